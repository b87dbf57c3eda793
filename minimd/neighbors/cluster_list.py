"""The cluster list with a skin: rows of clusters for the vector loop, and the memory that the loop works on."""

from collections import namedtuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import DirectCalls, by_type, kernel, scalar
from minimd.compiled.simd import broadcast, convert, lane, load, store, with_lane
from minimd.compiled.simd.lanes import DOUBLE, MIXED, count, lanes_for
from minimd.compiled.threads import ThreadPool
from minimd.neighbors.binning import Binned
from minimd.neighbors.buffers import HALF_A_PAGE, SPARE, Buffers, with_room
from minimd.neighbors.cluster_build import Building, build_clusters
from minimd.neighbors.cluster_search import AHEAD, GHOST_BITS, LAYERS, Rows, exclude_pairs
from minimd.neighbors.clusters import (
    DIMENSIONS,
    Clusters,
    Columns,
    any_moved_from_clusters,
    bins_for_sort,
    clusters_for_build,
    columns_fit,
    gathered,
    loaded,
    make_clusters,
    make_columns,
    most_clusters,
    moved_columns,
    offsets_of,
    region_of,
)
from minimd.neighbors.domains import (
    BLOCKS,
    IMAGES,
    SIDES,
    Domains,
    GhostClusters,
    Layout,
    ghosts_for_search,
    make_domains,
    make_ghosts,
)
from minimd.neighbors.verlet_list import VerletList, partners
from minimd.structure.cell import Cell
from minimd.structure.strain import strained

ENTRIES_GUESSED = 12  # for each atom, at first
GRID = 2.0**31  # steps of the coordinates in mixed precision, from one end of the scene to the other
COARSEST = 1e-6  # of the cutoff: on a coarser grid, coordinates are rounded more than float32 rounds their differences


class Memory(ByAddress, namedtuple("Memory", "coordinates shift origin unit forces first_sum far net")):
    """What the loop reads and writes; coordinates are in the precision of the pair arithmetic,
    see separation in cluster_loop.

    coordinates, forces : flat, a block for each ghost, and for each ghost in a window.
    shift : (IMAGES, 3) of each image, as the coordinates.  origin : (3,) [length] and unit [length]:
        coordinate = (x − origin) / unit.
    first_sum : (W,) int64, what sums of forces begin with in fixed-point arithmetic, filled by the loop; else empty.
    far : flat, n numbers for each set of lanes: 0 for lanes in it, ∞ for others,
        which are then infinitely far [length²].
    net : (K, 3); in mixed precision the sum of the forces on the atoms of each domain [energy/length]; in fixed-point
        arithmetic not zero where a force (first column) or a momentum (second) of the domain has left its range.
    """


class ClusterArrays(ByAddress, namedtuple("ClusterArrays", "clusters domain_start domains ghosts rows memory")):
    """What the loop over clusters gets from the list.  domain_start : (K + 1,) int, first cluster of each domain."""


