"""Implicit Runge-Kutta methods for y′ = f(t, y) and F(t, y, y′) = 0: all stages and all variables solved together.

    F(t + c_i h, y + h Σ_j β_ij K_j, K_i) = 0,  i = 1 … s        K_i are the slopes of the stages
    y₁ = y + h Σ_i w_i K_i                                       or the last stage, where the two are the same

The equations are solved to rounding and the increments are added with a compensated sum (W. Kahan, Commun. ACM 8, 40 (1965)),
so that what a method keeps, invariants of symplectic ones above all, it keeps over millions of steps.
E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems by Runge-Kutta Methods (1989).
"""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.integrators.dae.problem import DifferentialAlgebraic
from minimd.integrators.method import Answer, Method, Step
from minimd.integrators.ode.problems import Problem
from minimd.integrators.ode.stages import StageEquations
from minimd.integrators.ode.tableau import TABLEAU_ROUNDING, Tableau, gauss, radau_iia
from minimd.structure.errors import ConvergenceError

Array = NDArray[np.float64]
FARTHEST = 3.0  # lengths of the last step to which its slopes are continued


class RungeKutta(Method):
    """An implicit Runge-Kutta method, given by its tableau.

    Attributes of each method
    -------------------------
    tableau : Tableau. Order, symmetry and symplecticity are computed from it.
    """

    tableau: ClassVar[Tableau]
    is_explicit = False
    order = Answer(lambda method: method.tableau.order)
    stages = Answer(lambda method: method.tableau.nodes.size)
    is_symmetric = Answer(lambda method: method.tableau.is_symmetric)
    is_symplectic: ClassVar[Any] = Answer(lambda method: method.tableau.is_symplectic)

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """The step on any problem; one of index 3 needs a method whose last stage is the next state.

        Raises
        ------
        TypeError : for Gauss-Legendre methods on problems of index 3, whose multipliers they leave off by order 1 at any time step.
        """
        if isinstance(problem, DifferentialAlgebraic) and problem.index > 2 and not cls.tableau.is_stiffly_accurate:
            raise TypeError(f"{cls.name} does not converge on problems of index {problem.index}, whose multipliers stay wrong however short "
                            "the steps; take RadauIIA3 or BDF3, or a Holonomic problem with a splitting")  # fmt: skip
        return StageStep(problem, cls.tableau)

    @classmethod
    def order_on(cls, problem: Problem) -> int:
        """Order of the error estimate: where algebraic variables are less accurate it is theirs, those of index 2 and 3 weighted by h and h²."""
        if not isinstance(problem, DifferentialAlgebraic) or (problem.index <= 1 and cls.tableau.is_stiffly_accurate):
            return cls.order
        return _stage_order(cls.tableau)


def _stage_order(tableau: Tableau) -> int:
    """Largest η with Σ_j β_ij c_jᵏ⁻¹ = c_iᵏ/k for k = 1 … η."""
    c, eta = tableau.nodes, 0
    while eta < c.size and np.abs(tableau.beta @ c**eta - c ** (eta + 1) / (eta + 1)).max() < TABLEAU_ROUNDING:
        eta += 1
    return eta


class StageStep:
    """One step with a tableau. The slopes of a step, continued as a polynomial, are the first guess for the next."""

    def __init__(self, problem: Problem, tableau: Tableau) -> None:
        self._problem, self._tableau = problem, tableau
        self._equations = StageEquations(problem)
        self._coefficients = np.linalg.inv(np.vander(tableau.nodes))  # of the polynomial through values at the nodes
        self._known: tuple[Array | None, Array | float] = None, 0.0  # last state, and what rounding took from it
        self._last: tuple[float, float, Array] | None = None  # time, length and slopes of the last step

    @property
    def nfev(self) -> int:
        """Evaluations of the right-hand side."""
        return self._equations.nfev

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        known, lost = self._known
        slopes = self._slopes(t, y, h)
        increment = h * (self._tableau.weights @ slopes) + (lost if known is y else 0.0)
        y_new = y + increment
        self._known, self._last = (y_new, increment - (y_new - y)), (t, h, slopes)
        return y_new

    def _slopes(self, t: float, y: Array, h: float) -> Array:
        """(s, n) slopes of all stages; begun anew from the field if what was known misleads."""
        tableau = self._tableau
        times, weights = t + tableau.nodes * h, h * tableau.beta
        guess = self._continued(t, h)
        if guess is not None:
            try:
                return self._equations.slopes(times, y, weights, guess, h)
            except ConvergenceError:
                pass
        return self._equations.slopes(times, y, weights, np.tile(self._problem.field(t, y), (times.size, 1)), h)

    def _continued(self, t: float, h: float) -> Array | None:
        """The slopes of the last step as a polynomial, at the stages of this one; none if that is far."""
        if self._last is None:
            return None
        t_last, h_last, slopes = self._last
        nodes = (t - t_last + self._tableau.nodes * h) / h_last
        if nodes.min() < -1.0 or nodes.max() > FARTHEST:
            return None
        return np.vander(nodes, len(slopes)) @ (self._coefficients @ slopes)


class GaussLegendre1(RungeKutta):
    """Gauss-Legendre with one stage, the implicit midpoint rule: order 2, symplectic, symmetric."""

    name, tableau = "gauss-legendre-1", gauss(1)
    source = "J. C. Butcher, Math. Comput. 18, 50 (1964)"


class GaussLegendre2(RungeKutta):
    """Gauss-Legendre with two stages: order 4, symplectic, symmetric."""

    name, tableau = "gauss-legendre-2", gauss(2)
    source = "J. C. Butcher, Math. Comput. 18, 50 (1964)"


class GaussLegendre3(RungeKutta):
    """Gauss-Legendre with three stages: order 6, symplectic, symmetric."""

    name, tableau = "gauss-legendre-3", gauss(3)
    source = "J. C. Butcher, Math. Comput. 18, 50 (1964)"


class GaussLegendre4(RungeKutta):
    """Gauss-Legendre with four stages: order 8, symplectic, symmetric."""

    name, tableau = "gauss-legendre-4", gauss(4)
    source = "J. C. Butcher, Math. Comput. 18, 50 (1964)"


class ImplicitEuler(RungeKutta):
    """Implicit Euler, Radau IIA with one stage: order 1, stiffly accurate."""

    name, tableau = "implicit-euler", radau_iia(1)
    source = "E. Hairer, G. Wanner, Solving ODEs II (1996), IV.3"


class RadauIIA2(RungeKutta):
    """Radau IIA with two stages: order 3, stiffly accurate."""

    name, tableau = "radau-iia-2", radau_iia(2)
    source = "B. L. Ehle (1969); E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5"


class RadauIIA3(RungeKutta):
    """Radau IIA with three stages: order 5, stiffly accurate."""

    name, tableau = "radau-iia-3", radau_iia(3)
    source = "B. L. Ehle (1969); E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5"
