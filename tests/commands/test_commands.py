"""The command line: what it says, with which exit code, what it leaves behind; `minimd doctor` notices faults."""

import json
import os
import re
import shutil
import signal
import warnings
from pathlib import Path

import h5py
import numba
import numpy as np
import pytest
from processes import ended
from scene_texts import SMOOTH
from wrong_calls import assert_answered

import minimd as md
from minimd.commands import doctor, main as cli
from minimd.core.compiled import kernels as compiling
from minimd.core.compiled.code_cache import CodeFiles
from minimd.core.files.h5md_digest import sign
from minimd.core.files.h5md_reader import read_file
from minimd.core.files.h5md_writer import H5MDWriter
from minimd.core.integrators.substeps import Thermalize
from minimd.scene import load_scene

SCENE = f'title = "A small melt"\n{SMOOTH}'
PNG = b"\x89PNG"
LIGHT = """
import runpy, sys
from minimd.commands.main import main
sys.argv = ["minimd", "--help"]
for call in (lambda: main(["--version"]), lambda: runpy.run_module("minimd", None, "__main__")):
    try:
        call()
    except SystemExit as end:
        assert end.code == 0
heavy = {"ase", "MDAnalysis", "matplotlib", "h5py", "pydantic", "tqdm"} & set(sys.modules)
assert not heavy, heavy
"""
READING = [["check"], ["frames", "--at", "1"], ["resume", "--steps", "5"], ["replay"]]
DRAWING = pytest.param([["view"], ["plot"]], marks=pytest.mark.slow)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The file of a run of the scene."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "melt.toml").write_text(SCENE)
    assert run("run", folder / "melt.toml", "--out", folder / "melt.h5md") == 0
    return folder / "melt.h5md"


def run(*arguments):
    return cli.main([*map(str, arguments), "--quiet"])


def test_version_and_help_are_told_without_loading_anything():
    light = ended("-c", LIGHT)
    assert (light.returncode, light.stderr) == (0, "")
    assert light.stdout.startswith(f"minimd {md.__version__}\nusage: minimd [-h] [--version] command ...")


def test_run_tells_what_it_does_and_what_to_do_next_unless_it_is_quiet(folder, capfd):
    assert (run("run", "melt.toml"), *capfd.readouterr()) == (0, "", "")
    assert read_file("melt.h5md").n_frames == 5
    assert cli.main(["run", "melt.toml", "--overwrite"]) == 0
    out, err = capfd.readouterr()
    for words in ("A small melt", "256 atoms", "40 steps = 0.16 τ", "verdict", "melt.h5md", "minimd check melt.h5md"):
        assert words in out
    assert err.count("running: step") == 4  # no terminal, so lines


def test_the_first_command_runs_where_calls_of_linux_and_letters_are_missing(folder):
    tests = Path(__file__).parents[1]
    text = (tests.parent / "examples" / "argon.toml").read_text(encoding="utf-8")
    Path("argon.toml").write_text(text.replace("steps = 4000", "steps = 400"), encoding="utf-8")
    for command in (["run", "argon.toml", "--steps", "200"], ["check", "argon.h5md"], ["view", "argon.h5md"]):
        done = ended(f"{tests}/elsewhere.py", *command, folder=folder, PYTHONIOENCODING="ascii")
        assert done.returncode == 0, done.stderr
    assert sorted(file.suffix for file in folder.glob("argon*")) == [".h5md", ".html", ".png", ".toml"]


@pytest.mark.slow
def test_out_takes_the_picture_along_and_spares_pictures_that_were_not_named(folder, capsys):
    Path("melt.toml").write_text(SCENE + 'plot = "melt.png"\n')
    for name in ("melt.png", "second.png"):
        Path(name).write_text("precious")
    for name in ("first", "second"):
        assert cli.main(["run", "melt.toml", "--steps", "20", "--out", f"{name}.h5md"]) == 0
        assert read_file(f"{name}.h5md").record.step.tolist() == [0, 10, 20]
    assert Path("first.png").read_bytes().startswith(PNG)
    assert {Path(name).read_text() for name in ("melt.png", "second.png")} == {"precious"}
    assert "second.png exists and is kept" in capsys.readouterr().out
    assert run("run", "melt.toml", "--steps", 0, "--out", "third.xyz") == 0
    Path("melt.toml").write_text(SCENE + "plot = true\n")
    assert run("run", "melt.toml", "--steps", 0, "--out", "fourth.h5md") == 0
    assert Path("fourth.png").read_bytes().startswith(PNG)
    assert not Path("melt.h5md").exists()


