"""All arrays of a cluster list, in memory that is used again."""

import numpy as np

from minimd.core.compiled.simd.vector import Lanes
from minimd.core.neighbors.buffers import HALF_A_PAGE, Buffers, with_room
from minimd.core.neighbors.cluster_memory import ClusterArrays, ClusterMemory
from minimd.core.neighbors.cluster_search import AHEAD, GHOST_BITS, LAYERS, Rows
from minimd.core.neighbors.clusters import DIMENSIONS, Columns, make_clusters
from minimd.core.neighbors.domains import BLOCKS, IMAGES, make_domains, make_ghosts
from minimd.core.neighbors.search import Binned
from minimd.core.structure.arrays import Array

ENTRIES_GUESSED = 12  # for each slot, at first


class ClusterStore:
    """All arrays of a cluster list. They have room for more than is needed, and are kept until it is used up.

    domains : Domains of the columns.
    arrays : ClusterArrays.
    binned : Binned.
    room : (4,) int, for clusters, ghosts, ghosts in windows and blocks of forces.
    entry_start : (K + 1,) int, first entry of each domain.
    needed : (K,) int, entries that each of them needs.
    layers : see Rows."""

    def __init__(
        self, n_atoms: int, lanes: Lanes, is_fixed: bool, reaches2: Array, limits2: Array
    ) -> None:
        """is_fixed : whether forces are summed as whole numbers.
        reaches2, limits2 : of Rows, limits2 at a build."""
        self._n_atoms = n_atoms
        self._lanes = lanes
        self._is_fixed = is_fixed
        self._reaches2 = reaches2
        self._limits2 = limits2
        self._buffers = Buffers()
        sets = np.arange(1 << lanes.size)[:, None] >> np.arange(lanes.size) & 1
        self._far = self._buffers.array("far", np.float64, sets.size)
        self._far[:] = np.where(sets, 0.0, np.inf).ravel()
        self._columns: Columns | None = None
        self.room = np.zeros(4, dtype=np.int64)
        self.needed = np.zeros(0, dtype=np.int64)
        self.entry_start = np.zeros(1, dtype=np.int64)
        self.layers = np.zeros(3, dtype=np.int64)

    def fit(self, columns: Columns, is_strained: bool) -> None:
        """Make all arrays large enough for these columns, and for what a build has found that it needs.
        is_strained : whether clusters have origins of their own.

        Raises ValueError if there are more clusters or entries than numbers for them."""
        n_lanes = self._lanes.size
        # each column may have a cluster that is not full
        n_columns = int(columns.counts[:2].prod())
        n_clusters = (self._n_atoms + n_columns * (n_lanes - 1)) // n_lanes
        if columns is not self._columns:
            self._columns = columns
            self.domains = make_domains(columns, self._n_atoms)
            n_domains = len(self.domains.first)
            guess = n_clusters * n_lanes * ENTRIES_GUESSED // n_domains
            self.needed = np.full(n_domains, guess, dtype=np.int64)
            if len(self.entry_start) != n_domains + 1:
                self.entry_start = np.zeros(n_domains + 1, dtype=np.int64)

        domains = self.domains
        widest = int(np.diff(domains.window).max())
        if widest > GHOST_BITS:
            raise ValueError(
                f"this scene is too large for a cluster list: it needs {widest} clusters of atoms and images in one "
                f"part of the cell, and {GHOST_BITS} fit; simulate fewer atoms"
            )

        needed = [n_clusters, domains.ghost[-1], domains.window[-1], domains.numbers[BLOCKS]]
        self.room = with_room(np.array(needed), self.room)

        entries = with_room(self.needed, np.diff(self.entry_start))
        start = np.concatenate([[0], np.cumsum(entries)])
        most = np.iinfo(np.int32).max
        if start[-1] > most:
            raise ValueError(
                f"cluster lists hold up to {most} entries, this scene needs {start[-1]}: reduce cutoff or skin, or "
                "simulate fewer atoms"
            )

        self.entry_start = start
        self._lay_out(columns, is_strained)

    def _lay_out(self, columns: Columns, is_strained: bool) -> None:
        """All arrays, with the room that there is now."""
        array = self._buffers.array
        domains = self.domains
        n_domains = len(self.needed)
        n_atoms = self._n_atoms
        n_clusters, n_ghosts, n_in_windows, n_blocks = self.room.tolist()
        n_slots = n_clusters * self._lanes.size
        n_block = DIMENSIONS * self._lanes.size

        clusters = make_clusters(n_clusters, columns, self._lanes, is_strained, self._buffers)
        ghosts = make_ghosts(n_clusters, n_ghosts, n_in_windows, self._buffers)

        # atoms are sorted where entries are written afterwards; sizes in words of four bytes
        n_bins = int(columns.counts.prod()) + 1
        sizes = [2 * n_atoms, n_atoms, n_atoms, n_bins, n_bins]
        n_entries = int(self.entry_start[-1]) + AHEAD
        entries = array("entries", np.uint32, max(n_entries, sum(sizes)))
        pieces = np.split(entries.view(np.int32), np.cumsum(sizes))
        height, order, bins, bin_start, place, _ = pieces
        no_cells = np.zeros((0, 3))
        self.binned = Binned(order, bins, bin_start, place, no_cells, height.view(np.float64))

        rows = Rows(
            array("row start", np.int32, n_slots),
            array("row stops", np.int32, LAYERS, n_slots),
            entries,
            self._reaches2,
            array("limits2", np.float64, LAYERS),
            self._limits2,
            self.layers,
        )

        force_type = np.int64 if self._is_fixed else np.float64
        memory = ClusterMemory(
            array("coordinates", np.float64, n_ghosts * n_block),
            array("shifts", np.float64, IMAGES, DIMENSIONS),
            array("forces", force_type, n_blocks * n_block, in_page=HALF_A_PAGE),
            array("first sum", np.int64, n_in_windows * self._is_fixed),
            self._far,
            array("is out", np.int64, n_domains * self._is_fixed),
            array("layers", np.int64, n_domains),
        )

        self.arrays = ClusterArrays(
            clusters, domains.cluster, domains, ghosts, rows, memory, columns
        )
