"""Runs of small problems: fixed steps, steps up to a time, steps chosen by their error, steps that stay reversible.

All drivers keep states in one loop, Path.through; they differ in how the next state follows.

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

Störmer's two-step recursion for q″ = f(q), and its summed form:

    two-step   q_{n+1} − 2q_n + q_{n−1} = Δt² f(q_n)
    summed     d_n = d_{n−1} + Δt² f(q_n),   q_{n+1} = q_n + d_n

Both are velocity Verlet with the velocities eliminated, v_n = (q_{n+1} − q_{n−1})/2Δt. In exact arithmetic they give
the same path. In floating point the recursion adds Δt² f to numbers of order one, and its rounding errors grow as n² ε.
The summed form adds Δt² f to the small increments first, and its errors grow as n ε (P. Henrici, Discrete Variable
Methods in ODEs (1962), 6.4; E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), III.10).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import chain, repeat
from math import copysign, isfinite, log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.compiled.machine import EPS
from minimd.core.console.display import Displayed, Rows
from minimd.core.console.words import shown
from minimd.core.integrators.method import Method, Problem, check_class
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import (
    COUNTS,
    checked_count,
    checked_kind,
    checked_number,
    checked_numbers,
)
from minimd.core.structure.errors import ConvergenceError, NonFiniteError
from minimd.textbook.ode.problems import DifferentialAlgebraic, Partitioned

__all__ = [
    "DensityControl",
    "Solution",
    "StepControl",
    "run_adaptive",
    "run_reversible",
    "run_steps",
    "run_until",
    "stormer_summed",
    "stormer_two_step",
]

REACHED = "the end was reached"
# of a step: a shorter rest is rounding of the times, and belongs to the step before
LEFTOVER = 1e-12
# factor of the proposed step; bounds of its change from one step to the next: Hairer et al., II.4
SAFETY = 0.9
SHRINK = 0.2
GROW = 5.0
# ρ ∝ |f|^¾: around a mass ρ ∝ r^(−3/2), so that steps are proportional to the free-fall time
EXPONENT = 0.75
# of the time in which q changes by its size: truncation and rounding of d ln |f|/dt are then alike, 1e-10
DIFFERENCE = 1e-5
Rate = Callable[[float, Array, Array], float]
Start = tuple[ArrayLike, ArrayLike]
States = Iterable[tuple[float, Array]]


@dataclass(repr=False)
class Solution(Displayed):
    """A path on a grid of times.

    t : (n + 1,) times.
    y : (n + 1, size) states.
    q, v : (n + 1, …) positions and velocities, of problems with them.
    nfev : evaluations of the right-hand side (of f, for problems with q and v).
    n_rejected : steps tried in vain.
    success, message : whether the end was reached, and if not, why; if so, what limits the accuracy beside the method
        and rounding.
    density : of run_reversible, (n + 1,) values of ρ at its times, dimensionless, for a run on or back."""

    t: Array
    y: Array
    nfev: int
    shape: tuple[int, ...] | None = None
    success: bool = True
    message: str = REACHED
    n_rejected: int = 0
    density: Array | None = None

    def __repr__(self) -> str:
        return f"Solution({len(self.t)} states at t = {self.t[0]:.6g} to {self.t[-1]:.6g})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        n = self.y.shape[1]
        size = f"{n} numbers" if self.shape is None else f"q and v of shape {self.shape}"
        rows = [
            ("states", f"{len(self.t)} of {size}, t = {self.t[0]:.6g} to {self.t[-1]:.6g}"),
            ("evaluations", f"{self.nfev}"),
            ("outcome", self.message),
        ]
        if self.n_rejected:
            rows.append(("rejected", f"{self.n_rejected} steps"))
        return rows

    @property
    def q(self) -> Array:
        """(n + 1, …) positions."""
        return self._halves[:, 0]

    @property
    def v(self) -> Array:
        """(n + 1, …) velocities."""
        return self._halves[:, 1]

    @property
    def _halves(self) -> Array:
        if self.shape is None:
            raise AttributeError("this problem has no q and v; its states are in y")
        return self.y.reshape(-1, 2, *self.shape)


class Path:
    """The states that are kept of a run: every so many, and the last one.
    counts : what has counted evaluations, in nfev.
    stopped : why a run ended early; empty if it did not.
    densities : ρ at the times of reversible steps."""

    def __init__(self, problem: Problem, start: Any, t0: float, every: int = 1) -> None:
        if not hasattr(problem, "begin"):
            raise TypeError(
                f"problem must be a differential equation, such as SecondOrder(f); got {shown(problem)}"
            )
        self.problem: Any = problem
        self._every = checked_count("every", every)
        self.times = [t0]
        self.states = [problem.begin(start, t0)]
        self.n_rejected = 0
        self.stopped = ""
        self.counts = list[Any]()
        self.densities = dict[float, float]()

    def step(self, method: type[Method]) -> Any:
        """The step of a method, whose evaluations are counted."""
        self.counts.append(method.on(self.problem))
        return self.counts[-1]

    def through(self, states: States, timestep: float | None = None) -> Any:
        """The solution with these states, each the next one.
        Raises ConvergenceError or NonFiniteError if a step cannot be made; error.solution is the path before."""
        kept_times = self.times
        kept_states = self.states
        every = self._every
        n = 0
        try:
            for t, y in states:
                if n % every != 0:  # the last one is kept only if its number is a multiple of every
                    del kept_times[-1], kept_states[-1]
                kept_times.append(t)
                kept_states.append(y)
                n += 1
        except (ConvergenceError, NonFiniteError) as error:
            step = f"step {n + 1} from t = {kept_times[-1]:g}"
            if timestep is None:
                self.stopped = f"{step}: {error}"
            else:
                self.stopped = f"{step} with timestep {timestep:g}: {error}; reduce the timestep"

            raise failed(type(error), self.solution()) from None

        return self.solution()

    def solution(self) -> Solution:
        """Of the states so far."""
        remark = self.problem.remark
        densities = [self.densities[t] for t in self.times] if self.densities else None
        return Solution(
            t=np.array(self.times),
            y=np.array(self.states),
            nfev=sum(getattr(step, "nfev", 0) for step in self.counts),
            shape=self.problem.shape,
            success=not self.stopped,
            message=self.stopped or (f"{REACHED}; {remark}" if remark else REACHED),
            n_rejected=self.n_rejected,
            density=None if densities is None else np.array(densities),
        )


Failure = ConvergenceError | NonFiniteError


def failed(kind: type[Failure], path: Solution) -> Failure:
    """The error of a run, with the words and the path of its solution, error.solution."""
    error = kind(path.message)
    error.solution = path
    return error


def run_steps(
    problem: Problem, method: Method, start: Any, n_steps: int, t0: float = 0.0, every: int = 1
) -> Solution:
    """A fixed number of steps of the method's time step.

    Parameters
    ----------
    problem : SecondOrder, Partitioned, FirstOrder, or a differential-algebraic one.
    method : a method with its time step, such as VelocityVerlet(0.05).
    start : (q, v), or y, at time t0.
    every : steps between the states that are kept; the last one is kept too.

    Raises
    ------
    TypeError : for anything but a problem and a method with its time step.
    ValueError : for counts below 1, a time that is not finite, or a start that does not fit the problem.
    ConvergenceError, NonFiniteError : if a step cannot be made; error.solution is the path before.
    """
    check_method(method)
    checked_count("n_steps", n_steps)
    checked_number("t0", t0)
    return _fixed(Path(problem, start, t0, every), method, repeat(method.timestep, n_steps))


def run_until(
    problem: Problem, method: Method, start: Any, t_end: float, t0: float = 0.0, every: int = 1
) -> Solution:
    """Steps of the method's time step up to t_end, the last one shortened to end there.

    Parameters, Raises : as run_steps; t_end must lie on the side of t0 to which the time step leads."""
    check_method(method)
    h = method.timestep
    n_steps = checked_span(t0, t_end, h)
    whole = int(n_steps * (1.0 + LEFTOVER) + LEFTOVER)
    rest = t_end - (t0 + whole * h)
    lengths = chain(repeat(h, whole), [rest] if rest / h > LEFTOVER * n_steps else [])
    return _fixed(Path(problem, start, t0, every), method, lengths, t_end)


def _fixed(
    path: Path, method: Method, lengths: Iterable[float], t_end: float | None = None
) -> Solution:
    """Steps of these lengths.  The states are looked at once they are all there; those before the first that is not
    finite are the solution of the NonFiniteError."""
    h = method.timestep
    step = path.step(type(method))

    def states() -> States:
        t0 = path.times[0]
        y = path.states[0]
        for n, length in enumerate(lengths, 1):
            y = step(t0 + (n - 1) * h, y, length)
            yield t0 + n * h, y

    solution = path.through(states(), h)
    t = solution.t
    y = solution.y
    if t_end is not None:
        t[-1] = t_end
    if np.isfinite(y[-1]).all():
        return solution
    first = np.argmin(np.isfinite(y).all(axis=1))
    why = (
        f"the state is not finite at t = {t[first]:g}; the last finite one is at t = {t[first - 1]:g}; "
        f"reduce the timestep ({h:g}), or look for a singularity of the problem"
    )
    finite = replace(solution, t=t[:first], y=y[:first], success=False, message=why)
    raise failed(NonFiniteError, finite)


def check_method(method: Method) -> None:
    """TypeError for anything but a method with its time step."""
    checked_kind(
        "method", method, Method, "a method with its time step, such as VelocityVerlet(0.05)"
    )


def checked_span(t0: float, t_end: float, timestep: float | None = None) -> float:
    """The time from t0 to t_end, in time steps or, without one, whichever its direction.
    ValueError unless both times are finite, and t_end lies on the side of t0 to which the time step leads."""
    span = checked_number("t_end", t_end) - checked_number("t0", t0)
    n_steps = abs(span) if timestep is None else span / timestep
    if not 0.0 < n_steps < COUNTS:
        raise ValueError(
            f"t_end must lie ahead of t0, by fewer than 9e18 steps; t0 = {t0!r}, t_end = {t_end!r}, "
            f"timestep = {timestep!r}"
        )
    return n_steps


@dataclass(frozen=True)
class StepControl:
    """Allowed error and length of steps.

    A step is accepted if its error, in root mean square over atol + rtol |y|, is at most 1.

    Parameters
    ----------
    rtol, atol : relative and absolute error allowed per step; atol may differ from component to component.
    first_step, min_step, max_step : lengths of steps [time], positive.
    max_steps : int, limit of accepted and rejected steps together.

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
        is_positive = checked_number("rtol", self.rtol) > 0.0 or np.all(atol > 0.0)
        if not (self.rtol >= 0.0 and np.all(atol >= 0.0) and is_positive):
            raise ValueError(
                f"rtol and atol must not be negative, nor both zero; rtol = {self.rtol!r}, atol = {self.atol!r}"
            )
        if self.first_step is not None:
            checked_number("first_step", self.first_step, "positive and finite")
        if self.max_step != np.inf:
            checked_number("max_step", self.max_step)
        least = checked_number("min_step", self.min_step)
        if not 0.0 <= least <= self.max_step or self.max_step == 0.0:
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
        size = self._norm(y, np.abs(y))
        rate = self._norm(slope, np.abs(y))
        is_moving = size > 0.0 < rate < np.inf
        guess = 0.01 * size / rate if is_moving else 1e-3 * span
        return self.clipped(self.first_step or max(min(span, guess), shortest))

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
        """Root mean square of difference/(atol + rtol size); no difference is zero even where nothing is allowed."""
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
    TypeError : for anything but a problem, a method without a time step, and StepControl.
    ValueError : if atol does not fit y.
    A run that needs too many steps, or steps below min_step or the spacing of numbers at t, ends early:
    solution.success is False.
    """
    checked_span(t0, t_end)
    check_class(method)
    checked_kind("control", control, StepControl, "StepControl(rtol, atol)")
    path = Path(problem, start, t0)
    y = path.states[0]
    shape = np.shape(control.atol)
    if shape not in ((), y.shape):
        raise ValueError(
            f"atol must be a number, or an array of length {y.size}, one for each component of y; got shape {shape}"
        )

    return path.through(_adaptive(path, method, t_end, control))


def _adaptive(path: Path, method: type[Method], t_end: float, control: StepControl) -> States:
    """The accepted states, each after two steps of h/2."""
    problem = path.problem
    order = method.order_on(problem)
    n = 0
    t = path.times[0]
    y = path.states[0]
    # each remembers its own last state
    coarse = path.step(method)
    fine = path.step(method)
    direction = copysign(1.0, t_end - t)
    span = abs(t_end - t)
    h = control.first(problem.field(t, y), y, span, control.shortest(t, span))

    while t != t_end:
        rest = abs(t_end - t)
        is_last = h >= rest * (1.0 - LEFTOVER)
        h = min(h, rest)
        signed = direction * h
        half = 0.5 * signed
        try:
            y_coarse = coarse(t, y, signed)
            y_fine = fine(t + half, fine(t, y, half), half)
        except ConvergenceError as reason:
            error = np.inf
            why = str(reason)
        else:
            difference = y_fine - y_coarse
            if isinstance(problem, DifferentialAlgebraic):
                difference = problem.error_weights(signed) * difference
            error = control.excess(difference / (2.0**order - 1.0), y, y_fine)
            why = f"its error is {error:.1e} times what is allowed"

        if error <= 1.0:
            t = t_end if is_last else t + signed
            y = y_fine
            yield t, y
        elif h <= control.shortest(t, span):
            path.stopped = (
                f"stopped at t = {t:g}: a step of {h:.1e} is too long, {why}, and shorter ones are not allowed "
                f"(min_step = {control.min_step:g})"
            )
            return
        else:
            path.n_rejected += 1

        n += 1
        if n >= control.max_steps and t != t_end:
            path.stopped = (
                f"stopped at t = {t:g} after {n} steps, the last of {h:.1e}; "
                "loosen rtol and atol, or raise max_steps"
            )
            return

        h = control.after(h, error, order)


@dataclass(frozen=True)
class DensityControl:
    """The density of steps, ρ.

    Parameters
    ----------
    rate : G(t, q, v) = d ln ρ/dt [1/time], odd in v; if not given, ρ follows |f|^¾, at two more evaluations per step.
    density : ρ at the start, dimensionless.
    max_steps : int, limit of the number of steps.

    Raises
    ------
    ValueError : if the density is not positive and finite, or max_steps is not a whole number, at least 1.
    TypeError : if the rate is no function.
    """

    rate: Rate | None = None
    density: float = 1.0
    max_steps: int = 1_000_000

    def __post_init__(self) -> None:
        checked_kind("rate", self.rate, Callable | None, "a function G(t, q, v)")
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
) -> Solution:
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
    ConvergenceError, NonFiniteError : as run_steps, or if ρ is no longer positive.
    A run that needs too many steps ends early: solution.success is False.
    """
    check_method(method)
    checked_span(t0, t_end, method.timestep)
    checked_count("every", every)
    checked_kind("control", control, DensityControl, "DensityControl(rate, density, max_steps)")
    if not method.is_symmetric:
        raise ValueError(
            f"reversible steps need a symmetric method, such as VelocityVerlet; {method.name} is not"
        )

    path = Path(problem, start, t0, every)
    return path.through(_reversible(path, method, t_end, control), method.timestep)


