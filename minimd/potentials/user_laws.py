"""Law types of a user's laws: a class for each, named after a digest, by which the next process finds compiled loops.

The index of Numba's cache holds the law types of earlier runs. It is read with pickle, which looks for their classes in
this module; a class that no law of this process needs stays without a formula.
"""

import re
from collections import namedtuple
from collections.abc import Callable
from types import FunctionType
from typing import Any
from uuid import uuid4

from numba.core.dispatcher import Dispatcher

from minimd.compiled.kernels import scalar, type_of
from minimd.compiled.snapshot import Snapshot
from minimd.console.words import shown

CLASS_NAME = "UserLaw_{}"  # a digest, or a random number


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


def user_law(function: Callable) -> UserLaw:
    """The law type of a plain or compiled function of r² and parameters that returns u and −u′(r)/r.

    The law stays as it is now, compiled and in Python: globals that it reads may change later without effect. Raises
    TypeError if it is not a function.
    """
    if not isinstance(function, FunctionType | Dispatcher):
        wanted = "a function law(r2, *parameters) that returns u and -u'(r)/r"
        raise TypeError(f"a law must be {wanted}; it is {shown(function)}")
    if function in _unrecognized:  # a copy of a law type asks for it again
        return _unrecognized[function]()
    snapshot = Snapshot(function)
    if not snapshot.digest:
        return _unrecognized_law(snapshot)
    named = _class_named(CLASS_NAME.format(snapshot.digest))
    if not hasattr(named, "formula"):
        type_of(_compiled(snapshot.function), snapshot.python)(named)
    return named()


def is_user_law(law: tuple) -> bool:
    """True if the law type, or the one inside it, was made by user_law."""
    return isinstance(law, UserLaw) or any(is_user_law(inner) for inner in law if isinstance(inner, tuple))


def is_recognized(law: tuple) -> bool:
    """False if the law type, or the one inside it, is that of a user's law that the disk cache cannot recognize."""
    if isinstance(law, UserLaw):
        return law.is_recognized
    return all(is_recognized(inner) for inner in law if isinstance(inner, tuple))


def _unrecognized_law(snapshot: Snapshot) -> UserLaw:
    """The law type of a function without a digest."""
    named = _class_named(CLASS_NAME.format(uuid4().hex))
    named.is_recognized = False
    formula = _compiled(snapshot.function)
    _unrecognized[formula] = type_of(formula, snapshot.python)(named)
    return _unrecognized[formula]()


def _compiled(function: Any) -> Dispatcher:
    return function if isinstance(function, Dispatcher) else scalar(function)


def _class_named(name: str) -> type[UserLaw]:
    """The law type of this name, always the same one."""
    return _classes.setdefault(name, type(name, (UserLaw,), {"__slots__": (), "__module__": __name__}))
