"""Distance constraints and fixed atoms, and the solvers that keep them."""

from minimd.constraints.constraint_set import ConstraintSet
from minimd.constraints.solver import ConstraintSolver
from minimd.structure.constraints import DistanceConstraints, FixedAtoms

__all__ = ["ConstraintSet", "ConstraintSolver", "DistanceConstraints", "FixedAtoms"]
