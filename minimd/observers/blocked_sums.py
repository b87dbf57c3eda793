"""Sums over a run, and their values at some moments: enough for error bars, in little memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.structure.statistics import MOST_BLOCKS, replicas, spread

Array = NDArray[np.float64]


class BlockedSums:
    """Sums of n numbers over the entries of a run.



    All blocks have the same length, which grows with the run:
    they become longer than any correlation that the run is long enough to show.

    total : (n,), to which entries are added in place.  n_entries : number of complete entries.
    """

    def __init__(self, n: int) -> None:
        self.total = np.zeros(n)
        self.n_entries, self._length, self._n_marks = 0, 1, 0
        self._marks = np.zeros((MOST_BLOCKS, n))

    def close_entry(self) -> None:
        """Count an entry that has been added completely."""
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
        """The result of a law for the sums without one block, (K, ...), for each of K blocks;
        their spread gives the standard error."""
        with np.errstate(all="ignore"):  # a lag that occurs in one block only has no error
            return replicas(law, self.total, self.parts())

    def estimate(self, law: Callable[[Array], Any]) -> tuple[Array, Array]:
        """The result of a law for the sums, and its standard error."""
        with np.errstate(all="ignore"):
            value = np.asarray(law(self.total), dtype=np.float64)
        found = self.replicas(law)
        return value, spread(found) if len(found) else np.full_like(value, np.nan)

    def state(self) -> dict[str, NDArray[Any]]:
        """The state, for restore."""
        numbers = np.array([self.n_entries, self._length, self._n_marks])
        return {"total": self.total, "marks": self._marks[: self._n_marks], "entries": numbers}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state."""
        self.total[:] = state["total"]
        self.n_entries, self._length, self._n_marks = map(int, state["entries"])
        self._marks[: self._n_marks] = state["marks"]
