"""How loops are given a scalar law u(r): by its type, so that the next process finds the compiled loop again.

A law is one function `law(r2, *parameters)` that returns u [energy] and f = −u′(r)/r [energy/length²]. Its law type is
a named tuple class that law_type ties to it. The law type of a truncated law holds that of the law inside. Law types
hold no parameters: these follow in one flat tuple, first those of the truncation, then those of the law.
"""

from collections import namedtuple
from collections.abc import Callable, Iterable
from inspect import signature
from math import isfinite, nan
from typing import Any

from numba.core import types
from numba.extending import overload

from minimd.compiled.kernels import type_of
from minimd.potentials.user_laws import UserLaw, user_law

STEP = 1e-5  # of a central difference, relative to the distance
ACCURACY, BESIDE_U = 1e-4, 1e-9  # of that difference: relative to itself, and to u


def law_type(name: str, formula: Callable) -> Any:
    """The law type of a compiled law, formula(r2, *parameters), or of one around another, formula(r2, law, parameters).

    name : of the variable that it is assigned to in the module of the formula; there the cache and pickles find it.
    """
    python = formula.py_func  # type: ignore[attr-defined]
    fields = ["law"] if "law" in signature(python).parameters else []
    return type_of(formula)(namedtuple(name, fields, module=python.__module__))


def checked_law(law: Any) -> Any:
    """The law type of a law: that of a user's function, or the law type itself.  Raises TypeError for anything else."""
    return law if isinstance(law, tuple) and hasattr(type(law), "formula") else user_law(law)


def law_at(law: tuple, r: float, parameters: tuple[float, ...]) -> tuple[float, float]:
    """u(r) [energy] and −u′(r)/r [energy/length²] of a law at a distance r [length]; NaN where the law gives no real
    number. Raises TypeError if a user's law does not take these parameters or does not return two numbers."""
    try:
        u, f = evaluate_law(law, r * r, parameters)
        return (nan, nan) if isinstance(u, complex) or isinstance(f, complex) else (float(u), float(f))
    except (ArithmeticError, ValueError) as error:
        if "unpack" in str(error):
            raise TypeError(f"the law {_name(law)} must return two numbers, u and -u'(r)/r: {error}") from None
        return nan, nan
    except (TypeError, NameError, AttributeError, LookupError) as error:
        wanted = f"take r² and {len(parameters)} parameters and return u and -u'(r)/r"
        raise TypeError(f"the law {_name(law)} must {wanted}: {error}") from None


def _name(law: tuple) -> str:
    return type(law).python.__name__ if isinstance(law, UserLaw) else type(law).__name__


def check_user_law(law: tuple, parameters: tuple[float, ...], distances: Iterable[float]) -> None:
    """Try a user's law at some distances [length]: does it return u and −u′(r)/r? Raises TypeError as law_at;
    ValueError if, at more than half of the distances, the second number is not −u′(r)/r by central differences."""
    tried, wrong = 0, []
    for r in distances:
        u, f = law_at(law, r, parameters)
        low, high = (law_at(law, r * (1.0 + h), parameters)[0] for h in (-STEP, STEP))
        slope = (low - high) / (2.0 * STEP * r * r)
        if isfinite(u) and isfinite(f) and isfinite(slope):
            tried += 1
            if not agree(f, slope, u / r**2):
                wrong.append(f"at r = {r:.4g} it returns {f:.6g} where -u'(r)/r is {slope:.6g}")
    if 2 * len(wrong) > tried:
        raise ValueError(f"the law must return u and -u'(r)/r; {wrong[-1]}")


def agree(said: float, slope: float, u: float, rough: float = 0.0) -> bool:
    """Whether a force is a slope by central difference; also if they cannot be compared, because one is not finite.
    u : the energy, in the unit of the slope.  rough : by how much the slope may be wrong besides."""
    return not abs(said - slope) > ACCURACY * max(abs(said), abs(slope)) + BESIDE_U * abs(u) + rough


def evaluate_law(law, r2, parameters):
    """u(r) [energy] and −u′(r)/r [energy/length²] of one pair at r² = r2.
    law : law type.  r2 : [length²].  parameters : tuple of numbers, those of the truncation first."""
    formula = type(law).python  # type: ignore[attr-defined]
    return formula(r2, law[0], parameters) if law else formula(r2, *parameters)


@overload(evaluate_law)
def _evaluate_law(law, r2, parameters):
    if not isinstance(law, types.BaseNamedTuple):
        return None
    formula = law.instance_class.formula
    if len(law) == 1:
        return lambda law, r2, parameters: formula(r2, law[0], parameters)
    return lambda law, r2, parameters: formula(r2, *parameters)
