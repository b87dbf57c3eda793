"""Signals with manners: who else has a say, where a run ends, and that the command ends in one sentence wherever it is."""

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

import pytest
from references import liquid
from scene_texts import SMOOTH
from test_kills import assert_same_file

import minimd as md
from minimd.files.h5md_reader import read_file
from minimd.structure.console import SIGNALS, Terminated, endings_are_told, stop_on_signals

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

REPOSITORY = Path(__file__).parent.parent
SCENE = SMOOTH.replace("steps = 40", "steps = 3000")
READY = """
import os, sys, minimd_command
class Loading:  # NumPy and the like: the first lines of minimd are behind it
    def find_spec(self, *_): os.write(1, b"!"), sys.meta_path.remove(self)
sys.meta_path.insert(0, Loading())
minimd_command.main()
"""
PROGRESS = ("running: step", "minimd: compiling kernels")
END = 3000
LOADING = 1.0  # s, about


class Run:
    """What looks at a flag between its steps."""

    stop_requested = True


def endings(received, words="stopped after the last step"):
    return {signal.SIGINT: pytest.raises(KeyboardInterrupt, match=words)}.get(
        received, pytest.raises(Terminated, match=words)
    )


@pytest.fixture(autouse=True)
def handlers():
    """Every test starts with those that Python has, and leaves those that were there."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def simulation():
    made = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.8), md.VelocityVerlet(0.002), threads=1)
    made.set_temperature(1.0, seed=1)
    return made


@pytest.mark.parametrize("number", SIGNALS)
def test_a_handler_of_the_host_is_left_alone(number):
    heard, run = [], Run()
    signal.signal(number, lambda *_: heard.append(number))
    with stop_on_signals(run):
        signal.raise_signal(number)
        assert heard == [number]
        assert not run.stop_requested


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_that_the_host_ignores_stays_ignored(number):
    signal.signal(number, signal.SIG_IGN)
    with stop_on_signals(run := Run()):
        signal.raise_signal(number)
        assert not run.stop_requested
    assert signal.getsignal(number) is signal.SIG_IGN


@pytest.mark.parametrize("number", SIGNALS)
def test_a_handler_set_during_the_run_stays(number):
    def own(*_):
        pass

    with stop_on_signals(Run()):
        signal.signal(number, own)
    assert signal.getsignal(number) is own


@pytest.mark.parametrize("number", SIGNALS)
def test_the_handlers_are_back_after_a_run_and_nothing_is_requested(number):
    before, run = [signal.getsignal(one) for one in SIGNALS], Run()
    with endings(number), stop_on_signals(run):
        signal.raise_signal(number)
        assert run.stop_requested
    assert [signal.getsignal(one) for one in SIGNALS] == before
    assert not run.stop_requested


@pytest.mark.parametrize("number", [one for one in SIGNALS if one != signal.SIGINT])
def test_a_terminal_that_hangs_up_twice_does_not_cut_the_step(number):
    with endings(number) as caught, stop_on_signals(Run()):
        signal.raise_signal(number)
        signal.raise_signal(number)
    assert caught.value.code == 128 + number


def test_a_second_ctrl_c_does_not_wait():
    reached = []
    with pytest.raises(KeyboardInterrupt), stop_on_signals(Run()):
        reached += [signal.raise_signal(signal.SIGINT) for _ in range(3)]
    assert not reached


def test_outside_the_main_thread_no_handler_is_touched():
    before, during = [signal.getsignal(one) for one in SIGNALS], []

    def work():
        with stop_on_signals(Run()):
            during.extend(signal.getsignal(one) for one in SIGNALS)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert during == before


@pytest.mark.parametrize("number", [one for one in SIGNALS if one != signal.SIGINT])
def test_a_script_that_is_terminated_says_at_which_step_and_what_is_kept(number, tmp_path, capsys):
    def inner(_sim):
        simulation().run(100, every=10, observers=[lambda one: signal.raise_signal(number) if one.step == 30 else None])

    with endings(number, "stopped after step"):
        simulation().run(
            100,
            every=10,
            trajectory=tmp_path / "a.h5md",
            observers=[lambda sim: signal.raise_signal(number) if sim.step == 20 else None],
        )
    told = f"by {signal.Signals(number).name}"
    assert (
        capsys.readouterr().err
        == f"minimd: stopped after step 21 {told}; what was written is kept in {tmp_path / 'a.h5md'}\n"
    )
    with endings(number, "stopped after step"):
        simulation().run(100, every=10, observers=[inner])  # both runs stop, and one sentence is enough
    assert capsys.readouterr().err == f"minimd: stopped after step 31 {told}\n"
    with endings(number, "stopped after step"), endings_are_told():
        simulation().run(100, every=10, observers=[inner])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("number", SIGNALS)
def test_a_run_inside_a_run_stops_and_so_does_the_other(number):
    outer, inner = simulation(), simulation()

    def nested(sim):
        if sim.step == 20:
            inner.run(
                100_000, every=10, observers=[lambda one: signal.raise_signal(number) if one.step == 30 else None]
            )

    with endings(number, "stopped after step"):
        outer.run(100_000, every=10, observers=[nested])
    assert (outer.step, inner.step) == (20, 31)


def test_after_a_stopped_run_steps_can_be_made():
    stopped = simulation()
    with pytest.raises(KeyboardInterrupt):
        stopped.run(
            1000, every=10, observers=[lambda sim: signal.raise_signal(signal.SIGINT) if sim.step == 20 else None]
        )
    stopped.make_steps(10)
    assert stopped.step == 31


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty current folder with the scene in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "melt.toml").write_text(SCENE)
    return tmp_path


def command(*arguments, handler=signal.SIG_DFL, **keywords):
    """The command, at its first lines.  handler : of all signals, as it finds them."""
    streams = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "preexec_fn": lambda: [signal.signal(number, handler) for number in SIGNALS],
    }
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)} | keywords.pop("env", {})
    process = subprocess.Popen([sys.executable, "-c", READY, *arguments], env=environment, **streams, **keywords)
    assert process.stdout.read(1) == b"!"
    return process


def sentences(process, most=1):
    """What a process says on standard error, beside how far it is."""
    _, errors = process.communicate(timeout=120)
    told = [line for line in errors.decode().splitlines() if not line.startswith(PROGRESS)]
    assert len(told) <= most, errors.decode()
    assert all(line.startswith("minimd: error: ") for line in told), told
    return told


def interrupted_after(seconds, **keywords):
    """The exit code of a run that gets SIGINT after so many seconds, and a new place for its file."""
    shutil.rmtree("out", ignore_errors=True)
    Path("out").mkdir()
    process = command("run", "melt.toml", "--out", "out/melt.h5md", **keywords)
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    told = sentences(process)
    assert process.returncode in (0, 130), told
    assert len(told) == (process.returncode == 130)
    return process.returncode


def begun(file):
    """A run that has begun to write its file."""
    process = command("run", "melt.toml", "--out", file)
    while not Path(file).exists():
        assert process.poll() is None
        time.sleep(0.002)
    return process


def seconds_of_a_run():
    """From its first lines to its end, and of these while it writes whole.h5md; a shorter run before it compiles."""
    assert sentences(command("run", "melt.toml", "--steps", "200", "--out", "first.h5md")) == []
    started = time.monotonic()
    process = begun("whole.h5md")
    has_begun = time.monotonic()
    assert sentences(process) == []
    assert process.returncode == 0
    return time.monotonic() - started, time.monotonic() - has_begun


def assert_stopped_run_goes_on(number, seconds):
    """A signal so many seconds after the run has begun to write; whether it came before the end."""
    shutil.rmtree("out", ignore_errors=True)
    Path("out").mkdir()
    process = begun("out/melt.h5md")
    time.sleep(seconds)
    process.send_signal(number)
    told, step = sentences(process), read_file("out/melt.h5md").step
    if not any("kept in" in one for one in told):
        assert (process.returncode in (0, 128 + number), step) == (True, END)  # the run was over
        return False
    assert "kept in out/melt.h5md" in told[0]
    assert ("minimd resume out/melt.h5md" in told[0]) == (step < END)
    if step < END:
        resumed = command("resume", "out/melt.h5md", "--quiet")
        assert sentences(resumed) == []
        assert resumed.returncode == 0
    assert_same_file("out/melt.h5md", "whole.h5md")
    return True


def test_ctrl_c_at_some_moments_ends_the_command_in_one_sentence(folder):
    for k in range(2):
        interrupted_after((0.1 + k) * LOADING)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_during_imports_ends_the_command_in_one_sentence(number):
    process = command("--help")
    process.send_signal(number)
    assert len(sentences(process)) == 1
    assert process.returncode == 128 + number


def test_a_run_that_is_terminated_goes_on_to_the_same_bits(folder):
    _, writing = seconds_of_a_run()
    assert_stopped_run_goes_on(signal.SIGTERM, 0.2 * writing)  # SIGHUP is among the slow tests


def test_the_command_begins_with_its_own_module():
    """That of a module in the package would load NumPy and Numba before its first line."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    assert project["project"]["scripts"] == {"minimd": "minimd_command:main"}
    assert "minimd_command" in project["tool"]["setuptools"]["py-modules"]
    code = "import sys, minimd_command; assert not {'numpy', 'numba', 'minimd'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": str(REPOSITORY)})


