"""The command line: what it says, where, with which exit code, and what it leaves behind."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
from scene_texts import SMOOTH

import minimd as md
from minimd.commands import main as cli
from minimd.files.h5md_digest import sign
from minimd.files.h5md_reader import read_file
from minimd.scene import load_scene

SCENE = f'title = "A small melt"\n{SMOOTH}'


REPOSITORY = Path(__file__).parent.parent


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty current folder with the scene in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "melt.toml").write_text(SCENE)
    return tmp_path


def command(*arguments, **keywords):
    """The command in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    return subprocess.Popen(
        [sys.executable, "-m", "minimd.commands.main", *arguments], env=environment, text=True, **keywords
    )


def answer(*arguments, **keywords):
    process = command(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **keywords)
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def wait_for_frames(process, file):
    """Wait until a running process has written more than one frame; between two flushes the file can be copied and read."""
    deadline = time.monotonic() + 100.0
    while time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.1)
        with contextlib.suppress(OSError, ValueError):
            shutil.copy(file, "copy.h5md")
            if read_file("copy.h5md").n_frames > 1:
                return
    pytest.fail(f"{file} has no frames after 100 s; the process ended with {process.poll()}")


@pytest.mark.parametrize(
    ("option", "told"),
    [("--version", f"minimd {md.__version__}\n"), ("--help", "usage: minimd [-h] [--version] command ...")],
)
def test_version_and_help_are_told_quickly_and_without_loading_anything(option, told):
    code = (
        f"import sys; from minimd.commands.main import main\ntry: main(['{option}'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "heavy = {'ase', 'MDAnalysis', 'matplotlib', 'h5py', 'pydantic', 'tqdm'} & set(sys.modules); assert not heavy, heavy"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
    )
    assert (done.returncode, done.stdout.startswith(told), done.stderr) == (0, True, "")


@pytest.mark.parametrize(
    "name", ["run", "scan", "resume", "check", "plot", "view", "frames", "archive", "bench", "doctor"]
)
def test_each_command_describes_itself_in_a_sentence(name, capsys):
    with pytest.raises(SystemExit):
        cli.main([name, "--help"])
    described = capsys.readouterr().out.split("\n\n")[1]
    assert "." in described
    assert not described.startswith("positional")


def test_without_a_command_there_is_help(capsys):
    assert cli.main([]) == 0
    told = capsys.readouterr().out
    assert all(f"\n    {name} " in told for name in ("run", "resume", "check", "plot", "doctor"))


def test_run_tells_what_it_does_and_what_to_do_next(folder, capsys):
    assert cli.main(["run", "melt.toml"]) == 0
    out, err = capsys.readouterr()
    for words in (
        "A small melt",
        "256 atoms",
        "force-shifted",
        "40 steps = 0.16 τ",
        "verdict",
        "written        melt.h5md",
        "minimd check melt.h5md",
    ):
        assert words in out
    assert err.count("running: step") == 4  # no terminal, so lines: one at each of the four observations


def test_quiet_run_says_nothing(folder):
    code, out, err = answer("run", "melt.toml", "--quiet")
    assert (code, out, err) == (0, "", "")
    assert read_file("melt.h5md").n_frames == 5


def test_steps_and_out_replace_those_of_the_scene(folder):
    assert cli.main(["run", "melt.toml", "--steps", "20", "--out", "other.h5md", "--quiet"]) == 0
    assert read_file("other.h5md").record.step.tolist() == [0, 10, 20]
    assert not Path("melt.h5md").exists()


@pytest.mark.parametrize("steps", ["-1", "2.5", "many"])
def test_steps_must_be_a_number_of_steps(folder, capsys, steps):
    with pytest.raises(SystemExit) as end:
        cli.main(["run", "melt.toml", "--steps", steps])
    assert end.value.code == 2
    assert f"at least 0; it is '{steps}'" in capsys.readouterr().err


