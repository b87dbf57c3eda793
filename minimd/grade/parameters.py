"""Parameters of a force function: those without effect, and wrong terms of a Lennard-Jones force.

Each argument is increased by 15 %: if the forces are the same, it has no effect. Both terms of a Lennard-Jones force
are compared with 48 ε σ¹²/r¹³ − 24 ε σ⁶/r⁷.
"""

from __future__ import annotations

import re

import numpy as np

from minimd.grade.findings import coefficient, is_near
from minimd.grade.force_calling import Array, StudentForce, option_of
from minimd.grade.profile import Law, powers_of

STRENGTH = r"^(k|ks|kb|k_?bond|k_?spring|q|charge|d_?e)$"  # besides ε and σ
REST = r"^(r0|r_?eq|req|l0|d0|length|rest\w*|b0|x0)$"  # of a bond, if there is also a parameter for the stiffness
STIFF = r"^(k|ks|kb|k_?bond|k_?spring)$"
FACTOR = 1.15
DIFFERENT = 1e-5  # coefficients with a larger relative difference are different
TERMS = (("repulsive", 13, 48.0, 12), ("attractive", 7, -24.0, 6))  # name, exponent of 1/r, factor, power of σ


def values_of(force: StudentForce) -> dict[str, float]:
    """The values of the function's physical parameters, such as ε and σ, by name."""
    told = {
        name: force.options[option]
        for name, option in zip(force.names[1 + force.is_of_two :], force.extra, strict=True)
    }
    values = {**force.defaults, **told}
    return {
        name: float(value)
        for name, value in values.items()
        if isinstance(value, (int, float))
        and not isinstance(value, bool)
        and value > 0.0
        and _is_physical(name, list(values))
    }


def _is_physical(name: str, others: list[str]) -> bool:
    if re.search(REST, name.lower()):
        return any(re.search(STIFF, other.lower()) for other in others)
    return option_of(name) in ("epsilon", "sigma") or bool(re.search(STRENGTH, name.lower()))


def changed(force: StudentForce, name: str, value: float) -> tuple[dict[str, object], dict[str, object]]:
    """Options and keyword arguments of the function, with another value for one parameter."""
    option = option_of(name)
    if option and option in force.extra:
        return {**force.options, option: value}, force.named
    return force.options, {**force.named, name: value}


def at_changed(force: StudentForce, name: str, value: float, x: Array) -> Array:
    """Forces with another value for one parameter."""
    options, named = force.options, force.named
    try:
        force.options, force.named = changed(force, name, value)
        return np.asarray(force(x, len(x) if np.ndim(x) == 2 else 2)[0])
    finally:
        force.options, force.named = options, named


def without_effect(force: StudentForce, x: Array) -> list[str]:
    """Faults for physical parameters whose values have no effect on the forces."""
    faults, own = [], force(x, len(x) if np.ndim(x) == 2 else 2)[0]
    if not np.isfinite(own).all() or not np.any(own):
        return []
    for name, value in values_of(force).items():
        try:
            other = at_changed(force, name, FACTOR * value, x)
        except Exception:  # whatever a student's function raises
            continue
        if np.array_equal(own, other):
            hint = ", a bond without rest length: F = −k (r − r0) r_ij/r" if re.search(REST, name.lower()) else ""
            faults.append(
                f"the argument {name} is without effect: with {name} = {value:g} and {FACTOR * value:g} the forces are "
                f"the same{hint}"
            )
    return faults


def places_of_epsilon_and_sigma(force: StudentForce, f: Law, r: Array) -> list[str] | None:
    """Faults of a Lennard-Jones force with the function's own ε and σ; None if they cannot be determined."""
    values = {option_of(name): value for name, value in values_of(force).items()}
    if not {"epsilon", "sigma"} <= set(values):
        return None
    epsilon, sigma = values["epsilon"], values["sigma"]
    own = powers_of(np.array([f(float(one)) for one in r]), r)
    if own is None or own.exponents != (13, 7):
        return None
    ratios = [
        c / (factor * epsilon * sigma**power) for c, (_, _, factor, power) in zip(own.coefficients, TERMS, strict=True)
    ]
    if abs(ratios[0] / ratios[1] - 1.0) < DIFFERENT:
        return [] if is_near(ratios[0], 1.0) else None
    faults = []
    for ratio, c, (name, n, factor, power) in zip(ratios, own.coefficients, TERMS, strict=True):
        if abs(ratio - 1.0) < DIFFERENT:
            continue
        missing = next(
            (f": σ^{k} is missing" for k in range(power, 0, -1) if sigma != 1.0 and is_near(ratio, sigma**-k)), ""
        )
        missing = missing or (
            ": ε is missing"
            if epsilon != 1.0 and is_near(ratio, 1.0 / epsilon)
            else f", {coefficient(ratio)} times as much"
        )
        faults.append(f"the {name} term is {c:.6g} r^−{n} where {factor:g} ε σ^{power} r^−{n} = "
                      f"{factor * epsilon * sigma**power:.6g} r^−{n} is "
                      f"needed (with the function's ε = {epsilon:g}, σ = {sigma:g}){missing}")  # fmt: skip
    return faults
