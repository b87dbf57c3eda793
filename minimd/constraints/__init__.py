"""Lengths and atoms that are held fixed, each shape with the solver that suits it."""

from minimd.constraints.constraint_set import ConstraintSet
from minimd.constraints.solver import ConstraintSolver
from minimd.structure.constraints import DistanceConstraints, FixedAtoms

__all__ = ["ConstraintSet", "ConstraintSolver", "DistanceConstraints", "FixedAtoms"]
