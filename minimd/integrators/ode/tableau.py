"""Butcher tableaus: Runge-Kutta methods as data, and the properties that follow from them.

    Y_i = y + h Σ_j β_ij f(t + c_i h, Y_j)        y₁ = y + h Σ_i w_i f(t + c_i h, Y_i)

Collocation methods follow from their nodes alone: β_ij = ∫₀^{c_i} ℓ_j and w_j = ∫₀¹ ℓ_j with the Lagrange polynomials ℓ_j of
the nodes. E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import Legendre
from numpy.typing import ArrayLike

from minimd.integrators.method import Array

__all__ = ["Tableau", "collocation", "gauss", "radau_iia"]

TABLEAU_ROUNDING = 1e-13  # of sums of a few products of coefficients of order one
HIGHEST_ORDER = 10  # conditions are evaluated up to this order


@dataclass(frozen=True)
class Tableau:
    """Coefficients of a Runge-Kutta method with s stages.

    beta : (s, s).  weights, nodes : (s,).  All dimensionless; Σ_j β_ij = c_i.
    """

    beta: Array
    weights: Array
    nodes: Array

    @property
    def symplecticity_defect(self) -> Array:
        """M_ij = w_i β_ij + w_j β_ji − w_i w_j, zero for symplectic methods; they keep every quadratic invariant.

        J. M. Sanz-Serna, BIT 28, 877 (1988); F. M. Lasagni (1988); Y. B. Suris (1989).
        """
        product = self.weights[:, None] * self.beta
        return product + product.T - np.outer(self.weights, self.weights)

    @property
    def is_symplectic(self) -> bool:
        """Whether M = 0, to rounding."""
        return bool(np.abs(self.symplecticity_defect).max() < TABLEAU_ROUNDING)

    @property
    def is_symmetric(self) -> bool:
        """Whether β_{s+1−i,s+1−j} + β_ij = w_j: the method is its own adjoint (stages in rising order of their nodes)."""
        return bool(np.abs(self.beta[::-1, ::-1] + self.beta - self.weights).max() < TABLEAU_ROUNDING)

    @property
    def is_stiffly_accurate(self) -> bool:
        """Whether the last stage is the new state."""
        return bool(np.abs(self.beta[-1] - self.weights).max() < TABLEAU_ROUNDING)

    @property
    def is_explicit(self) -> bool:
        """Whether each stage follows from those before it."""
        return not np.triu(self.beta).any()

    @property
    def order(self) -> int:
        """Largest p whose simplifying assumptions B(p), C(η), D(ζ) with p ≤ η + ζ + 1 and p ≤ 2η + 2 hold (Butcher 1964): a lower bound of the order.

        B(p): Σ w_i c_iᵏ⁻¹ = 1/k;  C(η): Σ_j β_ij c_jᵏ⁻¹ = c_iᵏ/k;  D(ζ): Σ_i w_i c_iᵏ⁻¹ β_ij = w_j (1 − c_jᵏ)/k.
        """
        w, c, k = self.weights, self.nodes, np.arange(1, HIGHEST_ORDER + 1)
        powers = c[:, None] ** (k - 1)
        b = _first_failure(w @ powers - 1.0 / k)
        eta = _first_failure(self.beta @ powers - c[:, None] ** k / k)
        zeta = _first_failure((w[:, None] * powers).T @ self.beta - w * (1.0 - c ** k[:, None]) / k[:, None], axis=1)
        return min(b, eta + zeta + 1, 2 * eta + 2)


def _first_failure(defects: Array, axis: int = 0) -> int:
    """How many conditions hold before the first that fails; conditions along the last axis, or along the first if axis is 1."""
    worst = np.abs(np.atleast_2d(defects)).max(axis=axis)
    return int(np.argmax(worst > TABLEAU_ROUNDING)) if (worst > TABLEAU_ROUNDING).any() else worst.size


def collocation(nodes: ArrayLike) -> Tableau:
    """The collocation method on s different nodes, in units of the step."""
    c = np.array(nodes, dtype=float)
    return Tableau(np.array([_lagrange_integrals(c, node) for node in c]), _lagrange_integrals(c, 1.0), c)


def gauss(n_stages: int) -> Tableau:
    """Gauss-Legendre nodes, the zeros of P_s(2c − 1): order 2s, symplectic and symmetric.

    J. C. Butcher, Math. Comput. 18, 50 (1964).
    """
    if n_stages == 2:
        r = np.sqrt(3.0) / 6.0
        return Tableau(np.array([[0.25, 0.25 - r], [0.25 + r, 0.25]]), np.array([0.5, 0.5]), np.array([0.5 - r, 0.5 + r]))
    rounded = collocation((1.0 + np.polynomial.legendre.leggauss(n_stages)[0]) / 2.0)
    beta = rounded.beta - rounded.symplecticity_defect / (2.0 * rounded.weights[:, None])  # else invariants drift with the rounding of M
    return Tableau(beta, rounded.weights, rounded.nodes)


def radau_iia(n_stages: int) -> Tableau:
    """Radau nodes with c_s = 1, the zeros of P_s(2c − 1) − P_{s−1}(2c − 1): order 2s − 1, stiffly accurate.

    B. L. Ehle (1969); E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5.
    """
    inner = (Legendre.basis(n_stages) - Legendre.basis(n_stages - 1)).roots()
    nodes = (1.0 + np.sort(np.real(inner))) / 2.0
    nodes[-1] = 1.0
    return collocation(nodes)


def _lagrange_integrals(nodes: Array, end: float) -> Array:
    """∫₀^end ℓ_j for all j, by a Gauss quadrature that is exact for them; ℓ_j is one on node j and zero on the others."""
    x, w = np.polynomial.legendre.leggauss(nodes.size)
    x, w = end * (1.0 + x) / 2.0, end * w / 2.0
    factors = (x[:, None, None] - nodes) / np.where(np.eye(nodes.size, dtype=bool), 1.0, nodes[:, None] - nodes)  # of ℓ_j at x_k, for [k, j]
    factors[:, np.arange(nodes.size), np.arange(nodes.size)] = 1.0
    return w @ factors.prod(axis=2)
