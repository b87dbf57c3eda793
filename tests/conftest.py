"""The scenes as fixtures; Hypothesis draws the same ones in every run, without a deadline: the first call compiles.

Signals are not ignored, as behind nohup. BLAS has one thread, in the workers and in the processes that tests start:
matrices here are small, and its threads would spend a third of the time waiting for each other on shared cores.
What is imported without bytecode leaves it behind, for the next process."""

import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before anybody imports numpy

import pytest
from hypothesis import settings
from scenes import SCENES
from slow_cases import quick_cases

from minimd.commands import main as cli

ALL_CASES = "MINIMD_ALL_CASES"  # a variable of the environment: mutants are tried with all

settings.register_profile("minimd", deadline=None, derandomize=True, max_examples=100)
settings.load_profile("minimd")
signal.signal(signal.SIGINT, signal.default_int_handler)  # minimd leaves ignored signals alone, and tests raise them
signal.signal(signal.SIGHUP, signal.SIG_DFL)
for _name, _scene in SCENES.items():
    globals()[_name] = pytest.fixture(_scene, name=_name)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark as slow what would make the suite take more than five minutes, see data/slow_tests.txt."""
    left = dict(quick_cases())
    for item in items:
        name = f"{item.path.relative_to(Path(__file__).parent).as_posix()}::{item.originalname}"
        if name in left and not item.get_closest_marker("slow"):
            left[name] -= 1
            if left[name] < 0 and ALL_CASES not in os.environ:
                item.add_marker(pytest.mark.slow)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder, in which the test runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def folder(here, request):
    """That folder with the scene of the test's module, SCENE, as melt.toml in it."""
    (here / "melt.toml").write_text(request.module.SCENE)
    return here


@pytest.fixture
def install(monkeypatch):
    """A function that gives the program a command as if its package were installed: a Command, or what raises."""

    def installing(name, load):
        entry_point = SimpleNamespace(name=name, value=f"{name}:COMMAND", load=load)
        monkeypatch.setattr(cli, "entry_points", lambda group: [entry_point])

    return installing


@pytest.fixture
def told(capsys):
    """A function that runs a command, which ends with a code, and returns what it prints; of an error, what it says."""

    def telling(*arguments, code=0):
        capsys.readouterr()
        assert cli.main([*map(str, arguments)]) == code
        return capsys.readouterr()[code > 1]

    return telling
