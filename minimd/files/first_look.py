"""A first look at a file, in a child process: on damaged bytes HDF5 may crash, or never end,
and its process with it."""

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

from minimd.console.quiet import quiet

Found = TypeVar("Found")

PR_SET_PDEATHSIG = 1  # of linux/prctl.h
SECONDS, BYTES_PER_SECOND = 10, 10_000_000  # of processor time that a look may take; reading needs a hundredth of it
# bytes that a look may take, and besides so many times those of the file: texts of a file may claim the same bytes
MEMORY, SIZES = 2**32, 4


def looked_at(path: str | Path, look: Callable[[], Found]) -> Found:
    """Return or raise what look() does; it is called in a child process if the system can fork, else in this one.

    Raises OSError if the child crashes, or takes more time or memory than reading could take.
    """
    if not hasattr(os, "fork"):
        return look()
    parent, (listening, telling) = os.getpid(), os.pipe()
    try:
        with quiet():  # Python warns of forks with threads; h5py holds its lock in a fork
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
        try:
            status = os.waitpid(child, 0)[1]
        except ChildProcessError:  # not known, because this process ignores the ends of its children
            status = 0
    if status or not answer:
        raise OSError(f"file {str(path)!r} is damaged: HDF5 crashes on it; copy it again, or run again")
    found, error = pickle.loads(answer)
    if error is not None:
        raise error
    return found


def _tell(parent: int, pipe: int, path: str | Path, look: Callable[[], Any]) -> NoReturn:
    """In the child: call look, send its result or error, and end without any output, whatever happens."""
    status = 1
    try:
        end_with(parent)
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        _limit(os.path.getsize(path) if os.path.exists(path) else 0)
        answer: tuple[Any, Exception | None]
        try:
            answer = look(), None
        except MemoryError:
            much = f"to read it takes more memory than {MEMORY / 1e9:.2g} GB"
            answer = None, OSError(f"file {str(path)!r} is damaged: {much}; copy it, or run, again")
        except Exception as error:
            answer = None, error
        with open(pipe, "wb") as told:
            pickle.dump(answer, told)
        status = 0
    finally:
        os._exit(status)


def end_with(parent: int, number: int = signal.SIGKILL) -> None:
    """On Linux, let this process get the signal when its parent dies:
    otherwise the locks of the parent would live on in it."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(number))
        if os.getppid() != parent:
            os._exit(1)


def _limit(n_bytes: int) -> None:
    """Limit processor time and memory of this process to what a file of n_bytes may take,
    and let it leave no core file."""
    import resource  # a system without fork does not have this module

    limits = {resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: SECONDS + n_bytes // BYTES_PER_SECOND}
    with suppress(OSError):  # not every system tells how much memory a process has
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        limits[resource.RLIMIT_AS] = pages * resource.getpagesize() + MEMORY + SIZES * n_bytes
    for which, limit in limits.items():
        hard = resource.getrlimit(which)[1]
        resource.setrlimit(which, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