def test_resumed_run_ends_with_the_scene_and_is_the_uninterrupted_one(folder, told):
    Path("melt.toml").write_text(SCENE + 'trajectory = ["melt.h5md", "melt.xyz"]\n')
    assert (run("run", "melt.toml", "--out", "whole.h5md"), run("run", "melt.toml", "--steps", 15)) == (0, 0)
    assert "only melt.h5md is continued" in told("resume", "melt.h5md")
    assert "it is at step 40, dynamics.steps = 40" in told("resume", "melt.h5md", code=2)
    whole, parts, start = read_file("whole.h5md"), read_file("melt.h5md"), load_scene("melt.toml").system()
    assert (parts.step, whole.step, parts.time) == (40, 40, pytest.approx(0.16))
    assert set(whole.record.step) <= set(parts.record.step)
    # rounding: other list, other sums; grown over 25 steps in the positions
    assert parts.record.total_energy[-1] == pytest.approx(whole.record.total_energy[-1], rel=1e-13)
    assert np.abs(parts.system.positions - whole.system.positions).max() < 1e-12
    assert np.abs(parts.system.positions - start.positions).max() > 1e-3  # atoms moved


def test_interrupted_run_says_how_to_go_on_or_that_nothing_was_written(folder, told, monkeypatch):
    write, rescale = H5MDWriter.write, md.Simulation.rescale_temperature

    def stopping(call, one, argument):
        call(one, argument)
        if getattr(argument, "step", None) == 20 or getattr(one, "step", None) == 20:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(md.Simulation, "rescale_temperature", lambda sim, to: stopping(rescale, sim, to))
    Path("warm.toml").write_text(SCENE.replace("[output]", "[equilibration]\nsteps = 40\n[output]"))
    assert "of the equilibration; nothing was written" in told("run", "warm.toml", code=130)
    assert not Path("warm.h5md").exists()
    monkeypatch.setattr(H5MDWriter, "write", lambda writer, frame: stopping(write, writer, frame))
    stopped = told("run", "melt.toml", code=130)
    assert "resume with: minimd resume melt.h5md --steps 19" in stopped
    assert "error" not in stopped
    monkeypatch.undo()
    os.chdir(folder)
    assert (run("resume", "melt.h5md", "--steps", 19), read_file("melt.h5md").step) == (0, 40)


def test_resume_goes_on_up_to_a_step_and_counts_all_steps(folder, capsys):
    assert run("run", "melt.toml", "--steps", 10) == 0
    capsys.readouterr()
    assert cli.main(["resume", "melt.h5md", "--until-step", "30"]) == 0
    assert "running: step 30 of 30" in capsys.readouterr().err
    assert read_file("melt.h5md").step == 30
    for ends, words in ((["20"], "30"), (["40", "--steps", "5"], "--until-step")):
        assert cli.main(["resume", "melt.h5md", "--until-step", *ends]) == 2
        assert words in capsys.readouterr().err


def test_resume_without_a_stored_scene_asks_for_one(folder, told):
    of = load_scene("melt.toml").simulation()
    md.Simulation(of.system, of.potentials, of.method).run(10, every=5, trajectory="bare.h5md")
    assert "minimd.Simulation.resume('bare.h5md', potentials)" in told("resume", "bare.h5md", "--steps", 5, code=2)
    assert (run("resume", "bare.h5md", "--steps", 10, "--scene", "melt.toml"), read_file("bare.h5md").step) == (0, 20)


