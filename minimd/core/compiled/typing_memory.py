"""Numba looks up the type of each operation at each place of each kernel, and compares its flags name by name.
Here it remembers the types of operations on numbers, and compares flags as dictionaries: a tenth of the time of
compilation. What it finds is the same."""

from typing import Any

from numba.core.targetconfig import TargetConfig
from numba.core.types import Boolean, Number, functions

_find_type: Any = functions.BaseFunction.get_call_type


def _remembered_type(function: Any, context: Any, args: tuple, kws: dict) -> Any:
    """The signature of a function for arguments of these types.

    It is kept if the function is an instruction, whose typing key it then is, and all arguments are numbers: what is
    compiled for a call may depend on flags. Other templates of a function belong to another object.
    """
    if kws or not all(isinstance(kind, Number | Boolean) for kind in args):
        return _find_type(function, context, args, kws)
    known = vars(function).setdefault("_known_types", {})
    if args not in known:
        signature = _find_type(function, context, args, kws)
        if function._impl_keys[signature.args] is not function.typing_key:
            return signature
        known[args] = signature
    return known[args]


def _are_equal(flags: TargetConfig, other: object) -> Any:
    """Whether all options have the same values."""
    if not isinstance(other, TargetConfig):
        return NotImplemented
    names = flags._values.keys() | other._values.keys()  # of the options that are set
    return all(getattr(flags, name) == getattr(other, name) for name in names)


def remember() -> None:
    """Let Numba do so from now on."""
    functions.BaseFunction.get_call_type = _remembered_type  # type: ignore[method-assign, assignment]
    TargetConfig.__eq__ = _are_equal  # type: ignore[method-assign]
    TargetConfig.__hash__ = lambda flags: hash(type(flags))  # type: ignore[method-assign]
