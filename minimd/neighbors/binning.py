"""Atoms into bins: a grid along the lattice vectors, and the atoms in the order of their bins."""

from collections import namedtuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel, scalar
from minimd.structure.cell import Cell

ATOMS_PER_BIN = 0.25  # a grid never has more than 1/0.25 = 4 bins for each atom, so that empty space costs nothing
FLATTEST = 1e-9  # of the reach: a thinner scene counts as this thick, so that no width is zero
WIDER = 1.0 + 1e-9  # bins are this much wider than the reach, so that rounding never asks for one bin more


class Grid(namedtuple("Grid", "counts reach origin extent")):
    """counts : (3,) int, bins along each lattice vector.  reach : (3,) int, bins to search on each side.

    origin, extent : (3,) fractional coordinates covered; 0 and 1 in periodic directions.
    """


def make_grid(cell: Cell, positions: NDArray[np.float64], reach: float) -> Grid:
    """A grid whose bins are about half the reach wide, wider where there would be many more bins than atoms."""
    fractional = np.einsum("ij,jk->ik", positions, cell.inverse)  # not @: see observables
    origin = np.where(cell.pbc, 0.0, fractional.min(axis=0))
    extent = np.where(cell.pbc, 1.0, np.maximum(fractional.max(axis=0) - origin, np.finfo(float).tiny))
    widths = cell.heights * extent
    counts = np.maximum(1.0, np.floor(2.0 * widths / (reach * WIDER)))
    while counts.prod() > max(64.0, len(positions) / ATOMS_PER_BIN) and counts.max() > 1.0:
        counts = np.where(counts == counts.max(), np.ceil(0.5 * counts), counts)
    needed = np.ceil(reach * counts / np.maximum(widths, FLATTEST * reach * counts))
    needed = np.where(cell.pbc, needed, np.minimum(needed, counts - 1.0))
    return Grid(counts.astype(np.int64), needed.astype(np.int64), origin, extent)


class Binned(namedtuple("Binned", "order bins bin_start place cells height")):
    """The arrays of a counting sort of N atoms into B bins.

    order, bins : (N,) int, atoms in the order of their bins, and the bin of each atom.
    bin_start : (B + 1,) int, first atom of each bin.  place : (B + 1,) int, scratch.
    cells : (N, 3) numbers of lattice vectors that bring each atom into the cell; (0, 3) where nobody asks for them.
    height : (N,) fractional coordinate along the third lattice vector, in the cell.
    """


@scalar
def into_cell(positions, i, inverse, pbc, origin, d):
    """Fractional coordinate of atom i along lattice vector d, in the cell that begins at an origin (3,),
    and the number of lattice vectors that brought it there."""
    s = positions[i, 0] * inverse[0, d] + positions[i, 1] * inverse[1, d] + positions[i, 2] * inverse[2, d]
    cells = -np.floor(s - origin[d]) if pbc[d] else 0.0
    return s + cells, cells


@scalar
def counting_sort(positions, inverse, pbc, grid, binned):
    """Sort atoms into the bins of a grid (counts, origin, extent), the last direction running fastest, in linear time:
    fills Binned. Atoms outside what is covered are in the outermost bins."""
    counts, origin, extent = grid.counts, grid.origin, grid.extent
    for b in range(binned.bin_start.size):
        binned.bin_start[b] = 0
    for i in range(positions.shape[0]):
        index, s = 0, 0.0
        for d in range(3):
            s, cells = into_cell(positions, i, inverse, pbc, origin, d)
            if binned.cells.shape[0] > 0:
                binned.cells[i, d] = cells
            along = (s - origin[d]) / extent[d] * counts[d]
            index = index * counts[d] + int(max(0.0, min(counts[d] - 1.0, along)))
        binned.bins[i], binned.height[i] = index, s
        binned.bin_start[index + 1] += 1
    for b in range(binned.bin_start.size - 1):
        binned.place[b] = binned.bin_start[b]
        binned.bin_start[b + 1] += binned.bin_start[b]
    for i in range(positions.shape[0]):
        place = binned.place[binned.bins[i]]
        binned.order[place] = i
        binned.place[binned.bins[i]] = place + 1


@kernel
def sort_into_bins(positions, lattice, inverse, pbc, grid):
    """order, offsets and bin_start: the atoms in the order of their bins, see Binned;
    offsets[k] [length] brings atom order[k] into the cell."""
    n_atoms, n_bins = positions.shape[0], grid.counts[0] * grid.counts[1] * grid.counts[2]
    order, bins = np.empty(n_atoms, dtype=np.int64), np.empty(n_atoms, dtype=np.int64)
    bin_start, place = np.empty(n_bins + 1, dtype=np.int64), np.empty(n_bins + 1, dtype=np.int64)
    cells = np.empty((n_atoms, 3))
    counting_sort(positions, inverse, pbc, grid, Binned(order, bins, bin_start, place, cells, np.empty(n_atoms)))
    offsets = np.empty((n_atoms, 3))
    for k in range(n_atoms):
        i = order[k]
        for c in range(3):
            offsets[k, c] = cells[i, 0] * lattice[0, c] + cells[i, 1] * lattice[1, c] + cells[i, 2] * lattice[2, c]
    return order, offsets, bin_start
