"""ASE's constraints as minimd's, and back."""

from typing import Any

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms, FixBondLengths, FixCom, FixConstraint, FixLinearTriatomic
from ase.geometry import find_mic
from numpy.typing import NDArray

from minimd.structure.constraints import TOLERANCE, Constraint, DistanceConstraints, FixedAtoms
from minimd.structure.images import lengths_of

Pairs = tuple[NDArray[np.int64], NDArray[np.float64]]
UNDERSTOOD = "FixAtoms, FixBondLengths, FixBondLength, FixLinearTriatomic, FixCom"


def constraints_of(atoms: Atoms) -> tuple[Constraint, ...]:
    """The constraints of atoms: lengths, linear molecules and fixed atoms. FixCom is left out: see fixes_center.

    Raises ValueError for a constraint of another kind, by name.
    """
    lengths: list[Pairs] = []
    tolerances: list[float] = []
    fixed: list[int] = []
    for constraint in atoms.constraints:
        if isinstance(constraint, FixBondLengths):
            pairs, given = _counted_from_front(constraint.pairs, len(atoms)), constraint.bondlengths
            lengths.append((pairs, _distances(atoms, pairs) if given is None else np.asarray(given, dtype=float)))
            tolerances.append(float(constraint.tolerance))
        elif isinstance(constraint, FixLinearTriatomic):
            lengths.append(_rods(atoms, constraint))
        elif isinstance(constraint, FixAtoms):
            fixed.extend(np.arange(len(atoms))[constraint.index])
        elif type(constraint) is not FixCom:
            name = type(constraint).__name__
            raise ValueError(f"atoms.constraints may hold {UNDERSTOOD}; it holds {name}: remove it, or use ASE's dynamics")
    if fixed and fixes_center(atoms):
        raise ValueError("atoms.constraints holds FixCom and FixAtoms: with fixed atoms the center of mass does not stay by itself; remove one")
    answer: list[Constraint] = [FixedAtoms(np.unique(fixed))] if fixed else []
    if lengths:
        pairs, values = (np.concatenate(part) for part in zip(*lengths, strict=True))
        answer.append(DistanceConstraints(pairs, values, min(tolerances, default=TOLERANCE)))
    return tuple(answer)


def ases_constraints_of(system: Any) -> list[FixConstraint]:
    """The constraints of a system for an ase.Atoms: FixAtoms, and FixBondLengths with the lengths; ASE has one solver of its own."""
    answer: list[FixConstraint] = []
    for constraint in system.constraints:
        if isinstance(constraint, FixedAtoms):
            answer.append(FixAtoms(indices=constraint.atoms))
        else:
            lengths = lengths_of(system.positions, system.cell, constraint)
            answer.append(FixBondLengths(constraint.pairs.copy(), tolerance=constraint.tolerance, bondlengths=lengths.copy()))
    return answer


def fixes_center(atoms: Atoms) -> bool:
    """Whether the center of mass is held. If momentum is conserved, it is enough that it is zero at the start; Engine refuses all other cases."""
    return any(isinstance(constraint, FixCom) for constraint in atoms.constraints)


def _rods(atoms: Atoms, constraint: FixLinearTriatomic) -> Pairs:
    """Both bonds of each molecule and the distance of its ends, the sum of the two."""
    triples = _counted_from_front(constraint.triples, len(atoms))
    arms = np.concatenate([triples[:, [0, 1]], triples[:, [1, 2]]])
    lengths = _distances(atoms, arms)
    return np.concatenate([arms, triples[:, [0, 2]]]), np.concatenate([lengths, lengths.reshape(2, -1).sum(axis=0)])


def _distances(atoms: Atoms, pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    """Distances to the nearest image [Å]."""
    return find_mic(atoms.positions[pairs[:, 1]] - atoms.positions[pairs[:, 0]], atoms.cell, atoms.pbc)[1]


def _counted_from_front(indices: Any, n_atoms: int) -> NDArray[np.int64]:
    """Indices of atoms; negative ones count from the last atom, in ASE as in Python."""
    array = np.asarray(indices, dtype=np.int64)
    return np.where(array < 0, array + n_atoms, array)
