"""All pairs of atoms and images within a distance, each once, in a time linear in the number of atoms.

Atoms are sorted into bins, a grid along the lattice vectors; then the bins within reach of each bin are searched.
"""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.kernels import kernel, scalar
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell, minimum_image
from minimd.core.structure.vectors import along, separation, transformed

# a grid never has more than 1/0.25 = 4 bins for each atom, so that empty space costs nothing
ATOMS_PER_BIN = 0.25
FLATTEST = 1e-9  # of the reach: a thinner scene counts as this thick, so that no width is zero
# bins are this much wider than the reach, so that rounding never asks for one bin more
WIDER = 1.0 + 1e-9


class BinGrid(namedtuple("BinGrid", "counts reach origin extent")):
    """counts : (3,) int, bins along each lattice vector.
    reach : (3,) int, bins to search on each side.

    origin, extent : (3,) fractional coordinates covered; 0 and 1 in periodic directions."""


def make_grid(cell: Cell, positions: Array, reach: float) -> BinGrid:
    """A grid whose bins are about half the reach wide, wider where there would be many more bins than atoms."""
    fractional = np.einsum("ij,jk->ik", positions, cell.inverse)  # not @: see observables
    origin = np.where(cell.pbc, 0.0, fractional.min(axis=0))
    occupied = np.maximum(fractional.max(axis=0) - origin, np.finfo(float).tiny)
    extent = np.where(cell.pbc, 1.0, occupied)

    widths = cell.heights * extent
    counts = np.maximum(1.0, np.floor(2.0 * widths / (reach * WIDER)))
    while counts.prod() > max(64.0, len(positions) / ATOMS_PER_BIN) and counts.max() > 1.0:
        counts = np.where(counts == counts.max(), np.ceil(0.5 * counts), counts)

    needed = np.ceil(reach * counts / np.maximum(widths, FLATTEST * reach * counts))
    needed = np.where(cell.pbc, needed, np.minimum(needed, counts - 1.0))
    return BinGrid(counts.astype(np.int64), needed.astype(np.int64), origin, extent)


class Binned(namedtuple("Binned", "order bins bin_start place cells height")):
    """The arrays of a counting sort of N atoms into B bins.
    order, bins : (N,) int, atoms in the order of their bins, and the bin of each atom.
    bin_start : (B + 1,) int, first atom of each bin.
    place : (B + 1,) int, scratch.
    cells : (N, 3) numbers of lattice vectors that bring each atom into the cell; (0, 3) where nobody asks for them.
    height : (N,) fractional coordinate along the third lattice vector, in the cell."""


@scalar
def into_cell(positions, i, inverse, pbc, origin, d):
    """Fractional coordinate of atom i along lattice vector d, and how many lattice vectors wrapping has added.

    positions : (N, 3) [length].
    inverse, pbc : of the Cell; where pbc[d], the coordinate is wrapped.
    origin : (3,) where the cell begins."""
    s = along((positions[i, 0], positions[i, 1], positions[i, 2]), inverse, d)
    cells = -np.floor(s - origin[d]) if pbc[d] else 0.0
    return s + cells, cells


@scalar
def counting_sort(positions, inverse, pbc, grid, binned):
    """Atoms into the bins of a grid, the last direction running fastest. Atoms outside it are in the outermost bins.

    positions : (N, 3) [length].
    inverse, pbc : of the Cell.
    grid : counts, origin and extent, see BinGrid.
    binned : Binned, output."""
    counts = grid.counts
    origin = grid.origin
    extent = grid.extent
    per_bin = counts[0] / extent[0], counts[1] / extent[1], counts[2] / extent[2]

    bins = binned.bins
    bin_start = binned.bin_start
    place = binned.place
    for b in range(bin_start.size):
        bin_start[b] = 0

    for i in range(positions.shape[0]):
        index = 0
        s = 0.0

        for d in range(3):
            s, cells = into_cell(positions, i, inverse, pbc, origin, d)
            if binned.cells.shape[0] > 0:
                binned.cells[i, d] = cells
            along = (s - origin[d]) * per_bin[d]
            index = index * counts[d] + int(max(0.0, min(counts[d] - 1.0, along)))

        bins[i] = index
        binned.height[i] = s
        bin_start[index + 1] += 1

    for b in range(bin_start.size - 1):
        place[b] = bin_start[b]
        bin_start[b + 1] += bin_start[b]
    for i in range(bins.size):
        binned.order[place[bins[i]]] = i
        place[bins[i]] += 1


@kernel
def sort_into_bins(positions, lattice, inverse, pbc, grid):
    """order and bin_start, see Binned, and offsets.

    positions : (N, 3) [length].
    lattice, inverse, pbc : of the Cell.
    grid : BinGrid.
    offsets : (N, 3) [length]; offsets[k] brings atom order[k] into the cell."""
    n_atoms = positions.shape[0]
    n_bins = grid.counts[0] * grid.counts[1] * grid.counts[2]
    order = np.empty(n_atoms, dtype=np.int64)
    bins = np.empty(n_atoms, dtype=np.int64)
    bin_start = np.empty(n_bins + 1, dtype=np.int64)
    place = np.empty(n_bins + 1, dtype=np.int64)

    cells = np.empty((n_atoms, 3))
    binned = Binned(order, bins, bin_start, place, cells, np.empty(n_atoms))
    counting_sort(positions, inverse, pbc, grid, binned)
    offsets = np.empty((n_atoms, 3))
    for k in range(n_atoms):
        for d, x in enumerate(transformed(cells[order[k]], lattice)):
            offsets[k, d] = x
    return order, offsets, bin_start


