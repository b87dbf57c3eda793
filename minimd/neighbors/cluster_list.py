"""The cluster list with a skin: rows of clusters for the vector loop, and the memory that the loop works on."""

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel, scalar, shared_kernel
from minimd.compiled.simd import broadcast, convert, load, store
from minimd.compiled.threads import ThreadPool, begin, finish_and_take, take, wait
from minimd.forces.cluster_loop import BLOCK, COPY_BITS, LANES, Rows
from minimd.neighbors.buffers import SPARE, Buffers
from minimd.neighbors.cluster_search import exclude_pairs, find_rows, make_work
from minimd.neighbors.clusters import Clusters, make_columns, sort_into_clusters
from minimd.neighbors.domains import Chunks, Copies, cut_into_chunks, fill_copies, sort_copies
from minimd.neighbors.verlet_list import VerletList
from minimd.structure.cell import Cell

ENTRIES_GUESSED = 12  # for each atom, at first
GRID = 2.0**31  # steps of the coordinates in mixed precision, from one end of the scene to the other
COARSEST = 1e-6  # of the cutoff: a coarser grid would not be worth the name of single precision


class Memory(NamedTuple):
    """What the loop reads and writes; the coordinates in the precision of the pair arithmetic, see separation in cluster_loop.

    coordinates, forces : flat, BLOCK numbers for each copy.
    shift : (M, 3) of each copy, as the coordinates.  origin : (3,) [length] and unit [length]: coordinate = (x − origin) / unit.
    """

    coordinates: Any
    shift: Any
    origin: Any
    unit: float
    forces: Any


class ClusterList(VerletList):
    """Clusters with an atom within cutoff + skin of each atom.

    It needs a cell whose periodic heights are at least cutoff + skin, and a finite cutoff.

    Parameters
    ----------
    cutoff, skin, excluded : see VerletList.  is_mixed : whether the pair arithmetic is float32.  team : who builds it.

    Attributes
    ----------
    clusters, chunks, copies, rows, memory : see there.  n_builds : how often it was built.
    """

    clusters: Clusters
    chunks: Chunks
    copies: Copies
    rows: Rows
    memory: Memory

    def __init__(self, n_atoms: int, cutoff: float, skin: float, excluded: NDArray[np.int64], is_mixed: bool, team: ThreadPool) -> None:
        super().__init__(n_atoms, cutoff, skin, excluded)
        self._team, self._is_mixed = team, is_mixed
        self._columns_of: Cell | None = None
        self._entry_start, self._entries = np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.uint32)
        self._memory = Buffers()

    @property
    def n_chunks(self) -> int:
        """Shares of work."""
        return len(self.chunks.run) - 1

    def _build(self, positions: NDArray[np.float64], cell: Cell) -> None:
        reach = self.cutoff + self.skin
        if self._columns_of is None or not (cell.pbc.all() and cell.same_as(self._columns_of)):
            self._columns, self._columns_of = make_columns(cell, positions, reach), cell
        columns = self._columns
        self.clusters = clusters = sort_into_clusters(positions, cell, columns, self._memory, self._team)
        self.chunks = chunks = cut_into_chunks(clusters, columns, len(positions), cell.pbc)
        n_chunks, n_clusters, n_copies = len(chunks.run) - 1, len(clusters.filled), int(chunks.copy[-1])
        if n_copies > COPY_BITS:
            raise ValueError(f"cluster lists hold up to {COPY_BITS} clusters with their copies, this scene needs {n_copies}: simulate fewer atoms")
        self.copies = copies = _make_copies(n_clusters, n_copies, self._memory)
        exact = self._memory.array("coordinates", np.float64, n_copies * BLOCK)
        start, stop = (self._memory.array(name, np.int32, n_clusters * LANES) for name in ("row start", "row stop"))
        if len(self._entry_start) != n_chunks + 1:
            self._make_entries(np.diff(chunks.cluster) * LANES * ENTRIES_GUESSED)
        needed = np.zeros(n_chunks, dtype=np.int64)
        while True:
            self.rows = Rows(start, stop, self._entries)
            scene = (chunks, clusters, columns, cell.pbc, cell.lattice, copies, exact, reach, self.rows)
            self._team.run(_build_chunks, *scene, self._entry_start, needed)
            if np.all(needed <= np.diff(self._entry_start)):
                break
            self._make_entries(np.maximum(np.diff(self._entry_start), (SPARE * needed).astype(np.int64)))
        sort_copies(copies)
        self.memory = self._make_memory(exact)
        if self.has_excluded:
            self._exclude(cell)

    def _make_memory(self, exact: NDArray[np.float64]) -> Memory:
        copies, number = self.copies, np.float32 if self._is_mixed else np.float64
        (forces,) = self._memory.carve("scratch", (number, (len(exact),)))  # sorting is over
        if not self._is_mixed:
            return Memory(exact, copies.shift, np.zeros(3), 1.0, forces)
        shift = self._memory.array("grid shift", np.int32, len(copies.owner), 3)
        origin = np.empty(3)
        unit = lay_grid(copies, self.skin, origin, shift)
        if unit > COARSEST * self.cutoff:
            width, limit = unit * GRID, COARSEST * self.cutoff
            raise ValueError(f"precision='mixed' resolves {unit:.1e} in a scene {width:.3g} wide, coarser than {limit:.1e}; take precision='double'")
        return Memory(self._memory.array("grid", np.int32, len(exact)), shift, origin, unit, forces)

    def _make_entries(self, room: NDArray[np.int64]) -> None:
        """Room for the entries of each chunk."""
        start, most = np.concatenate([[0], np.cumsum(room)]), np.iinfo(np.int32).max
        if start[-1] > most:
            raise ValueError(f"cluster lists hold up to {most} entries, this scene needs {start[-1]}: reduce cutoff or skin, or simulate fewer atoms")
        self._entry_start = start
        self._entries = np.empty(self._entry_start[-1], dtype=np.uint32)

    def _exclude(self, cell: Cell) -> None:
        slot_of = self._memory.array("slot of", np.int64, len(self._built_at))
        image = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
        partners = (self._excluded_start, self._excluded)
        self._team.run(exclude_pairs, self.clusters, self.chunks.cluster, self.copies, image, *partners, slot_of, self.rows)


