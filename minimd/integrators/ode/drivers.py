"""Runs of small problems with a fixed time step, over a number of steps or up to a time,
and their results in the manner of SciPy."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import repeat
from math import isfinite
from typing import Any, Self

import numpy as np

from minimd.console.display import Displayed, Rows
from minimd.console.words import shown
from minimd.integrators.method import Array, Method, Problem
from minimd.structure.checks import checked_count, checked_number
from minimd.structure.errors import ConvergenceError, NonFiniteError

__all__ = ["Solution", "run_steps", "run_until"]

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
    checked_count("every", every)
    y = problem.begin(start, t0)
    step = type(method).on(problem)
    t, n, times, states = t0, 0, [t0], [y]

    def path() -> Solution:
        return Solution(np.array(times), np.array(states), step.nfev, problem.shape, message=end_message(problem))

    try:
        for n, h in enumerate(steps, start=1):
            y = step(t, y, h)
            t = t0 + n * method.timestep
            if (n - 1) % every != 0:
                del times[-1], states[-1]  # it was the last one, and its number is no multiple of every
            times.append(t)
            states.append(y)
    except ConvergenceError as reason:
        error = ConvergenceError(f"step {n} from t = {t:g} with timestep {h:g}: {reason}; reduce the timestep")
        raise with_path(error, path()) from None
    if t_end is not None:
        times[-1] = t_end
    return _finite(path(), method.timestep)


def _finite(solution: Solution, h: float) -> Solution:
    """The solution, or NonFiniteError with the part of it that is finite."""
    if np.isfinite(solution.y[-1]).all():
        return solution
    first = int(np.argmin(np.isfinite(solution.y).all(axis=1)))
    error = NonFiniteError(f"the state is not finite at t = {solution.t[first]:g}; the last finite one is at t = "
                           f"{solution.t[first - 1]:g}; "
                           f"reduce the timestep ({h:g}), or look for a singularity of the problem")  # fmt: skip
    raise with_path(error, Solution(solution.t[:first], solution.y[:first], solution.nfev, solution.shape))


def end_message(problem: Problem) -> str:
    """What is said of a run that reached its end."""
    return f"{REACHED}; {problem.remark}" if problem.remark else REACHED


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
