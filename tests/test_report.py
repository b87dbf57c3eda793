"""The conservation report: what it calls conserved, and how sure it is."""

import numpy as np
from references import liquid

import minimd as md

LJ = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")


def test_report_tells_conserved_from_not():
    good = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.002))
    good.run(2000, every=10)
    assert good.report().energy_is_conserved
    assert good.report().momentum_is_conserved
    assert "is conserved" in str(good.report())

    def friction(sim):
        sim.velocities[:] *= 0.99

    bad = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.002))
    bad.run(1000, every=10, observers=[friction])
    assert not bad.report().energy_is_conserved
    assert "DRIFTS" in bad.report().verdict


def test_report_sees_momentum_change():
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85), md.VelocityVerlet(0.002))

    def wind(sim):
        sim.velocities[:, 0] += 1e-6

    simulation.run(200, every=10, observers=[wind])
    assert not simulation.report().momentum_is_conserved


def test_drift_has_an_honest_error():
    """The error of the slope covers the truth for correlated noise, and finds a slope that is there."""
    from minimd.diagnosis.report import drift

    rng, t, misses = np.random.default_rng(0), np.linspace(0, 100, 4000), 0
    for _ in range(200):
        noise = np.convolve(rng.normal(size=4099), np.ones(100) / 100, mode="valid")
        misses += abs(drift(t, noise).slope) > 2 * drift(t, noise).error
        assert drift(t, noise + 0.01 * t).is_significant
    assert misses < 30  # 5 % expected, with room for the correlation between blocks


def test_angular_momentum_is_judged_by_its_scale_not_by_itself():
    """A cluster at rest as a whole has L = 0; rounding must not look like a change."""
    simulation = md.Simulation(md.System(liquid(2, jitter=0.0).positions - 1.0), LJ, md.VelocityVerlet(0.002))
    simulation.run(500, every=100)
    assert simulation.report().angular_momentum_change < 1e-12


def test_few_frames_are_not_judged():
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85), md.VelocityVerlet(0.002))
    simulation.run(20, every=10)
    assert simulation.report().energy_is_conserved is None
    assert "too few" in simulation.report().verdict


def test_small_significant_drift_is_told_apart_from_none():
    """1e-3 ε per atom per τ is a drift, however long the run."""
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.002))

    def heat(sim):
        sim.velocities[:] *= 1.0 + 1e-5

    simulation.run(2000, every=10, observers=[heat])
    assert 1e-4 < simulation.report().energy_drift.slope < 1e-2
    assert simulation.report().energy_is_conserved is False
