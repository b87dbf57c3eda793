"""Problems with q and v, and one step of a splitting on them: the same substeps, explicit or implicit.

    SecondOrder   q″ = f(t, q, v)                               planets, pendulums, particles
    Partitioned   q′ = g(t, q, v),  v′ = f(t, q, v)             any Hamiltonian, with v for the momenta

Separable problems, q′ = g(v) and v′ = f(t, q), are kicked and drifted. For all others the sequence is read as a product
of the two symplectic Euler methods. Each of them solves one equation, and each is the adjoint of the other:

    SE1   v₁ = v₀ + h f(t₀, q₀, v₁),   q₁ = q₀ + h g(t₀, q₀, v₁)
    SE2   q₁ = q₀ + h g(t₁, q₁, v₀),   v₁ = v₀ + h f(t₁, q₁, v₀)

    kick b₁, drift a₁, kick b₂, …  =  … SE1(b₂ − a₁ + b₁) ∘ SE2(a₁ − b₁) ∘ SE1(b₁)

Velocity Verlet becomes SE2(½) ∘ SE1(½), the generalized Störmer-Verlet method (A), position Verlet (B). Time is a
position: it moves with q. A sequence whose order p holds for all separable problems has the order p for all problems.
R. I. McLachlan, SIAM J. Sci. Comput. 16, 151 (1995); E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration (2006), III.3.3, VI.3.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from minimd.compiled.kernels import kernel
from minimd.console.words import shown
from minimd.integrators.method import Array, Step
from minimd.integrators.ode.functions import Field, Function, check_finite
from minimd.integrators.ode.newton import Iteration, Newton, Solver, checked_solver
from minimd.integrators.splitting.order_conditions import nystrom_order, separable_order
from minimd.integrators.splitting.substeps import COEFFICIENT_ROUNDING, Kick, Substep, Substeps

__all__ = ["Partitioned", "SecondOrder"]

Place = Callable[[Array], tuple[float, Array, Array]]


class Partitioned:
    """q′ = g(t, q, v), v′ = f(t, q, v).

    Parameters
    ----------
    g, f : functions of t, q, v, or of those of them they depend on: g(v), f(q), f(t, q), …; q and v have the shape of
        the start, and so have the answers. q and v are not to be changed.
    g_q, f_v : (n, n) Jacobians ∂g/∂q and ∂f/∂v, functions of t, q, v; found by finite differences if not given.
    solver : Newton() or FixedPoint(), for steps that turn out implicit.

    Raises
    ------
    TypeError : for anything but functions, or functions whose arguments are called otherwise.
    """

    remark = ""

    def __init__(
        self,
        g: Function,
        f: Function,
        g_q: Function | None = None,
        f_v: Function | None = None,
        solver: Solver = Newton(),
    ) -> None:
        self.g, self.f = Field(g, "v", "g"), Field(f, "q", "f")
        self.g_q = g_q if g_q is None else Field(g_q, "tqv", "g_q")
        self.f_v = f_v if f_v is None else Field(f_v, "tqv", "f_v")
        self.solver = checked_solver(solver)
        self.shape: tuple[int, ...] = ()  # of q and of v, known once there is a start
        self.g_is_v = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'' if self.g_is_v else f'g({self.g.arguments}), '}f({self.f.arguments}))"

    @property
    def is_separable(self) -> bool:
        """Whether g takes v alone and f does not take v, so that each half can be solved exactly."""
        return self.g.takes in ("", "v") and "v" not in self.f.takes

    def begin(self, start: tuple[ArrayLike, ArrayLike], t0: float = 0.0) -> Array:
        """(q, v) as one state of length 2n.

        Raises ValueError if q and v do not have the same shape, or a value is not finite; from g and f,
        if their answers have another shape.
        """
        if not isinstance(start, (tuple, list, np.ndarray)) or len(start) != 2:
            raise ValueError(f"the start must be a pair, (q, v); got {shown(start)}")
        q, v = (np.array(part, dtype=float) for part in start)
        if q.shape != v.shape or q.size == 0:
            raise ValueError(
                f"q and v of the start must have the same shape, and at least one element; got {q.shape} and {v.shape}"
            )
        self.shape = self.g.shape = self.f.shape = q.shape
        y = np.concatenate([q.reshape(-1), v.reshape(-1)])
        check_finite(y)
        return y

    def sequence_step(self, substeps: Substeps) -> Step:
        """The step of a splitting: kicks and drifts if the problem is separable,
        else the implicit form of the method."""
        return SequenceStep(self, substeps) if self.is_separable else EulerStep(self, substeps)

    def sequence_order(self, substeps: Substeps) -> int:
        """Order of a splitting on this problem, which can be lower than on q″ = f(q)."""
        return separable_order(substeps)

    def halves(self, y: Array) -> tuple[Array, Array]:
        """Views of q and v, in their shape."""
        n = y.size // 2
        q, v = y[:n], y[n:]
        return (q, v) if len(self.shape) == 1 else (q.reshape(self.shape), v.reshape(self.shape))

    def field(self, t: float, y: Array) -> Array:
        """(g, f) as one array of length 2n."""
        q, v = self.halves(y)
        return np.concatenate([self.g(t, q, v), self.f(t, q, v)])

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """y′ − (g, f)."""
        return slope - self.field(t, y)


class SecondOrder(Partitioned):
    """q″ = f(t, q, v): Newton's equation, f being force over mass.

    Parameters
    ----------
    f : a function of q, of t and q, or of t, q and v.  f_v, solver : as for Partitioned.
    """

    def __init__(self, f: Function, f_v: Function | None = None, solver: Solver = Newton()) -> None:
        super().__init__(lambda v: v, f, f_v=f_v, solver=solver)
        self.g_is_v = True

    def sequence_order(self, substeps: Substeps) -> int:
        """See Partitioned."""
        return nystrom_order(substeps) if self.is_separable else separable_order(substeps)


@kernel
def push(x, duration, rate):
    """x += duration · rate.  (n,) arrays; [time]."""
    for k in range(x.size):
        x[k] += duration * rate[k]


class SequenceStep:
    """Kicks and drifts in turn; the force at the end of a step is that at the start of the next."""

    def __init__(self, problem: Partitioned, substeps: Substeps) -> None:
        self.nfev, self._problem = 0, problem
        self._substeps = [(isinstance(substep, Kick), substep.coefficient) for substep in substeps]
        self._known: tuple[Array | None, Array | None] = None, None

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        problem, n = self._problem, y.size // 2
        force = self._known[1] if self._known[0] is y else None
        y = y.copy()
        q, v = y[:n], y[n:]
        q_shaped, v_shaped = (q, v) if len(problem.shape) == 1 else problem.halves(y)
        for is_kick, coefficient in self._substeps:
            duration = coefficient * h
            if is_kick:
                if force is None:
                    force = problem.f(t, q_shaped, v_shaped)
                    self.nfev += 1
                push(v, duration, force)
            else:
                self._drift(t, q, v, duration)
                t += duration
                force = None
        self._end(q, v)
        self._known = y, force
        return y

    def _drift(self, t: float, q: Array, v: Array, duration: float) -> None:
        """q += duration · q′, in place."""
        problem = self._problem
        push(q, duration, v if problem.g_is_v else problem.g(t, q.reshape(problem.shape), v.reshape(problem.shape)))

    def _end(self, q: Array, v: Array) -> None:
        """What follows the last substep, in place."""


class EulerStep:
    """Symplectic Euler methods in turn; each implicit equation is solved to rounding, from its explicit guess."""

    def __init__(self, problem: Partitioned, substeps: Substeps) -> None:
        self.nfev, self._problem = 0, problem
        self._factors = [(kind, weight, problem.solver.iteration()) for kind, weight in euler_factors(substeps)]

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        problem, n = self._problem, y.size // 2
        q, v = y[:n].copy(), y[n:].copy()
        for kind, weight, iteration in self._factors:
            duration = weight * h
            if kind is Kick:
                v = self._solved(problem.f, problem.f_v, "v", v, lambda x: (t, q, x), duration, iteration)
                q = q + duration * self._value(problem.g, t, q, v)
                t += duration
            else:
                t += duration
                q = self._solved(problem.g, problem.g_q, "q", q, lambda x: (t, x, v), duration, iteration)
                v = v + duration * self._value(problem.f, t, q, v)
        return np.concatenate([q, v])

    def _value(self, field: Field, t: float, q: Array, v: Array) -> Array:
        self.nfev, shape = self.nfev + (field is self._problem.f), self._problem.shape
        return field(t, q.reshape(shape), v.reshape(shape))

    def _solved(
        self,
        field: Field,
        jacobian: Field | None,
        unknown: str,
        x0: Array,
        place: Place,
        duration: float,
        iteration: Iteration,
    ) -> Array:
        """x₁ = x₀ + h·field(x₁), where x is the unknown, q or v, and the other one is constant.  place : (t, q, v)
        with this x."""
        guess = x0 + duration * self._value(field, *place(x0))
        if unknown not in field.takes:
            return guess
        slope = (
            None
            if jacobian is None
            else lambda x: np.eye(x.size) - duration * self._value(jacobian, *place(x)).reshape(x.size, x.size)
        )
        return iteration.solve(
            lambda x: x - (x0 + duration * self._value(field, *place(x))), guess, slope, duration, np.abs(x0).max()
        )


def euler_factors(substeps: Substeps) -> list[tuple[type[Substep], float]]:
    """The sequence as symplectic Euler methods in turn, kick-first and drift-first, with their weights."""
    factors, rest = [], 0.0
    for substep in substeps:
        rest = substep.coefficient - rest
        factors.append((type(substep), rest))
    if abs(rest) > COEFFICIENT_ROUNDING * len(substeps):
        raise TypeError("a sequence whose kicks and drifts do not add up to the same time has no implicit form")
    return [(kind, weight) for kind, weight in factors[:-1] if abs(weight) > COEFFICIENT_ROUNDING * len(substeps)]
