"""Profiles from umbrella windows: those of potentials that are known, with error bars that cover; gaps are refused."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import ndtr
from wrong_calls import assert_answered

import minimd as md

KT, K, RUNS = 0.8, 20.0, 40
CENTERS = np.linspace(-1.5, 1.5, 13)
EDGES = np.linspace(-1.4, 1.4, 29)
GRID = np.linspace(-3.0, 3.0, 6001)


def double_well(x):
    return 3.0 * (x * x - 1.0) ** 2 + 0.5 * x


def samples(rng, n, center, correlation=0.0, stiffness=K):
    """Of one window, exactly from its distribution, with correlations ρᵗ of the normal numbers behind them."""
    noise = rng.normal(size=n)
    noise[1:] *= (1.0 - correlation**2) ** 0.5
    normal = lfilter([1.0], [1.0, -correlation], noise)
    density = np.exp(-(double_well(GRID) + 0.5 * stiffness * (GRID - center) ** 2) / KT)
    cumulative = np.cumsum(density)
    return np.interp(ndtr(normal), cumulative / cumulative[-1], GRID)


def windows(seed, n=300, correlation=0.0, stiffness=K, centers=CENTERS):
    rng = np.random.default_rng(seed)
    return [samples(rng, n, center, correlation, stiffness) for center in centers]


def exact_profile(profile):
    """Of bins, with the zero where the profile has it."""
    density = np.exp(-double_well(GRID) / KT)
    width = EDGES[1] - EDGES[0]
    free = [-KT * np.log(density[np.abs(GRID - x) <= 0.5 * width].mean()) for x in profile.coordinate]
    return np.array(free) - free[int(profile.free_energy.argmin())]


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_a_double_well_is_found_within_errors_that_cover(correlation):
    profiles = [md.free_energy.umbrella(windows(k, 300, correlation), CENTERS, K, KT, EDGES) for k in range(RUNS)]
    off = np.array([one.free_energy - exact_profile(one) for one in profiles])
    errors = np.array([one.free_energy_error for one in profiles])
    assert np.abs(off.mean(axis=0)).max() < 4.0 * errors.mean() / RUNS**0.5
    assert 0.85 < np.sqrt((errors**2).mean() / (off**2).mean()) < 1.3
    assert errors.mean() < (0.15 if correlation == 0.0 else 0.4)


def test_errors_are_the_response_of_the_profile_to_the_samples():
    """All blocks of the windows are alike, but for half of those of one, in which one sample is another."""
    centers, rng = np.linspace(-1.4, 1.4, 6), np.random.default_rng(6)
    blocks = [samples(rng, 40, center, stiffness=6.0) for center in centers]
    moved = blocks[1].copy()
    moved[3] = moved.max()
    is_moved = np.tile([False, True, True, False], 8)

    def profile():
        mixed = np.concatenate([moved if other else blocks[1] for other in is_moved])
        series = [mixed if k == 1 else np.tile(block, 32) for k, block in enumerate(blocks)]
        return md.free_energy.umbrella(series, centers, 6.0, KT, np.linspace(-1.2, 1.2, 9))

    before = profile()
    is_moved[0] = True
    change = np.abs(profile().free_energy - before.free_energy)
    errors = before.free_energy_error
    assert change.max() > 1e-5
    assert errors / errors.max() == pytest.approx(change / change.max(), rel=0.03, abs=0.01)  # truncation


def test_windows_of_a_free_particle_cost_what_their_stiffness_says():
    """Gaussians of different stiffness: the free energies of the windows are kT ln(k/k₀)/2."""
    rng, stiffnesses = np.random.default_rng(7), np.array([1.0, 4.0, 9.0, 2.0])
    centers = np.array([0.0, 0.3, 0.5, 0.8])
    series = [rng.normal(c, (KT / k) ** 0.5, 10_000) for c, k in zip(centers, stiffnesses, strict=True)]
    result = md.free_energy.umbrella(series, centers, stiffnesses, KT)
    assert result.window_free_energies == pytest.approx(0.5 * KT * np.log(stiffnesses), abs=0.02)  # statistics


def test_the_profile_does_not_depend_on_the_order_or_number_of_windows():
    series = windows(3)
    order = np.random.default_rng(1).permutation(len(CENTERS))
    one = md.free_energy.umbrella(series, CENTERS, K, KT, EDGES)
    other = md.free_energy.umbrella([series[k] for k in order], CENTERS[order], np.full(13, K), KT, EDGES)
    assert other.free_energy == pytest.approx(one.free_energy, abs=1e-7)
    assert other.free_energy_error == pytest.approx(one.free_energy_error, rel=1e-5, abs=1e-9)
    twice = md.free_energy.umbrella([*series, *series], [*CENTERS, *CENTERS], K, KT, EDGES)
    assert twice.free_energy == pytest.approx(one.free_energy, abs=1e-6)
    assert twice.free_energy_error[5] < one.free_energy_error[5]


def test_wham_of_the_same_histograms_agrees():
    """The textbook iteration on bins, the twin of the equations without them."""
    series = windows(5, 2000)
    fine = np.linspace(-2.5, 2.5, 401)
    middle = 0.5 * (fine[1:] + fine[:-1])
    counts = np.array([np.histogram(values, fine)[0] for values in series])
    factors = np.exp(-0.5 * K * (middle - CENTERS[:, None]) ** 2 / KT)
    f = np.zeros(len(CENTERS))
    for _ in range(4000):
        p = counts.sum(axis=0) / ((counts.sum(axis=1) * np.exp(f)) @ factors)
        f = -np.log(factors @ p)
    result = md.free_energy.umbrella(series, CENTERS, K, KT, EDGES)
    assert result.window_free_energies == pytest.approx(KT * (f - f[0]), abs=5e-3)  # width of the bins


def test_gaps_are_refused_and_short_runs_told():
    """No sample in common: no evidence."""
    centers = np.delete(CENTERS, [5, 6, 7])
    series = windows(1, stiffness=60.0, centers=centers)
    words = "windows 4 and 5", "gap"
    assert_answered(lambda: md.free_energy.umbrella(series, centers, 60.0, KT), ValueError, *words)
    short = md.free_energy.umbrella(windows(2, 300, 0.92), CENTERS, K, KT, 20)
    assert "LOWER BOUNDS" in str(short)
    assert f"in window {short.shortest} " in str(short)
    assert "LOWER BOUNDS" not in str(md.free_energy.umbrella(windows(2), CENTERS, K, KT, 20))


def test_a_profile_prints_its_numbers_and_is_drawn(tmp_path):
    result = md.free_energy.umbrella(windows(4), CENTERS, K, KT, EDGES)
    assert "highest F = " in str(result)
    assert result.numbers()["minimum"] == pytest.approx(-1.0, abs=0.15)
    result.plot().savefig(tmp_path / "profile.png")
    assert (tmp_path / "profile.png").stat().st_size > 1000


SERIES = windows(0, 50)
WRONG = {
    "another number of centers": ((SERIES, CENTERS[1:], K, KT), "centers", "13 windows"),
    "a center of nan": (([SERIES[0]], [np.nan], K, KT), "centers", "nan"),
    "no window": (([], [], K, KT), "centers", "0 windows"),
    "three samples": (([[1.0, 2.0, 3.0]], [0.0], K, KT), "coordinates[0]", "(3,)"),
    "not finite": (([[1.0, 2.0, np.nan, 4.0]], [0.0], K, KT), "coordinates[0]", "finite"),
    "negative springs": ((SERIES, CENTERS, -1.0, KT), "stiffnesses", "-1"),
    "no temperature": ((SERIES, CENTERS, K, 0.0), "kT", "0"),
    "bins elsewhere": ((SERIES, CENTERS, K, KT, [5.0, 6.0]), "bins", "[5.0, 6.0]"),
    "no bins": ((SERIES, CENTERS, K, KT, -1), "bins", "-1"),
    "words": ((SERIES, CENTERS, K, KT, "many"), "bins", "many"),
    "edges in reverse": ((SERIES, CENTERS, K, KT, [1.0, 0.0]), "bins", "increasing"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_windows_are_named(name):
    arguments, *words = WRONG[name]
    assert_answered(lambda: md.free_energy.umbrella(*arguments), ValueError, *words)


@pytest.mark.slow
def test_windows_that_minimd_runs_give_the_field_that_they_were_run_in():
    """Many atoms in a double well along x, each window a restraint: from the trajectory to the profile."""

    def field(x, y, z, t):
        u = 3.0 * (x * x - 1.0) ** 2 + 0.5 * x
        return u, -12.0 * x * (x * x - 1.0) - 0.5, 0.0, 0.0, 0.0

    series, spring = [], K
    for center in CENTERS:
        system = md.System(np.tile([center, 0.0, 0.0], (20, 1)))
        bias = md.Restraint([spring, 1.0, 1.0], np.tile([center, 0.0, 0.0], (20, 1)))
        sim = md.Simulation(system, [md.Field(field), bias], md.LangevinBAOAB(0.02, KT, friction=2.0, seed=3))
        sim.set_temperature(KT, seed=3)
        sim.run(500, progress=False)
        places = []
        sim.run(4000, every=10, observers=[lambda sim, places=places: places.append(sim.positions[:, 0].copy())])
        series.append(np.concatenate(np.array(places).T))  # one atom after the other
    result = md.free_energy.umbrella(series, CENTERS, spring, KT, EDGES)
    off = result.free_energy - exact_profile(result)
    assert np.abs(off).max() < 5.0 * result.free_energy_error.max() < 0.5
