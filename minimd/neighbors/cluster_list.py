"""The cluster list with a skin: rows of clusters for the vector loop, and the memory that the loop works on."""

import numpy as np
from numpy.typing import NDArray

from minimd.cell import Cell, minimum_image_translations
from minimd.neighbors.cluster_search import HOME, exclude_lanes, find_rows, fold_ghosts, refresh_ghosts
from minimd.neighbors.clusters import FAR, bounding_boxes, gather_clusters, make_columns, place_padding, scatter_clusters, sort_into_clusters
from minimd.neighbors.skin import ListWithSkin
from minimd.potentials.cluster_loop import BLOCK, LANES, Rows

SPARE = 1.2  # room for this much more than was found
CACHE_LINE = 64  # bytes; vectors that straddle two cost twice
IMAGES = 27


class ClusterList(ListWithSkin):
    """Clusters with an atom within cutoff + skin of each atom.

    It needs a cell whose periodic heights are at least cutoff + skin, and a finite cutoff.

    Parameters
    ----------
    cutoff, skin, excluded : see ListWithSkin.

    Attributes
    ----------
    rows : Rows for the loop.  atom : (slots,) int, user's index in each slot, −1 for padding.
    coordinates, on_clusters, on_atoms : flat float64, see add_cluster_forces.  n_builds : how often it was built.
    """

    def __init__(self, n_atoms: int, cutoff: float, skin: float, excluded: NDArray[np.int64]) -> None:
        super().__init__(n_atoms, cutoff, skin, excluded)
        self._lattice = np.zeros((3, 3))
        self._cluster, self._lanes = np.empty(0, dtype=np.uint32), np.empty(0, dtype=np.uint8)
        self._ghost_room = np.empty((0, 2), dtype=np.int64)
        self._candidates = np.empty((256, 2), dtype=np.int64)
        self.coordinates = self.on_clusters = self.on_atoms = np.empty(0)

    def gather(self, positions: NDArray[np.float64]) -> None:
        """Copy the positions to where the loop reads them, ghosts included, and clear the forces."""
        gather_clusters(positions, self.atom, self._offsets, self.coordinates)
        refresh_ghosts(self.coordinates, self.n_clusters, self.ghosts, self._lattice)
        self.on_clusters[: (self.n_clusters + len(self.ghosts)) * BLOCK] = 0.0
        self.on_atoms[: self.n_clusters * BLOCK] = 0.0

    def scatter(self, forces: NDArray[np.float64]) -> None:
        """Add what the loop found to the forces on the atoms, (N, 3)."""
        fold_ghosts(self.on_clusters, self.n_clusters, self.ghosts)
        scatter_clusters(self.on_clusters, self.on_atoms, self.atom, forces)

    def by_slot(self, per_atom: NDArray) -> NDArray:
        """Values of the atoms, (N,), as (slots,) of real and ghost clusters; padding gets the first atom's."""
        real = per_atom[np.maximum(self.atom, 0)].reshape(-1, LANES)
        return np.concatenate([real, real[self.ghosts[:, 0]]]).ravel()

    def _build(self, positions: NDArray[np.float64], cell: Cell) -> None:
        self._lattice, reach = cell.lattice, self.cutoff + self.skin
        columns = make_columns(cell, positions, reach)
        clusters = sort_into_clusters(positions, cell, columns)
        self.atom, self._offsets = clusters.atom, clusters.offsets
        self.n_clusters = len(clusters.top)
        self._make_room(self.n_clusters + len(self._ghost_room))
        gather_clusters(positions, self.atom, self._offsets, self.coordinates)
        place_padding(self.atom, FAR * max(reach, float((cell.heights * columns.extent).max())), self.coordinates)
        boxes = np.empty((self.n_clusters, 6))
        bounding_boxes(self.coordinates, self.atom, boxes)
        start, ghost_of = np.empty(len(self.atom) + 1, dtype=np.int64), np.empty((IMAGES, self.n_clusters), dtype=np.int64)
        shape = (boxes, clusters.bottom, clusters.top, clusters.column_start, columns.counts, columns.reach, columns.along)
        while True:
            ghost_of[:] = -1
            room = (ghost_of, self._ghost_room, self._candidates, start, self._cluster, self._lanes)
            n_entries, n_ghosts, most = find_rows(self.coordinates, self.atom, *shape, reach, cell.pbc, cell.lattice, *room)
            if n_ghosts <= len(self._ghost_room) and n_entries <= len(self._cluster) and most <= len(self._candidates):
                break
            self._grow(n_entries, n_ghosts, most)
        self.ghosts = self._ghost_room[:n_ghosts]
        if self.has_excluded:
            self._exclude(positions, cell, ghost_of, start)
        self.rows = Rows(start, self._cluster[:n_entries], self._lanes[:n_entries])

    def _grow(self, n_entries: int, n_ghosts: int, most: int) -> None:
        if most > len(self._candidates):
            self._candidates = np.empty((int(SPARE * most), 2), dtype=np.int64)
        if n_ghosts > len(self._ghost_room):
            self._ghost_room = np.empty((2 * n_ghosts + 64, 2), dtype=np.int64)
            self._make_room(self.n_clusters + len(self._ghost_room))
        if n_entries > len(self._cluster):
            self._cluster, self._lanes = np.empty(int(SPARE * n_entries), dtype=np.uint32), np.empty(int(SPARE * n_entries), dtype=np.uint8)

    def _make_room(self, n_blocks: int) -> None:
        """Memory for so many clusters, real and ghost; what stands there already is kept."""
        if n_blocks * BLOCK <= len(self.coordinates):
            return
        kept = self.coordinates
        self.coordinates, self.on_clusters, self.on_atoms = (aligned_zeros(int(SPARE * n_blocks) * BLOCK) for _ in range(3))
        self.coordinates[: len(kept)] = kept

    def _exclude(self, positions: NDArray[np.float64], cell: Cell, ghost_of: NDArray[np.int64], start: NDArray[np.int64]) -> None:
        first = np.repeat(np.arange(len(positions)), np.diff(self._excluded_start))
        real = self.atom >= 0
        slot_of, home = np.empty(len(positions), dtype=np.int64), np.empty_like(positions)
        slot_of[self.atom[real]] = np.flatnonzero(real)
        home[self.atom[real]] = positions[self.atom[real]] + self._offsets[real]
        nearest = np.full(len(first), HOME, dtype=np.int64)
        if cell.is_periodic:
            translations = np.empty((len(first), 3))
            minimum_image_translations(home, first, self._excluded, cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2, translations)
            steps = np.rint(translations @ cell.inverse).astype(np.int64)
            nearest += steps @ np.array([9, 3, 1])
        exclude_lanes(self.atom, slot_of, self._excluded_start, self._excluded, nearest, ghost_of, start, self._cluster, self._lanes)


def aligned_zeros(n: int) -> NDArray[np.float64]:
    """n zeros that begin at a cache line."""
    item = np.dtype(np.float64).itemsize
    raw = np.zeros(n + CACHE_LINE // item)
    skip = (-raw.ctypes.data % CACHE_LINE) // item
    return raw[skip : skip + n]
