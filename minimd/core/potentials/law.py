"""How loops are given a scalar law u(r): by its type, so that the next process finds the compiled loop again.

A law is one function `law(r2, *parameters)` that returns u [energy] and f = −u′(r)/r [energy/length²]. Its law type is
a named tuple class that law_type ties to it. The law type of a truncated law holds that of the law inside. Law types
hold no parameters: these follow in one flat tuple, first those of the truncation, then those of the law.

A user's law has a class of its own, named after a digest. The index of Numba's cache holds the law types of earlier
runs. It is read with pickle, which looks for their classes in this module; a class that no law of this process needs
stays without a formula.
"""

import functools
import re
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator
from inspect import signature
from math import isfinite, nan
from types import FunctionType
from typing import Any
from uuid import uuid4

import numpy as np
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from minimd.core.compiled.kernels import by_type, in_kernels, kernel, scalar, type_of, without_cache
from minimd.core.compiled.simd import lane, load, total, with_lane
from minimd.core.compiled.simd.vector import count, lanes_for, loaded_columns
from minimd.core.compiled.snapshot import FunctionSnapshot
from minimd.core.structure.checks import checked_kind

STEP = 1e-5  # of a central difference, relative to the distance
ANGLES = (-2.1, -0.7, 1.1, 2.6)  # rad, where laws of dihedrals are tried
ACCURACY, BESIDE_U = 1e-5, 1e-9  # of that difference: relative to itself, and to u
CLASS_NAME = "UserLaw_{}"  # a digest, or a random number


def law_type(name: str, formula: Callable) -> Any:
    """The law type of a compiled law, formula(r2, *numbers) or, with fields, formula(r2, *fields, parameters).

    name : of the variable that it is assigned to in the module of the formula; there the cache and pickles find it.
    """
    python = formula.py_func  # type: ignore[attr-defined]
    _, *fields, last = signature(python).parameters
    if last != "parameters":
        fields = []
    return type_of(formula)(namedtuple(name, fields, module=python.__module__))


def evaluate_law(law, r2, parameters):
    """u(r) [energy] and −u′(r)/r [energy/length²] of one pair at r² = r2.
    law : law type.
    r2 : [length²].
    parameters : tuple of numbers, those of the truncation first."""
    formula = type(law).python  # type: ignore[attr-defined]
    return formula(r2, *law, parameters) if law else formula(r2, *parameters)


@in_kernels(evaluate_law)
def _evaluate_law(law, r2, parameters):
    if not isinstance(law, types.BaseNamedTuple):
        return None
    formula = law.instance_class.formula
    if len(law) == 2:
        return lambda law, r2, parameters: formula(r2, law[0], law[1], parameters)
    if len(law) == 1:
        return lambda law, r2, parameters: formula(r2, law[0], parameters)
    return lambda law, r2, parameters: formula(r2, *parameters)


class UserLaw(namedtuple("UserLaw", "")):
    """Law type of a user's law; each law has a class of its own.
    is_recognized : whether the disk cache may hold its loops; not of laws without a digest, see compiled.snapshot."""

    __slots__ = ()
    is_recognized = True
    python: Callable  # tied to each class with its formula, see type_of

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other)

    __ne__ = object.__ne__  # not that of tuples

    def __hash__(self) -> int:
        return hash(type(self))

    def __reduce__(self) -> tuple:
        return user_law, (type(self).formula,)  # type: ignore[attr-defined]


_classes: dict[str, type[UserLaw]] = {}
_unrecognized: dict[Any, type[UserLaw]] = {}  # by the compiled copy


