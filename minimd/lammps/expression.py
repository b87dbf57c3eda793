"""A law u(r) as a text for LAMMPS' styles "lepton": the function of the law is called with symbols,
which record the operations on them.

Lepton differentiates the text itself: only u is needed, not the −u′(r)/r that the law also returns. A law with
conditions on the distance is called for each combination of their outcomes.
P. Eastman et al., PLoS Comput. Biol. 13, e1005659 (2017), for Lepton, the parser of OpenMM.
"""

import builtins
import math
import operator
from collections import Counter
from collections.abc import Callable, Iterator
from functools import reduce
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from minimd.core.compiled.snapshot import globals_read, unread
from minimd.core.potentials.law import evaluate_law, reads_table

MOST_DECISIONS = 8  # conditions that a call of a law may evaluate one after the other
# names in math and numpy: in Lepton
SAME = "sqrt exp log sin cos tan asin acos atan sinh cosh tanh erf erfc floor ceil abs"
FUNCTIONS = {name: name for name in SAME.split()} | {
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
    "fabs": "abs",
    "absolute": "abs",
    "maximum": "max",
    "minimum": "min",
    "where": "select",
}
# names in math and numpy: by operators and other functions
COMPUTED: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "negative": operator.neg,
    "divide": operator.truediv,
    "true_divide": operator.truediv,
    "power": operator.pow,
    "float_power": operator.pow,
    "pow": operator.pow,
    "less": operator.lt,
    "greater": operator.gt,
    "less_equal": operator.le,
    "greater_equal": operator.ge,
    "square": lambda x: x * x,
    "reciprocal": lambda x: 1.0 / x,
    "cbrt": lambda x: x ** (1.0 / 3.0),
    "expm1": lambda x: x.of("exp", x) - 1.0,
    "log1p": lambda x: x.of("log", 1.0 + x),
    "log10": lambda x: x.of("log", x) / math.log(10.0),
    "log2": lambda x: x.of("log", x) / math.log(2.0),
}
LEAVES = {"r": "r", "r2": "(r*r)"}  # symbols without arguments, as they are written


class UnwritableError(ValueError):
    """A law does something that Lepton cannot express."""


class Undecided(Exception):  # noqa: N818 - not an error: it is always caught in this module
    """A law needs the truth value of a condition on its symbols, its argument."""


class Symbol:
    """An unknown number: an operation, and its arguments, which are symbols and numbers.
    decisions : truth values for the conditions in this call of a law, in their order."""

    def __init__(
        self, operation: str, arguments: tuple[Any, ...], decisions: Iterator[bool]
    ) -> None:
        self.operation = operation
        self.arguments = arguments
        self.decisions = decisions

    def of(self, operation: str, *arguments: Any) -> "Symbol":
        """An operation or a function of Lepton with these arguments. √(r²) is r."""
        for argument in arguments:
            if not isinstance(argument, Symbol | int | float | np.number | np.bool_):
                kind = type(argument).__name__
                raise UnwritableError(f"it computes with {kind}, not with numbers")
        base, *powers = arguments or (None,)
        if isinstance(base, Symbol) and base.operation == "r2":
            if operation == "sqrt":
                return self.of("r")
            if operation == "^" and isinstance(powers[0], float) and powers[0] % 1.0 == 0.5:
                return self.of("^", self.of("r"), 2.0 * powers[0])
        return Symbol(operation, arguments, self.decisions)

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
        if name.startswith("__array"):
            raise UnwritableError("it makes arrays")
        raise UnwritableError(f"it uses {name} of its arguments")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **_options: Any) -> Any:
        """Apply a function of numpy to symbols."""
        return applied(ufunc.__name__, *inputs)

    def __array_function__(
        self, function: Callable, _types: Any, inputs: Any, _options: Any
    ) -> Any:
        """Apply functions such as numpy.where to symbols."""
        return applied(function.__name__, *inputs)


OPERATORS: dict[str, Callable[..., Any]] = {  # of Python, by their names in operator; a is a symbol
    "neg": lambda a: 0.0 - a,
    "pos": lambda a: a,
    "abs": lambda a: a.of("abs", a),
    "lt": lambda a, b: 1.0 - (a >= b),
    "gt": lambda a, b: 1.0 - (a <= b),
    "ne": lambda a, b: 1.0 - (a == b),
    "le": lambda a, b: a.of("step", b - a),
    "ge": lambda a, b: a.of("step", a - b),
    "eq": lambda a, b: a.of("delta", a - b),
}
for _name, _sign in {"add": "+", "sub": "-", "mul": "*", "truediv": "/", "pow": "^"}.items():
    OPERATORS[_name] = lambda a, b, sign=_sign: a.of(sign, a, b)
    OPERATORS[f"r{_name}"] = lambda a, b, sign=_sign: a.of(sign, b, a)
for _name, _operation in OPERATORS.items():
    setattr(Symbol, f"__{_name}__", _operation)


