"""Memory of a simulation per atom, measured in separate processes."""

import subprocess
import sys
from math import nan

from minimd.compiled.machine import STATUS, peak_memory
from minimd_bench.engines import Minimd
from minimd_bench.scenes import SCENES

FROM_ATOMS = 256_000  # with fewer atoms, the memory of Python and of the kernels hides that of the atoms
SMALL = 20  # a first scene of 32 000 atoms loads the kernels
STEPS = 120  # enough for the snapshots to which a failed run goes back


def bytes_per_atom(scene: str, n: int, threads: int) -> float | None:
    """Growth of minimd's peak memory per additional atom, from a scene of 32 000 atoms to one of about 4 n³;
    both are built and run.

    None if the operating system does not give the peak, or the measurement fails.
    """
    if not STATUS.exists():
        return None
    call = f"growth({scene!r}, {n}, {threads})"
    code = f"from minimd_bench.memory import growth; print(); print({call})"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if answer.returncode:
        print(
            f"memory could not be measured: {(answer.stderr.splitlines() or ['no reason given'])[-1]}", file=sys.stderr
        )
        return None
    return float(answer.stdout.splitlines()[-1])


def growth(scene: str, n: int, threads: int) -> float:
    """As bytes_per_atom, in this process, which must be new."""
    few, before = _run(scene, SMALL, threads), peak_memory() or nan
    many, after = _run(scene, n, threads), peak_memory() or nan
    return (after - before) / (many - few)


def _run(scene: str, n: int, threads: int) -> int:
    """Build a scene and run it; returns the number of its atoms."""
    loaded = SCENES[scene](n)
    n_atoms, engine = len(loaded.system), Minimd(loaded, threads)
    del loaded  # the simulation has its own copy
    engine.run(STEPS)
    return n_atoms
