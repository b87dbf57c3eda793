"""The name of a step: methods, right and wrong, with which it is compared to rounding, and the kicks and drifts in it.

A row is a name and a step; a(x) is F/m at x. Steps that are sequences of kicks and drifts come from minimd's own table
of splittings. To add a method, add a row.

The weights of kicks and drifts are found from the results of a step:

    without forces, the force is evaluated at the positions x + c_k Δt v: the drifts are c_k − c_{k−1}
    if only the k-th evaluation returns a force, velocities change by b_k Δt F/m: the kicks are b_k

A step is a sequence of them if positions then change by b_k (c_end − c_k) Δt² F/m.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from minimd.grade.calling import StudentStep
from minimd.grade.findings import coefficient
from minimd.grade.problems import Array, Problem

Acceleration = Callable[[Array], Array]
Row = Callable[[Array, Array, Acceleration, float], tuple[Array, Array]]
NOT_SYMPLECTIC = "a Runge-Kutta method: it is not symplectic, its energy drifts at any order"
CLASSICAL = [1 / 6, 1 / 3, 1 / 3, 1 / 6]  # weights of RK4
ROUNDING = 1e-9
FEW = 3  # a step with so many evaluations or more should have an order above 2


def explicit_euler(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
    """Explicit Euler: positions and velocities change with the old velocity and the old force."""
    return x + h * v, v + h * a(x)


def runge_kutta(
    x: Array, v: Array, a: Acceleration, h: float, stages: list[list[float]], weights: list[float]
) -> tuple[Array, Array]:
    """An explicit Runge-Kutta method of the first-order system."""
    slopes: list[tuple[Array, Array]] = []
    for row in stages:
        at_x = x + h * sum((c * dx for c, (dx, _) in zip(row, slopes, strict=False)), np.zeros_like(x))
        at_v = v + h * sum((c * dv for c, (_, dv) in zip(row, slopes, strict=False)), np.zeros_like(v))
        slopes.append((at_v, a(at_x)))
    return (
        x + h * sum((w * dx for w, (dx, _) in zip(weights, slopes, strict=True)), np.zeros_like(x)),
        v + h * sum((w * dv for w, (_, dv) in zip(weights, slopes, strict=True)), np.zeros_like(v)),
    )


def taylor(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
    """A parabola: positions and velocities change with the old force."""
    return x + h * v + 0.5 * h * h * a(x), v + h * a(x)


def one_after_another(kicks: tuple[float, float]) -> Row:
    """Each atom is moved before the force on the next one is computed: kick, drift, kick.  kicks : their weights."""

    def step(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
        x, v = x.copy(), v.copy()
        for i in range(len(x) if x.ndim else 0):
            v[i] += kicks[0] * h * a(x)[i]
            x[i] += h * v[i]
            v[i] += kicks[1] * h * a(x)[i] if kicks[1] else 0.0
        return x, v

    return step


def tableau(stages: list[list[float]], weights: list[float]) -> Row:
    """A Runge-Kutta method as a row of the table."""
    return lambda x, v, a, h: runge_kutta(x, v, a, h, stages, weights)


def drift_with_new_force(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
    """Velocity Verlet with the new force only in the velocities."""
    x1 = x + h * v + 0.5 * h * h * a(x)
    return x1, v + h * a(x1)


def mixed_drift(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
    """Positions by explicit Euler, velocities by the trapezoidal rule."""
    x1 = x + h * v
    return x1, v + 0.5 * h * (a(x) + a(x1))


VARIANTS: dict[
    str, tuple[Row, str]
] = {  # name: the step, and what is wrong with it (empty if nothing is, or if the expansion says it)
    "explicit Euler": (explicit_euler, ""),
    "Taylor's parabola with the old force": (taylor, ""),
    "velocity Verlet with the new force alone": (drift_with_new_force, ""),
    "explicit Euler for positions, trapezoidal rule for velocities": (mixed_drift, ""),
    "RK2, midpoint": (tableau([[], [0.5]], [0.0, 1.0]), NOT_SYMPLECTIC),
    "RK2, Heun": (tableau([[], [1.0]], [0.5, 0.5]), NOT_SYMPLECTIC),
    "RK2, Ralston": (tableau([[], [2 / 3]], [0.25, 0.75]), NOT_SYMPLECTIC),
    "RK3, Kutta": (tableau([[], [0.5], [-1.0, 2.0]], [1 / 6, 2 / 3, 1 / 6]), NOT_SYMPLECTIC),
    "RK4, the classical Runge-Kutta method": (
        tableau([[], [0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], CLASSICAL),
        NOT_SYMPLECTIC,
    ),
    "RK4, the 3/8 rule": (
        tableau([[], [1 / 3], [-1 / 3, 1.0], [1.0, -1.0, 1.0]], [1 / 8, 3 / 8, 3 / 8, 1 / 8]),
        NOT_SYMPLECTIC,
    ),
    "nearly RK4: k1 for k2": (
        tableau([[], [0.5], [0.5], [0.0, 0.0, 1.0]], CLASSICAL),
        "looks like RK4 with a wrong third stage: it uses k1 in place of k2, k3 = f(y + dt/2 k2); order 2, not 4",
    ),
    "nearly RK4: k2 for k3": (
        tableau([[], [0.5], [0.0, 0.5], [0.0, 1.0]], CLASSICAL),
        "looks like RK4 with a wrong fourth stage: it uses k2 in place of k3, k4 = f(y + dt k3); order 2, not 4",
    ),
    "nearly RK4: k1 for k3": (
        tableau([[], [0.5], [0.0, 0.5], [1.0]], CLASSICAL),
        "looks like RK4 with a wrong fourth stage: it uses k1 in place of k3, k4 = f(y + dt k3); order less than 4",
    ),
    "nearly RK4: a fourth stage of half a step": (
        tableau([[], [0.5], [0.0, 0.5], [0.0, 0.0, 0.5]], CLASSICAL),
        "looks like RK4 with a wrong fourth stage: it uses dt/2 in place of dt, k4 = f(y + dt k3); order less than 4",
    ),
    "nearly RK4: equal weights": (
        tableau([[], [0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [0.25, 0.25, 0.25, 0.25]),
        "looks like RK4 with wrong weights: all are 1/4 in place of (k1 + 2 k2 + 2 k3 + k4)/6; order 2, not 4",
    ),
    "symplectic Euler, atom after atom": (
        one_after_another((1.0, 0.0)),
        "atoms are moved one after another: the force on each is computed when those "
        "before it have moved already. Compute all forces first, then move all atoms",
    ),
    "velocity Verlet, atom after atom": (
        one_after_another((0.5, 0.5)),
        "atoms are moved one after another, each with its own force computation: "
        "an atom sees others that have moved already, and action is no longer reaction",
    ),
}


def rows() -> Iterator[tuple[str, Row, str]]:
    """All rows, minimd's splittings first."""
    from minimd.integrators.methods import SPLITTINGS
    from minimd.integrators.splitting.substeps import Kick, Substeps

    def split(substeps: Substeps) -> Row:
        def step(x: Array, v: Array, a: Acceleration, h: float) -> tuple[Array, Array]:
            for substep in substeps:
                if isinstance(substep, Kick):
                    v = v + substep.coefficient * h * a(x)
                else:
                    x = x + substep.coefficient * h * v
            return x, v

        return step

    for name, method in SPLITTINGS.items():
        yield name, split(method.substeps), ""
    for name, (row, wrong) in VARIANTS.items():
        yield name, row, wrong


