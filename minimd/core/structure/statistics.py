"""Means of correlated series, and their uncertainty. Every error bar of minimd is computed here."""

from collections.abc import Callable
from functools import cache
from math import floor, isfinite, log10
from typing import Any

import numpy as np

from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_numbers

Weighted = Callable[[int], list[tuple[float, Array]]]
# correlation times; a run with fewer cannot tell how many it has, and its error bars are too small
FEWEST = 30.0
FEW = 4  # entries or blocks: from fewer, no error can be estimated
LEAST_POWER = -4  # of ten: smaller means are written with a power of ten
WINDOWS = 6.0, 18.0  # of correlations, in correlation times
MOST_BLOCKS = 32  # at this number, blocks are joined in pairs: a long run always has 16 to 31
# of slow correlations, in parts of the run and of the variance of the mean
TIMES = (0.02, 0.05, 0.12, 0.3)
SHARES = (0.7, 0.9, 0.97, 1.0)
NONE = 0.8  # weight of no correlation; the weights of the 16 correlations add up to the rest
# parts of a random walk in the variance of the mean of its steps, and their weights
WALKS = {0.0: 1.0, 0.3: 1.0, 0.6: 1.0, 0.9: 1.0, 1.0: 3.0}


def mean_and_error(series: Any) -> tuple[float, float]:
    """Mean of a correlated series, and the standard error of the mean from its averages over 16 to 31 blocks.

    Parameters
    ----------
    series : (T,) array, as record.pressure: equally spaced in time, after the equilibration.

    Returns
    -------
    mean, error : in the unit of the series; the error is NaN for fewer than 4 entries, the mean for none.

    Raises ValueError for anything but a list of numbers.
    """
    values = checked_numbers("series", series, "numbers")

    if values.ndim != 1:
        raise ValueError(f"series must be one number for each time; its shape is {values.shape}")
    n = len(values)
    mean = float(values.mean()) if n else np.nan
    if n < FEW:
        return mean, np.nan
    length = n // MOST_BLOCKS + 1
    fluctuations = values - mean  # blocks of the values would be rounded more
    blocks = fluctuations[: n // length * length].reshape(-1, length).mean(axis=1)
    return mean, float(standard_error(blocks))


def standard_error(parts: Array, weighted: Weighted | None = None) -> Array:
    """The standard error of the mean of K numbers (K, ...), each from the same length of a run, that may be correlated;
    (...).

        C_ab ∝ w Λ_ab(τ) + (1 − w) δ_ab             Λ: of averages of a process with correlations e^(−t/τ), Σ_b Λ_ab → 1
        q = xᵀ(C⁻¹ − C⁻¹1 1ᵀC⁻¹/1ᵀC⁻¹1) x / (K − 1)   xᵀx/(K − 1) of deviations x from the mean, if uncorrelated
        L = (|C| 1ᵀC⁻¹1 q^(K−1))^(−1/2)                                         likelihood of C, whatever mean and scale
        error = Σ p L √(q 1ᵀC1)/K / Σ p L                                       p: weight of C

    The sums are over covariances C that few numbers can just tell from each other: w = 0, and those of TIMES and
    SHARES. Correlations that last longer than a sixth of a run are seen in part only: the error is too small then.
    0 for equal numbers, NaN for fewer than 4.
    weighted : other covariances and their weights, see correlated and wandering.

    H. D. Patterson, R. Thompson, Biometrika 58, 545 (1971), on L; J. A. Hoeting, D. Madigan, A. E. Raftery, C. T.
    Volinsky, Statist. Sci. 14, 382 (1999), on averages over models."""
    n = len(parts)
    if n < FEW:
        return np.full(parts.shape[1:], np.nan)
    columns = zip(*_forms(weighted or correlated, n), strict=True)
    logs, variances, forms = map(np.array, columns)

    with np.errstate(all="ignore"):
        # equal numbers give 0, whatever the rounding of their mean
        rest = (parts - parts[0]).reshape(n, -1)
        rest -= rest.mean(axis=0)
        size = np.abs(rest).max(axis=0)
        x = rest / size
        q = np.array([((form @ x) * x).sum(axis=0) for form in forms]) / (n - 1.0)
        log_weights = logs[:, None] - 0.5 * (n - 1.0) * np.log(q)
        weights = np.exp(log_weights - log_weights.max(axis=0))
        errors = np.sqrt(variances[:, None] * q)
        error = size * (weights * errors).sum(axis=0) / weights.sum(axis=0)

    return np.where(size == 0.0, 0.0, error).reshape(parts.shape[1:])


def correlated(n: int) -> list[tuple[float, Array]]:
    """Weights p and covariances C, (n, n), of averages that nothing, or a correlation e^(−t/τ), ties to each other;
    see standard_error."""
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    each = (1.0 - NONE) / (len(TIMES) * len(SHARES))
    white = np.eye(n)
    covariances = [(NONE, white)]
    for time in n * np.array(TIMES):
        ratio = np.exp(-1.0 / time)
        slow = 0.5 * time * (1.0 - ratio) ** 2 * ratio ** (lags - 1.0)
        np.fill_diagonal(slow, 1.0 - time * (1.0 - ratio))
        covariances += [(each, share * slow + (1.0 - share) * white) for share in SHARES]
    return covariances


def wandering(n: int) -> list[tuple[float, Array]]:
    """Weights and covariances, (n, n), of steps between averages of a random walk with noise; see WALKS."""
    beside = np.eye(n, k=1) + np.eye(n, k=-1)
    walk = np.eye(n) + 0.25 * beside
    noise = 2.0 * np.eye(n) - beside
    covariances = []
    for part, weight in WALKS.items():
        covariance = part * walk / walk.sum() + (1.0 - part) * noise / noise.sum()
        covariances.append((weight, covariance))
    return covariances


@cache
def _forms(weighted: Weighted, n: int) -> list[tuple[float, float, Array]]:
    """For each C: log p (|C| 1ᵀC⁻¹1)^(−1/2), 1ᵀC1/n², and the matrix of (n − 1) q, (n, n); see standard_error."""
    forms = []
    for weight, covariance in weighted(n):
        inverse = np.linalg.inv(covariance)
        sums = inverse.sum(axis=0)
        total = sums.sum()
        log = np.log(weight) - 0.5 * (np.linalg.slogdet(covariance)[1] + np.log(total))
        form = inverse - np.outer(sums, sums) / total
        forms.append((float(log), float(covariance.sum()) / n**2, form))
    return forms


def independent(rest: Array) -> float:
    """How many of n correlated numbers are independent: n (1 − ρ)/(1 + ρ), with the correlation ρ of neighbors.
    rest : (n,), their distances from a straight line, whose fit makes ρ too small by (2 + 4ρ)/n; this is corrected.
    M. G. Kendall, Biometrika 41, 403 (1954), on the bias."""
    square = float(rest @ rest)
    n = len(rest)
    correlation = float(rest[1:] @ rest[:-1]) / square if square > 0.0 else 0.0
    correlation += (2.0 + 4.0 * correlation) / n
    correlation = min(max(0.0, correlation), 1.0 - 1.0 / n)
    return n * (1.0 - correlation) / (1.0 + correlation)


def statistical_inefficiency(series: Any) -> float:
    """How many entries of a correlated series count as one independent entry: g = T error² / σ²; NaN if the error is,
    1 for a constant series."""
    values = np.asarray(series, float)
    error = mean_and_error(values)[1]
    variance = float(values.var(ddof=1)) if len(values) > 1 else 0.0
    return len(values) * error**2 / variance if variance > 0.0 else 1.0


def windowed_error(series: Any) -> tuple[float, float, float]:
    """The standard error of the mean of a series, how many independent entries it has, n/g, and v; from its
    correlations ρ:

        error² = g s²/n (1 + 2 v),   g = 1 + 2 Σ ρ_t, t ≤ M,   M = g w/2,   v = 2 (2M + 1)/n

    v is the relative variance of this error². Of two windows w, the one with the larger g counts: a long one also holds
    a slow part of the correlations, which may be small. The error fluctuates less than that of mean_and_error, but
    knows only the correlations that its window contains. 0 for equal numbers. U. Wolff, Comput. Phys. Commun. 156, 143
    (2004)."""
    from scipy.fft import irfft, next_fast_len, rfft

    values = np.asarray(series, float)
    n = len(values)
    rest = values - values.mean()
    size = next_fast_len(2 * n)
    products = irfft(np.abs(rfft(rest, size)) ** 2, size)[:n]
    if not products[0] > 0.0:
        return 0.0, float(n), 0.0
    growing = 2.0 * np.cumsum(products / products[0]) - 1.0
    unbiased = growing * (1.0 + (2.0 * np.arange(n) + 1.0) / n)
    is_closed = [np.arange(n) >= 0.5 * window * growing for window in WINDOWS]
    ends = [int(np.argmax(closed)) if closed.any() else n - 1 for closed in is_closed]
    last = max(ends, key=unbiased.__getitem__)
    g = max(unbiased[last], 1.0 / n)
    v = 2.0 * (2 * last + 1) / n
    return float(np.sqrt(g * products[0] / n**2 * (1.0 + 2.0 * v))), n / g, v


def correlation_times(variance: Array | float, error: Array | float) -> Array:
    """The length of a run in correlation times of a series: n_c = 2 s²/error², with the variance s² of the series and
    the standard error of its mean; NaN where the error is zero or unknown."""
    with np.errstate(all="ignore"):
        return np.where(np.greater(error, 0.0), 2.0 * np.divide(variance, np.square(error)), np.nan)


def short_run(times: float, of: str, enough: float = FEWEST) -> str:
    """What error bars are in a run of fewer than enough correlation times; empty in a longer one, or for NaN.
    of : the quantity that is correlated."""
    if not times < enough:
        return ""
    return f"the run is only {max(1.0, times):.0f} correlation times of the {of} long: THE ERROR BARS ARE LOWER BOUNDS"


def block_means(series: Array, blocks: int) -> Array:
    """Averages over the given number of blocks of a series, as equal as its length allows."""
    return np.array([part.mean() for part in np.array_split(series, blocks)])


def replicas(estimate: Callable[[Array], Any], total: Array, parts: Array) -> Array:
    """Estimates from the sums over a run without one of its blocks, (K, ...), for each of K blocks; see spread.
    estimate : function of sums (n,), linear or not; returns a number or an array.
    total : (n,).
    parts : (K, n), of blocks of equal length.
    This is the jackknife: B. Efron, C. Stein, Ann. Statist. 9, 586 (1981)."""
    # (0, ...) without blocks
    return np.array([estimate(total - part) for part in (0.0, *parts)], float)[1:]


def spread(without: Array) -> Array:
    """The standard error that follows from replicas f_k in the order of time, (K, ...): that of the mean of (K − 1)
    f_k."""
    return standard_error((len(without) - 1.0) * without)


def with_error(mean: float, error: float) -> str:
    """A mean with two digits of its error, as 1.234 ± 0.056, or 1.2340e-05 ± 5.6e-08."""
    if not (isfinite(error) and error > 0.0 and isfinite(mean)):
        return f"{mean:.6g}"
    digits = max(0, 1 - floor(log10(error)))
    power = floor(log10(max(abs(mean), error)))
    if power < LEAST_POWER:
        return f"{mean:.{min(12, digits + power)}e} ± {error:.1e}"
    if digits < 12:
        return f"{mean:.{digits}f} ± {error:.{digits}f}"
    return f"{mean:.12g} ± {error:.1e}"
