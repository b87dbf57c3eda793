"""Cubics on equal steps, as the files of embedded atoms mean them: one law for numbers and for vectors.

    S(x) = c₀ + c₁ t + c₂ t² + c₃ t³,   k = ⌊x⌋,   t = x − k,   x in steps of the table

The cubic of each step has the values of the table, and slopes by differences, at both of its ends.
"""

from collections import namedtuple
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.kernels import scalar
from minimd.core.compiled.simd import fma, select
from minimd.core.compiled.simd.vector import MAGIC
from minimd.core.neighbors.buffers import Buffers

FEWEST_POINTS = 5  # of which a slope is made


class Identical:
    """Equal to nothing but itself: for law types that hold arrays."""

    __slots__ = ()
    __eq__ = object.__eq__
    __ne__ = object.__ne__
    __hash__ = object.__hash__


class Cubics(Identical, namedtuple("Cubics", "rows per_step last")):
    """Functions, or pairs of them, on the same steps, one after the other.

    rows : (K · M, 4 or 8) c₀ to c₃ of K functions, or of both of K pairs; row k M + m is step m, of M, of the k-th.
    per_step : 1/Δ of a step Δ.
    last : M − 1.
    """

    __slots__ = ()


def cubics(step: float, values: Iterable[Sequence[NDArray[np.float64]]]) -> Cubics:
    """Functions, or pairs of them, with these values, each (M + 1,), at 0, Δ, 2Δ …

    Slopes are differences of order 4, (f₋₂ − 8 f₋₁ + 8 f₁ − f₂)/12, of order 2 beside the ends, and of order 1 at them:
    those with which LAMMPS (pair_style eam) reads a file, so that energies agree in all digits.
    """
    functions = [np.hstack([*map(_coefficients, of_row)]) for of_row in values]
    coefficients = np.concatenate(functions)
    rows = Buffers().array("rows", np.float64, *coefficients.shape)
    rows[:] = coefficients
    return Cubics(rows, 1.0 / step, float(len(functions[0]) - 1))


def _coefficients(f: NDArray[np.float64]) -> NDArray[np.float64]:
    slopes = np.gradient(f)
    slopes[2:-2] = (f[:-4] - f[4:] + 8.0 * (f[3:-1] - f[1:-3])) / 12.0
    rise = np.diff(f)
    start, end = slopes[:-1], slopes[1:]
    columns = (f[:-1], start, 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise)
    return np.column_stack(columns)


@scalar
def step_at(x, table):
    """MAGIC + k, see simd.vector, and t of x; beyond the end those of the end.  k is a step of the table for any x ≥ 0,
    also for one that is no number.

    x − ½ is rounded to a whole number when MAGIC is added. At a point of the table this may give the step before it,
    whose end is the same."""
    within = select(x < table.last + 0.5, x, table.last + 0.5)
    place = (within - 0.5) + MAGIC
    t = x - (place - MAGIC)
    return place, select(t < 1.0, t, 1.0)


@scalar
def cubic(t, c0, c1, c2, c3):
    """S and S′ of a step."""
    value = fma(fma(fma(c3, t, c2), t, c1), t, c0)
    slope = fma(fma(3.0 * c3, t, 2.0 * c2), t, c1)
    return value, slope
