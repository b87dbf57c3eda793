"""What loops add: float64 numbers (or vectors of them), or, in fixed-point arithmetic, numbers rounded to a grid.

steps : Steps of the grid, () without one.
"""

import numpy as np

from minimd.compiled.fixed_point import MOST, as_float, is_fixed, whole_product
from minimd.compiled.kernels import by_type
from minimd.compiled.simd import bits_from_mask
from minimd.compiled.simd.vector import Vector

LIMIT2 = MOST**2  # square of the largest impulse, in steps of momentum: below it, whole_product is right


@by_type
def no_force(steps):
    """Zero, of the type of the forces."""
    return (lambda steps: np.int64(0)) if is_fixed(steps) else lambda steps: 0.0


@by_type
def force_along(f, x, steps):
    """The component f x of a force; on a grid as an impulse, a whole number of steps of momentum."""
    if is_fixed(steps):
        return lambda f, x, steps: whole_product(f * steps.per_force[0], x)
    return lambda f, x, steps: f * x


@by_type
def as_force(f, steps):
    """A component of a force from force_along."""
    return (lambda f, steps: as_float(f) / steps.per_force[0]) if is_fixed(steps) else lambda f, steps: f


@by_type
def is_too_large(size2, steps):
    """Whether one of several forces may be too large for a grid.  size2 : sum of their squares [energy²/length²]."""
    if not is_fixed(steps):
        return lambda size2, steps: False
    if not isinstance(size2, Vector):
        return lambda size2, steps: not size2 * steps.per_force[0] ** 2 <= LIMIT2
    all_lanes = (1 << size2.lanes) - 1
    return lambda size2, steps: bits_from_mask(size2 * steps.per_force[0] ** 2 <= LIMIT2) != all_lanes
