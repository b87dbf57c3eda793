"""The plain pair list: every pair within reach, with its image."""

import numpy as np
from numpy.typing import NDArray

from minimd.neighbors.binning import make_grid, sort_into_bins
from minimd.neighbors.search import find_pairs, forward_bins, image_table
from minimd.neighbors.verlet_list import VerletList
from minimd.potentials.pair_loop import Pairs
from minimd.structure.cell import Cell

SPARE = 1.2  # room for this much more than the pairs that were found


class PairList(VerletList):
    """All pairs within cutoff + skin, in any cell, all images of them; built in linear time.

    Parameters
    ----------
    cutoff, skin, excluded : see VerletList; an infinite cutoff lists all pairs, in open scenes.

    Attributes
    ----------
    pairs : Pairs, counting in the order of the list.  order : (N,) int, user's index of each atom in that order.
    offsets : (N, 3), lattice vectors to add to positions[order].  n_builds : how often it was built.
    """

    def __init__(self, n_atoms: int, cutoff: float, skin: float, excluded: NDArray[np.int64]) -> None:
        super().__init__(n_atoms, cutoff, skin, excluded)
        self._second, self._image = (np.empty(0, dtype=np.uint32) for _ in range(2))

    def _build(self, positions: NDArray[np.float64], cell: Cell) -> None:
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