def _reversible(path: Path, method: Method, t_end: float, control: DensityControl) -> States:
    """States of steps ε/ρ; ρ changes by half of ε G before and after each."""
    problem = path.problem
    epsilon = method.timestep
    n = 0
    t = path.times[0]
    y = path.states[0]
    step = path.step(type(method))
    rate = control.rate or _Fall(problem, abs(epsilon))
    path.counts.append(rate)
    # between the density of the last step and that of the next one
    rho = path.densities[t] = control.density
    change = epsilon * float(rate(t, *problem.halves(y)))

    while (t_end - t) * copysign(1.0, epsilon) > 0.0 and n < control.max_steps:
        rho += 0.5 * change
        if not rho > 0.0 or t + epsilon / rho == t:
            change_of_density = "fell" if rho <= 0.0 else "grew"
            raise ConvergenceError(f"the density of steps {change_of_density} to {rho:.1e}")
        h = epsilon / rho
        rest = t_end - t
        is_last = abs(h) >= abs(rest) - LEFTOVER * max(abs(t), abs(t_end))
        y = step(t, y, rest if is_last else h)
        t = t_end if is_last else t + h
        n += 1
        if not np.isfinite(y).all():
            raise NonFiniteError("the state is no longer finite")
        change = epsilon * float(rate(t, *problem.halves(y)))
        rho = path.densities[t] = rho + 0.5 * change
        yield t, y

    if t != t_end:
        path.stopped = (
            f"stopped at t = {t:g} after {n} steps, where their density ρ is {rho:.1e}; "
            "raise max_steps or the timestep"
        )


