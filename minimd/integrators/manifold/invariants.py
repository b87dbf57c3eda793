"""Invariants g(y), which the exact flow keeps, the manifold that they define, and its stabilization.

    y′ = f(t, y) − γ F(y) (g(y) − g₀)         F = D (G D)⁻¹,  D = Gᵀ,  G = ∂g/∂y

On the manifold g = g₀ nothing is changed; away from it g − g₀ decays like e^(−γt), whatever f does along the manifold.
U. M. Ascher, H. Chin, S. Reich, Numer. Math. 67, 131 (1994); U. M. Ascher, L. R. Petzold, Computer Methods for Ordinary
Differential Equations and Differential-Algebraic Equations (1998), 9.2. Projections are in projection.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.console.words import shown
from minimd.integrators.method import Array, Problem
from minimd.integrators.ode.functions import Field, Function, accurate_differences, argument_names
from minimd.integrators.ode.partitioned import Partitioned
from minimd.integrators.ode.problems import FirstOrder
from minimd.structure.checks import checked_number
from minimd.structure.errors import ConvergenceError

__all__ = ["Invariants", "stabilized"]

Shape = tuple[int, ...] | None
PARALLEL = 1e-8  # sine of the angle between a gradient and the span of the others below which they count as dependent


class Invariants:
    """m quantities that are constant along solutions.

    Parameters
    ----------
    g : function of y, or of q and v (or of one of them), in the shape of the start; a number or an array of m numbers.
    jacobian : G = ∂g/∂y as a function of the same, m × (size of y) numbers in any shape; q and v are concatenated to y.
        By differences of order 6 if not given.
    value : (m,) numbers to be kept; g of the start if not given.

    Raises
    ------
    TypeError : for anything but functions, or arguments other than y, q, v.
    """

    def __init__(self, g: Function, jacobian: Function | None = None, value: ArrayLike | None = None) -> None:
        self.g = _of_state(g, "g")
        self.jacobian = jacobian if jacobian is None else _of_state(jacobian, "jacobian")
        self.value = value if value is None else np.array(value, dtype=float).reshape(-1)

    def through(self, y: Array, shape: Shape = None) -> Manifold:
        """The manifold g = value, or g = g(y) if no value was given.

        y : (n,) state.  shape : of q and v, None for problems without them.
        Raises ValueError if the numbers of values, derivatives and unknowns do not fit, or values are not finite.
        """
        return Manifold(self, y, shape)


class Manifold:
    """{y : g(y) = value}. value : (m,).  Arguments and errors : see Invariants.through."""

    def __init__(self, invariants: Invariants, y: Array, shape: Shape) -> None:
        answer, given = invariants.g(y, shape), invariants.jacobian
        self.value = answer if invariants.value is None else invariants.value
        self._invariants, self._shape = invariants, shape
        if answer.size != self.value.size:
            raise ValueError(
                f"value must have one number per invariant; g has {answer.size}, value has {self.value.size}"
            )
        if not 0 < answer.size < y.size:
            raise ValueError(
                f"there must be fewer invariants than unknowns, and at least one; got {answer.size} of {y.size}"
            )
        if not (np.isfinite(answer).all() and np.isfinite(self.value).all()):
            raise ValueError(
                f"g and its value must be finite at the start; g = {_shown(answer)}, value = {_shown(self.value)}"
            )
        if given is not None and (size := given(y, shape).size) != answer.size * y.size:
            raise ValueError(f"jacobian must have {answer.size} × {y.size} numbers, ∂g/∂y; got {size}")

    def defect(self, y: Array) -> Array:
        """(m,) g(y) − value."""
        return self._invariants.g(y, self._shape) - self.value

    def jacobian(self, y: Array) -> Array:
        """(m, n) G(y)."""
        if self._invariants.jacobian is None:
            return accurate_differences(self.defect, y)
        return self._invariants.jacobian(y, self._shape).reshape(self.value.size, y.size)

    def frame(self, y: Array) -> tuple[Array, Array]:
        """Gᵀ = Q R: (n, m) orthonormal directions Q that span the gradients, and upper triangular (m, m) R.

        Raises ConvergenceError where the gradients of the invariants are not independent.
        """
        gradients = self.jacobian(y).T
        q, r = np.linalg.qr(gradients)
        sines = np.abs(np.diagonal(r)) / np.maximum(np.linalg.norm(gradients, axis=0), np.finfo(float).tiny)
        if not np.all(sines > PARALLEL):
            k = int(np.argmin(sines > PARALLEL))
            raise ConvergenceError(f"invariant {k} is not independent: its gradient {_shown(gradients[:, k])} "
                                   "vanishes, or lies in the span of those "
                                   "before it; the Jacobian of invariants must have full rank")  # fmt: skip
        return q, r


def check_invariants(invariants: Invariants) -> None:
    """TypeError for anything but Invariants."""
    if not isinstance(invariants, Invariants):
        raise TypeError(f"invariants must be Invariants(g), with a function g(y) or g(q, v); got {shown(invariants)}")


Correction = Callable[[Array], Array]  # (n,) a term that is added to y′, of the state


def corrected(
    problem: Problem, correction: Correction, begin: Callable[[Array, Shape], None]
) -> CorrectedPartitioned | CorrectedFirstOrder:
    """A problem of the same kind with a term added to y′; one with q and v is then Partitioned, and its steps implicit.

    begin : called with the start of each run and the shape of q and v.  Raises TypeError for problems of other kinds.
    """
    if isinstance(problem, Partitioned):
        return CorrectedPartitioned(problem, correction, begin)
    if isinstance(problem, FirstOrder):
        return CorrectedFirstOrder(problem, correction, begin)
    raise TypeError(
        f"y′ can be corrected in SecondOrder, Partitioned and FirstOrder problems; got {type(problem).__name__}"
    )


class CorrectedPartitioned(Partitioned):
    """q′ = g + c_q, v′ = f + c_v with a correction c(q, v)."""

    def __init__(self, problem: Partitioned, correction: Correction, begin: Callable[[Array, Shape], None]) -> None:
        def of(q: Array, v: Array) -> Array:
            return correction(np.concatenate([q.reshape(-1), v.reshape(-1)]))

        g, f = (
            (lambda t, q, v: problem.g(t, q, v) + of(q, v)[: q.size]),
            (lambda t, q, v: problem.f(t, q, v) + of(q, v)[q.size :]),
        )
        super().__init__(g, f, solver=problem.solver)
        self._problem, self._correction, self._begin, self.shape = problem, correction, begin, problem.shape

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The start as a state of length 2n."""
        y = self._problem.begin(start)
        self.shape = self._problem.shape
        self._begin(y, self.shape)
        return y

    def field(self, t: float, y: Array) -> Array:
        """(g, f) of the problem, plus the correction."""
        return self._problem.field(t, y) + self._correction(y)


