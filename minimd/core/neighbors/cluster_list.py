"""The cluster list with a skin: rows of clusters for the vector loop, in memory that is used again."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.kernels import DirectCalls
from minimd.core.compiled.program import Operation, Program, operation
from minimd.core.compiled.simd.vector import lanes_for
from minimd.core.compiled.threads import MOST_CHUNKS, ThreadPool
from minimd.core.neighbors import cluster_build
from minimd.core.neighbors.buffers import HALF_A_PAGE, SPARE, Buffers, with_room
from minimd.core.neighbors.cluster_build import Building
from minimd.core.neighbors.cluster_memory import ClusterArrays, ClusterMemory
from minimd.core.neighbors.cluster_search import AHEAD, BUILDS, GHOST_BITS, IN_USE, LAYERS, Rows
from minimd.core.neighbors.clusters import (
    DIMENSIONS,
    Clusters,
    Columns,
    make_clusters,
    make_columns,
    region_of,
)
from minimd.core.neighbors.domains import (
    BLOCKS,
    IMAGES,
    GhostClusters,
    Layout,
    ghosts_for_search,
    make_domains,
    make_ghosts,
)
from minimd.core.neighbors.search import Binned, bins_for_sort
from minimd.core.neighbors.verlet_list import VerletList, partners, raise_not_finite
from minimd.core.structure.cell import Cell, Images
from minimd.core.structure.vectors import Array, strained

NO_PARTNERS = np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
ENTRIES_GUESSED = 12  # for each atom, at first


class ClusterList(VerletList):
    """Clusters with an atom within cutoff + skin of each atom.

    Each row has two layers: what is within cutoff + skin/2, which is enough until an atom has moved by skin/4, and the
    rest. So rows are short at first. What is left out then would add zeros: forces have the same bits either way.

    It needs a cell whose periodic heights are at least cutoff + skin, and a finite cutoff.
    cutoff, skin : see VerletList.  excluded : (P, 2) int, pairs whose nearest image is left out.
    is_fixed : whether forces are summed as whole numbers.  pool : the threads that build it.
    n_domains : number of chunks of an operation.  lanes : of its vectors.
    clusters, domains, ghosts, rows, memory : see there.
    arrays : what the loop needs of them. They have room for more, and are the same arrays until it is used up.
    version : how often they were replaced.  building : what operations need."""

    clusters: Clusters
    ghosts: GhostClusters
    rows: Rows
    memory: ClusterMemory
    _columns: Columns
    _bins: Binned
    _entries: NDArray[np.uint32]

    def __init__(
        self,
        n_atoms: int,
        cutoff: float,
        skin: float,
        excluded: NDArray[np.int64],
        is_fixed: bool,
        pool: ThreadPool,
    ) -> None:
        super().__init__(cutoff, skin)
        self._excluded = partners(excluded, n_atoms) if len(excluded) else None
        self._slot_of = np.zeros(n_atoms if len(excluded) else 0, dtype=np.int64)
        # by which the layers reach beyond the cutoff
        self._widths = self.skin * np.arange(1, LAYERS + 1) / LAYERS
        self._n_atoms = n_atoms
        self._reach = cutoff + skin
        self._is_fixed = is_fixed
        self._pool = pool
        self._columns_of: tuple[Cell, Array] | None = None
        self._images: Images | None = None
        self._positions = np.zeros((n_atoms, DIMENSIONS))  # where the operations find them
        self._calls = DirectCalls()
        self._program = Program(self.operations, lambda: self.version, pool)
        self._n_counted = 0  # builds
        self._layers = np.zeros(3, dtype=np.int64)
        self.lanes = lanes_for()
        self._room: tuple[int, ...] = (0, 0, 0)
        self._entry_start = np.zeros(1, dtype=np.int64)
        self._shifts = np.zeros((IMAGES, DIMENSIONS))
        self._memory = Buffers()
        sets = np.arange(1 << self.lanes.size)[:, None] >> np.arange(self.lanes.size) & 1
        self._far = self._memory.array("far", np.float64, sets.size)
        self._far[:] = np.where(sets, 0.0, np.inf).ravel()

    def operations(self) -> Iterator[Operation]:
        """Atoms to their clusters and ghosts; a new list where it is due; see cluster_build.  Memory must be ready."""
        n = self.n_domains
        of_list = partial(operation, self._calls, is_kept=True)
        build = [
            (cluster_build.find_columns, 1, self._refit),
            (cluster_build.sort_atoms, 1, None),
            (cluster_build.cut_columns, self.building.n_chunks, None),
            (cluster_build.find_domains, 1, self._make_room),
            (cluster_build.place_ghosts, n, None),
            (cluster_build.list_rows, n, self._make_room),
            (cluster_build.finish_list, 1, None),
        ]
        if self._excluded is not None:
            build += [(cluster_build.number_slots, n, None), (cluster_build.exclude_pairs, n, None)]
        after = 1 + len(build)
        yield of_list(cluster_build.place_atoms, self.building, n)
        refuse = lambda _answer: raise_not_finite(self._positions)  # noqa: E731
        yield of_list(cluster_build.is_valid, self.building, otherwise=after, python=refuse)
        for k, (kernel, n_chunks, remedy) in enumerate(build, start=2):
            # in the end to place_atoms; after a remedy to sort_atoms
            then = 1 if k < after else -k
            yield of_list(kernel, self.building, n_chunks, then=then, python=remedy, again=3 - k)

    def ready(self, positions: Array, cell: Cell) -> None:
        """See VerletList: memory; without a list of this cell, the operations build one."""
        of = (self._cell, None if self._columns_of is None else self._columns_of[0])
        if not all(one is cell or (one is not None and cell.same_as(one)) for one in of):
            self._take(positions, cell)
        elif positions is not self._positions:
            self._positions = positions
            self._arrange_building()

    def _take(self, positions: Array, cell: Cell) -> None:
        """Memory for a new list of atoms at these positions."""
        self._positions = positions
        self._cell = cell
        self._built_in = cell
        self._stretch = 1.0
        self._layers[IN_USE] = 0
        if self._images is None:
            self._images = Images.of(cell)
        self._images.take(cell)
        region = region_of(cell, positions, self._reach) if self._region is None else self._region
        self._lay_columns(cell, region)
        if self.building.positions is not positions:
            self._arrange_building()

    def _lay_columns(self, cell: Cell, region: Array) -> None:
        """Columns of a region of a cell."""
        of = self._columns_of
        if of is None or not (cell.same_as(of[0]) and np.array_equal(region, of[1])):
            columns = make_columns(cell, self._n_atoms, self._reach, self.lanes, region)
            if of is None or not self._columns.move_to(columns):
                self._columns = columns
                self.domains = make_domains(columns, self._n_atoms)
                self.n_domains = len(self.domains.first)
                self._needed = np.zeros(self.n_domains, dtype=np.int64)
                self._arrange()
            self._columns_of = cell, region
        self._region = region

    def _refit(self, _answer: int) -> None:
        """Columns where the atoms are now."""
        if self._cell is not None:
            self._lay_columns(self._cell, region_of(self._cell, self._positions, self._reach))

    def settle(self) -> None:
        """After operations: what they have done to the list."""
        built = int(self._layers[BUILDS]) - self._n_counted
        if built:
            self.n_builds += built
            self._n_counted += built
            self._built_in = self._cell
            self._stretch = 1.0
        if self._layers[IN_USE] == 0:
            self._cell = None

    def update(self, positions: Array, cell: Cell) -> bool:
        """See VerletList."""
        before = self.n_builds
        self.ready(positions, cell)
        try:
            self._program.run()
        finally:
            self.settle()
        return self.n_builds != before

    def _build(self, positions: Array, cell: Cell) -> None:
        before = self._positions
        self._take(positions, cell)
        self._program.run()
        self._n_counted = int(self._layers[BUILDS])  # the caller counts
        self._positions = before
        self._arrange_building()

    def _built_at(self) -> Array:
        clusters = self.clusters
        n_lanes = self.lanes.size
        n = self.n_clusters
        positions = np.empty((self._n_atoms, DIMENSIONS))
        real = np.arange(n_lanes) < clusters.filled[:n, None]
        positions[clusters.atom[: n * n_lanes][real.ravel()]] = self._blocks(
            clusters.origins
        ).transpose(0, 2, 1)[real]
        return positions

    def _blocks(self, flat: Array) -> Array:
        """The numbers of the atoms of all clusters, (C, 3, n), a view."""
        return flat.reshape(-1, DIMENSIONS, self.lanes.size)[: self.n_clusters]

    @property
    def n_clusters(self) -> int:
        """Number of clusters."""
        return int(self.clusters.column_start[-1])

    @property
    def n_ghosts(self) -> int:
        """Number of their ghosts."""
        return int(self.domains.ghost[-1])

    def _strain(self, strain: Array, before: Cell, cell: Cell) -> None:
        if self.clusters.origins is self.clusters.positions:  # from now on they are not the same
            origins = self._memory.array("origins", np.float64, len(self.clusters.positions))
            origins[:] = self.clusters.positions
            self.clusters = self.clusters._replace(origins=origins)
            self._arrange_building()
        strained(self._blocks(self.clusters.origins), strain, self._blocks(self.clusters.positions))
        if self._images is not None:
            self._images.take(cell)
        self.clusters.wrapping.lattice[:] = cell.lattice
        before.follow(cell, self._shifts)
        self.rows.limits2[:] = [self._limit2(width) for width in self._widths]
        if self._region is not None:
            columns = make_columns(cell, self._n_atoms, self._reach, self.lanes, self._region)
            if self._columns.move_to(columns):
                self._columns_of = cell, self._region

    def _make_room(self, _answer: int = 0) -> None:
        """More memory, after a build that has found how much it needs."""
        columns_of = self._columns_of
        self._columns_of = None  # what follows may fail: a whole list or none
        window = self.domains.window
        needed = self.n_ghosts, int(window[-1]), int(self.domains.numbers[BLOCKS])
        widest = int(np.diff(window).max())
        if widest > GHOST_BITS:
            raise ValueError(
                f"this scene is too large for a cluster list: it needs {widest} clusters of atoms and images in one "
                f"part of the cell, and {GHOST_BITS} fit; simulate fewer atoms"
            )
        room = tuple(
            room if n <= room else with_room(n) for n, room in zip(needed, self._room, strict=True)
        )
        is_enough = room == self._room
        self._room = room
        if len(self._entry_start) != self.n_domains + 1:
            self._make_entries(np.diff(self.domains.cluster) * self.lanes.size * ENTRIES_GUESSED)
        elif is_enough:
            self._make_entries(
                np.maximum(
                    np.diff(self._entry_start), [with_room(n) for n in self._needed.tolist()]
                )
            )
        self._arrange()
        self._columns_of = columns_of

    def _make_entries(self, room: NDArray[np.int64]) -> None:
        """Room for so many entries of each domain."""
        start = np.concatenate([[0], np.cumsum(room)])
        most = np.iinfo(np.int32).max
        if start[-1] > most:
            raise ValueError(
                f"cluster lists hold up to {most} entries, this scene needs {start[-1]}: reduce cutoff or skin, or "
                "simulate fewer atoms"
            )
        self._entry_start = start
        # they hold the old memory
        del self._entries, self._bins, self.rows, self.arrays, self.building

    def _arrange(self) -> None:
        """All arrays, with the room that there is now. Atoms are sorted where the entries are written afterwards."""
        memory = self._memory
        # room to spare, for columns that go along with the atoms; others have room for atoms however they stand
        spare = 1.0 if self._columns.is_crossed.all() else SPARE
        n_ghosts, n_in_windows, n_forces = self._room
        n_lanes = self.lanes.size
        n_block = n_lanes * DIMENSIONS
        # each may have a cluster that is not full
        n_columns = int(self._columns.counts[0] * self._columns.counts[1])
        n_clusters = (self._n_atoms + n_columns * (n_lanes - 1)) // n_lanes
        heights = (np.float64, (n_clusters,))
        boxes = (np.float64, (n_clusters, 6))
        ((bottom, top, boxes_now, *for_search),) = memory.overlaid(
            "scratch",
            (heights, heights, boxes, *ghosts_for_search(n_ghosts, n_in_windows)),
            spare=spare,
        )
        self._coordinates = memory.array("coordinates", np.float64, n_ghosts * n_block, spare=1.0)
        n_entries = max(int(self._entry_start[-1]), n_clusters * n_lanes * ENTRIES_GUESSED) + AHEAD
        sort = bins_for_sort(self._n_atoms, self._columns.counts)
        entries = ((np.uint32, (n_entries,)),)
        bins, (self._entries,) = memory.overlaid("entries", sort, entries, spare=1.0)
        self._bins = Binned(*bins)
        self.clusters = make_clusters(
            n_clusters, self._columns, self.lanes, (bottom, top, boxes_now), memory, spare
        )
        self.ghosts = make_ghosts(n_clusters, n_ghosts, n_in_windows, for_search, memory)
        start = memory.array("row start", np.int32, len(self.clusters.atom), spare=spare)
        stops = memory.array("row stops", np.int32, LAYERS * len(start), spare=spare).reshape(
            LAYERS, -1
        )
        self.rows = Rows(
            start,
            stops,
            self._entries,
            (self.cutoff + self._widths) ** 2,
            np.zeros(LAYERS),
            (0.5 * self._widths) ** 2,
            self._layers,
        )
        self.memory = ClusterMemory(
            self._coordinates,
            self._shifts,
            memory.array(
                "forces",
                np.int64 if self._is_fixed else np.float64,
                n_forces * n_block,
                in_page=HALF_A_PAGE,
                spare=1.0,
            ),
            memory.array("first sum", np.int64, n_in_windows if self._is_fixed else 0),
            self._far,
            np.zeros(self.n_domains * self._is_fixed, dtype=np.int64),
            np.zeros(self.n_domains, dtype=np.int64),
        )
        self._arrange_building()

    def _arrange_building(self) -> None:
        """What operations and the loop get."""
        self.arrays = ClusterArrays(
            self.clusters, self.domains.cluster, self.domains, self.ghosts, self.rows, self.memory
        )
        goes_along = self._pool.n_threads == 1 and not self._is_fixed
        self.building = Building(
            self._positions,
            self.arrays,
            self._bins,
            Layout(
                self._columns,
                self.clusters,
                self.domains,
                self.ghosts,
                self._coordinates,
                self._shifts,
            ),
            self._room[2],
            min(int(self._columns.counts[0]), MOST_CHUNKS),
            int(goes_along),
            self._entry_start,
            self._needed,
            NO_PARTNERS if self._excluded is None else self._excluded,
            self._slot_of,
            self._images,
        )
        self.version += 1
