"""Cubics on equal steps, as the files of embedded atoms mean them: one law for numbers and for vectors.

    S(x) = c₀ + c₁ t + c₂ t² + c₃ t³,   t = x − k − ½  for  k ≤ x ≤ k + 1,   x in steps of the table

The cubic of each step has the values of the table, and slopes by differences, at both of its ends.
"""

from collections import namedtuple
from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from minimd.core.compiled.kernels import scalar
from minimd.core.compiled.simd import fma
from minimd.core.compiled.simd.vector import MAGIC
from minimd.core.neighbors.buffers import Buffers
from minimd.core.structure.arrays import Array

FEWEST_POINTS = 5  # of which a slope is made


class Identical:
    """Equal to nothing but itself: for law types that hold arrays."""

    __slots__ = ()
    __eq__ = object.__eq__
    __ne__ = object.__ne__
    __hash__ = object.__hash__


class Cubics(Identical, namedtuple("Cubics", "rows per_step end")):
    """Functions, or pairs of them, on the same steps, one after the other; each ends with straight lines.

    rows : (K · M, 4 or 8) c₀ to c₃ of K functions, or of both of K pairs; row k M + m is step m, of M, of the k-th.
    per_step : 1/Δ of a step Δ.
    end : the largest x, within the last step.
    """

    __slots__ = ()


def cubics(step: float, values: Iterable[Sequence[Array]], reach: float = 0.0) -> Cubics:
    """Functions, or pairs of them, with these values, each (M,), at 0, Δ, 2Δ …; beyond the last, straight lines.

    reach : to which the lines go, at least [as step].

    Slopes are differences of order 4, (f₋₂ − 8 f₋₁ + 8 f₁ − f₂)/12, of order 2 beside the ends, and of order 1 at them:
    those with which LAMMPS (pair_style eam) reads a file, so that energies agree in all digits.
    """
    rows_of = partial(_coefficients, n_steps=int(np.ceil(reach / step)) + 1)
    functions = [np.hstack([*map(rows_of, of_row)]) for of_row in values]
    coefficients = np.concatenate(functions)
    rows = Buffers().array("rows", np.float64, *coefficients.shape)
    rows[:] = coefficients
    return Cubics(rows, 1.0 / step, len(functions[0]) - 0.75)


def _coefficients(f: Array, n_steps: int) -> Array:
    """c₀ to c₃ of as many steps, at least as many as points."""
    slopes = np.gradient(f)
    slopes[2:-2] = (f[:-4] - f[4:] + 8.0 * (f[3:-1] - f[1:-3])) / 12.0
    rise = np.diff(f)
    mean = 0.5 * (slopes[:-1] + slopes[1:])
    bend = np.diff(slopes)
    middle = 0.5 * (f[:-1] + f[1:]) - 0.125 * bend
    columns = (middle, 1.5 * rise - 0.5 * mean, 0.5 * bend, 2.0 * (mean - rise))
    beyond = np.zeros((max(1, n_steps - len(rise)), 4))
    beyond[:, 0] = f[-1] + slopes[-1] * (np.arange(len(beyond)) + 0.5)
    beyond[:, 1] = slopes[-1]
    return np.vstack([np.column_stack(columns), beyond])


def periodic_cubics(f: Array) -> Array:
    """c₀ to c₃, (4, …, n), of the smooth spline through the points of a period along the last axis, f (…, n).

    S(x) = c₀ + c₁ t + c₂ t² + c₃ t³,   t = x − k  for  k ≤ x ≤ k + 1
    s₋₁ + 4 s + s₁ = 3 (f₁ − f₋₁) of its slopes,   s = Σ_d (zᵈ + zⁿ⁻ᵈ)/(√12 (1 − zⁿ)) 3 (f₁₋d − f₋₁₋d),   z = √3 − 2
    """
    n = f.shape[-1]
    powers = np.cumprod([1.0, *[3.0**0.5 - 2.0] * n])
    weights = (powers + powers[::-1]) / (12.0**0.5 * (1.0 - powers[n]))
    right = np.roll(f, -1, -1)
    bend = 3.0 * (right - np.roll(f, 1, -1))
    slopes = np.zeros(f.shape)
    for d in range(n):
        slopes += weights[d] * np.roll(bend, d, -1)
    last = np.roll(slopes, -1, -1)
    rise = right - f
    return np.stack([f, slopes, 3.0 * rise - 2.0 * slopes - last, slopes + last - 2.0 * rise])


@scalar
def step_at(x, row):
    """MAGIC + row + k, see simd.vector, and t.
    row : the first one of the function.

    x − ½ is rounded to a whole number when MAGIC is added. At a point of the table, but the first, this may give the
    step before it, whose end is the same."""
    from_middle = x - 0.5
    start = MAGIC + row
    place = from_middle + start
    return place, from_middle - (place - start)


@scalar
def cubic(t, c0, c1, c2, c3):
    """S and S′ of a step."""
    value = fma(fma(fma(c3, t, c2), t, c1), t, c0)
    slope = fma(fma(3.0 * c3, t, 2.0 * c2), t, c1)
    return value, slope
