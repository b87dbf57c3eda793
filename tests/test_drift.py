"""The standard error of a drift, judged by the scatter over many series, and over many runs."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

import minimd as md
from minimd.diagnosis.report import Drift, conservation_report, drift, drift_of_walk
from minimd.engine.record import Record

N_SERIES = 400


def correlated(correlation, n, rng):
    """A stationary series whose neighbors resemble each other by so much."""
    return lfilter([1.0], [1.0, -correlation], rng.normal(size=n + 400))[400:]


@pytest.mark.parametrize(
    ("correlation", "n", "most"),
    [(0.0, 51, 0.01), (0.5, 51, 0.02), (0.8, 51, 0.03), (0.8, 501, 0.02), (0.95, 501, 0.02)],
)
def test_few_correlated_series_seem_to_drift(correlation, n, most):
    """0.003 expected where the correlation is known; scipy's own line, blind to it, finds every third of 51 with 0.8 drifting."""
    rng, t = np.random.default_rng(3), np.arange(float(n))
    found = [drift(t, correlated(correlation, n, rng)) for _ in range(N_SERIES)]
    assert np.mean([one.is_significant for one in found]) <= most
    judged = np.array([one.slope / one.error for one in found if not one.is_too_short])
    assert 0.8 < np.sqrt(np.mean(judged**2)) < 1.6  # 1 expected


def test_a_series_as_short_as_its_fluctuations_is_not_judged():
    rng, t = np.random.default_rng(3), np.arange(51.0)
    found = [drift(t, correlated(0.98, 51, rng)) for _ in range(N_SERIES)]
    assert np.mean([one.is_too_short for one in found]) > 0.6
    assert (
        np.mean([one.is_significant for one in found]) < 0.08
    )  # no test can tell such a fluctuation from a drift always


def test_a_drift_that_is_there_is_found():
    rng, t = np.random.default_rng(3), np.arange(51.0)
    assert all(drift(t, correlated(0.5, 51, rng) + 0.3 * t).is_significant for _ in range(20))
    assert drift(t, np.exp(0.01 * t)).is_significant  # smooth, and no line
    assert drift(t, 2.0 * t).is_significant
    assert not drift(t, np.ones(51)).is_significant
    assert not Drift(0.0, 0.0).is_significant


@pytest.mark.parametrize("noise", [0.0, 1.0, 5.0])
def test_the_error_of_a_walk_that_fluctuates_is_its_scatter(noise):
    """The energy without that of a bath wanders, and the error of the energy fluctuates. Few runs seem to drift."""
    rng, t = np.random.default_rng(3), np.arange(50.0)
    found = [drift_of_walk(t, rng.normal(size=50).cumsum() + noise * rng.normal(size=50)) for _ in range(400)]
    slopes, errors = np.array([(one.slope, one.error) for one in found]).T
    assert 0.85 < np.sqrt((errors**2).mean()) / slopes.std() < 1.3
    assert np.mean([one.is_significant for one in found]) < 0.03  # 0.003 if the error were known exactly


def record_of(total, n_atoms=10):
    n = len(total)
    flat, vectors = np.ones(n), np.zeros((n, 3))
    series = {"potential_energy": total - 1.0, "kinetic_energy": flat, "total_energy": total, "temperature": 2.0 * flat}
    series |= dict.fromkeys(("momentum", "angular_momentum"), vectors) | dict.fromkeys(
        ("absolute_momentum", "absolute_angular_momentum"), flat
    )
    return Record.of(md.units.LJ, n_atoms, {"step": np.arange(n), "time": np.arange(float(n)), **series})


def test_the_report_says_that_a_run_is_too_short():
    for size, quiet in ((0.001, "stays within 0.002 of"), (0.1, "varies")):
        wave = 1.0 + size * np.sin(np.linspace(0.0, 5.0, 51))
        report = conservation_report(record_of(wave), angular=False)
        assert report.energy_is_conserved is None
        assert re.search(
            f"verdict        the total energy {quiet}.*; the run is too short to tell whether it drifts", str(report)
        )
        assert report.is_quiet is (size == 0.001)


def test_what_stands_behind_a_figure_is_told():
    """± is a standard error, and a standard deviation is called one; one frame has neither."""
    rng = np.random.default_rng(1)
    text = str(conservation_report(record_of(1.0 + 0.01 * rng.normal(size=51)), angular=False))
    assert "(standard error)" in text
    assert "temperature    2 ε/k_B on average, standard deviation 0 ε/k_B" in text
    one = str(conservation_report(record_of(np.ones(1)), angular=False))
    assert "drift unknown: one frame" in one
    assert "temperature    2 ε/k_B of one frame" in one
    assert "±" not in one
    assert "1 frame is too few to judge" in one


def test_slow_changes_that_the_energy_hides_are_seen_in_the_kinetic_energy():
    """Fast noise on top of a slow wave: by itself the series seems to drift."""
    rng, t = np.random.default_rng(3), np.arange(51.0)
    slow = np.sin(t / 30.0)
    alone, beside = [], []
    for _ in range(20):
        series = slow + 0.3 * rng.normal(size=51)
        alone.append(drift(t, series))
        beside.append(drift(t, series, beside=3.0 - slow))
    assert np.mean([one.is_significant for one in alone]) > 0.3
    assert not any(one.is_significant for one in beside)
    assert all(b.error >= a.error for a, b in zip(alone, beside, strict=True))
    assert sum(one.is_too_short for one in beside) >= sum(one.is_significant for one in alone)


@pytest.mark.slow
def test_the_error_is_the_scatter_of_many_runs():
    """Rigid water, thin, in consecutive runs of 1 ps: errors that know nothing of correlation called every second one drifting."""
    from ase.build import molecule

    water, boxes = molecule("H2O"), []
    for shift in np.ndindex(2, 2, 2):
        boxes.append(water.copy())
        boxes[-1].translate(4.0 * np.array(shift))
    atoms = boxes[0]
    for one in boxes[1:]:
        atoms += one
    atoms.set_cell([8.5] * 3)
    atoms.pbc = True
    rigid = md.DistanceConstraints([(3 * i + a, 3 * i + b) for i in range(8) for a, b in ((0, 1), (0, 2), (1, 2))])
    law = md.LennardJones({"O": (0.0067, 3.166), "H": (0.0, 1.0)}, cutoff=4.0, truncation="force-shifted")
    sim = md.Simulation(atoms, law, md.VelocityVerlet(2.0 * md.units.fs), rigid)
    sim.set_temperature(200.0, seed=1)
    found, reports = [], []
    for _ in range(100):
        sim.run(500, every=10)
        reports.append(sim.report())
        found.append(reports[-1].energy_drift)
    assert sum(one.energy_is_conserved is False for one in reports) <= 3  # of 100; 50 before
    assert 0.5 < np.sqrt(np.mean([(one.slope / one.error) ** 2 for one in found])) < 1.5  # 1 expected
