"""The machine and what is installed on it: cores, processor, versions, rounding of numbers, vectors.

MINIMD_VECTORS leaves out the processor's features of newer vectors, to compare or test.
"""

import functools
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from importlib import metadata
from pathlib import Path

import llvmlite.binding as llvm
import numba
import numpy as np

EPS = float(np.finfo(float).eps)  # of 1: the relative spacing of numbers
MISSING = "MISSING"
# of Linux, where the peak of getrusage can be that of the parent process
STATUS = Path("/proc/self/status")
_threads: ContextVar[int | None] = ContextVar("_threads", default=None)


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def default_threads() -> int:
    """Threads of a simulation that does not say how many: one for each core, or what threads_by_default says."""
    return _threads.get() or available_cores()


@contextmanager
def threads_by_default(n_threads: int) -> Iterator[None]:
    """Context in which simulations have this number of threads, unless they say otherwise."""
    before = _threads.set(n_threads)
    try:
        yield
    finally:
        _threads.reset(before)


@functools.cache
def version(package: str) -> str:
    """Installed version of a package, or MISSING."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return MISSING


def processor_name() -> str:
    """What the processor calls itself, or its family."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def peak_memory() -> int | None:
    """Bytes of memory that this process has held at most so far; None where the system does not tell, as on Windows."""
    with suppress(OSError):
        for line in STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):  # "VmHWM:   178012 kB"
                return 1024 * int(line.split()[1])
    if platform.system() != "Darwin":
        return None
    from resource import RUSAGE_SELF, getrusage  # which Windows does not have

    return getrusage(RUSAGE_SELF).ru_maxrss  # in bytes there


NEWEST = "avx512"
# beginnings of names of the features that each choice does without
WIDER = {
    NEWEST: (),
    "avx2": ("avx512", "avx10"),
    "sse": ("avx", "fma", "f16c", "vaes", "vpclmulqdq", "xop"),
}
EXACT = "sse-exact"  # the same, but with the bits of newer ones
WIDER[EXACT] = WIDER["sse"]


def chosen_vectors() -> str:
    """What MINIMD_VECTORS says, or the newest."""
    return os.environ.get("MINIMD_VECTORS", NEWEST)


def rounds_once() -> bool:
    """Whether kernels round a · b + c once: by an instruction that the processor has; with EXACT by a function of the C
    library, which takes many times as long."""
    features = llvm.get_host_cpu_features()
    is_there = features.get("fma", platform.machine() not in ("x86_64", "AMD64"))
    return chosen_vectors() == EXACT or (is_there and chosen_vectors() != "sse")


def restrict_features(choice: str) -> None:
    """Let Numba compile for the vectors of an older processor, see WIDER; only before anything is compiled.
    Raises ValueError for another word."""
    if choice not in WIDER:
        raise ValueError(f"MINIMD_VECTORS must be one of {', '.join(WIDER)}; it is {choice!r}")
    if WIDER[choice]:
        features = []
        for name, is_there in llvm.get_host_cpu_features().items():
            is_used = is_there and not name.startswith(WIDER[choice])
            features.append(f"{'+' if is_used else '-'}{name}")
        numba.config.CPU_FEATURES = ",".join(features)  # type: ignore[attr-defined]
