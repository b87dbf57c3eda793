"""Memory that is used again at each build: new pages from the operating system cost more time than writing to them."""

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.structure.arrays import Indices

# room for this much more than was asked for: from build to build of a liquid sizes change by less
SPARE = 1.05
# bytes
PAGE = 4096
HALF_A_PAGE = 2048
DEVIATIONS = 16.0  # of a number that is a sum of independent ones


def with_room(needed: Indices, room: Indices) -> Indices:
    """Room for so many: room where that is enough, else some to spare. Many atoms together change less than few."""
    roomy = np.minimum(SPARE * needed, needed + DEVIATIONS * np.sqrt(needed)).astype(np.int64) + 1
    return np.where(needed > room, roomy, room)


class Buffers:
    """Arrays by name, each as large as it ever was; zeros at first, then what was left in them.
    Processors take a load for one of what was just stored if the two addresses agree in the lower twelve bits, and
    wait. So an array from which a loop loads and one to which it stores should begin at different places in a page."""

    def __init__(self) -> None:
        self._all: dict[str, NDArray[Any]] = {}

    def array(self, name: str, dtype: type, *shape: int, in_page: int = 0) -> NDArray[Any]:
        """An array of this shape; the next one of the same name takes its place.
        in_page : where in a page it begins, a multiple of 64 bytes."""
        size = prod(shape)
        if name not in self._all or size > self._all[name].size:
            self._all.pop(name, None)  # first: the old one is not needed beside the new one
            item = np.dtype(dtype).itemsize
            raw: NDArray[Any] = np.zeros(size + PAGE // item, dtype)
            first = (in_page - raw.ctypes.data) % PAGE // item
            self._all[name] = raw[first : first + size]
        return self._all[name][:size].reshape(shape)
