"""Drivers: a method on a small problem, over a number of steps, to a time, or with steps that an error estimate chooses.

    error ≈ ‖y_h − y_{h/2, h/2}‖₂ / (2ᵖ − 1)          step doubling: one step against two half as long, p the order

Good for every one-step method. The two short steps are the ones kept, without extrapolation, so that what the method
conserves in a step stays conserved. E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), II.4.
"""

from collections.abc import Iterator
from math import copysign, isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.errors import ConvergenceError, NonFiniteError
from minimd.integrators.method import Method, Step
from minimd.integrators.problems import Problem
from minimd.integrators.solution import Solution

Array = NDArray[np.float64]
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0  # of the step that the error estimate proposes; largest changes from one step to the next
ROUNDING = 1e-12  # a last step shorter than this fraction of the others is made with the one before


def run_steps(problem: Problem, method: Method, start: Any, n_steps: int, t0: float = 0.0, every: int = 1) -> Solution:
    """A fixed number of steps of the method's time step.

    Parameters
    ----------
    problem : SecondOrder, Partitioned, FirstOrder, or a differential-algebraic one.
    method : a method with its time step, such as VelocityVerlet(0.05).
    start : (q, v), or y, at time t0.  every : steps between the states that are kept; the last one is kept too.

    Raises
    ------
    ValueError : for counts below 1, or a start that does not fit the problem.
    ConvergenceError, NonFiniteError : if a step cannot be made; the message names it, error.solution holds the path before.
    """
    _check_method(method)
    for name, value in (("n_steps", n_steps), ("every", every)):
        if not isinstance(value, (int, np.integer)) or value < 1:
            raise ValueError(f"{name} must be a whole number, at least 1; {name} = {value!r}")
    h = method.timestep
    return _fixed(problem, method, start, t0, (h for _ in range(n_steps)), every)


def run_until(problem: Problem, method: Method, start: Any, t_end: float, t0: float = 0.0, every: int = 1) -> Solution:
    """Steps of the method's time step up to t_end, the last one shortened to end there.

    Parameters, Raises : as run_steps; t_end must lie on the side of t0 to which the time step leads.
    """
    _check_method(method)
    h = method.timestep
    n_steps = (t_end - t0) / h
    if not (isfinite(n_steps) and n_steps > 0.0):
        raise ValueError(f"t_end must be finite and lie ahead of t0; t0 = {t0!r}, t_end = {t_end!r}, timestep = {h!r}")
    whole = int(n_steps * (1.0 + ROUNDING) + ROUNDING)
    rest = t_end - (t0 + whole * h)
    steps = [h] * whole + ([rest] if rest / h > ROUNDING * n_steps else [])
    return _fixed(problem, method, start, t0, iter(steps), every, t_end)


def run_adaptive(
    problem: Problem,
    method: type[Method],
    start: Any,
    t_end: float,
    t0: float = 0.0,
    *,
    rtol: float = 1e-6,
    atol: ArrayLike = 1e-9,
    first_step: float | None = None,
    min_step: float = 0.0,
    max_step: float = np.inf,
) -> Solution:
    """Steps to t_end whose length follows from their error, estimated by step doubling.

    A step is accepted if the error, in root mean square over atol + rtol |y|, is at most 1. solution.n_rejected counts the others.

    Parameters
    ----------
    method : a one-step method without a time step, such as VelocityVerlet.
    rtol, atol : relative and absolute error allowed per step; atol may differ from component to component.
    first_step, min_step, max_step : lengths of steps [time], positive.

    Raises
    ------
    ValueError : for tolerances or steps out of range.
    A run that needs steps below min_step, or below the spacing of numbers at t, ends there: solution.success is False.
    """
    check_ahead(t0, t_end)
    if not (rtol >= 0.0 and np.all(np.asarray(atol) >= 0.0) and (rtol > 0.0 or np.all(np.asarray(atol) > 0.0))):
        raise ValueError(f"rtol and atol must not be negative, nor both zero; rtol = {rtol!r}, atol = {atol!r}")
    if not 0.0 <= min_step <= max_step:
        raise ValueError(f"0 <= min_step <= max_step is needed; min_step = {min_step!r}, max_step = {max_step!r}")
    y = problem.begin(start)
    coarse, fine, order = method.on(problem), method.on(problem), method.order_on(problem)
    direction = copysign(1.0, t_end - t0)
    h = abs(first_step) if first_step else _first_step(problem, t0, y, rtol, atol, abs(t_end - t0))
    h = min(max(h, min_step), max_step)
    t, times, states, n_rejected, message = t0, [t0], [y], 0, ""
    while (t_end - t) * direction > 0.0 and not message:
        is_last = h >= abs(t_end - t) * (1.0 - ROUNDING)
        h = min(h, abs(t_end - t))
        try:
            y_new, difference = doubled(coarse, fine, t, y, direction * h)
            scale = np.asarray(atol) + rtol * np.maximum(np.abs(y), np.abs(y_new))
            error = np.linalg.norm(difference / scale) / np.sqrt(y.size) / (2.0**order - 1.0)
        except ConvergenceError as reason:
            error, why = np.inf, str(reason)
        else:
            why = f"its error is {error:.1e} of what is allowed"
        if error <= 1.0:
            t, y = (t_end if is_last else t + direction * h), y_new
            times.append(t)
            states.append(y)
        elif h <= max(min_step, 16.0 * np.spacing(max(abs(t), abs(t_end)))):
            message = f"stopped at t = {t:g}: a step of {h:.1e} is too long, {why}, and min_step = {min_step:g} forbids shorter ones"
        else:
            n_rejected += 1
        factor = SHRINK if not np.isfinite(error) else SAFETY * max(error, 1e-10) ** (-1.0 / (order + 1))
        h = min(max(h * min(max(factor, SHRINK), GROW), min_step), max_step)
    solution = Solution(np.array(times), np.array(states), coarse.nfev + fine.nfev, problem.shape, not message, message or Solution.message)
    solution.n_rejected = n_rejected
    return solution


