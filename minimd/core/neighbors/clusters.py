"""Atoms into clusters of as many as a vector has lanes: columns of the cell, sorted along them, cut into pieces.

Seen from above and from the side (4 columns; one column with its clusters A, B, C of eight; · is padding):

    +-----+-----+        | A A A A A A A A | B B B B B B B B | C C C · · · · · |
    |  0  |  1  |         bottom  ->  along the third lattice vector  ->   top
    +-----+-----+
    |  2  |  3  |        in memory, each cluster: x x x x x x x x y y y y y y y y z z z z z z z z
    +-----+-----+

The last cluster of a column may have fewer atoms than lanes. The other lanes are padding: they repeat its last atom,
and count nowhere.
"""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import kernel, scalar
from minimd.core.compiled.simd import lane
from minimd.core.compiled.simd.vector import Lanes, count, gathered, loaded, stored
from minimd.core.neighbors.buffers import Buffers
from minimd.core.neighbors.search import ATOMS_PER_BIN, WIDER, into_cell
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.system import local_density
from minimd.core.structure.vectors import plus, transformed

N_FIXED = 5  # fields of Columns that stay as the cell is strained
# numbers of an atom; a cluster of n atoms is a block of 3 n numbers in memory: n x, n y, n z
DIMENSIONS = 3


class Columns(
    ByAddress,
    namedtuple(
        "Columns", "counts distance reach pbc is_crossed along origin extent lattice inverse"
    ),
):
    """The part of a cell where there are atoms, divided into columns along the third lattice vector.

    Atoms outside it are in the outermost columns. Between two atoms there are never more columns than if the columns
    went on: so no pair is missed, as long as none can meet across a face that is not crossed, see columns_fit.

    What changes as the cell is strained, from along on, is in arrays.
    counts : (3,) int, columns along the first two lattice vectors, and bins along the third, for sorting.
    distance : within which pairs are searched [length].
    reach : (2,) int, the same in columns on each side.
    pbc, lattice, inverse : of the Cell.
    along : (3,) distance as a fraction of its heights.
    is_crossed : (3,) bool, whether atoms may meet those beyond the faces across a lattice vector.
    origin, extent : (3,) fractional coordinates of that part; 0 and 1 where is_crossed. In periodic directions
        atoms are in the cell that begins at the origin."""

    def move_to(self, to: "Columns") -> bool:
        """Whether there are as many columns in another cell, or elsewhere; then they move there, in the same arrays."""
        is_alike = all(map(np.array_equal, self[:N_FIXED], to[:N_FIXED]))
        if is_alike:
            for array, values in zip(self[N_FIXED:], to[N_FIXED:], strict=True):
                array[:] = values
        return is_alike


class Clusters(
    ByAddress,
    namedtuple(
        "Clusters", "lanes atom filled positions origins wrapping column_start bottom top boxes"
    ),
):
    """Atoms sorted into C clusters of n lanes; slot s is lane s % n of cluster s // n.

    Arrays of C elements have room for more.
    lanes : Lanes, n as a type.
    atom : (n C,) int, the user's index.
    filled : (C,) int, lanes that are not padding.
    positions : flat, a block of 3 n numbers for each cluster: of its atoms when it was made,
        strained since as the cell was [length].
    origins : the same without the strain, and the same array if there never was one.
    wrapping : Wrapping.
    column_start : (columns + 1,) int, first cluster of each column; the last number is C.
    bottom, top : (C,) lowest and highest fractional coordinate along the third lattice vector.
    boxes : (C, 6) smallest x y z and largest x y z of the atoms of each cluster [length].
    bottom, top and boxes are needed for a build only."""


class Wrapping(namedtuple("Wrapping", "inverse periodic lattice origin")):
    """How atoms are brought into the cell: by as many lattice vectors as for their origins.

    These are computed, not kept: memory is slower.
    inverse : (3, 3) of the cell in which clusters were made [1/length], and periodic : (3,) 1.0 where it was, else 0.0.
    lattice : (3, 3) of the cell as it is now [length].
    origin : (3,) of Columns."""


