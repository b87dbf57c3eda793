"""The two ways in which physics can fail while a simulation runs."""


class NonFiniteError(ArithmeticError):
    """A position, velocity, force or energy is no longer a finite number."""


class ConstraintError(ArithmeticError):
    """A constraint solver did not reach its tolerance."""
