"""`minimd scan`: what is set is what runs, and nothing strange in its folder is believed."""

import json
import os
import re
import shutil
import signal
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from references import melt_scene

from minimd.commands import main as cli
from minimd.core.files.h5md_reader import read_file
from minimd.core.structure.statistics import with_error
from minimd.ensemble.folder import EnsembleFolder
from minimd.ensemble.scan import changed_text, parsed_setting
from minimd.ensemble.table import status
from minimd.ensemble.workers import named_executor
from minimd.scene import parse_scene
from minimd.scene.section import quantity_of

DYNAMICS = 'method = "langevin-baoab"\nrelaxation_time = 1.0\n[output]\nevery = 5\n'
SCENE = "# A comment.\n" + melt_scene(2, 40, DYNAMICS).replace("2.5", "1.6")
SETTINGS = {
    "80:120:5": [80, 85, 90, 95, 100, 105, 110, 115, 120], 'shifted,"smooth",true': ["shifted", "smooth", True],
    "0.1:0.3:0.1": [0.1, 0.2, 0.3], "1:0.5:-0.25": [1.0, 0.75, 0.5], "1:2:3": [1], "1,2.5,1e-3": [1, 2.5, 0.001],
}  # fmt: skip


@pytest.fixture
def in_time():
    """Fail instead of waiting forever."""
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it still waits"))
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def scan(*arguments):
    return cli.main(["scan", *map(str, arguments)])


def test_settings_are_read_in_decimals_with_both_ends():
    for text, values in SETTINGS.items():
        setting = parsed_setting(f"a.b={text}")
        assert (*setting, [*map(type, setting.values)]) == ("a.b", values, [*map(type, values)])


def test_a_changed_scene_differs_in_what_was_set_only():
    changes = [("dynamics.temperature", 0.9), ("potential[0].cutoff", 1.5), ("dynamics.seed", 2**62)]
    text = changed_text(Path("a.toml"), SCENE, changes)
    assert text.startswith("# A comment.")
    expected = tomllib.loads(SCENE)
    expected["dynamics"] |= {"temperature": 0.9, "seed": 2**62}
    expected["potential"][0]["cutoff"] = 1.5
    assert tomllib.loads(text) == expected


SET = ["melt.toml", "--set"]
WRONG = [  # arguments, and what is shown
    ([*SET, "dynamic.temperature=1,2"], "'dynamic.temperature'"),
    ([*SET, "potential[1].cutoff=1,2"], "'potential[1].cutoff'"), ([*SET, "dynamics.steps=1,2"], "--steps"),
    ([*SET, "dynamics.temperatur=1,2"], "'temperatur'"), ([*SET, "dynamics.temperature=1,-2"], "dynamics.temperature"),
    ([*SET, "structure.density=1,cold"], "density"), ([], "--status"), (["--status", "nowhere"], "'nowhere'"),
    (["melt.toml", "--out", "other"], "another scene"),
]  # fmt: skip


def test_what_cannot_run_is_refused_before_anything_is_computed(folder, told):
    (folder / "other").mkdir()
    (folder / "other" / "scene.toml").write_text("another")
    for arguments, shown in WRONG:
        error = told("scan", *arguments, code=2)
        assert (shown in error, error.count("\n") <= 2) == (True, True), error
    assert not Path("scan").exists()


def test_a_refused_call_leaves_the_scan_as_it_was(copied, told):
    Path("other.toml").write_text(SCENE.replace("1.6", "1.7"))
    before = Path("scan/scene.toml").read_text()
    assert "--overwrite" in told("scan", "other.toml", "--overwrite", "--members", "0:1", code=2)
    with EnsembleFolder(Path("scan"), writes=True):
        assert "running" in told("scan", "other.toml", "--overwrite", code=2)
    assert Path("scan/scene.toml").read_text() == before


