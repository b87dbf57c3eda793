"""The force of one pair as a function of the distance: its powers of r, its ratio to a known law, its sign, its cutoff,
and the function's own ε and σ.

f > 0 is repulsion. Whether a law returns f/r, as minimd's laws do, is found by comparing it with the energy. Each
parameter is increased by 15 %: if the forces are the same, it has no effect. Both terms of a Lennard-Jones force are
compared with 48 ε σ¹²/r¹³ − 24 ε σ⁶/r⁷.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from minimd.grade.calling import REST, StudentForce, plain
from minimd.grade.findings import Fault, Finding, Kind, all_of, coefficient, first_of, first_of_each, is_near
from minimd.grade.problems import Array, bisected

POWERS = range(1, 21)
FITTED = 1e-7  # largest relative rest of a fit of powers that is exact
SAME = 1e-5  # largest relative difference of equal forces; slopes of the energy come from finite differences
NEAREST, FARTHEST = 0.72, 6.0  # σ; a force capped at 1000 ε/σ is capped below 0.79 σ
GRID = 500
DELTA = 2e-4
JUMP = 1e-6  # of the largest |f| or |u| beyond r = 1
FACTOR = 1.15
TERMS = (("repulsive", 13, 48.0, 12), ("attractive", 7, -24.0, 6))  # name, exponent of 1/r, factor, power of σ
Law = Callable[[float], float]


class Jump(NamedTuple):
    """A jump of f or u: its place, and the values on both sides."""

    r: float
    below: float
    above: float

    @property
    def height(self) -> float:
        """The size of the jump, with its sign."""
        return self.above - self.below


class Powers(NamedTuple):
    """A function that is exactly Σ c r^−n, perhaps with a constant, on a range of distances."""

    exponents: tuple[int, ...]
    coefficients: tuple[float, ...]

    def __str__(self) -> str:
        terms = [f"{'−' if c < 0.0 else '+'} {abs(c):.6g} r^−{n}" for n, c in zip(*self, strict=True)]
        return " ".join(terms).removeprefix("+ ")


def powers_of(values: Array, r: Array) -> Powers | None:
    """One or two inverse powers of r, with a constant if needed; None if no such sum fits."""
    scale = np.abs(values)
    if not (scale > 0.0).any() or not np.isfinite(values).all():
        return None
    weights = 1.0 / np.maximum(scale, 1e-3 * scale.max())
    for constant, count in product((False, True), (1, 2)):
        for exponents in combinations(POWERS, count):
            columns = [r ** float(-n) for n in exponents] + ([np.ones_like(r)] if constant else [])
            matrix = np.array(columns).T * weights[:, None]
            sizes = np.linalg.norm(matrix, axis=0)
            found = np.linalg.lstsq(matrix / sizes, values * weights, rcond=None)[0] / sizes
            if np.abs(values * weights - matrix @ found).max() < FITTED:
                return Powers(exponents[::-1], tuple(float(c) for c in found[:count][::-1]))
    return None


def ratio_of(f: Array, g: Array, r: Array) -> tuple[float, float]:
    """c and k if f = c rᵏ g, from the points where both are large; NaN if there is no such relation."""
    large = (np.abs(g) > 1e-3 * np.median(np.abs(g))) & (np.abs(f) > 0.0) & np.isfinite(f) & np.isfinite(g)
    ratio, logs = f[large] / g[large], np.log(r[large])
    if large.sum() < 5 or not (np.all(ratio > 0.0) or np.all(ratio < 0.0)):
        return np.nan, np.nan
    k, log_c = np.polyfit(logs, np.log(np.abs(ratio)), 1)
    if np.abs(np.log(np.abs(ratio)) - k * logs - log_c).max() > SAME:
        return np.nan, np.nan
    return float(np.sign(ratio[0]) * np.exp(log_c)), round(float(k), 4)


def related(c: float, k: float, other: str, is_law: bool = False) -> tuple[str, list[str]]:
    """The meaning of f = c rᵏ g: words for a finding, and the fault, if it is one.

    is_law : whether f may be f/r.
    """
    if np.isnan(c):
        return f"not {other}, nor a multiple of it", []
    size, power = abs(c), "" if k == 0.0 else f" r^{coefficient(k)}"
    words = f"F = {other}" if (is_near(c, 1.0) and k == 0.0) else f"F = {coefficient(c)}{power} × ({other})"
    faults = first_of_each(
        ((c < 0.0, f"the force has the wrong sign: it is {coefficient(c)} times {other}, so atoms that should repel "
                   "each other attract each other"),),
        ((k == 1.0 and is_law, f"the force has one power of r too many: a factor 1/r is missing in {other}"),
         (k == 1.0, "the factor 1/r is missing: du/dr is multiplied by the vector r_ij, but du/dr / r (or the unit "
                    "vector) is needed"),
         (k == -1.0 and not is_law, "there is a factor 1/r too many: the force is divided by r twice"),
         (k not in (0.0, -1.0), f"the force has {coefficient(abs(k))} power{'s' * (abs(k) != 1)} of r too "
                                f"{'many' if k > 0 else 'few'}")),
        ((is_near(size, 2.0), f"the force is twice {other}: pairs are counted twice, or a factor ½ is missing"),
         (is_near(size, 0.5), f"the force is half of {other}: a factor 2 is missing, or the energy counts each pair "
                              "twice"),
         (not is_near(size, 1.0), f"the force is {coefficient(size)} times {other}")),
    )  # fmt: skip
    return words, ["; ".join(faults)] if faults else []


def jumps(law: Law, r: Array) -> list[Jump]:
    """The jumps of a function of r: between grid points that differ by more than a smooth function would; refined by
    bisection."""

    def is_low(low: float, middle: float, high: float) -> bool:
        return not abs(law(middle) - law(low)) > abs(law(high) - law(middle))

    values, found = np.array([law(float(one)) for one in r]), list[Jump]()
    far, change = r >= 1.0, np.abs(np.diff(values))
    scale = np.abs(values[far] if far.any() else values).max()
    for k in range(2, len(change) - 2):
        beside = max(change[k - 2], change[k - 1], min(change[k + 1], change[k - 1]))
        if change[k] > JUMP * scale and change[k] > 3.0 * beside:
            low, high = bisected(is_low, float(r[k]), float(r[k + 1]), 45)
            one = Jump(high, law(low), law(high))
            found += [one] if abs(one.height) > 0.3 * change[k] else []
    return found


def lennard_jones_fault(f: Powers) -> tuple[str, list[str]]:
    """Name and faults of a force of two powers that should be −du/dr of Lennard-Jones, 48 r^−13 − 24 r^−7 with
    ε = σ = 1."""
    n, c = f.exponents, f.coefficients
    if len(n) != 2 or not (13 in n or 7 in n or (5 <= n[1] <= 9 and 11 <= n[0] <= 15)):
        return "", []
    told, right = f"F = {f}; −du/dr of Lennard-Jones has r^−13 and r^−7", "48 r^−13 − 24 r^−7"
    others = [f"r^−{one} where r^−{known} is needed" for one, known in zip(n, (13, 7), strict=True) if one != known]
    wrong = [(name, [sentence]) for condition, name, sentence in (
        (n == (14, 8), "divided by r", f"{told}: there is a factor 1/r too many. f/r is multiplied by the vector r_ij, "
                                       "not by the unit vector"),
        (n == (12, 6), "times r", f"{told}: the factor 1/r is missing; these are the exponents of the energy (du/dr is "
                                  "multiplied by the vector r_ij, which brings another r)"),
        (others, "with other exponents", f"wrong exponent: {', '.join(others)} ({told})"),
        (c[0] * c[1] >= 0.0, "with a wrong sign", f"F = {f}: both terms have the same sign; repulsion and attraction "
                                                  f"need opposite ones, {right}"),
    ) if condition]  # fmt: skip
    if wrong:
        return f"Lennard-Jones, {wrong[0][0]}", wrong[0][1]
    sizes = abs(c[0]), abs(c[1])
    sigma6 = abs(c[0] / c[1]) / 2.0
    epsilon, sigma = sizes[1] / 24.0 / sigma6, sigma6 ** (1.0 / 6.0)
    times, is_48, is_24 = coefficient(epsilon), is_near(sizes[0], 48.0), is_near(sizes[1], 24.0)
    which, size, needed = ("attractive", sizes[1], 24) if is_48 else ("repulsive", sizes[0], 48)
    reasons = {2.0: "pairs are counted twice, or a factor ½ is missing", 0.5: "a factor 2 is missing"}
    why = next((reasons[one] for one in reasons if is_near(epsilon, one)), "a factor is wrong, unless this ε is meant")
    faults = all_of(
        (c[0] < 0.0, f"the force has the wrong sign: F = {f} attracts at short distances; F = −du/dr = 48ε σ¹²/r¹³ − "
                     "24ε σ⁶/r⁷"),
    )  # fmt: skip
    of_units = first_of(
        (is_near(sizes[0], 24.0) and is_24, "the repulsive term has 24 where 48 = 4 · 12 is needed: "
                                            f"{right} with ε = σ = 1; a factor 2 is missing"),
        (is_near(sigma6, 1.0) and not is_near(epsilon, 1.0), f"with ε = σ = 1 the force is {times} times {right}, as "
                                                             f"for ε = {times}: {why}"),
        (is_48 != is_24, f"with ε = σ = 1 the {which} term has {size:.6g} where {needed} is needed: {right}"),
    )  # fmt: skip
    name = f"Lennard-Jones with ε = {epsilon:.6g}, σ = {sigma:.6g}"
    return name, faults + [Fault(Kind.OF_UNITS, words) for words in of_units]


def cutoff_findings(f: Law, u: Law | None, cutoff: float | None, farthest: float) -> tuple[list[Finding], list[str]]:
    """Whether the force ends at the cutoff, and whether force and energy are continuous; without a cutoff, where they
    jump."""
    r = np.linspace(NEAREST, farthest, GRID)
    steps = {"force": jumps(f, r)} | ({"energy": jumps(u, r)} if u is not None else {})
    findings, faults = list[Finding](), list[str]()
    end = next((one.r for one in steps["force"] if one.above == 0.0), None)
    if cutoff is not None and cutoff < farthest:
        beyond = float(np.abs([f(x) for x in np.linspace(1.001 * cutoff, farthest, 20)]).max())
        words = f"the largest force beyond r = {cutoff:g} is {beyond:.2g}"
        findings.append(Finding("cutoff", beyond == 0.0, words, beyond))
        where = f"; the force ends at {end:.6g} instead" if end is not None else ""
        at = f"at r = {1.001 * cutoff:.4g} the force is {f(1.001 * cutoff):.3g}{where}"
        faults += all_of((beyond != 0.0, Fault(Kind.CUTOFF, f"the cutoff {cutoff:g} is not applied: {at}")))
    if end is not None:
        squared, twice, percents = end**2, 2.0 * end**2, 100.0 * end
        is_odd = is_near(twice, round(twice)) and not is_near(percents, round(percents))
        why = ": r² is compared with the cutoff, not with its square" if is_near(squared, cutoff or np.inf) else ""
        faults += first_of(
            (cutoff is not None and end < 0.999 * cutoff, f"the force ends at r = {end:.6g}, before the cutoff "
                                                          f"{cutoff or 0.0:g}{why}"),
            (cutoff is None and is_odd, f"the force ends at r = {end:.6g}, where r² = {squared:.6g}: is r² compared "
                                        "with a cutoff, not with its square?"),
        )  # fmt: skip
    for name, found in steps.items():
        first = found[0] if found else Jump(0.0, 0.0, 0.0)
        words = "; ".join(f"jumps by {one.height:+.4g} at r = {one.r:.6g}" for one in found[:3]) or "continuous"
        passed = (None if name == "force" else False) if found else True
        findings.append(Finding(f"{name} continuous", passed, words, float(first.height)))
        faults += all_of((passed is False, Fault(
            Kind.JUMP, f"the energy jumps at the cutoff by {first.height:+.4g} (r = {first.r:.6g}): each pair that "
            f"crosses it changes the total energy; subtract u(r_c) = {first.below:.4g} from the energy of every "
            "pair")))  # fmt: skip
    return findings, faults


def values_of(force: StudentForce) -> dict[str, float]:
    """The values of the function's physical parameters, such as ε and σ, by name."""
    values = {**force.defaults, **force.values}
    physical = {name for name in values if force.roles[name] in ("epsilon", "sigma", "stiffness", "strength")}
    rests = {name for name in values if re.search(REST, plain(name))}
    physical = physical - rests | (rests if "stiffness" in force.roles.values() else set())
    numbers = {name: value for name, value in values.items() if type(value) in (int, float, np.float64)}
    return {name: float(value) for name, value in numbers.items() if value > 0.0 and name in physical}