@pytest.mark.slow
def test_a_scene_given_to_resume_replaces_that_of_the_file(folder, told):
    Path("slow.toml").write_text(SCENE.replace("timestep = 0.004", "timestep = 0.002"))
    assert run("run", "melt.toml", "--steps", 4) == 0
    resumed = told("resume", "melt.h5md", "--scene", "slow.toml", "--steps", 4)
    assert "dynamics.timestep: 0.004 before, 0.002 now" in resumed
    assert "timestep 0.002 τ" in told("resume", "melt.h5md", "--steps", 4)
    simulation = md.Simulation.resume("melt.h5md")
    simulation.method = md.VelocityVerlet(0.001)  # in a script, beside the scene in the file
    simulation.run(4, trajectory="melt.h5md", append=True)
    assert "the last steps were made with VelocityVerlet(timestep=0.001)" in told("resume", "melt.h5md", "--steps", 4)
    assert md.Simulation.resume("melt.h5md").method.timestep == 0.001


def test_any_steps_are_made_again_and_their_energies_told(folder, told):
    Path("melt.toml").write_text(SCENE.replace("[output]", 'precision = "fixed-point"\n[output]'))
    assert run("run", "melt.toml", "--out", "melt.h5md") == 0
    words = told("frames", "melt.h5md", "--at", 3, 10, "--out", "a.h5md")
    energies = read_file("a-3.h5md").record.total_energy[0], read_file("melt.h5md").record.total_energy[1]
    assert all(f"total energy {float(energy)!r} ε" in words for energy in energies)


@pytest.mark.parametrize("reading", [READING, DRAWING], ids=["reading", "drawing"])
def test_texts_of_files_give_no_orders_to_the_terminal(reading, finished, folder, capsys):
    """Titles and names of files are escaped, labels of atoms refused.  Colors, returns, bells, titles, order."""
    orders = ["\x1b[31mred", "a\rb", "\a", "\x9d0;x\x9c", "\u202egnp"]
    strange = "".join(orders)
    file = shutil.copy(finished, f"a{strange}.h5md")
    with h5py.File(file, "r+") as h5:
        h5["minimd"].attrs["title"] = strange
        sign(h5)
    scene, title = f"a{strange}.toml", json.dumps(strange)
    Path(scene).write_text(f"title = {title}\n{SMOOTH}")
    assert cli.main(["run", scene, "--steps", "0", "--out", f"b{strange}.h5md"]) == 0
    Path(scene).write_text(f"{title} = {title}\n{SMOOTH}")
    read = [[name, file, *options] for name, *options in reading]
    for arguments in (*read, ["check", f"{file}.nowhere"], ["run", scene]):
        assert cli.main(arguments) == 2 or arguments in read
        told = "".join(capsys.readouterr())
        assert repr(strange)[1:-1] in told, arguments
        assert all(one.isprintable() or one == "\n" for one in told)
    for one in orders:
        assert_answered(lambda: md.System([[0.0, 0, 0]], species=[one]), ValueError, "printable", repr(one))


def test_plot_draws_and_check_passes_on_a_sound_file_and_fails_on_another(finished, folder, told):
    shutil.copy(finished, "melt.h5md")
    Path("other.png").touch()
    lines = ["drawing        other.png ...", "replaced       other.png"]
    assert told("plot", "melt.h5md", "--out", "other.png").splitlines() == lines
    assert Path("other.png").read_bytes().startswith(PNG)
    assert "passed" in told("check", "melt.h5md")
    with h5py.File("melt.h5md", "r+") as h5:
        h5["particles/trajectory/velocity/value"][2] *= 1.01
    assert "FAILED" in told("check", "melt.h5md", code=1)


def test_blow_up_ends_with_its_own_code_and_keeps_what_was_written(folder, capsys):
    hot = SCENE.replace("1.44", "50.0").replace("steps = 40", "steps = 4000")
    Path("melt.toml").write_text(hot.replace("timestep = 0.004", "timestep = 0.025"))
    with warnings.catch_warnings(action="always"):
        assert cli.main(["run", "melt.toml"]) == 3
    err = capsys.readouterr().err
    note, cause, seen = [line for line in err.splitlines() if line.startswith("minimd: ") and "compiling" not in line]
    assert note.startswith("minimd: warning: timestep 0.025 τ is long for Lennard-Jones atoms")
    assert re.match("minimd: error: Likely cause:.*timestep 0.025 τ too large", cause)
    assert re.match("minimd: error: At step.*kept in melt.h5md", seen)
    assert read_file("melt.h5md").n_frames > 0


class Careless(md.Simulation):
    def __init__(self, *arguments, threads=None):
        super().__init__(*arguments, threads=threads)
        self.positions[0, 0] += 1e-15 * (threads == 2)


