"""What the coefficients of kicks and drifts tell: the order, from its conditions; the longest stable step.

A sequence has order p if its step and the exact flow agree through Δtᵖ. There are two orders:

    separable order   for every H = T(p) + V(q); for every q′ = g(v), v′ = f(q)
    Nyström order     for T = p²/2m, that is q″ = f(q): fewer conditions, never a lower order

E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), III.3 and IV.2; R. I. McLachlan, G. R. W.
Quispel, Acta Numerica 11, 341 (2002), section 4.

On a harmonic oscillator q″ = −ω²q, with h = ωΔt, in units of q and v/ω:

    drift (1 ch; 0 1)   kick (1 0; −ch 1)   step M(h) : their product, det M = 1

Powers of M stay bounded while |tr M| < 2. E. Hairer, C. Lubich, G. Wanner (2006), I.5.2; B. Leimkuhler, S. Reich,
Simulating Hamiltonian Dynamics (2004), 2.6.
"""

from collections.abc import Callable, Iterator
from functools import cache
from itertools import product
from math import factorial, pi, prod
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from minimd.core.integrators.substeps import (
    Drift,
    Kick,
    Substep,
    Substeps,
    checked_substeps,
    mechanical,
    merged,
    outer_substeps,
)
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_number

__all__ = [
    "accurate_step",
    "energy_oscillation",
    "nystrom_order",
    "separable_order",
    "stability_limit",
]

HIGHEST_ORDER = 10  # conditions are evaluated up to this order
TOLERANCE = 1e-12  # coefficients of 14 digits pass; a condition that fails leaves 1e-6 and more

Word = tuple[type[Substep], ...]


def separable_order(substeps: Substeps) -> int:
    """Order for every H = T(p) + V(q), at most HIGHEST_ORDER; 0 if the sequence is not consistent.
    Raises TypeError, ValueError for wrong substeps, as all functions here: see checked_substeps."""
    return _order(checked_substeps(substeps), separable_residuals)


def nystrom_order(substeps: Substeps) -> int:
    """Order for H = p²/2m + V(q), at most HIGHEST_ORDER; 0 if the sequence is not consistent."""
    return _order(checked_substeps(substeps), nystrom_residuals)


@cache
def _order(substeps: Substeps, residuals: Callable[[Substeps, int], list[float]]) -> int:
    """The highest order up to which there are no residuals."""
    for order in range(1, HIGHEST_ORDER + 1):
        if max(map(abs, residuals(substeps, order))) > TOLERANCE:
            return order - 1
    return HIGHEST_ORDER


def separable_residuals(substeps: Substeps, order: int) -> list[float]:
    """Residuals of the conditions of exactly this order: coefficient of each Lyndon word − 1/order!.

    The step is exp(c₁X₁) exp(c₂X₂) …, where each X is T or V. The exact flow is exp(T + V), in which every word of n
    letters T, V has the coefficient 1/n!. Both series are group-like, and such series agree if they agree on the Lyndon
    words, the words that come before all their rotations. For n = 1, …, 8 there are 2, 1, 2, 3, 6, 9, 18, 30 of them,
    as many as there are independent conditions (C. Reutenauer, Free Lie Algebras (1993), chapter 6)."""
    exact = 1.0 / factorial(order)
    return [word_coefficient(substeps, word) - exact for word in lyndon_words(order)]


@cache
def lyndon_words(length: int) -> tuple[Word, ...]:
    """Words in Drift < Kick that come strictly before each of their rotations."""
    lyndon = []
    for letters in product((0, 1), repeat=length):
        if all(letters < letters[k:] + letters[:k] for k in range(1, length)):
            lyndon.append(tuple((Drift, Kick)[letter] for letter in letters))
    return tuple(lyndon)


def word_coefficient(substeps: Substeps, word: Word) -> float:
    """Coefficient of a word in exp(c₁X₁) exp(c₂X₂) …; the factor exp(cX) appends k letters X with the weight cᵏ/k!."""
    # coefficient of the first j letters of the word in the product so far
    prefix = [1.0] + [0.0] * len(word)
    for substep in substeps:
        for j in range(len(word), 0, -1):
            weight = 1.0
            k = 1
            while k <= j and word[j - k] is type(substep):
                weight *= substep.coefficient / k
                prefix[j] += weight * prefix[j - k]
                k += 1
    return prefix[-1]


class Branch(NamedTuple):
    """A branch of a Nyström tree: its power of Δt, its value at each kick and in the exact solution, κ Δt^power."""

    power: int
    values: Array
    kappa: float


def nystrom_residuals(substeps: Substeps, order: int) -> list[float]:
    """Residuals of the conditions of exactly this order for q″ = f(q): Σ bᵢ Φᵢ(τ) − κ(τ)/order for each Nyström tree τ.

    As a Runge-Kutta-Nyström method the sequence has, for kick i, the weight bᵢ, the abscissa cᵢ = Σ drifts before it
    and aᵢⱼ = bⱼ (cᵢ − cⱼ), j before i. A tree is a force f with branches: velocities, Φᵢ = cᵢ, and forces integrated
    twice, Φᵢ = Σⱼ aᵢⱼ Φⱼ. These are the conditions for velocities. Those for positions, with weights bᵢ (1 − cᵢ),
    follow from them if Σ drifts = 1. The trees: E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), II.14."""
    kicks = [k for k, substep in enumerate(substeps) if isinstance(substep, Kick)]
    b = np.array([substeps[k].coefficient for k in kicks])
    c = np.array([drifts_sum(substeps[:k]) for k in kicks])
    a = np.tril(b * (c[:, None] - c), -1)
    branches = [Branch(1, c, 1.0)]
    for power in range(1, order + 1):
        trees = []
        for tree in bunches(branches, power - 1):
            values = np.ones_like(c)
            for branch in tree:
                values = values * branch.values
            trees.append((values, prod(branch.kappa for branch in tree)))
        for values, kappa in trees:
            branches.append(Branch(power + 1, a @ values, kappa / (power * (power + 1))))
    residuals = [float(b @ values - kappa / order) for values, kappa in trees]
    return residuals if order > 1 else [*residuals, drifts_sum(substeps) - 1.0]


