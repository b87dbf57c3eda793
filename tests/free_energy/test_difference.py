"""Free-energy differences from works: Gaussian works and harmonic wells have exact ones; error bars cover them."""

import numpy as np
import pytest
from wrong_calls import assert_answered

import minimd as md

RUNS = 40
KT = 0.7


def gaussian_works(rng, n, delta, sigma, kT=KT):
    """Works of both ways with a dissipation of σ²/2kT, as Crooks' theorem wants them; in them ΔF = delta."""
    lost = sigma**2 / (2.0 * kT)
    return rng.normal(delta + lost, sigma, n), rng.normal(lost - delta, sigma, n)


def wells(rng, n, k_0=1.0, k_1=4.0, apart=0.5, kT=KT):
    """Changes of the energy when one harmonic well is exchanged for another; ΔF = kT ln(k₁/k₀)/2."""
    x_0 = rng.normal(0.0, (kT / k_0) ** 0.5, n)
    x_1 = rng.normal(apart, (kT / k_1) ** 0.5, n)
    change = lambda x: 0.5 * k_1 * (x - apart) ** 2 - 0.5 * k_0 * x**2  # noqa: E731
    return change(x_0), -change(x_1), 0.5 * kT * np.log(k_1 / k_0)


def coverage(results, exact):
    """RMS deviation from the exact value over the RMS of the errors that are claimed."""
    deviations = np.array([one.free_energy for one in results]) - exact
    return np.sqrt((deviations**2).mean()) / np.sqrt(np.mean([one.free_energy_error**2 for one in results]))


def test_gaussian_works_give_the_mean_minus_half_the_variance_by_jarzynski():
    results = [
        md.free_energy.jarzynski(gaussian_works(np.random.default_rng(k), 400, 2.0, KT)[0], KT) for k in range(RUNS)
    ]
    errors = [one.free_energy_error for one in results]
    assert np.mean([one.free_energy for one in results]) == pytest.approx(2.0, abs=4 * np.mean(errors) / RUNS**0.5)
    assert np.mean(errors) == pytest.approx(KT * np.sqrt((np.e - 1.0) / 400), rel=0.25)  # of a lognormal average
    assert 0.85 < 1.0 / coverage(results, 2.0) < 1.3


@pytest.mark.parametrize("n_back", [400, 100])
def test_bar_is_exact_for_gaussian_works_and_its_error_that_of_shirts(n_back):
    results = []
    for k in range(RUNS):
        forward, backward = gaussian_works(np.random.default_rng(k), 400, 2.0, 1.5 * KT)
        results.append(md.free_energy.bar(forward, backward[:n_back], KT))
    errors = [one.free_energy_error for one in results]
    assert np.mean([one.free_energy for one in results]) == pytest.approx(2.0, abs=4 * np.mean(errors) / RUNS**0.5)
    assert 0.85 < 1.0 / coverage(results, 2.0) < 1.3
    x = np.concatenate([forward, -backward[:n_back]]) - results[-1].free_energy
    information = (1.0 / (2.0 + 2.0 * np.cosh(np.log(400 / n_back) + x / KT))).sum()
    assert np.mean(errors) == pytest.approx(KT * np.sqrt(1.0 / information - 1.0 / 400 - 1.0 / n_back), rel=0.15)
    assert max(abs(one.crooks) for one in results) < 4.0


def test_harmonic_wells_have_the_ratio_of_their_stiffnesses():
    """As many samples as wished: to 1 %. Correlated samples have larger error bars, that cover as well."""
    forward, backward, exact = wells(np.random.default_rng(1), 100_000)
    result = md.free_energy.bar(forward, backward, KT)
    assert abs(result.free_energy - exact) < 4 * result.free_energy_error < 0.04 * exact
    correlated = []
    for k in range(RUNS):
        forward, backward, _ = wells(np.random.default_rng(k), 400)
        correlated.append(md.free_energy.bar(np.repeat(forward, 10), np.repeat(backward, 10), KT))
    assert 0.85 < 1.0 / coverage(correlated, exact) < 1.3


def test_bar_is_jarzynskis_limit_of_few_works_back_and_its_sign_turns_with_the_process():
    forward, backward, _ = wells(np.random.default_rng(5), 5000)
    one, other = md.free_energy.bar(forward, backward, KT), md.free_energy.bar(backward, forward, KT)
    assert one.free_energy == pytest.approx(-other.free_energy, abs=1e-9)
    assert one.free_energy_error == pytest.approx(other.free_energy_error, rel=1e-6)
    assert md.free_energy.bar(10.0 * forward, 10.0 * backward, 10.0 * KT).free_energy == pytest.approx(
        10.0 * one.free_energy, rel=1e-9
    )


def test_numbers_without_evidence_are_refused_and_those_with_little_say_so():
    rng = np.random.default_rng(2)
    far, back = gaussian_works(rng, 1000, 0.0, 6.0 * KT)
    assert_answered(lambda: md.free_energy.jarzynski(far, KT), ValueError, "works must", "of 1000")
    assert_answered(lambda: md.free_energy.bar(5.0 + 0.1 * far / KT, 3.0 + back / KT, KT), ValueError, "overlap")
    few = md.free_energy.jarzynski(gaussian_works(rng, 400, 0.0, 1.7 * KT)[0], KT)
    assert few.n_effective < 30.0
    assert "LOWER BOUND" in str(few)
    enough = md.free_energy.jarzynski(gaussian_works(rng, 1000, 0.0, 0.5 * KT)[0], KT)
    assert "LOWER BOUND" not in str(enough)


def test_works_that_contradict_crooks_are_told():
    """A wrong kT; a sign forgotten leaves no overlap, or a contradiction."""
    forward, backward = gaussian_works(np.random.default_rng(3), 2000, 1.0, 1.5 * KT)
    assert "CONTRADICT" not in str(md.free_energy.bar(forward, backward, KT))
    assert "CONTRADICT" in str(md.free_energy.bar(forward, backward, 2.0 * KT))
    assert "CONTRADICT" in str(md.free_energy.bar(forward, backward, 0.5 * KT))
    assert_answered(lambda: md.free_energy.bar(forward + 6.0, -backward + 6.0, KT), ValueError, "overlap", "signs")


def test_a_result_prints_its_numbers_and_draws_its_works(tmp_path):
    forward, backward = gaussian_works(np.random.default_rng(4), 500, 2.0, KT)
    for result in (md.free_energy.bar(forward, backward, KT), md.free_energy.jarzynski(forward, KT)):
        assert f"ΔF = {result.free_energy:.3f} ± " in repr(result)
        assert result.numbers()["free_energy"] == result.free_energy
        result.plot().savefig(tmp_path / "works.png")
        assert (tmp_path / "works.png").stat().st_size > 1000


@pytest.mark.parametrize("works", [[1.0, 2.0, 3.0], [[1.0] * 8], [1.0, 2.0, np.nan, 3.0, 4.0], "works"])
def test_wrong_works_are_named(works):
    assert_answered(lambda: md.free_energy.jarzynski(works, KT), ValueError, "works")
    assert_answered(lambda: md.free_energy.bar([1.0, 2.0, 3.0, 4.0], works, KT), ValueError, "works_backward")
    assert_answered(lambda: md.free_energy.jarzynski([1.0, 2.0, 3.0, 4.0], -1.0), ValueError, "kT", "-1")
