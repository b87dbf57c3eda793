"""Queries about neighbors: the list in ASE's form, the closest pair."""

from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.words import shown
from minimd.core.neighbors.pair_list import PairList, check_size
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import LARGEST, checked_kind, checked_number
from minimd.core.structure.system import System

QUANTITIES = "ijdDS"
BEYOND = 1.0 + 1e-9  # of a distance: the reach that finds a pair at this distance


def neighbor_list(quantities: str, system: System, cutoff: float) -> tuple[NDArray, ...] | NDArray:
    """Neighbors within a cutoff, each pair in both directions, sorted by the first atom.

    Parameters
    ----------
    quantities : any of the letters of ASE's neighbor_list, in any order:
        i, j : (P,) int, the two atoms;
    d : (P,) distance [length];
    D : (P, 3) r_j − r_i + S · cell [length];
        S : (P, 3) int, lattice vectors of system.cell to add to r_j.
    cutoff : [length], > 0 and finite.

    Raises
    ------
    ValueError : for an unknown letter or a cutoff that is not positive and finite.
    """
    is_known = isinstance(quantities, str) and set() < set(quantities) <= set(QUANTITIES)
    if not is_known:
        raise ValueError(
            f"quantities must be letters of {QUANTITIES!r}; quantities = {shown(quantities)}"
        )

    checked_kind("system", system, System, "a minimd System")
    cutoff = checked_number("cutoff", cutoff, "positive and finite")
    check_size(system, cutoff, 0.0)

    cell = system.cell
    positions = system.positions
    pair_list = PairList(len(system), cutoff, 0.0, np.zeros((0, 2), dtype=np.int64))
    pair_list.update(positions, cell)
    pairs = pair_list.pairs
    order = pair_list.order
    first = np.repeat(np.arange(len(system)), np.diff(pairs.start))

    cells = pair_list.offsets @ cell.inverse
    steps = cells[pairs.second] - cells[first]
    if cell.is_periodic:
        steps += (pairs.translations @ cell.inverse)[pairs.image]
    shifts = np.rint(steps).astype(np.int64) @ cell.reduction

    i = np.concatenate([order[first], order[pairs.second]])
    j = np.concatenate([order[pairs.second], order[first]])
    shifts = np.concatenate([shifts, -shifts])
    by_first = np.lexsort((*shifts.T, j, i))
    i, j, shifts = i[by_first], j[by_first], shifts[by_first]

    vectors = positions[j] - positions[i] + shifts @ cell.vectors
    columns = {"i": i, "j": j, "d": np.linalg.norm(vectors, axis=1), "D": vectors, "S": shifts}
    answer = tuple(columns[quantity] for quantity in quantities)
    return answer if len(answer) > 1 else answer[0]


class ClosestPair(NamedTuple):
    """Atoms first and second, distance apart [length] through the nearest image."""

    first: int
    second: int
    distance: float

    def __str__(self) -> str:
        return self.told("")

    def told(self, length: str) -> str:
        """The pair as text.
        length : the unit."""
        unit = f" {length}" if length else ""
        return f"atoms {self.first} and {self.second}, {self.distance:.3g}{unit} apart"


def closest_pair(system: System) -> ClosestPair | None:
    """The two closest atoms; None for a single atom in an open cell or where no distance is finite.
    First the closest pair within one cell, in N log N however uneven the atoms; then a closer one through an image,
    near the faces of the cell."""
    known = np.flatnonzero((np.abs(system.positions) <= LARGEST).all(axis=1))
    cell = system.cell
    if known.size == 0 or (known.size == 1 and not cell.is_periodic):
        return None

    fractional = np.einsum("ij,jk->ik", system.positions[known], cell.inverse)
    fractional = np.where(cell.pbc, fractional - np.floor(fractional), fractional)
    from scipy.spatial import KDTree

    tree = KDTree(fractional @ cell.lattice)
    distances, partners = tree.query(tree.data, k=2)
    i = int(np.argmin(distances[:, 1]))
    j = int(partners[i, 0] if partners[i, 0] != i else partners[i, 1])
    best = ClosestPair(min(i, j), max(i, j), distances[i, 1])
    if cell.is_periodic:
        best = min(
            best, _closest_image(tree, fractional, cell, best.distance), key=attrgetter("distance")
        )
    return ClosestPair(int(known[best.first]), int(known[best.second]), float(best.distance))


def _closest_image(tree: Any, fractional: Array, cell: Cell, distance: float) -> ClosestPair:
    """An atom and the closest image of an atom, or of itself; at infinity if none is within a distance [length].

    tree : KDTree of the atoms in the cell.
    fractional : (n, 3) their coordinates in cell.lattice.
    """
    own = np.linalg.norm(cell.lattice[cell.pbc], axis=1).min()
    reach = BEYOND * min(distance, own)
    margin = np.where(cell.pbc, reach / cell.heights, np.inf)
    most = np.where(cell.pbc, np.ceil(margin), 0)
    grid = np.meshgrid(*(np.arange(-n, n + 1) for n in most), indexing="ij")
    steps = np.stack(grid, axis=-1).reshape(-1, 3)
    best = ClosestPair(0, 0, np.inf)

    for step in steps[: len(steps) // 2]:  # the opposite steps have the same pairs
        images = fractional + step
        near = np.flatnonzero(((images >= -margin) & (images <= 1.0 + margin)).all(axis=1))
        distances, partners = tree.query(images[near] @ cell.lattice)
        if distances.min(initial=np.inf) < best.distance:
            k = np.argmin(distances)
            i, j = sorted((near[k], partners[k]))
            best = ClosestPair(i, j, distances[k])
    return best
