"""Means of correlated series, and their uncertainty. Every error bar of minimd is computed here."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import floor, isfinite, log10
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEW = 4  # entries or blocks: from fewer, no error can be estimated
MOST_BLOCKS = 32  # at this number, blocks are joined in pairs: a long run always has 16 to 31
TIMES = (0.01, 0.022, 0.05, 0.11, 0.25)  # correlation times, of the length of a run
SHARES = (0.5, 0.8, 0.95, 1.0)  # of slow correlations in the variance of the mean
LEVEL, LINE = (1.0, 3.0), (2.0, 4.0)  # bias of a correlation where a mean, or a straight line, was fitted


def mean_and_error(series: Any) -> tuple[float, float]:
    """Mean of a correlated series, and the standard error of the mean from its averages over 16 to 31 blocks; NaN for fewer than 4 entries."""
    values = np.asarray(series, dtype=np.float64)
    if len(values) < FEW:
        return float(values.mean()) if len(values) else np.nan, np.nan
    mean, length = float(values.mean()), len(values) // MOST_BLOCKS + 1
    blocks = (values - mean)[: len(values) // length * length].reshape(-1, length).mean(axis=1)  # without the mean, whose rounding would hide them
    return mean, float(standard_error(blocks))


def standard_error(parts: Array) -> Array:
    """The standard error of the mean of K numbers (K, ...), each from the same length of a run, and correlated with those before it; (...).

        covariance   C_ab ∝ w Λ_ab(τ) + (1 − w) δ_ab:   averages over parts of e^(−t/τ), with a share w of the integral, and of what is fast
        likelihood   L = |C|^(−1/2) (1ᵀC⁻¹1)^(−1/2) q^((1 − K)/2),   q = xᵀ(C⁻¹ − C⁻¹1 1ᵀC⁻¹/1ᵀC⁻¹1) x / (K − 1)
        error        Σ L √(q 1ᵀC1)/K / Σ L

    The sums are over processes that a run can just tell from each other, see _processes: τ from a hundredth to a quarter of the run, and none,
    w = 0, with half of the weight. Means and scale of C are integrated out. If correlations last longer than a sixth of the run, the error
    is too small. 0 for equal numbers, NaN for fewer than 4.

    H. D. Patterson, R. Thompson, Biometrika 58, 545 (1971), on the likelihood; J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky,
    Statist. Sci. 14, 382 (1999), on sums over models.
    """
    n = len(parts)
    if n < FEW:
        return np.full(parts.shape[1:], np.nan)
    numbers = (parts - parts.mean(axis=0)).reshape(n, -1)
    found = [(log_weight, variance, ((form @ numbers) * numbers).sum(axis=0) / (n - 1.0)) for log_weight, variance, form in _processes(n)]
    log_weights, variances, squares = (np.array(one) for one in zip(*found, strict=True))
    scale = squares[0]
    with np.errstate(all="ignore"):
        squares = np.where(scale == 0.0, 1.0, squares / scale)
        log_likelihoods = log_weights[:, None] - 0.5 * (n - 1.0) * np.log(squares)
    weights = np.exp(log_likelihoods - log_likelihoods.max(axis=0))
    mean: Array = (weights * np.sqrt(variances[:, None] * squares)).sum(axis=0) / weights.sum(axis=0) * np.sqrt(scale)
    return mean.reshape(parts.shape[1:])


@cache
def _processes(n: int) -> list[tuple[float, float, Array]]:
    """Of each process: the logarithm of its weight times |C|^(−1/2) (1ᵀC⁻¹1)^(−1/2), the variance of the mean, and the form of q, (n, n)."""
    lags, found = np.abs(np.subtract.outer(np.arange(n), np.arange(n))), []
    for time in n * np.array(TIMES):
        ratio = np.exp(-1.0 / time)
        slow = 0.5 * time * (1.0 - ratio) ** 2 * ratio ** (lags - 1.0)
        np.fill_diagonal(slow, 1.0 - time * (1.0 - ratio))
        found += [(0.0, share * slow + (1.0 - share) * np.eye(n)) for share in SHARES]
    return [_process(*one) for one in [(np.log(len(found)), np.eye(n)), *found]]


def _process(log_weight: float, covariance: Array) -> tuple[float, float, Array]:
    inverse = np.linalg.inv(covariance)
    sums = inverse.sum(axis=0)
    log_size = np.linalg.slogdet(covariance)[1] + np.log(sums.sum())
    return log_weight - 0.5 * log_size, covariance.sum() / len(sums) ** 2, inverse - np.outer(sums, sums) / sums.sum()


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
    """The standard error that follows from replicas f_k in the order of time, (K, ...): that of the mean of (K − 1) f_k."""
    return standard_error((len(without) - 1.0) * without)


def with_error(mean: float, error: float) -> str:
    """A mean with two digits of its error, as 1.234 ± 0.056."""
    if not (isfinite(error) and error > 0.0 and isfinite(mean)):
        return f"{mean:.6g}"
    digits = max(0, 1 - floor(log10(error)))
    return f"{mean:.{digits}f} ± {error:.{digits}f}" if digits < 12 else f"{mean:.12g} ± {error:.1e}"
