"""Error bars are right: over many series of a process whose correlation is known, they are what the means scatter by."""

import numpy as np
import pytest

from minimd.structure.statistics import mean_and_error, replicas, spread, statistical_inefficiency, with_error


def processes(n_series, length, decay, seed=1):
    rng = np.random.default_rng(seed)
    x = np.empty((length, n_series))
    x[0] = rng.normal(size=n_series)
    for k in range(1, length):
        x[k] = decay * x[k - 1] + np.sqrt(1.0 - decay**2) * rng.normal(size=n_series)
    return x.T


@pytest.mark.parametrize("decay", [0.0, 0.8, 0.95])
def test_the_error_of_a_mean_is_what_means_scatter_by(decay):
    """Variance (1 + a)/(1 − a)/T of a process with correlation aⁿ."""
    length = 4000
    exact = np.sqrt((1.0 + decay) / (1.0 - decay) / length)
    found = np.array([mean_and_error(series) for series in processes(60, length, decay)])
    assert found[:, 0].std() == pytest.approx(exact, rel=0.4)  # statistics of 60 means
    assert np.sqrt((found[:, 1] ** 2).mean()) == pytest.approx(exact, rel=0.15)
    inefficiency = np.mean([statistical_inefficiency(series) for series in processes(20, length, decay, seed=2)])
    assert inefficiency == pytest.approx((1.0 + decay) / (1.0 - decay), rel=0.35)


def test_few_entries_and_constant_series():
    assert np.isnan(mean_and_error([1.0, 2.0])[1])
    assert mean_and_error([2.0] * 10) == (2.0, 0.0)
    assert statistical_inefficiency([2.0] * 10) == 1.0
    assert np.isnan(mean_and_error([])[0])


def test_replicas_of_a_mean_spread_by_its_error():
    """Of a linear law the jackknife is σ/√K of the blocks."""
    parts = np.random.default_rng(3).normal(size=(20, 4))
    found = spread(replicas(lambda sums: sums / 20.0, parts.sum(axis=0), parts))
    assert found.shape == (4,)
    exact = spread(replicas(lambda sums: sums / 19.0, parts.sum(axis=0), parts))
    np.testing.assert_allclose(exact, parts.std(axis=0, ddof=1) / np.sqrt(20), rtol=1e-12)
    assert np.isnan(spread(np.zeros((3, 2)))).all()


def test_an_error_has_two_digits():
    assert with_error(1.23456, 0.0123) == "1.235 ± 0.012"
    assert with_error(2.0, 0.0) == "2"
