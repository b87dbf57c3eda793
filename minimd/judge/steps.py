"""The grade of a step: its order, its symmetries, and what it conserves. All is measured on a few particles."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from minimd.core.structure.arrays import Array
from minimd.judge.calling import FORCES, StudentStep, understood
from minimd.judge.faults import faults_of, hidden
from minimd.judge.findings import Answer, Finding, Grade, Law, causes, judged
from minimd.judge.methods import Numbers, named, numbers_of
from minimd.judge.problems import Function, TrialProblem, difference, largest

# needed to distinguish all terms, by the shape of x
STATES = {(5, 3): 4, (5, 2): 5, (5,): 8, (): 24}
DURATION = 0.8  # errors are compared after this time
COUNTS = (8, 16, 32, 64)  # numbers of steps in this time
ORDER_OFF = 0.25  # of the slope from the order
HIGH = 2.5  # a step of higher order has the right terms up to dt²
PACE = 0.05  # time step of runs
BACK = 10  # steps back and forth
SOME = 20  # steps for momenta
LONG = 1000  # steps for the energy
DELTA = 2e-3  # of differences
NOISE = 1e-13  # of a step in float64
EXACTLY = 1e-13  # of an energy that is rescaled
TOO_LARGE = 1e6  # an energy
SYMPLECTIC = 1e-9  # JᵀΩJ − Ω
LENGTHS = np.arange(0.01, 6.001, 0.01)  # ω dt at which stability is tested


class Measured:
    """A step and what is measured on it: see Law.measure."""

    def __init__(self, step: StudentStep, where: TrialProblem, expected: int) -> None:
        self.step = step
        self.where = where
        self.expected = expected
        starts = [where.x * (1.0 + 1e-6 * k) for k in range(12)]
        ends = [np.ravel(step(where, x, where.v, 0.1)[0]) for x in starts]
        bends = np.diff(ends, n=3, axis=0)
        self.noise = largest(bends) / 8.0 / largest(where.x)
        self.fuzz = max(1.0, self.noise / NOISE)
        # springs to the origin conserve no momenta
        n_dimensions = 0 if where.stiffness else where.x.ndim
        self.has = {*("atoms", "vectors")[:n_dimensions]}
        if step.takes(*FORCES):
            self.has.add("force")

    def run(self, h: float, n: int, start: Any = None) -> tuple[Array, Array]:
        """x and v after n steps.  start : (x, v), those of the problem if not given."""
        x, v = start or self.where[:2]
        for _ in range(n):
            x, v = self.step(self.where, x, v, h)
        return x, v

    def order(self) -> Answer:
        """The slope, in a logarithmic plot, of the error after a fixed time against the time step."""
        right = self.where.flow(DURATION)
        ends = [np.array(self.run(DURATION / n, n)) for n in COUNTS]
        errors = np.array([np.linalg.norm(end - right) for end in ends])
        slope = 0.0
        if np.isfinite(errors).all():
            kept = np.flatnonzero(errors > 1e-11)[-3:]
            if len(kept) < 3:
                kept = np.arange(2)
            counts = np.array(COUNTS)[kept]
            logs = np.log(np.maximum(errors[kept], 1e-300))
            slope = -np.polyfit(np.log(counts), logs, 1)[0]

        off = max(self.expected - slope, 0.0)
        if slope < ORDER_OFF:  # the error does not decrease with dt
            off = np.inf
        shortest = DURATION / COUNTS[-1]
        sentence = (
            f"{max(slope, 0.0):.2f} measured, {self.expected} expected; error {errors[-1]:.1e} at t = {DURATION:g}, "
            f"dt = {shortest:g}"
        )
        return slope, off, sentence

    @cached_property
    def jacobian(self) -> Array:
        """∂(x₁, p₁)/∂(x, p) at Δt = 0.1."""
        where = self.where
        mass = where.mass

        def end(y: Array) -> Array:
            x, p = y.reshape(2, *where.x.shape)
            x, v = self.step(where, x, p / mass, 0.1)
            return np.ravel([x, mass * v])

        start = np.ravel([where.x, mass * where.v])
        columns = [difference(end, start, DELTA * unit) / DELTA for unit in np.eye(start.size)]
        return np.array(columns).T

    @cached_property
    def form(self) -> float:
        """The largest element of JᵀΩJ − Ω."""
        turn = [[0.0, 1.0], [-1.0, 0.0]]
        omega = np.kron(turn, np.eye(self.where.x.size))
        form = self.jacobian.T @ omega @ self.jacobian
        return largest(form - omega) / self.fuzz

    def reversal(self) -> Answer:
        """The distance from the start after steps forwards and as many back, and the way."""
        x, v = self.run(PACE, BACK)
        way = largest(x - self.where.x)
        x, v = self.run(PACE, BACK, (x, -v))
        off_x = largest(x - self.where.x)
        off_v = largest(v + self.where.v)
        off = max(off_x, off_v)
        return off, off / self.fuzz / max(1.0, way), way

    def momentum(self, of: Callable[[Array, Array], Array]) -> float:
        """The relative change of Σ of(x, mv) in some steps."""
        x, v = self.run(PACE, SOME)
        before = of(self.where.x, self.where.mass * self.where.v)
        after = of(x, self.where.mass * v)
        change = (after - before).sum(axis=0)
        return largest(change) / np.abs(before).sum() / self.fuzz

    def energy(self) -> Answer:
        """Drift of the total energy per step in a long run; a symplectic step has none, only slow oscillations."""
        x, v = self.where[:2]
        parts = np.empty((LONG, 2))  # kinetic and potential energy
        for k in range(LONG):
            x, v = self.step(self.where, x, v, PACE)
            kinetic = 0.5 * np.sum(self.where.mass * v * v)
            _, potential = self.where.at(x)
            parts[k] = kinetic, potential
            if not abs(kinetic + potential) < TOO_LARGE:
                sentence = f"grows beyond {TOO_LARGE:g} in {k + 1} steps of {PACE:g}"
                return np.inf, np.inf, sentence

        times = np.arange(LONG)
        energies = parts.sum(axis=1) / parts.mean(axis=0)[0]
        slope, start = np.polyfit(times, energies, 1)
        oscillation = np.std(energies - slope * times - start)
        off = 0.0
        if self.form > SYMPLECTIC:  # others keep it by their high order
            if oscillation < EXACTLY:
                sentence = "constant to rounding: no explicit step has this property by itself"
                return 0.0, np.inf, sentence
            off = abs(slope) * LONG / max(1e-9, oscillation)
        sentence = "does not drift"
        if off > 1.0:
            sentence = f"changes by {slope:.1e} of the kinetic energy per step"
        return slope, off, f"{sentence}; it oscillates by {oscillation:.1e} (dt = {PACE:g})"

    def oscillator(self) -> Answer:
        """The step as a matrix, for x″ = −x: its determinant, the quadratic form that it conserves, and the longest
        stable step."""
        omega = np.sqrt(self.step.stiffness or 1.0)
        where = self.step.problem(1, stiffness=float(omega**2))
        where = where._replace(m=np.ones_like(where.m))
        units = np.ones_like(where.x)

        def end(x: float, v: float, h: float) -> tuple[float, float]:
            new_x, new_v = self.step(where, x * units, v * units, h / omega)
            return new_x.flat[0], new_v.flat[0]

        def matrix(h: float) -> Array:
            columns = [end(1.0, 0.0, h), end(0.0, omega, h)]
            return np.array(columns).T / np.array([[1.0], [omega]])

        m = matrix(0.5)
        off = np.linalg.det(m) - 1.0
        if not abs(off) <= 1e-7:
            sentence = (
                f"at ω dt = 0.5 the energy changes by the factor {1.0 + off:.4g} in each step"
            )
            return off, np.inf, sentence

        skew = (m[1, 1] - m[0, 0]) / m[0, 1]
        stiffness = -m[1, 0] / m[0, 1]
        n_stable = 0
        for h in LENGTHS:
            if abs(np.trace(matrix(h))) > 2.0 + 1e-9:
                break
            n_stable += 1
        longest = 0.01 * n_stable
        mixed = f" {skew:+.4g} ω x v" if abs(skew) > 1e-9 else ""
        sentence = f"at ω dt = 0.5 it conserves v² {stiffness:+.6g} ω² x²{mixed}; stable up to ω dt = {longest:.2f}"
        return longest, 0.0 if n_stable else np.inf, sentence

    def cost(self) -> Answer:
        """The number of force evaluations in one step."""
        self.step.n_evaluations = 0
        self.run(PACE, 1)
        n = self.step.n_evaluations
        advice = ""
        if n == 2 and not self.step.takes("known"):
            advice = "; one is enough if the force at the end of a step is kept for the next step"
        return n, 0.0 if n == 1 else np.nan, advice


def angular_momenta(x: Array, p: Array) -> Array:
    """x_a p_b − x_b p_a of each atom, (N, 3, 3)."""
    products = x[:, :, None] * p[:, None]
    return products - products.swapaxes(1, 2)


PHASE_SPACE = (
    "the step, like Runge-Kutta methods and thermostats, shrinks or stretches phase space, or is not a product of "
    "kicks and drifts (see the laws symplectic and volume): the energy drifts"
)
LAWS = (
    Law(
        "order",
        Measured.order,
        ORDER_OFF,
        "{2}",
        "the terms up to dt² are right, but the measured order is {0:.2f}",
    ),
    Law("symplectic", lambda s: s.form, SYMPLECTIC, "at dt = 0.1 JᵀΩJ − Ω is {0:.1e}", PHASE_SPACE),
    Law(
        "volume",
        lambda s: (np.linalg.det(s.jacobian) - 1.0) / s.fuzz,
        1e-8,
        "det J − 1 is {0:.1e}",
        PHASE_SPACE,
    ),
    Law(
        "reversible",
        Measured.reversal,
        1e-11,
        f"{BACK} steps and as many back miss the start by {{0:.1e}} on a way of {{2:.2g}}",
        "the step is not symmetric: kicks and drifts do not read the same forwards and backwards",
    ),
    Law(
        "momentum",
        lambda s: s.momentum(lambda x, p: p),
        1e-11,
        f"changes by {{0:.1e}} of Σ|mv| in {SOME} steps",
        "the total momentum changes: the forces of a step are not all computed at the same positions",
        "atoms",
    ),
    Law(
        "angular momentum",
        lambda s: s.momentum(angular_momenta),
        1e-11,
        f"changes by {{0:.1e}} of Σ|r × mv| in {SOME} steps",
        "the total angular momentum changes",
        "vectors",
    ),
    Law("energy", Measured.energy, 1.0, "{2}", "the energy drifts"),
    Law(
        "oscillator",
        Measured.oscillator,
        1.0,
        "{2}",
        "the energy of an oscillator is kept at no time step",
    ),
    Law("cost", Measured.cost, 0.5, "{0} force evaluations per step{2}", needs="force"),
)
REMARKS = (
    (lambda step: step.swapped, "the step returns v before x; the usual order is x, v"),
    (
        lambda step: step.in_place,
        "the step changes the arrays that it is given; copy them if you need the old ones",
    ),
    (lambda step: step.masses == "(N, 1)", "masses must have shape (N, 1) in this step, not (N,)"),
    (
        lambda step: step.takes(*FORCES) and not step.takes("m", "acceleration"),
        "the step takes no masses: it is right only for m = 1",
    ),
    (
        lambda step: step.takes("half"),
        "velocities are at half steps: the test adds half a kick before and after",
    ),
    (
        lambda step: step.takes("old"),
        "a recursion of two positions; the test takes v = (x₁ − x₀)/dt + ½ dt F/m",
    ),
    (
        lambda step: step.takes("before"),
        "a step that takes the force of the previous step is not a map of x and v, and is not judged as one",
    ),
)
# open for a step that is no map
NO_MAP = {"reversible", "symplectic", "volume", "angular momentum", "energy", "oscillator"}
RUNGE_KUTTA = "a Runge-Kutta method: it is not symplectic, and its energy drifts at any order"


def grade_step(function: Function, order: int) -> Grade:
    """The grade of a step, see grade."""
    step = understood(function)
    problems = [step.problem(seed) for seed in range(STATES[step.shape])]
    where = problems[0]
    remarks = [sentence for is_so, sentence in REMARKS if is_so(step)]
    is_map = not step.takes("before")
    with np.errstate(all="ignore"):
        fault = hidden(step, where)
        if fault:
            finding = Finding("a map of x and v", False, fault)
            return Grade(step.call_text, (finding,), (fault,), remarks=tuple(remarks))
        measured = Measured(step, where, order)
        laws = {finding.name: finding for finding in judged(LAWS, measured)}
        reached = laws["order"].value
        is_right = laws["order"].passed
        is_symplectic = laws["symplectic"].passed
        is_low = is_symplectic and order == 1  # and asked for
        is_beyond = reached > HIGH or is_low

        numbers = numbers_of(step, where) if is_map else None
        method, fault = named(numbers)
        faults = [fault]
        if not fault:
            is_energy_kept = laws["energy"].value == 0.0
            n_powers = 2 if is_beyond else 3
            faults = faults_of(step, problems, measured.noise, n_powers, is_energy_kept)

    open_laws = set[str]() if is_map else NO_MAP
    is_runge_kutta = isinstance(numbers, Numbers) and not numbers.substeps
    if is_symplectic and is_right and is_beyond:
        open_laws = {"reversible"}  # as Ruth's method of order 3, which is right
    elif is_runge_kutta and not is_symplectic and not faults:
        if is_right and abs(reached - order) < 0.5 and (order > 2 or method):
            open_laws = {name for name, law in laws.items() if law.passed is False}
            remarks.append(RUNGE_KUTTA)
        else:
            call = f"md.grade(step, order={round(reached)})"
            faults = [f"{RUNGE_KUTTA}. If it is meant, ask for its order: {call}"]
    for name in open_laws.intersection(laws):
        laws[name] = replace(laws[name], passed=None)
    findings = tuple(laws.values())
    faults = faults or causes(findings)[:1]
    return Grade(step.call_text, findings, tuple(faults), method, tuple(remarks))
