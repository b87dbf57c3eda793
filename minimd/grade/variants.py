"""The name of a step: methods, right and wrong, with which it is compared to rounding, and the kicks and drifts in it.

Steps that are sequences of kicks and drifts come from minimd's own table of splittings. To add a method, add a row.

The weights of kicks and drifts are found from the results of a step:

    without forces, the force is evaluated at the positions x + c_k Δt v: the drifts are c_k − c_{k−1}
    if only the k-th evaluation returns a force, velocities change by b_k Δt F/m: the kicks are b_k

A step is a sequence of them if positions then change by b_k (c_end − c_k) Δt² F/m.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from minimd.grade.calling import StudentStep
from minimd.grade.problems import Array, Problem
from minimd.integrators.methods import SPLITTINGS
from minimd.integrators.splitting.substeps import Drift, Kick, Substep, Substeps, merged

Acceleration = Callable[[Array], Array]
Step = Callable[[Array, Array, Acceleration, float], tuple[Array, Array]]  # a(x) is F/m at x
ROUNDING, SAME = 1e-9, 1e-7  # smaller differences of results are rounding; of weights, and of second differences


class Kind(Enum):
    """Kinds of methods."""

    SPLITTING = "a sequence of kicks and drifts"
    RUNGE_KUTTA = "a Runge-Kutta method: it is not symplectic, its energy drifts at any order"
    PARABOLA = "a parabola with the old force, then a kick"
    IN_TURN = "one atom after another"


class Row(NamedTuple):
    """A method.  wrong : what is wrong with it; empty if nothing is, or if the expansion says it."""

    name: str
    kind: Kind
    order: int
    step: Step
    wrong: str = ""


def split(substeps: Substeps) -> Step:
    """Kicks and drifts."""

    def step(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
        for one in substeps:
            if isinstance(one, Kick):
                v = v + one.coefficient * h * a(x)
            else:
                x = x + one.coefficient * h * v
        return x, v

    return step


def parabola(c: float, old: float, new: float) -> Step:
    """x₁ = x + Δt v + c Δt² a(x), then v₁ = v + Δt (old a(x) + new a(x₁))."""

    def step(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
        x1 = x + h * v + c * h * h * a(x)
        return x1, v + h * (old * a(x) + new * a(x1))

    return step


def tableau(*rows: list[float]) -> Step:
    """An explicit Runge-Kutta method of the first-order system.  rows : of the matrix; last, the weights."""

    def step(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
        start, slopes = np.array([x, v]), list[Array]()
        for row in rows:
            at = start + h * sum((b * slope for b, slope in zip(row, slopes, strict=True)), np.zeros_like(start))
            slopes.append(np.array([at[1], a(at[0])]))
        return at[0], at[1]

    return step


def in_turn(first: float, second: float) -> Step:
    """Each atom is moved before the force on the next one is computed: kick, drift, kick, with the weights of kicks."""

    def step(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
        x, v = x.copy(), v.copy()
        for i in range(len(x) if x.ndim else 0):
            v[i] += first * h * a(x)[i]
            x[i] += h * v[i]
            v[i] += second * h * a(x)[i]
        return x, v

    return step


HALF: tuple[list[float], list[float]] = ([], [1 / 2])  # the first stages of RK4
CLASSICAL = [1 / 6, 1 / 3, 1 / 3, 1 / 6]  # its weights
NEARLY = "looks like RK4 with a wrong"
# fmt: off
ROWS = (
    *(Row(name, Kind.SPLITTING, method.order, split(method.substeps)) for name, method in SPLITTINGS.items()),
    Row("explicit Euler", Kind.PARABOLA, 1, parabola(0.0, 1.0, 0.0)),
    Row("Taylor's parabola with the old force", Kind.PARABOLA, 1, parabola(0.5, 1.0, 0.0)),
    Row("velocity Verlet with the new force alone", Kind.PARABOLA, 1, parabola(0.5, 0.0, 1.0)),
    Row("explicit Euler for positions, trapezoidal rule for velocities", Kind.PARABOLA, 1, parabola(0.0, 0.5, 0.5)),
    Row("RK2, midpoint", Kind.RUNGE_KUTTA, 2, tableau([], [1 / 2], [0, 1])),
    Row("RK2, Heun", Kind.RUNGE_KUTTA, 2, tableau([], [1], [1 / 2, 1 / 2])),
    Row("RK2, Ralston", Kind.RUNGE_KUTTA, 2, tableau([], [2 / 3], [1 / 4, 3 / 4])),
    Row("RK3, Kutta", Kind.RUNGE_KUTTA, 3, tableau([], [1 / 2], [-1, 2], [1 / 6, 2 / 3, 1 / 6])),
    Row("RK4, the classical Runge-Kutta method", Kind.RUNGE_KUTTA, 4,
        tableau(*HALF, [0, 1 / 2], [0, 0, 1], CLASSICAL)),
    Row("RK4, the 3/8 rule", Kind.RUNGE_KUTTA, 4,
        tableau([], [1 / 3], [-1 / 3, 1], [1, -1, 1], [1 / 8, 3 / 8, 3 / 8, 1 / 8])),
    Row("nearly RK4: k1 for k2", Kind.RUNGE_KUTTA, 2, tableau(*HALF, [1 / 2, 0], [0, 0, 1], CLASSICAL),
        f"{NEARLY} third stage: it uses k1 in place of k2, k3 = f(y + dt/2 k2); order 2, not 4"),
    Row("nearly RK4: k2 for k3", Kind.RUNGE_KUTTA, 2, tableau(*HALF, [0, 1 / 2], [0, 1, 0], CLASSICAL),
        f"{NEARLY} fourth stage: it uses k2 in place of k3, k4 = f(y + dt k3); order 2, not 4"),
    Row("nearly RK4: k1 for k3", Kind.RUNGE_KUTTA, 2, tableau(*HALF, [0, 1 / 2], [1, 0, 0], CLASSICAL),
        f"{NEARLY} fourth stage: it uses k1 in place of k3, k4 = f(y + dt k3); order less than 4"),
    Row("nearly RK4: a fourth stage of half a step", Kind.RUNGE_KUTTA, 1,
        tableau(*HALF, [0, 1 / 2], [0, 0, 1 / 2], CLASSICAL),
        f"{NEARLY} fourth stage: it uses dt/2 in place of dt, k4 = f(y + dt k3); order less than 4"),
    Row("nearly RK4: equal weights", Kind.RUNGE_KUTTA, 2, tableau(*HALF, [0, 1 / 2], [0, 0, 1], 4 * [1 / 4]),
        "looks like RK4 with wrong weights: all are 1/4 in place of (k1 + 2 k2 + 2 k3 + k4)/6; order 2, not 4"),
    Row("symplectic Euler, atom after atom", Kind.IN_TURN, 1, in_turn(1.0, 0.0),
        "atoms are moved one after another: the force on each is computed when those before it have moved already. "
        "Compute all forces first, then move all atoms"),
    Row("velocity Verlet, atom after atom", Kind.IN_TURN, 2, in_turn(0.5, 0.5),
        "atoms are moved one after another, each with its own force computation: an atom sees others that have moved "
        "already, and action is no longer reaction"),
)
# fmt: on


def recognized(step: StudentStep, where: Problem, h: float, accuracy: float) -> Row | None:
    """The row that gives the same step."""

    def acceleration(x: Array) -> Array:
        return np.asarray(where.force(x) / where.mass)

    own = step(where, where.x, where.v, h)
    for row in ROWS:
        known = row.step(where.x, where.v, acceleration, h)
        if max(np.abs(one - other).max() for one, other in zip(known, own, strict=True)) < accuracy:
            return row
    return None


class Recorded(Problem):
    """A problem that records where its force is evaluated, and returns it in one call only, that at the start."""

    places: list[Array]
    only: int

    def force(self, x: Array) -> Array:
        """The force at the start in the call with the number `only`, else zero."""
        self.places.append(np.array(x))
        return super().force(self.x) if len(self.places) - 1 == self.only else np.zeros_like(self.x)


def substeps_of(step: StudentStep, where: Problem, h: float = 0.1) -> Substeps:
    """Kicks and drifts in turn; empty for a step that is not such a sequence."""
    x0, v0, a = where.x, where.v, where.force(where.x) / where.mass

    def end_with(only: int) -> tuple[Array, Array, list[Array]]:
        one = Recorded(*where)
        one.places, one.only = [], only
        return *step(one, x0, v0, h), one.places

    if any(role.split()[0] in ("known", "before", "half", "old") for role in step.manner.roles):
        return ()
    end, v, places = end_with(-1)
    if np.abs(v - v0).max() > ROUNDING:
        return ()
    times = [float(np.sum((x - x0) * v0) / np.sum(v0**2)) / h for x in (x0, *places, end)]
    parts: list[Substep] = []
    for k, (before, at) in enumerate(pairwise(times[:-1])):
        x, v, _ = end_with(k)
        b = float(np.sum((v - v0) * a) / np.sum(a * a)) / h
        off = np.abs(v - v0 - b * h * a).max() > ROUNDING
        if off or np.abs((x - end) / h**2 - b * (times[-1] - at) * a).max() > SAME:
            return ()
        parts += [Drift(at - before), Kick(b)]
    parts.append(Drift(times[-1] - times[-2]))
    return merged(one for one in parts if abs(one.coefficient) > ROUNDING)


def kind_of(substep: Substep) -> str:
    """Kick or drift, as a word."""
    return type(substep).__name__.lower()


def nearest_method(parts: Substeps) -> str:
    """A fault if a splitting of minimd has the same substeps and at most half of the weights differ; else empty."""
    best, fewest, kinds = "", max(1, len(parts) // 2), [type(one) for one in parts]
    for name, method in SPLITTINGS.items():
        if [type(one) for one in method.substeps] == kinds:
            pairs = enumerate(zip(parts, method.substeps, strict=True), start=1)
            wrong = [
                f"substep {k}, a {kind_of(own)}, is {own.coefficient:.10g} where {right.coefficient:.10g} is needed"
                for k, (own, right) in pairs
                if abs(own.coefficient - right.coefficient) > SAME
            ]
            if 0 < len(wrong) <= fewest:
                fewest, best = len(wrong), f": nearly {name}, but {', '.join(wrong)}"
    return best
