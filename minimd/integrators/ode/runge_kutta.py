"""Implicit Runge-Kutta methods for y′ = f(t, y) and F(t, y, y′) = 0: all stages and all variables solved together.

    F(t + c_i h, y + h Σ_j β_ij K_j, K_i) = 0,  i = 1 … s        K_i are the slopes of the stages
    y₁ = y + h Σ_i w_i K_i                                       or the last stage, where the two are the same

The equations are solved to rounding and the increments are added with a compensated sum (W. Kahan, Commun. ACM 8, 40 (1965)),
so that symplectic methods keep quadratic invariants over millions of steps.
E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems by Runge-Kutta Methods (1989).
"""

from typing import Any, ClassVar

import numpy as np

from minimd.integrators.method import Array, ClassProperty, Method, Problem, Step
from minimd.integrators.ode.problems import DifferentialAlgebraic
from minimd.integrators.ode.stages import StageEquations
from minimd.integrators.ode.tableau import TABLEAU_ROUNDING, Tableau, gauss, radau_iia
from minimd.structure.errors import ConvergenceError

__all__ = ["GaussLegendre1", "GaussLegendre2", "GaussLegendre3", "GaussLegendre4", "ImplicitEuler", "RadauIIA2", "RadauIIA3", "RungeKutta"]

FARTHEST = 3.0  # times the last step: how far its slopes are extrapolated at most


class RungeKutta(Method):
    """An implicit Runge-Kutta method, given by its tableau.

    Attributes of each method
    -------------------------
    tableau : Tableau. Order, symmetry and symplecticity are computed from it.
    """

    tableau: ClassVar[Tableau]
    is_explicit = False
    order = ClassProperty(lambda method: method.tableau.order)
    stages = ClassProperty(lambda method: method.tableau.nodes.size)
    is_symmetric = ClassProperty(lambda method: method.tableau.is_symmetric)
    is_symplectic: ClassVar[Any] = ClassProperty(lambda method: method.tableau.is_symplectic)

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """The step on any problem; those of index 3 need a method whose last stage is the next state.

        Raises
        ------
        TypeError : for Gauss-Legendre methods on problems of index 3, where errors of the multipliers do not shrink with the time step.
        """
        if isinstance(problem, DifferentialAlgebraic) and problem.index > 2 and not cls.tableau.is_stiffly_accurate:
            raise TypeError(f"{cls.name} does not converge on problems of index {problem.index}, whose multipliers stay wrong however short "
                            "the steps; take RadauIIA3 or BDF3, or a Holonomic problem with a splitting")  # fmt: skip
        return StageStep(problem, cls.tableau)

    @classmethod
    def order_on(cls, problem: Problem) -> int:
        """Order of the error estimate: that of algebraic variables, weighted by h for index 2 and h² for index 3, where it is lower."""
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
    """One step with a tableau. The slopes of a step, extrapolated as a polynomial, are the first guess for the next."""

    def __init__(self, problem: Problem, tableau: Tableau) -> None:
        self._problem, self._tableau = problem, tableau
        self._equations = StageEquations(problem)
        self._coefficients = np.linalg.inv(np.vander(tableau.nodes))  # of the polynomial through values at the nodes
        self._known: tuple[Array | None, Array | float] = None, 0.0  # last state, and its rounding error
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
        """(s, n) slopes of all stages; from the guess y′ for all of them if there is no other, or if the other one fails."""
        tableau = self._tableau
        times, weights = t + tableau.nodes * h, h * tableau.beta
        guess = self._extrapolated(t, h)
        if guess is not None:
            try:
                return self._equations.slopes(times, y, weights, guess, h)
            except ConvergenceError:
                pass
        return self._equations.slopes(times, y, weights, np.tile(self._problem.field(t, y), (times.size, 1)), h)

    def _extrapolated(self, t: float, h: float) -> Array | None:
        """The slopes of the last step as a polynomial, at the stages of this one; None if these are far."""
        if self._last is None:
            return None
        t_last, h_last, slopes = self._last
        nodes = (t - t_last + self._tableau.nodes * h) / h_last
        if nodes.min() < -1.0 or nodes.max() > FARTHEST:
            return None
        return np.vander(nodes, len(slopes)) @ (self._coefficients @ slopes)


def _method(title: str, doc: str, name: str, tableau: Tableau, source: str) -> type[RungeKutta]:
    return type(title, (RungeKutta,), {"__doc__": doc, "name": name, "tableau": tableau, "source": source})


def _gauss_legendre(s: int, stages: str) -> type[RungeKutta]:
    doc = f"Gauss-Legendre with {stages}: order {2 * s}, symplectic, symmetric."
    return _method(f"GaussLegendre{s}", doc, f"gauss-legendre-{s}", gauss(s), "J. C. Butcher, Math. Comput. 18, 50 (1964)")


def _radau(s: int, stages: str) -> type[RungeKutta]:
    doc = f"Radau IIA with {stages}: order {2 * s - 1}, stiffly accurate."
    return _method(f"RadauIIA{s}", doc, f"radau-iia-{s}", radau_iia(s), "B. L. Ehle (1969); E. Hairer, G. Wanner, Solving ODEs II (1996), IV.5")


EULER = "Implicit Euler, Radau IIA with one stage: order 1, stiffly accurate."

GaussLegendre1 = _gauss_legendre(1, "one stage, the implicit midpoint rule")
GaussLegendre2 = _gauss_legendre(2, "two stages")
GaussLegendre3 = _gauss_legendre(3, "three stages")
GaussLegendre4 = _gauss_legendre(4, "four stages")
ImplicitEuler = _method("ImplicitEuler", EULER, "implicit-euler", radau_iia(1), "E. Hairer, G. Wanner, Solving ODEs II (1996), IV.3")
RadauIIA2 = _radau(2, "two stages")
RadauIIA3 = _radau(3, "three stages")
