"""Simulations with a bath: what is conserved, that a run in parts or resumed is the run in one, and what files and reports say."""

import numpy as np
import pytest
from baths import BUSSI, LANGEVIN, OBABO, SCENE, simulation

import minimd as md
from minimd.analysis.check import check_file
from minimd.diagnosis.report import drift, drift_of_walk
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import H5MDWriter
from minimd.forces.cluster_term import ClusterTerm
from minimd.integrators import THERMOSTATS
from minimd.scene import parse_scene
from minimd.scene.running import resume_run, run_scene


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_temperature_counts_the_degrees_of_freedom_that_the_bath_leaves(method):
    sim = simulation(method)
    n = len(sim.system)
    assert sim.n_dof == (3 * n if method is LANGEVIN else 3 * n - 3)
    sim.run(0)
    assert sim.record.temperature[0] == pytest.approx(1.3, rel=1e-14)
    assert 2.0 * sim.record.kinetic_energy[0] == pytest.approx(1.3 * sim.n_dof, rel=1e-14)


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_total_energy_minus_heat_is_conserved(method):
    """As well as the total energy is without a bath, though the bath moves it by a hundred times more."""
    parameters = {**method.parameters, "timestep": 0.002}
    sim = simulation(type(method)(**parameters))
    sim.equilibrate(500, 1.3)
    record = sim.run(2000, every=25)
    conserved, total = record.conserved_energy, record.total_energy
    assert np.ptp(conserved) < 0.05 * np.ptp(total)
    assert sim.report().energy_is_conserved
    assert "minus reservoir energy is conserved" in sim.report().verdict
    assert total[-1] - conserved[-1] == pytest.approx(sim.reservoir_energy, rel=1e-9)


def test_rescaling_keeps_momentum_and_langevin_does_not_promise_it():
    report = simulation(BUSSI), simulation(LANGEVIN)
    for sim in report:
        sim.run(200, every=20)
    assert report[0].report().momentum_change < 1e-13
    assert report[1].report().momentum_change is None
    assert "not a constant" in str(report[1].report())


def test_without_friction_langevin_is_velocity_verlet():
    free, verlet = simulation(md.LangevinBAOAB(0.004, 1.3, 0.0, 1)), simulation(md.VelocityVerlet(0.004))
    verlet.velocities[:] = free.velocities
    free.run(100)
    verlet.run(100)
    assert np.abs(free.positions - verlet.positions).max() < 1e-10  # rounding, amplified
    assert free.reservoir_energy == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_a_run_in_two_parts_is_the_run_in_one(method):
    whole, parts = simulation(method), simulation(method)
    whole.run(60, every=30)
    parts.run(30, every=30)
    parts.run(30, every=30)
    assert abs(whole.reservoir_energy) > 1.0
    assert (whole.positions == parts.positions).all()
    assert (whole.velocities == parts.velocities).all()
    assert whole.reservoir_energy == parts.reservoir_energy


def test_contacts_at_both_ends_of_a_step_are_not_made_one_where_nobody_looks():
    whole, parts = (simulation(OBABO(0.004, 1.3, 2.0, 5)) for _ in range(2))
    whole.run(40, every=40)
    parts.run(20, every=20)
    parts.run(20, every=20)
    assert whole.positions == pytest.approx(
        parts.positions, abs=1e-9
    )  # rounding: energies are summed with the forces or without


