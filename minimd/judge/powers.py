"""Functions of a distance: sums of powers of r, their ratios, and their jumps."""

from collections.abc import Callable
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from minimd.core.structure.arrays import Array
from minimd.judge.findings import coefficient, is_near
from minimd.judge.problems import bisected, largest

EXPONENTS = range(1, 21)  # of 1/r
FITTED = 1e-7  # largest relative rest of a fit of powers that is exact
SAME = 1e-5  # relative difference of equal functions, one of them a slope
JUMP = 1e-6  # relative difference of values that are no jump


class Powers(NamedTuple):
    """A function that is exactly a constant and Σ c r^−n on a range of distances.  terms : c by n, largest n first."""

    terms: dict[int, float]
    constant: float = 0.0

    def at(self, r: Array) -> Array:
        """The values at distances."""
        values = [c * r ** float(-n) for n, c in self.terms.items()]
        return np.asarray(self.constant + sum(values))

    def __str__(self) -> str:
        terms = [f"{'−' if c < 0.0 else '+'} {abs(c):.6g} r^−{n}" for n, c in self.terms.items()]
        return " ".join(terms).removeprefix("+ ")


def powers_of(values: Array, r: Array) -> Powers | None:
    """One or two inverse powers of r, with a constant if needed; None if no such sum fits."""
    sizes = np.abs(values)
    if not (sizes.any() and np.isfinite(values).all()):
        return None
    smallest = max(1e-3 * sizes.max(), 1e-300)
    weights = 1.0 / np.maximum(sizes, smallest)
    target = values * weights
    for has_constant, count in product((False, True), (1, 2)):
        for exponents in combinations(EXPONENTS, count):
            if has_constant:
                exponents += (0,)
            columns = [r ** float(-n) for n in exponents]
            matrix = np.array(columns).T * weights[:, None]
            norms = np.linalg.norm(matrix, axis=0)
            scaled, *_ = np.linalg.lstsq(matrix / norms, target, rcond=None)
            solution = scaled / norms
            if largest(target - matrix @ solution) < FITTED:
                pairs = zip(exponents, solution.tolist(), strict=True)
                terms = dict(sorted(pairs, reverse=True))
                constant = terms.pop(0, 0.0)
                return Powers(terms, constant)
    return None


def compared(f: Array, g: Array, r: Array, other: str) -> tuple[float, float, str]:
    """c and k if f = c rᵏ g, or NaN; and what is wrong if f should be g.

    f, g : of the distances r, (N,).
    other : what g is.
    """
    is_large = np.abs(g) > 1e-3 * np.median(np.abs(g))
    used = is_large & (np.abs(f) > 0.0) & np.isfinite(f) & np.isfinite(g)
    ratio = f[used] / g[used]
    is_power = False
    if len(ratio) > 4:
        logs = np.log(r[used])
        log_ratio = np.log(np.abs(ratio))
        k, log_c = np.polyfit(logs, log_ratio, 1)
        rest = largest(log_ratio - k * logs - log_c)
        is_power = not (np.ptp(np.sign(ratio)) or rest > SAME or np.isnan(log_c))
    if not is_power:
        fault = f"the force is not {other}, nor a multiple of it"
        own = powers_of(f, r)
        right = powers_of(g, r)
        if own and right:
            fault = (
                f"the force is not {other}: wrong exponent, coefficient or sign in F = {own} "
                f"where {right} is needed"
            )
        return np.nan, np.nan, fault

    c = np.sign(ratio[0]) * np.exp(log_c)
    k = round(k, 4)
    size = abs(c)
    faults = list[str]()
    if c < 0.0:
        faults.append(
            "the force has the wrong sign, so atoms that should repel each other attract each other"
        )
    if k == 1.0:
        faults.append(
            "the factor 1/r is missing: du/dr is multiplied by r_ij, not by the unit vector"
        )
    elif k:
        faults.append(f"the force goes as r^{k:g} times {other}: check the factors 1/r")
    if is_near(size, 2.0):
        faults.append(
            f"the force is twice {other}: pairs are counted twice, or a factor ½ is missing"
        )
    elif is_near(size, 0.5):
        faults.append(
            f"the force is half of {other}: a factor 2 is missing, or energies count twice"
        )
    elif not is_near(size, 1.0):
        faults.append(f"the force is {coefficient(size)} times {other}")
    return c, k, "; ".join(faults)


def jumps(law: Callable[[float], float], r: Array) -> list[tuple[float, float, float]]:
    """The jumps of a function of r, as r and the values below and above: between grid points that differ by more than a
    smooth function would; refined by bisection."""

    def is_low(low: float, middle: float, high: float) -> bool:
        return not abs(law(middle) - law(low)) > abs(law(high) - law(middle))

    values = np.array([law(distance) for distance in r])
    changes = np.abs(np.diff(values))
    scale = largest(values[r >= min(1.0, r[-1])])
    places = list[tuple[float, float, float]]()
    for k in range(2, len(changes) - 2):
        change = changes[k]
        before = max(changes[k - 2], changes[k - 1])
        is_jump = change > JUMP * scale and change > 3.0 * before
        if not is_jump:
            continue
        low, high = bisected(is_low, r[k], r[k + 1], 45)
        below = law(low)
        above = law(high)
        if abs(above - below) > 0.3 * change:
            places.append((high, below, above))
    return places
