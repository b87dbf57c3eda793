"""Sums that grow with a run, and what they were at some moments: enough for error bars, in little memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.structure.statistics import replicas, spread

Array = NDArray[np.float64]
MOST_BLOCKS = 32  # when there are so many, two become one: a long run always has 16 to 32


class BlockedSums:
    """Sums of n numbers over the entries of a run.

    Blocks of equal length grow with the run: they become longer than any correlation that the run is long enough to show.

    total : (n,), to be added to in place.  n_entries : how many were closed.
    """

    def __init__(self, n: int) -> None:
        self.total = np.zeros(n)
        self.n_entries, self._length, self._n_marks = 0, 1, 0
        self._marks = np.zeros((MOST_BLOCKS, n))

    def close_entry(self) -> None:
        """All of an entry has been added."""
        self.n_entries += 1
        if self.n_entries % self._length:
            return
        self._marks[self._n_marks] = self.total
        self._n_marks += 1
        if self._n_marks == MOST_BLOCKS:
            self._marks[: MOST_BLOCKS // 2] = self._marks[1::2]
            self._n_marks, self._length = MOST_BLOCKS // 2, 2 * self._length

    def parts(self) -> Array:
        """(K, n) sums over each block; a last block that is not full is left out."""
        return np.diff(self._marks[: self._n_marks], axis=0, prepend=0.0)

    def replicas(self, law: Callable[[Array], Any]) -> Array:
        """What a law makes of the sums without one block, (K, ...), for each; their spread is the standard error."""
        with np.errstate(all="ignore"):  # a lag that one block alone has seen has no error
            return replicas(law, self.total, self.parts())

    def estimate(self, law: Callable[[Array], Any]) -> tuple[Array, Array]:
        """What a law makes of the sums, and its standard error."""
        with np.errstate(all="ignore"):
            value = np.asarray(law(self.total), dtype=np.float64)
        found = self.replicas(law)
        return value, spread(found) if len(found) else np.full_like(value, np.nan)

    def state(self) -> dict[str, NDArray[Any]]:
        """For restore."""
        numbers = np.array([self.n_entries, self._length, self._n_marks])
        return {"total": self.total, "marks": self._marks[: self._n_marks], "entries": numbers}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take the place of the sums whose state this is."""
        self.total[:] = state["total"]
        self.n_entries, self._length, self._n_marks = map(int, state["entries"])
        self._marks[: self._n_marks] = state["marks"]
