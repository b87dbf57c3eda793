"""Distance constraints and fixed atoms, and the solvers that keep them."""

from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.constraints.solver import ConstraintSolver
from minimd.core.structure.constraints import DistanceConstraints, FixedAtoms

__all__ = ["ConstraintSet", "ConstraintSolver", "DistanceConstraints", "FixedAtoms"]
