"""A law u(r) as a text for LAMMPS' styles "lepton": the function of the law is called with symbols,
which record the operations on them.

Lepton differentiates the text itself: only u is needed, not the −u′(r)/r that the law also returns. A law with
conditions on the distance is called for each combination of their outcomes.
P. Eastman et al., PLoS Comput. Biol. 13, e1005659 (2017), for Lepton, the parser of OpenMM.
"""

from __future__ import annotations

import builtins
import math
import operator
from collections import Counter
from collections.abc import Callable, Iterator
from types import CellType, CodeType, FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from minimd.potentials.law import evaluate_law
from minimd.potentials.tabulated import reads_table

MOST_DECISIONS = 8  # conditions that a call of a law may evaluate one after the other
FUNCTIONS = {  # names in math and numpy: in Lepton
    **{
        name: name
        for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "erf", "erfc", "floor", "ceil")
    },
    **dict(zip(("arcsin", "arccos", "arctan", "asin", "acos", "atan"), ("asin", "acos", "atan") * 2, strict=True)),
    **dict.fromkeys(("abs", "fabs", "absolute"), "abs"),
}
OPERATORS: dict[str, Callable[[Any, Any], Any]] = {  # of numpy
    **dict(
        zip(
            ("add", "subtract", "multiply", "power"),
            (operator.add, operator.sub, operator.mul, operator.pow),
            strict=True,
        )
    ),
    **dict(
        zip(
            ("divide", "true_divide", "float_power", "pow"),
            (operator.truediv, operator.truediv, operator.pow, operator.pow),
            strict=True,
        )
    ),
    **dict(
        zip(
            ("less", "greater", "less_equal", "greater_equal"),
            (operator.lt, operator.gt, operator.le, operator.ge),
            strict=True,
        )
    ),
}


class UnwritableError(ValueError):
    """A law does something that Lepton cannot express."""


class Undecided(Exception):  # noqa: N818 - not an error: it is always caught in this module
    """A law needs the truth value of a condition on its symbols."""

    def __init__(self, condition: Symbol) -> None:
        super().__init__()
        self.condition = condition


def _methods(operation: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """The methods of Symbol for an operator: with the symbol on its left, and on its right."""
    return lambda self, other: self.of(operation, self, other), lambda self, other: self.of(operation, other, self)


class Symbol:
    """An unknown number: an operation, and its arguments, which are symbols and numbers.

    decisions : truth values for the conditions in this call of a law, in their order.
    """

    __hash__ = object.__hash__

    def __init__(self, operation: str, arguments: tuple[Any, ...], decisions: Iterator[bool]) -> None:
        self.operation, self.arguments, self.decisions = operation, arguments, decisions

    def of(self, operation: str, *arguments: Any) -> Symbol:
        """An operation or a function of Lepton with these arguments. √(r²) is r."""
        for one in arguments:
            if not isinstance(one, Symbol | int | float | np.number | np.bool_):
                raise UnwritableError(f"it computes with {type(one).__name__}, not with numbers")
        if arguments and isinstance(arguments[0], Symbol) and arguments[0].operation == "r2":
            if operation == "sqrt":
                return self.of("r")
            if operation == "^" and isinstance(arguments[1], float) and arguments[1] % 1.0 == 0.5:
                return self.of("^", self.of("r"), 2.0 * arguments[1])
        return Symbol(operation, arguments, self.decisions)

    __add__, __radd__ = _methods("+")
    __sub__, __rsub__ = _methods("-")
    __mul__, __rmul__ = _methods("*")
    __truediv__, __rtruediv__ = _methods("/")
    __pow__, __rpow__ = _methods("^")

    def __neg__(self) -> Symbol:
        return self.of("-", 0.0, self)

    def __pos__(self) -> Symbol:
        return self

    def __abs__(self) -> Symbol:
        return self.of("abs", self)

    def __lt__(self, other: Any) -> Symbol:
        return self.of("-", 1.0, self.of("step", self - other))

    def __gt__(self, other: Any) -> Symbol:
        return self.of("-", 1.0, self.of("step", other - self))

    def __le__(self, other: Any) -> Symbol:
        return self.of("step", other - self)

    def __ge__(self, other: Any) -> Symbol:
        return self.of("step", self - other)

    def __eq__(self, other: object) -> Any:
        return self.of("delta", self - other)

    def __ne__(self, other: object) -> Any:
        return self.of("-", 1.0, self == other)

    def __bool__(self) -> bool:
        decision = next(self.decisions, None)
        if decision is None:
            raise Undecided(self)
        return decision

    def __float__(self) -> float:
        raise UnwritableError("it uses a function that takes numbers only")

    def __int__(self) -> int:
        raise UnwritableError("it needs whole numbers")

    def __getattr__(self, name: str) -> Any:
        raise UnwritableError("it makes arrays" if name.startswith("__array") else f"it uses {name} of its arguments")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **_options: Any) -> Any:
        """Apply a function of numpy to symbols."""
        return applied(ufunc.__name__, *inputs)

    def __array_function__(self, function: Callable, _types: Any, inputs: Any, _options: Any) -> Any:
        """Apply functions such as numpy.where to symbols."""
        return applied(function.__name__, *inputs)