class ClusterList(VerletList):
    """Clusters with an atom within cutoff + skin of each atom.

    Each row has two layers: what is within cutoff + skin/2, which is enough until an atom has moved by skin/4, and the
    rest. So rows are short at first. What is left out then would add zeros: forces have the same bits either way.

    It needs a cell whose periodic heights are at least cutoff + skin, and a finite cutoff.

    cutoff, skin : see VerletList.  excluded : (P, 2) int, pairs whose nearest image is left out.
    precision : see Options.  pool : the threads that build it.
    lanes : of its vectors.  clusters, domains, ghosts, rows, memory : see there.  n_domains :
        number of chunks of a task.
    arrays : what the loop needs of them. They have room for more, and are the same arrays until it is used up.
    n_arranged : how often they were replaced.  building : what build_clusters needs.
    idle : flat, a block for each cluster, memory that is free between two builds.
    """

    clusters: Clusters
    domains: Domains
    ghosts: GhostClusters
    rows: Rows
    memory: Memory
    arrays: ClusterArrays
    building: Building
    _columns: Columns
    _bins: Binned
    _entries: NDArray[np.uint32]
    _exact: NDArray[np.float64]
    idle: NDArray[np.float64]

    def __init__(
        self, n_atoms: int, cutoff: float, skin: float, excluded: NDArray[np.int64], precision: str, pool: ThreadPool
    ) -> None:
        super().__init__(cutoff, skin)
        self._excluded = partners(excluded, n_atoms) if len(excluded) else None
        self._widths = (
            self.skin * np.arange(1, LAYERS + 1) / LAYERS
        )  # how much farther than the cutoff the layers reach
        self._n_atoms, self._pool, self._is_mixed, self._is_fixed = (
            n_atoms,
            pool,
            precision == "mixed",
            precision == "fixed-point",
        )
        self._columns_of: tuple[Cell, NDArray[np.float64]] | None = None
        self._calls = DirectCalls()
        self.lanes = lanes_for(MIXED if self._is_mixed else DOUBLE)
        self._room: tuple[int, ...] = (0, 0, 0)
        self._entry_start, self._shifts = np.zeros(1, dtype=np.int64), np.zeros((IMAGES, DIMENSIONS))
        self._memory, self.n_arranged = Buffers(), 0
        sets = far(self.lanes.size)
        self._far = self._memory.array("far", np.float32 if self._is_mixed else np.float64, len(sets))
        self._far[:] = sets

    def _has_moved(self, positions: NDArray[np.float64]) -> bool:
        layers = self.rows.layers
        while self._calls(any_moved_from_clusters, positions, self.clusters, self.rows.limits2[layers[0] - 1]):
            if layers[0] == LAYERS:
                return True
            layers[0] += 1
        return False

    def _built_at(self) -> NDArray[np.float64]:
        clusters, n_lanes, n = self.clusters, self.lanes.size, self.n_clusters
        positions, real = np.empty((self._n_atoms, DIMENSIONS)), np.arange(n_lanes) < clusters.filled[:n, None]
        positions[clusters.atom[: n * n_lanes][real.ravel()]] = self._blocks(clusters.origins).transpose(0, 2, 1)[real]
        return positions

    def _blocks(self, flat: NDArray[np.float64]) -> NDArray[np.float64]:
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

    @property
    def can_be_renewed(self) -> bool:
        """Whether a kernel can do what update does: on one thread, in columns that there are, and with nothing that
        a build does after build_clusters.
        """
        stays = self._cell is not None and self._columns_of is not None and self._cell.same_as(self._columns_of[0])
        return stays and self._pool.n_threads == 1 and self._excluded is None and not self._is_mixed

    def renewed(self, n: int) -> None:
        """So many lists were built by a kernel. rows.layers is zero if it has left none that can be used."""
        self.n_builds += n
        if n > 0:
            self._built_in, self._stretch = self._cell, 1.0
        if self.rows.layers[0] == 0:
            self._cell = None

    def _strain(self, strain: NDArray[np.float64], before: Cell, cell: Cell) -> None:
        if self.clusters.origins is self.clusters.positions:
            self._keep_origins()
        strained(self._blocks(self.clusters.origins), strain, self._blocks(self.clusters.positions))
        self.clusters.wrapping.lattice[:] = cell.lattice
        before.follow(cell, self._shifts)
        if self._is_mixed:
            self.memory.shift[:] = np.rint(self._shifts / self.memory.unit)
        self.rows.limits2[:] = [self._limit2(width) for width in self._widths]
        if self._region is not None and moved_columns(self._columns, self._columns_in(cell, self._region)):
            self._columns_of = cell, self._region

    def _keep_origins(self) -> None:
        """Memory of their own for the origins of clusters, of which the positions so far are a copy."""
        origins = self._memory.array("origins", np.float64, len(self.clusters.positions))
        origins[:] = self.clusters.positions
        self.clusters = self.clusters._replace(origins=origins)
        self.building = self.building._replace(layout=self.building.layout._replace(clusters=self.clusters))
        self.arrays = self.arrays._replace(clusters=self.clusters)

    def _columns_in(self, cell: Cell, region: NDArray[np.float64]) -> Columns:
        return make_columns(cell, self._n_atoms, self.cutoff + self.skin, self.lanes, region)

    def _lay_columns(self, cell: Cell, region: NDArray[np.float64]) -> None:
        of = self._columns_of
        if of is None or not (cell.same_as(of[0]) and np.array_equal(region, of[1])):
            columns = self._columns_in(cell, region)
            if of is None or not moved_columns(self._columns, columns):
                self._columns = columns
                self._make_clusters()
            self._columns_of = cell, region
        self._region = region

    def _build(self, positions: NDArray[np.float64], cell: Cell) -> None:
        reach = self.cutoff + self.skin
        self._lay_columns(cell, region_of(cell, positions, reach) if self._region is None else self._region)
        if not self._calls(columns_fit, positions, self._columns):
            self._lay_columns(cell, region_of(cell, positions, reach))
        while not self._pool.run(build_clusters, positions, self.building, calls=self._calls):
            columns_of, self._columns_of = self._columns_of, None  # what follows may fail: a whole list or none
            self._make_room()
            self._columns_of = columns_of
        if self._is_mixed:
            self._lay_grid()
        if self._excluded is not None:
            slot_of, image = (
                self._memory.array("slot of", np.int64, len(positions)),
                (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2),
            )
            self._pool.run(
                exclude_pairs, self.building.layout, image, self._excluded, slot_of, self.rows, calls=self._calls
            )
        self.rows.layers[0] = 1

    def _make_clusters(self) -> None:
        """Memory for other columns."""
        self.domains = make_domains(self._columns, self._n_atoms)
        self.n_domains = len(self.domains.first)
        self._needed = np.zeros(self.n_domains, dtype=np.int64)
        self._arrange()

    def _make_room(self) -> None:
        """More memory, after a build that has found how much it needs."""
        window = self.domains.window
        needed = self.n_ghosts, int(window[-1]), int(self.domains.numbers[BLOCKS])
        widest, is_enough = (
            int(np.diff(window).max()),
            all(n <= room for n, room in zip(needed, self._room, strict=True)),
        )
        if widest > GHOST_BITS:
            raise ValueError(
                f"cluster lists hold up to {GHOST_BITS} ghost clusters of a domain, this scene needs {widest}: "
                "simulate fewer atoms"
            )
        self._room = tuple(room if n <= room else with_room(n) for n, room in zip(needed, self._room, strict=True))
        if len(self._entry_start) != self.n_domains + 1:
            self._make_entries(np.diff(self.domains.cluster) * self.lanes.size * ENTRIES_GUESSED)
        elif is_enough:
            self._make_entries(np.maximum(np.diff(self._entry_start), [with_room(n) for n in self._needed.tolist()]))
        self._arrange()

    def _make_entries(self, room: NDArray[np.int64]) -> None:
        """Room for so many entries of each domain."""
        start, most = np.concatenate([[0], np.cumsum(room)]), np.iinfo(np.int32).max
        if start[-1] > most:
            raise ValueError(
                f"cluster lists hold up to {most} entries, this scene needs {start[-1]}: reduce cutoff or skin, or "
                "simulate fewer atoms"
            )
        self._entry_start = start
        del (
            self._entries,
            self._bins,
            self.rows,
            self.arrays,
            self.building,
        )  # they hold the old memory, and _arrange takes the new

    def _arrange(self) -> None:
        """All arrays, with the room that there is now."""
        self._share_memory()
        start = self._memory.array("row start", np.int32, len(self.clusters.atom), spare=self._spare)
        stops = self._memory.array("row stops", np.int32, LAYERS * len(start), spare=self._spare).reshape(LAYERS, -1)
        reaches2, limits2 = (self.cutoff + self._widths) ** 2, (0.5 * self._widths) ** 2
        self.rows = Rows(start, stops, self._entries, reaches2, np.zeros(LAYERS), limits2, np.zeros(1, dtype=np.int64))
        number, n_block = (
            np.float32 if self._is_mixed else np.int64 if self._is_fixed else np.float64,
            self.lanes.size * DIMENSIONS,
        )
        forces = self._memory.array("forces", number, self._room[2] * n_block, in_page=HALF_A_PAGE, spare=1.0)
        first_sum = self._memory.array("first sum", np.int64, self._room[1] if self._is_fixed else 0)
        net, coordinates, shift = (
            np.zeros((self.n_domains if self._is_mixed or self._is_fixed else 0, 3)),
            self._exact,
            self._shifts,
        )
        if self._is_mixed:
            coordinates, shift = (
                self._memory.array("grid", np.int32, len(self._exact), spare=1.0),
                np.zeros((IMAGES, 3), dtype=np.int32),
            )
        layout = Layout(self._columns, self.clusters, self.domains, self.ghosts, self._exact, self._shifts)
        goes_along = self._pool.n_threads == 1 and not (self._is_mixed or self._is_fixed)
        self.building = Building(
            self._bins, layout, self.rows, self._room[2], int(goes_along), self._entry_start, self._needed
        )
        self.memory = Memory(coordinates, shift, np.zeros(3), 1.0, forces, first_sum, self._far, net)
        self.arrays = ClusterArrays(
            self.clusters, self.domains.cluster, self.domains, self.ghosts, self.rows, self.memory
        )
        self.n_arranged += 1

    @property
    def _spare(self) -> float:
        """Room to spare where there is enough for all atoms, however they stand: for other columns,
        which are needed where columns go along with the atoms."""
        return 1.0 if self._columns.is_crossed.all() else SPARE

    def _share_memory(self) -> None:
        """Arrays of clusters and ghosts, and the entries of rows. What only the search needs shares memory with idle.

        Atoms are sorted where the entries are written afterwards.
        """
        memory, spare, (n_ghosts, n_in_windows, _) = self._memory, self._spare, self._room
        n_clusters, n_coordinates = (
            most_clusters(self._n_atoms, self._columns, self.lanes),
            n_ghosts * self.lanes.size * DIMENSIONS,
        )
        own, exact = (
            (np.float64, (n_clusters * self.lanes.size * DIMENSIONS,)),
            (np.float64, (n_coordinates if self._is_mixed else 0,)),
        )
        always, search = clusters_for_build(n_clusters), (*ghosts_for_search(n_ghosts, n_in_windows), exact)
        (bottom, top, boxes, *for_search, in_mixed), (self.idle,) = memory.overlaid(
            "scratch", (*always, *search), (own,), spare=spare
        )
        n_entries = max(int(self._entry_start[-1]), n_clusters * self.lanes.size * ENTRIES_GUESSED) + AHEAD
        bins, (self._entries,) = memory.overlaid(
            "entries", bins_for_sort(self._n_atoms, self._columns), ((np.uint32, (n_entries,)),), spare=1.0
        )
        self._bins, self._exact = (
            Binned(*bins),
            in_mixed if self._is_mixed else memory.array("coordinates", np.float64, n_coordinates, spare=1.0),
        )
        self.clusters = make_clusters(n_clusters, self._columns, self.lanes, (bottom, top, boxes), memory, spare)
        self.ghosts = make_ghosts(n_clusters, n_ghosts, n_in_windows, for_search, memory)

    def _lay_grid(self) -> None:
        """The grid of mixed precision."""
        origin, in_units = self.memory.origin, self.memory.shift
        unit = self._calls(
            lay_grid,
            self.n_ghosts,
            self.ghosts.boxes,
            self._shifts,
            self.cutoff + self.skin,
            self.skin,
            origin,
            in_units,
        )
        if unit > COARSEST * self.cutoff:
            width, limit = unit * GRID, COARSEST * self.cutoff
            raise ValueError(
                f"precision='mixed' resolves {unit:.1e} in a scene {width:.3g} wide, coarser than {limit:.1e}; take "
                "precision='double'"
            )
        self.memory = self.memory._replace(unit=unit)
        self.arrays = self.arrays._replace(memory=self.memory)