def test_executors_say_what_is_missing_and_whose_processes_they_use(folder, told, monkeypatch):
    monkeypatch.setitem(sys.modules, "dask", SimpleNamespace(config={"scheduler-address": "tcp://there:1"}))
    for client, shown in ((None, "'minimd-engine[cluster]'"), (SimpleNamespace(Client=None), "--workers, which is 0")):
        monkeypatch.setitem(sys.modules, "distributed", client)
        assert shown in told("scan", "melt.toml", "--executor", "dask", "--workers", 0, code=2)
    with pytest.raises(ModuleNotFoundError), named_executor("threads", 0):
        raise ModuleNotFoundError("of the scan itself")


def test_a_scan_runs_what_was_set_and_tells_averages(folder, told):
    command = ["melt.toml", "--set", "dynamics.temperature=0.5:0.6:0.1", "--workers", 0, "--replicas"]
    found = told("scan", *command, 1)
    for words in ("set            dynamics.temperature = 0.5, 0.6 (2 values)", "2 done", "±"):
        assert words in found
    assert Path("scan/pressure.png").read_bytes().startswith(b"\x89PNG")
    texts = [read_file(f"scan/0000-0999/{k:04d}.h5md").scene for k in range(2)]
    scenes = [parse_scene(text, Path("a.toml")).sections.dynamics for text in texts]
    assert [one.temperature for one in scenes] == [0.5, 0.6]
    assert scenes[0].seed != scenes[1].seed
    alone = parse_scene(texts[1], Path("a.toml")).simulation()  # a member is the run of the scene in its file
    alone.run(40, every=5, progress=False)
    np.testing.assert_array_equal(alone.positions, read_file("scan/0000-0999/0001.h5md").system.positions)
    before = Path("scan/members.jsonl").read_text()
    assert scan(*command, 2, "--plot", "temperature", "--quiet") == 0
    assert Path("scan/members.jsonl").read_text().startswith(before)
    assert Path("scan/temperature.png").exists()
    assert "'pressure'" in told("scan", *command, 2, "--plot", "presure", code=2)
    ends = "(?s)4 members in scan: 4 done.*dynamics.temperature.*written +scan/pressure.png$"
    assert re.search(ends, told("scan", "--status", "scan"))


ARGON = """
[structure]
lattice = "fcc"
element = "Ar"
repeat = [2, 2, 2]
density_g_cm3 = 1.4
[[potential]]
type = "lennard-jones"
epsilon_K = 120.0
sigma_A = 3.4
cutoff_A = 5.0
[dynamics]
method = "langevin-baoab"
timestep_fs = 8.0
temperature_K = 95.0
relaxation_time_fs = 1000.0
steps = 400
[barostat]
pressure_bar = 1000.0
compressibility_per_bar = 2e-4
relaxation_time_fs = 500.0
[output]
every = 10
"""


def test_a_scan_at_constant_pressure_tells_bar_and_density(folder, told):
    """And no components of the cell that are zero."""
    Path("argon.toml").write_text(ARGON)
    scanned = ["argon.toml", "--set", "dynamics.temperature_K=90,95", "--workers", 0, "--plot", "density"]
    lines = told("scan", *scanned)
    table = status(Path("scan"))[0]
    record = read_file("scan/0000-0999/0000.h5md").record
    density = 32 * 39.948 / 0.6022140858549161 / record.volume
    assert table["density_mean"][0] == pytest.approx(density.mean())
    assert (table.unit("density"), table.unit("pressure")) == ("g/cm³", "eV/Å³")
    for words in ("density [g/cm³]", "pressure [bar]", "cell xx", "cell zz"):
        assert words in lines
    assert "cell xy" not in lines
    mean, error = (table[f"pressure_{end}"][0] / 6.241509125883258e-07 for end in ("mean", "error"))
    assert with_error(mean, error) in lines
    (panel,) = table.plot().axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("temperature  [K]", "mean pressure  [bar]")
    assert panel.lines[0].get_ydata()[0] == pytest.approx(mean)


def test_a_quantity_that_cannot_be_drawn_is_refused_before_the_first_run(folder, told):
    assert "'pressure'" in told("scan", "melt.toml", "--plot", "density", code=2)
    assert not Path("scan").exists()


KEYS = {
    "dynamics.temperature_K": "temperature  [K]", "structure.density_g_cm3": "density  [g/cm³]",
    "barostat.compressibility_per_bar": "compressibility  [1/bar]", "potential[0].k_eV_A2": "k  [eV/Å²]",
    "dynamics.temperature": "temperature", "bath_K": "bath_K",
}  # fmt: skip