@scalar
def offsets_of(start, clusters):
    """Lattice vectors that bring the atoms of a block into the cell: vectors x, y, z [length].

    start : where the block begins in positions and origins.
    clusters : Clusters."""
    inverse, periodic, lattice, origin = clusters.wrapping
    a, b, c = transformed(loaded(clusters.origins, start, clusters.lanes), inverse)
    cells = (
        -np.floor(a - origin[0]) * periodic[0],
        -np.floor(b - origin[1]) * periodic[1],
        -np.floor(c - origin[2]) * periodic[2],
    )
    return transformed(cells, lattice)


def region_of(cell: Cell, positions: Array, reach: float) -> Array:
    """Where atoms are: (7,) origin and extent of Columns; and how many atoms a cell as dense everywhere would have.
    On both sides there is room for half the reach. A periodic direction is crossed and covered as a whole, unless there
    is a gap in it that leaves a reach between the two ends of the region."""
    origin = np.zeros(3)
    extent = np.ones(3)
    margin = WIDER * reach / cell.heights

    # not @: see observables
    for k, coordinates in enumerate(np.einsum("ij,jk->ki", positions, cell.inverse)):
        if cell.pbc[k]:
            s = np.sort(coordinates - np.floor(coordinates))
            gaps = np.diff(s, append=s[0] + 1.0)
            widest = int(np.argmax(gaps))
            first = s[(widest + 1) % len(s)]
            width = 1.0 - gaps[widest]
        else:
            first = coordinates.min()
            width = coordinates.max() - first
        if not cell.pbc[k] or width + 2.0 * margin[k] <= 1.0:
            origin[k] = first - 0.5 * margin[k]
            extent[k] = width + margin[k]

    filled = local_density(positions, cell, reach) * abs(np.linalg.det(cell.lattice))
    return np.array([*origin, *extent, filled])


def make_columns(cell: Cell, n_atoms: int, reach: float, lanes: Lanes, region: Array) -> Columns:
    """Columns of a region of a cell, see region_of and count_columns."""
    extent = region[3:6].copy()
    is_crossed = cell.pbc & (extent == 1.0)
    numbers = np.zeros(5, dtype=np.int64)
    count_columns(cell.heights, region, is_crossed, n_atoms, reach, lanes.size, numbers)
    return Columns(
        numbers[:3],
        reach,
        numbers[3:],
        cell.pbc,
        is_crossed,
        WIDER * reach / cell.heights,
        region[:3].copy(),
        extent,
        cell.lattice.copy(),
        cell.inverse.copy(),
    )


@kernel
def count_columns(heights, region, is_crossed, n_atoms, distance, n_lanes, numbers):
    """Counts and reach of Columns, so wide that the atoms of a cluster fill about a cube.

    heights : of the Cell.
    region : see region_of.
    is_crossed, distance : of Columns.
    numbers : (5,) int, output, counts and reach."""
    filled = region[6] * (region[3] * region[4] * region[5])
    a = heights[0] * region[3]
    b = heights[1] * region[4]
    cube = (n_lanes * (a * b * (heights[2] * region[5])) / filled) ** (1.0 / 3.0)
    # a flat scene has few; many that are empty would cost time
    most = max(1.0, min(filled, n_atoms) / n_lanes)
    along_a = min(max(1.0, a / cube), most)
    along_b = min(max(1.0, b / cube), most)
    fewer = min(1.0, (most / (along_a * along_b)) ** 0.5)
    n_a = max(1.0, np.rint(along_a * fewer))
    n_b = max(1.0, np.rint(along_b * fewer))
    numbers[0] = n_a
    numbers[1] = n_b
    numbers[2] = max(1.0, min(filled, n_atoms / ATOMS_PER_BIN) / (n_a * n_b))
    for d, (n, width) in enumerate(((n_a, a), (n_b, b))):
        needed = np.ceil(WIDER * distance * n / width)
        numbers[3 + d] = min(needed, n if is_crossed[d] else n - 1.0)


