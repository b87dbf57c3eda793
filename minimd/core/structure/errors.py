"""The exceptions for failed physics and for interrupted computations, and the message of an error."""

import os
import re
from typing import Any

# in lines of Numba that name what it cannot compile
TELLING = (
    "Untyped global name",
    "Unknown attribute",
    "No implementation of function",
    "Use of unsupported",
    "cannot be compiled",
    "Unsupported",
)


class NonFiniteError(ArithmeticError):
    """A position, velocity, force or energy is no longer a finite number.

    solution : of a small system, up to the failure.
    crash_report : CrashReport of a simulation.  file :
        to which it was written, or None."""

    solution: Any = None
    crash_report: Any = None
    file: Any = None


class RangeError(NonFiniteError):
    """A force, a momentum or a position has left the range of fixed-point numbers (none has wrapped around); or a
    barostat would strain the cell too much at once."""


class ConstraintError(ArithmeticError):
    """A constraint solver did not reach its tolerance.
    atoms : the two of the constraint.  crash_report, file :
    as for NonFiniteError."""

    atoms: Any = None
    crash_report: Any = None
    file: Any = None


class ConvergenceError(ArithmeticError):
    """The equations of an implicit step could not be solved.
    solution : up to this step."""

    solution: Any = None


class HandOverError(RuntimeError):
    """Another program that was given a scene disagrees with minimd, or has failed."""


class EnsembleError(RuntimeError):
    """All members have failed, with the traceback of the first in the notes; or members cannot be run at all."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a computation that has a partial result.
    result : that result."""

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result


def sentence(error: BaseException) -> str:
    """The message of an error; for one of the operating system with its file name, without its number."""
    if isinstance(error, OSError) and error.strerror is not None:
        file = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
        return f"{file}{error.strerror}"
    is_interrupt = isinstance(error, KeyboardInterrupt)
    return str(error) or ("interrupted" if is_interrupt else type(error).__name__)


def why_not_compiled(message: str) -> str:
    """The line of a message of Numba that names what it cannot compile; else its first line."""
    lines = [line.strip().removeprefix("- ") for line in message.splitlines() if line.strip()]
    reasons = [line for clause in TELLING for line in lines if clause in line]
    return re.sub(r"\x1b\[\d*m", "", [*reasons, *lines, "Numba gives no reason"][0])