def recognized(end: tuple[Array, Array], where: Problem, h: float, accuracy: float) -> tuple[str, str]:
    """The name of the row that gives the same step, and what is wrong with it; both are empty if there is none."""
    for name, row, wrong in rows():
        x, v = row(where.x, where.v, lambda x: where.force(x) / where.mass, h)
        if max(np.abs(x - end[0]).max(), np.abs(v - end[1]).max()) < accuracy:
            return name.replace("leapfrog", "symplectic-euler-1"), wrong
    return "", ""


class Recorded(Problem):
    """A problem that records where its force is evaluated, and returns a force only once."""

    places: list[Array]
    only: int
    answer: Array

    def force(self, x: Array) -> Array:
        """The force in the call with the number `only`, else zero."""
        self.places.append(np.array(x))
        return self.answer if len(self.places) - 1 == self.only else np.zeros_like(self.answer)


def recorded(where: Problem, only: int) -> Any:
    """The problem with a force in the call with the number `only` (−1 for none)."""
    one = Recorded(*where)
    one.places, one.only, one.answer = [], only, np.asarray(where.force(where.x))
    return one


def substeps_of(step: StudentStep, where: Problem, h: float = 0.1) -> list[tuple[str, float]] | None:
    """("kick" or "drift", weight) in turn, neighbors of the same kind added;
    None for a step that is not such a sequence."""
    if any(role.split()[0] in ("known", "before", "half", "old") for role in step.manner.roles):
        return None
    free = recorded(where, -1)
    end, v = step(free, where.x, where.v, h)
    if np.abs(v - where.v).max() > ROUNDING:
        return None

    def along(x: Array) -> float:
        return float(np.sum((x - where.x) * where.v) / np.sum(where.v**2)) / h

    c, c_end = [along(x) for x in free.places], along(end)
    kicks = []
    for k in range(len(c)):
        one = recorded(where, k)
        x, v = step(one, where.x, where.v, h)
        a = one.answer / where.mass
        b = float(np.sum((v - where.v) * a) / np.sum(a * a)) / h
        pushed = (x - end) / h**2
        if np.abs(v - where.v - b * h * a).max() > ROUNDING or np.abs(pushed - b * (c_end - c[k]) * a).max() > 1e-7:
            return None
        kicks.append(b)
    parts, at = [], 0.0
    for b, place in zip(kicks, c, strict=True):
        parts += [("drift", place - at), ("kick", b)]
        at = place
    parts.append(("drift", c_end - at))
    return merged([part for part in parts if abs(part[1]) > ROUNDING])


