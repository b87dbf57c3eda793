"""Bad input, of all the kinds that occur: one clear sentence that names quantity and value, never a traceback from the inside."""

import errno
import os
import re
import traceback
from pathlib import Path

import numpy as np
import pytest
from references import melt_scene

import minimd as md
from minimd import cli
from minimd.h5md import read_file

THREE = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])
NAN = float("nan")
LJ = md.LennardJones(1.0, 1.0, 2.5)
TWO_SPECIES = md.LennardJones({"Ar": (1.0, 1.0), "Kr": (1.0, 1.0)}, cutoff=2.5)

SCENE = melt_scene(3, 20, "[output]\nevery = 5\n")
SCENE_OF_A_FILE = SCENE.replace('lattice = "fcc"\nrepeat = [3, 3, 3]\ndensity = 0.8442', 'file = "atoms.xyz"\npbc = true\ncell = [9, 9, 9]')


def simulate(positions=THREE, potentials=LJ, timestep=0.005, n_steps=10, cell=None, **keywords):
    """A short run."""
    simulation = md.Simulation(md.System(positions, cell=cell), potentials, md.VelocityVerlet(timestep))
    simulation.set_temperature(1.0, seed=1)
    return simulation.run(n_steps, progress=False, **keywords)


def temperature_set_to(value):
    md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005)).set_temperature(value)