def without_effect(force: StudentForce, x: Array) -> list[str]:
    """Faults for physical parameters whose values have no effect on the forces."""
    faults, given, own = list[str](), force.values, force(x)[0]
    for name, value in values_of(force).items() if np.isfinite(own).all() and np.any(own) else ():
        force.values = {**given, name: FACTOR * value}
        try:
            other = force(x)[0]
        except Exception:  # whatever a student's function raises
            continue
        finally:
            force.values = given
        hint = ", a bond without rest length: F = −k (r − r0) r_ij/r" if re.search(REST, plain(name)) else ""
        faults += all_of((np.array_equal(own, other), f"the argument {name} is without effect: with {name} = {value:g} "
                          f"and {FACTOR * value:g} the forces are the same{hint}"))  # fmt: skip
    return faults


def places_of_epsilon_and_sigma(force: StudentForce, f: Law, r: Array) -> list[str] | None:
    """Faults of a Lennard-Jones force with the function's own ε and σ; None if they cannot be determined."""
    values = {force.roles[name]: value for name, value in values_of(force).items()}
    own = powers_of(np.array([f(float(one)) for one in r]), r) if {"epsilon", "sigma"} <= set(values) else None
    if own is None or own.exponents != (13, 7):
        return None
    epsilon, sigma = values["epsilon"], values["sigma"]
    rights = [factor * epsilon * sigma**power for _, _, factor, power in TERMS]
    ratios = [c / right for c, right in zip(own.coefficients, rights, strict=True)]
    if abs(ratios[0] / ratios[1] - 1.0) < SAME:
        return [] if is_near(ratios[0], 1.0) else None
    faults = []
    for ratio, c, right, (name, n, factor, power) in zip(ratios, own.coefficients, rights, TERMS, strict=True):
        missing = first_of(
            *((sigma != 1.0 and is_near(ratio, sigma**-k), f": σ^{k} is missing") for k in range(power, 0, -1)),
            (epsilon != 1.0 and is_near(ratio, 1.0 / epsilon), ": ε is missing"),
            (True, f", {coefficient(ratio)} times as much"),
        )
        if abs(ratio - 1.0) >= SAME:
            faults.append(f"the {name} term is {c:.6g} r^−{n} where {factor:g} ε σ^{power} r^−{n} = {right:.6g} r^−{n} "
                          f"is needed (with the function's ε = {epsilon:g}, σ = {sigma:g}){missing[0]}")  # fmt: skip
    return faults
