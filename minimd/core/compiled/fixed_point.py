"""Arithmetic on grids: numbers that are whole multiples of a step, so that sums in any order have no rounding error.

A step is a power of two. Up to 2⁵³ steps, its multiples are float64 numbers, and adding two of them is exact. Forces of
pairs are summed as int64: all sums are right modulo 2⁶⁴, so the final one is right if it is in range.

Rounding uses the spacing of float64: from 2⁵² to 2⁵³ they are the whole numbers. Adding 1.5 · 2⁵² to a number between
−2⁵¹ and 2⁵¹ rounds it to a whole number (of two equally near ones, to the even one), which is then in the lowest bits
of the sum. −x is rounded to the opposite of what x is rounded to: so a force and its reaction stay opposite.

Loops add float64 numbers (or vectors of them) where `steps` is (), and numbers rounded to a grid where it is Steps.
"""

from collections import namedtuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from minimd.core.compiled.kernels import by_type, scalar
from minimd.core.compiled.simd import bits_from_mask, fma
from minimd.core.compiled.simd.vector import MAGIC, Vector, as_floats, bits_of

BIAS = int(np.float64(MAGIC).view(np.int64))
# steps in a momentum or in the impulse of a pair: the rounding of v = p/m and p = m v leads back to the same p
MOST = 2.0**50
FARTHEST = 2.0**52  # steps of length: sums of two positions are still exact


@by_type
def biased_product(a, b):
    """a · b as a whole number (int64), rounded once, plus BIAS; for |a b| < 2⁵¹. For numbers or vectors."""
    return lambda a, b: bits_of(fma(a, b, MAGIC))


def rounder_for(terms: NDArray[np.float64]) -> float:
    """A number to be added to terms and taken away again: it rounds each to a multiple of one step, so that their sum
    has no rounding error and is the same in any order."""
    return MAGIC * float(np.spacing(4.0 * len(terms) * np.abs(terms).max(initial=0.0)))


def sum_in_any_order(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sum over the first axis, the same for terms in any order."""
    rounder = rounder_for(terms)
    return np.asarray(((terms + rounder) - rounder).sum(axis=0))


@by_type
def plus_rounded(f, x, to, rounder):
    """to + f x of vectors; with the product rounded if there is a rounder, else ()."""
    if rounder == types.float64:
        return lambda f, x, to, rounder: to + (fma(f, x, rounder) - rounder)
    return lambda f, x, to, rounder: fma(f, x, to)


@scalar
def on_grid(x, step):
    """x rounded to a multiple of step, a power of 2; for |x| < 2⁵¹ steps, numbers or vectors; x itself if step = 0."""
    return (x + MAGIC * step) - MAGIC * step


@by_type
def as_float(whole):
    """An int64, or a vector of them, as float64."""
    if isinstance(whole, Vector):
        return lambda whole: as_floats(whole)
    return lambda whole: np.float64(whole)


class GridSteps(namedtuple("GridSteps", "per_force length momentum energy limit2")):
    """The steps of a grid for a kernel.
    per_force : (P,) impulses of P kicks, in steps of momentum, per unit of force: duration / momentum [length/energy].
    length, momentum, energy : the steps [length], [mass length/time], [energy].
    limit2 : square of what the forces on an atom may be, divided by its distances, in these impulses [1/length²]."""


def is_fixed(steps: types.Type) -> bool:
    """Whether a type is that of Steps, not of () where there is no grid."""
    return isinstance(steps, types.BaseNamedTuple)


@by_type
def in_steps(energy, steps):
    """An energy; on a grid rounded to a multiple of its step."""
    if is_fixed(steps):
        return lambda energy, steps: on_grid(energy, steps.energy)
    return lambda energy, steps: energy


# square of the largest impulse, in steps of momentum: below it, biased_product is right
LIMIT2 = MOST**2


@by_type
def no_force(steps):
    """Zero, of the type of the forces."""
    return (lambda steps: np.int64(0)) if is_fixed(steps) else lambda steps: 0.0


@by_type
def force_along(f, x, steps):
    """The component f x of a force; on a grid as an impulse, a whole number of steps of momentum."""
    if is_fixed(steps):
        return lambda f, x, steps: biased_product(f * steps.per_force[0], x) - BIAS
    return lambda f, x, steps: f * x


@by_type
def as_force(f, steps):
    """A component of a force from force_along."""
    if is_fixed(steps):
        return lambda f, steps: as_float(f) / steps.per_force[0]
    return lambda f, steps: f


@by_type
def is_too_large(size2, steps):
    """Whether one of several forces may be too large for a grid.
    size2 : sum of their squares [energy²/length²]."""
    if not is_fixed(steps):
        return lambda size2, steps: False
    if not isinstance(size2, Vector):
        return lambda size2, steps: not size2 * steps.per_force[0] ** 2 <= LIMIT2
    all_lanes = (1 << size2.lanes) - 1
    return lambda size2, steps: (
        bits_from_mask(size2 * steps.per_force[0] ** 2 <= LIMIT2) != all_lanes
    )
