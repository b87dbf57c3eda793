"""Functions of the user: which arguments they take, their answers as arrays, and their derivatives by differences.

A function is written with the arguments it needs, under the names that the problem gives them. It cannot depend on an
argument that it does not take, and from this a method knows which steps are explicit. A function that takes all
arguments may depend on all of them: its steps are solved as implicit ones, in one iteration if they turn out explicit.

    forward_differences      order 1, some 8 digits     matrices of Newton's method, whose errors vanish with it
    central_differences      order 2, some 11 digits     the same where ranks are judged too
    accurate_differences     order 6, some 13 digits    derivatives in the equations themselves, as G in −Gᵀ λ
    time_derivative          order 6, some 12 digits     along a path
    second time_derivative   order 6, some 10 digits

Of order 6:  f′ = (45 Δ₁ − 9 Δ₂ + Δ₃)/(60 s) + O(s⁶),  Δ_j = f(js) − f(−js).  The one of order 4, (8 Δ₁ − Δ₂)/(12 s),
estimates the error. B. Fornberg, Math. Comput. 51, 699 (1988), table 1.
"""

import inspect
from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np

from minimd.core.compiled.machine import EPS
from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_kind

Function = Callable[..., Any]
Map = Callable[[Array], Array]
Path = Callable[[float], Array]


def arguments(
    function: Function, names: str, label: str, usual: str, wanted: str, unknown: str
) -> list[str]:
    """Which of the named arguments a function takes: by their names and in their order, else by their number, if it
    takes all of them or the usual ones.
    names, usual : separated by blanks; all are usual if none is.
    unknown : what a function takes that cannot be asked, if not the usual.
    Raises TypeError for anything else; label is its name in the message, wanted what it should be."""
    checked_kind(label, function, Callable, wanted)
    every = names.split()
    most = usual.split() or every
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # written in C, such as numpy.sin
        return unknown.split() or most

    taken = []

    for parameter in parameters:
        if parameter.kind is parameter.VAR_POSITIONAL:
            taken.append(f"*{parameter.name}")
        elif parameter.kind is not parameter.VAR_KEYWORD and parameter.default is parameter.empty:
            taken.append(parameter.name)

    if taken == [name for name in every if name in taken]:
        return taken
    places = every if len(taken) == len(every) else most
    pairs = zip(taken, places, strict=False)
    are_other_names = all(name == place or name not in every for name, place in pairs)
    if len(taken) == len(places) and are_other_names:
        return places
    alternative = "" if most == every else f"{', '.join(most)}, or "
    raise TypeError(
        f"{label} must take {alternative}some of {', '.join(every)}, in this order and under these names; it takes "
        f"({', '.join(taken)})"
    )


def reading(
    function: Function,
    names: str,
    label: str,
    usual: str = "",
    wanted: str = "a function",
    unknown: str = "",
) -> tuple[list[str], Function]:
    """Which of the named arguments a function takes, and the function as one of all of them.  See arguments."""
    taken = arguments(function, names, label, usual, wanted, unknown)
    # written out, as a named tuple does it: a call through *values takes longer than many a force
    code = f"lambda {', '.join(names.split())}: function({', '.join(taken)})"
    return taken, eval(code, {"function": function})


def taking(function: Function, names: str, label: str) -> Function:
    """The function as one of all the named arguments, of which it may take some; its answer is flat."""
    _, answer = reading(function, names, label, wanted=f"a function of {', '.join(names.split())}")
    return lambda *values: np.array(answer(*values), dtype=float).reshape(-1)


class VectorField:
    """A function of t, q and v, or of some of them, called with all three; its answers are fresh flat arrays.

    usual : the arguments of a function whose own names cannot be known or are others."""

    def __init__(self, function: Function, usual: str, name: str) -> None:
        self.name = name
        self.takes, self._call = reading(function, "t q v", name, usual)
        self.shape: tuple[int, ...] | None = None  # of its answers, known once there is a start

    def __call__(self, t: float, q: Array, v: Array) -> Array:
        """(n,) values of the function."""
        return checked_values(self._call(t, q, v), self.shape, self.name)


