"""Signals with manners: who else has a say, where a run ends, and the one sentence of the command, wherever it is."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import pytest
from h5md_runs import assert_same_file, at_step, simulation
from scene_texts import SMOOTH

from minimd.commands import main as cli
from minimd.core.console.signals import SIGNALS, Terminated, endings_are_told, stop_on_signals
from minimd.core.files.h5md_reader import read_file

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
REPOSITORY = Path(__file__).parents[2]
END = 3000
SCENE = SMOOTH.replace("steps = 40", f"steps = {END}")
READY = """
import os, sys, minimd_command
class Loading:  # NumPy and the like: the first lines of minimd are behind it
    def find_spec(self, *_): os.write(1, b"!"), sys.meta_path.remove(self)
sys.meta_path.insert(0, Loading())
minimd_command.main()
"""
PROGRESS = ("running: step", "minimd: compiling kernels")
ENDINGS = [number for number in SIGNALS if number != signal.SIGINT]
EACH = pytest.mark.parametrize("number", SIGNALS)


class Run:
    stop_requested = True  # what is looked at between the steps


def ending_of(number, words="stopped after the last step"):
    return pytest.raises(KeyboardInterrupt if number == signal.SIGINT else Terminated, match=words)


@pytest.fixture(autouse=True)
def handlers():
    """Every test starts with those that Python has, and leaves those that were there."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@EACH
def test_handlers_of_the_host_are_left_alone_and_ignored_signals_stay_ignored(number):
    heard = []
    for handler in (lambda *_: heard.append(number), signal.SIG_IGN):
        signal.signal(number, handler)
        with stop_on_signals(run := Run()):
            signal.raise_signal(number)
            assert not run.stop_requested
        assert (heard, signal.getsignal(number)) == ([number], handler)


@EACH
def test_handlers_are_back_after_a_run_except_those_set_meanwhile_and_nothing_is_requested(number):
    before, run = [signal.getsignal(one) for one in SIGNALS], Run()
    with ending_of(number) as caught, stop_on_signals(run):
        signal.raise_signal(number)
        assert run.stop_requested
        if number != signal.SIGINT:
            signal.raise_signal(number)  # a terminal that hangs up twice does not cut the step
    assert [signal.getsignal(one) for one in SIGNALS] == before
    assert not run.stop_requested
    assert number == signal.SIGINT or caught.value.code == 128 + number
    with stop_on_signals(run):
        signal.signal(number, own := lambda *_: None)
    assert signal.getsignal(number) is own


def test_a_second_ctrl_c_does_not_wait():
    reached = []
    with pytest.raises(KeyboardInterrupt), stop_on_signals(Run()):
        reached += [signal.raise_signal(signal.SIGINT) for _ in range(3)]
    assert not reached


def test_outside_the_main_thread_no_handler_is_touched():
    handlers = lambda: [signal.getsignal(one) for one in SIGNALS]  # noqa: E731

    def work():
        with stop_on_signals(Run()):
            return handlers()

    with ThreadPoolExecutor() as pool:
        assert pool.submit(work).result() == handlers()


def raising(number, step):
    return [at_step(step, lambda: signal.raise_signal(number))]


@pytest.mark.parametrize("number", ENDINGS)
def test_a_script_that_is_terminated_says_at_which_step_and_what_is_kept(number, tmp_path, capsys):
    path, told = tmp_path / "a.h5md", f"by {signal.Signals(number).name}"
    inner = [lambda _: simulation().run(100, every=10, observers=raising(number, 30))]
    for options, silent, step in (
        ({"trajectory": path, "observers": raising(number, 20)}, False, 21),
        ({"observers": inner}, False, 31),  # both runs stop, and one sentence is enough
        ({"observers": inner}, True, 31),
    ):
        with ending_of(number, "step"), endings_are_told() if silent else nullcontext():
            simulation().run(100, every=10, **options)
        said = capsys.readouterr().err
        assert (said.count("\n"), f"step {step} {told}" in said) == (not silent, not silent)
        assert (f" {path}; " in said, "append" in said) == ("trajectory" in options,) * 2


def test_after_ctrl_c_a_script_is_told_its_files_and_how_to_go_on_and_a_command_is_not(tmp_path):
    for name, silent, known in (("a.h5md", False, "append"), ("b.xyz", False, "b.xyz"), ("c.h5md", True, "step 21")):
        with ending_of(signal.SIGINT, known) as caught, endings_are_told() if silent else nullcontext():
            simulation().run(100, every=10, trajectory=tmp_path / name, observers=raising(signal.SIGINT, 20))
        assert (name in str(caught.value), "resume" in str(caught.value)) == (not silent, name == "a.h5md")


