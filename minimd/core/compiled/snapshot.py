"""Snapshots of functions: copies that later changes do not reach, and digests by which the cache recognizes them.

What a compiled function does is decided by its bytecode, its constants and defaults, the globals and closure cells it
reads, the compiled functions it calls, and its compile options. All of this enters the digest; names of files and
numbers of lines do not. Where the effect of something on the compiled code is not certain, it is copied all the same,
but there is no digest.
"""

import builtins
import copy
import dis
import hashlib
import sys
from collections.abc import Iterator
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any
from uuid import uuid4

import numba
import numpy as np
from numba.core.registry import CPUDispatcher

from minimd.core.compiled.kernels import PartOfKernel

NUMBERS = (bool, int, float, complex, str, bytes, type(None))
NUMBER_KINDS = "biufc"  # of NumPy: truth values, integers, floats, complex numbers
# modules known by their versions, minimd by its sources
TRUSTED = {"builtins", "math", "cmath", "numpy", "numba", "minimd"}
LARGEST_ARRAY = 10**6  # bytes: Numba does not cache code that reads a larger one
CODE_FIELDS = (
    "co_code",
    "co_exceptiontable",
    "co_names",
    "co_varnames",
    "co_freevars",
    "co_cellvars",
    "co_flags",
)
COUNTS = ("co_argcount", "co_posonlyargcount", "co_kwonlyargcount")


class FunctionSnapshot:
    """A function as it is now.

    Parameters
    ----------
    function : a plain function, or one compiled by numba.njit; the functions that it calls must be compiled.

    Attributes
    ----------
    function : the copy, of the same kind, with the same compile options.
    python : the copy as a plain function; it calls plain functions, too, but for those with fixed signatures.
    digest : 32 hexadecimal digits; the same for functions that compile to the same code. Empty for a function that
        imports modules, or reads anything but numbers, strings, tuples and small arrays of numbers, functions compiled
        without fixed signatures, and names from math, cmath, numpy, numba and minimd.
    """

    def __init__(self, function: Any) -> None:
        self._hash = hashlib.sha256()
        self._is_clear = True
        self._copies: dict[int, tuple[Any, Any]] = {}  # by the id of a compiled function
        self._note(sys.version, numba.__version__, np.__version__)
        self.function: Any
        self.python: FunctionType
        if isinstance(function, FunctionType):
            self.function, self.python = self._shells(function)
            self._fill(function, self.function, self.python)
        else:
            self.function, self.python = self._compiled(function)
        self.digest = self._hash.hexdigest()[:32] if self._is_clear else ""

    def _note(self, *parts: Any) -> None:
        self._hash.update(repr(parts).encode())

    def _value(self, value: Any) -> tuple[Any, Any]:
        """Copies of what a function reads: for kernels, and for the plain function."""
        if isinstance(value, ModuleType) and _is_trusted(value.__name__):
            self._note("module", value.__name__)
            # its constants may change with its sources
            self._is_clear &= not value.__name__.startswith("minimd")
            return value, value
        if _is_named_in_trusted_module(value):
            self._note("name", value.__module__, value.__qualname__)
            return value, getattr(value, "py_func", value)
        return self._compiled(value) if isinstance(value, CPUDispatcher) else self._data(value)

    def _data(self, value: Any) -> tuple[Any, Any]:
        """Copies of a number, a string, a tuple or an array."""
        if type(value) in NUMBERS:
            self._note(type(value).__name__, value)
        elif isinstance(value, np.generic) and value.dtype.kind in NUMBER_KINDS:
            self._note("number", value.dtype.str, value.tobytes())
        elif type(value) is np.ndarray and _is_noted(value):
            if not (value.flags.c_contiguous or value.flags.f_contiguous):
                self._is_clear = False  # Numba reads an array with gaps from its place in memory
            self._note(
                "array", value.dtype.str, value.shape, value.flags.c_contiguous, value.tobytes()
            )
            value = value.copy(order="K")
        elif type(value) is tuple:
            self._note("tuple", len(value))
            copies = [self._value(part) for part in value]
            return tuple(first for first, _ in copies), tuple(second for _, second in copies)
        else:
            self._is_clear = False
            value = _independent(value)
        return value, value

    def _compiled(self, function: Any) -> tuple[Any, Any]:
        """Copies of a function that Numba compiles; if it was met before, as in a recursion, it is only noted again."""
        if id(function) in self._copies:
            self._note("again", list(self._copies).index(id(function)))
            return self._copies[id(function)]
        is_plain = type(function) in (CPUDispatcher, PartOfKernel) and not function.locals
        if not is_plain or _has_fixed_signatures(function):
            self._is_clear = False
            return function, function
        self._note("options")
        for name, option in sorted(function.targetoptions.items()):
            self._note(name)
            self._data(tuple(sorted(option)) if isinstance(option, set) else option)
        plain: Any = function.py_func
        first, second = self._shells(plain)
        compiled = type(function)(first, None, dict(function.targetoptions))
        self._copies[id(function)] = compiled, second
        self._fill(plain, first, second)
        return compiled, second

    def _shells(self, function: FunctionType) -> tuple[FunctionType, FunctionType]:
        """Two copies of a function that read nothing yet."""
        self._note("function", function.__name__)
        self._code(function.__code__)
        defaults = function.__defaults__ or ()
        keywords = function.__kwdefaults__ or {}
        values = self._data(tuple(defaults))
        keyword_values = self._data(tuple(keywords.values()))
        self._note(tuple(keywords))
        shells = []
        for defaults, copies in zip(values, keyword_values, strict=True):
            named = dict(zip(keywords, copies, strict=True))
            shells.append(unread(function, defaults or None, named or None))
        return shells[0], shells[1]

    def _fill(self, function: FunctionType, first: FunctionType, second: FunctionType) -> None:
        """Give the shells copies of the globals and closure cells that the function reads."""
        names, imports = globals_read(function.__code__)
        self._is_clear &= not imports
        for name in names:
            self._note("global", name)
            if name in function.__globals__:
                copies = self._value(function.__globals__[name])
                first.__globals__[name], second.__globals__[name] = copies
            elif not hasattr(builtins, name):
                self._is_clear = False  # it is not defined
        closures = [each.__closure__ or () for each in (function, first, second)]
        for cell, first_cell, second_cell in zip(*closures, strict=True):
            self._note("cell")
            try:
                copies = self._value(cell.cell_contents)
                first_cell.cell_contents, second_cell.cell_contents = copies
            except ValueError:  # it is empty
                self._is_clear = False

    def _code(self, code: CodeType) -> None:
        for name in (*CODE_FIELDS, *COUNTS):
            self._note(name, getattr(code, name, None))  # co_exceptiontable is new in Python 3.11
        self._note("constants", len(code.co_consts))
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                self._code(constant)
            else:
                self._data(constant)