def checked_values(answer: Any, shape: tuple[int, ...] | None, name: str) -> Array:
    """A fresh flat array of an answer of this shape; a single number may come without brackets.
    Raises TypeError for anything but real numbers, ValueError for an answer of another shape, if one is given."""
    values = np.array(answer)
    if values.dtype.kind not in "fiub":
        raise TypeError(f"{name} must answer with real numbers; got {shown(answer)}")
    if shape is not None and values.shape != shape and not values.size == prod(shape) == 1:
        raise ValueError(
            f"{name} must answer with an array of shape {shape}; got shape {values.shape}"
        )
    return values.reshape(-1).astype(float, copy=False)


def check_finite(y: Array) -> None:
    """Raise ValueError if an element of the initial state is not finite."""
    if not np.isfinite(y).all():
        k = np.argmin(np.isfinite(y))
        raise ValueError(f"the start must be finite; element {k} is {y[k]}")


# step of central differences relative to a variable: truncation and rounding are then alike, some 1e-11
CENTRAL = EPS ** (1.0 / 3.0)
FORWARD = EPS**0.5  # the same of forward differences: some 1e-8
LEAST = 1e-3  # smallest size of a variable for its step, relative to the largest one
LEAST_WIDE = 0.125  # the same for accurate differences, which narrow a step that is too wide
# of the points, in spacings; differences from the value at 0 are weighted
OFFSETS = np.array([-3, -2, -1, 1, 2, 3])
WEIGHTS = {  # for the first and second derivative: formulas of order 6 and 4
    1: (np.array([-1, 9, -45, 45, -9, 1]) / 60.0, np.array([0, 1, -8, 8, -1, 0]) / 12.0),
    2: (np.array([2, -27, 270, 270, -27, 2]) / 180.0, np.array([0, -1, 16, 16, -1, 0]) / 12.0),
}
RESTING = 1e-13  # lower rates are rounding, and the path is at rest [1/time]
NOISE = 10.0 * EPS  # rounding of a function, relative to its change over the widest spacing
SPACINGS = 0.1 / 3.0 ** np.arange(12)  # in units of the time in which a path changes by its size
# in units of a variable: powers of two, so that x ± s has no rounding
NARROWING = 2.0**-8 / 4.0 ** np.arange(12)
# an error that has grown by this factor, of a derivative this near the best one, is noise: it grows with spacing
GROWN = 16.0
NEAR = 0.03
# relative error of the formula of order 4 with which the search ends: that of order 6 is then some 1e-13
ENOUGH = 1e-9


def forward_differences(function: Map, x: Array, at_x: Array) -> Array:
    """∂function/∂x, one column per variable: half the evaluations of central differences.
    at_x : function(x)."""
    return _differences(function, x, FORWARD * _sizes(x, LEAST), at_x)


def central_differences(function: Map, x: Array, step: float = CENTRAL, size: float = 0.0) -> Array:
    """∂function/∂x, one column per variable.
    step : relative to each variable; wide for noisy functions.
    size : of the largest variable, where x may be smaller by chance."""
    return _differences(function, x, step * _sizes(x, LEAST, size))


def _sizes(x: Array, least: float, largest: float = 0.0) -> Array:
    """(n,) sizes of variables.
    least : relative to the largest, which is at least as large as given; none is zero."""
    return np.maximum(np.abs(x), least * (max(np.abs(x).max(), largest) or 1.0))


def _differences(function: Map, x: Array, steps: Array, at_x: Array | None = None) -> Array:
    """Those between x + step and x − step, or x itself if the value there is given."""
    columns = []
    for k, step in enumerate(steps):
        ahead = x.copy()
        ahead[k] += step
        values = function(ahead)
        behind = x.copy()
        if at_x is None:
            behind[k] -= step
            change = values - function(behind)
        else:
            change = values - at_x
        columns.append(change / (ahead[k] - behind[k]))
    return np.stack(columns, axis=-1)


