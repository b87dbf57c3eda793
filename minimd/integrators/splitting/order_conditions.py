"""The order of a sequence of kicks and drifts, found by evaluating its order conditions.

A sequence has order p if its step and the exact flow agree through Δtᵖ. There are two orders:

    separable order   for every H = T(p) + V(q); for every q′ = g(v), v′ = f(q)
    Nyström order     for T = p²/2m, that is q″ = f(q): fewer conditions, never a lower order

E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), III.3 and IV.2; R. I. McLachlan, G. R. W.
Quispel, Acta Numerica 11, 341 (2002), section 4.
"""

from collections.abc import Callable, Iterator
from functools import cache
from itertools import product
from math import factorial, prod
from typing import NamedTuple

import numpy as np

from minimd.integrators.method import Array
from minimd.integrators.splitting.substeps import Drift, Kick, Substep, Substeps

__all__ = ["nystrom_order", "separable_order"]

HIGHEST_ORDER = 10  # conditions are evaluated up to this order
TOLERANCE = 1e-12  # coefficients of 14 digits pass; a condition that fails leaves 1e-6 and more

Word = tuple[type[Substep], ...]


@cache
def separable_order(substeps: Substeps) -> int:
    """Order for every H = T(p) + V(q), at most HIGHEST_ORDER; 0 if the sequence is not consistent."""
    return _first_failure(substeps, separable_residuals)


@cache
def nystrom_order(substeps: Substeps) -> int:
    """Order for H = p²/2m + V(q), at most HIGHEST_ORDER; 0 if the sequence is not consistent."""
    return _first_failure(substeps, nystrom_residuals)


def _first_failure(substeps: Substeps, residuals: Callable[[Substeps, int], list[float]]) -> int:
    for order in range(1, HIGHEST_ORDER + 1):
        if max(map(abs, residuals(substeps, order))) > TOLERANCE:
            return order - 1
    return HIGHEST_ORDER


def separable_residuals(substeps: Substeps, order: int) -> list[float]:
    """Residuals of the conditions of exactly this order: coefficient of each Lyndon word − 1/order!.

    The step is exp(c₁X₁) exp(c₂X₂) …, where each X is T or V. The exact flow is exp(T + V), in which every word of n
    letters T, V has the coefficient 1/n!. Both series are group-like, and such series agree if they agree on the Lyndon
    words, the words that come before all their rotations. For n = 1, …, 8 there are 2, 1, 2, 3, 6, 9, 18, 30 of them,
    as many as there are independent conditions (C. Reutenauer, Free Lie Algebras (1993), chapter 6).
    """
    return [word_coefficient(substeps, word) - 1.0 / factorial(order) for word in lyndon_words(order)]


@cache
def lyndon_words(length: int) -> tuple[Word, ...]:
    """Words in Drift < Kick that come strictly before each of their rotations."""
    words = product((0, 1), repeat=length)
    lyndon = (word for word in words if all(word < word[k:] + word[:k] for k in range(1, length)))
    return tuple(tuple((Drift, Kick)[letter] for letter in word) for word in lyndon)


def word_coefficient(substeps: Substeps, word: Word) -> float:
    """Coefficient of a word in exp(c₁X₁) exp(c₂X₂) …; the factor exp(cX) appends k letters X with the weight cᵏ/k!."""
    prefix = [1.0] + [0.0] * len(word)  # coefficient of the first j letters of the word in the product so far
    for substep in substeps:
        for j in range(len(word), 0, -1):
            weight, k = 1.0, 1
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
    follow from them if Σ drifts = 1. The trees: E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), II.14.
    """
    b, c, a = nystrom_tableau(substeps)
    one, branches = np.ones_like(c), [Branch(1, c, 1.0)]
    for power in range(1, order + 1):
        found = bunches(branches, power - 1)
        trees = [(np.prod([one, *(t.values for t in tree)], axis=0), prod(t.kappa for t in tree)) for tree in found]
        branches += [Branch(power + 1, a @ values, kappa / (power * (power + 1))) for values, kappa in trees]
    residuals = [float(b @ values - kappa / order) for values, kappa in trees]
    return residuals if order > 1 else [*residuals, drifts_sum(substeps) - 1.0]


def nystrom_tableau(substeps: Substeps) -> tuple[Array, Array, Array]:
    """Weights b (s,), abscissae c (s,) and matrix a (s, s) of a sequence with s kicks."""
    kicks = [k for k, substep in enumerate(substeps) if isinstance(substep, Kick)]
    b = np.array([substeps[k].coefficient for k in kicks])
    c = np.array([drifts_sum(substeps[:k]) for k in kicks])
    return b, c, np.tril(b * (c[:, None] - c), -1)


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
