"""Rigid bonds for LAMMPS' fix shake: one to three bonds of a middle atom, or a triangle with two equal sides,
such as water."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from minimd.structure.constraints import DistanceConstraints

EQUAL = 1e-12  # largest relative difference of sides of a triangle that count as equal
FLAT = 1e-6  # a triangle is a line if 1 − third side / sum of the two others is below this
MOST_BONDS = 3  # of a middle atom
CAN = "fix shake of LAMMPS holds one to three bonds of a middle atom, or triangles with two equal sides"


class Rigid(NamedTuple):
    """bonds : (B, 2) atoms.  lengths : (B,) [length].  angles : (A, 3) atoms, the middle one second.  openings : (A,)
    [rad]."""

    bonds: NDArray[np.int64]
    lengths: NDArray[np.float64]
    angles: NDArray[np.int64]
    openings: NDArray[np.float64]

    @classmethod
    def of(cls, constraints: DistanceConstraints, n_atoms: int) -> Rigid:
        """The bonds and angles that keep these lengths.  Raises ValueError for molecules that LAMMPS cannot hold."""
        pairs, lengths = constraints.pairs, np.asarray(constraints.lengths)
        links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n_atoms, n_atoms))
        n_molecules, molecule = connected_components(links, directed=False)
        of_pair = molecule[pairs[:, 0]]
        n_bonds, n_members = np.bincount(of_pair, minlength=n_molecules), np.bincount(molecule, minlength=n_molecules)
        degree = np.zeros(n_molecules, dtype=np.int64)
        np.maximum.at(degree, molecule, np.bincount(pairs.ravel(), minlength=n_atoms))
        is_star = (n_bonds == n_members - 1) & (degree == n_bonds) & (n_bonds <= MOST_BONDS)
        is_triangle = (n_bonds == 3) & (n_members == 3)
        wrong = np.flatnonzero(~(is_star | is_triangle | (n_members == 1)))
        if wrong.size:
            atoms = np.flatnonzero(molecule == wrong[0])
            found = f"the rigid molecule of atom {atoms[0]} has {len(atoms)} atoms and {n_bonds[wrong[0]]} lengths"
            raise ValueError(f"{CAN}; {found}: run this scene with minimd")
        in_triangle = is_triangle[of_pair]
        triangles = np.flatnonzero(in_triangle)[np.argsort(of_pair[in_triangle], kind="stable")].reshape(-1, 3)
        stars = np.flatnonzero(~in_triangle)
        first, second, angles, openings = _opened(pairs, lengths, triangles)
        chosen = np.concatenate([stars, first, second])
        return cls(pairs[chosen], lengths[chosen], angles, openings)


def _opened(
    pairs: NDArray[np.int64], lengths: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Two equal sides of each triangle, the atoms of the angle between them, and the angle.  triangles : (A, 3)
    indices of pairs."""
    sides = lengths[triangles]
    differences = np.abs(sides - np.roll(sides, -1, axis=1)) / sides.max(axis=1, keepdims=True, initial=1.0)
    equal = np.argmin(differences, axis=1)  # the first of two equal sides; the second follows it, cyclically
    rows = np.arange(len(triangles))
    if (differences[rows, equal] > EQUAL).any():
        raise ValueError(
            f"{CAN}; that of atom {pairs[triangles[np.argmax(differences[rows, equal] > EQUAL), 0], 0]} has none: run "
            "it with minimd instead"
        )
    first, second, third = (triangles[rows, (equal + k) % 3] for k in range(3))
    if (lengths[third] > (1.0 - FLAT) * (lengths[first] + lengths[second])).any():
        raise ValueError(f"{CAN}, but not three atoms in a line: run this scene with minimd")
    ends, others = pairs[first], pairs[second]
    is_shared = (ends[:, :, None] == others[:, None, :]).any(axis=2)  # of the two ends of the first side
    middle = ends[is_shared]
    last = others[~(others == middle[:, None])]
    angles = np.column_stack([ends[~is_shared], middle, last])
    return first, second, angles, 2.0 * np.arcsin(0.5 * lengths[third] / lengths[first])
