"""All pairs of atoms and images within a distance, each once, in a time linear in the number of atoms."""

from collections import namedtuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel
from minimd.neighbors.binning import Grid
from minimd.structure.cell import Cell, minimum_image


class Bins(namedtuple("Bins", "bin_start counts forward crossed translations pbc lattice inverse safe_distance2")):
    """Where the search looks for the neighbors of the atoms of a bin, and through which images.

    bin_start, counts : see Sorted, Grid.  forward, crossed, translations : see forward_bins, image_table.
    pbc, lattice, inverse, safe_distance2 : of the Cell.
    """


def bins_of(cell: Cell, grid: Grid, bin_start: NDArray[np.int64]) -> Bins:
    """The bins of a grid, ready for a search."""
    crossed, translations = image_table(cell, grid)
    return Bins(bin_start, grid.counts, forward_bins(grid), crossed, translations, cell.pbc, cell.lattice, cell.inverse, cell.safe_distance2)


def forward_bins(grid: Grid) -> NDArray[np.int64]:
    """Offsets (dx, dy, dz) of one half of the bins within reach, (0, 0, 0) left out: (K, 3) int.

    Of each offset and its opposite one is kept, so that every pair is met once.
    """
    axes = [np.arange(-r, r + 1) for r in grid.reach]
    offsets = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.ascontiguousarray(offsets[len(offsets) // 2 + 1 :])


def image_table(cell: Cell, grid: Grid) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """How many cells a search can cross in each direction, (3,) int, and the translations of all images, (T, 3) [length].

    Image (a, b, c) stands in row ((a + n_x)(2 n_y + 1) + b + n_y)(2 n_z + 1) + c + n_z. No rows if nothing is periodic.
    """
    crossed = np.where(cell.pbc, -(-grid.reach // grid.counts), 0)
    if not cell.is_periodic:
        return crossed, np.zeros((0, 3))
    axes = [np.arange(-n, n + 1) for n in crossed]
    images = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return crossed, images @ np.where(cell.pbc[:, None], cell.lattice, 0.0)


@kernel
def find_pairs(positions, order, bins, reach2, partners, pairs):
    """Write all pairs within the reach and return how many there are, which may be more than there is room for.

    positions : (N, 3), in the order of the bins and inside the cell [length].  order : (N,) the user's index of each.
    bins : Bins.  reach2 : squared reach [length²].
    partners : (start, values); the nearest image of a pair of user's atom a and values[start[a] : start[a + 1]] is left out.
    pairs : output, see Pairs; its atoms count in the order of the bins.
    """
    n_pairs = 0
    room = pairs.second.size
    counts, bin_start, crossed, translations = bins.counts, bins.bin_start, bins.crossed, bins.translations
    shifted = translations.shape[0] > 0
    rows_y, rows_z = 2 * crossed[1] + 1, 2 * crossed[2] + 1
    has_excluded = partners[1].size > 0
    ranges = np.empty((bins.forward.shape[0] + 1, 3), dtype=np.int64)
    for bin_x in range(counts[0]):
        for bin_y in range(counts[1]):
            for bin_z in range(counts[2]):
                own = (bin_x * counts[1] + bin_y) * counts[2] + bin_z
                if bin_start[own] == bin_start[own + 1]:
                    continue
                n_ranges = _atoms_in_reach(bin_x, bin_y, bin_z, bins, ranges)
                for i in range(bin_start[own], bin_start[own + 1]):
                    pairs.start[i] = n_pairs
                    x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
                    for k in range(n_ranges):
                        first_atom = i + 1 if k == 0 else ranges[k, 0]
                        row = ranges[k, 2]
                        tx = ty = tz = 0.0
                        if shifted:
                            tx, ty, tz = translations[row, 0], translations[row, 1], translations[row, 2]
                        for j in range(first_atom, ranges[k, 1]):
                            dx, dy, dz = positions[j, 0] - x + tx, positions[j, 1] - y + ty, positions[j, 2] - z + tz
                            if dx * dx + dy * dy + dz * dz < reach2:
                                if has_excluded and _is_partner(order[i], order[j], partners):
                                    a, b, c = minimum_image(dx - tx, dy - ty, dz - tz, bins.lattice, bins.inverse, bins.pbc, bins.safe_distance2)
                                    nearest = ((int(a) + crossed[0]) * rows_y + int(b) + crossed[1]) * rows_z + int(c) + crossed[2]
                                    if nearest == row:
                                        continue
                                if n_pairs < room:
                                    pairs.second[n_pairs] = j
                                    if shifted:
                                        pairs.image[n_pairs] = row
                                n_pairs += 1
    pairs.start[positions.shape[0]] = n_pairs
    return n_pairs


@kernel
def _atoms_in_reach(bin_x, bin_y, bin_z, bins, ranges):
    """Ranges of atoms in the bins ahead of one bin, as rows (first, last, image) of ranges; returns how many.

    The first row is the bin itself and what follows it without a gap. Neighboring bins of one image are one range.
    """
    bin_start, counts, forward, crossed, pbc = bins.bin_start, bins.counts, bins.forward, bins.crossed, bins.pbc
    rows_y, rows_z = 2 * crossed[1] + 1, 2 * crossed[2] + 1
    own = (bin_x * counts[1] + bin_y) * counts[2] + bin_z
    ranges[0, 0], ranges[0, 1] = bin_start[own], bin_start[own + 1]
    ranges[0, 2] = (crossed[0] * rows_y + crossed[1]) * rows_z + crossed[2]
    n = 0
    for k in range(forward.shape[0]):
        to_x, to_y, to_z = bin_x + forward[k, 0], bin_y + forward[k, 1], bin_z + forward[k, 2]
        cell_x, cell_y, cell_z = to_x // counts[0], to_y // counts[1], to_z // counts[2]
        if (cell_x != 0 and not pbc[0]) or (cell_y != 0 and not pbc[1]) or (cell_z != 0 and not pbc[2]):
            continue
        to_x, to_y, to_z = to_x - cell_x * counts[0], to_y - cell_y * counts[1], to_z - cell_z * counts[2]
        neighbor = (to_x * counts[1] + to_y) * counts[2] + to_z
        row = ((cell_x + crossed[0]) * rows_y + cell_y + crossed[1]) * rows_z + cell_z + crossed[2]
        if bin_start[neighbor] == ranges[n, 1] and row == ranges[n, 2]:
            ranges[n, 1] = bin_start[neighbor + 1]
        else:
            n += 1
            ranges[n, 0], ranges[n, 1], ranges[n, 2] = bin_start[neighbor], bin_start[neighbor + 1], row
    return n + 1


@kernel
def _is_partner(a, b, partners):
    start, values = partners
    for k in range(start[a], start[a + 1]):
        if values[k] == b:
            return True
    return False
