"""Steps whose length follows from their error, estimated by step doubling.

    error ≈ ‖y_h − y_{h/2, h/2}‖₂ / (2ᵖ − 1)          one step against two half as long, p the order

Good for every one-step method. The two short steps are the ones kept, without extrapolation, so that what the method
conserves in a step stays conserved. E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), II.4.
"""

from dataclasses import dataclass
from math import copysign, isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.errors import ConvergenceError
from minimd.integrators.differential_algebraic import begun, error_weights
from minimd.integrators.drivers import ROUNDING, check_ahead, check_problem
from minimd.integrators.method import Method, Step
from minimd.integrators.problems import Problem
from minimd.integrators.solution import Solution

Array = NDArray[np.float64]
EPS = float(np.finfo(float).eps)
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0  # of the step that the error estimate proposes; largest changes from one step to the next


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
    max_steps: int = 1_000_000,
) -> Solution:
    """Steps to t_end whose length follows from their error, estimated by step doubling.

    A step is accepted if the error, in root mean square over atol + rtol |y|, is at most 1. solution.n_rejected counts the others.

    Parameters
    ----------
    method : a one-step method without a time step, such as VelocityVerlet.
    rtol, atol : relative and absolute error allowed per step; atol may differ from component to component.
    first_step, min_step, max_step : lengths of steps [time], positive.  max_steps : int, tried at most, rejected ones among them.

    Raises
    ------
    TypeError : for anything but a problem and a method without a time step.  ValueError : for tolerances or steps out of range.
    A run that needs steps below min_step or below the spacing of numbers at t, or too many, ends there: solution.success is False.
    """
    check_problem(problem)
    check_ahead(t0, t_end)
    if not (isinstance(method, type) and issubclass(method, Method)):
        raise TypeError(f"method must be a method without a time step, such as VelocityVerlet; got {method!r}")
    tolerance = Tolerance(rtol, np.asarray(atol, dtype=float))
    lengths = Lengths(min_step, max_step, abs(t_end - t0), first_step)
    y = begun(problem, start, t0)
    tolerance.check_size(y.size)
    coarse, fine, order = method.on(problem), method.on(problem), method.order_on(problem)
    direction = copysign(1.0, t_end - t0)
    h = lengths.clipped(first_step or max(tolerance.first_step(problem.field(t0, y), y, abs(t_end - t0)), lengths.shortest(t0)))
    solution = Solution(np.array([t0]), np.array([y]), 0, problem.shape)
    t, times, states = t0, [t0], [y]
    while (t_end - t) * direction > 0.0 and solution.success:
        is_last = h >= abs(t_end - t) * (1.0 - ROUNDING)
        h = min(h, abs(t_end - t))
        try:
            y_new, difference = doubled(coarse, fine, t, y, direction * h)
            error = tolerance.excess(error_weights(problem, h) * difference / (2.0**order - 1.0), y, y_new)
            why = f"its error is {error:.1e} times what is allowed"
        except ConvergenceError as reason:
            error, why = np.inf, str(reason)
        if error <= 1.0:
            t, y = (t_end if is_last else t + direction * h), y_new
            times.append(t)
            states.append(y)
        elif h <= lengths.shortest(t):
            solution.success = False
            solution.message = (
                f"stopped at t = {t:g}: a step of {h:.1e} is too long, {why}, and shorter ones are not allowed (min_step = {min_step:g})"
            )
        else:
            solution.n_rejected += 1
        if solution.success and len(times) + solution.n_rejected > max_steps:
            solution.success = False
            solution.message = f"stopped at t = {t:g} after {max_steps} steps, the last of {h:.1e}; loosen rtol and atol, or raise max_steps"
        h = lengths.after(h, error, order)
    solution.t, solution.y, solution.nfev = np.array(times), np.array(states), coarse.nfev + fine.nfev
    return solution


@dataclass(frozen=True)
class Tolerance:
    """What error is allowed: atol + rtol |y| for each component, and the root mean square over all."""

    rtol: float
    atol: Array

    def __post_init__(self) -> None:
        if not (self.rtol >= 0.0 and np.all(self.atol >= 0.0) and (self.rtol > 0.0 or np.all(self.atol > 0.0))):
            raise ValueError(f"rtol and atol must not be negative, nor both zero; rtol = {self.rtol!r}, atol = {self.atol!r}")

    def excess(self, error: Array, y: Array, y_new: Array) -> float:
        """The error in units of what is allowed; infinite if it is not a number."""
        ratio = self._norm(error, np.maximum(np.abs(y), np.abs(y_new)))
        return ratio if isfinite(ratio) else np.inf

    def first_step(self, slope: Array, y: Array, span: float) -> float:
        """A hundredth of the time in which the state changes by its own size."""
        size, rate = self._norm(y, np.abs(y)), self._norm(slope, np.abs(y))
        return min(span, 0.01 * size / rate if size > 0.0 < rate < np.inf else 1e-3 * span)

    def check_size(self, n: int) -> None:
        """ValueError unless atol is one number, or one for each component."""
        if self.atol.shape not in ((), (n,)):
            raise ValueError(f"atol must be a number, or an array of length {n}, one for each component of y; got shape {self.atol.shape}")

    def _norm(self, difference: Array, size: Array) -> float:
        """Root mean square; what is exactly zero and stays so counts as exact, without an absolute tolerance too."""
        allowed = self.atol + self.rtol * size
        with np.errstate(divide="ignore"):
            ratio = np.divide(difference, allowed, out=np.zeros(size.size), where=difference != 0.0)
        return float(np.linalg.norm(ratio)) / np.sqrt(size.size)


@dataclass(frozen=True)
class Lengths:
    """How long steps may be, and how long the next one should be."""

    min_step: float
    max_step: float
    span: float
    first_step: float | None

    def __post_init__(self) -> None:
        if self.first_step is not None and not 0.0 < self.first_step < np.inf:
            raise ValueError(f"first_step must be positive and finite; first_step = {self.first_step!r}")
        if not 0.0 <= self.min_step <= self.max_step or self.max_step == 0.0:
            raise ValueError(f"0 <= min_step <= max_step is needed; min_step = {self.min_step!r}, max_step = {self.max_step!r}")

    def clipped(self, h: float) -> float:
        """H within the bounds."""
        return min(max(h, self.min_step), self.max_step)

    def shortest(self, t: float) -> float:
        """The length below which no step is tried: the smallest one allowed, or a few roundings of t."""
        return max(self.min_step, 16.0 * np.spacing(max(abs(t), EPS * self.span)))

    def after(self, h: float, error: float, order: int) -> float:
        """The step that should just meet the tolerance: the error of a step grows as hᵖ⁺¹."""
        factor = SAFETY * max(error, 1e-10) ** (-1.0 / (order + 1)) if isfinite(error) else SHRINK
        return self.clipped(h * min(max(factor, SHRINK), GROW))


def doubled(coarse: Step, fine: Step, t: float, y: Array, h: float) -> tuple[Array, Array]:
    """Two steps of h/2, and how far one step of h is from them.

    coarse, fine : the same method on the same problem, twice, so that each remembers its own last state.
    """
    one = coarse(t, y, h)
    two = fine(t + 0.5 * h, fine(t, y, 0.5 * h), 0.5 * h)
    return two, two - one