@pytest.mark.parametrize("key", KEYS)
def test_an_axis_has_the_unit_of_a_key(key):
    assert quantity_of(key) == KEYS[key]


def test_members_that_fail_are_told_and_the_code_is_one(folder, capsys):
    assert scan("melt.toml", "--set", "dynamics.timestep=0.004,0.5", "--workers", 0) == 1
    told, warned = capsys.readouterr()
    assert ("1 done, 1 failed" in told, "0001.crash.h5md" in warned) == (True, True)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """The folder of a scan with one member."""
    place = tmp_path_factory.mktemp("scanned")
    (place / "melt.toml").write_text(SCENE)
    assert scan(place / "melt.toml", "--workers", 0, "--steps", 5, "--quiet", "--out", place / "scan") == 0
    return place / "scan"


@pytest.fixture
def copied(scanned, folder):
    shutil.copytree(scanned, "scan")


def altered(**changes):
    """Of each line of a text of JSON: a copy with other values."""
    return lambda text: "".join(f"{json.dumps(json.loads(line) | changes)}\n" for line in text.splitlines())


DESCRIPTION, JOURNAL = "scan/ensemble.json", "scan/members.jsonl"
ALTERED = [  # the file, and what becomes of its text
    *((DESCRIPTION, altered(**change)) for change in (
        {"parameters": "x"}, {"members": 10**8}, {"members": 10**8, "parameters": {}}, {"steps": "x"})),
    *((JOURNAL, altered(**change)) for change in (
        {"means": "x"}, {"means": {"pressure": "x"}}, {"errors": "x"}, {"errors": {}}, {"n_steps": "x"},
        {"n_steps": 2**70}, {"status": []})),
    (DESCRIPTION, lambda _: "[]"), (JOURNAL, lambda _: "3\n"), (JOURNAL, lambda _: "[" * 200_000 + "\n"),
]  # fmt: skip


def test_altered_files_of_a_scan_are_refused_by_name(copied, told):
    for name, change in ALTERED:
        before = Path(name).read_text()
        Path(name).write_text(change(json.dumps(json.loads(before)) if name == DESCRIPTION else before))
        assert name in told("scan", "--status", "scan", code=2)
        Path(name).write_text(before)


@pytest.mark.parametrize("executor", ["threads", pytest.param("dask", marks=pytest.mark.slow)])
def test_executors_by_name_and_slices_make_the_same_table(executor, folder, told):
    command = ["scan", "melt.toml", "--set", "dynamics.temperature=0.5:0.7:0.1"]
    told(*command, "--workers", 0)
    for part, workers in (("2:9", 2), ("0:2", 0)):
        told(
            *command, "--executor", executor, "--workers", workers, "--members", part, "--retries", 1, "--out", "slices"
        )
    assert Path("slices/table.csv").read_bytes() == Path("scan/table.csv").read_bytes()
    assert Path("slices/members.2-3.jsonl").exists()


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
@pytest.mark.parametrize("name", [DESCRIPTION, JOURNAL, "scan/scene.toml"])
def test_pipes_and_folders_are_no_files_of_a_scan(name, make, copied, capsys, in_time):
    Path(name).unlink()
    make(name)
    is_scene = name.endswith("scene.toml")
    assert scan("melt.toml", "--workers", 0, "--steps", 5) == 2
    told = capsys.readouterr().err if is_scene else ""
    assert scan("--status", "scan") == (0 if is_scene else 2)
    assert name in told + capsys.readouterr().err


def test_no_member_is_written_through_a_link(copied, told):
    Path("scan/0000-0999").rename("elsewhere")
    Path("scan/0000-0999").symlink_to(Path("elsewhere").absolute())
    Path("elsewhere/0000.h5md").write_text("precious")
    for command in (["melt.toml", "--workers", 0, "--steps", 5], ["melt.toml", "--overwrite"], ["--status", "scan"]):
        assert "0000-0999" in told("scan", *command, code=2)
        assert Path("elsewhere/0000.h5md").read_text() == "precious"
