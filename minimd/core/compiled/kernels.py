"""How minimd compiles: a few decorators, one safe cache folder, one line for the user who waits.

Numba's own cache does not notice that a function of *another* file has changed, and fails when neither the installation
nor the home folder can be written. Compiled kernels therefore live in a folder named after a hash of all sources that
kernels depend on: edited sources never meet old machine code, other edits compile nothing, any writable place will do.
"""

import functools
import gc
import hashlib
import os
import re
import stat
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

import llvmlite
import numba
import numpy
from numba import types
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.extending import overload

from minimd.core.compiled import typing_memory
from minimd.core.compiled.code_cache import FailedCompilations, KernelCache
from minimd.core.compiled.machine import chosen_vectors, restrict_features, rounds_once
from minimd.core.compiled.terminal import tell


class PartLibrary(JITCodeLibrary):
    """The code of a part of a kernel, for the library of the kernel to link. Nobody can call it.
    Numba would optimize each part as a whole, and again as a part of what calls it, and so on up to the kernel."""

    def _optimize_functions(self, module: object) -> None:
        """Left to the kernel."""

    def _optimize_final_module(self) -> None:
        """Left to the kernel."""

    def _finalize_final_module(self) -> None:
        """Without machine code."""
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None."""
        return 0

    @property
    def codegen(self) -> Any:
        """For the executable that Numba makes of any function: this one needs nothing."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """There is no machine code that could read it."""


class PartCompiler(Compiler):
    """Numba's compiler, for parts of kernels."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *arguments: Any) -> None:
        super().__init__(
            typingctx, targetctx, library or PartLibrary(targetctx.codegen(), "part"), *arguments
        )


restrict_features(chosen_vectors())
typing_memory.remember()

WORDS = rb"\w*kernels?|inlined|scalar|by_type|type_of"
DECORATED = rb"^from minimd\.core\.compiled\.kernels import (\([^)]*)?.*\b(" + WORDS + rb")\b"
HOLDS_KERNELS = re.compile(DECORATED + rb"|^from numba\b", re.M)
IMPORTED = re.compile(r"^from (minimd[\w.]*) import (\([^)]*\)|.*)", re.M)
WAIT_BEFORE_TELLING = 1.0  # seconds of compiling before the user is told


@functools.cache
def cache_folder() -> Path | None:
    """The folder for compiled code, one per state of the kernels' sources; None, where each process compiles anew.
    It lies in the first of $NUMBA_CACHE_DIR, the user's cache folder and the temporary folder that can be written, and
    that nobody else can change: what is in it will be executed. Warns of one that others can change."""
    name = f"minimd-{_source_hash()}{'' if rounds_once() else '-twice'}"
    for base in _cache_bases():
        folder = Path(os.path.realpath(base / name))
        try:
            if not open_to_others(folder):
                for part in (*reversed(folder.parents), folder):
                    if not part.is_dir():
                        part.mkdir(mode=0o700, exist_ok=True)  # for this user alone
            # perhaps only now: somebody else may have been faster in a common folder
            opened = open_to_others(folder)
            if opened:
                warnings.warn(
                    f"compiled code is not kept in {base}, because other users can change {opened}; "
                    "take that permission from them, or set NUMBA_CACHE_DIR to a folder of your own",
                    stacklevel=2,
                )
                continue
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None


def open_to_others(folder: Path) -> Path | None:
    """The first of a folder and its parents, from the root down, that others than this user and root can change.

    Whoever can write to a folder can exchange the folders in it, unless it is sticky, as /tmp is: then only their
    owners can. Folders that do not exist yet belong to nobody. Windows keeps the folders of users apart by other means.
    None if there is no such folder.
    Raises OSError if the permissions cannot be read."""
    if not hasattr(os, "getuid"):
        return None
    folder = Path(os.path.realpath(folder))
    # in a container root may have another number
    trusted = {os.getuid(), 0, os.stat(folder.anchor).st_uid}
    for part in (*reversed(folder.parents), folder):
        try:
            status = part.stat()
        except FileNotFoundError:
            return None
        is_common = part != folder and status.st_mode & stat.S_ISVTX
        is_writable = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        if status.st_uid not in trusted or (is_writable and not is_common):
            return part
    return None