def accurate_differences(function: Map, x: Array, narrowed: float = 1.0) -> Array:
    """∂function/∂x, one column per variable, to some 1e-13, at worst 1e-12 of the terms of the function:
    six evaluations of it for a variable.
    Spacings are up to 1/256 of a variable, and are narrowed while the formulas of order 6 and 4 differ, or the function
    has no value there.
    narrowed : factor of all spacings.  The result is NaN where no spacing gives one."""
    at_x = np.tile(function(x), (x.size, 1))
    units = narrowed * np.exp2(np.floor(np.log2(_sizes(x, LEAST_WIDE))))

    def along_each(e: float) -> Array:
        return np.array([function(x + step) for step in np.diag(e * units)])

    rows = _derivative(along_each, at_x, 1, NARROWING.tolist(), ENOUGH) / units[:, None]
    return rows.T


def derivative(function: Map, jacobian: Map | None, x: Array) -> Array:
    """∂function/∂x, (m, n): of the user, a function of x with m n numbers, else by accurate differences."""
    if jacobian is None:
        return accurate_differences(function, x)
    return np.array(jacobian(x), float).reshape(-1, x.size)


def error_of_differences(function: Map, x: Array) -> float:
    """Relative error of accurate_differences, estimated from those with half the spacing."""
    wide = accurate_differences(function, x)
    narrow = accurate_differences(function, x, 0.5)
    return float(np.abs(wide - narrow).max() / (np.abs(wide).max() or 1.0))


def remark_on_differences(function: Map, jacobian: Any, x: Array) -> str:
    """Says that G = ∂g/∂q is found by accurate differences, with their error at x, if the user gives none."""
    if jacobian is not None:
        return ""
    error = max(error_of_differences(function, x), EPS)
    return f"G = ∂g/∂q by differences, with a relative error of {error:.0e} at the start"


def unit_of_time(y: Array, *derivatives: Array) -> float:
    """The time in which a path y + ε y′ + ε²/2 y″ changes by its own size; 1 if it rests."""
    size = np.abs(y).max() or 1.0
    fastest = 0.0
    for k, derivative in enumerate(derivatives, start=1):
        fastest = max(fastest, (np.abs(derivative).max() / size) ** (1.0 / k))
    return 1.0 / fastest if fastest > RESTING else 1.0


def time_derivative(path: Path, order: int, unit: float) -> Array:
    """The first or second derivative of a path at 0.
    unit : time in which the path changes by its size [time]."""
    return _derivative(path, path(0.0), order, (unit * SPACINGS).tolist())


def _derivative(
    path: Path, start: Array, order: int, spacings: list[float], enough: float = 0.0
) -> Array:
    """A derivative at 0, each element from the spacing with its least estimated error: |order 6 − order 4| + rounding.
    start : path(0).
    spacings : widest first.
    enough : relative error with which an element is settled."""
    best = np.full(start.shape, np.nan)
    least = np.full(start.shape, np.inf)
    largest = np.zeros(start.shape)

    for spacing in spacings:
        try:
            with np.errstate(all="ignore"):
                values = np.array([path(k * spacing) for k in OFFSETS]) - start
        except (ValueError, ArithmeticError):  # outside the domain of a function such as math.sqrt
            continue

        scale = spacing**order
        sixth, fourth = (np.tensordot(weights, values, 1) / scale for weights in WEIGHTS[order])
        changes = np.abs(values).max(axis=0)
        largest = np.fmax(largest, changes)
        error = np.abs(sixth - fourth) + NOISE * largest / scale
        better = error < least
        best[better] = sixth[better]
        least[better] = error[better]
        is_noise = (error > GROWN * least) & (np.abs(sixth - best) < NEAR * np.abs(best))
        least[is_noise | (error <= enough * changes / scale)] = 0.0
        if not least.any():
            break

    return best