class _Fall:
    """G = ¾ d ln |f(t, q)|/dt along v, by a central difference: exactly odd in v, and independent of units."""

    def __init__(self, problem: Partitioned, timestep: float) -> None:
        self.problem = problem
        self.timestep = timestep
        self.nfev = 0

    def __call__(self, t: float, q: Array, v: Array) -> float:
        speed = float(np.linalg.norm(v))
        if speed == 0.0:
            return 0.0
        delta = DIFFERENCE * max(float(np.linalg.norm(q)) / speed, self.timestep)
        ahead = float(np.linalg.norm(self.problem.f(t, q + delta * v, v)))
        behind = float(np.linalg.norm(self.problem.f(t, q - delta * v, v)))
        self.nfev += 2
        is_known = ahead > 0.0 < behind and isfinite(ahead * behind)
        return EXPONENT * log(ahead / behind) / (2.0 * delta) if is_known else 0.0


Acceleration = Callable[[Array], ArrayLike]


def stormer_two_step(
    f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int
) -> Solution:
    """The two-step recursion, started with q₁ = q₀ + Δt v₀ + ½Δt² f(q₀).

    Parameters
    ----------
    f : acceleration of positions, both of the shape of q0 [length/time²].
    q0, v0 : start [length], [length/time].
    timestep : Δt [time], negative to run backwards.
    n_steps : at least 1.

    Raises
    ------
    ValueError : if the time step is zero or not finite, n_steps below 1, or the shapes of q0, v0 and f(q0) differ.
    """

    def advance(q: Array, increments: Array, n: int, push: Array) -> None:
        q[n + 1] = 2.0 * q[n] - q[n - 1] + push
        increments[n - 1 : n + 1] = q[n : n + 2] - q[n - 1 : n + 1]

    return _stormer(f, q0, v0, timestep, n_steps, advance)