def kernel(function, **flags):
    """Compile a function that Python calls with arrays and numbers: lazily, once per machine.
    flags : of numba.njit."""
    return _cached(numba.njit(error_model="numpy", no_cfunc_wrapper=True, **flags)(function))


def _cached(compiled):
    """The same dispatcher, with a cache in the folder."""
    folder = cache_folder()
    previous = numba.config.CACHE_DIR
    if folder is not None:
        numba.config.CACHE_DIR = str(folder)
        try:
            compiled._cache = KernelCache(compiled.py_func)
        finally:
            numba.config.CACHE_DIR = previous
    return compiled


class CalledKernel(CPUDispatcher):
    """A function that only compiled code calls; in Python it runs as Python.
    Numba's wrappers for calls from Python and from C are left out: they took a quarter of the time of compilation."""

    def __call__(self, *arguments: object) -> Any:
        """The function of Python."""
        return self.py_func(*arguments)


class PartOfKernel(CalledKernel):
    """A function that the compiler puts into the kernels that call it."""

    def __init__(self, py_func: Callable, locals: Any = None, targetoptions: Any = None) -> None:
        super().__init__(py_func, locals, targetoptions, pipeline_class=PartCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Called by Numba, which would compile another form for each constant that is passed."""
        return super().get_call_template(tuple(map(types.unliteral, args)), kws)


NOT_FROM_OUTSIDE = {
    "nopython": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def inlined(function):
    """Compile a part of a kernel that may create arrays; the compiler puts it into the kernel."""
    return PartOfKernel(function, targetoptions={**NOT_FROM_OUTSIDE, "forceinline": True})


def scalar(function):
    """Compile a function that only kernels call; the compiler puts it into the kernel. It must not create arrays:
    then it needs no reference counts for those it is given, which would cost more than a small function."""
    return PartOfKernel(
        function, targetoptions={**NOT_FROM_OUTSIDE, "forceinline": True, "_nrt": False}
    )


def called_kernel(function):
    """Compile a kernel that other kernels call by its address, see compiled.by_address: each is compiled once,
    whoever calls it. It makes no arrays."""
    return _cached(CalledKernel(function, targetoptions={**NOT_FROM_OUTSIDE, "_nrt": False}))


def filling_kernel(function):
    """A called kernel that may make arrays."""
    return _cached(CalledKernel(function, targetoptions=NOT_FROM_OUTSIDE))


def by_type(choose: Callable) -> Callable:
    """Decorator of a function for kernels only: given the Numba types of arguments, it returns what to compile."""

    @functools.wraps(choose)
    def compiled_only(*arguments):
        raise NotImplementedError(f"{choose.__name__} can be called from compiled kernels only")

    in_kernels(compiled_only)(choose)
    return compiled_only


def in_kernels(function: Callable) -> Callable:
    """Decorator of what a function of Python is in kernels: given the Numba types of its arguments, it returns what to
    compile, or None to leave them to others."""
    options: Any = {"no_cfunc_wrapper": True, "pipeline_class": PartCompiler}
    return overload(function, jit_options=options)


def type_of(formula: Callable, python: Callable | None = None) -> Callable[[type], type]:
    """Decorator of a NamedTuple class that stands for a compiled function, which kernels, and the cache, choose by it.
    python : the same function for Python; if not given, the one that was compiled."""

    def tie(named: type) -> type:
        named.formula = formula  # type: ignore[attr-defined]
        named.python = staticmethod(python or formula.py_func)  # type: ignore[attr-defined]
        return named

    return tie


def code_for(kernel: Callable, kinds: tuple[types.Type, ...]) -> Callable:
    """The machine code of a kernel for arguments of these types, compiled if it is not there yet."""
    kernel.compile(kinds)  # type: ignore[attr-defined]
    return kernel.get_overload(kinds)  # type: ignore[attr-defined, no-any-return]


def types_of(arguments: Iterable[object]) -> tuple[types.Type, ...]:
    """The types of arguments, as Numba sees them."""
    return tuple(numba.typeof(argument) for argument in arguments)


class DirectCalls:
    """Where kernels are, for a caller that passes each of them arguments of one type, and arrays of one layout."""

    def __init__(self) -> None:
        self._codes: dict[Callable, tuple[tuple[types.Type, ...], int]] = {}

    def address(self, kernel: Callable, *arguments: object) -> int:
        """The address of the machine code of a kernel for arguments of these types, see call_at; it is
        compiled at the first call.

        Raises TypeError for arguments of other types than at the first call: that code would take them for those."""
        kinds = types_of(arguments)
        if kernel not in self._codes:
            code_for(kernel, kinds)
            compiled = kernel.overloads[kinds]  # type: ignore[attr-defined]
            place = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
            self._codes[kernel] = kinds, place
        first, address = self._codes[kernel]
        if kinds != first:
            name = getattr(kernel, "__name__", repr(kernel))
            raise TypeError(
                f"a DirectCalls passes {name} arguments of one type, {_in_words(first)}; got {_in_words(kinds)}: take "
                "another DirectCalls for these"
            )
        return address


def _in_words(kinds: tuple[types.Type, ...]) -> str:
    """Types in words: those of named tuples with their fields, which their own names may not show."""
    return ", ".join(f"{kind} {getattr(kind, 'types', '')}".strip() for kind in kinds)


@functools.cache
def without_cache(dispatcher):
    """The same kernel, compiled anew in each process: for a user's laws that the cache cannot recognize."""
    return type(dispatcher)(dispatcher.py_func, targetoptions=dict(dispatcher.targetoptions))


class CompileClock(event.Listener, threading.local):
    """Counts the seconds that each thread spends compiling, which are no part of its steps;
    announces long compilations if asked to. Meanwhile Python's search for garbage rests: it took a twelfth of them."""

    was_told = False

    def __init__(self) -> None:
        self.seconds = 0.0
        self.is_to_tell = False
        self._depth = 0
        self._started = 0.0
        self._collects = False
        self._timer: threading.Timer | None = None

    def on_start(self, _event: event.Event) -> None:
        """Called by Numba; compilations nest."""
        self._depth += 1
        if self._depth > 1:
            return
        self._started = perf_counter()
        self._collects = gc.isenabled()
        gc.disable()
        if self.is_to_tell:
            self._timer = threading.Timer(WAIT_BEFORE_TELLING, _tell_of_compilation)
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, _event: event.Event) -> None:
        """Called by Numba."""
        self._depth -= 1
        if self._depth > 0:
            return
        self.seconds += perf_counter() - self._started
        if self._collects:
            gc.enable()
        if self._timer is not None:
            self._timer.cancel()