def test_a_command_that_was_started_deaf_to_signals_stays_so(folder):
    """As nohup does, and shells with what goes on in the background."""
    process = command("run", "melt.toml", "--steps", "10", handler=signal.SIG_IGN)
    for number in SIGNALS:
        process.send_signal(number)
    assert sentences(process) == []
    assert process.returncode == 0


@pytest.mark.parametrize(("arguments", "code"), [(("--help",), 2), (("run", "hot.toml"), 3)])
def test_a_reader_that_is_gone_is_told_of_in_one_sentence(arguments, code, folder):
    Path("hot.toml").write_text(SCENE.replace("timestep = 0.004", "timestep = 0.018").replace("1.44", "200.0"))
    process = command(*arguments, env={"PYTHONUNBUFFERED": ""})
    process.stdout.close()
    process.stdout = None
    n_lines = 2 if code == 3 else 1  # of a blow-up the cause, and what was seen
    assert len(sentences(process, n_lines)) == n_lines
    assert process.returncode == code


@pytest.mark.slow
def test_ctrl_c_at_a_hundred_moments(folder, tmp_path):
    """Half of them while the kernels are compiled, into a cache that the next run goes on with; half of them with all kernels compiled."""
    draw, codes, cold = random.Random(1), {0: 0, 130: 0}, {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for _ in range(50):
        codes[interrupted_after(8.0 * draw.random() ** 2, env=cold)] += 1
    process = command("run", "melt.toml", "--out", "cold.h5md", env=cold)
    assert sentences(process) == []
    duration, _ = seconds_of_a_run()
    assert_same_file("cold.h5md", "whole.h5md")  # what the kills left in the cache is sound
    for k in range(50):
        codes[interrupted_after((k + draw.random()) / 50 * duration)] += 1
    print(f"codes: {codes}")
    assert codes[130] > 50


@pytest.mark.slow
@pytest.mark.parametrize("number", [one for one in SIGNALS if one != signal.SIGINT])
def test_termination_at_thirty_moments_of_a_run(number, folder):
    draw, n_early, n_late, (_, writing) = random.Random(number), 0, 0, seconds_of_a_run()
    while n_early < 30:
        is_early = assert_stopped_run_goes_on(number, draw.random() * writing)
        n_early, n_late = n_early + is_early, n_late + (not is_early)
        assert n_late < 30
    print(f"{n_early} moments in the run, {n_late} after its end")


@pytest.mark.slow
def test_a_cache_survives_kills_while_kernels_are_compiled(folder, tmp_path):
    draw, cold = random.Random(2), {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for _ in range(20):
        process = command("run", "melt.toml", "--out", "killed.h5md", "--overwrite", env=cold)
        time.sleep(LOADING + 4.0 * draw.random())
        process.kill()
        process.communicate()
    for name, environment in (("cold.h5md", cold), ("warm.h5md", {})):
        process = command("run", "melt.toml", "--out", name, env=environment)
        assert sentences(process) == []
    assert_same_file("cold.h5md", "warm.h5md")