def command(*arguments, **environment):
    """The command, at its first lines."""
    where = os.environ | {"PYTHONPATH": str(REPOSITORY)} | environment
    told = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    as_usual = lambda: [signal.signal(number, signal.SIG_DFL) for number in SIGNALS]  # noqa: E731
    process = subprocess.Popen([sys.executable, "-c", READY, *arguments], env=where, preexec_fn=as_usual, **told)
    assert process.stdout.read(1) == b"!"
    return process


def sentences(process, most=1):
    """What a process says on standard error, beside how far it is; and its exit code."""
    _, errors = process.communicate(timeout=300)
    told = [line for line in errors.decode().splitlines() if not line.startswith(PROGRESS)]
    assert len(told) <= most, errors.decode()
    assert all(line.startswith(("minimd: error: ", "minimd: stopped ")) for line in told), told
    return told, process.returncode


def test_a_signal_during_imports_ends_the_command_in_one_sentence():
    for number, process in [(number, command("--help")) for number in SIGNALS]:
        process.send_signal(number)
        told, code = sentences(process)
        assert (len(told), code) == (1, 128 + number)


def stopped(number, seconds, **environment):
    """The exit code of a run that gets a signal after so many seconds; what it has written goes on to the same bits."""
    shutil.rmtree("out", ignore_errors=True)
    Path("out").mkdir()
    process = command("run", "melt.toml", "--out", "out/melt.h5md", **environment)
    time.sleep(seconds)
    process.send_signal(number)
    told, code = sentences(process)
    ended = -number if number == signal.SIGKILL else 128 + number
    assert (code in (0, ended), len(told)) == (True, code > 0), told
    if Path("out/melt.h5md").exists():
        if read_file("out/melt.h5md").step < END:
            assert all("kept in out/melt.h5md" in one and "minimd resume out/melt.h5md" in one for one in told)
            assert cli.main(["resume", "out/melt.h5md", "--quiet"]) == 0
        assert_same_file("out/melt.h5md", "whole.h5md")
    return code


@pytest.mark.slow
@pytest.mark.parametrize("number", [*SIGNALS, signal.SIGKILL])
def test_signals_at_thirty_moments_of_a_run(number, folder, tmp_path):
    """Ten of them while kernels are compiled, into a cache that the next run goes on with."""
    draw, cold = random.Random(number), {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for _ in range(2):  # the first one compiles
        started = time.monotonic()
        assert sentences(command("run", "melt.toml", "--out", "whole.h5md", "--overwrite")) == ([], 0)
        duration = time.monotonic() - started
    codes = [stopped(number, 8.0 * draw.random() ** 2, **cold) for _ in range(10)]
    assert sentences(command("run", "melt.toml", "--out", "cold.h5md", **cold)) == ([], 0)
    assert_same_file("cold.h5md", "whole.h5md")  # what was left in the cache is sound
    codes += [stopped(number, (k + draw.random()) / 20 * duration) for k in range(20)]
    assert len(codes) - codes.count(0) > 10


def test_a_limit_on_the_wall_time_is_a_normal_end_that_can_be_resumed(tmp_path, capfd):
    sim, whole, path = simulation(), simulation(), tmp_path / "a.h5md"
    began = time.monotonic()
    record = sim.run(10**8, trajectory=path, max_seconds=0.5, progress=False)
    assert time.monotonic() - began < 20.0
    assert 0 < sim.step < 10**8
    assert "max_seconds = 0.5" in (said := capfd.readouterr().err)
    assert "append=True" in said
    assert read_file(path).step == sim.step >= record.step[-1]
    end = sim.step + 20
    sim.run(until_step=end, trajectory=path, append=True, progress=False)  # nothing is left of the limit
    whole.run(end, trajectory=tmp_path / "b.h5md", progress=False)
    assert (sim.positions == whole.positions).all()


def test_the_command_ends_in_time_and_says_how_to_go_on(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scene = SMOOTH.replace("steps = 40", "steps = 100_000_000")
    Path("a.toml").write_text(scene)
    assert cli.main(["run", "a.toml", "--out", "a.h5md", "--max-seconds", "0.5"]) == cli.UNFINISHED
    said = capsys.readouterr()
    assert "resume with: minimd resume a.h5md --steps" in said.out
    assert "max_seconds = 0.5" in said.err
    Path("b.toml").write_text(scene.replace("steps = 100_000_000", "steps = 100_000_000\nmax_seconds = 0.5"))
    assert cli.main(["run", "b.toml", "--out", "b.h5md", "--quiet"]) == cli.UNFINISHED
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n"), "max_seconds = 0.5" in said.err) == ("", 1, True)
    assert cli.main(["resume", "b.h5md", "--steps", "5", "--max-seconds", "60", "--quiet"]) == 0
    assert cli.main(["run", "b.toml", "--out", "c.h5md", "--max-seconds", "-1", "--quiet"]) == 2
