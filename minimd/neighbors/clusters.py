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
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import scalar
from minimd.compiled.simd import load, with_lane
from minimd.compiled.simd.lanes import Lanes, count
from minimd.neighbors.binning import FLATTEST, WIDER, counting_sort, into_cell
from minimd.neighbors.buffers import Buffers, Fields
from minimd.structure.cell import Cell

ZEROS, ONES = np.zeros(3), np.ones(3)
N_FIXED = 4  # fields of Columns that stay as the cell is strained
DIMENSIONS = 3  # numbers of an atom; a cluster of n atoms is a block of 3 n numbers in memory: n x, n y, n z


class Columns(ByAddress, namedtuple("Columns", "counts distance reach pbc along origin extent lattice inverse")):
    """A cell divided into columns along its third lattice vector.

    What changes as the cell is strained, from along on, is in arrays.

    counts : (3,) int, columns along the first two lattice vectors, and bins along the third, for sorting.
    distance : within which pairs are searched [length].  reach : (2,) int, the same in columns on each side.
    pbc, lattice, inverse : of the Cell.  along : (1,) distance as a fraction of the
        height along the third lattice vector.
    origin, extent : (3,) fractional coordinates covered; 0 and 1 in periodic directions.
    """


class Clusters(
    ByAddress, namedtuple("Clusters", "lanes atom filled positions origins wrapping column_start bottom top boxes")
):
    """Atoms sorted into C clusters of n lanes; slot s is lane s % n of cluster s // n.

    Arrays of C elements have room for more.

    lanes : Lanes, n as a type.  atom : (n C,) int, the user's index.  filled : (C,) int, lanes that are not padding.
    positions : flat, a block of 3 n numbers for each cluster: of its atoms when it was made,
        strained since as the cell was [length].
    origins : the same without the strain, and the same array if there never was one.  wrapping : Wrapping.
    column_start : (columns + 1,) int, first cluster of each column; the last number is C.
    bottom, top : (C,) lowest and highest fractional coordinate along the third lattice vector.
    boxes : (C, 6) smallest x y z and largest x y z of the atoms of each cluster [length].
    bottom, top and boxes are needed for a build only; afterwards their memory has other uses.
    """


class Wrapping(namedtuple("Wrapping", "inverse periodic lattice")):
    """How atoms are brought into the cell: by as many lattice vectors as for their origins.

    These are computed, not kept: memory is slower.

    inverse : (3, 3) of the cell in which clusters were made [1/length], and periodic : (3,) 1.0 where it was, else 0.0.
    lattice : (3, 3) of the cell as it is now [length].
    """


@scalar
def offsets_of(start, clusters):
    """Lattice vectors that bring the atoms of a cluster into the cell: vectors x, y, z [length].  start :
    of its block."""
    (inverse, periodic, lattice), (x, y, z) = clusters.wrapping, loaded(clusters.origins, start, clusters.lanes)
    a = -np.floor(x * inverse[0, 0] + y * inverse[1, 0] + z * inverse[2, 0]) * periodic[0]
    b = -np.floor(x * inverse[0, 1] + y * inverse[1, 1] + z * inverse[2, 1]) * periodic[1]
    c = -np.floor(x * inverse[0, 2] + y * inverse[1, 2] + z * inverse[2, 2]) * periodic[2]
    x = a * lattice[0, 0] + b * lattice[1, 0] + c * lattice[2, 0]
    y = a * lattice[0, 1] + b * lattice[1, 1] + c * lattice[2, 1]
    return x, y, a * lattice[0, 2] + b * lattice[1, 2] + c * lattice[2, 2]