def applied(name: str, *inputs: Any) -> Any:
    """Apply a function of math or numpy, given by name, to symbols and numbers.
    Raises UnwritableError if Lepton does not have it."""
    first = next(one for one in inputs if isinstance(one, Symbol))
    if name in OPERATORS:
        return OPERATORS[name](*(x if isinstance(x, Symbol) else float(x) for x in inputs))
    if name in FUNCTIONS:
        return first.of(FUNCTIONS[name], *inputs)
    special: dict[str, Callable[[], Any]] = {
        "maximum": lambda: first.of("max", *inputs),
        "minimum": lambda: first.of("min", *inputs),
        "where": lambda: first.of("select", *inputs),
        "square": lambda: first * first,
        "negative": lambda: -first,
        "reciprocal": lambda: 1.0 / first,
        "expm1": lambda: first.of("exp", first) - 1.0,
        "log1p": lambda: first.of("log", 1.0 + first),
        "log10": lambda: first.of("log", first) / math.log(10.0),
        "log2": lambda: first.of("log", first) / math.log(2.0),
        "cbrt": lambda: first ** (1.0 / 3.0),
    }
    if name not in special:
        raise UnwritableError(f"it uses {name}, which Lepton does not have")
    return special[name]()


def energy_expression(law: tuple, parameters: tuple[float, ...]) -> str:
    """u(r) [energy] of a law as an expression for Lepton, with the variable r [length].

    law : law type, with its truncation.  parameters : its numbers.
    Raises UnwritableError for a law that Lepton cannot express.
    """
    try:
        if reads_table(law):
            raise UnwritableError("it looks up a table")
        return written(_followed(law, parameters, ()))
    except UnwritableError as error:
        while law and isinstance(law[0], tuple) and hasattr(type(law[0]), "python"):
            law = law[0]  # the law that is truncated
        name = type(law).python.__name__  # type: ignore[attr-defined]
        raise UnwritableError(f"LAMMPS' Lepton cannot express the law {name}: {error}") from None


def _followed(law: tuple, parameters: tuple[float, ...], decisions: tuple[bool, ...]) -> Any:
    """u for given outcomes of the first conditions; for each further condition, a choice between its two outcomes."""
    if len(decisions) > MOST_DECISIONS:
        raise UnwritableError(f"it evaluates more than {MOST_DECISIONS} conditions one after the other")
    try:
        r2 = Symbol("r2", (), iter(decisions))
        u, _f = Rewritten().law(law, r2, parameters)
        return u
    except Undecided as stopped:
        both = (_followed(law, parameters, (*decisions, outcome)) for outcome in (True, False))
        return stopped.condition.of("select", stopped.condition, *both)
    except UnwritableError:
        raise
    except (TypeError, ValueError, AttributeError, NotImplementedError, LookupError) as error:
        raise UnwritableError(str(error)) from None


