"""Homogeneous strain of arrays of vectors: rows (n, 3), or blocks (n, 3, m) that hold the x,
the y and the z of m vectors."""

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel

NOWHERE = np.zeros(3)


def strained(
    vectors: NDArray[np.float64],
    matrix: NDArray[np.float64],
    out: NDArray[np.float64],
    shift: NDArray[np.float64] = NOWHERE,
) -> None:
    """out = vectors @ matrix + shift; both may be one array.  vectors, out : (n, 3) or (n, 3, m).  matrix : (3, 3).
    shift : (3,)."""
    multiply_blocks(as_blocks(vectors), np.ascontiguousarray(matrix), shift, as_blocks(out))


def follow_lattice(translations: NDArray[np.float64], before: NDArray[np.float64], after: NDArray[np.float64]) -> None:
    """Translations by lattice vectors, (n, 3) or (n, 3, m), become the same multiples of other ones, in place.  before,
    after : (3, 3) rows."""
    follow_blocks(as_blocks(translations), np.ascontiguousarray(np.linalg.inv(before)), np.ascontiguousarray(after))


def as_blocks(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
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
