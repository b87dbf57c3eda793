"""Steps of varying length that keep a symmetric method symmetric: the integrating controller.

    ρ_{n+1/2} = ρ_{n−1/2} + ε G(y_n),      y_{n+1} = Φ_{ε/ρ_{n+1/2}}(y_n),      G = d ln ρ/dt along the solution

Steps are dense (ρ large) where the solution changes fast. Density and state are advanced in turn, so that the scheme is symmetric. It
is reversible if G changes sign with the velocities. The energy of Hamiltonian problems then oscillates; it drifts if each step is
chosen by an estimate of its error.
E. Hairer, G. Söderlind, SIAM J. Sci. Comput. 26, 1838 (2005), eq. 3.2-3.4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import copysign, isfinite, log

import numpy as np
from numpy.typing import ArrayLike

from minimd.integrators.method import Array, Method
from minimd.integrators.ode.drivers import LEFTOVER, Solution, check_ahead, check_method, check_problem, end_message, with_path
from minimd.integrators.ode.partitioned import Partitioned
from minimd.structure.checks import checked_count, checked_number, shown
from minimd.structure.errors import ConvergenceError, NonFiniteError

__all__ = ["DensityControl", "run_reversible"]

Rate = Callable[[float, Array, Array], float]
Start = tuple[ArrayLike, ArrayLike]
EXPONENT = 0.75  # ρ ∝ |f|^¾: around a mass ρ ∝ r^(−3/2), so that steps are proportional to the free-fall time
DIFFERENCE = 1e-5  # of the time in which q changes by its size: truncation and rounding of d ln |f|/dt are then alike, 1e-10


@dataclass
class ReversibleSolution(Solution):
    """A Solution with density : (n + 1,) values of ρ at its times, dimensionless, for a run that continues or goes back."""

    density: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class DensityControl:
    """The density of steps, ρ.

    Parameters
    ----------
    rate : G(t, q, v) = d ln ρ/dt [1/time], odd in v. If not given, ρ follows |f|^¾, at two more evaluations of f per step.
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
    problem: Partitioned, method: Method, start: Start, t_end: float, t0: float = 0.0, control: DensityControl = DensityControl(), every: int = 1
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
    ConvergenceError, NonFiniteError : if a step cannot be made, or ρ is no longer positive; error.solution holds the path before.
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
    return _Path(problem, method, problem.begin(start, t0), t0, control).to(t_end, every)


class _Path:
    """State, time and density, and those that are kept for the solution."""

    def __init__(self, problem: Partitioned, method: Method, y: Array, t0: float, control: DensityControl) -> None:
        self.problem, self.epsilon, self.max_steps, self.y, self.t = problem, method.timestep, control.max_steps, y, t0
        self.step = type(method).on(problem)
        self.rate = control.rate or _Fall(problem, abs(method.timestep))
        self.rho = control.density  # at the last state: between the density of the last step and that of the next one
        self.kept: list[tuple[float, Array, float]] = [(t0, y, self.rho)]

    def to(self, t_end: float, every: int) -> ReversibleSolution:
        n, direction, change = 0, copysign(1.0, self.epsilon), self._change()
        try:
            while (t_end - self.t) * direction > 0.0 and n < self.max_steps:
                n += 1
                change = self._advance(t_end, change)
                if (n - 1) % every != 0:
                    del self.kept[-1]  # it was the last one, and its number is no multiple of every
                self.kept.append((self.t, self.y, self.rho))
        except (ConvergenceError, NonFiniteError) as reason:
            error = type(reason)(f"step {n} from t = {self.t:g}: {reason}; reduce the timestep ({self.epsilon:g})")
            raise with_path(error, self.solution()) from None
        if self.t != t_end:
            return self.solution().ended(f"stopped at t = {self.t:g} after {n} steps, where ρ = {self.rho:.1e}; raise max_steps or the timestep")
        return self.solution()

    def _advance(self, t_end: float, change: float) -> float:
        """One step. change : ε G at its start; returns ε G at its end. Half of each is added to ρ, before and after the step."""
        rho = self.rho + 0.5 * change
        if not rho > 0.0 or self.t + self.epsilon / rho == self.t:
            raise ConvergenceError(f"the density of steps {'fell' if rho <= 0.0 else 'grew'} to {rho:.1e}")
        h, rest = self.epsilon / rho, t_end - self.t
        is_last = abs(h) >= abs(rest) - LEFTOVER * max(abs(self.t), abs(t_end))
        y = self.step(self.t, self.y, rest if is_last else h)
        if not np.isfinite(y).all():
            raise NonFiniteError("the state is no longer finite")
        self.t, self.y = (t_end if is_last else self.t + h), y
        change = self._change()
        self.rho = rho + 0.5 * change
        return change

    def _change(self) -> float:
        """ε G at the present state."""
        return self.epsilon * float(self.rate(self.t, *self.problem.halves(self.y)))

    def solution(self) -> ReversibleSolution:
        t, y, rho = zip(*self.kept, strict=True)
        nfev = self.step.nfev + getattr(self.rate, "nfev", 0)
        return ReversibleSolution(np.array(t), np.array(y), nfev, self.problem.shape, message=end_message(self.problem), density=np.array(rho))


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
        return EXPONENT * log(ahead / behind) / (2.0 * delta) if ahead > 0.0 < behind and isfinite(ahead * behind) else 0.0
