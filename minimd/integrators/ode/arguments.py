"""What a function of the user takes."""

import inspect
from collections.abc import Callable
from typing import Any


def argument_names(function: Callable[..., Any], label: str, wanted: str = "a function") -> list[str] | None:
    """Names of the arguments that a function must be given; None if they cannot be known.

    Raises
    ------
    TypeError : for anything but a function; label is its name in the message, wanted what it should be.
    """
    if not callable(function):
        raise TypeError(f"{label} must be {wanted}; got {function!r}")
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # written in C, such as numpy.sin
        return None
    return [f"*{p.name}" if p.kind is p.VAR_POSITIONAL else p.name for p in parameters if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
