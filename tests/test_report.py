"""The conservation report: what it calls conserved, and how sure it is."""

from pathlib import Path

import numpy as np
import pytest
from lammps_scenes import water
from references import liquid

import minimd as md
from minimd.analysis.check import check_file
from minimd.compiled import machine
from minimd.compiled.machine import peak_memory
from minimd.diagnosis.report import conservation_report, drift, drift_of_walk
from minimd.engine.record import SERIES, Record

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


def test_the_kinetic_energy_of_a_report_leaves_out_a_drift(tmp_path):
    """Of rigid water, which has two degrees of freedom for each atom: in a run, and from its file."""
    file, simulation = tmp_path / "a.h5md", water()
    simulation.velocities -= simulation.drift
    expected = simulation.engine.kinetic_energy / len(simulation.system)
    simulation.velocities[:, 0] += 100.0
    with pytest.warns(UserWarning, match="the center of mass moves"):
        simulation.run(1, every=1, trajectory=file)
    for report in (simulation.report(), check_file(file).report):
        assert report.kinetic_energy == pytest.approx(expected, rel=0.01)


def test_report_sees_momentum_change():
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85), md.VelocityVerlet(0.002))

    def wind(sim):
        sim.velocities[:, 0] += 1e-6

    simulation.run(200, every=10, observers=[wind])
    assert not simulation.report().momentum_is_conserved


def test_drift_has_an_honest_error():
    """The error of the slope covers the truth for correlated noise, and finds a slope that is there."""
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


@pytest.fixture(scope="module")
def recorded():
    """The record of a run in which everything is conserved, with all that a record may hold."""
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.002))
    record = simulation.run(300, every=10)
    extra = {"shadow_energy": record.total_energy, "constraint_violation": np.zeros(len(record))}
    return {name: np.array(getattr(record, name)) for name in ("step", "time", *SERIES) if name in record} | extra


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("frames", [[0], [17], [30], slice(None)], ids=["first", "middle", "last", "all"])
@pytest.mark.parametrize("bath", [False, True], ids=["alone", "bath"])
def test_nothing_is_conserved_where_something_is_not_finite(recorded, value, frames, bath):
    """In any observable, in any frame."""
    known = recorded | ({"conserved_energy": recorded["total_energy"]} if bath else {})
    fine = conservation_report(Record.of(md.units.LJ, 108, known), angular=False)
    assert fine.energy_is_conserved
    assert fine.shadow_is_conserved
    assert fine.momentum_is_conserved
    for name in known.keys() - {"step"}:
        series = known | {name: known[name].copy()}
        series[name][frames] = value
        report = conservation_report(Record.of(md.units.LJ, 108, series), angular=True)
        judged = (
            report.energy_is_conserved,
            report.shadow_is_conserved,
            report.momentum_is_conserved,
            report.angular_momentum_is_conserved,
        )
        assert judged == (False,) * 4
        assert report.verdict.startswith(f"NOTHING IS CONSERVED: {name.replace('_', ' ')} is not finite at step")


@pytest.mark.parametrize("frames", [[0], [17], [30], slice(None)], ids=["first", "middle", "last", "all"])
def test_an_energy_that_overflows_is_not_conserved(recorded, frames):
    energy = recorded["total_energy"].copy()
    energy[frames] = 1e308 * np.random.default_rng(1).random(len(energy[frames]))
    report = conservation_report(Record.of(md.units.LJ, 108, recorded | {"total_energy": energy}), angular=False)
    assert report.energy_is_conserved is False
    assert "DRIFTS" in report.verdict


@pytest.mark.parametrize("slope", [drift, drift_of_walk])
def test_a_series_that_is_not_finite_has_a_drift(slope):
    t, series = np.linspace(0.0, 1.0, 50), np.ones(50)
    series[20] = np.nan
    assert slope(t, series).is_significant


@pytest.mark.skipif(peak_memory() is None, reason="the operating system does not tell")
def test_memory_is_the_peak_of_the_process(monkeypatch):
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85), md.VelocityVerlet(0.002))
    simulation.run(10)
    before = simulation.report().cost.peak_memory
    held = np.ones(int(before // 8) + 10**7)  # 80 MB more than the process has ever held, whatever was freed of it
    assert simulation.report().cost.peak_memory >= before + 80e6
    del held
    assert simulation.report().cost.peak_memory >= before + 80e6
    assert f"\nmemory         {peak_memory() / 1e6:.4g} MB at most so far, of the whole process\n" in str(
        simulation.report()
    )
    monkeypatch.setattr(machine, "STATUS", Path("nowhere"))
    monkeypatch.setattr(machine.platform, "system", lambda: "Windows")
    assert simulation.report().cost.peak_memory is None
    assert "memory" not in str(simulation.report())
    monkeypatch.setattr(machine.platform, "system", lambda: "Darwin")
    assert machine.peak_memory() > 0
