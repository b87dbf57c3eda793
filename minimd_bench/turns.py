"""Timing in rounds: engines with the same energies run one after the other, again and again."""

from collections.abc import Sequence
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from minimd.structure.errors import HandOverError
from minimd_bench.engines import TimedEngine
from minimd_bench.outcome import tell, threads_text

# allowed relative difference of energies at step 0: rounding of single precision; GROMACS sums 32 000 atoms to 2e-5
SAME_START = 5e-5
# so few that trajectories do not diverge, enough for the potential energy to change by half an ε per atom
STEPS_COMPARED = 10
# ε per atom, allowed difference after these steps, in single precision; a time step 1 % longer makes a larger one
SAME_COURSE = 1e-3
WARM_UP, SECONDS_WARM_UP = 200, 5.0  # steps or seconds, whichever ends first: melts the lattice, fills caches
# much longer than the resolution of the clock, much shorter than the minutes in which machines change their speed
SECONDS_A_TURN = 0.5
# least number of steps in a turn, so that it has two new lists, unless they take longer than so many seconds
STEPS_A_TURN, LONGEST_TURN = 40, 5.0


def check_agreement(engines: Sequence[TimedEngine], n_atoms: int, scatter: float = 0.0) -> None:
    """Check that all engines have loaded the same scene and make the same steps; for this they make some steps.

    The total energy alone does not show a wrong time step, because it is conserved. The potential energy of a melting
    crystal does. scatter : further difference allowed after these steps, for engines with random numbers of their own
    [ε per atom]. Raises HandOverError if an engine differs from the first.
    """
    _compare("potential energy at step 0", [(e, e.potential_energy()) for e in engines], relative=SAME_START)
    for engine in engines:
        engine.run(STEPS_COMPARED)
    when = f"per atom after {STEPS_COMPARED} steps"
    allowed = SAME_COURSE + scatter
    _compare(f"potential energy {when}", [(e, e.potential_energy() / n_atoms) for e in engines], absolute=allowed)
    _compare(f"total energy {when}", [(e, e.total_energy() / n_atoms) for e in engines], absolute=allowed)


def warm_up(engines: Sequence[TimedEngine], n_atoms: int) -> list[int]:
    """Run each engine several times, each twice as long as the one before; returns the number of steps in its turns."""
    n_steps = []
    for engine in engines:
        tell(f"{n_atoms} atoms: warming up {label(engine)}")
        started, done, burst = perf_counter(), 0, 1
        seconds = _seconds(engine, burst)
        while (done := done + burst) < WARM_UP and perf_counter() - started <= SECONDS_WARM_UP:
            burst *= 2
            seconds = _seconds(engine, burst)
        n_steps.append(steps_in_a_turn(seconds / burst))
    return n_steps


def take_turns(
    engines: Sequence[TimedEngine], n_steps: Sequence[int], repeats: int, n_atoms: int
) -> NDArray[np.float64]:
    """Steps per second of each engine in each turn, (E, repeats).

    The engines take turns because the speed of a machine drifts: so the drift affects all of them.  n_steps : (E,),
    of a turn.
    """
    speeds = np.empty((len(engines), repeats))
    for turn in range(repeats):
        for k, engine in enumerate(engines):
            speeds[k, turn] = n_steps[k] / _seconds(engine, n_steps[k])
        tell(f"{n_atoms} atoms: turn {turn + 1} of {repeats}")
    return speeds


def steps_in_a_turn(seconds_per_step: float) -> int:
    """The number of steps of a turn: half a second, at least 40 steps, at most 5 seconds,
    and never less than one step."""
    in_time, at_most = SECONDS_A_TURN / seconds_per_step, LONGEST_TURN / seconds_per_step
    return max(1, int(min(max(in_time, STEPS_A_TURN), at_most)))


def label(engine: TimedEngine) -> str:
    """The description of an engine."""
    return f"{engine.name}, {engine.precision}, {threads_text(engine.threads)}"


def _compare(
    quantity: str, energies: Sequence[tuple[TimedEngine, float]], relative: float = 0.0, absolute: float = 0.0
) -> None:
    first, expected = energies[0]
    for engine, energy in energies[1:]:
        if not abs(energy - expected) <= relative * abs(expected) + absolute:
            raise HandOverError(f"{quantity}: {label(first)} has {expected:.8g}, {label(engine)} has {energy:.8g}")


def _seconds(engine: TimedEngine, n_steps: int) -> float:
    start = perf_counter()
    measured = engine.run(n_steps)
    return perf_counter() - start if measured is None else measured