class Rewritten:
    """Copies of functions that compute with symbols: in them, functions of math, min,
    max and others take symbols too."""

    def __init__(self) -> None:
        self._copies: dict[int, Callable] = {}

    def law(self, law: tuple, r2: Any, parameters: tuple[Any, ...]) -> Any:
        """Do what evaluate_law does, see minimd.potentials.law."""
        formula = self._value(type(law).python)  # type: ignore[attr-defined]
        return formula(r2, law[0], parameters) if law else formula(r2, *parameters)

    def _value(self, value: Any) -> Any:
        """The replacement of a value that a function reads."""
        if value is evaluate_law:
            return self.law
        if isinstance(value, Dispatcher):
            return self._value(value.py_func)
        if value is math:
            return SimpleNamespace(**{name: self._value(one) for name, one in vars(math).items()})
        if getattr(value, "__module__", None) == "math" or value in (max, min, abs):
            return _taking_symbols(value)
        return self._function(value) if isinstance(value, FunctionType) and not _is_library(value) else value

    def _function(self, function: FunctionType) -> Callable:
        if id(function) not in self._copies:
            own = {"__builtins__": builtins, "__name__": function.__module__}
            cells = tuple(CellType() for _ in function.__closure__ or ())
            copied = FunctionType(function.__code__, own, function.__name__, function.__defaults__, cells)
            copied.__kwdefaults__ = function.__kwdefaults__
            self._copies[id(function)] = copied
            for name in _names(function.__code__):
                if name in function.__globals__ or hasattr(builtins, name):
                    own[name] = self._value(function.__globals__.get(name, getattr(builtins, name, None)))
            for ours, theirs in zip(cells, function.__closure__ or (), strict=True):
                ours.cell_contents = self._value(theirs.cell_contents)
        return self._copies[id(function)]


def _is_library(function: FunctionType) -> bool:
    return function.__module__.split(".")[0] in ("numpy", "numba")


def _names(code: CodeType) -> set[str]:
    """The names that a code reads, also in functions defined in it."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def _taking_symbols(function: Callable) -> Callable:
    """A function of math, or max, min, abs, that takes symbols too."""
    name = function.__name__

    def called(*inputs: Any) -> Any:
        if not any(isinstance(one, Symbol) for one in inputs):
            return function(*inputs)
        if name in ("max", "min"):
            result = inputs[0]
            for one in inputs[1:]:
                both = (result, one)
                result = applied(f"{name}imum", *both) if any(isinstance(x, Symbol) for x in both) else function(*both)
            return result
        return applied(name, *inputs)

    return called


def written(expression: Any) -> str:
    """A symbol as an expression for Lepton; parts that occur more than once get names, defined after semicolons."""
    if not isinstance(expression, Symbol):
        return _number(expression)
    uses: Counter[int] = Counter()
    _count(expression, uses)
    texts: dict[int, str] = {}
    named: list[str] = []
    whole = _text(expression, uses, texts, named)
    return ";".join([whole, *reversed(named)])


def _count(symbol: Symbol, uses: Counter[int]) -> None:
    uses[id(symbol)] += 1
    if uses[id(symbol)] == 1:
        for one in symbol.arguments:
            if isinstance(one, Symbol):
                _count(one, uses)


def _text(one: Any, uses: Counter[int], texts: dict[int, str], named: list[str]) -> str:
    if not isinstance(one, Symbol):
        return _number(one)
    if id(one) not in texts:
        arguments = [_text(x, uses, texts, named) for x in one.arguments]
        if one.operation in ("r", "r2"):
            text = "r" if one.operation == "r" else "(r*r)"
        else:
            text = (
                f"({one.operation.join(arguments)})"
                if one.operation in "+-*/^"
                else f"{one.operation}({','.join(arguments)})"
            )
            if uses[id(one)] > 1:
                named.append(f"t{len(named) + 1}={text}")
                text = f"t{len(named)}"
        texts[id(one)] = text
    return texts[id(one)]


def _number(value: Any) -> str:
    """A number with all its digits.  Raises UnwritableError for one that is not finite."""
    if not math.isfinite(number := float(value)):
        raise UnwritableError(f"it contains the number {number}")
    return repr(number) if number >= 0.0 else f"(0-{-number!r})"
