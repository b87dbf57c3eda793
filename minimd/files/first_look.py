"""A first look at a file, in a child process: on damaged bytes HDF5 may crash, or never come to an end, and take its process along."""

import ctypes
import faulthandler
import os
import pickle
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from minimd.structure.quiet import quiet

Found = TypeVar("Found")

PR_SET_PDEATHSIG = 1  # of linux/prctl.h
SECONDS, BYTES_PER_SECOND = 10, 10_000_000  # of processor time that a look may take; reading takes a hundredth of it


def looked_at(path: str | Path, look: Callable[[], Found]) -> Found:
    """What a look at a file finds, or raises; made in a child process where the system can fork, else in this one.

    Raises OSError if the child crashes, or computes for longer than reading can take.
    """
    if not hasattr(os, "fork"):
        return look()
    parent, (listening, telling) = os.getpid(), os.pipe()
    try:
        with quiet():  # Python warns of threads: h5py holds its lock in a fork
            child = os.fork()
    except OSError:
        os.close(listening)
        os.close(telling)
        raise
    if child == 0:
        _tell(parent, telling, path, look)
    os.close(telling)
    try:
        with open(listening, "rb") as pipe:
            answer = pipe.read()
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        status = _status_of(child)
    if status or not answer:
        raise OSError(f"file {str(path)!r} is damaged: HDF5 crashes on it; copy it again, or run again")
    found, error = pickle.loads(answer)
    if error is not None:
        raise error
    return found


def _status_of(child: int) -> int:
    """How a child has ended; 0 where nobody can know, because the process was told to ignore the ends of its children."""
    try:
        return os.waitpid(child, 0)[1]
    except ChildProcessError:
        return 0


def _tell(parent: int, pipe: int, path: str | Path, look: Callable[[], Any]) -> NoReturn:
    """In the child: look, tell what was found or raised, and end without a word, whatever happens."""
    status = 1
    try:
        end_with(parent)
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        _limit(SECONDS + (os.path.getsize(path) // BYTES_PER_SECOND if os.path.exists(path) else 0))
        answer: tuple[Any, Exception | None]
        try:
            answer = look(), None
        except Exception as error:
            answer = None, error
        with open(pipe, "wb") as told:
            pickle.dump(answer, told)
        status = 0
    finally:
        os._exit(status)


def end_with(parent: int, number: int = signal.SIGKILL) -> None:
    """On Linux, get this signal when the parent dies: the locks that it held would live on in its child."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(number))
        if os.getppid() != parent:
            os._exit(1)


def _limit(seconds: int) -> None:
    """Let this process compute for so long, and leave no core file."""
    import resource  # where there is no fork, there is no such module

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (seconds if hard == resource.RLIM_INFINITY else min(seconds, hard), hard))
