"""What the scalar loops add to: the float64 arrays forces, energies, virials; or GridSums,
to which only numbers rounded to a grid are added."""

import numpy as np
from numba import types
from numba.extending import overload

from minimd.compiled.fixed_point import MOST, GridSums, on_grid, whole_product

LIMIT2 = MOST**2  # square of the largest impulse, in steps of momentum: below it, whole_product is right


def no_force(sums):
    """Zero, of the type of the forces."""
    return 0 if isinstance(sums, GridSums) else 0.0


def force_along(f, x, sums):
    """The component f x of a force; for GridSums as an impulse, a whole number of steps of momentum."""
    return whole_product(f * sums.steps.per_force[0], x) if isinstance(sums, GridSums) else f * x


def in_steps(u, sums):
    """An energy; for GridSums rounded to a multiple of its step."""
    return on_grid(u, sums.steps.energy) if isinstance(sums, GridSums) else u


def watch(size2, sums):
    """For GridSums, record a fault if one of several forces may be too large.  size2 :
    sum of their squares [energy²/length²]."""
    if isinstance(sums, GridSums) and not size2 * sums.steps.per_force[0] ** 2 <= LIMIT2:
        sums.faults[0] = 1


def _is_grid(sums: types.Type) -> bool:
    return getattr(sums, "instance_class", None) is GridSums


@overload(no_force)
def _no_force(sums):
    return (lambda sums: np.int64(0)) if _is_grid(sums) else lambda sums: 0.0


@overload(force_along)
def _force_along(f, x, sums):
    if _is_grid(sums):
        return lambda f, x, sums: whole_product(f * sums.steps.per_force[0], x)
    return lambda f, x, sums: f * x


@overload(in_steps)
def _in_steps(u, sums):
    return (lambda u, sums: on_grid(u, sums.steps.energy)) if _is_grid(sums) else lambda u, sums: u


@overload(watch)
def _watch(size2, sums):
    if not _is_grid(sums):
        return lambda size2, sums: None

    def watch_steps(size2, sums):
        if not size2 * sums.steps.per_force[0] ** 2 <= LIMIT2:
            sums.faults[0] = 1

    return watch_steps