def __getattr__(name: str) -> type[UserLaw]:
    """The class of this name, for which the index of the cache asks."""
    if re.fullmatch(CLASS_NAME.format("[0-9a-f]{32}"), name):
        return _class_named(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _class_named(name: str) -> type[UserLaw]:
    """The law type of this name, always the same one."""
    return _classes.setdefault(
        name, type(name, (UserLaw,), {"__slots__": (), "__module__": __name__})
    )


def user_law(function: Callable) -> UserLaw:
    """The law type of a plain or compiled function of r² and parameters that returns u and −u′(r)/r.

    The law stays as it is now, compiled and in Python: globals that it reads may change later without effect. Raises
    TypeError if it is not a function.
    """
    wanted = "a function law(r2, *parameters) that returns u and -u'(r)/r"
    checked_kind("law", function, FunctionType | Dispatcher, wanted)
    if function in _unrecognized:  # a copy of a law type asks for it again
        return _unrecognized[function]()
    snapshot = FunctionSnapshot(function)
    named = _class_named(CLASS_NAME.format(snapshot.digest or uuid4().hex))
    if not hasattr(named, "formula"):
        formula: Any = snapshot.function
        if not isinstance(formula, Dispatcher):
            formula = scalar(formula)
        type_of(formula, snapshot.python)(named)

    if not snapshot.digest:
        named.is_recognized = False
        _unrecognized[named.formula] = named  # type: ignore[attr-defined]
    return named()


def checked_law(law: Any) -> Any:
    """The law type of a law: that of a user's function, or the law type itself.
    Raises TypeError for anything else."""
    return law if isinstance(law, tuple) and hasattr(type(law), "formula") else user_law(law)


def nested(law: tuple) -> Iterator[tuple]:
    """A law type, and those inside; also tuples of the numbers or arrays of one, which have no formula."""
    yield law
    for inner in law:
        if isinstance(inner, tuple):
            yield from nested(inner)


def is_user_law(law: tuple) -> bool:
    """True if the law type, or the one inside it, was made by user_law."""
    return any(isinstance(inner, UserLaw) for inner in nested(law))


def reads_table(law: tuple) -> bool:
    """True if the law type, or the one inside it, is a table with a search for the place: vectors cannot do that."""
    return any(getattr(inner, "is_scalar", False) for inner in nested(law))


def is_recognized(law: tuple) -> bool:
    """False if the law type, or the one inside it, is that of a user's law that the disk cache cannot recognize."""
    return all(getattr(inner, "is_recognized", True) for inner in nested(law))


def loop_for(loop: Any, *laws: tuple) -> Any:
    """A kernel for some laws: not cached on disk if the cache cannot recognize one of them."""
    return loop if all(map(is_recognized, laws)) else without_cache(loop)


def law_at(law: tuple, r: float, parameters: tuple[float, ...]) -> tuple[float, float]:
    """u(r) [energy] and −u′(r)/r [energy/length²] of a law at a distance r [length]; NaN where the law gives no real
    number. Raises TypeError if a user's law does not take these parameters or does not return two numbers."""
    return _two_numbers(law, parameters, "r²", "-u'(r)/r", r * r)


def _two_numbers(
    law: tuple, parameters: tuple[float, ...], variable: str, slope: str, x: float
) -> tuple[float, float]:
    """What a law returns at x, see law_at.
    variable, slope : what it takes and returns, for messages."""
    name = type(law).python.__name__ if isinstance(law, UserLaw) else type(law).__name__
    try:
        u, f = evaluate_law(law, x, parameters)
        if isinstance(u, complex) or isinstance(f, complex):
            return nan, nan
        return float(u), float(f)
    except (ArithmeticError, ValueError) as error:
        if "unpack" in str(error):
            raise TypeError(
                f"the law {name} must return two numbers, u and {slope}: {error}"
            ) from None
        return nan, nan
    except (TypeError, NameError, AttributeError, LookupError) as error:
        raise TypeError(
            f"the law {name} must take {variable} and {len(parameters)} parameters "
            f"and return u and {slope}: {error}"
        ) from None


def check_user_law(law: tuple, parameters: tuple[float, ...], distances: Iterable[float]) -> None:
    """Try a user's law at some distances [length]: does it return u and −u′(r)/r? Raises TypeError as law_at;
    ValueError if, at more than half of the distances, the second number is not −u′(r)/r by central differences."""
    _compare(lambda r: law_at(law, r, parameters), lambda r: -1.0 / r, distances, "r", "-u'(r)/r")


def check_law_of_density(
    law: tuple, parameters: tuple[float, ...], densities: Iterable[float]
) -> None:
    """The same for a law of the density of embedded atoms, which returns F and F′(ρ)."""
    at = functools.partial(_two_numbers, law, parameters, "rho", "F'(rho)")
    _compare(at, lambda rho: 1.0, densities, "rho", "F'(rho)")


def check_law_of_angles(law: tuple, parameters: tuple[float, ...]) -> None:
    """The same for a law of dihedral angles, which returns u and u′(φ)."""
    at = functools.partial(_two_numbers, law, parameters, "phi", "u'(phi)")
    _compare(at, lambda phi: 1.0, ANGLES, "phi", "u'(phi)")


def _compare(
    at: Callable, factor: Callable, places: Iterable[float], symbol: str, name: str
) -> None:
    """Raise ValueError unless at(x) returns u and factor(x) u′ at most places.
    symbol, name : of x and the latter."""
    n_compared = 0
    n_wrong = 0
    for x in places:
        u, f = at(x)
        low, _ = at(x * (1.0 - STEP))
        high, _ = at(x * (1.0 + STEP))
        slope = factor(x) * (high - low) / (2.0 * STEP * x)
        if all(map(isfinite, (u, f, slope))):
            n_compared += 1
            if not agree(f, slope, factor(x) * u / x):
                n_wrong += 1
                fault = f"at {symbol} = {x:.4g} it returns {f:.8g} where {name} is {slope:.8g}"
    if 2 * n_wrong > n_compared:
        raise ValueError(f"the law must return u and {name}, to a relative {ACCURACY:g}; {fault}")


def agree(said: float, slope: float, u: float, rough: float = 0.0) -> bool:
    """Whether a force is a slope by central difference; also if they cannot be compared, because one is not finite.
    u : the energy, in the unit of the slope.
    rough : by how much the slope may be wrong besides."""
    return not abs(said - slope) > ACCURACY * max(abs(said), abs(slope)) + BESIDE_U * abs(u) + rough


@scalar
def each_lane(x, law, parameters):
    """A law of numbers on a vector of them.
    parameters : tuple of vectors."""
    u = f = x
    for k in range(count(x)):
        v, g = evaluate_law(law, lane(x, k), _in_lane(parameters, k))
        u, f = with_lane(u, k, v), with_lane(f, k, g)
    return u, f


@by_type
def _in_lane(parameters, k):
    """The numbers in lane k of a tuple of vectors; unrolled by the compiler."""
    if len(parameters) == 0:
        return lambda parameters, k: ()
    return lambda parameters, k: (lane(parameters[0], k),) + _in_lane(parameters[1:], k)


EachLane = law_type("EachLane", each_lane)


@kernel
def sum_over_lanes(law, distances2, parameters, columns, lanes):
    """Σ (u + f) of a law at as many squared distances [length²] as lanes, with parameters that are numbers, and with a
    number for each lane: compiles only if it runs on vectors with both."""
    r2 = load(distances2, 0, lanes)
    u, f = evaluate_law(law, r2, parameters)
    v, g = evaluate_law(law, r2, loaded_columns(columns, 0, lanes))
    return total(u) + total(f) + total(v) + total(g)


@functools.cache
def runs_on_vectors(law: tuple, n_parameters: int) -> bool:
    """Whether a law compiles for vectors: minimd's do, but for tables; one that branches on its arguments does not."""
    if reads_table(law):
        return False
    if is_user_law(law):
        lanes = lanes_for()
        column = np.ones(lanes.size)
        loop = loop_for(sum_over_lanes, law)
        try:
            loop(law, column, (1.0,) * n_parameters, (column,) * n_parameters, lanes)
        except (NumbaError, AttributeError):  # the latter for a constant, which is no vector
            return False
    return True


def on_vectors(law: tuple, n_parameters: int) -> tuple:
    """A law type that runs on vectors: the law, or EachLane of it."""
    return law if runs_on_vectors(law, n_parameters) else EachLane(law)