@shared_kernel
def _build_chunks(me, task, chunks, clusters, columns, pbc, lattice, copies, coordinates, reach, rows, entries, needed):
    """Copies and rows of all chunks; needed : (K,) int, output, entries of each chunk, which may be more than there is room for."""
    n, work = needed.size, make_work(chunks, columns)
    phase = begin(me, task)
    chunk = take(me, phase, n)
    while chunk >= 0:
        fill_copies(chunk, chunks, clusters, columns, pbc, lattice, copies, coordinates)
        room = (entries[chunk], entries[chunk + 1])
        needed[chunk] = find_rows(chunk, chunks, clusters, columns, copies, coordinates, reach, rows, room, work)
        chunk = finish_and_take(me, phase, n)
    wait(me, phase)


@kernel
def lay_grid(copies, skin, origin, shift):
    """The grid of mixed precision: its origin (3,) and the shift of each copy (M, 3) in units are written, the unit is returned."""
    unit = 0.0
    for c in range(3):
        low, high = np.inf, -np.inf
        for m in range(shift.shape[0]):
            low, high = min(low, copies.boxes[m, c]), max(high, copies.boxes[m, c + 3])
        origin[c] = 0.5 * (low + high)
        unit = max(unit, (high - low + 2.0 * skin) / GRID)
    for m in range(shift.shape[0]):
        for c in range(3):
            shift[m, c] = np.int32(np.rint(copies.shift[m, c] / unit))
    return unit


@scalar
def gather(first, last, clusters, copies, positions, memory):
    """Positions of the atoms of clusters first to last, to all copies of them; forces there = 0."""
    nothing = broadcast(0.0, load(memory.forces, 0, LANES))
    for k in range(first, last):
        home = copies.home[k] * BLOCK
        for lane in range(LANES):
            slot = k * LANES + lane
            for c in range(3):
                x = positions[clusters.atom[slot], c] + clusters.offsets[slot, c]
                memory.coordinates[home + c * LANES + lane] = coordinate(x, memory.origin[c], memory.unit, memory.coordinates)
        for p in range(copies.start[k], copies.start[k + 1]):
            m = copies.of[p]
            for d in range(3):
                c = d * LANES
                store(memory.coordinates, m * BLOCK + c, load(memory.coordinates, home + c, LANES) + memory.shift[m, d])
                store(memory.forces, m * BLOCK + c, nothing)


def coordinate(x, origin, unit, coordinates):
    """A coordinate x [length] as an array of coordinates holds it, see Memory."""
    raise NotImplementedError


@overload(coordinate)
def _coordinate(x, origin, unit, coordinates):
    if isinstance(coordinates.dtype, types.Float):
        return lambda x, origin, unit, coordinates: x
    return lambda x, origin, unit, coordinates: np.int32(np.rint((x - origin) / unit))


@scalar
def scatter(first, last, clusters, copies, memory, forces, work):
    """forces (N, 3) += what the loop found for the atoms of clusters first to last, on all copies of them. work : (BLOCK,) float64."""
    for k in range(first, last):
        for c in range(0, BLOCK, LANES):
            force = convert(load(memory.forces, copies.of[copies.start[k]] * BLOCK + c, LANES), 0.0)
            for p in range(copies.start[k] + 1, copies.start[k + 1]):
                force = force + convert(load(memory.forces, copies.of[p] * BLOCK + c, LANES), 0.0)
            store(work, c, force)
        for lane in range(clusters.filled[k]):
            for c in range(3):
                forces[clusters.atom[k * LANES + lane], c] += work[c * LANES + lane]


def _make_copies(n_clusters: int, n_copies: int, memory: Buffers) -> Copies:
    return Copies(
        owner=memory.array("owner", np.int32, n_copies),
        key=memory.array("key", np.int32, n_copies),
        shift=memory.array("shift", np.float64, n_copies, 3),
        bottom=memory.array("copy bottom", np.float64, n_copies),
        top=memory.array("copy top", np.float64, n_copies),
        boxes=memory.array("copy boxes", np.float64, n_copies, 6),
        lanes=memory.array("lanes", np.uint8, n_copies),
        home=memory.array("home", np.int32, n_clusters),
        is_used=memory.array("is_used", np.bool_, n_copies),
        of=memory.array("of", np.int32, n_copies),
        start=memory.array("start", np.int32, n_clusters + 1),
    )
