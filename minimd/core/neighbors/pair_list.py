"""The plain pair list: every pair within reach, with its image."""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import called_kernel
from minimd.core.compiled.program import GO_ON, NEEDS_ROOM
from minimd.core.neighbors.buffers import SPARE
from minimd.core.neighbors.search import bins_of, find_pairs, make_grid, sort_into_bins
from minimd.core.neighbors.verlet_list import (
    VerletList,
    any_moved,
    partners,
    raise_not_finite,
    starts,
)
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell
from minimd.core.structure.system import System, local_density
from minimd.core.structure.vectors import strain_vectors

MOST_PAIRS = 2**30  # 8 bytes each
MOST_OF_AN_ATOM = 2**18  # pairs, in the mean: a reach of some 40 atoms
MOST_IMAGES = 2**22  # 72 bytes each
NEVER = -1.0  # no squared distance is so small


class Pairs(namedtuple("Pairs", "start second image translations")):
    """Pairs (i, j), grouped by their first atom: pairs start[i] to start[i+1] belong to atom i.
    start : (N+1,) int.
    second : (P,) int, the atoms j.
    image : (P,) int, row of translations to add to r_j − r_i.
    translations : (T, 3) [length]; with no rows, no pair is shifted and image is not read."""


class Reach(ByAddress, namedtuple("Reach", "positions reference limit2")):
    """Whether a list is valid: see any_moved.
    limit2 : (1,), NEVER if there is none."""


@called_kernel
def is_in_reach(reach, _chunk):
    """NEEDS_ROOM if a new list is needed."""
    return NEEDS_ROOM if any_moved(reach.positions, reach.reference, reach.limit2[0]) else GO_ON


class PairList(VerletList):
    """All pairs within cutoff + skin, in any cell, all images of them; built in linear time.
    cutoff, skin : see VerletList; an infinite cutoff lists all pairs, in open scenes.
    excluded : (P, 2) int, pairs whose nearest image is left out.
    pairs : Pairs, counting in the order of the list.
    order : (N,) int, user's index of each atom in that order.
    offsets : (N, 3), lattice vectors to add to positions[order].
    n_builds : how often it was built."""

    _second = _image = np.empty(0, dtype=np.uint32)

    def __init__(self, n_atoms: int, cutoff: float, skin: float, excluded: Indices) -> None:
        super().__init__(cutoff, skin)
        self._excluded = partners(excluded, n_atoms)
        self._reference = np.empty((n_atoms, 3))
        self._original = np.empty((n_atoms, 3))  # positions at the last build
        self.reach = Reach(np.zeros((n_atoms, 3)), self._reference, np.full(1, NEVER))

    def ready(self, positions: Array, cell: Cell) -> None:
        """See VerletList: what is_in_reach needs."""
        if positions is not self.reach.positions:
            self.reach = self.reach._replace(positions=positions)
        is_same = cell is self._cell or (self._cell is not None and cell.same_as(self._cell))
        self.reach.limit2[0] = self.limit2 if is_same else NEVER

    def update(self, positions: Array, cell: Cell) -> bool:
        """See VerletList."""
        self.ready(positions, cell)
        if not any_moved(positions, self._reference, self.reach.limit2[0]):
            return False
        self._cell = None  # no list until the new one is whole
        raise_not_finite(positions)
        self._build_in(cell, positions)
        return True

    def _built_at(self) -> Array:
        return self._original.copy()

    def _strain(self, strain: Array, before: Cell, cell: Cell) -> None:
        strain_vectors(self._original, strain, np.zeros(3), self._reference)
        before.follow(cell, self.offsets)
        before.follow(cell, self.pairs.translations)
        self.limit2 = self._limit2(self.skin)

    def _build(self, positions: Array, cell: Cell) -> None:
        self._reference[:] = positions
        self._original[:] = positions
        self.limit2 = self._limit2(self.skin)
        self.version += 1
        if self.cutoff == np.inf:
            return self._list_all_pairs(positions)

        reach = self.cutoff + self.skin
        grid = make_grid(cell, positions, reach)
        self.order, self.offsets, bin_start = sort_into_bins(
            positions, cell.lattice, cell.inverse, cell.pbc, grid
        )
        local = positions[self.order] + self.offsets
        bins = bins_of(cell, grid, bin_start)

        start = np.empty(len(positions) + 1, dtype=np.int64)

        while True:
            pairs = Pairs(start, self._second, self._image, bins.translations)
            n_pairs = find_pairs(local, self.order, bins, reach**2, self._excluded, pairs)
            if n_pairs <= len(self._second):
                break
            self._second, self._image = np.empty((2, int(SPARE * n_pairs)), dtype=np.uint32)

        self.pairs = pairs._replace(second=self._second[:n_pairs], image=self._image[:n_pairs])

    def _list_all_pairs(self, positions: Array) -> None:
        """Every pair once, in the user's order: the list without a cutoff, never built again."""
        n = len(positions)
        self.order = np.arange(n)
        self.offsets = np.zeros((n, 3))
        is_listed = np.triu(np.ones((n, n), dtype=bool), k=1)
        is_listed[np.repeat(self.order, np.diff(self._excluded[0])), self._excluded[1]] = False
        first, second = np.nonzero(is_listed)
        no_image = np.empty(0, dtype=np.uint32)
        self.pairs = Pairs(starts(first, n), second.astype(np.uint32), no_image, np.zeros((0, 3)))


def check_size(system: System, cutoff: float, skin: float) -> None:
    """Raise ValueError for more pairs or images than a list can hold: a huge reach, or a huge scene without cutoff."""
    n_atoms = len(system)
    reach = cutoff + skin
    cell = system.cell
    n_pairs = 0.5 * n_atoms**2
    if reach < np.inf:
        density = local_density(system.positions, cell, reach)
        in_reach = 0.5 * n_atoms * density * 4.0 / 3.0 * np.pi * reach**3
        n_pairs = in_reach if cell.is_periodic else min(n_pairs, in_reach)

    n_images = np.prod(2.0 * np.ceil(reach / cell.heights[cell.pbc]) + 1.0)
    name, length = ("cutoff", cutoff) if skin < cutoff else ("skin", skin)

    for objects, number, most in (
        ("images of the cell", float(n_images), MOST_IMAGES),
        ("pairs of an atom", n_pairs / max(n_atoms, 1), MOST_OF_AN_ATOM),
        ("pairs", n_pairs, MOST_PAIRS),
    ):
        if number > most:
            raise ValueError(
                f"pair lists hold up to {most:.1e} {objects}, this scene needs about {number:.1e}: "
                f"reduce the {name} ({length:g})"
            )
