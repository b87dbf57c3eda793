"""The pair list with a skin: built in linear time, used until an atom has moved half the skin."""

import numpy as np
from numpy.typing import NDArray

from minimd.cell import Cell
from minimd.compiling import kernel
from minimd.errors import NonFiniteError
from minimd.neighbors.binning import make_grid, sort_into_bins
from minimd.neighbors.search import find_pairs, forward_bins, image_table
from minimd.potentials.pair_loop import Pairs

SPARE = 1.2  # room for this much more than the pairs that were found


class PairList:
    """Pairs closer than a cutoff, kept for as long as no atom can have come into reach unseen.

    All pairs within cutoff + skin are listed; a pair beyond that needs one of its atoms to move more than skin/2 before it
    can come within the cutoff. The displacements that count are true ones: an atom moved by a lattice vector has moved.

    Parameters
    ----------
    cutoff : [length]; infinite for all pairs, in open scenes.
    skin : [length], ≥ 0.
    excluded : (P, 2) int, pairs whose nearest image is left out.

    Attributes
    ----------
    pairs : Pairs, counting in the order of the list.  order : (N,) int, user's index of each atom in that order.
    offsets : (N, 3), lattice vectors to add to positions[order].  n_builds : how often it was built.
    """

    def __init__(self, n_atoms: int, cutoff: float, skin: float, excluded: NDArray[np.int64]) -> None:
        self.cutoff, self.skin = cutoff, skin
        self.n_builds = 0
        self._excluded_start, self._excluded = partners(excluded, n_atoms)
        self._cell: Cell | None = None
        self._built_at = np.empty((0, 3))
        self._second, self._image = (np.empty(0, dtype=np.uint32) for _ in range(2))

    @property
    def has_excluded(self) -> bool:
        """True if a pair is left out."""
        return self._excluded.size > 0

    def update(self, positions: NDArray[np.float64], cell: Cell) -> bool:
        """Build the list anew if it can miss a pair; True if it was built.

        Raises
        ------
        NonFiniteError : if a position is not finite.
        """
        if self._cell is not None and cell.same_as(self._cell) and not self._moved_too_far(positions):
            return False
        bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
        if bad.size:
            raise NonFiniteError(f"positions of {bad.size} atoms are not finite, the first is atom {bad[0]}")
        self._build(positions, cell)
        return True

    def _moved_too_far(self, positions: NDArray[np.float64]) -> bool:
        if self.cutoff == np.inf:
            return not np.isfinite(positions).all()
        return bool(any_moved(positions, self._built_at, 0.25 * self.skin**2))

    def _build(self, positions: NDArray[np.float64], cell: Cell) -> None:
        self._cell, self._built_at = cell, positions.copy()
        self.n_builds += 1
        if self.cutoff == np.inf:
            self._list_all_pairs(positions)
            return
        reach = self.cutoff + self.skin
        grid = make_grid(cell, positions, reach)
        self.order, self.offsets, bin_start = sort_into_bins(positions, cell, grid)
        local = positions[self.order] + self.offsets
        crossed, translations = image_table(cell, grid)
        start = np.empty(len(positions) + 1, dtype=np.int64)
        geometry = (bin_start, grid.counts, forward_bins(grid), crossed, translations, cell.pbc, cell.lattice, cell.inverse)
        limits = (cell.safe_distance2, reach**2, self._excluded_start, self._excluded)
        n_pairs = find_pairs(local, self.order, *geometry, *limits, start, self._second, self._image)
        if n_pairs > len(self._second):
            self._second, self._image = (np.empty(int(SPARE * n_pairs), dtype=np.uint32) for _ in range(2))
            find_pairs(local, self.order, *geometry, *limits, start, self._second, self._image)
        self.pairs = Pairs(start, self._second[:n_pairs], self._image[:n_pairs], translations)

    def _list_all_pairs(self, positions: NDArray[np.float64]) -> None:
        """Every pair once, in the user's order: the list without a cutoff, never built again."""
        n = len(positions)
        self.order, self.offsets = np.arange(n), np.zeros((n, 3))
        first, second = np.triu_indices(n, k=1)
        if self._excluded.size:
            apart = np.ones((n, n), dtype=bool)
            apart[np.repeat(np.arange(n), np.diff(self._excluded_start)), self._excluded] = False
            kept = apart[first, second]
            first, second = first[kept], second[kept]
        start = np.zeros(n + 1, dtype=np.int64)
        np.cumsum(np.bincount(first, minlength=n), out=start[1:])
        self.pairs = Pairs(start, second.astype(np.uint32), np.empty(0, dtype=np.uint32), np.zeros((0, 3)))


@kernel
def any_moved(positions, reference, limit2):
    """True if an atom is farther than the square root of limit2 from where it was, or nowhere (NaN)."""
    for i in range(positions.shape[0]):
        dx = positions[i, 0] - reference[i, 0]
        dy = positions[i, 1] - reference[i, 1]
        dz = positions[i, 2] - reference[i, 2]
        if not dx * dx + dy * dy + dz * dz <= limit2:
            return True
    return False


def partners(pairs: NDArray[np.int64], n_atoms: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs as a table: the partners of atom a are values[start[a] : start[a + 1]]."""
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    start = np.zeros(n_atoms + 1, dtype=np.int64)
    np.cumsum(np.bincount(both[:, 0], minlength=n_atoms), out=start[1:])
    return start, np.ascontiguousarray(both[:, 1])
