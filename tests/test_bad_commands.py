"""Commands that cannot work are answered with one sentence, and spoil nothing."""

import os
import re

import pytest
from full_disk import fill_the_disk
from references import melt_scene

import minimd as md
from minimd.commands import main as cli
from minimd.files.h5md_reader import read_file

SCENE = melt_scene(3, 20, "[output]\nevery = 5\n")
SCENE_OF_A_FILE = SCENE.replace(
    'lattice = "fcc"\nrepeat = [3, 3, 3]\ndensity = 0.8442', 'file = "atoms.xyz"\npbc = true\ncell = [9, 9, 9]'
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A current folder with a scene that runs, and a structure that can be read."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "good.toml").write_text(SCENE)
    (tmp_path / "atoms.xyz").write_text("2\n\nAr 0 0 0\nAr 3 0 0\n")
    return tmp_path


# what is done wrong: (the scene, None for none; the arguments; the exit code; words in the one sentence)
WRONG_COMMANDS = {
    "missing scene": (None, ["run", "none.toml"], 2, ["scene file 'none.toml' does not exist"]),
    "folder in place of a scene": (None, ["run", "."], 2, ["scene file '.' cannot be read"]),
    "broken TOML": ("a = [", ["run"], 2, ["bad.toml: this is not valid TOML"]),
    "empty structure file": (
        SCENE_OF_A_FILE.replace("atoms.xyz", "empty.xyz"),
        ["run"],
        2,
        ["structure: file 'empty.xyz' cannot be read"],
    ),
    "structure file that is none": (
        SCENE_OF_A_FILE.replace("atoms.xyz", "good.toml"),
        ["run"],
        2,
        ["structure: file 'good.toml' cannot be read"],
    ),
    "missing structure file": (
        SCENE_OF_A_FILE.replace("atoms.xyz", "b.xyz"),
        ["run"],
        2,
        ["structure: file 'b.xyz' does not exist"],
    ),
    "pbc without cell": (
        SCENE_OF_A_FILE.replace("cell = [9, 9, 9]", ""),
        ["run"],
        2,
        ["structure: pbc[0] is True but cell[0] is zero"],
    ),
    "structure of overlapping atoms": (
        SCENE_OF_A_FILE.replace("atoms.xyz", "same.xyz"),
        ["run"],
        3,
        ["atoms 0 and 1, 0 σ apart"],
    ),
    "unknown element": (
        SCENE.replace('units = "LJ"', "")
        .replace('"fcc"', '"fcc"\nelement = "Ag2"')
        .replace("density", "density_g_cm3")
        .replace("epsilon", "epsilon_eV")
        .replace("sigma", "sigma_A")
        .replace("cutoff", "cutoff_A")
        .replace("timestep", "timestep_fs")
        .replace("temperature", "temperature_K"),
        ["run"],
        2,
        ["structure: element must be a chemical symbol", "'Ag2'"],
    ),
    "unknown key": (
        SCENE.replace("steps", "step"),
        ["run"],
        2,
        ["dynamics has no key 'step'", "did you mean 'steps'?"],
    ),
    "wrong unit in a key": (
        SCENE.replace("timestep", "timestep_ps"),
        ["run"],
        2,
        ["no key 'timestep_ps'", "did you mean 'timestep'?"],
    ),
    "unknown unit system": (
        SCENE.replace('"LJ"', '"lj"').replace("[structure]", "[structure]"),
        ["run"],
        2,
        ["units must be 'ASE' or 'LJ'", '"lj"'],
    ),
    "negative steps": (
        SCENE.replace("steps = 20", "steps = -20"),
        ["run"],
        2,
        ["dynamics.steps must be greater than or equal to 0", "-20"],
    ),
    "cell too hot": (SCENE.replace("1.44", "1e8"), ["run"], 3, ["moves", "timestep 0.004 τ too large"]),
    "unknown suffix": (SCENE, ["run", "--out", "a.pdf"], 2, ["suffix of a trajectory", "'a.pdf'"]),
    "missing output folder": (SCENE, ["run", "--out", "no/a.h5md"], 2, ["no' does not exist"]),
    "existing output": (SCENE, ["run", "--out", "atoms.xyz"], 2, ["'atoms.xyz' exists"]),
    "missing run to resume": (None, ["resume", "none.h5md", "--steps", "5"], 2, ["'none.h5md' does not exist"]),
    "resume what is no run": (None, ["resume", "good.toml", "--steps", "5"], 2, ["'good.toml' is not an HDF5 file"]),
    "check what is no run": (None, ["check", "good.toml"], 2, ["'good.toml' is not an HDF5 file"]),
    "plot what is not there": (None, ["plot", "none.h5md"], 2, ["'none.h5md' does not exist"]),
}


def only_error(capsys, n_lines=1):
    """What follows `minimd: error:` on standard error, where it must stand once; of a blow-up the cause, and what was seen."""
    err = capsys.readouterr().err
    assert "Traceback" not in err
    messages = re.findall(r"^minimd: error: (.*)$", err, re.MULTILINE)
    assert len(messages) == n_lines, messages
    return " ".join(messages)


@pytest.mark.parametrize("wrong", WRONG_COMMANDS)
def test_wrong_command_is_answered_with_one_sentence(wrong, folder, capsys):
    scene, arguments, code, words = WRONG_COMMANDS[wrong]
    (folder / "empty.xyz").write_text("")
    (folder / "same.xyz").write_text("2\n\nAr 1 1 1\nAr 1 1 1\n")
    if scene is not None:
        (folder / "bad.toml").write_text(scene)
        arguments = [arguments[0], "bad.toml", *arguments[1:]]
    assert cli.main(arguments) == code
    message = only_error(capsys, 2 if code == 3 else 1)
    assert [word for word in words if word not in message] == [], message
    assert not list(folder.glob("*.h5md")) or code == 3


def test_unwritable_folder_is_told_before_anything_is_computed(folder, capsys, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # a mode of the folder would not stop root
    monkeypatch.setattr(md.Simulation, "__init__", lambda *_, **__: pytest.fail("it began to compute"))
    assert cli.main(["run", "good.toml"]) == 2
    assert only_error(capsys) == "output 'good.h5md' cannot be written: Permission denied"


def test_refused_output_leaves_no_empty_files_of_the_others(folder, capsys):
    (folder / "two.toml").write_text(SCENE + 'trajectory = ["new.h5md", "atoms.xyz"]\n')
    assert cli.main(["run", "two.toml"]) == 2
    assert (
        only_error(capsys) == "output 'atoms.xyz' exists; replace it with --overwrite, write elsewhere with --out FILE"
    )
    assert not (folder / "new.h5md").exists()


def test_ctrl_c_without_words_says_interrupted_and_what_is_kept(folder, capsys, monkeypatch):
    def interrupt(*_, **__):
        (folder / "good.h5md").write_text("half a run")
        raise KeyboardInterrupt

    monkeypatch.setattr(md.Simulation, "run", interrupt)
    assert cli.main(["run", "good.toml"]) == 130
    assert only_error(capsys) == "interrupted; what was written before is kept in good.h5md"


def test_full_disk_is_told_with_what_is_kept(folder, capsys, monkeypatch):
    fill_the_disk(monkeypatch, after=5)
    assert cli.main(["run", "good.toml"]) == 2
    message = only_error(capsys)
    assert "No space left on device" in message
    assert "kept in good.h5md" in message
    assert read_file("good.h5md").record.step.tolist() == [0, 5]


def test_ctrl_c_in_a_command_is_no_traceback(folder, capsys, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("minimd.scene.run_scene", interrupt)
    assert cli.main(["run", "good.toml"]) == 130
    assert only_error(capsys) == "interrupted"


def test_every_wrong_value_of_a_scene_gets_its_line(folder, capsys):
    (folder / "bad.toml").write_text(SCENE.replace("cutoff = 2.5", "cutoff = 0").replace("every = 5", "every = 0"))
    assert cli.main(["run", "bad.toml"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all(line.startswith("minimd: error: bad.toml: ") for line in lines)