def far(n_lanes: int) -> NDArray[np.float64]:
    """Memory.far for all sets of n lanes; bit k of the number of a set stands for lane k."""
    sets = np.arange(1 << n_lanes)[:, None] >> np.arange(n_lanes) & 1
    return np.where(sets, 0.0, np.inf).ravel()


@kernel
def lay_grid(n, boxes, shifts, reach, skin, origin, in_units):
    """The grid of mixed precision: its origin (3,) and shifts (IMAGES, 3) in units are written, the unit is returned.
    boxes : of n ghosts."""
    unit, stride = 0.0, boxes.size // SIDES
    for c in range(3):
        low, high = np.inf, -np.inf
        for m in range(n):
            low, high = min(low, boxes[c * stride + m]), max(high, boxes[(c + 3) * stride + m])
        origin[c] = 0.5 * (low + high) * reach
        unit = max(unit, ((high - low) * reach + 2.0 * skin) / GRID)
    for image in range(IMAGES):
        for c in range(3):
            in_units[image, c] = np.int32(np.rint(shifts[image, c] / unit))
    return unit


@scalar
def gather(k, clusters, of_atoms, block, start):
    """Three numbers of each atom of cluster k, from (N, 3) to a flat array of blocks, from index start on."""
    for c, x in enumerate(gathered(k, clusters, of_atoms)):
        store(block, start + c * count(clusters.lanes), x)


