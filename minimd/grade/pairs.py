"""The force of one pair as a function of the distance, f > 0 for repulsion: its powers of r, its ratio to a known law,
whether it is capped, where it jumps and ends."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from minimd.grade.findings import Law, coefficient, first_of, is_near
from minimd.grade.problems import Array, bisected, difference

EXPONENTS, FITTED = range(1, 21), 1e-7  # of 1/r; largest relative rest of a fit of powers that is exact
SAME, SAME_FORCE, CAPPED = 1e-5, 1e-9, 1e-4  # relative differences of equal forces; slopes come from finite differences
CLOSEST, NEAREST, FARTHEST = (
    0.3,
    0.77,
    6.0,
)  # σ: of the search for a cap, of ordinary distances, of the search for an end
POINTS, GRID, DELTA, JUMP = 40, 500, 2e-4, 1e-6  # a jump is that of the largest |f| or |u| beyond r = 1
TWICE, HALF = (
    "pairs are counted twice, or a factor ½ is missing",
    "a factor 2 is missing, or energies are counted twice",
)
Function = Callable[[float], float]


class Powers(NamedTuple):
    """A function that is exactly a constant and Σ c r^−n on a range of distances."""

    exponents: tuple[int, ...]
    coefficients: tuple[float, ...]
    constant: float

    def at(self, r: Array) -> Array:
        """The values at distances."""
        return np.asarray(self.constant + sum(c * r ** float(-n) for n, c in zip(*self[:2], strict=True)))

    def __str__(self) -> str:
        terms = [f"{'−' if c < 0.0 else '+'} {abs(c):.6g} r^−{n}" for n, c in zip(*self[:2], strict=True)]
        return " ".join(terms).removeprefix("+ ")


def powers_of(values: Array, r: Array) -> Powers | None:
    """One or two inverse powers of r, with a constant if needed; None if no such sum fits."""
    scale = np.abs(values)
    if not scale.any() or not np.isfinite(values).all():
        return None
    weights = 1.0 / np.maximum(scale, 1e-3 * scale.max())
    for constant, count in product((0, 1), (1, 2)):
        for n in combinations(EXPONENTS, count):
            matrix = np.array([r ** float(-k) for k in n] + [np.ones_like(r)] * constant).T * weights[:, None]
            sizes = np.linalg.norm(matrix, axis=0)
            found = np.linalg.lstsq(matrix / sizes, values * weights, rcond=None)[0] / sizes
            if np.abs(values * weights - matrix @ found).max() < FITTED:
                return Powers(n[::-1], tuple(map(float, found[:count][::-1])), float(found[-1]) * constant)
    return None


def ratio_of(f: Array, g: Array, r: Array) -> tuple[float, float]:
    """c and k if f = c rᵏ g, from the points where both are large; NaN if there is no such relation."""
    large = (np.abs(g) > 1e-3 * np.median(np.abs(g))) & (np.abs(f) > 0.0) & np.isfinite(f) & np.isfinite(g)
    ratio, logs = f[large] / g[large], np.log(r[large])
    if large.sum() < 5 or np.ptp(np.sign(ratio)):
        return np.nan, np.nan
    k, log_c = np.polyfit(logs, np.log(np.abs(ratio)), 1)
    is_power = np.abs(np.log(np.abs(ratio)) - k * logs - log_c).max() < SAME
    return (float(np.sign(ratio[0]) * np.exp(log_c)), round(float(k), 4)) if is_power else (np.nan, np.nan)


def related(c: float, k: float, other: str) -> list[str]:
    """The fault of a force f = c rᵏ g; none for c = 1, k = 0, or if there is no such relation."""
    many = "many" if k > 0.0 else "few"
    faults = [] if np.isnan(c) else [
        *first_of((c < 0.0, "the force has the wrong sign, so atoms that should repel each other attract each other")),
        *first_of((k == 1.0, "the factor 1/r is missing: du/dr is multiplied by the vector r_ij, but du/dr / r, or the unit "
                             "vector, is needed"),
                  (k, f"the force has {coefficient(abs(k))} power of r too {many}; 1/r is the unit vector's")),
        *first_of((is_near(abs(c), 2.0), f"the force is twice {other}: {TWICE}"),
                  (is_near(abs(c), 0.5), f"the force is half of {other}: {HALF}"),
                  (not is_near(abs(c), 1.0), f"the force is {coefficient(abs(c))} times {other}")),
    ]  # fmt: skip
    return [f"{'; '.join(faults)} (F = {coefficient(c)} r^{coefficient(k)} × {other})"] if faults else []


def jumps(law: Function, r: Array) -> list[tuple[float, float, float]]:
    """The jumps of a function of r, as r and the values below and above: between grid points that differ by more than a
    smooth function would; refined by bisection."""

    def is_low(low: float, middle: float, high: float) -> bool:
        return not abs(law(middle) - law(low)) > abs(law(high) - law(middle))

    values, found = np.array([law(float(one)) for one in r]), list[tuple[float, float, float]]()
    change, scale = np.abs(np.diff(values)), np.abs(values[r >= min(1.0, r[-1])]).max()
    for k in range(2, len(change) - 2):
        beside = max(change[k - 2], change[k - 1], min(change[k + 1], change[k - 1]))
        if change[k] > JUMP * scale and change[k] > 3.0 * beside:
            low, high = bisected(is_low, float(r[k]), float(r[k + 1]), 45)
            found += [(high, law(low), law(high))] * int(abs(law(high) - law(low)) > 0.3 * change[k])
    return found


def lennard_jones(own: Powers, epsilon: float, sigma: float, is_given: bool) -> tuple[str, list[str]]:
    """Name and faults of a force of two powers that should be 48 ε σ¹² r^−13 − 24 ε σ⁶ r^−7.  is_given : whether ε and σ
    are those of the function."""
    n, c = own.exponents, own.coefficients
    if len(n) != 2 or not (13 in n or 7 in n or (5 <= n[1] <= 9 and 11 <= n[0] <= 15)):
        return "", []
    right, units = "48 ε σ¹² r^−13 − 24 ε σ⁶ r^−7", f"with ε = {epsilon:g}, σ = {sigma:g}"
    ratios, sigma6 = (c[0] / (48.0 * epsilon * sigma**12), -c[1] / (24.0 * epsilon * sigma**6)), abs(c[0] / c[1]) / 2.0
    name, sizes = f"Lennard-Jones with ε = {abs(c[1]) / 24.0 / sigma6:.6g}, σ = {sigma6 ** (1 / 6):.6g}", np.abs(c)
    if n != (13, 7):
        why = {(14, 8): ": a factor 1/r too many, f/r is multiplied by r_ij", (12, 6): ": the factor 1/r is missing"}
        return "nearly Lennard-Jones", [f"wrong exponent: F = {own} where {right} is needed{why.get(n, '')}"]
    if c[0] < 0.0 or c[1] > 0.0:
        return name, [f"wrong sign: F = {own} where repulsion is positive and attraction negative, {right}"]
    if is_near(ratios[0] / ratios[1], 1.0):
        why = TWICE if is_near(ratios[0], 2.0) else HALF if is_near(ratios[0], 0.5) else "unless another ε is meant"
        return name, first_of(
            (not is_near(ratios[0], 1.0), f"the force is {coefficient(ratios[0])} times {right} {units}: {why}")
        )
    faults, is_own = list[str](), not is_given and not any(is_near(one, m) for one in sizes for m in (24.0, 48.0))
    for ratio, one, factor, power in zip(ratios, c, (48, -24), (12, 6), strict=True):
        hints = [f": σ^{k} is missing" for k in range(power, 0, -1) if sigma != 1.0 and is_near(ratio, sigma**-k)]
        hints += [": ε is missing"] * (epsilon != 1.0 and is_near(ratio, 1.0 / epsilon))
        faults += first_of((not is_near(ratio, 1.0), f"the {'repulsive' if factor > 0 else 'attractive'} term is {one:.6g} "
                            f"r^−{power + 1} where {factor} ε σ^{power} r^−{power + 1} is needed {units}, {coefficient(ratio)} "
                            f"times as much{(*hints, '')[0]}"))  # fmt: skip
    return name, [] if is_own else faults


class Pair:
    """What is measured on the force of a pair: see Law.measure.

    f, u : of the distance; u is None without an energy.  known : the force of a potential of minimd.  units : ε and σ,
    and whether they are the function's own.  is_law : whether f may be f/r.  may_jump : whether the energy may.
    """

    name, is_cube, may_jump, off_center = "", False, False, 0.0

    def __init__(
        self,
        f: Function,
        u: Function | None,
        known: Function | None,
        farthest: float,
        cutoff: float | None,
        is_law: bool,
    ) -> None:
        self.f, self.u, self.farthest, self.cutoff, self.is_law = f, u, farthest, cutoff, is_law
        end, self.faults, self.remarks = min(farthest, 0.9 * (cutoff or 2.5), 2.2), list[str](), list[str]()
        ended = [x for x in np.linspace(1.0, end, 60) if f(float(x)) == 0.0]
        self.r = np.linspace(NEAREST, 0.98 * ended[0] if ended else end, POINTS)
        self.values, self.slopes = self.at(f, self.r), self.slopes_at(self.r)
        self.is_finite, self.known = (
            bool(np.isfinite(self.values).all()),
            None if known is None else self.at(known, self.r),
        )
        others = self.known if self.slopes is None else self.slopes
        if is_law and others is not None and ratio_of(self.values, others, self.r)[1] == -1.0:
            self.remarks.append("the law returns f = −u′(r)/r, as minimd's laws do: multiply it by the vector r_ij")
            self.values, self.f = self.values * self.r, lambda r: f(r) * r
        self.powers = powers_of(self.values, self.r)

    def at(self, f: Function, r: Array) -> Array:
        """The values of a function."""
        return np.array([f(float(x)) for x in r])

    def slopes_at(self, r: Array) -> Array | None:
        """−du/dr."""
        u = self.u
        return None if u is None else -self.at(lambda x: difference(u, x, DELTA) / DELTA, r)

    def name_with(self, epsilon: float, sigma: float, is_given: bool) -> None:
        """Find the name of the law, and the faults of a Lennard-Jones force."""
        self.name, faults = lennard_jones(self.powers, epsilon, sigma, is_given) if self.powers else ("", [])
        is_alone = is_given or (self.known is None and self.u is None)
        self.faults, self.suspected = faults if is_alone else [], faults
        is_inverse = self.powers is not None and self.powers.exponents == (1,) and not self.is_law and is_alone
        self.remarks += first_of((is_inverse, "the force of a pair decreases as r^−1. If q²/r² is meant, a factor 1/r is "
                                  "missing: q² r_ij/r³, not q² r_ij/r²"))  # fmt: skip

    def gradient(self) -> tuple[float, float] | None:
        """The force as a multiple of −du/dr."""
        if self.slopes is None:
            return None
        c, k = ratio_of(self.values, self.slopes, self.r)
        energy = None if self.u is None or not np.isnan(c) else powers_of(self.at(self.u, self.r), self.r)
        slope = energy and Powers(
            *zip(*[(n + 1, n * one) for n, one in zip(*energy[:2], strict=True)], strict=True), 0.0
        )
        told = f": F = {self.powers} where {slope} is needed" if self.powers and slope else ", nor a multiple of it"
        faults = [f"the force is not minus the slope of the energy{told}"] if np.isnan(c) else related(c, k, "−du/dr")
        self.faults += faults
        return c, float(len(faults))

    def beside(self) -> float | None:
        """The force beside that of minimd."""
        if self.known is None:
            return None
        off = float(np.abs(self.values - self.known).max() / np.abs(self.known).max())
        faults = related(*ratio_of(self.values, self.known, self.r), "minimd's force") or self.suspected
        if off > SAME_FORCE and not self.faults:
            self.faults += faults or [f"the force differs from minimd's by {off:.1%} of the largest"]
        return off

    def cap(self) -> tuple[float, float, float] | None:
        """How far the force at close distances is from the powers of r that it has farther away, or from its energy."""
        r, far = np.geomspace(CLOSEST, 1.0, POINTS), self.r > 1.0
        f, powers = self.at(self.f, r), self.powers or powers_of(self.values[far], self.r[far])
        right = powers.at(r) if powers else self.slopes_at(r)
        is_flat, rest = np.ptp(f[:4]) == 0.0 != np.ptp(f), np.abs(f / (f if right is None else right) - 1.0)
        if not np.isfinite(rest).all():
            return None
        off = r[(rest > CAPPED) | ((f == f[0]) & is_flat)]
        return float(off.max(initial=0.0)), float(len(off)), float(rest.max())

    def ending(self) -> tuple[float, float, float] | None:
        """The largest force beyond the cutoff."""
        if self.cutoff is None or self.cutoff >= self.farthest or self.is_cube:
            return None
        beyond = float(np.abs(self.at(self.f, np.linspace(1.001 * self.cutoff, self.farthest, 20))).max())
        return beyond, beyond, self.cutoff

    def continuous(self, law: Function | None) -> tuple[float, float, str] | None:
        """The jumps of the force or of the energy."""
        found = jumps(law, np.linspace(NEAREST, self.farthest, GRID)) if law else []
        end, cutoff = next((r for r, _, above in found if above == 0.0), np.inf), self.cutoff or np.inf
        is_odd = (
            end < np.inf and is_near(2.0 * end**2, round(2.0 * end**2)) and not is_near(100.0 * end, round(100.0 * end))
        )
        self.faults += first_of(
            (law is self.f and end < 0.999 * cutoff < np.inf, f"the force ends at r = {end:.6g}, before the cutoff {cutoff}"
             + ": r² is compared with the cutoff, not with its square" * is_near(end**2, cutoff)),
            (law is self.f and self.cutoff is None and is_odd, f"the force ends at r = {end:.6g}, where r² = {end**2:.6g}: is r² "
                                                               "compared with a cutoff, not with its square?"),
            *((law is self.u and not self.may_jump, f"the energy jumps at the cutoff by {above - below:+.4g} (r = {r:.6g}): each "
               f"pair that crosses it changes the total energy; subtract u(r_c) = {below:.4g} from the energy of every pair")
              for r, below, above in found[:1]),
        )  # fmt: skip
        words = (
            "; ".join(f"jumps by {above - below:+.4g} at r = {r:.6g}" for r, below, above in found[:3]) or "continuous"
        )
        return None if law is None else (found[0][2] - found[0][1] if found else 0.0, float(len(found)), words)


FINITE = Law("finite", lambda p: (np.nan, float(not p.is_finite)), 0.5, "all forces are finite, or not",
             "the force of a pair is not finite at an ordinary distance")  # fmt: skip
LAWS = (
    FINITE,
    Law("central", lambda p: p.off_center, 1e-9, "F × r_ij is {0:.1e} of F r", "the force of the pair does not point along "
        "r_ij: the direction must be r_ij/r in all three components"),
    Law("force = −∇U", Pair.gradient, 0.5, "F is {0:.6g} times −du/dr"),
    Law("powers of r", lambda p: p.powers and (np.nan, float(len(p.faults or p.remarks)), p.powers), 0.5, "F = {2}",
        otherwise=None),
    Law("as minimd's", Pair.beside, SAME_FORCE, "largest difference {0:.1e} of the largest force"),
    Law("not capped", Pair.cap, 0.5, "F at close distances differs from its law by {2:.1e}", "the force is capped at distances "
        "below {0:.3f}: it is no longer the law, nor −du/dr of the energy, and close atoms are pushed apart too slowly"),
    Law("cutoff", Pair.ending, 1e-300, "the largest force beyond r = {2:g} is {0:.2g}", "the cutoff {2:g} is not applied: "
        "the largest force beyond it is {0:.3g}"),
    Law("force continuous", lambda p: p.continuous(p.f), 0.5, "{2}", otherwise=None),
    Law("energy continuous", lambda p: p.continuous(p.u), 0.5, "{2}", otherwise=None),
)  # fmt: skip
