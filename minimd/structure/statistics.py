"""Means of correlated series, and their uncertainty. Every error bar of minimd is computed here."""

from __future__ import annotations

from collections.abc import Callable
from math import floor, isfinite, log10
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEW = 4  # entries or blocks: from fewer, no error can be estimated
CHANCE = 0.01  # of taking uncorrelated blocks for correlated ones
LEVEL, LINE = (1.0, 3.0), (2.0, 4.0)  # bias of a correlation where a mean, or a straight line, was fitted


def mean_and_error(series: Any) -> tuple[float, float]:
    """Mean of a correlated series, and the standard error of the mean, from blocks whose length follows from the series itself.

        σ_k², γ_k : variance of the n_k averages over 2ᵏ entries, and covariance of neighbors among them
        M_k = Σ n_j [((n_j − 1) σ_j² / n_j² + γ_j) / σ_j²]²,   j ≥ k
        error² = σ_k² / (n − 1),   with the first k for which uncorrelated averages explain M_k: it is below χ² of 99 %

    n of these n_k averages are independent, see independent: some correlation is left that the test does not see. NaN for fewer than 4 entries.
    H. Flyvbjerg, H. G. Petersen, J. Chem. Phys. 91, 461 (1989), on blocks; M. Jonsson, Phys. Rev. E 98, 043304 (2018), on their length.
    """
    values = np.asarray(series, dtype=np.float64)
    if len(values) < FEW:
        return float(values.mean()) if len(values) else np.nan, np.nan
    levels = [values - values.mean()]  # without the mean, whose rounding would hide small fluctuations
    while len(levels[-1]) > FEW:
        levels.append(0.5 * (levels[-1][0 : 2 * (len(levels[-1]) // 2) : 2] + levels[-1][1::2]))
    rests = [blocks - blocks.mean() for blocks in levels]
    counts, variances, covariances = np.array([(len(one), one @ one / len(one), one[1:] @ one[:-1] / len(one)) for one in rests]).T
    with np.errstate(all="ignore"):
        terms = counts * (((counts - 1.0) * variances / counts**2 + covariances) / variances) ** 2
    remaining = np.cumsum(np.nan_to_num(terms)[::-1])[::-1]
    from scipy.special import chdtri  # takes its time to load

    is_explained = remaining < chdtri(np.arange(len(levels), 0, -1), CHANCE)
    k = int(np.argmax(is_explained)) if is_explained.any() else len(levels) - 1
    n = max(independent(rests[k], LEVEL), 2.0)
    return float(values.mean()), float(np.sqrt(variances[k] / (n - 1.0)))


def independent(rest: Array, bias: tuple[float, float]) -> float:
    """How many of n correlated numbers are independent: n (1 − ρ)/(1 + ρ), with the correlation ρ of neighbors.

    rest : (n,), minus what was fitted to them.  bias : (a, b), LEVEL or LINE: fitting makes ρ too small by (a + b ρ)/n; this is corrected.
    M. G. Kendall, Biometrika 41, 403 (1954), on the bias.
    """
    square, n = float(rest @ rest), len(rest)
    alike = float(rest[1:] @ rest[:-1]) / square if square > 0.0 else 0.0
    alike = min(max(0.0, alike + (bias[0] + bias[1] * alike) / n), 1.0 - 1.0 / n)
    return n * (1.0 - alike) / (1.0 + alike)


def statistical_inefficiency(series: Any) -> float:
    """How many entries of a correlated series count as one independent entry: g = T error² / σ²; NaN if the error is, 1 for a constant series."""
    values = np.asarray(series, dtype=np.float64)
    error, variance = mean_and_error(values)[1], float(values.var(ddof=1)) if len(values) > 1 else 0.0
    return len(values) * error**2 / variance if variance > 0.0 else 1.0


def block_means(series: Array, blocks: int) -> Array:
    """Averages over the given number of blocks of a series, as equal as its length allows."""
    return np.array([part.mean() for part in np.array_split(series, blocks)])


def replicas(estimate: Callable[[Array], Any], total: Array, parts: Array) -> Array:
    """Estimates from the sums over a run without one of its blocks, (K, ...), for each of K blocks; see spread.

    estimate : function of sums (n,), linear or not; returns a number or an array.  total : (n,).  parts : (K, n), of blocks of equal length.
    This is the jackknife: B. Efron, C. Stein, Ann. Statist. 9, 586 (1981).
    """
    return np.array([estimate(total - part) for part in parts], dtype=np.float64)


def spread(without: Array) -> Array:
    """The standard error that follows from replicas (K, ...); NaN for fewer than 4.

    error² = (K − 1)/K Σ (f_k − mean)²
    """
    n = len(without)
    if n < FEW:
        return np.full(without.shape[1:], np.nan)
    found: Array = np.sqrt((n - 1.0) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return found


def with_error(mean: float, error: float) -> str:
    """A mean with two digits of its error, as 1.234 ± 0.056."""
    if not (isfinite(error) and error > 0.0 and isfinite(mean)):
        return f"{mean:.6g}"
    digits = max(0, 1 - floor(log10(error)))
    return f"{mean:.{digits}f} ± {error:.{digits}f}" if digits < 12 else f"{mean:.12g} ± {error:.1e}"