@scalar
def place(k, arrays, at):
    """Positions of the atoms of cluster k, vectors x, y, z [length], to all its ghosts.

    Indices are unsigned: none counts from the end.
    """
    ghosts, memory, lanes, n_lanes = (
        arrays.ghosts,
        arrays.memory,
        arrays.clusters.lanes,
        np.uintp(count(arrays.clusters.lanes)),
    )
    like, block = load(memory.coordinates, 0, lanes), np.uintp(DIMENSIONS) * n_lanes
    x, y, z = offsets_of(np.uintp(k) * block, arrays.clusters)
    x = coordinate(at[0] + x, memory.origin[0], memory.unit, like)
    y = coordinate(at[1] + y, memory.origin[1], memory.unit, like)
    z = coordinate(at[2] + z, memory.origin[2], memory.unit, like)
    for p in range(np.uintp(ghosts.start[k]), np.uintp(ghosts.start[k + 1])):
        m = np.uintp(ghosts.of[p])
        image = np.uintp(ghosts.image[m])
        store(memory.coordinates, m * block, x + memory.shift[image, 0])
        store(memory.coordinates, m * block + n_lanes, y + memory.shift[image, 1])
        store(memory.coordinates, m * block + n_lanes + n_lanes, z + memory.shift[image, 2])


