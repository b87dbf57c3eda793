"""Lattice vectors rotated to the place where MDAnalysis and LAMMPS expect them: a along x, b in the xy plane."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def upright(vectors: Array) -> tuple[Array, Array]:
    """A rotation (3, 3), and the vectors after it, vectors @ rotation: a lower triangle with a positive diagonal.

    vectors : (3, 3) [length], rows, independent. They must be right-handed; of a left-handed cell pass −vectors,
        which span the same lattice.
    """
    if np.array_equal(vectors, np.tril(vectors)) and (np.diag(vectors) > 0.0).all():
        return np.eye(3), np.array(vectors)
    q, upper = np.linalg.qr(vectors.T)
    signs = np.where(np.diag(upper) < 0.0, -1.0, 1.0)
    return q * signs, np.tril((upper * signs[:, None]).T)


def handedness(vectors: Array) -> float:
    """1 for right-handed vectors, −1 for left-handed ones."""
    return 1.0 if np.linalg.det(vectors) > 0.0 else -1.0