def applied(name: str, *inputs: Any) -> Any:
    """Apply a function of math or numpy, given by name, to symbols and numbers.
    Raises UnwritableError if Lepton does not have it."""
    if name in COMPUTED:
        return COMPUTED[name](*(x if isinstance(x, Symbol) else float(x) for x in inputs))
    if name not in FUNCTIONS:
        raise UnwritableError(f"it uses {name}, which Lepton does not have")
    symbol = next(x for x in inputs if isinstance(x, Symbol))
    return symbol.of(FUNCTIONS[name], *inputs)


def energy_expression(law: tuple, parameters: tuple[float, ...]) -> str:
    """u(r) [energy] of a law as an expression for Lepton, with the variable r [length].
    law : law type, with its truncation.
    parameters : its numbers.
    Raises UnwritableError for a law that Lepton cannot express."""
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
        raise UnwritableError(
            f"it evaluates more than {MOST_DECISIONS} conditions one after the other"
        )
    try:
        u, _f = Rewritten().law(law, Symbol("r2", (), iter(decisions)), parameters)
        return u
    except Undecided as stopped:
        condition = stopped.args[0]
        outcomes = [_followed(law, parameters, (*decisions, truth)) for truth in (True, False)]
        return condition.of("select", condition, *outcomes)
    except UnwritableError:
        raise
    except (TypeError, ValueError, AttributeError, NotImplementedError, LookupError) as error:
        raise UnwritableError(str(error)) from None


class Rewritten:
    """Copies of functions that compute with symbols: functions of math, min, max and others take symbols in them."""

    def __init__(self) -> None:
        self._copies: dict[int, Callable] = {}

    def law(self, law: tuple, r2: Any, parameters: tuple[Any, ...]) -> Any:
        """Do what evaluate_law does, see minimd.core.potentials.law."""
        formula = self._value(type(law).python)  # type: ignore[attr-defined]
        return formula(r2, law[0], parameters) if law else formula(r2, *parameters)

    def _value(self, value: Any) -> Any:
        """The replacement of a value that a function reads."""
        if value is evaluate_law:
            return self.law
        if isinstance(value, Dispatcher):
            return self._value(value.py_func)
        if value is math:
            return SimpleNamespace(**{name: self._value(each) for name, each in vars(math).items()})
        if getattr(value, "__module__", None) == "math" or value in (max, min, abs):
            return _taking_symbols(value)
        if not isinstance(value, FunctionType):
            return value
        package = value.__module__.split(".")[0]
        return value if package in ("numpy", "numba") else self._function(value)

    def _function(self, function: FunctionType) -> Callable:
        if id(function) not in self._copies:
            copied = unread(function, function.__defaults__, function.__kwdefaults__)
            self._copies[id(function)] = copied
            known = vars(builtins) | function.__globals__
            for name in globals_read(function.__code__)[0]:
                if name in known:
                    copied.__globals__[name] = self._value(known[name])
            cells = zip(copied.__closure__ or (), function.__closure__ or (), strict=True)
            for ours, theirs in cells:
                ours.cell_contents = self._value(theirs.cell_contents)
        return self._copies[id(function)]


def _taking_symbols(function: Callable) -> Callable:
    """A function of math, or max, min, abs, that takes symbols too."""
    name = function.__name__

    def called(*inputs: Any) -> Any:
        if not any(isinstance(x, Symbol) for x in inputs):
            return function(*inputs)
        if name == "log" and len(inputs) == 2:  # of math, with a base
            return called(inputs[0]) / called(inputs[1])
        if name not in ("max", "min"):
            return applied(name, *inputs)
        return applied(f"{name}imum", *inputs) if len(inputs) == 2 else reduce(called, inputs)

    return called


def written(expression: Any) -> str:
    """A symbol as an expression for Lepton; parts that occur more than once get names, defined after semicolons."""
    uses: Counter[int] = Counter()
    texts: dict[int, str] = {}
    named: list[str] = []

    def count(part: Any) -> None:
        uses[id(part)] += 1
        if isinstance(part, Symbol) and uses[id(part)] == 1:
            for argument in part.arguments:
                count(argument)

    def text(part: Any) -> str:
        if not isinstance(part, Symbol):
            number = float(part)
            if not math.isfinite(number):
                raise UnwritableError(f"it contains the number {number}")
            return repr(number) if number >= 0.0 else f"(0-{-number!r})"

        if id(part) not in texts:
            operation = part.operation
            arguments = [text(argument) for argument in part.arguments]
            whole = LEAVES.get(operation, f"{operation}({','.join(arguments)})")
            if operation in "+-*/^":
                whole = f"({operation.join(arguments)})"
            if uses[id(part)] > 1 and arguments:
                named.append(f"t{len(named) + 1}={whole}")
                whole = f"t{len(named)}"
            texts[id(part)] = whole

        return texts[id(part)]

    count(expression)
    return ";".join([text(expression), *reversed(named)])
