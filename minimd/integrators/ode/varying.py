"""Steps of varying length: adaptive ones, and those that keep a symmetric method symmetric.

Adaptive: the length of a step follows from its error, estimated by step doubling.

    error ≈ ‖y_h − y_{h/2, h/2}‖₂ / (2ᵖ − 1)          one step against two half as long, p the order

This works for every one-step method. The result of the two short steps is kept, without extrapolation, so that what the
method conserves in a step stays conserved. E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), II.4.

Reversible: the integrating controller.

    ρ_{n+1/2} = ρ_{n−1/2} + ε G(y_n),      y_{n+1} = Φ_{ε/ρ_{n+1/2}}(y_n),      G = d ln ρ/dt along the solution

Steps are dense (ρ large) where the solution changes fast. Density and state are advanced in turn, so that the scheme is
symmetric. It is reversible if G changes sign with the velocities. The energy of Hamiltonian problems then oscillates;
it drifts if each step is chosen by an estimate of its error. E. Hairer, G. Söderlind, SIAM J. Sci. Comput. 26,
1838 (2005), eq. 3.2-3.4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import copysign, isfinite, log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.compiled.machine import EPS
from minimd.console.words import shown
from minimd.integrators.method import Array, Method, Problem
from minimd.integrators.ode.drivers import (
    LEFTOVER,
    Path,
    Solution,
    check_ahead,
    check_method,
    check_problem,
    with_path,
)
from minimd.integrators.ode.partitioned import Partitioned
from minimd.integrators.ode.problems import DifferentialAlgebraic
from minimd.structure.checks import checked_count, checked_number, checked_numbers
from minimd.structure.errors import ConvergenceError, NonFiniteError

__all__ = ["DensityControl", "StepControl", "run_adaptive", "run_reversible"]

# factor of the proposed step; bounds of its change from one step to the next: Hairer et al., II.4
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0
Rate = Callable[[float, Array, Array], float]
Start = tuple[ArrayLike, ArrayLike]
EXPONENT = 0.75  # ρ ∝ |f|^¾: around a mass ρ ∝ r^(−3/2), so that steps are proportional to the free-fall time
# of the time in which q changes by its size: truncation and rounding of d ln |f|/dt are then alike, 1e-10
DIFFERENCE = 1e-5


@dataclass(frozen=True)
class StepControl:
    """Allowed error and length of steps.

    A step is accepted if its error, in root mean square over atol + rtol |y|, is at most 1.

    Parameters
    ----------
    rtol, atol : relative and absolute error allowed per step; atol may differ from component to component.
    first_step, min_step, max_step : lengths of steps [time], positive.  max_steps : int,
        limit of accepted and rejected steps together.

    Raises
    ------
    ValueError : for tolerances, lengths or a count out of range.
    """

    rtol: float = 1e-6
    atol: ArrayLike = 1e-9
    first_step: float | None = None
    min_step: float = 0.0
    max_step: float = np.inf
    max_steps: int = 1_000_000

    def __post_init__(self) -> None:
        atol = checked_numbers("atol", self.atol, "one number, or one for each component")
        if not (
            checked_number("rtol", self.rtol) >= 0.0 and np.all(atol >= 0.0) and (self.rtol > 0.0 or np.all(atol > 0.0))
        ):
            raise ValueError(
                f"rtol and atol must not be negative, nor both zero; rtol = {self.rtol!r}, atol = {self.atol!r}"
            )
        if self.first_step is not None:
            checked_number("first_step", self.first_step, "positive and finite")
        longest = self.max_step if self.max_step == np.inf else checked_number("max_step", self.max_step)
        if not 0.0 <= checked_number("min_step", self.min_step) <= longest or longest == 0.0:
            raise ValueError(
                f"0 <= min_step <= max_step is needed; min_step = {self.min_step!r}, max_step = {self.max_step!r}"
            )
        checked_count("max_steps", self.max_steps)

    def excess(self, error: Array, y: Array, y_new: Array) -> float:
        """The error divided by the allowed one; infinite if it is not finite."""
        ratio = self._norm(error, np.maximum(np.abs(y), np.abs(y_new)))
        return ratio if isfinite(ratio) else np.inf

    def first(self, slope: Array, y: Array, span: float, shortest: float) -> float:
        """The first step: first_step, or a hundredth of the time in which the state changes by its own size."""
        size, rate = self._norm(y, np.abs(y)), self._norm(slope, np.abs(y))
        guess = min(span, 0.01 * size / rate if size > 0.0 < rate < np.inf else 1e-3 * span)
        return self.clipped(self.first_step or max(guess, shortest))

    def after(self, h: float, error: float, order: int) -> float:
        """The next step: it should just meet the tolerance, as the error of a step grows as hᵖ⁺¹."""
        factor = SAFETY * max(error, 1e-10) ** (-1.0 / (order + 1)) if isfinite(error) else SHRINK
        return self.clipped(h * min(max(factor, SHRINK), GROW))

    def clipped(self, h: float) -> float:
        """h within the bounds."""
        return min(max(h, self.min_step), self.max_step)

    def shortest(self, t: float, span: float) -> float:
        """The length below which no step is tried: min_step, or a few roundings of t."""
        return max(self.min_step, 16.0 * np.spacing(max(abs(t), EPS * span)))

    def _norm(self, difference: Array, size: Array) -> float:
        """Root mean square of difference/(atol + rtol size);
        a difference of zero counts as zero even where nothing is allowed."""
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
    """Adaptive steps to t_end, with errors estimated by step doubling. solution.n_rejected counts the rejected ones.

    Parameters
    ----------
    method : a one-step method without a time step, such as VelocityVerlet.
    control : StepControl, such as StepControl(rtol=1e-8).

    Raises
    ------
    TypeError : for anything but a problem, a method without a time step, and StepControl.  ValueError :
        if atol does not fit y.
    A run that needs too many steps, or steps below min_step or the spacing of numbers at t, ends early:
    solution.success is False.
    """
    check_problem(problem)
    check_ahead(t0, t_end)
    if not (isinstance(method, type) and issubclass(method, Method)):
        raise TypeError(f"method must be a method without a time step, such as VelocityVerlet; got {shown(method)}")
    if not isinstance(control, StepControl):
        raise TypeError(f"control must be StepControl(rtol, atol); got {shown(control)}")
    y = problem.begin(start, t0)
    if (given := np.shape(control.atol)) not in ((), y.shape):
        raise ValueError(
            f"atol must be a number, or an array of length {y.size}, one for each component of y; got shape {given}"
        )
    return _AdaptivePath(problem, method, y, t0, control).to(t_end)


class _AdaptivePath:
    """The accepted states, and the number of rejected steps."""

    def __init__(self, problem: Problem, method: type[Method], y: Array, t0: float, control: StepControl) -> None:
        self.problem, self.control, self.order = problem, control, method.order_on(problem)
        self.coarse, self.fine = method.on(problem), method.on(problem)  # each remembers its own last state
        self.path, self.n_rejected = Path(problem, t0, y), 0

    def to(self, t_end: float) -> Solution:
        control, path, t0 = self.control, self.path, self.path.t
        direction, span = copysign(1.0, t_end - t0), abs(t_end - t0)
        h = control.first(self.problem.field(t0, path.y), path.y, span, control.shortest(t0, span))
        while (rest := abs(t_end - path.t)) > 0.0:
            t, is_last, h = path.t, h >= rest * (1.0 - LEFTOVER), min(h, rest)
            y, error, why = self._tried(direction * h)
            if error <= 1.0:
                path.keep(t_end if is_last else t + direction * h, y)
            elif h <= control.shortest(t, span):
                why = (
                    f"a step of {h:.1e} is too long, {why}, and shorter ones are not allowed (min_step = "
                    f"{control.min_step:g})"
                )
                return self.solution().ended(f"stopped at t = {t:g}: {why}")
            else:
                self.n_rejected += 1
            tried = path.n + self.n_rejected
            if tried >= control.max_steps and path.t != t_end:
                what = f"after {tried} steps, the last of {h:.1e}; loosen rtol and atol, or raise max_steps"
                return self.solution().ended(f"stopped at t = {path.t:g} {what}")
            h = control.after(h, error, self.order)
        return self.solution()

    def _tried(self, h: float) -> tuple[Array, float, str]:
        """The next state, after two steps of h/2, its error divided by the allowed one,
        and a description of the error."""
        t, y = self.path.t, self.path.y
        try:
            one = self.coarse(t, y, h)
            two = self.fine(t + 0.5 * h, self.fine(t, y, 0.5 * h), 0.5 * h)
        except ConvergenceError as reason:
            return y, np.inf, str(reason)
        weights = self.problem.error_weights(h) if isinstance(self.problem, DifferentialAlgebraic) else 1.0
        error = self.control.excess(weights * (two - one) / (2.0**self.order - 1.0), y, two)
        return two, error, f"its error is {error:.1e} times what is allowed"

    def solution(self) -> Solution:
        return self.path.solution(self.coarse.nfev + self.fine.nfev, self.n_rejected)


@dataclass
class ReversibleSolution(Solution):
    """A Solution with density : (n + 1,) values of ρ at its times, dimensionless,
    for a run that continues or goes back."""

    density: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class DensityControl:
    """The density of steps, ρ.

    Parameters
    ----------
    rate : G(t, q, v) = d ln ρ/dt [1/time], odd in v. If not given, ρ follows |f|^¾,
        at two more evaluations of f per step.
    density : ρ at the start, dimensionless.  max_steps : int, limit of the number of steps.

    Raises
    ------
    ValueError : if the density is not positive and finite, or max_steps is not a whole number, at least 1.
    """

    rate: Rate | None = None
    density: float = 1.0
    max_steps: int = 1_000_000

    def __post_init__(self) -> None:
        checked_number("density", self.density, "positive and finite")
        checked_count("max_steps", self.max_steps)


def run_reversible(
    problem: Partitioned,
    method: Method,
    start: Start,
    t_end: float,
    t0: float = 0.0,
    control: DensityControl = DensityControl(),
    every: int = 1,
) -> ReversibleSolution:
    """Steps of length timestep/ρ up to t_end, the last one shortened to end there.

    Parameters
    ----------
    problem : SecondOrder or Partitioned.
    method : a symmetric method; its time step is ε, the length of steps where ρ = 1.
    control : DensityControl: the density of steps, and how many may be made.
    every : steps between the states that are kept; the last one is kept too.

    Raises
    ------
    ValueError : if the method is not symmetric, or t_end does not lie ahead.
    ConvergenceError, NonFiniteError : if a step cannot be made, or ρ is no longer positive;
        error.solution holds the path before.
    A run that needs too many steps ends early: solution.success is False.
    """
    check_problem(problem)
    check_method(method)
    check_ahead(t0, t_end)
    checked_count("every", every)
    if not isinstance(control, DensityControl):
        raise TypeError(f"control must be DensityControl(rate, density, max_steps); got {shown(control)}")
    if not method.is_symmetric:
        raise ValueError(f"reversible steps need a symmetric method, such as VelocityVerlet; {method.name} is not")
    if (t_end - t0) * method.timestep < 0.0:
        raise ValueError(f"t_end must lie ahead; t0 = {t0!r}, t_end = {t_end!r}, {method!r}")
    return _ReversiblePath(problem, method, Path(problem, t0, problem.begin(start, t0), every), control).to(t_end)


class _ReversiblePath:
    """State, time and density, and those that are kept for the solution."""

    def __init__(self, problem: Partitioned, method: Method, path: Path, control: DensityControl) -> None:
        self.problem, self.epsilon, self.max_steps, self.path = problem, method.timestep, control.max_steps, path
        self.step = type(method).on(problem)
        self.rate = control.rate or _Fall(problem, abs(method.timestep))
        self.rho = control.density  # at the last state: between the density of the last step and that of the next one
        self.densities = {path.t: self.rho}

    def to(self, t_end: float) -> ReversibleSolution:
        path, direction, change = self.path, copysign(1.0, self.epsilon), self._change()
        try:
            while (t_end - path.t) * direction > 0.0 and path.n < self.max_steps:
                change = self._advance(t_end, change)
                self.densities[path.t] = self.rho
        except (ConvergenceError, NonFiniteError) as reason:
            words = f"step {path.n + 1} from t = {path.t:g}: {reason}; reduce the timestep ({self.epsilon:g})"
            raise with_path(type(reason)(words), self.solution()) from None
        if path.t == t_end:
            return self.solution()
        stopped = f"stopped at t = {path.t:g} after {path.n} steps, where ρ = {self.rho:.1e}"
        return self.solution().ended(f"{stopped}; raise max_steps or the timestep")

    def _advance(self, t_end: float, change: float) -> float:
        """One step.

        change : ε G at its start; returns ε G at its end. Half of each is added to ρ, before and after the step.
        """
        rho, t = self.rho + 0.5 * change, self.path.t
        if not rho > 0.0 or t + self.epsilon / rho == t:
            raise ConvergenceError(f"the density of steps {'fell' if rho <= 0.0 else 'grew'} to {rho:.1e}")
        h, rest = self.epsilon / rho, t_end - t
        is_last = abs(h) >= abs(rest) - LEFTOVER * max(abs(t), abs(t_end))
        y = self.step(t, self.path.y, rest if is_last else h)
        if not np.isfinite(y).all():
            raise NonFiniteError("the state is no longer finite")
        self.path.keep(t_end if is_last else t + h, y)
        change = self._change()
        self.rho = rho + 0.5 * change
        return change

    def _change(self) -> float:
        """ε G at the present state."""
        return self.epsilon * float(self.rate(self.path.t, *self.problem.halves(self.path.y)))

    def solution(self) -> ReversibleSolution:
        found = self.path.solution(self.step.nfev + getattr(self.rate, "nfev", 0))
        return ReversibleSolution(**vars(found), density=np.array([self.densities[t] for t in found.t.tolist()]))


class _Fall:
    """G = ¾ d ln |f(t, q)|/dt along v, by a central difference: exactly odd in v, and independent of units."""

    def __init__(self, problem: Partitioned, timestep: float) -> None:
        self.problem, self.timestep, self.nfev = problem, timestep, 0

    def __call__(self, t: float, q: Array, v: Array) -> float:
        speed = float(np.linalg.norm(v))
        if speed == 0.0:
            return 0.0
        delta = DIFFERENCE * max(float(np.linalg.norm(q)) / speed, self.timestep)
        ahead, behind = (float(np.linalg.norm(self.problem.f(t, q + side * v, v))) for side in (delta, -delta))
        self.nfev += 2
        return (
            EXPONENT * log(ahead / behind) / (2.0 * delta) if ahead > 0.0 < behind and isfinite(ahead * behind) else 0.0
        )
