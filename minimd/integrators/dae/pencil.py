"""The index of a linear pencil: M y′ = A y with constant matrices.

    P M Q = diag(1, N),  P A Q = diag(C, 1)          Weierstrass' form of a regular pencil; the index is that of N: Nᵛ = 0 ≠ Nᵛ⁻¹

Shuffle algorithm: orthogonal row operations bring M to (M₁; 0) with M₁ of full rank and A to (A₁; A₂); the equations 0 = A₂ y are
differentiated, 0 = A₂ y′, and become rows of M. It ends when M is regular; the number of rounds is the index.
F. R. Gantmacher, The Theory of Matrices, vol. 2 (1959), XII; D. G. Luenberger, Automatica 14, 473 (1978);
ranks by singular values: P. Van Dooren, Linear Algebra Appl. 27, 103 (1979).
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["pencil_index"]

TOLERANCE = 1e-10  # singular values of scaled matrices below this are rounding


def pencil_index(M: ArrayLike, A: ArrayLike, tolerance: float = TOLERANCE) -> int:  # noqa: N803
    """Index ν of the pencil λM − A: how often equations of M y′ = A y must be differentiated to give y′. 0 if M is regular.

    Parameters
    ----------
    M, A : (n, n).  tolerance : singular values below this part of the largest one count as zero; rows and time are scaled first.

    Raises
    ------
    ValueError : for matrices of other shapes, or a singular pencil, det(λM − A) = 0 for all λ: its solutions are not determined.
    """
    m, a = (np.array(matrix, dtype=float) for matrix in (M, A))
    if m.ndim != 2 or m.shape[0] != m.shape[1] or m.shape != a.shape or m.size == 0:
        raise ValueError(f"M and A must be square matrices of the same size; got shapes {m.shape} and {a.shape}")
    if not (np.isfinite(m).all() and np.isfinite(a).all()):
        raise ValueError("M and A must be finite")
    n = len(m)
    m, a = m / (np.abs(m).max() or 1.0), a / (np.abs(a).max() or 1.0)  # in a unit of time of its own, on which the index does not depend
    for index in range(n + 1):
        left, sizes, _ = np.linalg.svd(m)
        rank = int((sizes > tolerance * max(sizes[0], np.abs(a).max())).sum())
        if rank == n:
            return index
        constraints = left[:, rank:].T @ a
        independent = np.linalg.svd(constraints, compute_uv=False)
        if not independent[-1] > tolerance:
            raise ValueError(_singular(n - rank, index, independent))
        m = np.vstack([left[:, :rank].T @ m, constraints])
        a = np.vstack([left[:, :rank].T @ a, np.zeros_like(constraints)])
        sizes = np.linalg.norm(m, axis=1)
        m, a = m / sizes[:, None], a / sizes[:, None]
    raise ValueError(_singular(n - rank, n, independent))


def _singular(n_constraints: int, index: int, sizes: Any) -> str:
    return (
        f"the pencil is singular, det(λM − A) = 0 for all λ: after {index} differentiations {n_constraints} equations without y′ "
        f"depend on each other (singular values from {sizes[0]:.1e} to {sizes[-1]:.1e}), so that some variable is not determined"
    )
