"""The name of a step: the numbers of which it consists are measured, and compared with those of known methods.

    x₁ = x + Δt v + Δt² Σ β_k a_k,  v₁ = v + Δt Σ b_k a_k,  where a_k is F/m at x + c_k Δt v + Δt² Σ α_kl a_l

Without forces, the places at which the force is evaluated show c. If only the k-th evaluation returns a force, they
show the column k of α, and the end of the step β_k and b_k. Kicks and drifts in turn have α_jk = b_k (c_j − c_k) and
β_k = b_k (1 − c_k); a Runge-Kutta method with the matrix A has α = A² and β = b A.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from minimd.core.integrators import rows as splittings
from minimd.core.integrators.method import methods_of
from minimd.core.integrators.substeps import Drift, Kick, Substep, Substeps, merged
from minimd.core.structure.arrays import Array
from minimd.judge.calling import StudentStep
from minimd.judge.findings import coefficient
from minimd.judge.problems import TrialProblem, largest

SAME = 1e-7  # difference of equal weights
CLOSE = 1e-3  # difference of weights that are meant to be equal
MANY = 6  # substeps of a method that may be nearly another
ROUNDING = 1e-9  # of v
MOST = 60  # evaluations of the force in one step
STEP = 0.1  # time step
# rows of the matrix from the second one on, and the weights
RUNGE_KUTTA: dict[str, tuple[list[float], ...]] = {
    "RK2, midpoint": ([1 / 2], [0, 1]),
    "RK2, Heun": ([1], [1 / 2, 1 / 2]),
    "RK2, Ralston": ([2 / 3], [1 / 4, 3 / 4]),
    "RK3, Kutta": ([1 / 2], [-1, 2], [1 / 6, 2 / 3, 1 / 6]),
    "RK4, the classical Runge-Kutta method": (
        [1 / 2],
        [0, 1 / 2],
        [0, 0, 1],
        [1 / 6, 1 / 3, 1 / 3, 1 / 6],
    ),
    "RK4, the 3/8 rule": ([1 / 3], [-1 / 3, 1], [1, -1, 1], [1 / 8, 3 / 8, 3 / 8, 1 / 8]),
}
IN_TURN = (
    "atoms are moved one after another: the force on each is computed when those before it have moved already. "
    "Compute all forces first, then move all atoms"
)


class Numbers(NamedTuple):
    """The numbers of a step with n evaluations.

    places : c, (n + 1,), the last one that of the end.
    pushes : α, (n + 1, n), the last row β.
    weights : b, (n,).
    """

    places: Array
    pushes: Array
    weights: Array

    def is_same(self, matrix: Array, b: Array) -> bool:
        """Whether these are the numbers of a Runge-Kutta method with as many evaluations."""
        places = np.append(matrix.sum(axis=1), 1.0)
        pushes = np.vstack([matrix @ matrix, b @ matrix])
        pairs = zip(self, (places, pushes, b), strict=True)
        return all(np.allclose(own, right, 0.0, SAME) for own, right in pairs)

    @property
    def substeps(self) -> Substeps:
        """Kicks and drifts in turn; empty if the step is not such a sequence."""
        c = self.places
        b = self.weights
        pushes = np.tril(b * (c[:, None] - c[:-1]), -1)
        if largest(self.pushes - pushes) > SAME:
            return ()
        parts: list[Substep] = [Drift(float(c[0]))]
        for length, weight in zip(np.diff(c), b, strict=True):
            parts += [Kick(float(weight)), Drift(float(length))]
        return merged(part for part in parts if abs(part.coefficient) > SAME)


class Recorded(TrialProblem):
    """A problem that records where its force is evaluated, and returns it in one call only, that at the start."""

    places: list[Array]
    only: int

    def force(self, x: Array) -> Array:
        """The force at the start in the call with the number `only`, else zero."""
        self.places.append(np.array(x))
        if len(self.places) - 1 == self.only:
            return super().force(self.x)
        return np.zeros_like(self.x)


def numbers_of(step: StudentStep, where: TrialProblem) -> Numbers | str | None:
    """The numbers of a step; None if it is not made of such, or the fault of one that moves atoms one after another."""
    a = where.force(where.x) / where.mass
    drift = STEP * where.v

    def end_with(only: int) -> tuple[Array, Array]:
        recorded = Recorded(*where)
        recorded.places = []
        recorded.only = only
        x, v = step(recorded, where.x, where.v, STEP)
        return np.array([*recorded.places, x]), v - where.v

    def along(change: Array, unit: Array) -> float:
        return np.sum(change * unit) / np.sum(unit * unit)

    free, change = end_with(-1)
    n = len(free) - 1
    if n == 0:
        return None
    moved = np.round((free - where.x) / drift, 6)
    are_apart = np.ptp(moved[:-1].reshape(n, -1), axis=1).any()
    if are_apart and np.isin(moved, (0.0, 1.0)).all():
        return IN_TURN
    if n > MOST or largest(change) > ROUNDING:
        return None

    columns = []
    weights = []
    for k in range(n):
        places, change = end_with(k)
        if len(places) != n + 1:
            return None
        columns.append([along(push, a) / STEP**2 for push in places - free])
        weights.append(along(change, a) / STEP)
    places = np.array([along(x - where.x, drift) for x in free])
    return Numbers(places, np.array(columns).T, np.array(weights))


def named(numbers: Numbers | str | None) -> tuple[str, str]:
    """The name of a method, or what it consists of; the fault of a step that is nearly a known method.

    numbers : see numbers_of.
    """
    if not isinstance(numbers, Numbers):
        return "", numbers or ""
    parts = numbers.substeps
    return name_of_splitting(parts) if parts else name_of_runge_kutta(numbers)


def name_of_splitting(parts: Substeps) -> tuple[str, str]:
    """The name and the fault of kicks and drifts in turn, see named."""
    types = [type(part) for part in parts]
    kinds = [kind.__name__.lower() for kind in types]
    coefficients = np.array([part.coefficient for part in parts])
    near = list[tuple[int, str]]()
    for name, method in methods_of(splittings).items():
        if [type(part) for part in method.substeps] != types:
            continue
        right = np.array([part.coefficient for part in method.substeps])
        off = np.abs(coefficients - right)
        wrong = np.flatnonzero(off > SAME)
        n = len(wrong)
        if not n:
            return name, ""
        if len(parts) >= MANY and (n <= len(parts) // 2 or off.max() < CLOSE):
            substeps = [
                f"substep {k + 1}, a {kinds[k]}, is {coefficients[k]:.10g} where {right[k]:.10g} is needed"
                for k in wrong
            ]
            near.append((n, f"the step is nearly {name}, but {', '.join(substeps)}"))

    pairs = zip(kinds, coefficients, strict=True)
    substeps = [f"{kind} {coefficient(value)}" for kind, value in pairs]
    return ", ".join(substeps), min(near, default=(0, ""))[1]


def name_of_runge_kutta(own: Numbers) -> tuple[str, str]:
    """The name and the fault of a Runge-Kutta method, see named."""
    n = len(own.weights)
    for name, (*rows, weights) in RUNGE_KUTTA.items():
        if len(weights) != n:
            continue
        b = np.array(weights)
        matrix = np.zeros((n, n))
        for k, row in enumerate(rows, 1):
            matrix[k, :k] = row
        if own.is_same(matrix, b):
            return name, ""
        if n == 2:
            continue
        nearly = f"the step is nearly {name}, but its"
        if own.is_same(matrix, own.weights):
            fault = f"{nearly} weights are {fractions(own.weights)} where {fractions(b)} are needed"
            return "", fault

        # the stage that makes β = b A right
        for j in range(1, n):
            other = matrix.copy()
            other[j] += (own.pushes[-1] - b @ matrix) / b[j]
            if own.is_same(other, b):
                stage = fractions(other[j, :j])
                right = fractions(matrix[j, :j])
                fault = f"{nearly} stage {j + 1} has the weights {stage} where {right} are needed"
                return "", fault
    return "", ""


def fractions(weights: Array) -> str:
    """Weights in words."""
    return ", ".join(map(coefficient, weights))
