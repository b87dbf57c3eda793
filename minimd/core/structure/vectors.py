"""Vectors of three numbers in kernels, tuples (x, y, z); arrays of vectors, (n, 3) or (n, 3, m), strained or turned."""

from math import sqrt

import numpy as np

from minimd.core.compiled.kernels import inlined, kernel, scalar
from minimd.core.structure.arrays import Array


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


@scalar
def along(vector, matrix, d):
    """Component d of vector · matrix."""
    return vector[0] * matrix[0, d] + vector[1] * matrix[1, d] + vector[2] * matrix[2, d]


@scalar
def across(matrix, d, vector):
    """Component d of matrix · vector."""
    return matrix[d, 0] * vector[0] + matrix[d, 1] * vector[1] + matrix[d, 2] * vector[2]


@inlined
def transformed(vector, matrix):
    """vector · matrix, (3,) and (3, 3)."""
    return along(vector, matrix, 0), along(vector, matrix, 1), along(vector, matrix, 2)


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


def follow_lattice(translations: Array, before: Array, after: Array) -> None:
    """Translations by lattice vectors, (n, 3) or (n, 3, m), become the same multiples of other ones, in place.  before,
    after : (3, 3) rows."""
    follow_blocks(
        as_blocks(translations),
        inverse_of(np.array(before, order="C"))[0],
        np.ascontiguousarray(after),
    )


def as_blocks(vectors: Array) -> Array:
    """A contiguous (n, 3) or (n, 3, m) array as (n, 3, m)."""
    return vectors if vectors.ndim == 3 else vectors[:, :, np.newaxis]


@kernel
def inverse_of(matrix):
    """The inverse of a (3, 3) matrix, and its determinant, by elimination with the largest pivots (Gauss, Jordan)."""
    left = matrix.copy()
    right = np.eye(3)
    determinant = 1.0

    for k in range(3):
        pivot = k
        for i in range(k + 1, 3):
            pivot = i if abs(left[i, k]) > abs(left[pivot, k]) else pivot
        determinant *= left[pivot, k] if pivot == k else -left[pivot, k]
        for c in range(3):
            left[k, c], left[pivot, c] = left[pivot, c], left[k, c]
            right[k, c], right[pivot, c] = right[pivot, c], right[k, c]
        for i in range(3):
            factor = left[i, k] / left[k, k] if i != k else 0.0
            for c in range(3):
                left[i, c] -= factor * left[k, c]
                right[i, c] -= factor * right[k, c]

    for k in range(3):
        for c in range(3):
            right[k, c] /= left[k, k]
    return right, determinant


@kernel
def strain_vectors(vectors, matrix, shift, out):
    """out = vectors @ matrix + shift; both may be one array.
    vectors, out : (n, 3).
    matrix : (3, 3).
    shift : (3,)."""
    for i in range(vectors.shape[0]):
        vector = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        for c in range(3):
            out[i, c] = along(vector, matrix, c) + shift[c]


@kernel
def strain_state(positions, velocities, stretch, inverse, drift):
    """r ← r S,  v ← V + (v − V) S′, in place.

    positions, velocities : (N, 3).
    stretch, inverse : S and S′, (3, 3).
    drift : V, (3,)."""
    shift = np.empty(3)
    for c in range(3):
        shift[c] = drift[c] - along(drift, inverse, c)
    strain_vectors(positions, stretch, np.zeros(3), positions)
    strain_vectors(velocities, inverse, shift, velocities)


@kernel
def follow_blocks(translations, inverse, vectors):
    """See follow_lattice."""
    for i in range(translations.shape[0]):
        for k in range(translations.shape[2]):
            translation = translations[i, :, k]
            a, b, c = transformed(translation, inverse)
            whole = np.rint(a), np.rint(b), np.rint(c)
            for d in range(3):
                translation[d] = along(whole, vectors, d)


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