def unread(
    function: FunctionType, defaults: tuple | None, keywords: dict[str, Any] | None
) -> FunctionType:
    """A copy of a function with other defaults that reads nothing yet: its globals and its cells are empty."""
    around = {"__name__": function.__module__, "__builtins__": builtins}
    cells = tuple(CellType() for _ in function.__closure__ or ())
    copied = FunctionType(function.__code__, around, function.__name__, defaults, cells)
    copied.__kwdefaults__ = keywords
    copied.__qualname__ = function.__qualname__
    copied.__doc__ = function.__doc__
    return copied


def globals_read(code: CodeType) -> tuple[list[str], bool]:
    """Names of the globals that a code reads, functions defined in it included, and whether it imports modules."""
    names = set[str]()
    imports = False
    for part in _with_inner(code):
        for instruction in dis.get_instructions(part):
            if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                names.add(instruction.argval)
            imports |= instruction.opname == "IMPORT_NAME"
    return sorted(names), imports


def _independent(value: Any) -> Any:
    """A copy that later changes do not reach, if possible; a module's has its names, not copies of what they hold."""
    if isinstance(value, ModuleType):
        # Numba tells modules apart by their names
        module = ModuleType(f"{value.__name__}, copy {uuid4().hex}")
        module.__dict__.update(vars(value), __name__=module.__name__, __spec__=None)
        return module
    try:
        return copy.deepcopy(value)
    except Exception:  # whatever an object of the user's raises: it stays itself
        return value


def _with_inner(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _with_inner(constant)


def _is_noted(array: np.ndarray) -> bool:
    """Whether all elements of an array enter the digest."""
    return array.dtype.kind in NUMBER_KINDS and array.nbytes <= LARGEST_ARRAY


def _is_trusted(module: Any) -> bool:
    return isinstance(module, str) and module.split(".")[0] in TRUSTED


def _is_named_in_trusted_module(value: Any) -> bool:
    """True for what a trusted module holds under the name that the value carries, such as math.exp."""
    module = getattr(value, "__module__", None)
    name = getattr(value, "__qualname__", None)
    if not (_is_trusted(module) and isinstance(name, str)):
        return False
    return getattr(sys.modules.get(module), name, None) is value  # type: ignore[arg-type]


def _has_fixed_signatures(function: CPUDispatcher) -> bool:
    """True if the function was compiled for given signatures only; for others, its first one is compiled already."""
    try:
        for signature in function.signatures[:1]:
            function.compile(signature)
    except RuntimeError:
        return True
    return False
