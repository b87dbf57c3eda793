"""Timing in rounds: engines with the same energies run one after the other, again and again."""

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from minimd.bench.engines import LoadedEngine
from minimd.bench.outcome import threads_text
from minimd.bench.scenes import BenchScene
from minimd.core.compiled.machine import available_cores
from minimd.core.compiled.terminal import tell
from minimd.core.structure.arrays import Array
from minimd.core.structure.errors import HandOverError

# allowed relative difference of energies at step 0: rounding of single precision; GROMACS sums 32 000 atoms to 2e-5
SAME_START = 5e-5
# in mixed precision with charges, whose forces are measured; GROMACS sums 24 000 atoms of water to 2e-4, at order 6
SAME_START_MIXED = 5e-4
ERRORS = 4.0  # of the energy of charges, in those of their forces
# so few that trajectories do not diverge, enough for the potential energy to change by half an ε per atom
STEPS_COMPARED = 10
# k_B T per atom, allowed difference after these steps, in single precision; a time step 1 % longer makes a larger one
SAME_COURSE = 7e-4
# steps or seconds, whichever ends first: melts the lattice, fills caches
WARM_UP = 200
SECONDS_WARM_UP = 5.0
# much longer than the resolution of the clock, much shorter than the minutes in which machines change their speed
SECONDS_A_TURN = 0.5
# least number of steps in a turn, so that it has two new lists, unless they take longer than so many seconds
STEPS_A_TURN = 40
LONGEST_TURN = 5.0


def check_agreement(engines: Sequence[LoadedEngine], scene: BenchScene) -> None:
    """Check that all engines have loaded the same scene and make the same steps; for this they make some steps.
    The total energy alone does not show a wrong time step, because it is conserved. The potential energy of a melting
    crystal does. Differences at the start are taken off afterwards.
    Raises HandOverError if an engine differs from the first."""
    n_atoms = len(scene.system)
    heat = scene.temperature * scene.system.units.k_B

    def compare(quantity: str, energies: Sequence[float], allowed: float) -> None:
        first = energies[0]
        for engine, energy in zip(engines, energies, strict=True):
            if not abs(energy - first) <= allowed:
                raise HandOverError(
                    f"{quantity}: {label(engines[0])} has {first:.8g}, {label(engine)} has {energy:.8g}"
                )

    potential = [engine.potential_energy() for engine in engines]
    is_mixed = scene.error > 0.0 and any(engine.precision == "mixed" for engine in engines)
    same_start = SAME_START_MIXED if is_mixed else SAME_START
    allowed = max(same_start, ERRORS * scene.error) * abs(potential[0])
    compare("potential energy at step 0", potential, allowed)
    for engine in engines:
        engine.run(STEPS_COMPARED)
    when = f"per atom after {STEPS_COMPARED} steps"
    allowed = (SAME_COURSE + scene.scatter) * heat
    offsets = np.array(potential) - potential[0]
    for quantity in ("potential_energy", "total_energy"):
        energies = np.array([getattr(engine, quantity)() for engine in engines])
        after = (energies - offsets) / n_atoms
        compare(f"{quantity.replace('_', ' ')} {when}", after.tolist(), allowed)


def in_turns(engines: Sequence[LoadedEngine], repeats: int, n_atoms: int) -> Array:
    """Steps per second of each engine in each turn, (E, repeats), after a warm-up."""
    return take_turns(engines, warm_up(engines, n_atoms), repeats, n_atoms)


def warm_up(engines: Sequence[LoadedEngine], n_atoms: int) -> list[int]:
    """Run each engine several times, each twice as long as the one before; returns the number of steps in its turns."""
    n_steps = []
    for engine in engines:
        tell(f"{n_atoms} atoms: warming up {label(engine)}")
        started = perf_counter()
        burst = 1
        seconds = timed(engine.run, burst)[1]
        # all bursts so far are 2 burst - 1 steps
        while 2 * burst <= WARM_UP and perf_counter() - started <= SECONDS_WARM_UP:
            burst *= 2
            seconds = timed(engine.run, burst)[1]
        n_steps.append(steps_in_a_turn(seconds / burst))
    return n_steps


def take_turns(
    engines: Sequence[LoadedEngine], n_steps: Sequence[int], repeats: int, n_atoms: int
) -> Array:
    """Steps per second of each engine in each turn, (E, repeats).
    The engines take turns because the speed of a machine drifts: so the drift affects all of them.
    n_steps : (E,), of a turn."""
    speeds = np.empty((len(engines), repeats))
    for turn in range(repeats):
        for k, engine in enumerate(engines):
            speeds[k, turn] = n_steps[k] / timed(engine.run, n_steps[k])[1]
        tell(f"{n_atoms} atoms: turn {turn + 1} of {repeats}")
    return speeds


def steps_in_a_turn(seconds_per_step: float) -> int:
    """The number of steps of a turn: half a second, at least 40 steps, at most 5 seconds, and never less than one."""
    wanted = max(SECONDS_A_TURN / seconds_per_step, STEPS_A_TURN)
    return max(1, int(min(wanted, LONGEST_TURN / seconds_per_step)))


def label(engine: LoadedEngine) -> str:
    """The description of an engine."""
    return f"{engine.name}, {engine.precision}, {threads_text(engine.threads)}"


def thread_numbers(threads: Sequence[int]) -> tuple[int, ...]:
    """Numbers of threads, without repetition; if none are given, one and all cores.
    Raises ValueError for more threads than cores."""
    cores = available_cores()
    most = max(threads, default=1)
    if most > cores:
        raise ValueError(
            f"--threads {most} is more than the {cores} cores that this process may use"
        )
    return tuple(dict.fromkeys(threads or (1, cores)))


def timed(run: Callable[[int], Any], n_steps: int) -> tuple[Any, float]:
    """What a run returns, and its seconds: that number itself, if it is a float, which an engine's own clock gives."""
    started = perf_counter()
    result = run(n_steps)
    seconds = perf_counter() - started
    if isinstance(result, float):
        seconds = result
    return result, seconds
