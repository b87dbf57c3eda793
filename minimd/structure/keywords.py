"""Misspelt keywords: the TypeError of a call that has one names the keyword that was probably meant."""

import re
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from functools import partial, wraps
from inspect import signature
from types import FunctionType
from typing import Any, ParamSpec, TypeVar

from minimd.structure.checks import SIMILAR, near
from minimd.structure.console import NO_ELECTROSTATICS

ABSENT = dict.fromkeys(("charge", "charges"), f"; {NO_ELECTROSTATICS}")  # what other programs have
UNKNOWN = re.compile(r"got an unexpected keyword argument '(\w+)'$")  # from Python 3.13 on, a similar name may follow
P = ParamSpec("P")
R = TypeVar("R")


def names_keywords(function: Callable[P, R], elsewhere: Callable[[str], str] = lambda _: "") -> Callable[P, R]:
    """Decorator: if a call has a keyword that the function does not know, its TypeError names a similar one.

    elsewhere : gives words about a keyword to which none is similar.  Name,
        signature and help remain those of the function.
    """

    @wraps(function)
    def call(*arguments: P.args, **keywords: P.kwargs) -> R:
        try:
            return function(*arguments, **keywords)
        except BaseException as error:
            own = error.__traceback__
            inner = own and own.tb_next  # None if the call itself has failed, and the function has not begun
            if inner is None and isinstance(error, TypeError) and (unknown := UNKNOWN.search(str(error))):
                name = unknown[1]
                error.args = (f"{error}{ABSENT.get(name) or near(name, _keywords(function)) or elsewhere(name)}",)
            error.__traceback__ = inner  # without a line about this function
            raise

    return call


def name_keywords(kinds: Iterable[Any]) -> None:
    """Apply names_keywords to the constructors of classes, also to those inherited in minimd, and to their own methods
    that have defaults. What is no class is passed over."""
    for kind in kinds:
        if isinstance(kind, type):
            for base in kind.__mro__:
                _decorate(base, "__init__")
            for name in [
                name for name, method in vars(kind).items() if not name.startswith("_") and _has_defaults(method)
            ]:
                _decorate(kind, name)


def _decorate(kind: type, name: str) -> None:
    """Decorate a method of a class, if the class has it from minimd and it is not decorated yet."""
    method = vars(kind).get(name)
    function = _function(method)
    if function is not None and function.__module__.startswith("minimd") and not hasattr(function, "__wrapped__"):
        told = names_keywords(function, partial(_in_methods, kind))
        setattr(kind, name, type(method)(told) if isinstance(method, classmethod | staticmethod) else told)


def _function(method: Any) -> FunctionType | None:
    """The function of a method, also of a class; None of anything else."""
    function = method.__func__ if isinstance(method, classmethod | staticmethod) else method
    return function if isinstance(function, FunctionType) else None


def _has_defaults(method: Any) -> bool:
    function = _function(method)
    return function is not None and bool(function.__defaults__ or function.__kwdefaults__)


def _keywords(function: Callable[..., Any]) -> list[str]:
    return [name for name in signature(function).parameters if name not in ("self", "cls")]


def _in_methods(kind: type, unknown: str) -> str:
    """Words about the method of a class that has a keyword, or one similar to it; empty if none has."""
    methods = {
        name: one for name, method in vars(kind).items() if not name.startswith("_") and (one := _function(method))
    }
    places = {keyword: name for name, one in methods.items() for keyword in _keywords(one)}
    found = get_close_matches(unknown, places, n=1, cutoff=SIMILAR)
    return f"; {found[0]!r} is a keyword of {kind.__name__}.{places[found[0]]}" if found else ""
