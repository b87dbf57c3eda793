"""The machine and what is installed on it: cores, processor, versions, the rounding of its numbers."""

import os
import platform
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import numpy as np

EPS = float(np.finfo(float).eps)  # of 1: the relative spacing of numbers
MISSING = "MISSING"


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
