"""Memory that is used again at each build: new pages from the operating system cost more time than writing to them."""

from collections.abc import Sequence
from itertools import accumulate
from math import prod, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

# room for this much more than was asked for: from build to build of a liquid sizes change by less
SPARE = 1.05
CACHE_LINE = 64  # bytes; vectors that straddle two cost twice
# bytes
PAGE = 4096
HALF_A_PAGE = 2048
DEVIATIONS = 16.0  # of a number that is a sum of independent ones

Fields = Sequence[tuple[type, tuple[int, ...]]]  # types and shapes of arrays


def with_room(n: float) -> int:
    """n and some room to spare: many atoms together change less than few."""
    return int(min(SPARE * n, n + DEVIATIONS * sqrt(n))) + 1


class Buffers:
    """Arrays by name, each as large as it ever was; their contents are what was left in them.
    Processors take a load for one of what was just stored if the two addresses agree in the lower twelve bits, and
    wait. So an array from which a loop loads and one to which it stores should begin at different places in a page."""

    def __init__(self) -> None:
        self._all: dict[str, NDArray[Any]] = {}

    def array(
        self, name: str, dtype: type, n: int, *more: int, in_page: int = 0, spare: float = SPARE
    ) -> NDArray[Any]:
        """An array of shape (n, *more); the next one of the same name takes its place.
        in_page : where in a page it begins, a multiple of 64.  spare : memory in units of what was asked for, at first.
        """
        if name not in self._all or n > len(self._all[name]):
            self._all.pop(name, None)  # first: the old one is not needed beside the new one
            rows = int(spare * n) + 1
            item = np.dtype(dtype).itemsize
            size = rows * prod(more)
            raw: NDArray[Any] = np.empty(size + PAGE // item, dtype)
            first = ((in_page - raw.ctypes.data) % PAGE) // item
            self._all[name] = raw[first : first + size].reshape(rows, *more)
        return self._all[name][:n]

    def overlaid(self, name: str, *uses: Fields, spare: float = SPARE) -> list[list[NDArray[Any]]]:
        """For each of several uses of one piece of memory, one at a time, the arrays, one after the other.
        Uses that begin with the same fields share these."""
        most = max(sum(_padded(*field) for field in fields) for fields in uses)
        piece = self.array(name, np.uint8, most, spare=spare)
        found = list[list[NDArray[Any]]]()
        for fields in uses:
            starts = accumulate((_padded(*field) for field in fields), initial=0)
            each = [
                (start, start + _bytes(*field), *field)
                for start, field in zip(starts, fields, strict=False)
            ]
            found.append(
                [piece[start:end].view(dtype).reshape(shape) for start, end, dtype, shape in each]
            )
        return found


def _bytes(dtype: type, shape: tuple[int, ...]) -> int:
    return prod(shape) * np.dtype(dtype).itemsize


def _padded(dtype: type, shape: tuple[int, ...]) -> int:
    return -(-_bytes(dtype, shape) // CACHE_LINE) * CACHE_LINE