@pytest.mark.parametrize("method", THERMOSTATS)
def test_a_resumed_run_meets_the_noise_of_an_uninterrupted_one(method, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = parse_scene(SCENE.format(method=method), tmp_path / "bath.toml")
    run_scene(scene, trajectory=tmp_path / "whole.h5md", tell=lambda _: None)
    run_scene(scene, steps=20, trajectory=tmp_path / "parts.h5md", tell=lambda _: None)
    resume_run(tmp_path / "parts.h5md", 20, tell=lambda _: None)
    whole, parts = read_file(tmp_path / "whole.h5md"), read_file(tmp_path / "parts.h5md")
    assert (
        np.abs(whole.system.velocities - parts.system.velocities).max() < 1e-11
    )  # rounding: the list is built anew, sums have another order
    assert np.abs(whole.record.conserved_energy - parts.record.conserved_energy).max() < 1e-10
    assert whole.reservoir_energy == pytest.approx(parts.reservoir_energy, rel=1e-10)
    assert abs(whole.reservoir_energy) > 0.1


def test_equilibration_and_run_have_different_noise(monkeypatch):
    monkeypatch.setattr(ClusterTerm, "marches", False)  # thermalize is called at each step
    sim = simulation(LANGEVIN)
    seen = []
    thermalize = sim.method.thermalize
    sim.method = md.LangevinBAOAB(0.01, 1.3, 2.0, 5)
    sim.method.thermalize = lambda s, duration, around: (seen.append(around.bath.step), thermalize(s, duration, around))
    sim.equilibrate(5, 1.3)
    sim.run(3)
    assert seen == [-5, -4, -3, -2, -1, 0, 1, 2]
    assert sim.step == 3


def test_each_equilibration_has_noise_of_its_own_and_the_same_in_each_repetition(monkeypatch):
    """Two of them, and one after a run: none meets the noise of another, or that of the run."""
    monkeypatch.setattr(ClusterTerm, "marches", False)  # thermalize is called at each step

    def steps_of_noise():
        sim, seen = simulation(LANGEVIN), []
        sim.method = md.LangevinBAOAB(0.01, 1.3, 2.0, 5)
        thermalize = sim.method.thermalize
        sim.method.thermalize = lambda s, duration, around: (
            seen.append(around.bath.step),
            thermalize(s, duration, around),
        )
        sim.equilibrate(5, 1.3)
        sim.equilibrate(3, 1.3)
        sim.run(4)
        sim.equilibrate(2, 1.3)
        return seen, sim.velocities

    first, again = steps_of_noise(), steps_of_noise()
    assert first[0] == again[0] == [-5, -4, -3, -2, -1, -8, -7, -6, 0, 1, 2, 3, -10, -9]
    assert (first[1] == again[1]).all()


def test_replay_meets_the_same_noise():
    """A run that blows up ends in the state of a run that stops just before, made step by step."""
    failing, twin = (simulation(md.LangevinBAOAB(0.045, 1.3, 1.0, 1)) for _ in range(2))
    with pytest.raises(md.NonFiniteError):
        failing.run(20_000, every=100)
    assert failing.step > 1
    twin.run(failing.step, every=1)
    assert (failing.positions, failing.reservoir_energy) == (
        pytest.approx(twin.positions, abs=1e-9),
        pytest.approx(twin.reservoir_energy, rel=1e-9),
    )  # kicks merge


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_a_file_of_a_run_with_a_bath_passes_its_check(method, tmp_path):
    sim = simulation(type(method)(**{**method.parameters, "timestep": 0.002}))
    sim.equilibrate(1000, 1.3)
    sim.run(1000, every=10, trajectory=tmp_path / "bath.h5md")
    checked = check_file(tmp_path / "bath.h5md")
    assert checked.passed, str(checked)
    assert checked.report.verdict == sim.report().verdict


@pytest.mark.parametrize(
    ("first", "then"), [(LANGEVIN, md.VelocityVerlet(0.01)), (md.VelocityVerlet(0.01), BUSSI)], ids=["without", "with"]
)
def test_a_file_with_a_bath_is_not_continued_without_and_the_other_way_round(first, then, tmp_path):
    simulation(first).run(20, every=10, trajectory=tmp_path / "a.h5md")
    other = simulation(then)
    other.step = 20
    with pytest.raises(ValueError, match=r"a thermostat; it cannot be continued with"):
        H5MDWriter.append_to(tmp_path / "a.h5md", other.engine)


def test_drift_of_a_walk_has_an_honest_error():
    """Of walks without drift few seem to have one, where a fitted line cannot tell in most; one that is there is found."""
    rng, t = np.random.default_rng(0), np.linspace(0.0, 100.0, 4001)
    walks = np.cumsum(rng.normal(size=(300, t.size)), axis=1)
    misses = sum(abs(drift_of_walk(t, walk).slope) > 2.0 * drift_of_walk(t, walk).error for walk in walks)
    assert misses < 35  # 5 % expected, with few blocks 6
    assert sum(drift(t, walk).is_too_short for walk in walks) > 150
    assert all(drift_of_walk(t, walk + 10.0 * np.sqrt(t.size) / 100.0 * t).is_significant for walk in walks)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [lambda s: md.LangevinBAOAB(0.004, 1.3, 5.0, s), lambda s: md.StochasticVelocityRescaling(0.004, 1.3, 0.1, s)],
)
def test_long_runs_that_are_fine_are_told_so(make):
    """Energy minus reservoir energy wanders by 1e-3 ε per atom in 25 000 steps; that is no drift."""
    ratios = []
    for seed in range(6):
        sim = simulation(make(seed), seed)
        sim.run(2000, every=2000)
        sim.run(25_000, every=10)
        ratios.append(sim.report().energy_drift.slope / sim.report().energy_drift.error)
    assert (
        np.abs(ratios).max() < 4.5
    )  # errors from twenty blocks have long tails: 3.5 is passed once in a hundred such tests
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0  # statistics: 1 expected
