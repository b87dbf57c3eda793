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

from minimd.integrators.method import Answer, Method, Step
from minimd.integrators.problems import Problem
from minimd.integrators.tableau import Tableau, gauss, radau_iia

Array = NDArray[np.float64]


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
        """The step on any problem."""
        return StageStep(problem, cls.tableau)


class StageStep:
    """One step with a tableau. The slopes of a step are the first guess for the next."""

    def __init__(self, problem: Problem, tableau: Tableau) -> None:
        self.nfev = 0
        self._problem, self._tableau = problem, tableau
        self._iteration = problem.solver.iteration()
        self._known: tuple[Array | None, Array | None, Array | float] = None, None, 0.0  # last state, its slopes, what rounding took from it

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        tableau, n_stages = self._tableau, self._tableau.nodes.size
        known, guess, lost = self._known
        if known is not y:
            guess, lost = None, 0.0
        if guess is None:
            guess = np.tile(self._problem.field(t, y), n_stages)
        slopes = self._solved(t, y, h, guess)
        stages = slopes.reshape(n_stages, -1)
        increment = h * (tableau.weights @ stages) + lost
        y_new = y + increment
        self._known = y_new, slopes, increment - (y_new - y)
        return y_new

    def _solved(self, t: float, y: Array, h: float, guess: Array) -> Array:
        """Slopes of all stages, one after the other."""
        times, beta = t + self._tableau.nodes * h, self._tableau.beta

        def residual(slopes: Array) -> Array:
            k = slopes.reshape(times.size, -1)
            stages = y + h * (beta @ k)
            self.nfev += times.size
            return np.concatenate([self._problem.residual(*stage) for stage in zip(times, stages, k, strict=True)])

        return self._iteration.solve(residual, guess, key=h)


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