# what is done wrong: (the call, the exception, words that must be in its sentence)
WRONG_CALLS = {
    "two atoms on one spot": (lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3]], cell=10), md.NonFiniteError, ["atoms 1 and 2, 0 apart"]),
    "two atoms on one spot, evaluated": (
        lambda: md.evaluate(md.System([[0, 0, 0], [3, 3, 3], [3, 3, 3]]), LJ),
        md.NonFiniteError,
        ["not finite", "atoms 1 and 2, 0 apart"],
    ),
    "two atoms on one spot of the next cell": (
        lambda: simulate([[0, 0, 0], [3, 3, 3], [10, 0, 0]], cell=10),
        md.NonFiniteError,
        ["atoms 0 and 2, 0 apart"],
    ),
    "two atoms nearly on one spot": (
        lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3.001]], cell=10),
        md.NonFiniteError,
        ["force on atom", "atoms 1 and 2, 0.001 apart"],
    ),
    "NaN position": (lambda: md.System([[0, 0, 0], [1, NAN, 0]]), ValueError, ["positions must be finite", "positions[1]", "nan"]),
    "infinite position": (lambda: md.System([[0, np.inf, 0]]), ValueError, ["positions must be finite", "positions[0]", "inf"]),
    "NaN velocity": (lambda: md.System(THREE, velocities=THREE * NAN), ValueError, ["velocities must be finite", "velocities[0]"]),
    "no atoms": (lambda: md.System(np.zeros((0, 3))), ValueError, ["positions", "N > 0", "(0, 3)"]),
    "flat positions": (lambda: md.System([[0, 0], [1, 1]]), ValueError, ["positions", "(N, 3)", "(2, 2)"]),
    "positions that are words": (lambda: md.System([["a", "b", "c"]]), ValueError, ["positions", "(N, 3)", "'a'"]),
    "velocities of too few atoms": (lambda: md.System(THREE, velocities=[[0, 0, 0]]), ValueError, ["velocities", "3 atoms", "it has 1"]),
    "zero mass": (lambda: md.System(THREE, masses=[1, 0, 1]), ValueError, ["masses must be positive", "masses[1] = 0.0"]),
    "negative mass": (lambda: md.System(THREE, masses=[1, 1, -2]), ValueError, ["masses must be positive", "masses[2] = -2.0"]),
    "NaN mass": (lambda: md.System(THREE, masses=NAN), ValueError, ["masses must be positive and finite", "nan"]),
    "masses of too few atoms": (lambda: md.System(THREE, masses=[1, 2]), ValueError, ["masses", "3", "(2,)"]),
    "mass that is a word": (lambda: md.System(THREE, masses="heavy"), ValueError, ["masses must be one number", "'heavy'"]),
    "no masses in eV and Å": (lambda: md.System(THREE, units=md.units.ASE), ValueError, ["masses must be given in ASE units"]),
    "wrong unit system": (lambda: md.System(THREE, units="SI"), TypeError, ["units must be", "'SI'"]),
    "species of too few atoms": (lambda: md.System(THREE, species=["Ar"]), ValueError, ["species must be 3 labels", "(1,)"]),
    "species of several kinds": (lambda: md.System(THREE, species=["Ar", 1, None]), ValueError, ["species must be all strings", "None"]),
    "flat cell": (lambda: md.System(THREE, cell=[[1, 0, 0], [0, 1, 0], [1, 1, 0]]), ValueError, ["linearly independent", "[1.0, 1.0, 0.0]"]),
    "NaN cell": (lambda: md.System(THREE, cell=[10, NAN, 10]), ValueError, ["cell must be finite", "nan"]),
    "cell of two lengths": (lambda: md.System(THREE, cell=[10, 10]), ValueError, ["cell must be", "(2,)"]),
    "pbc without a cell": (lambda: md.System(THREE, pbc=True), ValueError, ["pbc[0] is True but cell[0] is zero"]),
    "bond to a missing atom": (lambda: md.System(THREE, bonds=[[0, 1], [1, 3]]), ValueError, ["bonds must name atoms 0 to 2", "bonds[1] = [1, 3]"]),
    "bond of an atom with itself": (lambda: md.System(THREE, bonds=[[1, 1]]), ValueError, ["two different atoms", "bonds[0] = [1, 1]"]),
    "doubled bond": (lambda: md.System(THREE, bonds=[[0, 1], [1, 0]]), ValueError, ["each pair once", "[0, 1] comes 2 times"]),
    "ragged bonds": (lambda: md.System(THREE, bonds=[[0, 1], [2]]), ValueError, ["bonds must be a (B, 2) array"]),
    "bond of fractions": (lambda: md.System(THREE, bonds=[[0, 1.5]]), ValueError, ["bonds must be a (B, 2) array", "float64"]),
    "negative cutoff": (lambda: md.LennardJones(1.0, 1.0, -2.5), ValueError, ["cutoff must be positive", "cutoff = -2.5"]),
    "NaN cutoff": (lambda: md.LennardJones(1.0, 1.0, NAN), ValueError, ["cutoff must be positive and finite", "nan"]),
    "no cutoff in a periodic cell": (
        lambda: simulate(potentials=md.LennardJones(1.0, 1.0), cell=10),
        ValueError,
        ["cutoff must be given in a periodic cell", "LennardJones", "None"],
    ),
    "tail correction without a cell": (
        lambda: simulate(potentials=md.LennardJones(1.0, 1.0, 2.5, "truncated", tail_correction=True)),
        ValueError,
        ["tail_correction needs a density", "periodic"],
    ),
    "tail correction of what has no tail": (
        lambda: md.LennardJones(1.0, 1.0, 2.5, "shifted", tail_correction=True),
        ValueError,
        ["tail_correction needs", "have no tail", "'shifted'"],
    ),
    "unknown truncation": (lambda: md.LennardJones(1.0, 1.0, 2.5, "shfted"), ValueError, ["truncation must be one of", "'switched'", "'shfted'"]),
    "unknown mixing rule": (lambda: md.LennardJones(1.0, 1.0, 2.5, mixing="mean"), ValueError, ["mixing must be one of", "'geometric'", "'mean'"]),
    "switch behind the cutoff": (lambda: md.LennardJones(1.0, 1.0, 2.5, "switched", switch_start=3.0), ValueError, ["switch_start", "2.5", "3.0"]),
    "negative epsilon": (lambda: md.LennardJones(-1.0, 1.0, 2.5), ValueError, ["epsilon must be finite and not negative", "-1.0"]),
    "zero sigma": (lambda: md.LennardJones(1.0, 0.0, 2.5), ValueError, ["sigma must be finite and positive", "0.0"]),
    "epsilon without sigma": (lambda: md.LennardJones(1.0), ValueError, ["either epsilon and sigma"]),
    "two factors of three": (lambda: md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0, 1)), ValueError, ["bonded_scale must be three", "(0, 1)"]),
    "unknown species": (
        lambda: md.evaluate(md.System(THREE, species=["Ar", "Kr", "Xe"]), TWO_SPECIES),
        ValueError,
        ["no parameters for species 'Xe'", "'Ar', 'Kr'"],
    ),
    "law that is no function": (lambda: md.PairPotential(3.0), TypeError, ["law must be a function", "3.0"]),
    "something that is no potential": (lambda: simulate(potentials=[3.0]), TypeError, ["potentials must be potentials of minimd", "got 3.0"]),
    "name in place of a potential": (lambda: simulate(potentials="lennard-jones"), TypeError, ["potentials must be", "got 'lennard-jones'"]),
    "something that is no method": (
        lambda: md.Simulation(md.System(THREE), LJ, "verlet"),
        TypeError,
        ["method must be an integrator", "VelocityVerlet(0.005)", "'verlet'"],
    ),
    "method without its time step": (lambda: md.Simulation(md.System(THREE), LJ, md.VelocityVerlet), TypeError, ["method must be an integrator"]),
    "negative stiffness": (lambda: md.HarmonicBond(-1.0, 1.0), ValueError, ["k of a harmonic bond must not be negative", "-1.0"]),
    "stiffness of too many bonds": (
        lambda: md.evaluate(md.System(THREE, bonds=[[0, 1]]), md.HarmonicBond([1.0, 2.0], 1.0)),
        ValueError,
        ["bond parameter must be one number or 1", "(2,)"],
    ),
    "angle at a missing atom": (
        lambda: md.evaluate(md.System(THREE), md.HarmonicAngle(1.0, 1.0, [[0, 1, 3]])),
        ValueError,
        ["triples must name different atoms from 0 to 2", "triples[0] = [0, 1, 3]"],
    ),
    "angle in degrees": (lambda: md.HarmonicAngle(1.0, 109.5, [[0, 1, 2]]), ValueError, ["between 0 and pi (radians)", "109.5"]),
    "zero time step": (lambda: md.VelocityVerlet(0.0), ValueError, ["timestep must be finite and not zero", "timestep = 0.0"]),
    "NaN time step": (lambda: md.VelocityVerlet(NAN), ValueError, ["timestep must be finite and not zero", "timestep = nan"]),
    "time step far too large": (lambda: simulate(timestep=5.0, cell=10), md.NonFiniteError, ["force on atom", "timestep 5 τ too large"]),
    "negative temperature": (lambda: temperature_set_to(-1.0), ValueError, ["temperature must be finite and not negative", "-1.0"]),
    "NaN temperature": (lambda: temperature_set_to(NAN), ValueError, ["temperature must be finite", "nan"]),
    "negative skin": (lambda: md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005), skin=-0.1), ValueError, ["skin", "-0.1"]),
    "negative number of steps": (lambda: simulate(n_steps=-1), ValueError, ["n_steps must be a whole number", "n_steps = -1"]),
    "half a step": (lambda: simulate(n_steps=0.5), ValueError, ["n_steps must be a whole number", "0.5"]),
    "observed every 0 steps": (lambda: simulate(every=0), ValueError, ["every must be a whole number, at least 1", "every = 0"]),
    "report before a run": (lambda: md.Simulation(md.System(THREE), LJ, md.VelocityVerlet(0.005)).report(), ValueError, ["call run first"]),
    "unknown suffix": (lambda: simulate(trajectory="run.pdf"), ValueError, ["suffix of a trajectory must be one of .h5md", "'run.pdf'"]),
    "output in a missing folder": (lambda: simulate(trajectory="/no/such/folder/a.h5md"), FileNotFoundError, ["'/no/such/folder' does not exist"]),
    "something that is no system": (lambda: md.Simulation("argon", LJ, md.VelocityVerlet(0.005)), TypeError, ["System or an ase.Atoms", "got str"]),
}


