"""The files of compiled kernels: a process loads what it finds; while one compiles a kernel, the others wait for it."""

import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar
from uuid import uuid4

from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

from minimd.core.compiled.terminal import tell

CHECKSUM = 32  # bytes at the beginning of each file, of SHA-256


class CodeFiles(IndexDataCacheFile):
    """The files of a kernel in Numba's cache: an index, and one file for the machine code of each signature.

    Numba numbers the files, and writes the index first: a process killed in between, or two at once, may leave one that
    names the code of another signature. Here each file has a unique name, which the index gets after it was written.

    Numba executes what it finds. Here each file begins with a checksum of the rest. A file that does not agree with
    it, such as after a power failure, is removed, and its kernel compiled anew; standard error says so once."""

    is_told: ClassVar[bool] = False

    def save(self, key: Any, data: Any) -> None:
        """Called by Numba after a compilation."""
        name = self._data_name(uuid4().int)
        self._save(self._data_path(name), data)
        self._save_index({**self._load_index(), key: name})

    def _load_index(self) -> dict[Any, str]:
        stamp, names = self._load(self._index_path) or ("", {})
        return names if stamp == self._source_stamp else {}

    def _save_index(self, names: dict[Any, str]) -> None:
        self._save(self._index_path, (self._source_stamp, names))

    def _load_data(self, name: str) -> Any:
        return self._load(self._data_path(name))

    def _load(self, path: str) -> Any:
        """What is in a file; None if there is none, or it was damaged."""
        try:
            content = sound_content(path)
        except OSError:  # it is not there, or cannot be read now
            return None
        if content is not None:
            try:
                return pickle.loads(content)
            except (ImportError, AttributeError):
                # of a script that has another name, or other functions, now
                return None
        if not CodeFiles.is_told:
            CodeFiles.is_told = True
            tell(f"minimd: compiled code in {self._cache_path} was damaged and is compiled anew")
        with suppress(OSError):
            os.unlink(path)
        return None

    def _save(self, path: str, value: Any) -> None:
        """Write a file under another name, then rename it."""
        content = self._dump(value)
        part = Path(f"{path}.{uuid4().hex}")
        try:
            with part.open("xb") as file:  # a new file: no link is followed
                file.write(sha256(content).digest())
                file.write(content)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


def sound_content(path: str | Path) -> bytes | None:
    """What a file of the cache holds behind its checksum; None if it is damaged.  OSError if it cannot be read."""
    with open(path, "rb") as file:
        checksum = file.read(CHECKSUM)
        content = file.read()
    return content if sha256(content).digest() == checksum else None


def is_damaged(path: str | Path) -> bool:
    """Whether a file of the cache does not agree with its checksum; False for one that is gone, or cannot be read."""
    try:
        return sound_content(path) is None
    except OSError:
        return False


class KernelCache(FunctionCache):
    """Numba's cache of a kernel's compiled forms; if processes want one at once, one compiles it, the others wait."""

    compiling: ClassVar[dict[Callable, "KernelCache"]] = {}  # for which others wait, by function

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self._function = function
        self._cache_file = CodeFiles(
            self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp()
        )
        self._lock = -1

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Called by Numba before a compilation: the compiled code; None if this process must compile it."""
        overload = super().load_overload(sig, target_context)
        if overload is not None or self._lock >= 0:
            return overload
        # take the lock of this kernel, where the file system has locks
        with suppress(OSError, ImportError):
            import fcntl  # Windows has no such locks

            file = os.path.join(self._cache_path, f"{self._impl.filename_base}.lock")
            self._lock = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX)
                self.compiling[self._function] = self
            except BaseException:
                self.let_others_go_on()
                raise
        overload = super().load_overload(sig, target_context)
        if overload is not None:
            self.let_others_go_on()
        return overload

    def save_overload(self, sig: Any, data: Any) -> None:
        """Called by Numba after a compilation."""
        try:
            # such as a full disk: what was compiled can be used all the same
            with suppress(OSError):
                super().save_overload(sig, data)
        finally:
            self.let_others_go_on()

    def let_others_go_on(self) -> None:
        """Release the lock, so that other processes look again."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1
            self.compiling.pop(self._function, None)

    def _index_key(self, sig: Any, codegen: Any) -> tuple:
        """With the names of fields: Numba takes no notice if fields of the same type change places in a named tuple."""
        return (*super()._index_key(sig, codegen), _fields_of(getattr(sig, "args", sig)))


def _fields_of(kinds: Any) -> tuple:
    """The names of fields of named tuples among types, and inside them."""
    return tuple(
        (tuple(getattr(kind, "fields", ())), _fields_of(getattr(kind, "types", ())))
        for kind in kinds
    )


class FailedCompilations(event.Listener):
    """Lets other processes go on if this one could not compile a kernel, and so saves nothing."""

    def on_start(self, _event: event.Event) -> None:
        """Called by Numba."""

    def on_end(self, ended: event.Event) -> None:
        """Called by Numba."""
        cache = KernelCache.compiling.get(ended.data["dispatcher"].py_func)
        if sys.exc_info()[0] is not None and cache is not None:
            cache.let_others_go_on()
