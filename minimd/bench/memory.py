"""Memory of a simulation per atom, measured in a process of its own."""

import subprocess
import sys
from pathlib import Path

from minimd.bench.engines import Minimd, Precision
from minimd.bench.scenes import SCENES

FROM_ATOMS = 256_000  # fewer would drown in what Python and the kernels need
SMALL = 10  # a first scene of 4000 atoms loads the kernels
STEPS = 20
STATUS = Path("/proc/self/status")  # of Linux; getrusage's peak would be that of the parent process, if that was higher


def bytes_per_atom(scene: str, n: int, threads: int, precision: str) -> float | None:
    """Peak memory of building and running a scene of about 4 n³ atoms, beyond that of one of 4000, per atom more.

    None where the operating system does not tell, or the measurement fails.
    """
    if not STATUS.exists():
        return None
    code = f"from minimd.bench.memory import peak_per_atom; print(peak_per_atom({scene!r}, {n}, {threads}, {precision!r}))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if answer.returncode:
        print(f"memory could not be measured: {(answer.stderr.splitlines() or ['no reason given'])[-1]}", file=sys.stderr)
        return None
    return float(answer.stdout)


def peak_per_atom(scene: str, n: int, threads: int, precision: Precision) -> float:
    """As bytes_per_atom, in this process, which must be a fresh one."""
    (few, before), (many, after) = (_peak(scene, size, threads, precision) for size in (SMALL, n))
    return (after - before) / (many - few)


def _peak(scene: str, n: int, threads: int, precision: Precision) -> tuple[int, float]:
    """Number of atoms, and bytes this process has held at most so far."""
    loaded = SCENES[scene](n)
    Minimd(loaded, threads, precision).run(STEPS)
    peak = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))  # "VmHWM:   178012 kB"
    return len(loaded.system), 1024.0 * float(peak.split()[1])
