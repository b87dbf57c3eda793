"""The closest pair of a scene: the first suspect when something goes wrong."""

from typing import NamedTuple

import numpy as np

from minimd.neighbors.listing import neighbor_list
from minimd.system import System

FARTHEST = 1e150  # [length]; the square of a larger number may be none
GROWTH = 1.5  # the search radius grows by this factor until a pair is found


class ClosestPair(NamedTuple):
    """Atoms first and second, distance apart [length] through the nearest image."""

    first: int
    second: int
    distance: float

    def __str__(self) -> str:
        return f"atoms {self.first} and {self.second}, {self.distance:.3g} apart"


def closest_pair(system: System) -> ClosestPair | None:
    """The two atoms that are closest to each other; None for a single atom in an open cell or where no distance is finite."""
    finite = np.flatnonzero(np.isfinite(system.positions).all(axis=1))
    if finite.size == 0 or (finite.size == 1 and not system.cell.is_periodic):
        return None
    part = System(system.positions[finite], cell=system.cell)
    spread = np.ptp(part.positions, axis=0) if not system.cell.is_periodic else system.cell.heights[system.cell.pbc]
    if not np.any(spread):
        return ClosestPair(int(finite[0]), int(finite[1]), 0.0)
    largest = 2.0 * np.sqrt(3.0) * float(np.max(spread)) + np.finfo(float).tiny
    if largest > FARTHEST:
        return None
    cutoff = largest / max(2.0, 2.0 * len(part)) ** (1.0 / 3.0)
    while True:
        i, j, d = neighbor_list("ijd", part, cutoff)
        if d.size or cutoff > largest * GROWTH:
            break
        cutoff *= GROWTH
    if d.size == 0:
        return None
    p = int(np.argmin(d))
    return ClosestPair(int(finite[i[p]]), int(finite[j[p]]), float(d[p]))