class CorrectedFirstOrder(FirstOrder):
    """y′ = f + c(y)."""

    def __init__(self, problem: FirstOrder, correction: Correction, begin: Callable[[Array, Shape], None]) -> None:
        super().__init__(lambda t, y: problem.field(t, y) + correction(y), solver=problem.solver)
        self._problem, self._begin = problem, begin

    def begin(self, start: ArrayLike, t0: float = 0.0) -> Array:
        """The start as a state of length n."""
        y = self._problem.begin(start)
        self._begin(y, None)
        return y


def stabilized(problem: Problem, invariants: Invariants, gamma: float) -> CorrectedPartitioned | CorrectedFirstOrder:
    """The problem y′ = f − γ Gᵀ (G Gᵀ)⁻¹ (g − g₀), for any method: its solutions approach the manifold g = g₀.

    For one invariant, such as the energy, it reads y′ = f − γ (H − H₀) ∇H / |∇H|². Distances are those of y: choose
    units in which its components have similar sizes. A problem with q and v becomes Partitioned, and its steps
    implicit. Far from the manifold give the Jacobian of the invariants in closed form: y′ contains the noise of
    differences, 1e-13, with which implicit steps may not be solved.

    Parameters
    ----------
    problem : SecondOrder, Partitioned or FirstOrder.
    gamma : rate γ at which g − g₀ decays [1/time], positive; γΔt should be at most about one.

    Raises
    ------
    ValueError : if γ is not positive and finite.  TypeError : for problems of other kinds.
    ConvergenceError : from a run, where the gradients of the invariants are not independent.
    """
    check_invariants(invariants)
    checked_number("gamma", gamma, "positive and finite")
    manifold: Manifold

    def begin(y: Array, shape: Shape) -> None:
        nonlocal manifold
        manifold = invariants.through(y, shape)

    def correction(y: Array) -> Array:
        """−γ Gᵀ (G Gᵀ)⁻¹ (g − g₀) = −γ Q R⁻ᵀ (g − g₀)."""
        defect = manifold.defect(y)
        if not defect.any():
            return np.zeros(y.size)
        q, r = manifold.frame(y)
        return -float(gamma) * (q @ np.linalg.solve(r.T, defect))

    return corrected(problem, correction, begin)


def _of_state(function: Function, name: str) -> Callable[[Array, Shape], Array]:
    """The function as one of the state and the shape of q and v, with fresh flat answers."""
    if argument_names(function, name, "a function of y, or of q and v") in (["y"], None):
        return lambda y, shape: np.array(function(y), dtype=float).reshape(-1)
    field = Field(function, "qv", name)
    if "t" in field.takes:
        raise TypeError(f"{name} must not depend on t; invariants are functions of y, or of q and v")

    def of_halves(y: Array, shape: Shape) -> Array:
        if shape is None:
            raise TypeError(f"{name} takes q and v, but the problem has none; write it as a function of y")
        n = y.size // 2
        return field(0.0, y[:n].reshape(shape), y[n:].reshape(shape))

    return of_halves


def _shown(numbers: Array) -> str:
    return np.array2string(np.asarray(numbers), precision=3, threshold=8)
