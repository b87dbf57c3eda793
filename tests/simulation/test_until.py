"""Runs that end by themselves: error bars at the end, predicted lengths, equilibrations, and what cannot be reached."""

import numpy as np
import pytest
from scenes import SCENES
from scipy.signal import lfilter
from wrong_calls import answered

import minimd as md
from minimd.core.engine.record import Record
from minimd.core.simulation.goal import Goal
from minimd.core.structure.statistics import windowed_error

T = 1.3


def correlated(n, time, rng):
    """A series with mean 1, variance 1 and correlations e^(−t/time)."""
    kept = np.exp(-1.0 / time)
    noise = rng.standard_normal(n) * (1.0 - kept**2) ** 0.5
    noise[0] /= (1.0 - kept**2) ** 0.5
    return 1.0 + lfilter([1.0], [1.0, -kept], noise)


def record_of(series):
    steps = np.arange(len(series))
    return Record.of(md.units.LJ, 1, {"step": steps, "time": 1.0 * steps, "pressure": series})


def judged(series, until):
    """The looks after which a run with this series ends, its goal, and the length that was predicted after a tenth."""
    goal = Goal(until, [], np.inf)
    n, predictions = 100, []
    while n < len(series):
        expected = goal.judge(record_of(series[:n]), 0, len(series))
        predictions.append((n, expected))
        if goal.is_reached:
            early = [expected for k, expected in predictions if k <= n / 10 and expected]
            return n, goal, early[-1] if early else None
        n = goal._due
    raise AssertionError("the series is too short")


def liquid(method=None, **options):
    sim = SCENES["argon"]().simulation(method or md.LangevinBAOAB(0.005, T, 1.0, seed=4), threads=1, **options)
    sim.set_temperature(T, seed=1)
    return sim


def test_the_error_of_a_window_is_that_of_the_correlations():
    rng = np.random.default_rng(1)
    time = 5.0
    g = (1.0 + np.exp(-1.0 / time)) / (1.0 - np.exp(-1.0 / time))
    error, independent, v = windowed_error(correlated(200_000, time, rng))
    assert error == pytest.approx((g / 200_000) ** 0.5, rel=0.05)
    assert independent == pytest.approx(200_000 / g, rel=0.1)
    assert 0.0 < v < 0.01
    squares = [windowed_error(correlated(4000, time, rng)) for _ in range(200)]
    spread = np.std([error**2 / (1.0 + 2.0 * v) for error, _, v in squares]) / (g / 4000)
    assert spread == pytest.approx(np.mean([v for *_, v in squares]) ** 0.5, rel=0.3)
    assert windowed_error(np.full(50, 3.0)) == (0.0, 50.0, 0.0)


def test_a_long_window_holds_a_slow_part_of_the_correlations():
    """A fifth of the variance has ten times the correlation time of the rest: a window of six times the mean alone
    holds 0.85 of the error²; the larger of two is 1.09 of it."""
    rng = np.random.default_rng(2)
    shares = {2.0: 0.8, 20.0: 0.2}
    g = sum(share * (1.0 + np.exp(-1.0 / time)) / (1.0 - np.exp(-1.0 / time)) for time, share in shares.items())
    squares = []
    for _ in range(300):
        series = sum(np.sqrt(share) * correlated(2000, time, rng) for time, share in shares.items())
        error, _, v = windowed_error(series)
        squares.append(error**2 / (1.0 + 2.0 * v))
    assert 0.98 < np.mean(squares) / (g / 2000) < 1.15


@pytest.mark.parametrize(("time", "wanted"), [(2.0, 0.1), pytest.param(1.0, 0.015, marks=pytest.mark.slow)])
def test_bars_at_the_end_of_a_run_cover(time, wanted):
    """An estimate that ends a run when it happens to be small would cover in 91 of 100."""
    rng = np.random.default_rng(3)
    n_runs, inside, predicted = 400, 0, []
    for _ in range(n_runs):
        n, goal, early = judged(correlated(40_000, time, rng), {"pressure": wanted})
        mean, error, _ = goal.known["pressure"]
        assert error <= 1.001 * wanted * mean
        inside += abs(mean - 1.0) < 1.96 * error
        predicted.append((early or np.nan) / n)
    assert 0.93 < inside / n_runs < 0.975
    if wanted < 0.02:
        assert np.nanmedian(np.abs(np.array(predicted) - 1.0)) < 0.2


