"""Atoms, bonds and molecules as the solvers of constraints are given them, and vectors of three numbers.

Solvers return the worst case: a number of iterations, negative if the constraint (or molecule) −1 − that number could not be kept.
"""

from math import sqrt
from typing import Any, NamedTuple

from minimd.compiled.kernels import inlined, kernel

NOTHING = -1


class Atoms(NamedTuple):
    """positions : (N, 3) [length].  vectors : (N, 3) velocities [length/time], or accelerations.  inverse_masses : (N,) [1/mass]."""

    positions: Any
    vectors: Any
    inverse_masses: Any


class Bonds(NamedTuple):
    """first, second : (K,) atoms.  offsets : (K, 3) [length], added to r_j − r_i.  lengths2 : (K,) d² [length²].  tolerance : of |r² − d²|/d²."""

    first: Any
    second: Any
    offsets: Any
    lengths2: Any
    tolerance: Any


class Molecules(NamedTuple):
    """atoms : (M, 3) a, b, c.  offsets : (M, 2, 3) of b and c from a [length].  shapes : (M, …) see each solver."""

    atoms: Any
    offsets: Any
    shapes: Any


@inlined
def separation(positions, i, j, offset):
    """r_j − r_i + offset [length]."""
    return positions[j, 0] - positions[i, 0] + offset[0], positions[j, 1] - positions[i, 1] + offset[1], positions[j, 2] - positions[i, 2] + offset[2]


@inlined
def moved(s, velocities, i, j, duration):
    """s + Δt (v_j − v_i), a separation after the drift."""
    return (
        s[0] + duration * (velocities[j, 0] - velocities[i, 0]),
        s[1] + duration * (velocities[j, 1] - velocities[i, 1]),
        s[2] + duration * (velocities[j, 2] - velocities[i, 2]),
    )


@inlined
def dot(a, b):
    """a · b of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(u, v):
    """u × v."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@inlined
def unit(u):
    """u/|u|."""
    scale = 1.0 / sqrt(dot(u, u))
    return u[0] * scale, u[1] * scale, u[2] * scale


@inlined
def combined(x, u, y, v):
    """x u + y v."""
    return x * u[0] + y * v[0], x * u[1] + y * v[1], x * u[2] + y * v[2]


@inlined
def add_opposite(vectors, inverse_masses, i, j, scale, s):
    """vectors of j += scale s/m_j, of i −= scale s/m_i."""
    wi, wj = scale * inverse_masses[i], scale * inverse_masses[j]
    for x in range(3):
        vectors[i, x] -= wi * s[x]
        vectors[j, x] += wj * s[x]


@kernel
def drift_some(positions, velocities, atoms, duration):
    """positions += duration · velocities, of some atoms. (N, 3), (N, 3), (F,), [time]."""
    for i in atoms:
        for x in range(3):
            positions[i, x] += duration * velocities[i, x]
