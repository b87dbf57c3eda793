"""Atoms, bonds and molecules in the form that constraint solvers use, and operations on their vectors.

Solvers return the largest number of iterations; n < 0 says that the constraint (or molecule) −1 − n could not be kept.
"""

from collections import namedtuple

from minimd.compiled.kernels import inlined, kernel
from minimd.structure.vectors import combined

NOTHING = -1


class Atoms(namedtuple("Atoms", "positions vectors inverse_masses")):
    """positions : (N, 3) [length].  vectors : (N, 3) velocities or accelerations.  inverse_masses : (N,) [1/mass]."""


class Bonds(namedtuple("Bonds", "first second offsets lengths2 tolerance")):
    """first, second : (K,) atoms.  offsets : (K, 3) [length], added to r_j − r_i.  lengths2 : (K,) d² [length²].
    tolerance : of |r² − d²|/d²."""


class Molecules(namedtuple("Molecules", "atoms offsets shapes")):
    """atoms : (M, 3) a, b, c.  offsets : (M, 2, 3) of b and c from a [length].  shapes : (M, …) see each solver."""


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
