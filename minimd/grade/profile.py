"""The force of one pair as a function of the distance: its powers of r, its ratio to a known law, its sign, its cutoff.

f > 0 is repulsion. Whether a law returns f/r, as minimd's laws do, is found by comparing it with the energy.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np

from minimd.grade.findings import Fault, Finding, Kind, coefficient, is_near
from minimd.grade.force_calling import Array

POWERS = range(1, 21)
FITTED = 1e-7  # largest relative rest of a fit of powers that is exact
SAME = 1e-5  # largest relative difference of equal forces; slopes of the energy come from finite differences
NEAREST, FARTHEST = 0.72, 6.0  # σ; a force capped at 1000 ε/σ is capped below 0.79 σ
GRID = 500
DELTA = 2e-4
JUMP = 1e-6  # of the largest |f| or |u| beyond r = 1
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
        signs = [
            ("− " if c < 0.0 else "+ " if k else "") + f"{abs(c):.6g} r^−{n}"
            for k, (n, c) in enumerate(zip(self.exponents, self.coefficients, strict=True))
        ]
        return " ".join(signs)


def powers_of(values: Array, r: Array) -> Powers | None:
    """One or two inverse powers of r, with a constant if needed; None if no such sum fits."""
    scale = np.abs(values)
    if not (scale > 0.0).any() or not np.isfinite(values).all():
        return None
    weights = 1.0 / np.maximum(scale, 1e-3 * scale.max())
    for constant in (False, True):
        for count in (1, 2):
            for exponents in combinations(POWERS, count):
                columns = [r ** float(-n) for n in exponents] + ([np.ones_like(r)] if constant else [])
                matrix = np.array(columns).T * weights[:, None]
                sizes = np.linalg.norm(matrix, axis=0)
                found = np.linalg.lstsq(matrix / sizes, values * weights, rcond=None)[0] / sizes
                rest = values * weights - matrix @ found
                if np.abs(rest).max() < FITTED:
                    order = np.argsort(exponents)[::-1]
                    return Powers(tuple(exponents[k] for k in order), tuple(float(found[k]) for k in order))
    return None


def slope_of(u: Law, r: float) -> float:
    """du/dr, by a difference of order 6."""
    return sum(c * (u(r + k * DELTA) - u(r - k * DELTA)) for k, c in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))) / DELTA


def ratio_of(f: Array, g: Array, r: Array) -> tuple[float, float] | None:
    """c and k if f = c rᵏ g, from the points where both are large; None if there is no such relation."""
    large = (np.abs(g) > 1e-3 * np.median(np.abs(g))) & (np.abs(f) > 0.0) & np.isfinite(f) & np.isfinite(g)
    if large.sum() < 5:
        return None
    ratio = f[large] / g[large]
    if not (np.all(ratio > 0.0) or np.all(ratio < 0.0)):
        return None
    k, log_c = np.polyfit(np.log(r[large]), np.log(np.abs(ratio)), 1)
    if np.abs(np.log(np.abs(ratio)) - k * np.log(r[large]) - log_c).max() > SAME:
        return None
    return float(np.sign(ratio[0]) * np.exp(log_c)), round(float(k), 4)


def related(pair: tuple[float, float] | None, other: str, is_law: bool = False) -> tuple[str, str]:
    """The meaning of f = c rᵏ g: words for a finding, and the fault (empty if there is none).  is_law :
    whether f may be f/r."""
    if pair is None:
        return f"not {other}, nor a multiple of it", ""
    c, k = pair
    power = "" if k == 0.0 else f" r^{coefficient(k)}"
    words = f"F = {other}" if (is_near(c, 1.0) and k == 0.0) else f"F = {coefficient(c)}{power} × ({other})"
    faults = []
    if c < 0.0:
        faults.append(
            f"the force has the wrong sign: it is {coefficient(c)} times {other}, so atoms that should repel each "
            "other attract each other"
        )
    if k == 1.0 and is_law:
        faults.append(f"the force has one power of r too many: a factor 1/r is missing in {other}")
    elif k == 1.0:
        faults.append(
            "the factor 1/r is missing: du/dr is multiplied by the vector r_ij, but du/dr / r (or the unit vector) is "
            "needed"
        )
    elif k == -1.0 and not is_law:
        faults.append("there is a factor 1/r too many: the force is divided by r twice")
    elif k not in (0.0, -1.0):
        faults.append(
            f"the force has {coefficient(abs(k))} power{'s' * (abs(k) != 1)} of r too {'many' if k > 0 else 'few'}"
        )
    size = abs(c)
    if is_near(size, 2.0):
        faults.append(f"the force is twice {other}: pairs are counted twice, or a factor ½ is missing")
    elif is_near(size, 0.5):
        faults.append(f"the force is half of {other}: a factor 2 is missing, or the energy counts each pair twice")
    elif not is_near(size, 1.0):
        faults.append(f"the force is {coefficient(size)} times {other}")
    return words, "; ".join(faults)


def jumps(law: Law, r: Array) -> list[Jump]:
    """The jumps of a function of r: between grid points that differ by more than a smooth function would;
    refined by bisection."""
    values = np.array([law(float(one)) for one in r])
    scale = np.abs(values[r >= 1.0]).max() if (r >= 1.0).any() else np.abs(values).max()
    found: list[Jump] = []
    change = np.abs(np.diff(values))
    for k in range(2, len(change) - 2):
        beside = max(change[k - 2], change[k - 1], min(change[k + 1], change[k - 1]))
        if change[k] > JUMP * scale and change[k] > 3.0 * beside and not (found and k < 3):
            low, high = float(r[k]), float(r[k + 1])
            for _ in range(45):
                middle = 0.5 * (low + high)
                if abs(law(middle) - law(low)) > abs(law(high) - law(middle)):
                    high = middle
                else:
                    low = middle
            one = Jump(high, law(low), law(high))
            if abs(one.height) > 0.3 * change[k]:
                found.append(one)
    return found


def lennard_jones_fault(f: Powers) -> tuple[str, list[str]]:
    """Name and faults of a force of two powers that should be −du/dr of Lennard-Jones,
    48 r^−13 − 24 r^−7 with ε = σ = 1."""
    n, c = f.exponents, f.coefficients
    if len(n) != 2:
        return "", []
    if n == (13, 7):
        if c[0] * c[1] >= 0.0:
            return "Lennard-Jones, with a wrong sign", [
                f"F = {f}: both terms have the same sign; repulsion and attraction need opposite ones, 48 r^−13 − 24 "
                "r^−7"
            ]
        sigma6 = abs(c[0] / c[1]) / 2.0
        epsilon, sigma = abs(c[1]) / 24.0 / sigma6, sigma6 ** (1.0 / 6.0)
        name = f"Lennard-Jones with ε = {epsilon:.6g}, σ = {sigma:.6g}"
        faults = []
        if c[0] < 0.0:
            faults.append(
                f"the force has the wrong sign: F = {f} attracts at short distances; F = −du/dr = 48ε σ¹²/r¹³ − 24ε "
                "σ⁶/r⁷"
            )
        if is_near(abs(c[0]), 24.0) and is_near(abs(c[1]), 24.0):
            words = "the repulsive term has 24 where 48 = 4 · 12 is needed: 48 r^−13 − 24 r^−7 with ε = σ = 1"
            faults.append(Fault(Kind.OF_UNITS, f"{words}; a factor 2 is missing"))
        elif is_near(sigma6, 1.0) and not is_near(epsilon, 1.0):
            times, why = coefficient(epsilon), "a factor is wrong, unless this ε is meant"
            if is_near(epsilon, 2.0):
                why = "pairs are counted twice, or a factor ½ is missing"
            elif is_near(epsilon, 0.5):
                why = "a factor 2 is missing"
            words = f"with ε = σ = 1 the force is {times} times 48 r^−13 − 24 r^−7, as for ε = {times}: {why}"
            faults.append(Fault(Kind.OF_UNITS, words))
        elif sum((is_near(abs(c[0]), 48.0), is_near(abs(c[1]), 24.0))) == 1:
            which, size, right = (
                ("attractive", abs(c[1]), 24) if is_near(abs(c[0]), 48.0) else ("repulsive", abs(c[0]), 48)
            )
            words = f"with ε = σ = 1 the {which} term has {size:.6g} where {right} is needed: 48 r^−13 − 24 r^−7"
            faults.append(Fault(Kind.OF_UNITS, words))
        return name, faults
    told = f"F = {f}; −du/dr of Lennard-Jones has r^−13 and r^−7"
    if n == (14, 8):
        return "Lennard-Jones, divided by r", [
            f"{told}: there is a factor 1/r too many. f/r is multiplied by the vector r_ij, not by the unit vector"
        ]
    if n == (12, 6):
        return "Lennard-Jones, times r", [f"{told}: the factor 1/r is missing; these are the exponents of the energy "
                                          f"(du/dr is multiplied by the vector r_ij, "
                                          "which brings another r)"]  # fmt: skip
    if 13 in n or 7 in n or (5 <= n[1] <= 9 and 11 <= n[0] <= 15):
        wrong = [
            f"r^−{have} where r^−{right} is needed" for have, right in zip(n, (13, 7), strict=True) if have != right
        ]
        return "Lennard-Jones, with other exponents", [f"wrong exponent: {', '.join(wrong)} ({told})"]
    return "", []


def _other_cutoff(seen: list[Jump], cutoff: float | None) -> list[str]:
    """The fault of a force that ends before the cutoff, for example because r² is compared with it."""
    ends = [one.r for one in seen if one.above == 0.0]
    if not ends:
        return []
    end, squared = ends[0], ends[0] ** 2
    if cutoff is not None and end < 0.999 * cutoff:
        why = ": r² is compared with the cutoff, not with its square" if is_near(squared, cutoff) else ""
        return [f"the force ends at r = {end:.6g}, before the cutoff {cutoff:g}{why}"]
    if cutoff is None and is_near(2.0 * squared, round(2.0 * squared)) and not is_near(100.0 * end, round(100.0 * end)):
        return [
            f"the force ends at r = {end:.6g}, where r² = {squared:.6g}: is r² compared with a cutoff, not with its "
            "square?"
        ]
    return []


def cutoff_findings(f: Law, u: Law | None, cutoff: float | None, farthest: float) -> tuple[list[Finding], list[str]]:
    """Whether the force ends at the cutoff, and whether force and energy are continuous; without a cutoff,
    where they jump."""
    r = np.linspace(NEAREST, farthest, GRID)
    steps = [("force", jumps(f, r))] + ([("energy", jumps(u, r))] if u is not None else [])
    findings: list[Finding] = []
    faults: list[str] = []
    if cutoff is not None and cutoff < farthest:
        beyond = float(np.abs([f(x) for x in np.linspace(1.001 * cutoff, farthest, 20)]).max())
        kept = beyond == 0.0
        findings.append(Finding("cutoff", kept, f"the largest force beyond r = {cutoff:g} is {beyond:.2g}", beyond))
        if not kept:
            seen = [one.r for one in steps[0][1] if one.above == 0.0]
            where = f"; the force ends at {seen[0]:.6g} instead" if seen else ""
            at = f"at r = {1.001 * cutoff:.4g} the force is {f(1.001 * cutoff):.3g}{where}"
            faults.append(Fault(Kind.CUTOFF, f"the cutoff {cutoff:g} is not applied: {at}"))
    faults += _other_cutoff(steps[0][1], cutoff)
    for name, found in steps:
        words = "; ".join(f"jumps by {one.height:+.4g} at r = {one.r:.6g}" for one in found[:3]) or "continuous"
        passed = (None if name == "force" else False) if found else True
        findings.append(Finding(f"{name} continuous", passed, words, float(found[0].height) if found else 0.0))
        if found and name == "energy":
            jump = f"the energy jumps at the cutoff by {found[0].height:+.4g} (r = {found[0].r:.6g})"
            cure = f"subtract u(r_c) = {found[0].below:.4g} from the energy of every pair"
            faults.append(Fault(Kind.JUMP, f"{jump}: each pair that crosses it changes the total energy; {cure}"))
    return findings, faults
