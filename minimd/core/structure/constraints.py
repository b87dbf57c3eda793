"""Constraints of a scene: fixed distances and fixed atoms. Their solvers are in minimd.core.constraints."""

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import checked_pairs, connected
from minimd.core.structure.cell import Cell, nearest_vectors
from minimd.core.structure.checks import (
    MOST_ATOMS,
    checked_array,
    checked_choice,
    checked_number,
    checked_numbers,
    checked_sizes,
)

SolverName = Literal["auto", "newton", "shake"]
TOLERANCE = 1e-12  # of |r² − d²|/d², if none is given


class DistanceConstraints:
    """Pairs of atoms whose distance is held fixed: |r_j − r_i| = d.

    Parameters
    ----------
    pairs : (K, 2) int, any graph: bonds, chains, rings, cages, molecules of three atoms in a line.
    lengths : (K,) or one number [length]; the distances in the start positions if not given.
    tolerance : of |r² − d²|/d², for "shake"; the other solvers are accurate to rounding.
    solver : "auto" (by shape), "newton" (for all), or "shake" (SHAKE and RATTLE sweeps, for all).

    Raises
    ------
    ValueError : for no pairs, an atom paired with itself, or a pair given twice; lengths that are not positive; a
        tolerance that is not between 0 and 1; an unknown solver.
    """

    def __init__(
        self,
        pairs: ArrayLike,
        lengths: ArrayLike | None = None,
        tolerance: float = TOLERANCE,
        solver: SolverName = "auto",
    ) -> None:
        self.pairs = checked_pairs("pairs", pairs)
        if not len(self.pairs):
            raise ValueError(
                "pairs of DistanceConstraints must name at least one pair; there is none"
            )

        self.lengths: Array | None = None
        if lengths is not None:
            numbers = checked_numbers("lengths", lengths, "one number, or one for each pair")
            if numbers.shape == (1,):
                numbers = numbers.reshape(())
            self.lengths = checked_sizes("lengths", numbers, len(self.pairs), "pair")

        self.tolerance = checked_number("tolerance", tolerance)
        self.solver = checked_choice("solver", solver, get_args(SolverName))
        if not 0.0 < self.tolerance < 1.0:
            raise ValueError(
                f"tolerance, of |r² − d²|/d², must lie between 0 and 1; tolerance = {tolerance!r}"
            )

    def __repr__(self) -> str:
        return f"DistanceConstraints({len(self.pairs)} pairs, solver={self.solver!r})"


class FixedAtoms:
    """Atoms that stay where they are.

    Parameters
    ----------
    atoms : indices (an empty list for no atoms), or one bool for each atom.

    Raises
    ------
    ValueError : for anything else. A Simulation raises it for atoms that do not exist, or a wrong number of bools.
    """

    def __init__(self, atoms: ArrayLike) -> None:
        expected = "a list of indices, counted from 0, or one bool for each atom"
        chosen = checked_array("fixed atoms", atoms, expected, "bi")
        if chosen.ndim != 1 or (chosen.size and not 0 <= chosen.min() <= chosen.max() < MOST_ATOMS):
            raise ValueError(f"fixed atoms must be {expected}; got {shown(atoms)}")
        self._n_bools = None
        if chosen.dtype == bool:
            self._n_bools = chosen.size or None
            self.atoms = np.flatnonzero(chosen)
        else:
            self.atoms = np.unique(chosen.astype(np.int64))

    def __repr__(self) -> str:
        return f"FixedAtoms({len(self.atoms)} atoms)"

    def check_size(self, n_atoms: int) -> None:
        """Raise ValueError if the indices or the bools do not fit a system of n_atoms atoms."""
        if self._n_bools not in (None, n_atoms):
            raise ValueError(
                f"fixed atoms must be given as indices, or as one bool for each of {n_atoms} atoms; "
                f"got {self._n_bools} bools"
            )
        if self.atoms.max(initial=-1) >= n_atoms:
            raise ValueError(
                f"fixed atoms must be among 0 to {n_atoms - 1}; they name atom {self.atoms.max()}"
            )


Constraint = DistanceConstraints | FixedAtoms


def lengths_of(positions: Array, cell: Cell, constraints: DistanceConstraints) -> Array:
    """(K,) [length], as given; else the present distances to the nearest image."""
    if constraints.lengths is not None:
        return constraints.lengths
    return np.linalg.norm(nearest_vectors(positions, cell, constraints.pairs), axis=1)


def joined_pairs(system: Any) -> Indices:
    """(B, 2) the pairs of atoms that bonds and lengths held fixed connect, and sites with their parents 0."""
    joined = [each.pairs for each in system.constraints if isinstance(each, DistanceConstraints)]
    if system.sites is not None:
        joined.append(system.sites.pairs)
    return np.concatenate([system.bonds, *joined])


def molecules_of(system: Any) -> Indices:
    """(N,) the number of the molecule of each atom: bonds and lengths held fixed connect the atoms of a molecule."""
    return connected(joined_pairs(system), len(system))
