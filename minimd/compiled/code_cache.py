"""The files of compiled kernels: a process loads what it finds there; while one process compiles a kernel, the others wait for it."""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar
from uuid import uuid4

from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile


class CodeFiles(IndexDataCacheFile):
    """The files of a kernel in Numba's cache: an index, and one file for the machine code of each signature.

    Numba numbers the files, and writes the index first. A process that is killed in between, or two at once, may leave an index that names the
    machine code of another signature. Here each file has a unique name, and the index names it only after it was written.
    """

    def save(self, key: Any, data: Any) -> None:
        """Called by Numba after a compilation."""
        name = self._data_name(uuid4().int)
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})


class KernelCache(FunctionCache):
    """Numba's cache of the compiled forms of a kernel. If several processes want one at the same moment, one compiles it while the others wait."""

    compiling: ClassVar[dict[Callable, "KernelCache"]] = {}  # for which others wait, by function

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self._function = function
        self._cache_file = CodeFiles(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())
        self._lock = -1

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Called by Numba before a compilation: the compiled code, if there is any. None if this process must compile, and others wait for it."""
        found = super().load_overload(sig, target_context)
        if found is None and self._lock < 0:
            self._wait_for_others()
            found = super().load_overload(sig, target_context)
            if found is not None:
                self.let_others_go_on()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Called by Numba after a compilation."""
        try:
            super().save_overload(sig, data)
        finally:
            self.let_others_go_on()

    def let_others_go_on(self) -> None:
        """Release the lock, so that other processes look again."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1
            self.compiling.pop(self._function, None)

    def _wait_for_others(self) -> None:
        """Take the lock of this kernel, where the file system has locks."""
        with suppress(OSError, ImportError):
            import fcntl  # Windows has no such locks

            self._lock = os.open(os.path.join(self._cache_path, f"{self._impl.filename_base}.lock"), os.O_RDWR | os.O_CREAT, 0o600)
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX)
                self.compiling[self._function] = self
            except BaseException:
                self.let_others_go_on()
                raise


class FailedCompilations(event.Listener):
    """Lets other processes go on if this one could not compile a kernel, and so saves nothing."""

    def on_start(self, _event: event.Event) -> None:
        """Called by Numba."""

    def on_end(self, ended: event.Event) -> None:
        """Called by Numba."""
        cache = KernelCache.compiling.get(ended.data["dispatcher"].py_func)
        if sys.exc_info()[0] is not None and cache is not None:
            cache.let_others_go_on()