@pytest.mark.parametrize("wrong", WRONG_CALLS)
def test_wrong_call_is_answered_with_one_sentence(wrong):
    call, kind, words = WRONG_CALLS[wrong]
    with pytest.raises(kind) as caught:
        call()
    message = str(caught.value)
    assert type(caught.value) is kind
    assert "\n" not in message
    assert [word for word in words if word not in message] == [], message
    last = traceback.extract_tb(caught.value.__traceback__)[-1]
    assert "minimd" in Path(last.filename).parts, "the error comes from the inside of another library"
    assert last.line.startswith("raise"), "the error was not foreseen"


def test_existing_output_is_refused_and_kept(tmp_path):
    (tmp_path / "a.h5md").write_text("precious")
    with pytest.raises(FileExistsError, match=r"a\.h5md' exists; choose another name, or pass overwrite=True"):
        simulate(trajectory=tmp_path / "a.h5md")
    assert (tmp_path / "a.h5md").read_text() == "precious"


def fill_the_disk(monkeypatch, after):
    """From so many reservations of room on, the disk is full."""
    calls = []

    def full(*_):
        calls.append(1)
        if len(calls) > after:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    monkeypatch.setattr("minimd.h5md.SECONDS_BETWEEN_FLUSHES", 0.0)


def test_full_disk_ends_a_run_with_a_sentence_and_a_valid_file(tmp_path, monkeypatch):
    fill_the_disk(monkeypatch, after=3)
    with pytest.raises(OSError, match=r"a\.h5md' could not take the frame of step 2: No space left on device; its 2 frames") as caught:
        simulate(every=1, trajectory=tmp_path / "a.h5md")
    assert "\n" not in str(caught.value)
    assert read_file(tmp_path / "a.h5md").record.step.tolist() == [0, 1]


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
    "broken TOML": ("a = [", ["run"], 2, ["bad.toml: this is no TOML"]),
    "empty structure file": (SCENE_OF_A_FILE.replace("atoms.xyz", "empty.xyz"), ["run"], 2, ["structure: file 'empty.xyz' cannot be read"]),
    "structure file that is none": (SCENE_OF_A_FILE.replace("atoms.xyz", "good.toml"), ["run"], 2, ["structure: file 'good.toml' cannot be read"]),
    "missing structure file": (SCENE_OF_A_FILE.replace("atoms.xyz", "b.xyz"), ["run"], 2, ["structure: file 'b.xyz' does not exist"]),
    "pbc without cell": (SCENE_OF_A_FILE.replace("cell = [9, 9, 9]", ""), ["run"], 2, ["structure: pbc[0] is True but cell[0] is zero"]),
    "structure of overlapping atoms": (SCENE_OF_A_FILE.replace("atoms.xyz", "same.xyz"), ["run"], 3, ["atoms 0 and 1, 0 apart"]),
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
    "unknown key": (SCENE.replace("steps", "step"), ["run"], 2, ["dynamics has no key 'step'", "did you mean 'steps'?"]),
    "wrong unit in a key": (SCENE.replace("timestep", "timestep_ps"), ["run"], 2, ["no key 'timestep_ps'", "did you mean 'timestep'?"]),
    "unknown unit system": (SCENE.replace('"LJ"', '"lj"').replace("[structure]", "[structure]"), ["run"], 2, ["units must be 'ASE' or 'LJ'", '"lj"']),
    "negative steps": (SCENE.replace("steps = 20", "steps = -20"), ["run"], 2, ["dynamics.steps must be greater than or equal to 0", "-20"]),
    "cell too hot": (SCENE.replace("1.44", "1e8"), ["run"], 3, ["moves", "timestep 0.004 τ too large"]),
    "unknown suffix": (SCENE, ["run", "--out", "a.pdf"], 2, ["suffix of a trajectory", "'a.pdf'"]),
    "missing output folder": (SCENE, ["run", "--out", "no/a.h5md"], 2, ["no' does not exist"]),
    "existing output": (SCENE, ["run", "--out", "atoms.xyz"], 2, ["'atoms.xyz' exists"]),
    "missing run to resume": (None, ["resume", "none.h5md", "--steps", "5"], 2, ["'none.h5md' does not exist"]),
    "resume what is no run": (None, ["resume", "good.toml", "--steps", "5"], 2, ["'good.toml' is not an HDF5 file"]),
    "check what is no run": (None, ["check", "good.toml"], 2, ["'good.toml' is not an HDF5 file"]),
    "plot what is not there": (None, ["plot", "none.h5md"], 2, ["'none.h5md' does not exist"]),
}


