"""Errors of heat capacity and compressibility, of synthetic runs whose variance is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from minimd import observers
from minimd.observers.accumulator import ObservedRun
from minimd.observers.blocked_sums import BlockedSums


@pytest.mark.parametrize("times", [50, 100, 400])
def test_error_bars_of_fluctuations_hold_the_variance_also_of_short_runs(times):
    """Of a volume with correlations e^(−t/τ): within two errors in 88 % of the runs or more; a short run says that it is one."""
    tau, n_runs = 4, 100
    scene = ObservedRun("LJ", ["A"], [1], 1.0, 3, 1.0, 1.0)
    decay, rng, within, told = np.exp(-1.0 / tau), np.random.default_rng(times), 0, []
    noise = np.sqrt(1.0 - decay**2) * rng.normal(size=((times + 10) * tau, n_runs))
    for volume in lfilter([1.0], [1.0, -decay], noise, axis=0)[10 * tau :].T:
        looking = observers.Fluctuations()
        looking.scene, looking.reference, looking.sums = scene, [0.0, 0.0, 100.0], BlockedSums(13)
        for one in volume:
            looking.sums.total += np.concatenate([[1.0, 0.0, 0.0, one], np.outer([0, 0, one], [0, 0, one]).ravel()])
            looking.sums.close_entry()
        found = looking.result()
        within += abs(100.0 * found.compressibility - 1.0) < 2.0 * 100.0 * found.compressibility_error
        told.append("LOWER BOUND" in str(found))
    assert within >= 0.88 * n_runs
    assert np.mean(told) > 0.9 if times == 50 else np.mean(told) < 0.1 if times == 400 else True