class Leaking(md.VelocityVerlet):
    substeps = (*md.VelocityVerlet.substeps, Thermalize(1.0))

    def thermalize(self, state, duration, around):
        state.velocities[:] *= 0.9999


@pytest.mark.slow
def test_doctor_finds_this_machine_in_order(told):
    found = told("doctor")
    assert (found.count("FAILED"), found.count(" OK ") + found.count("NOT TESTED"), len(doctor.TESTS)) == (0, 7, 7)
    for words in (f"minimd         {md.__version__}", "numba ", "equal to the last bit", "million atom-steps/s on one"):
        assert words in found
    doctor.same_bits()
    with pytest.raises(ValueError, match="not initialized"):  # as doctor says: minimd's threads are its own
        numba.threading_layer()


def test_doctor_calls_nothing_in_order_that_is_not_there(monkeypatch):
    def none(processes):
        raise FileNotFoundError("LAMMPS")

    monkeypatch.setattr("minimd.lammps.handing_over.find_program", none)
    assert doctor.lammps()[0] is None


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_doctor_outlives_a_test_that_crashes_and_goes_on(told, monkeypatch):
    monkeypatch.setattr(doctor, "TESTS", {"crash": os.abort, "cache folder": doctor.cache})
    crashed, cache, conclusion = told("doctor", code=1).splitlines()[-3:]
    assert (crashed[:21], cache[:17], "NOT work" in conclusion) == ("crash          FAILED", "cache folder   OK", True)


def test_doctor_finds_damaged_compiled_code_and_loads_nothing_of_it(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "cache_folder", lambda: tmp_path)
    (tmp_path / "forces").mkdir()
    files = CodeFiles(str(tmp_path / "forces"), "twice", "now")
    for signature in ("floats", "integers"):
        files.save(signature, f"code for {signature}")
    (tmp_path / "forces" / "gone.nbi").symlink_to(tmp_path / "nowhere")  # as one that another process has just replaced
    assert doctor.cache() == (True, str(tmp_path))
    file = tmp_path / "forces" / files._load_index()["floats"]
    code = bytearray(file.read_bytes())
    code[-3] ^= 1
    file.write_bytes(code)
    fine, sentence = doctor.cache()
    assert (fine, sentence[-3:]) == (True, ": 1")
    assert (files.load("floats"), files.load("integers")) == (None, "code for integers")


def test_doctor_empties_the_cache_and_leaves_what_is_not_the_caches(tmp_path, monkeypatch, told):
    own, older, strange = tmp_path / f"minimd-{16 * '0'}", tmp_path / f"minimd-{16 * 'a'}", tmp_path / "minimd-x"
    monkeypatch.setattr(compiling, "cache_folder", lambda: own)
    (tmp_path / f"minimd-{16 * 'f'}").symlink_to(strange)
    (tmp_path / f"minimd-{16 * 'e'}").write_bytes(b"no folder")
    (own / "forces" / "folder.nbi").mkdir(parents=True)
    kept = {tmp_path / "a.nbi", own / "a.txt", own / "forces" / "a.txt", strange / "forces" / "a.nbc"}
    removed = {own / "forces" / "a.nbc", own / "forces" / "a.lock", older / "forces" / f"a.nbi.{32 * '0'}"}
    for file in kept | removed:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"code")
    assert "3 files" in told("doctor", "--clear-cache")
    assert {file for file in kept | removed if file.exists()} == kept
    assert not older.exists()


def test_doctor_notices_wrong_forces_bits_that_depend_on_threads_and_drifts(monkeypatch):
    evaluate = md.evaluate

    def wrongly(system, potentials):
        found = evaluate(system, potentials)
        found.forces[:] *= 1.001
        return found

    wrong = {"evaluate": (wrongly, doctor.gradient), "Simulation": (Careless, doctor.same_bits)}
    for name, (one, test) in (wrong | {"VelocityVerlet": (Leaking, doctor.conservation)}).items():
        with monkeypatch.context() as patch:
            patch.setattr(doctor.md, name, one)
            fine, sentence = test()
        assert not fine, sentence
        assert name != "Simulation" or "2 threads" in sentence