def only_error(capsys):
    """What follows `minimd: error:` on standard error, where it must stand once."""
    err = capsys.readouterr().err
    assert "Traceback" not in err
    (message,) = re.findall(r"^minimd: error: (.*)$", err, re.MULTILINE)
    return message


@pytest.mark.parametrize("wrong", WRONG_COMMANDS)
def test_wrong_command_is_answered_with_one_sentence(wrong, folder, capsys):
    scene, arguments, code, words = WRONG_COMMANDS[wrong]
    (folder / "empty.xyz").write_text("")
    (folder / "same.xyz").write_text("2\n\nAr 1 1 1\nAr 1 1 1\n")
    if scene is not None:
        (folder / "bad.toml").write_text(scene)
        arguments = [arguments[0], "bad.toml", *arguments[1:]]
    assert cli.main(arguments) == code
    message = only_error(capsys)
    assert [word for word in words if word not in message] == [], message
    assert not list(folder.glob("*.h5md")) or code == 3


def test_unwritable_folder_is_told_before_anything_is_computed(folder, capsys, monkeypatch):
    original = Path.open

    def refuse(self, mode="r", *arguments, **keywords):  # a mode of the folder would not stop root
        if "a" in mode:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))
        return original(self, mode, *arguments, **keywords)

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr(md.Simulation, "__init__", lambda *_, **__: pytest.fail("it began to compute"))
    assert cli.main(["run", "good.toml"]) == 2
    assert only_error(capsys) == "output 'good.h5md' cannot be written: Permission denied"


def test_refused_output_leaves_no_empty_files_of_the_others(folder, capsys):
    (folder / "two.toml").write_text(SCENE + 'trajectory = ["new.h5md", "atoms.xyz"]\n')
    assert cli.main(["run", "two.toml"]) == 2
    assert only_error(capsys) == "output 'atoms.xyz' exists; replace it with --overwrite, write elsewhere with --out FILE"
    assert not (folder / "new.h5md").exists()


def test_ctrl_c_without_words_says_interrupted_and_what_is_kept(folder, capsys, monkeypatch):
    def interrupt(*_, **__):
        (folder / "good.h5md").write_text("half a run")
        raise KeyboardInterrupt

    monkeypatch.setattr(md.Simulation, "run", interrupt)
    assert cli.main(["run", "good.toml"]) == 130
    assert only_error(capsys) == "interrupted; what was written before is kept in good.h5md"


def test_full_disk_is_told_with_what_is_kept(folder, capsys, monkeypatch):
    fill_the_disk(monkeypatch, after=3)
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
