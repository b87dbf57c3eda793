"""The multiple-tau correlator: time correlations over many decades of lags during a run, with little memory and work.

Level k holds the last p entries of a series that is 2ᵏ times coarser than that of level 0, and correlates the newest
with the others, at lags 0, 1, …, p − 1 on level 0, and p/2 to p − 1 of its own entries on every other level.
The longest lag grows as 2ᵏ, the number of lags as k.

    thinned   a level gets every second entry of the level below: each lag is exact, but has fewer origins
    averaged  a level gets the means of two entries of the level below: noise is averaged out at lags of p/2 or more

J. Ramírez, S. K. Sukumaran, B. Vorselaars, A. E. Likhtman, J. Chem. Phys. 133, 154103 (2010).
"""

from __future__ import annotations

from collections import namedtuple
from functools import partial
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from minimd.core.compiled.kernels import kernel, scalar, type_of
from minimd.core.structure.arrays import Array, Indices

MOST_TAKEN = 2**62  # entries
RATIO = 2  # of the spacings of two levels


@scalar
def product(a, b):
    """a b, for velocities or stresses."""
    return a * b


@scalar
def squared_difference(a, b):
    """(a − b)², for positions."""
    return (a - b) * (a - b)


Product = type_of(product)(namedtuple("Product", ()))
SquaredDifference = type_of(squared_difference)(namedtuple("SquaredDifference", ()))


def of_both(law, a, b):
    """The value of a law, Product() or SquaredDifference(), for two numbers."""
    return law.python(a, b)


@overload(of_both)
def _of_both_compiled(law, a, b):
    formula = law.instance_class.formula
    return lambda law, a, b: formula(a, b)


# sums over atoms in any order: 5 times as fast
@partial(kernel, fastmath={"reassoc", "nsz", "contract"})
def add_correlations(law, ring, slot, first, n_kept, starts, sums):
    """sums[j, g, c] += Σ law(a(t), a(t − j)), over the particles of group g, for lags j from first to n_kept − 1.

    law : Product() or SquaredDifference().
    ring : (p, C, n), the last p entries, the newest at index slot.
    starts : (G + 1,) int, first particle of each group.
    sums : (p, G, C).
    """
    p = ring.shape[0]
    for j in range(first, n_kept):
        past = (slot + p - j) % p
        for g in range(starts.size - 1):
            for c in range(ring.shape[1]):
                a = ring[slot, c, starts[g] : starts[g + 1]]
                b = ring[past, c, starts[g] : starts[g + 1]]
                total = 0.0
                for i in range(a.size):
                    total += of_both(law, a[i], b[i])
                sums[j, g, c] += total


class MultipleTau:
    """Correlations of C components of n particles in G groups.

    law : Product() or SquaredDifference().
    starts : (G + 1,) int, first particle of each group.
    n_components : C.
    points : p, number of entries on a level, even.
    n_levels : L, the largest number of levels.
    averages : True for averaged levels, else thinned.

    size : of the sums, which the caller keeps: counts (L, p), then sums (L, p, G, C).
    lags : (T,) int, all possible lags in entries, ascending.
    """

    def __init__(
        self,
        law: tuple,
        starts: Indices,
        n_components: int,
        points: int,
        n_levels: int,
        averages: bool,
    ) -> None:
        self._law = law
        self._starts = starts
        self._averages = averages
        self._points = points
        self._n_levels = n_levels
        self._shape = (points, n_components, int(starts[-1]))
        self._n_counts = n_levels * points
        n_groups = len(starts) - 1
        self._sums_shape = (n_levels, points, n_groups, n_components)
        self.size = self._n_counts * (1 + n_groups * n_components)
        entries = np.arange(points)
        level = np.arange(n_levels)[:, None]
        self._places = np.flatnonzero(entries >= np.where(level > 0, points // RATIO, 0))
        self.lags = (entries * RATIO**level).ravel()[self._places]
        self.interrupt()

    def interrupt(self) -> None:
        """What comes next is not correlated with what came before."""
        self._rings: list[Array] = []
        self._means: list[Array] = []
        self._n_taken = np.zeros(self._n_levels, dtype=np.int64)

    def add(self, entry: Array, sums: Array) -> None:
        """Take the next entry, (C, n), and add its correlations to the sums, (size,)."""
        counts = sums[: self._n_counts].reshape(self._n_levels, self._points)
        products = sums[self._n_counts :].reshape(self._sums_shape)

        for level in range(self._n_levels):
            if level == len(self._rings):
                self._add_level()
            n = int(self._n_taken[level])
            ring = self._rings[level]
            slot = n % self._points
            first = self._points // RATIO if level else 0
            n_kept = min(n + 1, self._points)
            ring[slot] = entry
            self._n_taken[level] = n + 1
            if n_kept > first:
                add_correlations(
                    self._law, ring, slot, first, n_kept, self._starts, products[level]
                )
                counts[level, first:n_kept] += 1.0

            if self._averages:
                mean = self._means[level]
                mean += entry / RATIO
                if (n + 1) % RATIO:
                    return
                entry = mean.copy()
                mean[:] = 0.0
            elif n % RATIO:
                return

    def _add_level(self) -> None:
        self._rings.append(np.zeros(self._shape))
        self._means.append(np.zeros(self._shape[1:] if self._averages else (0, 0)))

    def correlations(self, sums: Array) -> tuple[Array, Array]:
        """Numbers of origins, (T,), and mean products of each group, summed over its particles, (T, G, C); NaN for lags
        without origins."""
        counts = sums[: self._n_counts][self._places]
        products = sums[self._n_counts :].reshape(self._n_counts, *self._sums_shape[2:])
        with np.errstate(all="ignore"):
            return counts, products[self._places] / counts[:, None, None]

    def state(self) -> dict[str, NDArray[Any]]:
        """The state, for restore."""
        return {
            "rings": np.array(self._rings or np.zeros(0)),
            "means": np.array(self._means or np.zeros(0)),
            "taken": self._n_taken,
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state."""
        self.interrupt()
        self._n_taken[:] = np.clip(state["taken"], 0, MOST_TAKEN)
        for level in range(np.count_nonzero(self._n_taken)):
            self._add_level()
            self._rings[level][:] = state["rings"][level]
            self._means[level][:] = state["means"][level]
