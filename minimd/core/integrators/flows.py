"""The two flows of a splitting, kick and drift: for numbers, SIMD vectors and all atoms, in float64 and fixed-point."""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import FARTHEST, MOST, as_float, is_fixed
from minimd.core.compiled.kernels import by_type, called_kernel, scalar
from minimd.core.compiled.program import GO_ON, OUT_OF_RANGE, share_of
from minimd.core.compiled.simd import fma, select
from minimd.core.compiled.simd.vector import MAGIC

# kinds of flows
KICK = 0.0
DRIFT = 1.0


@scalar
def kicked(velocity, force, inverse_mass, duration):
    """v + duration · F/m, for numbers or SIMD vectors."""
    return velocity + duration * inverse_mass * force


@scalar
def drifted(position, velocity, duration):
    """r + duration · v, for numbers or SIMD vectors."""
    return position + duration * velocity


@scalar
def mixed(velocity, noise, kept, scale):
    """kept · v + scale · ξ, the Ornstein-Uhlenbeck process, with scale = √(k_B T (1 − kept²)/m)."""
    return kept * velocity + scale * noise


@scalar
def momentum_in_steps(velocity, inverse_mass, steps):
    """Momentum in steps, for numbers: exactly the one its velocity was made from, if it was; zero for a fixed atom."""
    return np.rint(velocity / (steps.momentum * inverse_mass)) if inverse_mass > 0.0 else 0.0


@scalar
def velocity_of(momentum, inverse_mass, steps):
    """v = p/m of a momentum in steps [length/time]."""
    return momentum * (steps.momentum * inverse_mass)


@scalar
def kicked_on_grid(momentum, impulse, inverse_mass, times):
    """p + times · impulse, in steps, exact; p if inverse_mass is 0.
    momentum : float64 whole.
    impulse : int64."""
    return momentum + times * select(inverse_mass > 0.0, as_float(impulse), 0.0)


@scalar
def drifted_on_grid(position, momentum, inverse_mass, unit, times, steps):
    """r + times · (unit · p/m), with the displacement in brackets rounded to a multiple of steps.length;
    −p gives the opposite displacement."""
    rounder = MAGIC * steps.length
    return position + times * (
        fma(momentum, steps.momentum * unit * inverse_mass, rounder) - rounder
    )


class Moving(
    ByAddress,
    namedtuple(
        "Moving", "positions velocities forces inverse_masses flows steps n_chunks are_alike"
    ),
):
    """What kicks and drifts work on.
    positions, velocities, forces : (3 N,) flat [length], [length/time], [energy/length].
    inverse_masses : (N,) [1/mass], zero for atoms that are held fixed.
    are_alike : whether all are the same.
    flows : (F, 3), one after the other: KICK or DRIFT, its duration, and, on a grid, the unit [time] of which the
        duration is a whole multiple: the change over one unit is rounded.
    steps : Steps in fixed-point arithmetic, where forces are int64 impulses over the unit; else ()."""


@called_kernel
def move_atoms(moving, chunk):
    """Kicks and drifts of the atoms of a chunk, all of them in one pass over memory.
    OUT_OF_RANGE if a momentum or a position leaves its range, in fixed-point arithmetic."""
    n = moving.inverse_masses.size
    n_chunks = moving.n_chunks
    is_out = False
    begin, end = share_of(chunk, n_chunks, n)
    first = np.uintp(begin)
    last = np.uintp(end)
    for k in range(moving.flows.shape[0]):
        kind = moving.flows[k, 0]
        duration = moving.flows[k, 1]
        unit = moving.flows[k, 2]
        if kind == KICK:
            is_out |= _kick(moving, first, last, duration, unit, moving.steps)
        else:
            is_out |= _drift(moving, first, last, duration, unit, moving.steps)
    return OUT_OF_RANGE if is_out else GO_ON


@by_type
def _kick(moving, first, last, duration, unit, steps):
    """velocities += duration · forces / m, for numbers; momenta += times · impulses, on a grid."""
    return _kick_on_grid if is_fixed(steps) else _kick_floats


def _kick_floats(moving, first, last, duration, unit, steps):
    v = moving.velocities
    f = moving.forces
    inverse_masses = moving.inverse_masses
    if moving.are_alike:
        w = inverse_masses[0]
        for k in range(np.uintp(3) * first, np.uintp(3) * last):
            v[k] = kicked(v[k], f[k], w, duration)
        return False
    for i in range(first, last):
        w = inverse_masses[i]
        k = np.uintp(3) * i
        for x in range(np.uintp(3)):
            v[k + x] = kicked(v[k + x], f[k + x], w, duration)
    return False


def _kick_on_grid(moving, first, last, duration, unit, steps):
    v = moving.velocities
    impulses = moving.forces
    times = np.rint(duration / unit)
    is_out = False
    for i in range(first, last):
        w = moving.inverse_masses[i]
        for k in range(np.uintp(3) * i, np.uintp(3) * i + np.uintp(3)):
            momentum = kicked_on_grid(momentum_in_steps(v[k], w, steps), impulses[k], w, times)
            v[k] = velocity_of(momentum, w, steps)
            is_out |= not abs(momentum) <= MOST
    return is_out


@by_type
def _drift(moving, first, last, duration, unit, steps):
    """positions += duration · velocities; on a grid displacements over the unit are rounded."""
    return _drift_on_grid if is_fixed(steps) else _drift_floats


def _drift_floats(moving, first, last, duration, unit, steps):
    r = moving.positions
    v = moving.velocities
    for k in range(np.uintp(3) * first, np.uintp(3) * last):
        r[k] = drifted(r[k], v[k], duration)
    return False


def _drift_on_grid(moving, first, last, duration, unit, steps):
    r = moving.positions
    v = moving.velocities
    times = np.rint(duration / unit)
    farthest = FARTHEST * steps.length
    is_out = False
    for i in range(first, last):
        w = moving.inverse_masses[i]
        for k in range(np.uintp(3) * i, np.uintp(3) * i + np.uintp(3)):
            r[k] = drifted_on_grid(r[k], momentum_in_steps(v[k], w, steps), w, unit, times, steps)
            is_out |= not abs(r[k]) <= farthest
    return is_out
