"""Rows of substeps: kicks and drifts, and contacts with a bath, in the order in which a step applies them, and what one can do with such a row."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from math import isclose

COEFFICIENT_ROUNDING = 1e-14  # coefficients of order one, sums of a few of them


@dataclass(frozen=True, slots=True)
class Drift:
    """φ[1] over coefficient · Δt: q′ = v, v′ = 0. A negative coefficient runs it backwards."""

    coefficient: float


@dataclass(frozen=True, slots=True)
class Kick:
    """φ[2] over coefficient · Δt: q′ = 0, v′ = f(q). A negative coefficient runs it backwards."""

    coefficient: float


@dataclass(frozen=True, slots=True)
class Thermalize:
    """Contact with a bath over coefficient · Δt: velocities change at random, positions stand still. See thermostats."""

    coefficient: float


Substep = Kick | Drift | Thermalize
Substeps = tuple[Substep, ...]


def merged(substeps: Iterable[Substep]) -> Substeps:
    """The same flow with equal neighbors made one, φ_a ∘ φ_b = φ_{a+b}, and substeps of no duration left out."""
    row: list[Substep] = []
    for substep in substeps:
        if row and type(row[-1]) is type(substep):
            substep = type(substep)(row.pop().coefficient + substep.coefficient)
        if substep.coefficient != 0.0:
            row.append(substep)
    return tuple(row)


def scaled(substeps: Iterable[Substep], weight: float) -> Substeps:
    """The row over weight · Δt instead of Δt."""
    return tuple(type(substep)(weight * substep.coefficient) for substep in substeps)


def repeated(substeps: Substeps, weights: Sequence[float]) -> Substeps:
    """Φ_{w₁Δt}, then Φ_{w₂Δt}, …, as one row: how a method of low order is composed to one of high order."""
    return merged(chain.from_iterable(scaled(substeps, weight) for weight in weights))


def mirrored(substeps: Substeps) -> Substeps:
    """The row read from its other end: the adjoint Φ*_Δt = (Φ_{−Δt})⁻¹, for each flow is its own adjoint."""
    return substeps[::-1]


def alternating(kind: type[Substep], coefficients: Iterable[float]) -> Substeps:
    """Kicks and drifts in turn, beginning with one kind."""
    other = Drift if kind is Kick else Kick
    return tuple((other if k % 2 else kind)(coefficient) for k, coefficient in enumerate(coefficients))


def palindrome(half: Sequence[float]) -> tuple[float, ...]:
    """The coefficients up to the middle one, then back again."""
    return (*half, *half[-2::-1])


def is_palindrome(substeps: Substeps) -> bool:
    """Whether a row is its own mirror image, to rounding: then Φ*= Φ, the method is symmetric."""
    return all(
        type(one) is type(other) and isclose(one.coefficient, other.coefficient, rel_tol=COEFFICIENT_ROUNDING, abs_tol=COEFFICIENT_ROUNDING)
        for one, other in zip(substeps, mirrored(substeps), strict=True)
    )
