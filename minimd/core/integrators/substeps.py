"""Substeps (kicks, drifts and contacts with a bath), and sequences of them in the order in which a step makes them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, cycle
from math import isclose

from minimd.core.console.words import shown
from minimd.core.structure.checks import checked_number

__all__ = ["Drift", "Kick"]

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
class BondedKick(Kick):
    """The same, by bonded terms alone: see Forces.bonded_operations."""


@dataclass(frozen=True, slots=True)
class Thermalize:
    """Contact with a bath over coefficient · Δt: velocities change, positions do not. See thermostats. Where
    is_thermostat is false, it is no bath, and no heat is counted, as where a magnetic field turns velocities."""

    coefficient: float


Substep = Kick | Drift | Thermalize
Substeps = tuple[Substep, ...]


def checked_substeps(substeps: Iterable[Substep]) -> Substeps:
    """The substeps as a tuple.
    Raises TypeError for anything but Kick, Drift and Thermalize, ValueError for a coefficient that is not finite."""
    sequence = tuple(substeps) if isinstance(substeps, Iterable) else (substeps,)
    if isinstance(substeps, Substep) or not all(isinstance(each, Substep) for each in sequence):
        raise TypeError(
            "substeps must be a sequence of Kick, Drift and Thermalize, such as (Kick(0.5), Drift(1.0), Kick(0.5)); "
            f"substeps = {shown(substeps)}"
        )
    for k, substep in enumerate(sequence):
        checked_number(f"coefficient of substeps[{k}]", substep.coefficient)
    return sequence


def merged(substeps: Iterable[Substep]) -> Substeps:
    """The same flow with neighbors of one kind merged, φ_a ∘ φ_b = φ_{a+b}, and substeps of no duration left out.
    Errors : see checked_substeps."""
    sequence: list[Substep] = []
    for substep in checked_substeps(substeps):
        if sequence and type(sequence[-1]) is type(substep):
            substep = type(substep)(sequence.pop().coefficient + substep.coefficient)
        if substep.coefficient != 0.0:
            sequence.append(substep)
    return tuple(sequence)


def mechanical(substeps: Iterable[Substep]) -> Substeps:
    """The kicks and drifts alone."""
    return tuple(substep for substep in substeps if not isinstance(substep, Thermalize))


def scaled(substeps: Iterable[Substep], weight: float) -> Substeps:
    """The same substeps over weight · Δt instead of Δt."""
    return tuple(type(substep)(weight * substep.coefficient) for substep in substeps)


def repeated(substeps: Substeps, weights: Sequence[float]) -> Substeps:
    """Φ_{w₁Δt}, then Φ_{w₂Δt}, … as one sequence: a composition of a method with itself."""
    return merged(chain.from_iterable(scaled(substeps, weight) for weight in weights))


def mirrored(substeps: Substeps) -> Substeps:
    """The sequence in reverse: the adjoint Φ*_Δt = (Φ_{−Δt})⁻¹, because each flow is its own adjoint."""
    return substeps[::-1]


def alternating(kind: type[Substep], coefficients: Iterable[float]) -> Substeps:
    """Kicks and drifts in turn, beginning with one kind."""
    kinds = cycle((kind, Drift if kind is Kick else Kick))
    return tuple(kind(coefficient) for kind, coefficient in zip(kinds, coefficients, strict=False))


def palindrome(half: Sequence[float]) -> tuple[float, ...]:
    """The coefficients up to the middle one, then the same in reverse."""
    return (*half, *half[-2::-1])


def outer_substeps(substeps: Substeps) -> Substeps:
    """Without kicks of bonded terms alone: what is left where these have no forces."""
    return merged(part for part in substeps if not isinstance(part, BondedKick))


def are_alike(first: Substeps, second: Substeps) -> bool:
    """Whether two sequences are equal, to rounding."""
    if list(map(type, first)) != list(map(type, second)):
        return False
    rounding = COEFFICIENT_ROUNDING
    return all(
        isclose(a.coefficient, b.coefficient, rel_tol=rounding, abs_tol=rounding)
        for a, b in zip(first, second, strict=True)
    )


def is_palindrome(substeps: Substeps) -> bool:
    """Whether a sequence equals its reverse, to rounding: then Φ* = Φ, and the method is symmetric."""
    return are_alike(substeps, mirrored(substeps))
