"""Implicit Runge-Kutta methods for y′ = f(t, y) and F(t, y, y′) = 0: all stages and all variables solved together.

    F(t + c_i h, y + h Σ_j β_ij K_j, K_i) = 0,  i = 1 … s        K_i are the slopes of the stages
    y₁ = y + h Σ_i w_i K_i                                       or the last stage, where the two are the same

The equations are solved to rounding and the increments are added with a compensated sum (W. Kahan, Commun. ACM 8, 40
(1965)), so that symplectic methods keep quadratic invariants over millions of steps. Collocation methods follow from
their nodes alone: β_ij = ∫₀^{c_i} ℓ_j and w_j = ∫₀¹ ℓ_j with the Lagrange polynomials ℓ_j of the nodes.
E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems by Runge-Kutta Methods (1989);
E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.polynomial.legendre import Legendre
from numpy.typing import ArrayLike

from minimd.core.console.words import shown
from minimd.core.integrators.method import ClassProperty, Method, Problem, Step
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count, checked_numbers
from minimd.core.structure.errors import ConvergenceError
from minimd.textbook.ode.functions import forward_differences
from minimd.textbook.ode.problems import DifferentialAlgebraic, FirstOrder

__all__ = [
    "GaussLegendre1",
    "GaussLegendre2",
    "GaussLegendre3",
    "GaussLegendre4",
    "ImplicitEuler",
    "RadauIIA2",
    "RadauIIA3",
    "RungeKutta",
    "Tableau",
    "collocation",
    "gauss",
    "radau_iia",
]

FARTHEST = 3.0  # times the last step: how far its slopes are extrapolated at most
TABLEAU_ROUNDING = 1e-13  # of sums of a few products of coefficients of order one
MOST_STAGES = 64  # of a tableau whose numbers are not all rounding
HIGHEST_ORDER = 10  # conditions are evaluated up to this order
# factor of rounding per level, for steps of some hundredth of the time in which the solution varies
AMPLIFIED = 3e1
# of the state: a millionth of its rounding, too small to change even a compensated sum
UNSEEN = 1e-22
# smallest size of a variable relative to the largest one, so that no size is zero
VANISHING = 1e-30


class Tableau(NamedTuple):
    """Coefficients of a Runge-Kutta method with s stages.

    beta : (s, s).
    weights, nodes : (s,).  All dimensionless; Σ_j β_ij = c_i."""

    beta: Array
    weights: Array
    nodes: Array

    @property
    def symplecticity_defect(self) -> Array:
        """M_ij = w_i β_ij + w_j β_ji − w_i w_j, zero for symplectic methods; they keep every quadratic invariant.

        J. M. Sanz-Serna, BIT 28, 877 (1988); F. M. Lasagni (1988); Y. B. Suris (1989)."""
        product = self.weights[:, None] * self.beta
        return product + product.T - np.outer(self.weights, self.weights)

    @property
    def is_symplectic(self) -> bool:
        """Whether M = 0, to rounding."""
        return _vanishes(self.symplecticity_defect)

    @property
    def is_symmetric(self) -> bool:
        """Whether β_{s+1−i,s+1−j} + β_ij = w_j: the method is its own adjoint (stages in order of their nodes)."""
        return _vanishes(self.beta[::-1, ::-1] + self.beta - self.weights)

    @property
    def is_stiffly_accurate(self) -> bool:
        """Whether the last stage is the new state."""
        return _vanishes(self.beta[-1] - self.weights)

    @property
    def is_explicit(self) -> bool:
        """Whether each stage follows from those before it."""
        return not np.triu(self.beta).any()

    @property
    def stage_order(self) -> int:
        """Largest η for which C(η) holds, see order: the order of the stages."""
        c = self.nodes[:, None]
        k = np.arange(1, HIGHEST_ORDER + 1)
        return _n_held(self.beta @ c ** (k - 1) - c**k / k)

    @property
    def order(self) -> int:
        """Largest p whose simplifying assumptions B(p), C(η), D(ζ) with p ≤ η + ζ + 1 and p ≤ 2η + 2 hold (Butcher
        1964): a lower bound of the order.

        B(p): Σ w_i c_iᵏ⁻¹ = 1/k;  C(η): Σ_j β_ij c_jᵏ⁻¹ = c_iᵏ/k;  D(ζ): Σ_i w_i c_iᵏ⁻¹ β_ij = w_j (1 − c_jᵏ)/k."""
        w = self.weights
        c = self.nodes
        k = np.arange(1, HIGHEST_ORDER + 1)
        powers = c[:, None] ** (k - 1)
        b = _n_held([w @ powers - 1.0 / k])
        eta = self.stage_order
        column = k[:, None]
        d = (w[:, None] * powers).T @ self.beta - w * (1.0 - c**column) / column
        return min(b, eta + _n_held(d.T) + 1, 2 * eta + 2)


def _vanishes(defects: Array) -> bool:
    return bool(np.abs(defects).max() < TABLEAU_ROUNDING)


def _n_held(defects: ArrayLike) -> int:
    """How many conditions, one for each column of defects, hold before the first that fails."""
    fails = np.abs(defects).max(axis=0) > TABLEAU_ROUNDING
    return int(np.argmax(fails)) if fails.any() else fails.size


def collocation(nodes: ArrayLike) -> Tableau:
    """The collocation method on s different nodes, (s,), in units of the step.
    Raises ValueError for anything but a sequence of different, finite numbers, at least one."""
    c = checked_numbers("nodes", nodes, "a sequence of numbers")
    if c.ndim != 1 or np.unique(c).size != c.size or c.size == 0 or not np.isfinite(c).all():
        raise ValueError(
            f"nodes must be a sequence of different, finite numbers, at least one; nodes = {shown(nodes)}"
        )
    beta = np.array([_lagrange_integrals(c, node) for node in c])
    return Tableau(beta, _lagrange_integrals(c, 1.0), c)


def gauss(n_stages: int) -> Tableau:
    """Gauss-Legendre nodes, the zeros of P_s(2c − 1): order 2s, symplectic and symmetric.

    J. C. Butcher, Math. Comput. 18, 50 (1964).
    Raises ValueError for a number of stages below 1 or too large."""
    n_stages = checked_count("n_stages", n_stages, limit=MOST_STAGES)
    rounded = collocation((1.0 + np.polynomial.legendre.leggauss(n_stages)[0]) / 2.0)
    # else invariants drift with the rounding of M
    beta = rounded.beta - rounded.symplecticity_defect / (2.0 * rounded.weights[:, None])
    return Tableau(beta, rounded.weights, rounded.nodes)


def radau_iia(n_stages: int) -> Tableau:
    """Radau nodes with c_s = 1, the zeros of P_s(2c − 1) − P_{s−1}(2c − 1): order 2s − 1, stiffly accurate.

    B. L. Ehle (1969); E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5."""
    n_stages = checked_count("n_stages", n_stages, limit=MOST_STAGES)
    inner = (Legendre.basis(n_stages) - Legendre.basis(n_stages - 1)).roots()
    return collocation([*(1.0 + np.sort(np.real(inner))[:-1]) / 2.0, 1.0])


def _lagrange_integrals(nodes: Array, end: float) -> Array:
    """∫₀^end ℓ_j for all j, by a Gauss quadrature that is exact for them; ℓ_j is one on node j, zero on the others."""
    x, w = np.polynomial.legendre.leggauss(nodes.size)
    x = end * (1.0 + x) / 2.0
    w = end * w / 2.0
    distances = nodes[:, None] - nodes
    np.fill_diagonal(distances, 1.0)
    # of ℓ_j at x_k, for [k, j]
    factors = (x[:, None, None] - nodes) / distances
    factors[:, np.eye(nodes.size, dtype=bool)] = 1.0
    return w @ factors.prod(axis=2)


class RungeKutta(Method):
    """An implicit Runge-Kutta method, given by its tableau, from which order, symmetry and symplecticity follow."""

    tableau: ClassVar[Tableau]
    is_explicit = False
    order = ClassProperty(lambda method: method.tableau.order)
    stages = ClassProperty(lambda method: method.tableau.nodes.size)
    is_symmetric = ClassProperty(lambda method: method.tableau.is_symmetric)
    is_symplectic: ClassVar[Any] = ClassProperty(lambda method: method.tableau.is_symplectic)

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """The step on any problem; those of index 3 need a method whose last stage is the next state.
        Raises TypeError for Gauss-Legendre methods on problems of index 3, where errors of the multipliers do not
        shrink with the time step; and for a tableau with equal nodes, as explicit methods have them."""
        index = problem.index if isinstance(problem, DifferentialAlgebraic) else 0
        if index > 2 and not cls.tableau.is_stiffly_accurate:
            raise TypeError(
                f"{cls.name} does not converge on problems of index {index}, whose multipliers stay wrong "
                "however short the steps; take RadauIIA3 or BDF3, or a Holonomic problem with a splitting"
            )
        nodes = cls.tableau.nodes.tolist()
        if len(set(nodes)) < len(nodes):
            raise TypeError(
                f"{cls.name} has equal nodes, {nodes}, and implicit methods must have different ones; for explicit "
                "Runge-Kutta methods use scipy.integrate.solve_ivp"
            )
        return StageStep(problem, cls.tableau)

    @classmethod
    def order_on(cls, problem: Problem) -> int:
        """Order of the error estimate: that of algebraic variables, weighted as in error_weights, where it is lower."""
        if not isinstance(problem, DifferentialAlgebraic):
            return cls.order
        tableau = cls.tableau
        is_full = problem.index <= 1 and tableau.is_stiffly_accurate
        return tableau.order if is_full else tableau.stage_order


class StageEquations:
    """The equations of the stages of an implicit step, for all stages and all variables together.

        F(t_i, b_i + h Σ_j β_ij K_j, K_i) = 0,  i = 1 … s             unknown are the slopes K
        ∂/∂K_j = δ_ij F_y′ + h β_ij F_y                              of stage i

    F is the residual of the problem. Slopes are found to the rounding of h K, which they add to the state, in each
    variable separately. In variables of index 2 and 3 rounding is amplified by 1/h and 1/h² (E. Hairer, G. Wanner,
    Solving ODEs II (1996), VII.4).
    nfev : number of evaluations of the right-hand side."""

    def __init__(self, problem: Problem) -> None:
        self.nfev = 0
        self._problem = problem
        self._iteration = problem.solver.iteration()

    def slopes(self, times: Array, base: Array, weights: Array, guess: Array, h: float) -> Array:
        """(s, n) K with F(t_i, b_i + Σ_j weights_ij K_j, K_i) = 0.
        Raises ConvergenceError with the largest residual.
        times : (s,).
        base : (n,) b, the same for all stages.
        weights : (s, s) h β.
        guess : (s, n).
        h : [time]."""

        n = base.size

        def stages(unknowns: Array) -> Iterator[tuple[float, Array, Array]]:
            k = unknowns.reshape(guess.shape)
            return zip(times, base + weights @ k, k, strict=True)

        def residual(unknowns: Array) -> Array:
            return np.concatenate([self._residual(*stage) for stage in stages(unknowns)])

        def jacobian(unknowns: Array) -> Array:
            matrix = np.empty((unknowns.size, unknowns.size))

            for i, stage in enumerate(stages(unknowns)):
                own = slice(i * n, (i + 1) * n)
                of_state, of_slope = self._jacobians(*stage)
                matrix[own] = np.kron(weights[i], of_state)
                matrix[own, own] += of_slope

            return matrix

        key = (h, *weights[0])
        sizes = self._sizes(base, guess, h)
        slopes = self._iteration.solve(residual, guess.reshape(-1), jacobian, key, *sizes)
        return slopes.reshape(guess.shape)

    def _residual(self, t: float, y: Array, slope: Array) -> Array:
        self.nfev += 1
        return self._problem.residual(t, y, slope)

    def _jacobians(self, t: float, y: Array, slope: Array) -> tuple[Array, Array]:
        """F_y and F_y′."""
        problem = self._problem
        if isinstance(problem, DifferentialAlgebraic):
            self.nfev += y.size
            return problem.state_jacobian(t, y, slope), problem.slope_jacobian(t, y, slope)
        if isinstance(problem, FirstOrder) and problem.jacobian is not None:
            of_state = -np.asarray(problem.jacobian(t, y), dtype=float)
        else:
            at_y = self._residual(t, y, slope)
            of_state = forward_differences(lambda x: self._residual(t, x, slope), y, at_y)
        return of_state, np.eye(y.size)

    def _sizes(
        self, base: Array, guess: Array, h: float
    ) -> tuple[Array | float, Array | float, float]:
        """scale, floor and nothing of Iteration.solve.
        Explicit problems: the slopes are compared with the state over h once they no longer shrink, because at rest
        slopes vanish and the state does not. Differential-algebraic ones: each variable has its own size; corrections
        of algebraic variables that no longer shrink are rounding if the others are solved for."""
        problem = self._problem
        length = abs(h)
        if not isinstance(problem, DifferentialAlgebraic):
            largest = np.abs(base).max()
            return 0.0, largest / length, UNSEEN * largest / length
        levels = problem.levels
        sizes = np.maximum(np.abs(base), np.abs(h * guess).max(axis=0))
        scale = np.maximum(sizes, VANISHING * sizes.max()) * AMPLIFIED**levels / length
        floor = np.where(levels > 0, np.inf, sizes[levels == 0].max(initial=0.0) / length)
        return np.tile(scale, len(guess)), np.tile(floor, len(guess)), 0.0


class StageStep(StageEquations):
    """One step with a tableau. The slopes of a step, extrapolated as a polynomial, are the first guess for the next."""

    def __init__(self, problem: Problem, tableau: Tableau) -> None:
        super().__init__(problem)
        self._tableau = tableau
        # of the polynomial through values at the nodes
        self._coefficients = np.linalg.inv(np.vander(tableau.nodes))
        self._state: Array | None = None  # the last one
        self._rounding: Array | float = 0.0  # its error
        # time, length and slopes of the last step
        self._last: tuple[float, float, Array] | None = None

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        slopes = self._all_slopes(t, y, h)
        rounding = self._rounding if self._state is y else 0.0
        increment = h * (self._tableau.weights @ slopes) + rounding
        y_new = y + increment
        self._state = y_new
        self._rounding = increment - (y_new - y)
        self._last = (t, h, slopes)
        return y_new

    def _all_slopes(self, t: float, y: Array, h: float) -> Array:
        """(s, n) slopes; the guess is the polynomial through the last ones, or y′ if that is far or fails."""
        offsets = self._tableau.nodes * h
        times = t + offsets
        weights = h * self._tableau.beta
        if self._last is not None:
            t_last, h_last, slopes = self._last
            nodes = (t - t_last + offsets) / h_last
            if nodes.min() >= -1.0 and nodes.max() <= FARTHEST:
                guess = np.vander(nodes) @ (self._coefficients @ slopes)
                with suppress(ConvergenceError):
                    return self.slopes(times, y, weights, guess, h)
        guess = np.tile(self._problem.field(t, y), (times.size, 1))
        return self.slopes(times, y, weights, guess, h)


class GaussLegendre(RungeKutta):
    """Collocation on Gauss-Legendre nodes."""

    source = "J. C. Butcher, Math. Comput. 18, 50 (1964)"


class GaussLegendre1(GaussLegendre):
    """Gauss-Legendre with one stage, the implicit midpoint rule: order 2, symplectic, symmetric."""

    name = "gauss-legendre-1"
    tableau = gauss(1)


class GaussLegendre2(GaussLegendre):
    """Gauss-Legendre with two stages: order 4, symplectic, symmetric."""

    name = "gauss-legendre-2"
    tableau = gauss(2)


class GaussLegendre3(GaussLegendre):
    """Gauss-Legendre with three stages: order 6, symplectic, symmetric."""

    name = "gauss-legendre-3"
    tableau = gauss(3)


class GaussLegendre4(GaussLegendre):
    """Gauss-Legendre with four stages: order 8, symplectic, symmetric."""

    name = "gauss-legendre-4"
    tableau = gauss(4)


class ImplicitEuler(RungeKutta):
    """Implicit Euler, Radau IIA with one stage: order 1, stiffly accurate."""

    name = "implicit-euler"
    tableau = radau_iia(1)
    source = "E. Hairer, G. Wanner, Solving ODEs II (1996), IV.3"


class RadauIIA2(RungeKutta):
    """Radau IIA with two stages: order 3, stiffly accurate."""

    name = "radau-iia-2"
    tableau = radau_iia(2)
    source = "B. L. Ehle (1969); E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5"


class RadauIIA3(RungeKutta):
    """Radau IIA with three stages: order 5, stiffly accurate."""

    name = "radau-iia-3"
    tableau = radau_iia(3)
    source = RadauIIA2.source
