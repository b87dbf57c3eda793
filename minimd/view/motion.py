"""Atoms in motion, small enough for a page: some frames of a run, as integers of 16 bits.

    r = Σ_k (low_k + width_k q_k / 2¹⁶) lattice_k        k = 1, 2, 3;  q_k = 0 … 2¹⁶ − 1

Along periodic directions of the reduced lattice low is 0 and width is 1: q counts fractions of the lattice vector, a
sum that overflows leads to the next cell, and the difference of two q, as a signed number, is that of nearest images.
Along open directions each frame has its own bounds.
"""

from collections.abc import Sequence
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from minimd.files.turned_cell import as_in_run
from minimd.mdanalysis.universes import RunUniverse
from minimd.structure.cell import Cell
from minimd.structure.constraints import DistanceConstraints
from minimd.structure.system import System

Array = NDArray[np.float64]
LEVELS = 2**16
BYTES = 5_000_000  # of all positions, at most: 4000 atoms in 200 frames are 4.8 MB
ATOMS = 50_000  # at most: the number that the graphics of a laptop draws smoothly
SAMPLED = 2000  # atoms from which the distance of neighbors is computed


class Motion(NamedTuple):
    """Some frames of a run.

    frames : (T,) int, indices in the file.  atoms : (A,) int, indices in the system.  counts : (T, A, 3) uint16, q.
    low, width : (T, 3), dimensionless along periodic directions, [length] along open ones.
    steps, times, temperatures : (T,) int, [ps or τ], [temperature].  bonds : (B, 2) int, see bonds_among.
    apart : for each species the distance to the nearest neighbor [length], the median in the first frame shown.
    cell : Cell.  n_frames, n_atoms : of the file.
    """

    frames: NDArray[np.int64]
    atoms: NDArray[np.int64]
    counts: NDArray[np.uint16]
    low: Array
    width: Array
    steps: NDArray[np.int64]
    times: Array
    temperatures: Array
    bonds: NDArray[np.int64]
    apart: Array
    cell: Cell
    n_frames: int
    n_atoms: int

    def positions(self, k: int) -> Array:
        """(A, 3) [length] of frame k, off by at most half of width/2¹⁶ along each lattice vector,
        and by any vector of the periodic lattice."""
        positions: Array = (self.low[k] + self.width[k] * self.counts[k] / LEVELS) @ self.cell.lattice
        return positions


def motion_of(made: RunUniverse, most: int, marked: Sequence[int] = (), latest: bool = False) -> Motion:
    """The motion in a file whose universe is open.

    most : largest number of frames; fewer are used if there are many atoms.
    latest : the last frames, in place of evenly chosen ones.
    marked : atoms that are always shown; all are shifted so that, in the last frame, the first of these is in the
        middle of the cell.
    """
    contents, system = made.contents, made.contents.system
    cell, record, atoms = system.cell, contents.record, chosen_atoms(len(system), marked)
    frames = chosen_frames(contents.n_frames, min(most, max(2, BYTES // (6 * len(atoms)))), latest)
    inverses = np.linalg.inv(cell.reduction @ record.cell[frames]) if "cell" in record else [cell.inverse] * len(frames)
    looks = (made.trajectory[int(k)] for k in frames)
    places = (as_in_run(ts, ts.positions[atoms]) / system.units.to_angstrom for ts in looks)
    fractions = np.array([place @ inverse for place, inverse in zip(places, inverses, strict=True)])
    if marked:
        middle = 0.5 * cell.vectors.sum(axis=0) @ cell.inverse
        fractions += np.where(cell.pbc, middle - fractions[-1, np.searchsorted(atoms, marked[0])], 0.0)
    counts, low, width = counted(fractions, cell.pbc)
    steps, times = record.step[frames], record.time[frames] * system.units.to_picosecond
    bonds, place = bonds_among(atoms, system), fractions[0] @ cell.lattice
    apart = neighbor_distances(place, system.species_index[atoms], len(system.species_names))
    shown = (frames, atoms, counts, low, width, steps, times, record.temperature[frames], bonds, apart)
    return Motion(*shown, cell, contents.n_frames, len(system))


def bonds_among(atoms: NDArray[np.int64], system: System) -> NDArray[np.int64]:
    """(B, 2) pairs of indices in atoms: bonded pairs, and pairs whose length is held fixed, if both atoms are shown;
    each pair once."""
    held = [one.pairs for one in system.constraints if isinstance(one, DistanceConstraints)]
    place = np.full(len(system), -1)
    place[atoms] = np.arange(len(atoms))
    pairs = place[np.unique(np.sort(np.concatenate([system.bonds, *held]), axis=1), axis=0)]
    return pairs[(pairs >= 0).all(axis=1)]


def chosen_frames(n_frames: int, most: int, latest: bool = False) -> NDArray[np.int64]:
    """Indices of at most `most` frames: the last ones, or evenly chosen ones with the first and the last."""
    if latest:
        return np.arange(max(0, n_frames - most), n_frames)
    return np.unique(np.rint(np.linspace(0, n_frames - 1, min(most, n_frames))).astype(np.int64))


def chosen_atoms(n_atoms: int, marked: Sequence[int] = ()) -> NDArray[np.int64]:
    """All atoms, or every n-th and the marked ones."""
    return np.union1d(np.arange(0, n_atoms, ceil(n_atoms / ATOMS)), np.asarray(marked, dtype=np.int64))


def counted(fractions: Array, pbc: NDArray[np.bool_]) -> tuple[NDArray[np.uint16], Array, Array]:
    """q, low and width, (T, A, 3), (T, 3), (T, 3), of coordinates along the lattice, (T, A, 3)."""
    lowest, extent = fractions.min(axis=1), np.ptp(fractions, axis=1)
    open_width = np.where(extent > 0.0, extent, 1.0) * LEVELS / (LEVELS - 1)
    low, width = np.where(pbc, 0.0, lowest), np.where(pbc, 1.0, open_width)
    counts = np.rint((fractions - low[:, None]) / width[:, None] * LEVELS)
    return (counts % LEVELS).astype(np.uint16), low, width


def neighbor_distances(positions: Array, species: NDArray[np.int64], n_species: int) -> Array:
    """Median distance to the nearest other atom for each species [length], without images; 1 without another atom."""
    some = np.arange(0, len(positions), ceil(len(positions) / SAMPLED))
    if len(positions) < 2:
        return np.ones(n_species)
    nearest = cKDTree(positions).query(positions[some], k=2)[0][:, 1]
    each = [nearest[species[some] == k] for k in range(n_species)]
    medians = [np.median(own if len(own) else nearest) for own in each]
    return np.where(np.array(medians) > 0.0, medians, 1.0)
