"""Checks of input: a value is returned in the form that the rest of minimd expects, or refused in one sentence,
before memory is allocated for it."""

from collections.abc import Collection, Sequence
from math import inf, nan
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.words import listed, shown
from minimd.core.structure.arrays import Array, Indices

SMALLEST, LARGEST = 1e-75, 1e75  # of positive quantities: their fourth powers are still numbers
SHORTEST = 1e-150  # of times: their squares are
MOST_ATOMS = 2**27  # 3 GB of positions
MOST_NUMBERS = 3 * MOST_ATOMS  # in an array
COUNTS = 2**63  # whole numbers in arrays and files are below it
DEMANDS = {
    "finite": lambda number: abs(number) < inf,
    "finite and not zero": lambda number: 0.0 < abs(number) < inf,
    "finite and not negative": lambda number: 0.0 <= number < inf,
    "positive and finite": lambda number: 0.0 < number < inf,
}
# by the letters of NumPy
KINDS = {"b": "bools", "i": "whole numbers", "f": "fractions", "c": "complex"}
PLAIN = {bool: "b", int: "i", float: "f"}


def checked_count(name: str, value: Any, least: int = 1, limit: int = COUNTS) -> int:
    """The value as an int. Raises ValueError unless it is an int or an integer of NumPy, not a bool, not less than
    least, and below limit; name is used in the message."""
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (is_whole and least <= int(value) < limit):
        most = f" and below {limit:.3g}" if is_whole and int(value) >= limit else ""
        raise ValueError(
            f"{name} must be a whole number, at least {least}{most}; {name} = {shown(value)}"
        )
    return int(value)


def checked_number(
    name: str, value: Any, demand: str = "finite", smallest: float = SMALLEST
) -> float:
    """The value as a float.
    demand : one of DEMANDS.
    Raises ValueError for anything that is not a real number, such as a text or a bool, for what the demand excludes,
    and for numbers whose powers could overflow: above LARGEST or, if they must not be 0, below the smallest."""
    try:
        number = float(value) if not isinstance(value, bool) and isinstance(value, Real) else nan
    except OverflowError:
        number = inf

    is_right = DEMANDS[demand]
    if not is_right(number):
        raise ValueError(f"{name} must be {demand}; {name} = {shown(value)}")
    size = abs(number)
    if size > LARGEST or (size < smallest and not is_right(0.0)):
        raise ValueError(
            f"{name} must be {demand}, between {smallest:g} and {LARGEST:g} in size; {name} = {shown(value)}: "
            "take other units"
        )

    return number


def checked_flag(name: str, value: Any) -> bool:
    """The value as a bool.
    Raises ValueError unless it is True or False, of Python or of NumPy."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False; {name} = {shown(value)}")
    return bool(value)


def checked_kind(name: str, value: Any, kind: Any, wanted: str) -> Any:
    """The value, if it is an object of a kind, a class or several.
    wanted : the kind in words.
    Raises TypeError otherwise."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be {wanted}; {name} = {shown(value)}")
    return value


def checked_path(name: str, value: Any) -> Path:
    """The value as a Path.
    Raises ValueError unless it is a text, or a path, that can name a file."""
    try:
        path = Path(value or None)  # type: ignore[arg-type]  # an empty text names nothing
        path.lstat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (TypeError, ValueError, OSError):
        raise ValueError(
            f"{name} must be the path of a file or folder; {name} = {shown(value)}"
        ) from None
    return path


def checked_choice(name: str, value: Any, allowed: Collection[str]) -> Any:
    """The value, if it is one of the allowed texts.
    Raises ValueError otherwise."""
    if not (isinstance(value, str) and value in allowed):
        raise ValueError(f"{name} must be one of {listed(allowed)}; {name} = {shown(value)}")
    return value


def checked_numbers(name: str, values: Any, expected: str) -> Array:
    """A new contiguous array of real numbers, of any shape; they may be infinite or NaN.
    Raises ValueError as checked_array."""
    array = checked_array(name, values, expected, "if")
    try:
        return np.array(array, float, order="C")
    except OverflowError as error:
        raise ValueError(f"{name} must be {expected}: {error}") from None