@kernel
def columns_fit(positions, columns):
    """Whether atoms at positions (N, 3) are where columns are; else pairs are missed, or the search is slow.
    In each direction that is not crossed, they fill the region up to a reach at most on either side; where it is
    periodic, its ends are a reach apart through the gap."""
    for d in range(DIMENSIONS):
        if columns.is_crossed[d]:
            continue
        low = np.inf
        high = -np.inf
        origin = columns.origin[d]
        extent = columns.extent[d]
        margin = columns.along[d]

        for i in range(positions.shape[0]):
            s, _ = into_cell(positions, i, columns.inverse, columns.pbc, columns.origin, d)
            low = min(low, s - origin)
            high = max(high, s - origin)

        if not (0.0 <= low <= margin and extent - margin <= high <= extent):
            return False
        if columns.pbc[d] and extent + margin > 1.0:
            return False

    return True


def make_clusters(
    n_clusters: int, columns: Columns, lanes: Lanes, is_strained: bool, buffers: Buffers
) -> Clusters:
    """Arrays with room for so many.
    is_strained : whether their origins are not their positions."""
    array = buffers.array
    n_slots = n_clusters * lanes.size
    positions = array("positions", np.float64, n_slots * DIMENSIONS)
    origins = array("origins", np.float64, n_slots * DIMENSIONS) if is_strained else positions

    wrapping = Wrapping(
        array("inverse", np.float64, DIMENSIONS, DIMENSIONS),
        columns.pbc.astype(np.float64),
        array("lattice", np.float64, DIMENSIONS, DIMENSIONS),
        columns.origin,
    )
    return Clusters(
        lanes,
        array("atom", np.int32, n_slots),
        array("filled", np.int32, n_clusters),
        positions,
        origins,
        wrapping,
        array("column start", np.int64, int(columns.counts[:2].prod()) + 1),
        array("bottom", np.float64, n_clusters),
        array("top", np.float64, n_clusters),
        array("boxes", np.float64, n_clusters, 6),
    )


@scalar
def fill_column(column, positions, columns, binned, clusters):
    """Sort the atoms of a column by height (they nearly are, being in bins), and cut them into clusters.

    positions : (N, 3) [length].
    columns : Columns.
    binned : Binned; the order within the column is changed.
    clusters : Clusters, output."""
    counts = columns.counts
    order = binned.order
    height = binned.height
    n_lanes = count(clusters.lanes)
    first = binned.bin_start[column * counts[2]]
    last = binned.bin_start[(column + 1) * counts[2]]

    for p in range(first, last):
        i = order[p]
        q = p
        while q > first and height[order[q - 1]] > height[i]:
            order[q] = order[q - 1]
            q -= 1
        order[q] = i

    cluster = clusters.column_start[column]

    for p in range(first, last, n_lanes):
        n = min(n_lanes, last - p)
        clusters.filled[cluster] = n
        clusters.bottom[cluster] = height[order[p]]
        clusters.top[cluster] = height[order[p + n - 1]]
        for k in range(n_lanes):
            clusters.atom[cluster * n_lanes + k] = order[p + min(k, n - 1)]
        start = np.uintp(cluster * DIMENSIONS * n_lanes)
        at = gathered(positions, clusters.atom, cluster * n_lanes, clusters.lanes)
        stored(clusters.positions, start, at)
        stored(clusters.origins, start, at)
        wrapped = plus(at, offsets_of(start, clusters))

        for c, x in enumerate(wrapped):
            low = high = lane(x, 0)
            for k in range(1, n_lanes):
                low = min(low, lane(x, k))
                high = max(high, lane(x, k))
            clusters.boxes[cluster, c] = low
            clusters.boxes[cluster, c + 3] = high

        cluster += 1