def doubled(coarse: Step, fine: Step, t: float, y: Array, h: float) -> tuple[Array, Array]:
    """Two steps of h/2, and how far one step of h is from them.

    coarse, fine : the same method on the same problem, twice, so that each remembers its own last state.
    """
    one = coarse(t, y, h)
    two = fine(t + 0.5 * h, fine(t, y, 0.5 * h), 0.5 * h)
    return two, two - one


def check_ahead(t0: float, t_end: float) -> None:
    """ValueError unless there is time to go."""
    if not (isfinite(t0) and isfinite(t_end) and t0 != t_end):
        raise ValueError(f"t0 and t_end must be finite and differ; t0 = {t0!r}, t_end = {t_end!r}")


def _fixed(problem: Problem, method: Method, start: Any, t0: float, steps: Iterator[float], every: int, t_end: float | None = None) -> Solution:
    y = problem.begin(start)
    step = type(method).on(problem)
    t, n, times, states = t0, 0, [t0], [y]
    try:
        for n, h in enumerate(steps, start=1):
            y = step(t, y, h)
            t = t0 + n * method.timestep
            if n % every == 0:
                times.append(t)
                states.append(y)
    except ConvergenceError as reason:
        error = ConvergenceError(f"step {n} from t = {t:g} with timestep {h:g}: {reason}; reduce the timestep")
        error.solution = _path(problem, times, states, step)
        raise error from None
    if n % every != 0:
        times.append(t)
        states.append(y)
    if t_end is not None:
        times[-1] = t_end
    return _finite(_path(problem, times, states, step), method.timestep)


def _path(problem: Problem, times: list[float], states: list[Array], step: Step) -> Solution:
    return Solution(np.array(times), np.array(states), step.nfev, problem.shape)


def _finite(solution: Solution, h: float) -> Solution:
    """The solution, or NonFiniteError with the part of it that is finite."""
    if np.isfinite(solution.y[-1]).all():
        return solution
    first = int(np.argmin(np.isfinite(solution.y).all(axis=1)))
    error = NonFiniteError(f"the state is not finite at t = {solution.t[first]:g}; the last finite one is at t = {solution.t[first - 1]:g}; "
                           f"reduce the timestep ({h:g}), or look for a singularity of the problem")  # fmt: skip
    error.solution = Solution(solution.t[:first], solution.y[:first], solution.nfev, solution.shape, False, str(error))
    raise error


def _first_step(problem: Problem, t: float, y: Array, rtol: float, atol: ArrayLike, span: float) -> float:
    """A hundredth of the time in which the state changes by its own size."""
    scale = np.asarray(atol) + rtol * np.abs(y)
    size, rate = np.linalg.norm(y / scale), np.linalg.norm(problem.field(t, y) / scale)
    return min(span, 0.01 * float(size / rate) if size > 0.0 < rate else 1e-3 * span)


def _check_method(method: Method) -> None:
    if not isinstance(method, Method):
        raise TypeError(f"method must be a method with its time step, such as VelocityVerlet(0.05); got {method!r}")
