"""The name of a step: the numbers of which it consists are measured, and compared with those of known methods.

    x₁ = x + Δt v + Δt² Σ β_k a_k,  v₁ = v + Δt Σ b_k a_k,  where a_k is F/m at x + c_k Δt v + Δt² Σ α_kl a_l

Without forces, the places at which the force is evaluated show c. If only the k-th evaluation returns a force, they
show the column k of α, and the end of the step β_k and b_k. Kicks and drifts in turn have α_jk = b_k (c_j − c_k) and
β_k = b_k (1 − c_k); a Runge-Kutta method with the matrix A has α = A² and β = b A.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from minimd.grade.calling import StudentStep
from minimd.grade.findings import coefficient
from minimd.grade.problems import Array, Problem
from minimd.integrators.methods import SPLITTINGS
from minimd.integrators.splitting.substeps import Drift, Kick, Substep, Substeps, merged

SAME = 1e-7  # smaller differences of weights are rounding
CLOSE = 0.02  # weights that differ by less are meant to be the same
MOST = 60  # evaluations of the force in one step
RUNGE_KUTTA = {  # rows of the matrix from the second one on, and the weights
    "RK2, midpoint": ([1 / 2], [0, 1]),
    "RK2, Heun": ([1], [1 / 2, 1 / 2]),
    "RK2, Ralston": ([2 / 3], [1 / 4, 3 / 4]),
    "RK3, Kutta": ([1 / 2], [-1, 2], [1 / 6, 2 / 3, 1 / 6]),
    "RK4, the classical Runge-Kutta method": ([1 / 2], [0, 1 / 2], [0, 0, 1], [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    "RK4, the 3/8 rule": ([1 / 3], [-1 / 3, 1], [1, -1, 1], [1 / 8, 3 / 8, 3 / 8, 1 / 8]),
}


IN_TURN = ("atoms are moved one after another: the force on each is computed when those before it have moved already. "
           "Compute all forces first, then move all atoms")  # fmt: skip


class Numbers(NamedTuple):
    """The numbers of a step with n evaluations.  places : c, (n + 1,), the last one that of the end.  pushes : α,
    (n + 1, n), the last row β.  weights : b, (n,)."""

    places: Array
    pushes: Array
    weights: Array

    def is_same(self, other: Numbers) -> bool:
        """Whether all numbers are the same."""
        pairs = zip(self, other, strict=True)
        return all(one.shape == two.shape and np.allclose(one, two, rtol=0.0, atol=SAME) for one, two in pairs)

    def end(self, where: Problem, h: float) -> tuple[Array, Array]:
        """x and v after a step with these numbers."""
        a = np.zeros((len(self.weights), *where.x.shape))
        for k, (c, row) in enumerate(zip(self.places, self.pushes, strict=True)):
            x = where.x + h * c * where.v + h * h * np.tensordot(row, a, 1)
            if k < len(a):
                a[k] = where.force(x) / where.mass
        return x, where.v + h * np.tensordot(self.weights, a, 1)

    @property
    def substeps(self) -> Substeps:
        """Kicks and drifts in turn; empty if the step is not such a sequence."""
        c, b = self.places, self.weights
        if np.abs(self.pushes - np.tril(b * (c[:, None] - c[:-1]), -1)).max() > SAME:
            return ()
        parts: list[Substep] = [Drift(float(c[0]))]
        for length, weight in zip(np.diff(c), b, strict=True):
            parts += [Kick(float(weight)), Drift(float(length))]
        return tuple(one for one in merged(one for one in parts if abs(one.coefficient) > SAME))


class Recorded(Problem):
    """A problem that records where its force is evaluated, and returns it in one call only, that at the start."""

    places: list[Array]
    only: int

    def force(self, x: Array) -> Array:
        """The force at the start in the call with the number `only`, else zero."""
        self.places.append(np.array(x))
        return super().force(self.x) if len(self.places) - 1 == self.only else np.zeros_like(self.x)


def numbers_of(step: StudentStep, where: Problem, accuracy: float, h: float = 0.1) -> Numbers | str | None:
    """The numbers of a step; None if it is not made of such, or the fault of one that moves atoms one after another."""
    a = where.force(where.x) / where.mass

    def end_with(only: int) -> tuple[Array, Array]:
        one = Recorded(*where)
        one.places, one.only = [], only
        x, v = step(one, where.x, where.v, h)
        return np.array([*one.places, x]), v - where.v

    def along(change: Array, unit: Array) -> float:
        return float(np.sum(change * unit) / np.sum(unit * unit))

    free, _ = end_with(-1)
    parts = (free - where.x) / (h * where.v)
    if (
        where.x.ndim
        and np.isin(np.round(parts, 6), (0.0, 1.0)).all()
        and np.ptp(parts[:-1].reshape(len(parts) - 1, -1), axis=1).max(initial=0.0) > 0.5
    ):
        return IN_TURN
    n = len(free) - 1
    c, alpha, b = np.array([along(x - where.x, where.v) / h for x in free]), np.zeros((n + 1, n)), np.zeros(n)
    for k in range(n if n <= MOST else 0):
        places, v = end_with(k)
        if len(places) != n + 1:
            return None
        alpha[:, k], b[k] = [along(one - two, a) / h**2 for one, two in zip(places, free, strict=True)], along(v, a) / h
    found = Numbers(c, alpha, b)
    ends = zip(found.end(where, h), step(where, where.x, where.v, h), strict=True)
    return found if max(np.abs(one - two).max() for one, two in ends) < accuracy else None


def named(own: Numbers) -> tuple[str, str]:
    """The name of a method, or what it consists of; the fault of a step that is nearly a known method."""
    parts, best, fewest = own.substeps, "", np.inf
    for name, method in SPLITTINGS.items():
        if [type(one) for one in method.substeps] != [type(one) for one in parts]:
            continue
        rows = [(k, type(one).__name__.lower(), one.coefficient, two.coefficient)
                for k, (one, two) in enumerate(zip(parts, method.substeps, strict=True), start=1)]  # fmt: skip
        off = np.array([abs(mine - right) for *_, mine, right in rows])
        wrong = np.count_nonzero(off > SAME)
        if not wrong:
            return name, ""
        if wrong < fewest and len(rows) > 5 and (wrong <= len(rows) // 2 or off.max() < CLOSE):
            fewest, told = wrong, [f"substep {k}, a {kind}, is {mine:.10g} where {right:.10g} is needed"
                                   for k, kind, mine, right in rows if abs(mine - right) > SAME]  # fmt: skip
            best = f"the step is nearly {name}, but {', '.join(told)}"
    if parts:
        return ", ".join(f"{type(one).__name__.lower()} {coefficient(one.coefficient)}" for one in parts), best
    for name, (*rows, weights) in RUNGE_KUTTA.items():
        n, b = len(weights), np.array(weights)
        if len(own.weights) != n:
            continue
        matrix = np.array([[*row, *[0.0] * (n - len(row))] for row in ([], *rows)])
        if own.is_same(runge_kutta(matrix, b)):
            return name, ""
        if n > 2 and own.is_same(runge_kutta(matrix, own.weights)):
            return (
                "",
                f"the step is nearly {name}, but its weights are {told_row(own.weights)} where {told_row(b)} are needed",
            )
        for j in range(1, n if n > 2 else 0):
            other = matrix.copy()
            other[j] += (own.pushes[-1] - b @ matrix) / b[j]
            if own.is_same(runge_kutta(other, b)):
                return "", (f"the step is nearly {name}, but its stage {j + 1} has the weights {told_row(other[j, :j])} of the stages before "
                            f"it where {told_row(matrix[j, :j])} are needed")  # fmt: skip
    return "", ""


def runge_kutta(matrix: Array, b: Array) -> Numbers:
    """The numbers of a Runge-Kutta method."""
    return Numbers(np.append(matrix.sum(axis=1), 1.0), np.vstack([matrix @ matrix, b @ matrix]), b)


def told_row(numbers: Array) -> str:
    """Weights in words."""
    return ", ".join(coefficient(float(one)) for one in numbers)
