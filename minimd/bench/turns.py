"""Timing in turns: engines that agree about the scene run one after the other, again and again."""

import sys
from collections.abc import Sequence
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from minimd.bench.engines import Engine
from minimd.bench.outcome import DisagreementError

SAME_START = 1e-5  # of the energy at step 0, between engines: single precision
STEPS_COMPARED = 10  # few enough for trajectories not to part, enough for the energy to change by half an ε per atom
SAME_COURSE = 1e-3  # ε per atom, of the energies after them
WARM_UP, SECONDS_WARM_UP = 200, 5.0  # steps, or seconds if those come first: melts the lattice, fills caches
SECONDS_A_TURN = 0.5
STEPS_A_TURN, LONGEST_TURN = 40, 5.0  # at least so many, with two new lists or more, unless they take so many seconds


def check_agreement(engines: Sequence[Engine], n_atoms: int) -> None:
    """Make sure that all engines have loaded the same scene and make the same steps. Makes some.

    The total energy alone would not notice a wrong time step, since it is conserved: the potential energy of a crystal that melts does.

    Raises
    ------
    DisagreementError : if an engine differs from the first.
    """
    _compare("potential energy at step 0", [(e, e.potential_energy()) for e in engines], relative=SAME_START)
    for engine in engines:
        engine.run(STEPS_COMPARED)
    when = f"per atom after {STEPS_COMPARED} steps"
    _compare(f"potential energy {when}", [(e, e.potential_energy() / n_atoms) for e in engines], absolute=SAME_COURSE)
    _compare(f"total energy {when}", [(e, e.total_energy() / n_atoms) for e in engines], absolute=SAME_COURSE)


def warm_up(engines: Sequence[Engine], n_atoms: int) -> list[int]:
    """Run each engine for a while; returns how many steps make a turn of it."""
    n_steps = []
    for engine in engines:
        _tell(f"{n_atoms} atoms: warming up {label(engine)}")
        n_steps.append(steps_in_a_turn(_seconds_per_step(engine)))
    return n_steps


def take_turns(engines: Sequence[Engine], n_steps: Sequence[int], repeats: int, n_atoms: int) -> NDArray[np.float64]:
    """Steps per second of each engine in each turn, (E, repeats).

    Engines take turns, so that a machine whose speed drifts treats them alike. n_steps : (E,), of a turn.
    """
    speeds = np.empty((len(engines), repeats))
    for turn in range(repeats):
        for k, engine in enumerate(engines):
            speeds[k, turn] = n_steps[k] / _seconds(engine, n_steps[k])
        _tell(f"{n_atoms} atoms: turn {turn + 1} of {repeats}")
    return speeds


def steps_in_a_turn(seconds_per_step: float) -> int:
    """So many steps that a turn takes about half a second; 40 if that are more; one at least."""
    in_time, at_most = SECONDS_A_TURN / seconds_per_step, LONGEST_TURN / seconds_per_step
    return max(1, int(min(max(in_time, STEPS_A_TURN), at_most)))


def label(engine: Engine) -> str:
    """An engine in words."""
    return f"{engine.name}, {engine.precision}, {engine.threads} thread{'s' if engine.threads > 1 else ''}"


def _compare(quantity: str, energies: Sequence[tuple[Engine, float]], relative: float = 0.0, absolute: float = 0.0) -> None:
    first, expected = energies[0]
    for engine, energy in energies[1:]:
        if not abs(energy - expected) <= relative * abs(expected) + absolute:
            raise DisagreementError(f"{quantity}: {label(first)} has {expected:.8g}, {label(engine)} has {energy:.8g}")


def _seconds_per_step(engine: Engine) -> float:
    """Seconds that a step takes, after ever longer runs."""
    started, done, burst = perf_counter(), 0, 1
    while True:
        seconds = _seconds(engine, burst)
        done += burst
        if done >= WARM_UP or perf_counter() - started > SECONDS_WARM_UP:
            return seconds / burst
        burst *= 2


def _seconds(engine: Engine, n_steps: int) -> float:
    start = perf_counter()
    engine.run(n_steps)
    return perf_counter() - start


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
