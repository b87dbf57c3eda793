"""Errors of heat capacity and compressibility, of synthetic runs whose variance is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from minimd import observers
from minimd.observers.accumulator import ObservedRun
from minimd.observers.blocked_sums import BlockedSums


@pytest.mark.parametrize("times", [50, 100, 400])
def test_error_bars_of_fluctuations_hold_the_variance_also_of_short_runs(times):
    """Within two errors in 88 % of the runs or more, 0.85 to 1.3 of the scatter; a short run says what it misses."""
    tau, n_runs = 4, 100
    scene = ObservedRun("LJ", ["A"], [1], 1.0, 3, 1.0, 1.0)
    decay, rng, found, told = np.exp(-1.0 / tau), np.random.default_rng(times), [], []
    noise = np.sqrt(1.0 - decay**2) * rng.normal(size=((times + 10) * tau, n_runs))
    for volume in lfilter([1.0], [1.0, -decay], noise, axis=0)[10 * tau :].T:
        looking = observers.Fluctuations()
        looking.scene, looking.reference, looking.sums = scene, [0.0, 0.0, 100.0], BlockedSums(13)
        for one in volume:
            looking.sums.total += np.concatenate([[1.0, 0.0, 0.0, one], np.outer([0, 0, one], [0, 0, one]).ravel()])
            looking.sums.close_entry()
        result = looking.result()
        found.append((100.0 * result.compressibility, 100.0 * result.compressibility_error))
        told.append("LOWER BOUND" in str(result))
    values, errors = np.array(found).T
    assert (np.abs(values - 1.0) < 2.0 * errors).mean() >= 0.88
    assert 0.85 < np.sqrt((errors**2).mean()) / values.std() < 1.3
    assert np.mean(told) > 0.9 if times == 50 else np.mean(told) < 0.1 if times == 400 else True
