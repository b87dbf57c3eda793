"""How objects are displayed: rows of a name and words, aligned in a terminal, as a table in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from html import escape
from inspect import signature
from math import inf
from typing import Any

import numpy as np

from minimd.core.console.words import near, shown

NAME_WIDTH = 14  # letters of a name, at least; the words begin one further
LEFT = 'style="text-align: left; vertical-align: top"'
KEPT_SPACES = 'style="text-align: left; white-space: pre-wrap; font-family: monospace"'

Rows = list[tuple[str, str]]


class Displayed:
    """Base class of objects that a notebook displays; inside another object, such as a list, the repr is shown.
    A class defines either __str__ or display_rows; here each is defined by the other. A constructor that it defines
    names its arguments, see refuse_unknown_arguments."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls._repr_pretty_ = Displayed._repr_pretty_  # type: ignore[method-assign] # else IPython takes __repr__
        if "__init__" in vars(cls):
            refuse_unknown_arguments(cls)

    def display_rows(self) -> Rows:
        """Names and words; a row without a name continues the one before."""
        lines = str(self).splitlines()
        return [(line[:NAME_WIDTH].rstrip(), line[NAME_WIDTH + 1 :]) for line in lines]

    def __str__(self) -> str:
        rows = self.display_rows()
        width = max(NAME_WIDTH, *(len(name) for name, _ in rows))
        return "\n".join(f"{name:<{width}} {words}" for name, words in rows)

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """Called by IPython."""
        printer.text(repr(self) if cycle or len(printer.stack) > 1 else str(self))

    def _repr_html_(self) -> str:
        """Called by Jupyter."""
        rows = "".join(
            f"<tr><th {LEFT}>{escape(name)}</th><td {KEPT_SPACES}>{escape(words)}</td></tr>"
            for name, words in self.display_rows()
        )
        return f"<table><caption {LEFT}>{type(self).__name__}</caption>{rows}</table>"


def refuse_unknown_arguments(kind: Any) -> None:
    """Let the constructor of a class name its arguments, in a TypeError, if it is given one that it does not have."""
    construct = kind.__init__
    known = signature(kind).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in known.values()):
        return

    @wraps(construct)
    def checked_construct(self: Any, *arguments: Any, **named: Any) -> None:
        unknown = [name for name in named if name not in known]
        if unknown:
            raise TypeError(
                f"{kind.__name__} has no argument {unknown[0]!r}; "
                f"it has {', '.join(known)}{near(unknown[0], known)}"
            )
        construct(self, *arguments, **named)

    kind.__init__ = checked_construct


def call_of(
    one: object, arguments: Mapping[str, Any], always: Iterable[str] = (), most: float = inf
) -> str:
    """The call that recreates an object, without arguments that have their default values,
    except for those named in always.
    most : see as_text."""
    parameters = signature(type(one)).parameters
    always = set(always)
    texts = []
    for name, value in arguments.items():
        may_be_default = name in parameters and not isinstance(value, np.ndarray | Mapping)
        if name in always or not (may_be_default and parameters[name].default == value):
            texts.append(f"{name}={as_text(value, most)}")
    return f"{type(one).__name__}({', '.join(texts)})"


def as_text(value: Any, most: float = inf) -> str:
    """A value as Python writes it: floats to 10 digits, arrays shortened, functions by their names.
    most : numbers of an array, or entries of a mapping; of a longer one its length is written instead."""
    if isinstance(value, float):
        return f"{value:.10g}"
    if type(value) is tuple:
        entries = ", ".join(as_text(entry, most) for entry in value)
        return f"({entries}{',' if len(value) == 1 else ''})"
    if isinstance(value, Mapping) and len(value) <= most:
        return f"{{{', '.join(f'{key!r}: {as_text(entry)}' for key, entry in value.items())}}}"
    if isinstance(value, np.ndarray) and value.size <= most:
        return shown(value.tolist())
    if isinstance(value, np.ndarray | Mapping):
        return f"<{len(value)} entries>"
    if isinstance(value, Callable):  # type: ignore[arg-type]
        return str(getattr(value, "__name__", shown(value)))
    return repr(value)