def covered(
    cell: Cell, positions: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where atoms are, as Columns has it: origin and extent."""
    origin, extent = np.zeros(3), np.ones(3)
    for k in np.flatnonzero(~cell.pbc):
        along = np.einsum("ij,j->i", positions, cell.inverse[:, k])  # not @: see observables
        origin[k], extent[k] = along.min(), max(np.ptp(along), FLATTEST * reach / cell.heights[k])
    return origin, extent


def make_columns(
    cell: Cell,
    n_atoms: int,
    reach: float,
    lanes: Lanes,
    origin: NDArray[np.float64] = ZEROS,
    extent: NDArray[np.float64] = ONES,
) -> Columns:
    """Columns so wide that the atoms of a cluster fill about a cube of them.  origin, extent : see covered;
    the whole cell if left out."""
    widths, n_lanes = cell.heights * extent, lanes.size
    cube = (n_lanes * widths.prod() / n_atoms) ** (1.0 / 3.0)
    across = np.maximum(1.0, np.minimum(widths[:2] / cube, n_atoms))
    across = np.maximum(
        1.0, np.rint(across * min(1.0, (n_atoms / (n_lanes * across.prod())) ** 0.5))
    )  # a flat scene has few
    bins = max(1.0, n_atoms / across.prod())
    needed = np.ceil(WIDER * reach * across / widths[:2])
    needed = np.minimum(needed, np.where(cell.pbc[:2], across, across - 1.0))
    counts = np.array([*across, bins]).astype(np.int64)
    along_z = np.array([WIDER * reach / cell.heights[2]])
    return Columns(
        counts,
        reach,
        needed.astype(np.int64),
        cell.pbc,
        along_z,
        origin.copy(),
        extent.copy(),
        cell.lattice.copy(),
        cell.inverse.copy(),
    )


def moved_columns(columns: Columns, to: Columns) -> bool:
    """Whether there are as many columns in another cell, or at other places; then they are moved there,
    in the same arrays."""
    stay, move = columns[:N_FIXED], columns[N_FIXED:]
    if not all(np.array_equal(a, b) for a, b in zip(stay, to[:N_FIXED], strict=True)):
        return False
    for a, b in zip(move, to[N_FIXED:], strict=True):
        a[:] = b
    return True


def most_clusters(n_atoms: int, columns: Columns, lanes: Lanes) -> int:
    """Clusters of so many atoms, however they stand: each column may have one that is not full."""
    return (n_atoms + int(columns.counts[0] * columns.counts[1]) * (lanes.size - 1)) // lanes.size


def make_clusters(
    n_clusters: int, columns: Columns, lanes: Lanes, for_build: Sequence[NDArray], memory: Buffers, spare: float
) -> Clusters:
    """Arrays with room for so many.  for_build : those of clusters_for_build.  spare : see Buffers.array."""
    n_slots, array = n_clusters * lanes.size, partial(memory.array, spare=spare)
    column_start = array("column_start", np.int64, int(columns.counts[0] * columns.counts[1]) + 1)
    atom, filled = array("atom", np.int32, n_slots), array("filled", np.int32, n_clusters)
    at = array("positions", np.float64, n_slots * DIMENSIONS)
    wrapping = Wrapping(columns.inverse.copy(), columns.pbc.astype(np.float64), columns.lattice.copy())
    return Clusters(lanes, atom, filled, at, at, wrapping, column_start, *for_build)


def clusters_for_build(n_clusters: int) -> Fields:
    """Those arrays of Clusters that are needed for a build only: bottom, top, boxes."""
    return (np.float64, (n_clusters,)), (np.float64, (n_clusters,)), (np.float64, (n_clusters, 6))


def bins_for_sort(n_atoms: int, columns: Columns) -> Fields:
    """The arrays of Binned to sort so many atoms with. Its cells are left out: they are computed again."""
    each, of_bins = (np.int32, (n_atoms,)), (np.int32, (int(columns.counts.prod()) + 1,))
    return each, each, of_bins, of_bins, (np.float64, (0, 3)), (np.float64, (n_atoms,))


@scalar
def sort_into_columns(positions, columns, binned, clusters):
    """Atoms into the bins of all columns; the first cluster of each column,
    the second lattice direction running faster than the first."""
    counts, column_start, n_lanes = columns.counts, clusters.column_start, count(clusters.lanes)
    counting_sort(positions, columns.inverse, columns.pbc, columns, binned)
    column_start[0] = 0
    for column in range(counts[0] * counts[1]):
        n = binned.bin_start[(column + 1) * counts[2]] - binned.bin_start[column * counts[2]]
        column_start[column + 1] = column_start[column] + (n + n_lanes - 1) // n_lanes


@scalar
def fill_clusters(chunk, n, positions, columns, binned, clusters):
    """The clusters of a chunk of n: some rows of columns along the second lattice vector."""
    counts = columns.counts
    for column in range(chunk * counts[0] // n * counts[1], (chunk + 1) * counts[0] // n * counts[1]):
        _fill_column(column, positions, columns, binned, clusters)


@scalar
def _fill_column(column, positions, columns, binned, clusters):
    """Sort the atoms of a column by height (they nearly are, being in bins), and cut them into clusters."""
    counts, lattice, order, height = columns.counts, columns.lattice, binned.order, binned.height
    n_lanes = count(clusters.lanes)
    first, last = binned.bin_start[column * counts[2]], binned.bin_start[(column + 1) * counts[2]]
    for p in range(first, last):
        i, q = order[p], p
        while q > first and height[order[q - 1]] > height[i]:
            order[q] = order[q - 1]
            q -= 1
        order[q] = i
    cluster = clusters.column_start[column]
    for p in range(first, last, n_lanes):
        n = min(n_lanes, last - p)
        clusters.filled[cluster] = n
        clusters.bottom[cluster], clusters.top[cluster] = height[order[p]], height[order[p + n - 1]]
        for c in range(3):
            clusters.boxes[cluster, c], clusters.boxes[cluster, c + 3] = np.inf, -np.inf
        for k in range(n_lanes):
            i = order[p + min(k, n - 1)]
            clusters.atom[cluster * n_lanes + k] = i
            _, a = into_cell(positions, i, columns.inverse, columns.pbc, 0)
            _, b = into_cell(positions, i, columns.inverse, columns.pbc, 1)
            _, d = into_cell(positions, i, columns.inverse, columns.pbc, 2)
            for c in range(3):
                place = (cluster * DIMENSIONS + c) * n_lanes + k
                clusters.positions[place] = clusters.origins[place] = positions[i, c]
                x = positions[i, c] + (a * lattice[0, c] + b * lattice[1, c] + d * lattice[2, c])
                clusters.boxes[cluster, c], clusters.boxes[cluster, c + 3] = (
                    min(clusters.boxes[cluster, c], x),
                    max(clusters.boxes[cluster, c + 3], x),
                )
        cluster += 1


@scalar
def gathered(k, clusters, of_atoms):
    """Three numbers of each atom of cluster k, from (N, 3): vectors of the first, of the second and of the third."""
    n_lanes, x = count(clusters.lanes), load(clusters.positions, 0, clusters.lanes)
    y, z = x, x
    for k_lane in range(n_lanes):
        i = np.uintp(clusters.atom[k * n_lanes + k_lane])
        x, y, z = (
            with_lane(x, k_lane, of_atoms[i, 0]),
            with_lane(y, k_lane, of_atoms[i, 1]),
            with_lane(z, k_lane, of_atoms[i, 2]),
        )
    return x, y, z


@scalar
def loaded(blocks, start, lanes):
    """The vectors x, y, z of the block of a cluster, from index start on."""
    n_lanes = np.uintp(count(lanes))
    return (
        load(blocks, start, lanes),
        load(blocks, start + n_lanes, lanes),
        load(blocks, start + n_lanes + n_lanes, lanes),
    )
