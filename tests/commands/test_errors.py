"""Commands that cannot work are answered with one sentence and an exit code, and spoil nothing."""

import os
import re

import pytest
from h5md_runs import fill_the_disk
from references import melt_scene

import minimd as md
from minimd.bench import command as bench
from minimd.commands import main as cli
from minimd.core.files.h5md_reader import read_file

SCENE = melt_scene(3, 20, "[output]\nevery = 5\n")
LATTICE = 'lattice = "fcc"\nrepeat = [3, 3, 3]\ndensity = 0.8442'
OF_A_FILE = SCENE.replace(LATTICE, 'file = "atoms.xyz"\npbc = true\ncell = [9, 9, 9]')
# fmt: off
FILES = {
    "good.toml": SCENE,  "broken.toml": "a = [",  "atoms.xyz.png": "precious",
    "empty.xyz": "",     "same.xyz": "2\n\nAr 1 1 1\nAr 1 1 1\n",  "atoms.xyz": "2\n\nAr 0 0 0\nAr 3 0 0\n",
    "of_empty.toml": OF_A_FILE.replace("atoms.xyz", "empty.xyz"),
    "of_text.toml": OF_A_FILE.replace("atoms.xyz", "good.toml"),
    "of_none.toml": OF_A_FILE.replace("atoms.xyz", "b.xyz"),
    "no_cell.toml": OF_A_FILE.replace("cell = [9, 9, 9]", ""),
    "on_one_spot.toml": OF_A_FILE.replace("atoms.xyz", "same.xyz"),
    "misspelt.toml": SCENE.replace("steps", "step"),  "hot.toml": SCENE.replace("1.44", "1e8"),
    "picture.toml": SCENE + 'plot = "atoms.xyz.png"\n',
    "two_outputs.toml": SCENE + 'trajectory = ["new.h5md", "atoms.xyz"]\n',
}
WRONG = [  # arguments, exit code, words in the sentence
    ("run none.toml", 2, "'none.toml' does not exist"), ("run of_none.toml", 2, "structure", "'b.xyz' does not exist"),
    ("run .", 2, "'.' cannot be read"), ("run misspelt.toml", 2, "dynamics", "'step'", "did you mean 'steps'?"),
    ("run broken.toml", 2, "broken.toml: this is not valid TOML"),
    ("run of_empty.toml", 2, "structure", "'empty.xyz' cannot be read"),
    ("run of_text.toml", 2, "structure", "'good.toml' cannot be read"),
    ("run no_cell.toml", 2, "structure", "pbc[0]", "cell[0]"), ("run on_one_spot.toml", 3, "atoms 0 and 1, 0 σ apart"),
    ("run hot.toml", 3, "moves", "timestep 0.004 τ too large"), ("run picture.toml", 2, "'atoms.xyz.png' exists"),
    ("run good.toml --out a.pdf", 2, "suffix of a trajectory", "'a.pdf'"),
    ("run good.toml --out no/a.h5md", 2, "no' does not exist"), ("check good.toml", 2, "'good.toml' is not an HDF5"),
    ("view good.toml", 2, "'good.toml' is not an HDF5"),
    ("run two_outputs.toml", 2, "'atoms.xyz' exists", "--overwrite", "--out"),
    ("resume none.h5md --steps 5", 2, "'none.h5md' does not exist"),
    ("plot none.h5md", 2, "'none.h5md' does not exist"), ("bench peers --threads 1,100000", 2, "--threads 100000"),
    ("bench peers --scene ice", 2, "--scene", bench.SCENE_NAMES, "'ice'"),
    ("bench peers --scenes gas ice", 2, "--scene", bench.SCENE_NAMES, "'ice'"),
    ("bench peers --peers namd", 2, "--peers", bench.PEER_NAMES, "'namd'"),
    ("bench peers --peers none,ase", 2, "--peers", "'none'"),
    ("bench peers --cells 10,2", 2, "--cells 2", "twice the cutoff", "'melt'"),
    ("bench peers --scenes gas chain --peers ase", 2, "--peers ase", "'gas'", "melt"),
    ("bench peers --scene chains --peers ase", 2, "--peers ase", "'chains'", "melt"),
]
# fmt: on
NO_NUMBERS = ["run good.toml --steps -1", "run good.toml --steps 2.5", "run good.toml --steps many"]
NO_NUMBERS += ["bench peers --cells 4,x", "bench peers --threads 0"]


@pytest.fixture
def folder(here):
    for name, content in FILES.items():
        (here / name).write_text(content)
    return here


def only_error(capsys, n_lines=1):
    """What follows `minimd: error:` on standard error; of a blow-up the cause, and what was seen."""
    out, err = capsys.readouterr()
    assert ("drawing" in out, "Traceback" in err) == (False, False)
    messages = re.findall(r"^minimd: error: (.*)$", err, re.MULTILINE)
    assert len(messages) == n_lines, messages
    return " ".join(messages)


@pytest.mark.parametrize("row", WRONG, ids=lambda row: row[0])
def test_a_wrong_command_is_answered_with_one_sentence_and_leaves_no_files(row, folder, capsys):
    arguments, code, *shown = row
    assert cli.main(arguments.split()) == code
    message = only_error(capsys, 2 if code == 3 else 1)
    assert [word for word in shown if word not in message] == [], message
    assert not {path.name for path in folder.iterdir()} - set(FILES) or code == 3
    assert all((folder / name).read_text() == content for name, content in FILES.items())


def test_numbers_must_be_whole_and_large_enough(folder, capsys):
    for arguments in NO_NUMBERS:
        with pytest.raises(SystemExit, match="2"):
            cli.main(arguments.split())
        assert re.search(r"must be .*, at least [01]; it is ", capsys.readouterr().err), arguments


def test_what_cannot_be_written_is_told_before_anything_is_computed(folder, capsys, monkeypatch):
    monkeypatch.setattr(md.Simulation, "__init__", lambda *_, **__: pytest.fail("it began to compute"))
    (folder / "good.h5md").write_text("precious")
    assert cli.main(["run", "good.toml"]) == 2
    assert "minimd resume good.h5md" in only_error(capsys)
    assert (folder / "good.h5md").read_text() == "precious"
    monkeypatch.setattr(os, "access", lambda *_: False)  # a mode of the folder would not stop root
    assert cli.main(["run", "good.toml", "--out", "b.h5md"]) == 2
    assert re.search("'b.h5md'.*Permission denied", only_error(capsys))


def test_full_disk_is_told_with_what_is_kept(folder, capsys, monkeypatch):
    fill_the_disk(monkeypatch, after=4)
    assert cli.main(["run", "good.toml"]) == 2
    assert re.search("No space left on device.*kept in good.h5md", only_error(capsys))
    assert read_file("good.h5md").record.step.tolist() == [0, 5]


def test_a_command_that_cannot_be_loaded_does_not_stop_the_others(install, capsys):
    def load():
        raise ModuleNotFoundError("No module named 'far'")

    install("far", load)
    assert cli.main(["check", "none.h5md"]) == 2
    assert "'none.h5md' does not exist" in capsys.readouterr().err
    assert cli.main([]) == 0
    assert "warning: the command far of far:COMMAND cannot be loaded" in capsys.readouterr().err