def _tell_of_compilation() -> None:
    if not CompileClock.was_told:
        CompileClock.was_told = True
        tell("minimd: compiling kernels (once) ...")


compile_clock = CompileClock()
event.register("numba:compile", compile_clock)
event.register("numba:compile", FailedCompilations())


@contextmanager
def announce_compilation() -> Iterator[None]:
    """Context in which a compilation of more than a second is announced, on standard error and once in a process."""
    compile_clock.is_to_tell = not CompileClock.was_told
    try:
        yield
    finally:
        compile_clock.is_to_tell = False


def _source_hash() -> str:
    versions = f"{numba.__version__} {llvmlite.__version__} {numpy.__version__}"
    digest = hashlib.sha256(versions.encode())
    for name, source in sorted(_kernel_sources().items()):
        digest.update(name.encode() + source)
    return digest.hexdigest()[:16]


def _kernel_sources() -> dict[str, bytes]:
    """The sources on which machine code depends, by module: files with compiled functions, and those from which they
    import constants or types, which may depend on those of a third file, and so on.
    Imports inside functions do not count: kernels cannot import."""
    package = Path(__file__).parents[2]  # minimd
    texts = {}
    new = set[str]()
    for file in package.rglob("*.py"):
        module = ".".join(file.relative_to(package.parent).with_suffix("").parts)
        module = module.removesuffix(".__init__")
        texts[module] = file.read_bytes()
        if HOLDS_KERNELS.search(texts[module]) or module.startswith("minimd.core.compiled."):
            new.add(module)
    needed = set[str]()
    while new:
        needed |= new
        imported = set[str]()
        for name in new:
            for module, names in IMPORTED.findall(texts[name].decode()):
                imported.add(module)
                imported.update(f"{module}.{name}" for name in re.findall(r"\w+", names))
        new = imported.intersection(texts) - needed
    return {name: texts[name] for name in needed}


def _cache_bases() -> list[Path]:
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    temporary = f"minimd-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    bases = [Path(user) / "minimd", Path(tempfile.gettempdir()) / temporary]
    return [Path(chosen), *bases] if chosen else bases
