"""The cluster list with a skin: rows of clusters for the vector loop."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from minimd.core.compiled.kernels import DirectCalls, code_for, types_of
from minimd.core.compiled.program import Operation, Program, operation
from minimd.core.compiled.simd.vector import lanes_for
from minimd.core.compiled.threads import MOST_CHUNKS, ThreadPool
from minimd.core.neighbors import cluster_build
from minimd.core.neighbors.cluster_build import Building, follow_strain
from minimd.core.neighbors.cluster_search import BUILDS, IN_USE, LAYERS
from minimd.core.neighbors.cluster_store import ClusterStore
from minimd.core.neighbors.clusters import DIMENSIONS, Columns, make_columns, region_of
from minimd.core.neighbors.verlet_list import VerletList, partners, raise_not_finite
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell, Images

NO_PARTNERS = np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)


class ClusterList(VerletList):
    """Clusters with an atom within cutoff + skin of each atom.

    Each row has two layers: what is within cutoff + skin/2, which is enough until an atom has moved by skin/4, and the
    rest. So rows are short at first. What is left out then would add zeros: forces have the same bits either way.

    It needs a cell whose periodic heights are at least cutoff + skin, and a finite cutoff.
    cutoff, skin : see VerletList.
    excluded : (P, 2) int, pairs whose nearest image is left out.
    is_fixed : whether forces are summed as whole numbers.
    pool : the threads that build it.
    n_domains : number of chunks of an operation.
    lanes : of its vectors.
    arrays : what the loop needs; clusters, domains, ghosts and memory are in it.
    version : how often these were replaced.
    building : what operations need."""

    _columns: Columns

    def __init__(
        self,
        n_atoms: int,
        cutoff: float,
        skin: float,
        excluded: Indices,
        is_fixed: bool,
        pool: ThreadPool,
    ) -> None:
        super().__init__(cutoff, skin)
        self.lanes = lanes_for()
        self._n_atoms = n_atoms
        self._reach = cutoff + skin
        self._pool = pool
        self._has_excluded = len(excluded) > 0
        self._excluded = partners(excluded, n_atoms) if self._has_excluded else NO_PARTNERS
        self._slot_of = np.zeros(n_atoms * self._has_excluded, dtype=np.int64)
        self._goes_along = pool.n_threads == 1 and not is_fixed

        # by which the layers reach beyond the cutoff
        self._widths = self.skin * np.arange(1, LAYERS + 1) / LAYERS
        reaches2 = (cutoff + self._widths) ** 2
        limits2 = (0.5 * self._widths) ** 2
        self._store = ClusterStore(n_atoms, self.lanes, is_fixed, reaches2, limits2)
        self._layers = self._store.layers

        self._n_counted = 0  # builds
        self._columns_of: tuple[Cell, Array] | None = None
        self._images = Images.of(Cell.of(None))
        self._positions = np.zeros((n_atoms, DIMENSIONS))  # where the operations find them
        self._calls = DirectCalls()
        self._follow: Callable | None = None  # code of follow_strain
        self._program = Program(self.operations, lambda: self.version, pool)

    def operations(self) -> Iterator[Operation]:
        """Atoms to their clusters and ghosts; a new list where it is due; see cluster_build.  Memory must be ready."""
        n = self.n_domains
        build = [
            (cluster_build.find_columns, 1, self._refit),
            (cluster_build.sort_atoms, 1, None),
            (cluster_build.cut_columns, self.building.n_chunks, None),
            (cluster_build.find_domains, 1, self._fit),
            (cluster_build.place_ghosts, n, None),
            (cluster_build.list_rows, n, self._fit),
            (cluster_build.finish_list, 1, None),
        ]
        if self._has_excluded:
            build += [(cluster_build.number_slots, n, None), (cluster_build.exclude_pairs, n, None)]

        after = 1 + len(build)
        of_list = partial(operation, self._calls, data=self.building, is_kept=True)
        refuse = lambda _answer: raise_not_finite(self._positions)  # noqa: E731
        yield of_list(cluster_build.place_atoms, n_chunks=n)
        yield of_list(cluster_build.is_valid, otherwise=after, python=refuse)

        for k, (kernel, n_chunks, remedy) in enumerate(build, start=2):
            # in the end to place_atoms; after a remedy to sort_atoms
            then = 1 if k < after else -k
            yield of_list(kernel, n_chunks=n_chunks, then=then, python=remedy, again=3 - k)

    def ready(self, positions: Array, cell: Cell) -> None:
        """See VerletList: memory; without a list of this cell, the operations build one."""
        cell_of_columns = None if self._columns_of is None else self._columns_of[0]
        # mostly the same object
        is_same = [
            other is cell or (other is not None and cell.same_as(other))
            for other in (self._cell, cell_of_columns)
        ]
        if not all(is_same):
            self._begin(positions, cell)
        elif positions is not self._positions:
            self._positions = positions
            self._share()

    def _begin(self, positions: Array, cell: Cell) -> None:
        """Memory for a new list of atoms at these positions."""
        self._positions = positions
        self._cell = cell
        self._built_in = cell
        self._stretch = 1.0
        self._layers[IN_USE] = 0
        self._images.take(cell)
        region = region_of(cell, positions, self._reach) if self._region is None else self._region
        self._lay_columns(cell, region)
        if self.building.positions is not positions:
            self._share()

    def _lay_columns(self, cell: Cell, region: Array) -> None:
        """Columns of a region of a cell."""
        columns_of = self._columns_of
        is_laid = (
            columns_of is not None
            and cell.same_as(columns_of[0])
            and np.array_equal(region, columns_of[1])
        )
        if not is_laid:
            columns = make_columns(cell, self._n_atoms, self._reach, self.lanes, region)
            if columns_of is None or not self._columns.move_to(columns):
                self._columns = columns
                self._fit()
            self._columns_of = cell, region
        self._region = region

    def _refit(self, _answer: int) -> None:
        """Columns where the atoms are now."""
        if self._cell is not None:
            self._lay_columns(self._cell, region_of(self._cell, self._positions, self._reach))

    def _fit(self, _answer: int = 0, is_strained: bool = False) -> None:
        """Memory for the columns, and for what a build has found that it needs."""
        columns_of = self._columns_of
        self._columns_of = None  # what follows may fail: a whole list or none
        self._store.fit(self._columns, is_strained)
        self._columns_of = columns_of
        self._share()

    def _share(self) -> None:
        """What operations and the loop get."""
        store = self._store
        self.arrays = store.arrays
        self.clusters = self.arrays.clusters
        self.domains = self.arrays.domains
        self.ghosts = self.arrays.ghosts
        self.memory = self.arrays.memory
        self.n_domains = len(self.domains.first)

        self.building = Building(
            self._positions,
            self.arrays,
            store.binned,
            int(store.room[-1]),
            min(int(self._columns.counts[0]), MOST_CHUNKS),
            int(self._goes_along),
            store.entry_start,
            store.needed,
            self._excluded,
            self._slot_of,
            self._images,
        )
        self.version += 1

    def settle(self) -> None:
        """After operations: what they have done to the list."""
        n_built = int(self._layers[BUILDS]) - self._n_counted
        if n_built:
            self.n_builds += n_built
            self._n_counted += n_built
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
        self._begin(positions, cell)
        self._program.run()
        self._n_counted = int(self._layers[BUILDS])  # the caller counts

    def _built_at(self) -> Array:
        n = self.n_clusters
        positions = np.empty((self._n_atoms, DIMENSIONS))
        is_atom = np.arange(self.lanes.size) < self.clusters.filled[:n, None]
        atoms = self.clusters.atom[: is_atom.size][is_atom.ravel()]
        positions[atoms] = self._blocks(self.clusters.origins).transpose(0, 2, 1)[is_atom]
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

    def _strain(self, strain: Array, _before: Cell, cell: Cell) -> None:
        if self.clusters.origins is self.clusters.positions:  # from now on they are not the same
            self._fit(is_strained=True)
            self.clusters.origins[:] = self.clusters.positions
        self.arrays.rows.limits2[:] = [self._limit2(width) for width in self._widths]
        region: Any = self._region
        arguments = self.building, strain, cell.lattice, cell.inverse, cell.heights, region
        if self._follow is None:
            self._follow = code_for(follow_strain, types_of(arguments))
        if self._follow(*arguments):
            self._columns_of = cell, region