def stormer_summed(
    f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int
) -> Solution:
    """The recursion for the increments d_n = q_{n+1} − q_n: the same path with far less round-off over many steps.

    Parameters, Raises : as stormer_two_step."""

    def advance(q: Array, increments: Array, n: int, push: Array) -> None:
        increments[n] = increments[n - 1] + push
        q[n + 1] = q[n] + increments[n]

    return _stormer(f, q0, v0, timestep, n_steps, advance)


def _stormer(
    f: Acceleration,
    q0: ArrayLike,
    v0: ArrayLike,
    timestep: float,
    n_steps: int,
    advance: Callable[..., None],
) -> Solution:
    """The path without the position after the end, which is needed for the last velocity only.
    advance : finds q_{n+1} and the increments from q_{n−1}, q_n and Δt² f(q_n)."""
    q0 = checked_numbers("q0", q0, "numbers")
    v0 = checked_numbers("v0", v0, "numbers")
    checked_number("timestep", timestep, "finite and not zero")
    checked_count("n_steps", n_steps)
    a0 = np.asarray(f(q0), dtype=float)
    if not q0.shape == v0.shape == a0.shape:
        raise ValueError(
            f"q0, v0 and f(q0) must have the same shape; got {q0.shape}, {v0.shape} and {a0.shape}"
        )

    n_states = n_steps + 1
    q = np.empty((n_states + 1, *q0.shape))
    increments = np.empty((n_states, *q0.shape))
    increments[0] = timestep * v0 + 0.5 * timestep**2 * a0
    q[0] = q0
    q[1] = q0 + increments[0]
    for n in range(1, n_states):
        advance(q, increments, n, timestep**2 * np.asarray(f(q[n])))
    v = [v0, *(increments[1:] + increments[:-1]) / (2.0 * timestep)]
    t = np.linspace(0.0, n_steps * timestep, n_states)
    y = np.stack([q[:-1], v], axis=1).reshape(n_states, -1)
    return Solution(t, y, nfev=n_states, shape=q0.shape)
