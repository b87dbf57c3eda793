"""Atoms into clusters of eight: columns of the cell, sorted along them, cut into pieces.

Seen from above and from the side (4 columns; one column with its clusters A, B, C; · is padding):

    +-----+-----+        | A A A A A A A A | B B B B B B B B | C C C · · · · · |
    |  0  |  1  |         bottom  ->  along the third lattice vector  ->   top
    +-----+-----+
    |  2  |  3  |        in memory, each cluster: x x x x x x x x y y y y y y y y z z z z z z z z
    +-----+-----+
"""

from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.cell import Cell
from minimd.compiling import kernel
from minimd.neighbors.binning import counting_sort
from minimd.potentials.cluster_loop import BLOCK, LANES

FAR = 1e3  # in units of the scene: where padding stands, each piece farther than the one before


THINNEST = 1e-9  # a scene thinner than this fraction of the reach counts as this thick


class Columns(NamedTuple):
    """counts : (3,) int, columns along the first two lattice vectors, and bins along the third, for sorting.

    reach : (2,) int, columns to search on each side.  along : reach as a fraction of the third lattice vector.
    origin, extent : (3,) fractional coordinates covered; 0 and 1 in periodic directions.
    """

    counts: NDArray[np.int64]
    reach: NDArray[np.int64]
    along: float
    origin: NDArray[np.float64]
    extent: NDArray[np.float64]


class Clusters(NamedTuple):
    """Atoms sorted into clusters; slot s is lane s % 8 of cluster s // 8.

    atom : (slots,) int, the user's index, −1 for padding.  offsets : (slots, 3) lattice vectors that bring the atom into the cell.
    column_start : (columns + 1,) int, first cluster of each column.
    bottom, top : (clusters,) lowest and highest fractional coordinate along the third lattice vector.
    """

    atom: NDArray[np.int64]
    offsets: NDArray[np.float64]
    column_start: NDArray[np.int64]
    bottom: NDArray[np.float64]
    top: NDArray[np.float64]


def make_columns(cell: Cell, positions: NDArray[np.float64], reach: float) -> Columns:
    """Columns so wide that eight atoms fill about a cube of them."""
    origin, extent = np.zeros(3), np.ones(3)
    for k in np.flatnonzero(~cell.pbc):
        along = positions @ cell.inverse[:, k]
        origin[k], extent[k] = along.min(), max(np.ptp(along), THINNEST * reach / cell.heights[k])
    widths = cell.heights * extent
    cube = (LANES * widths.prod() / len(positions)) ** (1.0 / 3.0)
    across = np.maximum(1.0, np.rint(np.minimum(widths[:2] / cube, len(positions))))
    bins = max(1.0, len(positions) / across.prod())
    counts = np.array([*across, bins]).astype(np.int64)
    return Columns(counts, np.ceil(reach * counts[:2] / widths[:2]).astype(np.int64), reach / cell.heights[2], origin, extent)


def sort_into_clusters(positions: NDArray[np.float64], cell: Cell, columns: Columns) -> Clusters:
    """The clusters of all columns, the second lattice direction running faster than the first."""
    n_columns = int(columns.counts[0] * columns.counts[1])
    room = ceil((len(positions) + n_columns * (LANES - 1)) / LANES) * LANES
    atom, offsets = np.empty(room, dtype=np.int64), np.zeros((room, 3))
    column_start = np.empty(n_columns + 1, dtype=np.int64)
    bottom, top = np.empty(room // LANES), np.empty(room // LANES)
    _fill_columns(
        positions, cell.lattice, cell.inverse, cell.pbc, columns.counts, columns.origin, columns.extent, atom, offsets, column_start, bottom, top
    )
    n = int(column_start[-1])
    return Clusters(atom[: n * LANES], offsets[: n * LANES], column_start, bottom[:n], top[:n])


@kernel
def _fill_columns(positions, lattice, inverse, pbc, counts, origin, extent, atom, offsets, column_start, bottom, top):
    """Counting sort into bins of columns, insertion sort within; outputs as in Clusters."""
    order, bin_start, cells, height = counting_sort(positions, inverse, pbc, counts, origin, extent)
    slot = 0
    for column in range(counts[0] * counts[1]):
        column_start[column] = slot // LANES
        first, last = bin_start[column * counts[2]], bin_start[(column + 1) * counts[2]]
        for p in range(first, last):
            i, q = order[p], p
            while q > first and height[order[q - 1]] > height[i]:
                order[q] = order[q - 1]
                q -= 1
            order[q] = i
        for p in range(first, last):
            i = order[p]
            atom[slot] = i
            for c in range(3):
                offsets[slot, c] = cells[i, 0] * lattice[0, c] + cells[i, 1] * lattice[1, c] + cells[i, 2] * lattice[2, c]
            if slot % LANES == 0:
                bottom[slot // LANES] = height[i]
            top[slot // LANES] = height[i]
            slot += 1
        while slot % LANES != 0:
            atom[slot] = -1
            slot += 1
    column_start[column_start.size - 1] = slot // LANES


@kernel
def gather_clusters(positions, atom, offsets, coordinates):
    """coordinates of all slots = positions of their atoms + offsets; padding is left where it stands."""
    for slot in range(atom.size):
        i = atom[slot]
        if i >= 0:
            block = slot // LANES * BLOCK + slot % LANES
            for c in range(3):
                coordinates[block + c * LANES] = positions[i, c] + offsets[slot, c]


@kernel
def place_padding(atom, far, coordinates):
    """Padding stands far away, each piece elsewhere, so that it meets nobody."""
    for slot in range(atom.size):
        if atom[slot] < 0:
            block = slot // LANES * BLOCK + slot % LANES
            for c in range(3):
                coordinates[block + c * LANES] = far * (1.0 + slot)


@kernel
def scatter_clusters(on_clusters, on_atoms, atom, forces):
    """forces (N, 3) += what the loop found for each slot, on_clusters + on_atoms."""
    for slot in range(atom.size):
        i = atom[slot]
        if i >= 0:
            block = slot // LANES * BLOCK + slot % LANES
            for c in range(3):
                forces[i, c] += on_clusters[block + c * LANES] + on_atoms[block + c * LANES]


@kernel
def bounding_boxes(coordinates, atom, boxes):
    """boxes : (clusters, 6) smallest x y z and largest x y z of the atoms of each cluster, padding left out [length]."""
    for cluster in range(boxes.shape[0]):
        for c in range(3):
            low, high = np.inf, -np.inf
            for k in range(LANES):
                if atom[cluster * LANES + k] >= 0:
                    value = coordinates[cluster * BLOCK + c * LANES + k]
                    low, high = min(low, value), max(high, value)
            boxes[cluster, c], boxes[cluster, c + 3] = low, high
