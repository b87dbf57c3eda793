"""The three ways in which physics or its arithmetic can fail while something runs."""

from typing import Any


class NonFiniteError(ArithmeticError):
    """A position, velocity, force or energy is no longer a finite number. solution : the path before, of small systems."""

    solution: Any = None


class ConstraintError(ArithmeticError):
    """A constraint solver did not reach its tolerance."""


class ConvergenceError(ArithmeticError):
    """The equations of an implicit step could not be solved. solution : the path before."""

    solution: Any = None
