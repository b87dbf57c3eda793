"""How an observer declares its arguments: each with its check, what it is, its default, and its dimension."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import field
from functools import partial
from typing import Any, NamedTuple

from minimd.core.console.words import shown
from minimd.core.structure.checks import checked_choice, checked_count, checked_number

AXES = "abc"
PARTICLES = ATOMS, MOLECULES = "atoms", "molecules"


class Argument(NamedTuple):
    """What is declared of an argument.
    words : what it is.
    dimension : of its numbers; empty without one.

    check : checked_count, or one of the functions below; it returns the value that is kept, or raises ValueError.
    """

    check: Callable[[str, Any], Any]
    words: str
    dimension: str


def argument(
    check: Callable[[str, Any], Any], words: str, default: Any, dimension: str = ""
) -> Any:
    """A field of an Accumulator.  A default of None is not checked.  See Argument."""
    return field(default=default, metadata={"argument": Argument(check, words, dimension)})


def steps(default: int) -> Any:
    """The field every."""
    return argument(checked_count, "steps between two observations", default)


def label() -> Any:
    """The field name."""
    return argument(identifier, "name in files; the kind if not given", "")


levels = partial(checked_count, limit=40)  # of a correlator
positive = partial(checked_number, demand="positive and finite")
axis_name = partial(checked_choice, allowed=tuple(AXES))
particles = partial(checked_choice, allowed=PARTICLES)


def interval(name: str, value: Any) -> list[float]:
    """Two numbers, the lower one first."""
    is_pair = isinstance(value, list | tuple) and len(value) == 2
    numbers = [checked_number(name, end) for end in value] if is_pair else []
    if not is_pair or numbers[1] <= numbers[0]:
        wanted = "two numbers, the lower one first"
        raise ValueError(f"{name} must be {wanted}; {name} = {shown(value)}")
    return numbers


def names(name: str, value: Any) -> list[str]:
    """A text, or several of which no two are the same."""
    texts = [value] if isinstance(value, str) else value
    is_list = isinstance(texts, list | tuple) and all(isinstance(text, str) for text in texts)
    if not is_list or not 0 < len(texts) == len(set(texts)):
        raise ValueError(
            f"{name} must be a name, or a list of different names; {name} = {shown(value)}"
        )
    return [*texts]


def orders(name: str, value: Any) -> list[str]:
    """Names of orders of bonds: q or psi, and a degree of 1 to 20."""
    texts = names(name, value)
    if not all(re.fullmatch(r"(q|psi)([1-9]|1[0-9]|20)", text) for text in texts):
        wanted = 'q or psi with a degree of 1 to 20, such as "q6"'
        raise ValueError(f"{name} must be {wanted}; {name} = {shown(value)}")
    return texts


def identifier(name: str, value: Any) -> str:
    """Letters, digits and underscores, or nothing."""
    if not isinstance(value, str) or not (value.isidentifier() or not value):
        wanted = "made of letters, digits and underscores"
        raise ValueError(f"the {name} of an observer must be {wanted}; {name} = {shown(value)}")
    return value
