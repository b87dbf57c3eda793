"""All pairs of atoms and images within a distance, each once, in a time linear in the number of atoms."""

from collections import namedtuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel
from minimd.neighbors.binning import Grid
from minimd.structure.cell import Cell, minimum_image


class Bins(namedtuple("Bins", "bin_start counts forward crossed translations pbc lattice inverse safe_distance2")):
    """Where the search looks for the neighbors of the atoms of a bin, and through which images.

    bin_start, counts : see Binned, Grid.
    forward : (K, 3) int, offsets of one half of the bins within reach, (0, 0, 0) left out: every pair is met once.
    crossed : (3,) int, how many cells a search can cross in each direction.
    translations : (T, 3) of all images [length]; no rows if nothing is periodic.
        Image (a, b, c) has row ((a + n_x)(2 n_y + 1) + b + n_y)(2 n_z + 1) + c + n_z, with n = crossed.
    pbc, lattice, inverse, safe_distance2 : of the Cell.
    """


def bins_of(cell: Cell, grid: Grid, bin_start: NDArray[np.int64]) -> Bins:
    """The bins of a grid, ready for a search."""
    within = _steps(grid.reach)
    forward = within[len(within) // 2 + 1 :].copy()
    crossed = np.where(cell.pbc, -(-grid.reach // grid.counts), 0)
    translations = (
        _steps(crossed) @ np.where(cell.pbc[:, None], cell.lattice, 0.0) if cell.is_periodic else np.zeros((0, 3))
    )
    return Bins(
        bin_start,
        grid.counts,
        forward,
        crossed,
        translations,
        cell.pbc,
        cell.lattice,
        cell.inverse,
        cell.safe_distance2,
    )


def _steps(most: NDArray[np.int64]) -> NDArray[np.int64]:
    """(K, 3) int: all triples from −most to most, the last number running fastest."""
    axes = [np.arange(-n, n + 1) for n in most]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


@kernel
def find_pairs(positions, order, bins, reach2, partners, pairs):
    """Write all pairs within the reach and return how many there are, which may be more than there is room for.

    positions : (N, 3), in the order of the bins and inside the cell [length].  order : (N,) the user's index of each.
    bins : Bins.  reach2 : squared reach [length²].
    partners : (start, values); the nearest image of a pair of user's atom a and values[start[a] :
        start[a + 1]] is left out.
    pairs : output, see Pairs; its atoms count in the order of the bins.
    """
    n_pairs, room = 0, pairs.second.size
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
                n_ranges = atoms_in_reach(bin_x, bin_y, bin_z, bins, ranges)
                for i in range(bin_start[own], bin_start[own + 1]):
                    pairs.start[i] = n_pairs
                    x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
                    for k in range(n_ranges):
                        first_atom, row = i + 1 if k == 0 else ranges[k, 0], ranges[k, 2]
                        tx = ty = tz = 0.0
                        if shifted:
                            tx, ty, tz = translations[row, 0], translations[row, 1], translations[row, 2]
                        for j in range(first_atom, ranges[k, 1]):
                            dx, dy, dz = positions[j, 0] - x + tx, positions[j, 1] - y + ty, positions[j, 2] - z + tz
                            if dx * dx + dy * dy + dz * dz < reach2:
                                if has_excluded and _is_partner(order[i], order[j], partners):
                                    a, b, c = minimum_image(
                                        dx - tx,
                                        dy - ty,
                                        dz - tz,
                                        bins.lattice,
                                        bins.inverse,
                                        bins.pbc,
                                        bins.safe_distance2,
                                    )
                                    nearest = (
                                        ((int(a) + crossed[0]) * rows_y + int(b) + crossed[1]) * rows_z
                                        + int(c)
                                        + crossed[2]
                                    )
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
def atoms_in_reach(bin_x, bin_y, bin_z, bins, ranges):
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
