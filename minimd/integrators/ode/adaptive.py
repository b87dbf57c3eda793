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

from minimd.compiled.machine import EPS
from minimd.integrators.dae.problem import begun, error_weights
from minimd.integrators.method import Method, Step
from minimd.integrators.ode.drivers import LEFTOVER, check_ahead, check_problem
from minimd.integrators.ode.problems import Problem
from minimd.integrators.ode.solution import Solution, ended
from minimd.structure.errors import ConvergenceError, checked_count

Array = NDArray[np.float64]
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0  # of the step that the error estimate proposes; largest changes from one step to the next


@dataclass(frozen=True)
class StepControl:
    """What error a step may have, and how long it may be.

    A step is accepted if its error, in root mean square over atol + rtol |y|, is at most 1.

    Parameters
    ----------
    rtol, atol : relative and absolute error allowed per step; atol may differ from component to component.
    first_step, min_step, max_step : lengths of steps [time], positive.  max_steps : int, tried at most, rejected ones among them.

    Raises
    ------
    ValueError : for tolerances or lengths out of range.
    """

    rtol: float = 1e-6
    atol: ArrayLike = 1e-9
    first_step: float | None = None
    min_step: float = 0.0
    max_step: float = np.inf
    max_steps: int = 1_000_000

    def __post_init__(self) -> None:
        atol = np.asarray(self.atol, dtype=float)
        if not (self.rtol >= 0.0 and np.all(atol >= 0.0) and (self.rtol > 0.0 or np.all(atol > 0.0))):
            raise ValueError(f"rtol and atol must not be negative, nor both zero; rtol = {self.rtol!r}, atol = {self.atol!r}")
        if self.first_step is not None and not 0.0 < self.first_step < np.inf:
            raise ValueError(f"first_step must be positive and finite; first_step = {self.first_step!r}")
        if not 0.0 <= self.min_step <= self.max_step or self.max_step == 0.0:
            raise ValueError(f"0 <= min_step <= max_step is needed; min_step = {self.min_step!r}, max_step = {self.max_step!r}")
        checked_count("max_steps", self.max_steps)

    def check_size(self, n: int) -> None:
        """ValueError unless atol is one number, or one for each component."""
        if np.shape(self.atol) not in ((), (n,)):
            raise ValueError(f"atol must be a number, or an array of length {n}, one for each component of y; got shape {np.shape(self.atol)}")

    def excess(self, error: Array, y: Array, y_new: Array) -> float:
        """The error in units of what is allowed; infinite if it is not a number."""
        ratio = self._norm(error, np.maximum(np.abs(y), np.abs(y_new)))
        return ratio if isfinite(ratio) else np.inf

    def first(self, slope: Array, y: Array, span: float, shortest: float) -> float:
        """The first step; a hundredth of the time in which the state changes by its own size, unless given."""
        size, rate = self._norm(y, np.abs(y)), self._norm(slope, np.abs(y))
        guess = min(span, 0.01 * size / rate if size > 0.0 < rate < np.inf else 1e-3 * span)
        return self.clipped(self.first_step or max(guess, shortest))

    def after(self, h: float, error: float, order: int) -> float:
        """The step that should just meet the tolerance: the error of a step grows as hᵖ⁺¹."""
        factor = SAFETY * max(error, 1e-10) ** (-1.0 / (order + 1)) if isfinite(error) else SHRINK
        return self.clipped(h * min(max(factor, SHRINK), GROW))

    def clipped(self, h: float) -> float:
        """H within the bounds."""
        return min(max(h, self.min_step), self.max_step)

    def shortest(self, t: float, span: float) -> float:
        """The length below which no step is tried: the smallest one allowed, or a few roundings of t."""
        return max(self.min_step, 16.0 * np.spacing(max(abs(t), EPS * span)))

    def _norm(self, difference: Array, size: Array) -> float:
        """Root mean square; what is exactly zero and stays so counts as exact, without an absolute tolerance too."""
        allowed = np.asarray(self.atol, dtype=float) + self.rtol * size
        with np.errstate(divide="ignore"):
            ratio = np.divide(difference, allowed, out=np.zeros(size.size), where=difference != 0.0)
        return float(np.linalg.norm(ratio)) / np.sqrt(size.size)


