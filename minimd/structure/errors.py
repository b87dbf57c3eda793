"""The three ways in which physics or its arithmetic can fail while something runs, and the one in which a user ends it."""

from typing import Any


class NonFiniteError(ArithmeticError):
    """A position, velocity, force or energy is no longer a finite number.

    solution : the path before, of small systems.  crash_report : CrashReport of a simulation.  file : where that was written, or None.
    """

    solution: Any = None
    crash_report: Any = None
    file: Any = None


class ConstraintError(ArithmeticError):
    """A constraint solver did not reach its tolerance.  atoms : the two it holds.  crash_report, file : as of NonFiniteError."""

    atoms: Any = None
    crash_report: Any = None
    file: Any = None


class ConvergenceError(ArithmeticError):
    """The equations of an implicit step could not be solved. solution : the path before."""

    solution: Any = None


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a computation that has something to show for itself. result : how far it came."""

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result
