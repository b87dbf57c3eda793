"""Vectors of three numbers in kernels: tuples (x, y, z)."""

from math import sqrt

from minimd.compiled.kernels import inlined


@inlined
def separation(positions, i, j, offset):
    """r_j − r_i + offset [length]."""
    return (
        positions[j, 0] - positions[i, 0] + offset[0],
        positions[j, 1] - positions[i, 1] + offset[1],
        positions[j, 2] - positions[i, 2] + offset[2],
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
def plus(u, v):
    """u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@inlined
def minus(u, v):
    """u − v."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@inlined
def times(x, u):
    """x u."""
    return x * u[0], x * u[1], x * u[2]
