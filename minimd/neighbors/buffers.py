"""Memory that is used again at each build: fresh pages from the system would cost more than what is written into them."""

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

SPARE = 1.2  # room for this much more than was asked for
CACHE_LINE = 64  # bytes; vectors that straddle two cost twice


class Buffers:
    """Arrays by name, each as large as it ever was; their contents are what was left in them."""

    def __init__(self) -> None:
        self._all: dict[str, NDArray[Any]] = {}

    def array(self, name: str, dtype: type, *shape: int) -> NDArray[Any]:
        """An array of this shape that begins at a cache line; the next one of the same name takes its place."""
        n = prod(shape)
        kept = self._all.get(name)
        if kept is None or n > len(kept):
            item = np.dtype(dtype).itemsize
            raw: NDArray[Any] = np.empty(int(SPARE * n) + CACHE_LINE // item, dtype)
            kept = self._all[name] = raw[(-raw.ctypes.data % CACHE_LINE) // item :]
        return kept[:n].reshape(shape)
