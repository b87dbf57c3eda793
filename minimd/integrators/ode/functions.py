"""Functions of the user: which arguments they take, and their answers as arrays.

A function is written with the arguments it needs, under the names that the problem gives them. It cannot depend on an
argument that it does not take, and from this a method knows which steps are explicit. A function that takes all
arguments may depend on all of them: its steps are solved as implicit ones,
in one iteration where they turn out to be explicit.
"""

import inspect
from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np

from minimd.console.words import shown
from minimd.integrators.method import Array

Function = Callable[..., Any]


def argument_names(function: Function, label: str, wanted: str = "a function") -> list[str] | None:
    """Names of the arguments that a function must be given; None if they cannot be known.

    Raises TypeError for anything but a function; label is its name in the message, wanted what it should be.
    """
    if not callable(function):
        raise TypeError(f"{label} must be {wanted}; got {shown(function)}")
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # written in C, such as numpy.sin
        return None
    return [
        f"*{p.name}" if p.kind is p.VAR_POSITIONAL else p.name
        for p in parameters
        if p.default is p.empty and p.kind is not p.VAR_KEYWORD
    ]


def checked_values(answer: Any, shape: tuple[int, ...] | None, name: str) -> Array:
    """A fresh flat array of an answer of this shape; a single number may come without brackets.

    Raises TypeError for anything but real numbers, ValueError for an answer of another shape, if one is given.
    """
    values = np.array(answer)
    if values.dtype.kind not in "fiub":
        raise TypeError(f"{name} must answer with real numbers; got {shown(answer)}")
    if shape is not None and values.shape != shape and not values.size == prod(shape) == 1:
        raise ValueError(f"{name} must answer with an array of shape {shape}; got shape {values.shape}")
    return values.reshape(-1).astype(float, copy=False)


def check_finite(y: Array) -> None:
    """Raise ValueError if an element of the initial state is not finite."""
    if not np.isfinite(y).all():
        k = int(np.argmin(np.isfinite(y)))
        raise ValueError(f"the start must be finite; element {k} is {y[k]}")


class Field:
    """A function of t, q and v, or of some of them, called with all three; its answers are fresh flat arrays.

    usual : the arguments of a function whose own names cannot be known or are others.
    """

    def __init__(self, function: Function, usual: str, name: str) -> None:
        self.takes, self.name = _arguments(function, usual, name), name
        self.shape: tuple[int, ...] | None = None  # of its answers, known once there is a start
        self._call = _CALLS[self.takes](function)

    @property
    def arguments(self) -> str:
        """What it takes, in words."""
        return ", ".join(self.takes)

    def __call__(self, t: float, q: Array, v: Array) -> Array:
        """(n,) values of the function."""
        return checked_values(self._call(t, q, v), self.shape, self.name)


_CALLS: dict[str, Callable[[Function], Function]] = {
    "": lambda f: lambda t, q, v: f(),
    "t": lambda f: lambda t, q, v: f(t),
    "q": lambda f: lambda t, q, v: f(q),
    "v": lambda f: lambda t, q, v: f(v),
    "tq": lambda f: lambda t, q, v: f(t, q),
    "tv": lambda f: lambda t, q, v: f(t, v),
    "qv": lambda f: lambda t, q, v: f(q, v),
    "tqv": lambda f: f,
}


def _arguments(function: Function, usual: str, name: str) -> str:
    """Which of t, q, v a function takes: by their names, else by their number if that is the usual one or three."""
    names = argument_names(function, name)
    if names is None:
        return usual
    if set(names) <= set("tqv") and "".join(names) in _CALLS:
        return "".join(names)
    places = "tqv" if len(names) == 3 else usual
    if len(names) == len(places) and all(
        given == place or given not in ("t", "q", "v") for given, place in zip(names, places, strict=True)
    ):
        return places
    raise TypeError(
        f"{name} must take some of t, q, v, in this order and under these names; it takes ({', '.join(names)})"
    )


def of_time_and_state(function: Function, name: str) -> Function:
    """A function of y, or of t and y, as one of t and y.  Raises TypeError for anything else."""
    names = argument_names(function, name) or ["y"]
    if names == ["t"]:
        return lambda t, y: function(t)
    if len(names) > 2 or (len(names) == 2 and (names[0] == "y" or names[1] == "t")):
        raise TypeError(f"{name} must take y, or t and y, in this order; it takes ({', '.join(names)})")
    return function if len(names) == 2 else lambda t, y: function(y)


def taking(function: Function, names: tuple[str, ...], label: str) -> Function:
    """The function as one of all the named arguments, of which it may take some, under these names and in this order;
    its answer is flat.

    Raises TypeError for anything else.
    """
    known = argument_names(function, label, f"a function of {', '.join(names)}")
    takes = list(names) if known is None else known
    if len(takes) == len(names):
        return lambda *values: np.array(function(*values), dtype=float).reshape(-1)
    if takes != [name for name in names if name in takes]:
        raise TypeError(
            f"{label} must take some of {', '.join(names)}, in this order and under these names; it takes "
            f"({', '.join(takes)})"
        )
    chosen = [names.index(name) for name in takes]
    return lambda *values: np.array(function(*(values[k] for k in chosen)), dtype=float).reshape(-1)