def test_existing_output_is_refused_before_anything_is_computed(folder, capsys, monkeypatch):
    Path("melt.h5md").write_text("precious")
    monkeypatch.setattr(md.Simulation, "__init__", lambda *_, **__: pytest.fail("it began to compute"))
    assert cli.main(["run", "melt.toml"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "'melt.h5md' exists" in err
    for words in ("--overwrite", "--out", "minimd resume melt.h5md"):
        assert words in err
    assert Path("melt.h5md").read_text() == "precious"


def test_existing_picture_is_refused_too(folder, capsys):
    Path("melt.toml").write_text(SCENE + 'plot = "melt.png"\n')
    Path("melt.png").write_text("precious")
    assert cli.main(["run", "melt.toml"]) == 2
    assert "'melt.png' exists" in capsys.readouterr().err
    assert not Path("melt.h5md").exists()


def test_out_takes_the_picture_along_and_spares_pictures_that_were_not_named(folder, capsys):
    Path("melt.toml").write_text(SCENE + 'plot = "melt.png"\n')
    for name in ("melt.png", "second.png"):
        Path(name).write_text("precious")
    for name in ("first", "second"):
        assert cli.main(["run", "melt.toml", "--out", f"{name}.h5md"]) == 0
    assert Path("first.png").read_bytes().startswith(b"\x89PNG")
    assert {Path(name).read_text() for name in ("melt.png", "second.png")} == {"precious"}
    told = capsys.readouterr().out
    assert "drawing        first.png" in told
    assert "second.png exists and is kept" in told
    assert cli.main(["run", "melt.toml", "--out", "third.xyz", "--quiet"]) == 0


def test_overwrite_replaces(folder):
    Path("melt.h5md").write_text("worthless")
    assert cli.main(["run", "melt.toml", "--overwrite", "--quiet"]) == 0
    assert read_file("melt.h5md").n_frames == 5


def test_run_draws_the_picture_that_the_scene_asks_for(folder):
    Path("melt.toml").write_text(SCENE + "plot = true\n")
    assert cli.main(["run", "melt.toml", "--quiet"]) == 0
    assert Path("melt.png").read_bytes().startswith(b"\x89PNG")


def test_resumed_run_is_the_uninterrupted_one(folder):
    assert cli.main(["run", "melt.toml", "--quiet", "--steps", "60", "--out", "whole.h5md"]) == 0
    assert cli.main(["run", "melt.toml", "--quiet", "--steps", "30", "--out", "parts.h5md"]) == 0
    assert cli.main(["resume", "parts.h5md", "--quiet", "--steps", "30"]) == 0
    whole, parts = read_file("whole.h5md"), read_file("parts.h5md")
    assert parts.step == whole.step == 60
    assert parts.record.step.tolist() == whole.record.step.tolist()
    assert parts.time == pytest.approx(0.24)
    assert parts.record.total_energy == pytest.approx(
        whole.record.total_energy, rel=1e-13
    )  # rounding: other list, other sums
    assert np.abs(parts.system.positions - whole.system.positions).max() < 1e-12  # rounding, grown over 30 steps
    assert np.abs(parts.system.positions - load_scene("melt.toml").system().positions).max() > 1e-3  # atoms moved


def test_resume_without_steps_goes_on_to_the_end_of_the_scene(folder, capsys):
    Path("melt.toml").write_text(SCENE + 'trajectory = ["melt.h5md", "melt.xyz"]\n')
    assert cli.main(["run", "melt.toml", "--quiet", "--steps", "15"]) == 0
    capsys.readouterr()
    assert cli.main(["resume", "melt.h5md"]) == 0
    assert "only melt.h5md is continued" in capsys.readouterr().out
    assert read_file("melt.h5md").step == 40
    assert cli.main(["resume", "melt.h5md"]) == 2
    assert "it is at step 40, dynamics.steps = 40" in capsys.readouterr().err


def test_interrupted_run_says_how_to_go_on(folder, capsys, monkeypatch):
    from minimd.files.h5md_writer import H5MDWriter

    write = H5MDWriter.write

    def stopping(writer, frame):
        write(writer, frame)
        if frame.step == 20:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(H5MDWriter, "write", stopping)
    assert cli.main(["run", "melt.toml"]) == 130
    assert "resume with: minimd resume melt.h5md --steps 19" in capsys.readouterr().err
    monkeypatch.undo()
    os.chdir(folder)
    assert cli.main(["resume", "melt.h5md", "--steps", "19", "--quiet"]) == 0
    assert read_file("melt.h5md").step == 40


def test_interrupted_equilibration_says_that_nothing_was_written(folder, capsys, monkeypatch):
    Path("melt.toml").write_text(SCENE.replace("[output]", "[equilibration]\nsteps = 40\n[output]"))
    rescale = md.Simulation.rescale_temperature

    def stopping(simulation, temperature):
        rescale(simulation, temperature)
        if simulation.step == 20:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(md.Simulation, "rescale_temperature", stopping)
    assert cli.main(["run", "melt.toml"]) == 130
    assert "of the equilibration; nothing was written" in capsys.readouterr().err
    assert not Path("melt.h5md").exists()


def test_resume_without_a_stored_scene_asks_for_one(folder, capsys):
    from_scene = load_scene("melt.toml").simulation()
    simulation = md.Simulation(from_scene.system, from_scene.potentials, from_scene.method)
    simulation.run(10, every=5, trajectory="bare.h5md")
    assert cli.main(["resume", "bare.h5md", "--steps", "5"]) == 2
    told = capsys.readouterr().err
    assert "'bare.h5md' holds no scene" in told
    assert "minimd.Simulation.resume('bare.h5md', potentials)" in told
    assert cli.main(["resume", "bare.h5md", "--steps", "10", "--scene", "melt.toml", "--quiet"]) == 0
    assert read_file("bare.h5md").step == 20


STRANGE = {
    "escape": "\x1b[31mred",
    "return": "a\rb",
    "bell": "\a",
    "title of a window": "\x9d0;x\x9c",
    "reordered": "\u202egnp",
}


@pytest.mark.parametrize("kind", STRANGE)
def test_texts_of_files_give_no_orders_to_the_terminal(kind, folder, capsys):
    """Titles and names of files are escaped; labels of atoms are refused."""
    name, title = f"a{STRANGE[kind]}.toml", json.dumps(STRANGE[kind])
    Path(name).write_text(f"title = {title}\n{SMOOTH}")
    assert cli.main(["run", name, "--out", f"{name}.h5md"]) == 0
    with h5py.File(f"{name}.h5md", "r+") as h5:
        h5["minimd"].attrs["title"] = STRANGE[kind]
        sign(h5)
    for command in (["check"], ["view"], ["plot"], ["frames", "--at", "1"], ["resume", "--steps", "5"], ["replay"]):
        cli.main([command[0], f"{name}.h5md", *command[1:]])
    cli.main(["check", f"{name}.nowhere"])
    Path(name).write_text(f"{title} = {title}\n{SMOOTH}")
    assert cli.main(["run", name]) == 2
    told = "".join(capsys.readouterr())
    assert repr(STRANGE[kind])[1:-1] in told
    assert all(one.isprintable() or one == "\n" for one in told)
    with pytest.raises(ValueError, match="printable"):
        md.System([[0.0, 0, 0]], species=[STRANGE[kind]])


def test_check_passes_on_a_sound_file_and_fails_on_another(folder, capsys):
    cli.main(["run", "melt.toml", "--quiet"])
    assert cli.main(["check", "melt.h5md"]) == 0
    assert "passed" in capsys.readouterr().out
    import h5py

    with h5py.File("melt.h5md", "r+") as h5:
        h5["particles/trajectory/velocity/value"][2] *= 1.01
    assert cli.main(["check", "melt.h5md"]) == 1
    assert "FAILED" in capsys.readouterr().out


def test_plot_writes_a_picture_and_says_so(folder, capsys):
    cli.main(["run", "melt.toml", "--quiet"])
    assert cli.main(["plot", "melt.h5md"]) == 0
    assert cli.main(["plot", "melt.h5md"]) == 0
    assert cli.main(["plot", "melt.h5md", "--out", "other.png"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "drawing        melt.png ...",
        "written        melt.png",
        "drawing        melt.png ...",
        "replaced       melt.png",
        "drawing        other.png ...",
        "written        other.png",
    ]
    assert Path("other.png").read_bytes().startswith(b"\x89PNG")


def test_blow_up_ends_with_its_own_code_and_keeps_what_was_written(folder, capsys):
    Path("melt.toml").write_text(
        SCENE.replace("timestep = 0.004", "timestep = 0.025")
        .replace("1.44", "50.0")
        .replace("steps = 40", "steps = 4000")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert cli.main(["run", "melt.toml"]) == 3
    err = capsys.readouterr().err
    note, cause, seen = [line for line in err.splitlines() if line.startswith("minimd: ") and "compiling" not in line]
    assert note.startswith("minimd: warning: timestep 0.025 τ is long for Lennard-Jones atoms")
    assert cause.startswith("minimd: error: Likely cause:")
    assert "timestep 0.025 τ too large" in cause
    assert seen.startswith("minimd: error: At step")
    assert "kept in melt.h5md" in seen
    assert "Traceback" not in err
    assert read_file("melt.h5md").n_frames > 0


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_killed_run_can_be_resumed(folder):
    process = command("run", "melt.toml", "--steps", "1000000", "--quiet")
    wait_for_frames(process, "melt.h5md")
    process.kill()
    process.wait(timeout=60)
    contents = read_file("melt.h5md")
    assert contents.n_frames > 1
    assert cli.main(["resume", "melt.h5md", "--steps", "10", "--quiet"]) == 0
    assert read_file("melt.h5md").step == contents.step + 10


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_ends_with_130_and_a_file_that_can_be_resumed(folder):
    process = command("run", "melt.toml", "--steps", "1000000", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait_for_frames(process, "melt.h5md")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "stopped after step" in err
    assert "kept in melt.h5md" in err
    reached = read_file("melt.h5md").step
    assert cli.main(["resume", "melt.h5md", "--steps", "10", "--quiet"]) == 0
    assert read_file("melt.h5md").step == reached + 10