class Bins(namedtuple("Bins", "bin_start counts forward crossed translations image")):
    """Where the search looks for the neighbors of the atoms of a bin, and through which images.
    bin_start, counts : see Binned, BinGrid.
    forward : (K, 3) int, offsets of one half of the bins within reach, (0, 0, 0) left out: every pair is met once.
    crossed : (3,) int, how many cells a search can cross in each direction.
    translations : (T, 3) of all images [length]; no rows if nothing is periodic.
        Image (a, b, c) has row ((a + n_x)(2 n_y + 1) + b + n_y)(2 n_z + 1) + c + n_z, with n = crossed.
    image : lattice, inverse, pbc and safe_distance2 of the Cell, see minimum_image."""


def bins_of(cell: Cell, grid: BinGrid, bin_start: Indices) -> Bins:
    """The bins of a grid, ready for a search."""
    within = _steps(grid.reach)
    forward = within[len(within) // 2 + 1 :].copy()
    crossed = np.where(cell.pbc, -(-grid.reach // grid.counts), 0)
    periodic = np.where(cell.pbc[:, None], cell.lattice, 0.0)
    translations = _steps(crossed) @ periodic if cell.is_periodic else np.zeros((0, 3))
    image = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
    return Bins(bin_start, grid.counts, forward, crossed, translations, image)


def _steps(most: Indices) -> Indices:
    """(K, 3) int: all triples from −most to most, the last number running fastest."""
    axes = [np.arange(-n, n + 1) for n in most]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


@kernel
def find_pairs(positions, order, bins, reach2, partners, pairs):
    """Write all pairs within the reach and return how many there are, which may be more than there is room for.
    positions : (N, 3), in the order of the bins and inside the cell [length].
    order : (N,) the user's index of each.
    bins : Bins.
    reach2 : squared reach [length²].
    partners : see verlet_list; the nearest image of a pair of partners, numbered as by the user, is left out.
    pairs : output, see Pairs; its atoms count in the order of the bins."""
    n_pairs = 0
    room = pairs.second.size
    bin_start = bins.bin_start
    crossed = bins.crossed
    translations = bins.translations
    shifted = translations.shape[0] > 0
    has_excluded = partners[1].size > 0
    ranges = np.empty((bins.forward.shape[0] + 1, 3), dtype=np.int64)

    for own in range(bin_start.size - 1):
        if bin_start[own] == bin_start[own + 1]:
            continue
        n_ranges = atoms_in_reach(own, bins, ranges)

        for i in range(bin_start[own], bin_start[own + 1]):
            pairs.start[i] = n_pairs
            for k in range(n_ranges):
                first_atom = i + 1 if k == 0 else ranges[k, 0]
                row = ranges[k, 2]
                tx = ty = tz = 0.0
                if shifted:
                    tx, ty, tz = translations[row, 0], translations[row, 1], translations[row, 2]

                for j in range(first_atom, ranges[k, 1]):
                    dx, dy, dz = separation(positions, i, j, (tx, ty, tz))
                    if not dx * dx + dy * dy + dz * dz < reach2:
                        continue
                    if has_excluded and _is_partner(order[i], order[j], partners):
                        a, b, c = minimum_image(dx - tx, dy - ty, dz - tz, *bins.image)
                        if _row_of(int(a), int(b), int(c), crossed) == row:
                            continue

                    if n_pairs < room:
                        pairs.second[n_pairs] = j
                        if shifted:
                            pairs.image[n_pairs] = row

                    n_pairs += 1

    pairs.start[positions.shape[0]] = n_pairs
    return n_pairs


@scalar
def _row_of(a, b, c, crossed):
    """The row of image (a, b, c), see Bins."""
    row_xy = (a + crossed[0]) * (2 * crossed[1] + 1) + b + crossed[1]
    return row_xy * (2 * crossed[2] + 1) + c + crossed[2]


@kernel
def atoms_in_reach(own, bins, ranges):
    """Ranges of atoms in the bins ahead of one bin, as rows (first, last, image) of ranges; returns how many.
    The first row is the bin itself and what follows it without a gap. Neighboring bins of one image are one range."""
    bin_start = bins.bin_start
    forward = bins.forward
    crossed = bins.crossed
    counts = bins.counts
    n_x, n_y, n_z = counts[0], counts[1], counts[2]
    bin_x, bin_y, bin_z = own // (n_y * n_z), own // n_z % n_y, own % n_z
    ranges[0, 0] = bin_start[own]
    ranges[0, 1] = bin_start[own + 1]
    ranges[0, 2] = _row_of(0, 0, 0, crossed)

    n = 0

    for k in range(forward.shape[0]):
        to_x, to_y, to_z = bin_x + forward[k, 0], bin_y + forward[k, 1], bin_z + forward[k, 2]
        cell_x, cell_y, cell_z = to_x // n_x, to_y // n_y, to_z // n_z
        # none is crossed in a direction that is not periodic
        if abs(cell_x) > crossed[0] or abs(cell_y) > crossed[1] or abs(cell_z) > crossed[2]:
            continue
        neighbor = ((to_x % n_x) * n_y + to_y % n_y) * n_z + to_z % n_z
        row = _row_of(cell_x, cell_y, cell_z, crossed)
        if bin_start[neighbor] != ranges[n, 1] or row != ranges[n, 2]:
            n += 1
            ranges[n, 0] = bin_start[neighbor]
            ranges[n, 2] = row

        ranges[n, 1] = bin_start[neighbor + 1]

    return n + 1


@kernel
def _is_partner(a, b, partners):
    start, values = partners
    for k in range(start[a], start[a + 1]):
        if values[k] == b:
            return True
    return False
