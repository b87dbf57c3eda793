"""Atoms, bonds and molecules in the form that constraint solvers use, and operations on their vectors.

Solvers return the largest number of iterations; a negative number n says that the constraint (or molecule)
−1 − n could not be kept.
"""

from typing import Any, NamedTuple

from minimd.compiled.kernels import inlined, kernel
from minimd.structure.vectors import combined

NOTHING = -1


class Atoms(NamedTuple):
    """positions : (N, 3) [length].  vectors : (N, 3) velocities or accelerations.  inverse_masses : (N,) [1/mass]."""

    positions: Any
    vectors: Any
    inverse_masses: Any


class Bonds(NamedTuple):
    """first, second : (K,) atoms.  offsets : (K, 3) [length], added to r_j − r_i.  lengths2 : (K,) d² [length²].
    tolerance : of |r² − d²|/d²."""

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
def between(vectors, i, j):
    """x_j − x_i."""
    return vectors[j, 0] - vectors[i, 0], vectors[j, 1] - vectors[i, 1], vectors[j, 2] - vectors[i, 2]


@inlined
def moved(s, velocities, i, j, duration):
    """s + Δt (v_j − v_i), a separation after the drift."""
    return combined(1.0, s, duration, between(velocities, i, j))


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
