"""Functions of a distance: sums of powers of r, their ratios, and their jumps."""

from collections.abc import Callable
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from minimd.judge.findings import coefficient, first_of, is_near
from minimd.judge.problems import Array, bisected

EXPONENTS = range(1, 21)  # of 1/r
FITTED = 1e-7  # largest relative rest of a fit of powers that is exact
SAME = 1e-5  # relative difference of equal functions, one of them a slope
JUMP = 1e-6  # relative difference of values that are no jump
TWICE = ": pairs are counted twice, or a factor ½ is missing"
HALF = ": a factor 2 is missing, or energies count twice"


class Powers(NamedTuple):
    """A function that is exactly a constant and Σ c r^−n on a range of distances.  terms : c by n, largest n first."""

    terms: dict[int, float]
    constant: float = 0.0

    def at(self, r: Array) -> Array:
        """The values at distances."""
        return np.asarray(self.constant + sum(c * r ** float(-n) for n, c in self.terms.items()))

    def __str__(self) -> str:
        terms = [f"{'−' if c < 0.0 else '+'} {abs(c):.6g} r^−{n}" for n, c in self.terms.items()]
        return " ".join(terms).removeprefix("+ ")


def powers_of(values: Array, r: Array) -> Powers | None:
    """One or two inverse powers of r, with a constant if needed; None if no such sum fits."""
    scale = np.abs(values)
    weights = 1.0 / np.maximum(scale, max(1e-3 * scale.max(initial=0.0), 1e-300))
    for constant, count in (
        product((0, 1), (1, 2)) if scale.any() and np.isfinite(values).all() else ()
    ):
        for n in combinations(EXPONENTS, count):
            matrix = (
                np.array([r ** float(-k) for k in n] + [np.ones_like(r)] * constant).T
                * weights[:, None]
            )
            sizes = np.linalg.norm(matrix, axis=0)
            found = np.linalg.lstsq(matrix / sizes, values * weights, rcond=None)[0] / sizes
            if np.abs(values * weights - matrix @ found).max() < FITTED:
                return Powers(
                    dict(zip(n[::-1], map(float, found[:count][::-1]), strict=True)),
                    float(found[-1]) * constant,
                )
    return None


def compared(f: Array, g: Array, r: Array, other: str) -> tuple[float, float, str]:
    """c and k if f = c rᵏ g, or NaN; and what is wrong if f should be g.  other : what g is."""
    large = (
        (np.abs(g) > 1e-3 * np.median(np.abs(g)))
        & (np.abs(f) > 0.0)
        & np.isfinite(f)
        & np.isfinite(g)
    )
    ratio = f[large] / g[large]
    logs = np.log(r[large])
    k, log_c = np.polyfit(logs, np.log(np.abs(ratio)), 1) if large.sum() > 4 else (0.0, np.nan)
    if (
        np.isnan(log_c)
        or np.ptp(np.sign(ratio))
        or np.abs(np.log(np.abs(ratio)) - k * logs - log_c).max() > SAME
    ):
        own = powers_of(f, r)
        right = powers_of(g, r)
        told = (
            f": wrong exponent, coefficient or sign in F = {own} where {right} is needed"
            if own and right
            else ""
        )
        return np.nan, np.nan, f"the force is not {other}{told or ', nor a multiple of it'}"
    c = np.sign(ratio[0]) * np.exp(log_c)
    k = round(k, 4)
    faults = [
        *first_of((c < 0.0, "the force has the wrong sign, so atoms that should repel each other attract each other")),
        *first_of((k == 1.0, "the factor 1/r is missing: du/dr is multiplied by r_ij, not by the unit vector"),
                  (k, f"the force goes as r^{k:g} times {other}: check the factors 1/r")),
        *first_of((is_near(abs(c), 1.0), ""), (is_near(abs(c), 2.0), f"the force is twice {other}{TWICE}"),
                  (is_near(abs(c), 0.5), f"the force is half of {other}{HALF}"),
                  (True, f"the force is {coefficient(abs(c))} times {other}")),
    ]  # fmt: skip
    return c, k, "; ".join(fault for fault in faults if fault)


def jumps(law: Callable[[float], float], r: Array) -> list[tuple[float, float, float]]:
    """The jumps of a function of r, as r and the values below and above: between grid points that differ by more than a
    smooth function would; refined by bisection."""

    def is_low(low: float, middle: float, high: float) -> bool:
        return not abs(law(middle) - law(low)) > abs(law(high) - law(middle))

    values = np.array([law(one) for one in r])
    found = list[tuple[float, float, float]]()
    change = np.abs(np.diff(values))
    scale = np.abs(values[r >= min(1.0, r[-1])]).max()
    for k in range(2, len(change) - 2):
        beside = max(change[k - 2], change[k - 1], min(change[k + 1], change[k - 1]))
        if change[k] > JUMP * scale and change[k] > 3.0 * beside:
            low, high = bisected(is_low, r[k], r[k + 1], 45)
            if abs(law(high) - law(low)) > 0.3 * change[k]:
                found.append((high, law(low), law(high)))
    return found