def checked_sizes(name: str, values: Any, n: int, each: str) -> Array:
    """Positive numbers (n,), from one number or one for each atom, or whatever the word each says.
    Raises ValueError as checked_array, for another shape, and as checked_number."""
    array = checked_numbers(name, values, f"one number, or one for each {each}")
    if array.shape not in ((), (n,)):
        raise ValueError(
            f"{name} must be one number, or {n} numbers, one for each {each}; its shape is {array.shape}"
        )
    array = np.broadcast_to(array, (n,)).copy()
    check_rows(name, "positive and finite", (array > 0.0) & (array < inf), array)
    is_usual = (array >= SMALLEST) & (array <= LARGEST)
    check_rows(name, f"between {SMALLEST:g} and {LARGEST:g}", is_usual, array)
    return array


def check_rows(name: str, demand: str, is_good: Any, array: NDArray[Any]) -> None:
    """Raise ValueError with the first row of an array that is not good, (n,) bool.
    demand : what it must be."""
    bad = np.flatnonzero(~is_good)
    if bad.size:
        k = bad[0]
        others = f", and {bad.size - 1} more" if bad.size > 1 else ""
        raise ValueError(f"{name} must be {demand}; {name}[{k}] = {array[k].tolist()}{others}")


def checked_indices(name: str, values: Any, expected: str) -> Indices:
    """A new contiguous array of indices of atoms, of any shape; they may be negative.
    Raises ValueError as checked_array, or if one is too large."""
    array = checked_array(name, values, expected, "i")
    if array.size and not -MOST_ATOMS <= array.min() <= array.max() < MOST_ATOMS:
        raise ValueError(
            f"{name} must be {expected}: they go from {array.min()} to {array.max()}, but at most {MOST_ATOMS} atoms "
            "are allowed"
        )
    return np.array(array, np.int64, order="C")


def checked_array(name: str, values: Any, expected: str, kinds: str) -> NDArray[Any]:
    """The values as an array, the same one if they are one.
    expected : words for the message.
    kinds : which of KINDS may be in it.
    Raises ValueError for anything else, for masked values, for bools among numbers, for ragged lists,
    and for more than MOST_NUMBERS values."""
    present: set[str] = set()
    try:
        _find_kinds(values, present)
        for kind in sorted(present):
            if kind not in kinds or (kind == "b" and len(present) > 1):
                raise ValueError(f"some are {KINDS[kind]}")
        return np.asarray(values)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{name} must be {expected}: {error}") from None


def _find_kinds(values: Any, kinds: set[str]) -> None:
    """Add the kinds of numbers among the values.
    Raises ValueError for values that are no numbers, masked, or too many."""
    if type(values) in PLAIN:
        kinds.add(PLAIN[type(values)])
        return
    if isinstance(values, list | tuple):
        for value in values:
            _find_kinds(value, kinds)
        return

    is_list = isinstance(values, Sequence) and not isinstance(values, str)
    size = len(values) if is_list else 0
    array = np.empty(0) if size > MOST_NUMBERS else np.asanyarray(values)
    size = max(size, array.size)
    if size > MOST_NUMBERS:
        raise ValueError(f"there are {size} values; at most {MOST_NUMBERS} are allowed")
    if np.ma.is_masked(array):
        raise ValueError("some are masked; fill them or leave them out")
    kind = array.dtype.kind.replace("u", "i")
    if array.dtype == object and array.ndim:
        _find_kinds(array.tolist(), kinds)
    elif kind in KINDS and (array.size or isinstance(values, Real)):
        kinds.add(kind)
    elif isinstance(values, Real):  # an object, such as a Fraction
        kinds.add("i" if isinstance(values, Integral) else "f")
    elif array.size:
        raise ValueError(f"{shown(array.ravel()[:1].tolist()[0])} is not a number")
