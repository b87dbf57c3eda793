"""Error bars are right: over many series of a process whose correlation is known, means scatter by them."""

import numpy as np
import pytest
from references import processes

from minimd.core.structure import statistics

LOW, HIGH = 0.85, 1.3  # of an error bar beside what it should be; found in a short run, it itself scatters
SLOW = [(0.0, 1), (0.5, 12), (0.5, 25), (0.5, 100), (0.8, 25), (0.95, 12), (0.95, 25), (0.95, 100)]


@pytest.mark.parametrize("decay", [0.0, 0.8, 0.95])
def test_the_error_of_a_mean_is_what_means_scatter_by(decay):
    """Variance (1 + a)/(1 − a)/T of a process with correlation aⁿ."""
    length, rng, exact = 4000, np.random.default_rng(1), (1.0 + decay) / (1.0 - decay)
    means, errors = np.transpose([statistics.mean_and_error(one) for one in processes(60, length, decay, rng).T])
    assert means.std() == pytest.approx(np.sqrt(exact / length), rel=0.4)  # statistics of 60 means
    assert LOW < np.sqrt((errors**2).mean() / (exact / length)) < HIGH
    found = np.mean([statistics.statistical_inefficiency(one) for one in processes(20, length, decay, rng).T])
    assert found == pytest.approx(exact, rel=0.35)


def test_few_entries_and_constant_series():
    assert np.isnan([statistics.mean_and_error([1.0, 2.0])[1], statistics.mean_and_error([])[0]]).all()
    assert (*statistics.mean_and_error([2.0] * 10), statistics.statistical_inefficiency([2.0] * 10)) == (2.0, 0.0, 1.0)
    assert (statistics.with_error(1.23456, 0.0123), statistics.with_error(2.0, 0.0)) == ("1.235 ± 0.012", "2")
    assert statistics.with_error(5.84441e-6, 1.51e-9) == "5.8444e-06 ± 1.5e-09"
    assert statistics.with_error(1e-9, 0.0123) == "0.000 ± 0.012"


@pytest.mark.parametrize("n_blocks", [16, 31])
@pytest.mark.parametrize(("share", "times"), SLOW)
def test_an_error_bar_knows_slow_correlations(n_blocks, share, times):
    """Of a ratio of sums, one of which has fast and slow parts, as D follows the temperature of a bath.
    times : slow correlation times in a run.  share : of the slow part in the variance of the mean.  Uncorrelated blocks
    would give 0.4 to 0.8 of the error where it is 0.5 or more."""
    n_runs, n, rng = 600, 8 * n_blocks, np.random.default_rng(7)
    decay = np.exp(-times / n)
    slow = np.sqrt(share * (1.0 - decay) / (1.0 + decay)) * processes(n_runs, n, decay, rng)
    series = slow + np.sqrt(1.0 - share) * rng.normal(size=(n, n_runs))
    counted = 1.0 + 0.3 * rng.random((n, n_runs))
    parts = np.array([counted, counted * (20.0 + series)]).reshape(2, n_blocks, 8, n_runs).sum(axis=2)
    law, total = lambda sums: np.log(sums[1] / sums[0]), parts.sum(axis=1)
    values, errors = law(total), statistics.spread(statistics.replicas(law, total, parts.transpose(1, 0, 2)))
    assert LOW < np.sqrt((errors**2).mean()) / values.std() < HIGH
    inside = np.abs(values - values.mean()) < 2.0 * errors
    assert inside.mean() > 0.82  # 0.95 of long runs; a short run does not know its own error well


def test_replicas_of_a_mean_spread_by_its_error():
    """Of a linear law the jackknife is the error of the mean of the blocks; σ/√K if uncorrelated, in any unit."""
    parts, error = np.random.default_rng(3).normal(size=(20, 400)), statistics.standard_error
    found = statistics.spread(statistics.replicas(lambda sums: sums / 19.0, parts.sum(axis=0), parts))
    np.testing.assert_allclose(found, error(parts), rtol=1e-12)
    assert LOW < np.sqrt((found**2).mean()) * np.sqrt(20) < HIGH
    np.testing.assert_allclose(error(1e-200 * parts), 1e-200 * found, rtol=1e-12)
    assert np.isnan(statistics.spread(np.zeros((3, 2)))).all()
    assert (error(np.full((20, 2), 3.3)) == 0.0).all()
