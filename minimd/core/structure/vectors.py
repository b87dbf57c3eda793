"""Vectors of three numbers in kernels, tuples (x, y, z); arrays of vectors, (n, 3) or (n, 3, m), strained or turned."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.kernels import inlined, kernel

Array = NDArray[np.float64]


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


NOWHERE = np.zeros(3)


def strained(vectors: Array, matrix: Array, out: Array, shift: Array = NOWHERE) -> None:
    """out = vectors @ matrix + shift; both may be one array.
    vectors, out : (n, 3) or (n, 3, m).
    matrix : (3, 3).
    shift : (3,)."""
    multiply_blocks(as_blocks(vectors), np.ascontiguousarray(matrix), shift, as_blocks(out))


def follow_lattice(translations: Array, before: Array, after: Array) -> None:
    """Translations by lattice vectors, (n, 3) or (n, 3, m), become the same multiples of other ones, in place.  before,
    after : (3, 3) rows."""
    follow_blocks(
        as_blocks(translations),
        np.ascontiguousarray(np.linalg.inv(before)),
        np.ascontiguousarray(after),
    )


def as_blocks(vectors: Array) -> Array:
    """A contiguous (n, 3) or (n, 3, m) array as (n, 3, m)."""
    return vectors if vectors.ndim == 3 else vectors[:, :, np.newaxis]


@kernel
def multiply_blocks(vectors, matrix, shift, out):
    """See strained."""
    for i in range(vectors.shape[0]):
        for k in range(vectors.shape[2]):
            x, y, z = vectors[i, 0, k], vectors[i, 1, k], vectors[i, 2, k]
            for c in range(3):
                out[i, c, k] = x * matrix[0, c] + y * matrix[1, c] + z * matrix[2, c] + shift[c]


@kernel
def follow_blocks(translations, inverse, vectors):
    """See follow_lattice."""
    for i in range(translations.shape[0]):
        for k in range(translations.shape[2]):
            x, y, z = translations[i, 0, k], translations[i, 1, k], translations[i, 2, k]
            a = np.rint(x * inverse[0, 0] + y * inverse[1, 0] + z * inverse[2, 0])
            b = np.rint(x * inverse[0, 1] + y * inverse[1, 1] + z * inverse[2, 1])
            c = np.rint(x * inverse[0, 2] + y * inverse[1, 2] + z * inverse[2, 2])
            for d in range(3):
                translations[i, d, k] = a * vectors[0, d] + b * vectors[1, d] + c * vectors[2, d]


def upright(vectors: Array) -> tuple[Array, Array]:
    """A rotation (3, 3), and the vectors after it, vectors @ rotation: a lower triangle with a positive diagonal.
    vectors : (3, 3) [length], rows, independent. They must be right-handed; of a left-handed cell pass −vectors,
        which span the same lattice."""
    if np.array_equal(vectors, np.tril(vectors)) and (np.diag(vectors) > 0.0).all():
        return np.eye(3), np.array(vectors)
    q, upper = np.linalg.qr(vectors.T)
    signs = np.where(np.diag(upper) < 0.0, -1.0, 1.0)
    return q * signs, np.tril((upper * signs[:, None]).T)


def handedness(vectors: Array) -> float:
    """1 for right-handed vectors, −1 for left-handed ones."""
    return 1.0 if np.linalg.det(vectors) > 0.0 else -1.0
