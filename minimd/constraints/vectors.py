"""Atoms, bonds and molecules in the form that constraint solvers use, one at a time or as many as a vector has lanes.

Solvers return the largest number of iterations; n < 0 says that the constraint (or molecule) −1 − n could not be kept.
"""

from collections import namedtuple

import numpy as np
from numba import types

from minimd.compiled.kernels import by_type, inlined, kernel, scalar
from minimd.compiled.simd import lane, with_lane, zeros
from minimd.compiled.simd.lanes import count

NOTHING = -1


class Atoms(namedtuple("Atoms", "positions vectors inverse_masses lanes")):
    """positions : (N, 3) [length].  vectors : (N, 3) velocities or accelerations.  inverse_masses : (N,) [1/mass].
    lanes : Lanes."""


class Bonds(namedtuple("Bonds", "first second offsets lengths2 tolerance")):
    """first, second : (K,) atoms.  offsets : (K, 3) [length], added to r_j − r_i.  lengths2 : (K,) d² [length²].
    tolerance : of |r² − d²|/d²."""


class Molecules(namedtuple("Molecules", "atoms offsets shapes")):
    """atoms : three of (M,), a, b, c.  offsets : two of (M, 3), of b and c from a [length].  shapes : some of (M,),
    see each solver."""


# The lanes of a vector belong to a block (k, end, lanes): those of at[k], at[k + 1], … or, if at is (), of k, k + 1, …;
# lanes from the end on repeat the last one before.


@by_type
def _place(at, block, n):
    if isinstance(at, types.Array):
        return lambda at, block, n: np.uintp(at[min(block[0] + n, block[1] - 1)])
    return lambda at, block, n: np.uintp(min(block[0] + n, block[1] - 1))


@scalar
def numbers(values, at, block):
    """A vector of some of the values (N,)."""
    x = zeros(block[2])
    for n in range(count(block[2])):
        x = with_lane(x, n, values[_place(at, block, n)])
    return x


@scalar
def rows(values, at, block):
    """Vectors x, y, z of some of the values (N, 3)."""
    x = y = z = zeros(block[2])
    for n in range(count(block[2])):
        i = _place(at, block, n)
        x, y, z = with_lane(x, n, values[i, 0]), with_lane(y, n, values[i, 1]), with_lane(z, n, values[i, 2])
    return x, y, z


@scalar
def put_numbers(values, at, block, x):
    """Write the lanes of a vector to some of the values (N,)."""
    for n in range(count(block[2])):
        values[_place(at, block, n)] = lane(x, n)


@scalar
def put_rows(values, at, block, xyz):
    """Write vectors x, y, z to some of the values (N, 3)."""
    x, y, z = xyz
    for n in range(count(block[2])):
        i = _place(at, block, n)
        values[i, 0], values[i, 1], values[i, 2] = lane(x, n), lane(y, n), lane(z, n)


@inlined
def between(vectors, i, j):
    """x_j − x_i."""
    return vectors[j, 0] - vectors[i, 0], vectors[j, 1] - vectors[i, 1], vectors[j, 2] - vectors[i, 2]


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