def drifts_sum(substeps: Substeps) -> float:
    """Σ of the coefficients of all drifts."""
    return sum(substep.coefficient for substep in substeps if isinstance(substep, Drift))


def bunches(branches: list[Branch], power: int, first: int = 0) -> Iterator[tuple[Branch, ...]]:
    """All multisets of branches whose powers add up to power."""
    if power == 0:
        yield ()
    for k in range(first, len(branches)):
        if branches[k].power <= power:
            for rest in bunches(branches, power - branches[k].power, k):
                yield (branches[k], *rest)


ROUNDING = 1e-12  # of tr M: a product of some forty matrices with entries of order one
# relative imaginary part that rounding may leave of a double root: about the square root of rounding
REAL = 1e-6
SCANNED = 101  # lengths of a step, scanned for the first that is too long
BISECTIONS = 50  # halvings of an interval, down to rounding


def propagation(substeps: Substeps, h: float) -> Array:
    """M(h) of one step, (2, 2), on (q, v/ω).
    h : ωΔt.  Substeps Thermalize are left out."""
    matrix = np.eye(2)
    for substep in mechanical(substeps):
        c = substep.coefficient * h
        flow = [[1.0, 0.0], [-c, 1.0]] if isinstance(substep, Kick) else [[1.0, c], [0.0, 1.0]]
        matrix = np.array(flow) @ matrix
    return matrix


def stability_limit(substeps: Substeps) -> float:
    """The stability limit of h = ωΔt: |tr M(h)| ≤ 2 for all h up to it; 2 for velocity Verlet, 0 if no step is stable.

    tr M is a polynomial in x = h², from M = (a hb; −hc d), where a, b, c and d are polynomials in x. It is evaluated
    once between each two neighboring roots of tr M = ±2, so that no window of instability is too narrow to be found. A
    root at which tr M only touches ±2 is no limit.

    With kicks of bonded terms alone, ω is a vibration of these: its phase must not change by π between two other kicks,
    with which it would resonate, nor by 2 between any two."""
    return _stability_limit(checked_substeps(substeps))


@cache
def _stability_limit(substeps: Substeps) -> float:
    row = merged(mechanical(substeps))
    outer = outer_substeps(row)
    if outer != row:
        return min(pi / longest_drift(outer), 2.0 / longest_drift(row))
    a = d = Polynomial([1.0])
    b = c = Polynomial([0.0])
    x = Polynomial([0.0, 1.0])
    for substep in mechanical(substeps):
        if isinstance(substep, Kick):
            c = c + substep.coefficient * a
            d = d - substep.coefficient * x * b
        else:
            a = a - substep.coefficient * x * c
            b = b + substep.coefficient * d
    trace = a + d
    roots = np.concatenate([(trace - 2.0).roots(), (trace + 2.0).roots()])
    is_edge = (abs(roots.imag) <= REAL * abs(roots)) & (roots.real > REAL)
    start = 0.0
    for end in np.unique(roots[is_edge].real):
        middle = propagation(substeps, np.sqrt(0.5 * (start + end)))
        if abs(np.trace(middle)) - 2.0 > ROUNDING:
            break
        start = end
    return float(np.sqrt(start))


def longest_drift(substeps: Substeps) -> float:
    """The largest coefficient of a drift, by magnitude."""
    return max(abs(part.coefficient) for part in substeps if isinstance(part, Drift))


def energy_oscillation(substeps: Substeps, h: float) -> float:
    """Relative amplitude of the energy of an oscillator: (E_max − E_min)/(E_max + E_min); infinite if unstable.

    A stable step M = (a b; c d) conserves the quadratic form −c q² + (a − d) q v + b v². States lie on an ellipse; on
    its axes the energy (q² + v²)/2 is largest and smallest. Velocity Verlet has h²/(8 − h²):
    1/80 at 20 steps per period.
    h : ωΔt."""
    h = checked_number("h", h)
    (a, b), (c, d) = propagation(checked_substeps(substeps), h)
    if abs(a + d) >= 2.0:
        return float("inf")
    form = np.array([[-c, 0.5 * (a - d)], [0.5 * (a - d), b]])
    smallest, largest = np.sort(abs(np.linalg.eigvalsh(form)))
    return float((largest - smallest) / (largest + smallest))


def accurate_step(substeps: Substeps, oscillation: float) -> float:
    """The largest ωΔt, at most half the stability limit, up to which energy_oscillation stays within a fraction."""
    checked_number("oscillation", oscillation, "finite and not negative")
    return _accurate_step(checked_substeps(substeps), oscillation)


@cache
def _accurate_step(substeps: Substeps, oscillation: float) -> float:
    steps = np.linspace(0.0, 0.5 * stability_limit(substeps), SCANNED)
    too_long = [energy_oscillation(substeps, h) > oscillation for h in steps[1:]]
    if not any(too_long):
        return float(steps[-1])
    n_short = np.argmax(too_long)
    low, high = steps[n_short : n_short + 2]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if energy_oscillation(substeps, middle) <= oscillation:
            low = middle
        else:
            high = middle
    return float(low)
