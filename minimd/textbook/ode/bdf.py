"""Backward differentiation formulas: the polynomial through the last k states and the new one obeys the equation.

    F(t₁, y₁, K) = 0,      K = (1/h) Σ_{j=0}^{k} α_j y_{1−j},      α_j = ℓ_j′(t₁) h
    α = (1, −1)    (3/2, −2, 1/2)    (11/6, −3, 3/2, −1/3)    …                            for equal steps

The α follow from the times of the last states, so that a shortened last step has the order of the others. The first
k − 1 steps are made by Radau IIA with k stages, whose order is at least k in every variable that enters the formula.
Order k for problems of index 1 and 2, and of index 3 with equal steps after the first k + 1 (K. E. Brenan, S. L.
Campbell, L. R. Petzold, Numerical Solution of Initial-Value Problems in Differential-Algebraic Equations (1989), 3.2).
"""

from collections import deque
from typing import ClassVar

import numpy as np

from minimd.core.integrators.method import ClassProperty, Method, Problem, Step
from minimd.core.structure.arrays import Array
from minimd.textbook.ode.runge_kutta import StageEquations, StageStep, radau_iia

__all__ = ["BDF1", "BDF2", "BDF3", "BDF4", "BDF5"]


class BDF(Method):
    """A backward differentiation formula.

    With k ≥ 2 it is not a one-step method: run_steps and run_until can use it, run_adaptive cannot.
    n_past : number k of past states, and order; at most 5, because BDF6 is A(α)-stable only up to α = 18°."""

    n_past: ClassVar[int]
    source = (
        "C. F. Curtiss, J. O. Hirschfelder, Proc. Natl. Acad. Sci. 38, 235 (1952); C. W. Gear, IEEE Trans. "
        "Circuit Theory 18, 89 (1971)"
    )
    order = ClassProperty(lambda method: method.n_past)
    stages = 1
    is_symmetric = is_symplectic = is_explicit = False

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """The step on any problem."""
        return BDFStep(problem, cls.n_past)


class BDFStep:
    """One step, which must continue from the state that the last one returned."""

    def __init__(self, problem: Problem, k: int) -> None:
        self._k = k
        self._problem = problem
        self._equations = StageEquations(problem)
        self._start = StageStep(problem, radau_iia(k))
        self._states: deque[Array] = deque(maxlen=k)  # the newest first
        self._steps: deque[float] = deque(maxlen=k - 1)  # lengths of the steps between them
        self._slope: Array | None = None

    @property
    def nfev(self) -> int:
        """Evaluations of the right-hand side."""
        return self._start.nfev + self._equations.nfev

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h).
        Raises TypeError if y is not the last state, and k > 1."""
        if not self._states or self._k == 1:
            self._states.appendleft(y)
        if self._states[0] is not y:
            raise TypeError(
                f"bdf-{self._k} uses the last {self._k} states of its path and cannot start anew at every step; "
                "step doubling, reversible steps and projections require that: use run_steps or run_until, or a "
                "one-step method such as RadauIIA3"
            )
        is_start = len(self._states) < self._k
        y_new = self._start(t, y, h) if is_start else self._next(t, y, h)
        self._states.appendleft(y_new)
        self._steps.appendleft(h)
        return y_new

    def _next(self, t: float, y: Array, h: float) -> Array:
        """The state that follows from the last k."""
        alpha = slope_weights(np.append(0.0, -np.cumsum([h, *self._steps])) / h)
        base = -(alpha[1:] @ np.array(self._states)) / alpha[0]
        weight = h / alpha[0]
        if self._slope is None:
            self._slope = self._problem.field(t, y)
        guess = self._slope.reshape(1, -1)
        times = np.array([t + h])
        self._slope = self._equations.slopes(times, base, np.array([[weight]]), guess, h)
        return base + weight * self._slope[0]


def slope_weights(nodes: Array) -> Array:
    """α_j with p′(x₀) = Σ α_j p(x_j) for every polynomial p of degree below the number of nodes.

    B. Fornberg, SIAM Rev. 40, 685 (1998): α_j = ℓ_j′(x₀) = Π_{i≠0,j} (x₀ − x_i) / Π_{i≠j} (x_j − x_i), and Σ α_j = 0.
    """
    distances = nodes[:, None] - nodes
    np.fill_diagonal(distances, 1.0)
    alpha = np.prod(distances[0]) / distances[0] / np.prod(distances, axis=1)
    alpha[0] = -alpha[1:].sum()
    return np.asarray(alpha)


class BDF1(BDF):
    """BDF with one step, implicit Euler: order 1."""

    name = "bdf-1"
    n_past = 1


class BDF2(BDF):
    """BDF with two steps: order 2."""

    name = "bdf-2"
    n_past = 2


class BDF3(BDF):
    """BDF with three steps: order 3."""

    name = "bdf-3"
    n_past = 3


class BDF4(BDF):
    """BDF with four steps: order 4."""

    name = "bdf-4"
    n_past = 4


class BDF5(BDF):
    """BDF with five steps: order 5."""

    name = "bdf-5"
    n_past = 5