def merged(parts: list[tuple[str, float]]) -> list[tuple[str, float]]:
    """The substeps with neighbors of the same kind added."""
    answer: list[tuple[str, float]] = []
    for kind, weight in parts:
        if answer and answer[-1][0] == kind:
            answer[-1] = kind, answer[-1][1] + weight
        else:
            answer.append((kind, weight))
    return answer


def told(parts: list[tuple[str, float]]) -> str:
    """The substeps in words."""
    return ", ".join(f"{kind} {coefficient(weight)}" for kind, weight in parts)


def nearest_method(parts: list[tuple[str, float]]) -> str:
    """A fault if a splitting of minimd has the same substeps and at most half of the weights differ; else empty."""
    from minimd.integrators.methods import SPLITTINGS
    from minimd.integrators.splitting.substeps import Kick

    best = ""
    fewest = max(1, len(parts) // 2)
    for name, method in SPLITTINGS.items():
        known = [("kick" if isinstance(one, Kick) else "drift", one.coefficient) for one in method.substeps]
        if [kind for kind, _ in known] != [kind for kind, _ in parts]:
            continue
        wrong = [
            k for k, ((_, own), (_, right)) in enumerate(zip(parts, known, strict=True)) if abs(own - right) > 1e-7
        ]
        if 0 < len(wrong) <= fewest:
            fewest = len(wrong)
            places = ", ".join(
                f"substep {k + 1}, a {parts[k][0]}, is {parts[k][1]:.10g} where {known[k][1]:.10g} is needed"
                for k in wrong
            )
            best = f"nearly {name}, but {places}"
    return best
