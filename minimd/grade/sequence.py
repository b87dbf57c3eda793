"""The kicks and drifts of a step, found from its results: their weights, and a known method with nearly the same weights.

    without forces, the force is evaluated at the positions x + c_k Δt v: the drifts are c_k − c_{k−1}
    if only the k-th evaluation returns a force, velocities change by b_k Δt F/m: the kicks are b_k

A step is a sequence of them if positions then change by b_k (c_end − c_k) Δt² F/m.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from minimd.grade.calling import StudentStep
from minimd.grade.findings import coefficient
from minimd.grade.problems import Array, Problem

ROUNDING = 1e-9
FEW = 3  # a step with so many evaluations or more should have an order above 2


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
    """("kick" or "drift", weight) in turn, neighbors of the same kind added; None for a step that is not such a sequence."""
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
        wrong = [k for k, ((_, own), (_, right)) in enumerate(zip(parts, known, strict=True)) if abs(own - right) > 1e-7]
        if 0 < len(wrong) <= fewest:
            fewest = len(wrong)
            places = ", ".join(f"substep {k + 1}, a {parts[k][0]}, is {parts[k][1]:.10g} where {known[k][1]:.10g} is needed" for k in wrong)
            best = f"nearly {name}, but {places}"
    return best