def test_a_run_ends_when_it_has_seen_enough_and_has_the_bits_of_any_run():
    sim, same = liquid(), liquid()
    record = sim.run(until={"temperature": 0.02, "potential_energy": 0.02}, every=7, progress=False)
    assert sim.goal.is_reached
    assert sim.step % 7 == 0
    assert sim.step == record.step[-1]
    assert len(record) >= 100
    for name, (mean, error, _) in sim.goal.known.items():
        assert mean == getattr(record, name).mean()
        assert error <= 0.02 * abs(mean)
    assert "reached" in str(sim.goal)
    same.run(sim.step, every=50)
    np.testing.assert_array_equal(sim.positions, same.positions)
    sim.run(10)
    assert sim.goal is None


def test_a_result_of_an_observer_is_a_goal():
    sim = liquid()
    sim.run(
        until={"diffusion": 0.3}, every=10, observers=[md.observers.MeanSquareDisplacement(every=10)], progress=False
    )
    mean, error, _ = sim.goal.known["diffusion"]
    assert 0.0 < error < 0.5 * mean


def test_a_crystal_melts_until_it_is_equilibrated():
    """Its energy rises by half of k_B T per atom within the first hundreds of steps; those do not count."""
    sim = liquid()
    record = sim.run(until="equilibrated", every=5, progress=False)
    assert sim.goal.is_reached
    assert sim.goal.equilibrated_from < sim.step / 3
    after = record.potential_energy[record.step >= sim.goal.equilibrated_from]
    assert abs(after[: len(after) // 3].mean() - after[-len(after) // 3 :].mean()) < 0.03 * abs(after.mean())
    goal = Goal("equilibrated", [], np.inf)
    slope = np.linspace(0.0, 3.0, 2000) + correlated(2000, 2.0, np.random.default_rng(2))
    steps = np.arange(2000)
    series = {"step": steps, "time": 1.0 * steps, "potential_energy": slope}
    goal.judge(Record.of(md.units.LJ, 1, series), 0, 10**6)
    assert not goal.is_reached


def test_a_wrong_name_touches_no_file(tmp_path):
    """Nor a number of an observer, or the step."""
    sim, file = liquid(), tmp_path / "a.h5md"
    sim.run(20, every=10, trajectory=file)
    observers = [md.observers.MeanSquareDisplacement(every=10)]
    for name, given in (("presure", []), ("step", []), ("difusion", observers)):
        with pytest.raises(ValueError, match=f"it names '{name}'"):
            sim.run(until={name: 0.1}, every=10, trajectory=file, overwrite=True, observers=given)
    assert len(md.read_record(file)) == 3


def test_what_cannot_be_reached_is_told_after_a_tenth():
    sim = liquid()
    sim.make_steps(2000)
    with pytest.warns(UserWarning, match=r"needs some .* steps to reach its goal, more than max_steps = 20000 allows"):
        sim.run(until={"pressure": 1e-4}, max_steps=20_000, every=10, progress=False)
    assert sim.step == 22_000
    assert not sim.goal.is_reached
    assert "not reached" in str(sim.goal)


test_goals_that_make_no_sense_are_answered = answered(
    (lambda: liquid().run(until={"presure": 0.1}), ValueError, "presure", "pressure"),
    (lambda: liquid().run(until={"pressure": 0.0}), ValueError, "until['pressure']", "0.0"),
    (lambda: liquid().run(until="soon"), TypeError, "soon", "equilibrated"),
    (lambda: liquid().run(100, until="equilibrated"), ValueError, "max_steps"),
    (lambda: liquid().run(100, max_steps=50), ValueError, "max_steps", "n_steps"),
)
