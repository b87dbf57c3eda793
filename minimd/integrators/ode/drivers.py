"""Runs of small problems with a fixed time step, over a number of steps or up to a time, as SciPy gives them.

Störmer's two-step recursion for q″ = f(q), and its summed form.

    two-step   q_{n+1} − 2q_n + q_{n−1} = Δt² f(q_n)
    summed     d_n = d_{n−1} + Δt² f(q_n),   q_{n+1} = q_n + d_n

Both are velocity Verlet with the velocities eliminated, v_n = (q_{n+1} − q_{n−1})/2Δt. In exact arithmetic they give
the same path. In floating point the recursion adds Δt² f to numbers of order one, and its rounding errors grow as n² ε.
The summed form adds Δt² f to the small increments first, and its errors grow as n ε (P. Henrici, Discrete Variable
Methods in ODEs (1962), 6.4; E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), III.10).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import repeat
from math import isfinite
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from minimd.console.display import Displayed, Rows
from minimd.console.words import shown
from minimd.integrators.method import Array, Method, Problem
from minimd.structure.checks import checked_count, checked_number
from minimd.structure.errors import ConvergenceError, NonFiniteError

__all__ = ["Solution", "run_steps", "run_until", "stormer_summed", "stormer_two_step"]

REACHED = "the end was reached"
LEFTOVER = 1e-12  # of a step: a shorter rest is rounding of the times, and belongs to the step before


@dataclass(repr=False)
class Solution(Displayed):
    """A path on a grid of times.

    t : (n + 1,) times.  y : (n + 1, size) states.  q, v : (n + 1, …) positions and velocities,
        of problems that have them.
    nfev : evaluations of the right-hand side (of f, for problems with q and v).  n_rejected : steps tried in vain.
    success, message : whether the end was reached, and if not, why; if so,
        what limits the accuracy beside the method and rounding.
    """

    t: Array
    y: Array
    nfev: int
    shape: tuple[int, ...] | None = None
    success: bool = True
    message: str = REACHED
    n_rejected: int = 0

    def __repr__(self) -> str:
        return f"Solution({len(self.t)} states at t = {self.t[0]:.6g} to {self.t[-1]:.6g})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        size = f"q and v of shape {self.shape}" if self.shape is not None else f"{self.y.shape[1]} numbers"
        rows = [("states", f"{len(self.t)} of {size}, t = {self.t[0]:.6g} to {self.t[-1]:.6g}")]
        rows += [("evaluations", f"{self.nfev}"), ("outcome", self.message)]
        return rows + ([("rejected", f"{self.n_rejected} steps")] if self.n_rejected else [])

    @property
    def q(self) -> Array:
        """(n + 1, …) positions."""
        return self._half(0)

    @property
    def v(self) -> Array:
        """(n + 1, …) velocities."""
        return self._half(1)

    def ended(self, why: str) -> Self:
        """The same solution, which did not reach its end."""
        self.success, self.message = False, why
        return self

    def _half(self, k: int) -> Array:
        if self.shape is None:
            raise AttributeError("this problem has no q and v; its states are in y")
        n = self.y.shape[1] // 2
        return self.y[:, k * n : (k + 1) * n].reshape(-1, *self.shape)


class Path:
    """The states that are kept of a run: every so many, and the last one."""

    def __init__(self, problem: Problem, t: float, y: Array, every: int = 1) -> None:
        check_problem(problem)
        self.problem, self.t, self.y, self.n, self._every = problem, t, y, 0, checked_count("every", every)
        self.kept = [(t, y)]

    def keep(self, t: float, y: Array) -> None:
        """The state after one more step."""
        if self.n % self._every != 0:
            del self.kept[-1]  # it was the last one, and its number is no multiple of every
        self.t, self.y, self.n = t, y, self.n + 1
        self.kept.append((t, y))

    def solution(self, nfev: int, n_rejected: int = 0) -> Solution:
        """Of a run that has reached its end."""
        t, y = zip(*self.kept, strict=True)
        message = f"{REACHED}; {self.problem.remark}" if self.problem.remark else REACHED
        found = Solution(np.array(t), np.array(y), nfev, self.problem.shape, message=message)
        found.n_rejected = n_rejected
        return found


def with_path(error: ConvergenceError | NonFiniteError, path: Solution) -> ConvergenceError | NonFiniteError:
    """The error of a run with the path before it, error.solution."""
    error.solution = path.ended(str(error))
    return error


def run_steps(problem: Problem, method: Method, start: Any, n_steps: int, t0: float = 0.0, every: int = 1) -> Solution:
    """A fixed number of steps of the method's time step.

    Parameters
    ----------
    problem : SecondOrder, Partitioned, FirstOrder, or a differential-algebraic one.
    method : a method with its time step, such as VelocityVerlet(0.05).
    start : (q, v), or y, at time t0.  every : steps between the states that are kept; the last one is kept too.

    Raises
    ------
    TypeError : for anything but a problem and a method with its time step.
    ValueError : for counts below 1, a time that is not finite, or a start that does not fit the problem.
    ConvergenceError, NonFiniteError : if a step cannot be made; the message names it,
        error.solution holds the path before.
    """
    check_method(method)
    checked_count("n_steps", n_steps)
    checked_number("t0", t0)
    return _fixed(problem, method, start, t0, repeat(method.timestep, n_steps), every)


def run_until(problem: Problem, method: Method, start: Any, t_end: float, t0: float = 0.0, every: int = 1) -> Solution:
    """Steps of the method's time step up to t_end, the last one shortened to end there.

    Parameters, Raises : as run_steps; t_end must lie on the side of t0 to which the time step leads.
    """
    check_method(method)
    h = method.timestep
    n_steps = (checked_number("t_end", t_end) - checked_number("t0", t0)) / h
    if not (isfinite(n_steps) and n_steps > 0.0):
        raise ValueError(f"t_end must be finite and lie ahead of t0; t0 = {t0!r}, t_end = {t_end!r}, timestep = {h!r}")
    whole = int(n_steps * (1.0 + LEFTOVER) + LEFTOVER)
    rest = t_end - (t0 + whole * h)
    steps = [h] * whole + ([rest] if rest / h > LEFTOVER * n_steps else [])
    return _fixed(problem, method, start, t0, iter(steps), every, t_end)


def check_ahead(t0: float, t_end: float) -> None:
    """ValueError unless both times are finite, and differ."""
    if checked_number("t0", t0) == checked_number("t_end", t_end):
        raise ValueError(f"t0 and t_end must be finite and differ; t0 = {t0!r}, t_end = {t_end!r}")


def _fixed(
    problem: Problem,
    method: Method,
    start: Any,
    t0: float,
    steps: Iterator[float],
    every: int,
    t_end: float | None = None,
) -> Solution:
    check_problem(problem)
    path = Path(problem, t0, problem.begin(start, t0), every)
    step = type(method).on(problem)
    for h in steps:
        try:
            y = step(path.t, path.y, h)
        except ConvergenceError as reason:
            words = f"step {path.n + 1} from t = {path.t:g} with timestep {h:g}: {reason}; reduce the timestep"
            raise with_path(ConvergenceError(words), path.solution(step.nfev)) from None
        path.keep(t0 + (path.n + 1) * method.timestep, y)
    solution = path.solution(step.nfev)
    if t_end is not None:
        solution.t[-1] = t_end
    return _finite(solution, method.timestep)


def _finite(solution: Solution, h: float) -> Solution:
    """The solution, or NonFiniteError with the part of it that is finite."""
    if np.isfinite(solution.y[-1]).all():
        return solution
    first = int(np.argmin(np.isfinite(solution.y).all(axis=1)))
    error = NonFiniteError(f"the state is not finite at t = {solution.t[first]:g}; the last finite one is at t = "
                           f"{solution.t[first - 1]:g}; "
                           f"reduce the timestep ({h:g}), or look for a singularity of the problem")  # fmt: skip
    raise with_path(error, Solution(solution.t[:first], solution.y[:first], solution.nfev, solution.shape))


def check_problem(problem: Problem) -> None:
    """TypeError for anything but a problem."""
    if not hasattr(problem, "begin"):
        raise TypeError(f"problem must be a differential equation, such as SecondOrder(f); got {shown(problem)}")


def check_method(method: Method) -> None:
    """TypeError for anything but a method with its time step."""
    if not isinstance(method, Method):
        raise TypeError(
            f"method must be a method with its time step, such as VelocityVerlet(0.05); got {shown(method)}"
        )


Acceleration = Callable[[Array], ArrayLike]


def stormer_two_step(f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int) -> Solution:
    """The two-step recursion, started with q₁ = q₀ + Δt v₀ + ½Δt² f(q₀).

    Parameters
    ----------
    f : acceleration of positions, both of the shape of q0 [length/time²].  q0, v0 : start [length], [length/time].
    timestep : Δt [time], negative to run backwards.  n_steps : at least 1.

    Raises
    ------
    ValueError : if the time step is zero or not finite, n_steps not a whole number, at least 1, or the shapes of q0,
        v0 and f(q0) differ.
    """
    q, _ = _start(f, q0, v0, timestep, n_steps)
    for n in range(1, n_steps + 1):
        q[n + 1] = 2.0 * q[n] - q[n - 1] + timestep**2 * np.asarray(f(q[n]))
    return _solution(q, q[1:] - q[:-1], v0, timestep)


def stormer_summed(f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int) -> Solution:
    """The recursion for the increments d_n = q_{n+1} − q_n: the same path,
    with far less round-off over many small steps.

    Parameters, Raises : as stormer_two_step.
    """
    q, d = _start(f, q0, v0, timestep, n_steps)
    increments = np.empty_like(q[1:])
    increments[0] = d
    for n in range(1, n_steps + 1):
        increments[n] = increments[n - 1] + timestep**2 * np.asarray(f(q[n]))
        q[n + 1] = q[n] + increments[n]
    return _solution(q, increments, v0, timestep)


def _start(f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int) -> tuple[Array, Array]:
    """Memory for q₀ … q_{n+1} with q₀ and q₁ filled in, and the first increment."""
    q0, v0 = np.asarray(q0, dtype=float), np.asarray(v0, dtype=float)
    checked_number("timestep", timestep, "finite and not zero")
    checked_count("n_steps", n_steps)
    a0 = np.asarray(f(q0), dtype=float)
    if not q0.shape == v0.shape == a0.shape:
        raise ValueError(f"q0, v0 and f(q0) must have the same shape; got {q0.shape}, {v0.shape} and {a0.shape}")
    q, d = np.empty((n_steps + 2, *q0.shape)), timestep * v0 + 0.5 * timestep**2 * a0
    q[0], q[1] = q0, q0 + d
    return q, d


def _solution(q: Array, increments: Array, v0: ArrayLike, timestep: float) -> Solution:
    """The path without the position after the end, which is needed for the last velocity only."""
    n_steps = len(q) - 2
    v = np.empty_like(q[:-1])
    v[0] = v0
    v[1:] = (increments[1:] + increments[:-1]) / (2.0 * timestep)
    t = np.linspace(0.0, n_steps * timestep, n_steps + 1)
    y = np.concatenate([part.reshape(len(t), -1) for part in (q[:-1], v)], axis=1)
    return Solution(t, y, nfev=n_steps + 1, shape=q.shape[1:])