def run_adaptive(
    problem: Problem,
    method: type[Method],
    start: Any,
    t_end: float,
    t0: float = 0.0,
    control: StepControl = StepControl(),
) -> Solution:
    """Steps to t_end whose length follows from their error, estimated by step doubling. solution.n_rejected counts those tried in vain.

    Parameters
    ----------
    method : a one-step method without a time step, such as VelocityVerlet.
    control : StepControl, such as StepControl(rtol=1e-8): what error a step may have, and how long it may be.

    Raises
    ------
    TypeError : for anything but a problem, a method without a time step, and StepControl.  ValueError : if atol does not fit y.
    A run that needs steps below min_step or below the spacing of numbers at t, or too many, ends there: solution.success is False.
    """
    check_problem(problem)
    check_ahead(t0, t_end)
    if not (isinstance(method, type) and issubclass(method, Method)):
        raise TypeError(f"method must be a method without a time step, such as VelocityVerlet; got {method!r}")
    if not isinstance(control, StepControl):
        raise TypeError(f"control must be StepControl(rtol, atol); got {control!r}")
    y = begun(problem, start, t0)
    control.check_size(y.size)
    return _Path(problem, method, y, t0, control).to(t_end)


class _Path:
    """The states that were accepted, and how many steps were not."""

    def __init__(self, problem: Problem, method: type[Method], y: Array, t0: float, control: StepControl) -> None:
        self.problem, self.control, self.order = problem, control, method.order_on(problem)
        self.coarse, self.fine = method.on(problem), method.on(problem)
        self.times, self.states, self.n_rejected = [t0], [y], 0

    def to(self, t_end: float) -> Solution:
        control, t0 = self.control, self.times[0]
        direction, span = copysign(1.0, t_end - t0), abs(t_end - t0)
        h = control.first(self.problem.field(t0, self.states[0]), self.states[0], span, control.shortest(t0, span))
        while (rest := abs(t_end - self.times[-1])) > 0.0:
            t, is_last, h = self.times[-1], h >= rest * (1.0 - LEFTOVER), min(h, rest)
            y, error, why = self._tried(direction * h)
            if error <= 1.0:
                self.times.append(t_end if is_last else t + direction * h)
                self.states.append(y)
            elif h <= control.shortest(t, span):
                least = f"(min_step = {control.min_step:g})"
                return ended(self.solution(), f"stopped at t = {t:g}: a step of {h:.1e} is too long, {why}, and shorter ones are not allowed {least}")
            else:
                self.n_rejected += 1
            tried = len(self.times) - 1 + self.n_rejected
            if tried >= control.max_steps and self.times[-1] != t_end:
                what = f"after {tried} steps, the last of {h:.1e}; loosen rtol and atol, or raise max_steps"
                return ended(self.solution(), f"stopped at t = {self.times[-1]:g} {what}")
            h = control.after(h, error, self.order)
        return self.solution()

    def _tried(self, h: float) -> tuple[Array, float, str]:
        """The next state, its error in units of what is allowed, and words for one that is too large."""
        t, y = self.times[-1], self.states[-1]
        try:
            y_new, difference = doubled(self.coarse, self.fine, t, y, h)
        except ConvergenceError as reason:
            return y, np.inf, str(reason)
        error = self.control.excess(error_weights(self.problem, h) * difference / (2.0**self.order - 1.0), y, y_new)
        return y_new, error, f"its error is {error:.1e} times what is allowed"

    def solution(self) -> Solution:
        nfev = self.coarse.nfev + self.fine.nfev
        return Solution(np.array(self.times), np.array(self.states), nfev, self.problem.shape, n_rejected=self.n_rejected)


def doubled(coarse: Step, fine: Step, t: float, y: Array, h: float) -> tuple[Array, Array]:
    """Two steps of h/2, and how far one step of h is from them.

    coarse, fine : the same method on the same problem, twice, so that each remembers its own last state.
    """
    one = coarse(t, y, h)
    two = fine(t + 0.5 * h, fine(t, y, 0.5 * h), 0.5 * h)
    return two, two - one
