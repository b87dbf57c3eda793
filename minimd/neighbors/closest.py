"""The closest pair of a scene: the first suspect when something goes wrong."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.neighbors.listing import neighbor_list
from minimd.system import LARGEST, System

BEYOND = 1.0 + 1e-9  # of a distance, to find the pair that has it


class ClosestPair(NamedTuple):
    """Atoms first and second, distance apart [length] through the nearest image."""

    first: int
    second: int
    distance: float

    def __str__(self) -> str:
        return f"atoms {self.first} and {self.second}, {self.distance:.3g} apart"


def closest_pair(system: System) -> ClosestPair | None:
    """The two atoms that are closest to each other; None for a single atom in an open cell or where no distance is finite.

    Atoms in one cell first, in N log N however unevenly they lie; what is closer through an image is then
    searched within that distance of the faces.
    """
    known, cell = np.flatnonzero((np.abs(system.positions) <= LARGEST).all(axis=1)), system.cell
    if known.size == 0 or (known.size == 1 and not cell.is_periodic):
        return None
    fractional = np.einsum("ij,jk->ik", system.positions[known], cell.inverse)
    fractional = np.where(cell.pbc, fractional - np.floor(fractional), fractional)
    here = fractional @ cell.lattice
    best = _closest_of(here)
    reach = BEYOND * min(best.distance, float(np.linalg.norm(cell.lattice[cell.pbc], axis=1).min(initial=np.inf)))  # an atom and its own image
    from_faces = (np.minimum(fractional, 1.0 - fractional) * cell.heights)[:, cell.pbc]
    near = np.flatnonzero((from_faces <= reach).any(axis=1))
    if near.size and reach > 0.0:
        i, j, d = neighbor_list("ijd", System(here[near], cell=cell), reach)
        if d.min(initial=np.inf) < best.distance:
            p = int(np.argmin(d))
            best = ClosestPair(int(near[i[p]]), int(near[j[p]]), float(d[p]))
    return ClosestPair(int(known[best.first]), int(known[best.second]), best.distance)


def _closest_of(positions: NDArray[np.float64]) -> ClosestPair:
    """Without images; a distance of infinity for one atom."""
    if len(positions) == 1:
        return ClosestPair(0, 0, np.inf)
    from scipy.spatial import KDTree

    distances, partners = KDTree(positions).query(positions, k=2)
    i = int(np.argmin(distances[:, 1]))
    j = int(partners[i, 0] if partners[i, 0] != i else partners[i, 1])
    return ClosestPair(min(i, j), max(i, j), float(distances[i, 1]))
