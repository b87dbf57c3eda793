"""Memory of a simulation per atom, measured in separate processes."""

import subprocess
import sys
from collections.abc import Callable
from math import nan

from minimd.bench.engines import SKIN_LAMMPS, Minimd, Precision, preload_mpi
from minimd.bench.scenes import CUTOFF, MELT_DENSITY, MELT_TEMPERATURE, SCENES, SEED, TIMESTEP
from minimd.compiled.machine import STATUS, peak_memory

FROM_ATOMS = 256_000  # with fewer atoms, the memory of Python and of the kernels hides that of the atoms
SMALL = 20  # a first scene of 32 000 atoms loads the kernels
STEPS = 120  # enough for the snapshots to which a failed run goes back


def bytes_per_atom(scene: str, n: int, threads: int, precision: str) -> float | None:
    """Growth of minimd's peak memory per additional atom, from a scene of 32 000 atoms to one of about 4 n³;
    both are built and run.

    None if the operating system does not give the peak, or the measurement fails.
    """
    return _in_a_process(f"peak_per_atom(minimd_peak({scene!r}, {threads}, {precision!r}), {n})")


def bytes_per_atom_lammps(n: int) -> float | None:
    """The same for LAMMPS and the melt, built by its own commands; None also if LAMMPS is not installed."""
    return _in_a_process(f"peak_per_atom(lammps_peak, {n})")


def _in_a_process(call: str) -> float | None:
    if not STATUS.exists():
        return None
    code = f"from minimd.bench.memory import lammps_peak, minimd_peak, peak_per_atom; print(); print({call})"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if answer.returncode:
        print(
            f"memory could not be measured: {(answer.stderr.splitlines() or ['no reason given'])[-1]}", file=sys.stderr
        )
        return None
    return float(answer.stdout.splitlines()[-1])


def peak_per_atom(run: Callable[[int], int], n: int) -> float:
    """As bytes_per_atom, in this process, which must be new.  run :
    function of a size that runs it and returns the number of atoms."""
    few, before = run(SMALL), peak_memory() or nan
    many, after = run(n), peak_memory() or nan
    return (after - before) / (many - few)


def minimd_peak(scene: str, threads: int, precision: Precision) -> Callable[[int], int]:
    """A function that builds a scene and runs it in minimd."""

    def run(n: int) -> int:
        loaded = SCENES[scene](n)
        n_atoms, engine = len(loaded.system), Minimd(loaded, threads, precision)
        del loaded  # the simulation has its own copy
        engine.run(STEPS)
        return n_atoms

    return run


def lammps_peak(n: int) -> int:
    """Build the melt with LAMMPS' own commands and run it; returns the number of atoms."""
    preload_mpi()
    from lammps import lammps

    engine = lammps(cmdargs=["-log", "none", "-screen", "none", "-sf", "opt"])
    engine.commands_string(
        f"units lj\nlattice fcc {MELT_DENSITY}\nregion box block 0 {n} 0 {n} 0 {n}\ncreate_box 1 box\ncreate_atoms 1 "
        "box\nmass 1 1.0\n"
        f"velocity all create {MELT_TEMPERATURE} {SEED}\npair_style lj/cut {CUTOFF}\npair_coeff 1 1 1.0 1.0 "
        f"{CUTOFF}\nneighbor {SKIN_LAMMPS} bin\n"
        f"neigh_modify delay 0 every 20 check no\nfix 1 all nve\ntimestep {TIMESTEP}\nrun {STEPS}"
    )
    return int(engine.get_natoms())
