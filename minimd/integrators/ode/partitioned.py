"""One step of a splitting on q′ = g(t, q, v), v′ = f(t, q, v): the same row of coefficients, explicit or implicit.

Separable problems, q′ = g(v) and v′ = f(t, q), are kicked and drifted. For all others the row is read as a product of the two
symplectic Euler methods, of which each solves one equation, and which are each other's adjoint:

    SE1   v₁ = v₀ + h f(t₀, q₀, v₁),   q₁ = q₀ + h g(t₀, q₀, v₁)
    SE2   q₁ = q₀ + h g(t₁, q₁, v₀),   v₁ = v₀ + h f(t₁, q₁, v₀)

    kick b₁, drift a₁, kick b₂, …  =  … SE1(b₂ − a₁ + b₁) ∘ SE2(a₁ − b₁) ∘ SE1(b₁)

Velocity Verlet becomes SE2(½) ∘ SE1(½), the generalized Störmer-Verlet method (A), position Verlet (B). Time is a position:
it moves with q. A row whose order p holds for all separable problems has the order p for all problems.
R. I. McLachlan, SIAM J. Sci. Comput. 16, 151 (1995); E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), III.3.3, VI.3.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel
from minimd.integrators.splitting.substeps import COEFFICIENT_ROUNDING, Kick, Substep, Substeps

if TYPE_CHECKING:
    from minimd.integrators.ode.problems import Field, Partitioned

Array = NDArray[np.float64]


@kernel
def push(x, duration, rate):
    """X += duration · rate.  (n,) arrays; [time]."""
    for k in range(x.size):
        x[k] += duration * rate[k]


class SequenceStep:
    """Kicks and drifts in turn; a force that the last step ended with is not computed again."""

    def __init__(self, problem: "Partitioned", row: Substeps) -> None:
        self.nfev = 0
        self._problem = problem
        self._row = [(isinstance(substep, Kick), substep.coefficient) for substep in row]
        self._drifts_with_v = problem.g_is_v
        self._known: tuple[Array | None, Array | None] = None, None

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        problem, n = self._problem, y.size // 2
        known, force = self._known
        if known is not y:
            force = None
        y = y.copy()
        q, v = y[:n], y[n:]
        q_shaped, v_shaped = (q, v) if len(problem.shape) == 1 else problem.halves(y)
        for is_kick, coefficient in self._row:
            duration = coefficient * h
            if is_kick:
                if force is None:
                    force = problem.f(t, q_shaped, v_shaped)
                    self.nfev += 1
                push(v, duration, force)
            else:
                push(q, duration, v if self._drifts_with_v else problem.g(t, q_shaped, v_shaped))
                t += duration
                force = None
        self._known = y, force
        return y


class EulerStep:
    """Symplectic Euler methods in turn; each implicit equation is solved to rounding, from its explicit guess."""

    def __init__(self, problem: "Partitioned", row: Substeps) -> None:
        self.nfev = 0
        self._problem = problem
        self._factors = [(kind, weight, problem.solver.iteration()) for kind, weight in euler_factors(row)]

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        problem, n = self._problem, y.size // 2
        q, v = y[:n].copy(), y[n:].copy()
        for kind, weight, iteration in self._factors:
            duration = weight * h
            if kind is Kick:
                v = self._solved(problem.f, problem.f_v, "v", (t, q, v), duration, iteration)
                q = q + duration * self._value(problem.g, t, q, v)
                t += duration
            else:
                t += duration
                q = self._solved(problem.g, problem.g_q, "q", (t, q, v), duration, iteration)
                v = v + duration * self._value(problem.f, t, q, v)
        return np.concatenate([q, v])

    def _value(self, field: "Field", t: float, q: Array, v: Array) -> Array:
        self.nfev += field is self._problem.f
        shape = self._problem.shape
        return field(t, q.reshape(shape), v.reshape(shape))

    def _solved(self, field: "Field", jacobian: "Field | None", substep: str, state: tuple[float, Array, Array], duration: float, iteration) -> Array:
        """X₁ = x₀ + h·field(x₁) for the x that a substep names, the other one standing still."""
        t, q, v = state
        x0 = q if substep == "q" else v

        def place(x: Array) -> tuple[float, Array, Array]:
            return (t, x, v) if substep == "q" else (t, q, x)

        guess = x0 + duration * self._value(field, *state)
        if substep not in field.takes:
            return guess
        return iteration.solve(
            lambda x: x - (x0 + duration * self._value(field, *place(x))),
            guess,
            None if jacobian is None else lambda x: np.eye(x.size) - duration * self._value(jacobian, *place(x)).reshape(x.size, x.size),
            key=duration,
            scale=np.abs(x0).max(),
        )


def euler_factors(row: Substeps) -> list[tuple[type[Substep], float]]:
    """The row as symplectic Euler methods in turn, kick-first and drift-first, with their weights."""
    factors, rest = [], 0.0
    for substep in row:
        rest = substep.coefficient - rest
        factors.append((type(substep), rest))
    if abs(rest) > COEFFICIENT_ROUNDING * len(row):
        raise TypeError("a row whose kicks and drifts do not add up to the same time has no implicit form")
    return [(kind, weight) for kind, weight in factors[:-1] if abs(weight) > COEFFICIENT_ROUNDING * len(row)]
