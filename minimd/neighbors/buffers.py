"""Memory that is used again at each build: new pages from the operating system would cost more time than writing to them."""

from itertools import accumulate
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

SPARE = 1.05  # room for this much more than was asked for: from build to build of a liquid sizes change by less
CACHE_LINE = 64  # bytes; vectors that straddle two cost twice
PAGE = 4096  # bytes
HALF_A_PAGE = PAGE // 2


class Buffers:
    """Arrays by name, each as large as it ever was; their contents are what was left in them.

    Processors take a load for one of what was just stored if the two addresses agree in the lower twelve bits, and wait. Where a loop
    loads from one array and stores to another, the two should therefore begin at different places in a page of memory.
    """

    def __init__(self) -> None:
        self._all: dict[str, NDArray[Any]] = {}

    def array(self, name: str, dtype: type, n: int, *more: int, in_page: int = 0, spare: float = SPARE) -> NDArray[Any]:
        """An array of shape (n, *more); the next one of the same name takes its place.

        in_page : where in a page it begins, a multiple of 64.  spare : memory in units of what was asked for, if there is none yet.
        """
        kept = self._all.get(name)
        if kept is None or n > len(kept):
            rows, item = int(spare * n) + 1, np.dtype(dtype).itemsize
            size = rows * prod(more)
            raw: NDArray[Any] = np.empty(size + PAGE // item, dtype)
            first = ((in_page - raw.ctypes.data) % PAGE) // item
            kept = self._all[name] = raw[first : first + size].reshape(rows, *more)
        return kept[:n]

    def carve(self, name: str, *fields: tuple[type, tuple[int, ...]], in_page: int = 0) -> list[NDArray[Any]]:
        """Arrays of these types and shapes, one after the other in one piece of memory; those carved next of the same name take their place."""
        sizes = [prod(shape) * np.dtype(dtype).itemsize for dtype, shape in fields]
        starts = [0, *accumulate(-(-size // CACHE_LINE) * CACHE_LINE for size in sizes)]
        piece = self.array(name, np.uint8, starts[-1], in_page=in_page)
        return [piece[a : a + size].view(dtype).reshape(shape) for a, size, (dtype, shape) in zip(starts, sizes, fields, strict=False)]