@by_type
def coordinate(x, origin, unit, like):
    """A vector of coordinates x [length] as an array of coordinates holds it, see Memory; like :
    a vector from that array."""
    if like.is_float:
        return lambda x, origin, unit, like: x
    lanes = x.lanes

    def on_grid(x, origin, unit, like):
        for k in range(lanes):
            like = with_lane(like, k, np.int32(np.rint((lane(x, k) - origin) / unit)))
        return like

    return on_grid


@scalar
def clear(domain, arrays):
    """Forces on all ghosts in the window of a domain = 0, or first_sum.

    Who adds to them does so, and has them in its cache then.
    """
    lanes, n_lanes, forces, domains = (
        arrays.clusters.lanes,
        count(arrays.clusters.lanes),
        arrays.memory.forces,
        arrays.domains,
    )
    first = domains.place[domain]
    for block in range(first, first + domains.window[domain + 1] - domains.window[domain]):
        nothing = broadcast(_first_sum(block, arrays.memory.first_sum, forces), load(forces, 0, lanes))
        for c in range(DIMENSIONS):
            store(forces, (block * DIMENSIONS + c) * n_lanes, nothing)


@by_type
def _first_sum(block, first_sum, forces):
    """What the sum of the forces in a block begins with."""
    if isinstance(forces.dtype, types.Float):
        return lambda block, first_sum, forces: 0.0
    return lambda block, first_sum, forces: first_sum[block]


@scalar
def collected(k, arrays):
    """The forces on the atoms of cluster k, sums of those on its ghosts in all windows: vectors x, y,
    z in double precision, or of int64."""
    ghosts, forces, lanes = arrays.ghosts, arrays.memory.forces, arrays.clusters.lanes
    block, first = np.uintp(DIMENSIONS * count(lanes)), np.uintp(ghosts.part_start[k])
    x, y, z = loaded(forces, np.uintp(ghosts.parts[first]) * block, lanes)
    x, y, z = in_full(x), in_full(y), in_full(z)
    for p in range(first + np.uintp(1), np.uintp(ghosts.part_start[k + 1])):
        more_x, more_y, more_z = loaded(forces, np.uintp(ghosts.parts[p]) * block, lanes)
        x, y, z = x + in_full(more_x), y + in_full(more_y), z + in_full(more_z)
    return x, y, z


@by_type
def in_full(force):
    """A vector of forces in double precision; whole numbers as they are."""
    return (lambda force: convert(force, 0.0)) if force.is_float else lambda force: force


@by_type
def is_mixed(arrays):
    """Whether the pair arithmetic is float32, as a constant for the compiler."""
    answer = arrays[-1].types[-2].dtype == types.float32
    return lambda arrays: answer
