"""`minimd bench lj`: the Lennard-Jones melt against the other engines that are installed, in turn, and the table of it."""

import platform
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from time import perf_counter
from typing import NamedTuple

import numpy as np

from minimd.bench.engines import PEERS, Engine, Minimd, melt

REPEATS = 7
WARM_UP = 200  # steps: compiles, melts the lattice, fills caches
SECONDS_A_TURN = 0.5
AGREEMENT = 1e-5  # of the energy at step 0, between engines: single precision


class Row(NamedTuple):
    """Speed of one engine on one size: atom-steps per second in each turn, (R,), and the ratio of minimd's to it."""

    name: str
    n_atoms: int
    speeds: np.ndarray
    ratios: np.ndarray


def run_melt(n_cells: Sequence[int] = (5, 10, 20), repeats: int = REPEATS) -> str:
    """The table, as Markdown. Engines take turns, so that a machine whose speed drifts treats them alike.

    Raises
    ------
    ArithmeticError : if two engines disagree about the energy of the start.
    """
    rows = [row for cells in n_cells for row in _one_size(cells, repeats)]
    lines = [
        f"Lennard-Jones melt, ρ* 0.8442, T* 1.44, r_c 2.5, Δt* 0.005, NVE, one thread; {platform.machine()}, {repeats} turns each",
        "",
        "| atoms | engine | 10⁶ atom-steps/s (median, least to most) | minimd is faster by (median, least to most) |",
        "| ---: | --- | ---: | ---: |",
    ]
    return "\n".join(lines + [_line(row) for row in rows])


def _one_size(n_cells: int, repeats: int) -> list[Row]:
    scene = melt(n_cells)
    engines: list[Engine] = [Minimd(scene)]
    engines.extend(PEERS[name](scene) for name in PEERS if find_spec(name))
    _compare([(engine.name, engine.potential_energy()) for engine in engines])
    n_steps = [_steps_in_a_turn(engine) for engine in engines]
    speeds = np.empty((len(engines), repeats))
    for turn in range(repeats):
        for k, engine in enumerate(engines):
            speeds[k, turn] = len(scene[0]) * n_steps[k] / _seconds(engine, n_steps[k])
        print(f"{len(scene[0])} atoms: turn {turn + 1} of {repeats}", file=sys.stderr)
    return [Row(engine.name, len(scene[0]), speeds[k], speeds[0] / speeds[k]) for k, engine in enumerate(engines)]


def _compare(energies: Sequence[tuple[str, float]]) -> None:
    """All engines must have loaded the same scene before any timing counts."""
    first, expected = energies[0]
    for name, energy in energies[1:]:
        if abs(energy - expected) > AGREEMENT * abs(expected):
            raise ArithmeticError(f"potential energy at step 0: {first} has {expected:.8g}, {name} has {energy:.8g}")


def _steps_in_a_turn(engine: Engine) -> int:
    """So many steps that a turn takes about half a second; at least ten."""
    engine.run(WARM_UP)
    return max(10, int(WARM_UP * SECONDS_A_TURN / _seconds(engine, WARM_UP)))


def _seconds(engine: Engine, n_steps: int) -> float:
    start = perf_counter()
    engine.run(n_steps)
    return perf_counter() - start


def _line(row: Row) -> str:
    speeds, ratios = row.speeds / 1e6, row.ratios
    ratio = "" if np.all(ratios == 1.0) else f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})"
    return f"| {row.n_atoms} | {row.name} | {np.median(speeds):.2f} ({speeds.min():.2f} to {speeds.max():.2f}) | {ratio} |"
