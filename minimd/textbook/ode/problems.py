"""Problems whose state is one array, and one step of a splitting on those with q and v: explicit or implicit.

    FirstOrder    y′ = f(t, y)
    SecondOrder   q″ = f(t, q, v)                               planets, pendulums, particles
    Partitioned   q′ = g(t, q, v),  v′ = f(t, q, v)             any Hamiltonian, with v for the momenta
    F(t, y, y′) = 0                                             differential-algebraic, see dae/

Separable problems, q′ = g(v) and v′ = f(t, q), are kicked and drifted. For all others the sequence is read as a product
of the two symplectic Euler methods. Each of them solves one equation, and each is the adjoint of the other:

    SE1   v₁ = v₀ + h f(t₀, q₀, v₁),   q₁ = q₀ + h g(t₀, q₀, v₁)
    SE2   q₁ = q₀ + h g(t₁, q₁, v₀),   v₁ = v₀ + h f(t₁, q₁, v₀)

    kick b₁, drift a₁, kick b₂, …  =  … SE1(b₂ − a₁ + b₁) ∘ SE2(a₁ − b₁) ∘ SE1(b₁)

Velocity Verlet becomes SE2(½) ∘ SE1(½), the generalized Störmer-Verlet method (A), position Verlet (B). Time is a
position: it moves with q. A sequence whose order p holds for all separable problems has the order p for all problems.
R. I. McLachlan, SIAM J. Sci. Comput. 16, 151 (1995); E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration (2006), III.3.3, VI.3.

The index of a differential-algebraic problem is how often equations must be differentiated until they determine y′.
Constraints that appear on the way are hidden, and a start must obey them too. E. Hairer, C. Lubich, M. Roche, The
Numerical Solution of Differential-Algebraic Systems by Runge-Kutta Methods (1989); E. Hairer, G. Wanner, Solving ODEs
II (1996), VI and VII.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.compiled.kernels import kernel
from minimd.core.console.words import shown
from minimd.core.integrators.method import Problem, Step
from minimd.core.integrators.order_conditions import nystrom_order, separable_order
from minimd.core.integrators.substeps import COEFFICIENT_ROUNDING, Kick, Substep, Substeps
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_numbers
from minimd.textbook.ode.functions import (
    Function,
    VectorField,
    check_finite,
    checked_values,
    forward_differences,
    reading,
)
from minimd.textbook.ode.newton import FixedPoint, Iteration, Newton, checked_solver

__all__ = ["FirstOrder", "Partitioned", "SecondOrder"]

Place = Callable[[Array], tuple[float, Array, Array]]


class FirstOrder(Problem):
    """y′ = f(t, y).

    Parameters
    ----------
    f : function of t and y, or of y.
    jacobian : (n, n) ∂f/∂y as a function of the same, by finite differences if not given.
    solver : Newton() or FixedPoint().
    """

    shape = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}(f)"

    def __init__(
        self, f: Function, jacobian: Function | None = None, solver: Newton = Newton()
    ) -> None:
        self._f = reading(f, "t y", "f", "y")[1]
        self.jacobian = jacobian and reading(jacobian, "t y", "jacobian", "y")[1]
        self.solver = checked_solver(solver)

    def begin(self, start: ArrayLike, t0: float = 0.0) -> Array:
        """The start as a state of length n.
        Raises ValueError if it is not an array of one dimension, or a value is not finite; from f, if its answers have
        another shape."""
        y = checked_numbers("start", start, "numbers")
        if y.ndim != 1 or y.size == 0:
            raise ValueError(
                f"the start must be a one-dimensional array with at least one element; got shape {y.shape}"
            )
        check_finite(y)
        return y

    def field(self, t: float, y: Array) -> Array:
        """f(t, y)."""
        return checked_values(self._f(t, y), y.shape, "f")


class Partitioned(Problem):
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

    drifts_on_lines = False  # q′ = v, and nothing holds q

    def __init__(
        self,
        g: Function,
        f: Function,
        g_q: Function | None = None,
        f_v: Function | None = None,
        solver: Newton = Newton(),
    ) -> None:
        self.g = VectorField(g, "v", "g")
        self.f = VectorField(f, "q", "f")
        self.g_q = None if g_q is None else VectorField(g_q, "", "g_q")
        self.f_v = None if f_v is None else VectorField(f_v, "", "f_v")
        self.solver = checked_solver(solver)
        self.shape: tuple[int, ...] = ()  # of q and of v, known once there is a start

    def __repr__(self) -> str:
        fields = (self.f,) if isinstance(self, SecondOrder) else (self.g, self.f)
        functions = (f"{field.name}({', '.join(field.takes)})" for field in fields)
        return f"{type(self).__name__}({', '.join(functions)})"

    @property
    def is_separable(self) -> bool:
        """Whether g takes v alone and f does not take v, so that each half can be solved exactly."""
        return set(self.g.takes) <= {"v"} and "v" not in self.f.takes

    def begin(self, start: tuple[ArrayLike, ArrayLike], t0: float = 0.0) -> Array:
        """(q, v) as one state of length 2n.
        Raises ValueError if q and v do not have the same shape, or a value is not finite; from g and f, if their
        answers have another shape."""
        if not isinstance(start, (tuple, list, np.ndarray)) or len(start) != 2:
            raise ValueError(f"the start must be a pair, (q, v); got {shown(start)}")
        q, v = (checked_numbers("start", part, "numbers") for part in start)
        if q.shape != v.shape or q.size == 0:
            raise ValueError(
                f"q and v of the start must have the same shape, and at least one element; got {q.shape} and {v.shape}"
            )
        self.shape = self.g.shape = self.f.shape = q.shape
        y = np.concatenate([q.reshape(-1), v.reshape(-1)])
        check_finite(y)
        return y

    def sequence_step(self, substeps: Substeps) -> Step:
        """The step of a splitting: kicks and drifts if the problem is separable, else its implicit form."""
        return SequenceStep(self, substeps) if self.is_separable else EulerStep(self, substeps)

    def sequence_order(self, substeps: Substeps) -> int:
        """Order of a splitting on this problem, which can be lower than on q″ = f(q)."""
        return separable_order(substeps)

    def halves(self, y: Array) -> tuple[Array, Array]:
        """Views of q and v, in their shape."""
        n = y.size // 2
        q = y[:n]
        v = y[n:]
        if len(self.shape) == 1:
            return q, v
        return q.reshape(self.shape), v.reshape(self.shape)

    def field(self, t: float, y: Array) -> Array:
        """(g, f) as one array of length 2n."""
        q, v = self.halves(y)
        return np.concatenate([self.g(t, q, v), self.f(t, q, v)])

    def drift(self, t: float, q: Array, v: Array, duration: float, _iteration: Iteration) -> None:
        """q += duration · q′, in place.
        q, v : (n,).
        _iteration : of the step, for drifts that solve equations."""
        push(q, duration, self.g(t, q.reshape(self.shape), v.reshape(self.shape)))

    def settle(self, q: Array, v: Array) -> None:
        """What follows the last substep, in place."""


class SecondOrder(Partitioned):
    """q″ = f(t, q, v): Newton's equation, f being force over mass.

    Parameters
    ----------
    f : a function of q, of t and q, or of t, q and v.
    f_v, solver : as for Partitioned.
    """

    drifts_on_lines = True

    def __init__(self, f: Function, f_v: Function | None = None, solver: Newton = Newton()) -> None:
        super().__init__(lambda v: v, f, f_v=f_v, solver=solver)

    def sequence_order(self, substeps: Substeps) -> int:
        """See Partitioned."""
        return nystrom_order(substeps) if self.is_separable else separable_order(substeps)


class DifferentialAlgebraic(Problem):
    """F(t, y, y′) = 0: what the forms of differential-algebraic problems have in common.

    begin refuses a start that violates a constraint, given or hidden, or that has no solution through it, with a
    ValueError. It solves for the algebraic variables; field is zero for those.

    Attributes of each problem
    --------------------------
    index : how often equations must be differentiated until they determine y′; known once there is a start.
    levels : (n,) how many powers of 1/h amplify errors of each variable: 0, or 1 and 2 for those of index 2 and 3.
    """

    shape = None
    index: int
    levels: Array

    def __init__(self, solver: Newton) -> None:
        if not isinstance(solver, Newton) or isinstance(solver, FixedPoint):
            raise TypeError(
                "differential-algebraic equations need Newton's method, because they are no fixed-point equations; "
                f"got solver = {solver!r}"
            )
        self.solver = solver

    def state_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y, (n, n), by differences."""
        return forward_differences(
            lambda x: self.residual(t, x, slope), y, self.residual(t, y, slope)
        )

    def slope_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y′, (n, n), by differences."""
        return forward_differences(
            lambda x: self.residual(t, y, x), slope, self.residual(t, y, slope)
        )

    def error_weights(self, h: float) -> Array:
        """(n,) min(1, |h|)^level: the factors of the errors of variables in an error norm.
        An error ε of the equations appears as ε/h in variables of index 2 and as ε/h² in those of index 3. These act on
        the solution with the inverse factors. The unit of time should be one in which the solution varies.
        E. Hairer, G. Wanner, Solving ODEs II (1996), VII.4 and the code RADAU5."""
        return min(1.0, abs(h)) ** self.levels


@kernel
def push(x, duration, rate):
    """x += duration · rate.  (n,) arrays; [time]."""
    for k in range(x.size):
        x[k] += duration * rate[k]


class SequenceStep:
    """Kicks and drifts in turn; the force at the end of a step is that at the start of the next."""

    def __init__(self, problem: Partitioned, substeps: Substeps) -> None:
        self.nfev = 0
        self._problem = problem
        self._iteration = problem.solver.iteration()
        self._substeps = [(isinstance(substep, Kick), substep.coefficient) for substep in substeps]
        self._last: Array | None = None  # state, and its force if it is known
        self._force: Array | None = None

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        problem = self._problem
        n = y.size // 2
        force = self._force if self._last is y else None
        y = y.copy()
        q = y[:n]
        v = y[n:]
        q_shaped, v_shaped = problem.halves(y)

        for is_kick, coefficient in self._substeps:
            duration = coefficient * h
            if is_kick:
                if force is None:
                    force = problem.f(t, q_shaped, v_shaped)
                    self.nfev += 1
                push(v, duration, force)
                continue

            if problem.drifts_on_lines:
                push(q, duration, v)
            else:
                problem.drift(t, q, v, duration, self._iteration)

            t += duration
            force = None

        if not problem.drifts_on_lines:
            problem.settle(q, v)
        self._last = y
        self._force = force
        return y


class EulerStep:
    """Symplectic Euler methods in turn; each implicit equation is solved to rounding, from its explicit guess."""

    def __init__(self, problem: Partitioned, substeps: Substeps) -> None:
        self.nfev = 0
        self._problem = problem
        self._factors = list[tuple[type[Substep], float, Iteration]]()
        rounding = COEFFICIENT_ROUNDING * len(substeps)
        rest = 0.0
        # kick-first and drift-first in turn, each with the rest of its neighbor
        for substep in substeps:
            rest = substep.coefficient - rest
            if abs(rest) > rounding:
                self._factors.append((type(substep), rest, problem.solver.iteration()))
        if abs(rest) > rounding:
            raise TypeError(
                "a sequence whose kicks and drifts do not add up to the same time has no implicit form"
            )

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        problem = self._problem
        q, v = np.split(y.copy(), 2)
        for kind, weight, iteration in self._factors:
            duration = weight * h
            if kind is Kick:
                v = self._solved("v", v, lambda x: (t, q, x), duration, iteration)
                q = q + duration * self._value(problem.g, t, q, v)
                t += duration
            else:
                t += duration
                q = self._solved("q", q, lambda x: (t, x, v), duration, iteration)
                v = v + duration * self._value(problem.f, t, q, v)
        return np.concatenate([q, v])

    def _value(self, field: VectorField, t: float, q: Array, v: Array) -> Array:
        shape = self._problem.shape
        self.nfev += field is self._problem.f
        return field(t, q.reshape(shape), v.reshape(shape))

    def _solved(
        self, unknown: str, x0: Array, place: Place, duration: float, iteration: Iteration
    ) -> Array:
        """x₁ = x₀ + h·field(x₁), where x is the unknown, q or v, and the other one is constant.
        place : (t, q, v) with this x."""
        problem = self._problem
        field = problem.f if unknown == "v" else problem.g
        jacobian: Any = problem.f_v if unknown == "v" else problem.g_q

        def moved(x: Array) -> Array:
            return x0 + duration * self._value(field, *place(x))

        def slope(x: Array) -> Array:
            matrix = self._value(jacobian, *place(x)).reshape(x.size, x.size)
            return np.eye(x.size) - duration * matrix

        guess = moved(x0)
        if unknown not in field.takes:
            return guess
        return iteration.solve(
            lambda x: x - moved(x), guess, jacobian and slope, duration, np.abs(x0).max()
        )
