"""A whole simulation: what it conserves, what it observes, how it stops, and what it leaves behind when it fails."""

import os
import signal

import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.integrators import SPLITTINGS

LJ = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")


def chains(n_beads=8):
    """Two bead chains in a box, bonded, first neighbors excluded."""
    rng = np.random.default_rng(3)
    k = np.arange(n_beads)
    one = np.column_stack([k * 0.97, 0.3 * np.sin(k), 0.3 * np.cos(k)])
    positions = np.concatenate([one, one + np.array([0.3, 2.5, 2.5])]) + 0.02 * rng.normal(size=(2 * n_beads, 3))
    bonds = np.concatenate([np.column_stack([k[:-1], k[1:]]), np.column_stack([k[:-1], k[1:]]) + n_beads])
    return md.System(positions, cell=9.0, bonds=bonds), [
        md.LennardJones(1.0, 1.0, 2.5, "switched", bonded_scale=(0, 1, 1)),
        md.HarmonicBond(400.0, 1.0),
    ]


@pytest.mark.parametrize("method", [method for method in SPLITTINGS.values() if method.order == 2])
def test_energy_oscillation_falls_as_the_square_of_the_time_step(method):
    oscillation = []
    for dt in (0.008, 0.004, 0.002):
        simulation = md.Simulation(liquid(3, jitter=0.02), md.LennardJones(1.0, 1.0, 1.85, "switched"), method(dt))
        simulation.run(round(0.8 / dt), every=round(0.8 / dt))
        record = simulation.run(round(1.6 / dt), every=round(0.016 / dt))
        oscillation.append(record.total_energy.std())
    slopes = np.diff(np.log(oscillation)) / np.log(0.5)
    assert slopes == pytest.approx([2.0, 2.0], abs=0.25)  # truncation, measured on one short path


def test_momentum_is_kept_to_rounding():
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85), md.VelocityVerlet(0.004))
    record = simulation.run(1000, every=50)
    drift = np.linalg.norm(record.momentum - record.momentum[0], axis=1)
    assert drift.max() < 1e-14 * record.absolute_momentum[0]


def test_angular_momentum_is_a_constant_of_a_cluster():
    simulation = md.Simulation(md.System(liquid(2, jitter=0.02).positions), LJ, md.VelocityVerlet(0.002))
    simulation.set_temperature(0.2, seed=3)
    record = simulation.run(1000, every=100)
    assert np.abs(record.angular_momentum - record.angular_momentum[0]).max() < 1e-12
    assert simulation.report().angular_momentum_change < 1e-12


@pytest.mark.parametrize("scene", ["liquid", "chains"])
def test_wrapping_any_atom_at_any_step_changes_nothing(scene):
    system, potentials = (liquid(3), [md.LennardJones(1.0, 1.0, 1.7)]) if scene == "liquid" else chains()
    plain, wrapped = (md.Simulation(system, potentials, md.VelocityVerlet(0.002)) for _ in range(2))
    rng = np.random.default_rng(8)
    for _ in range(20):
        plain.run(10, every=10)
        wrapped.run(10, every=10)
        moved = rng.random(len(system)) < 0.3
        wrapped.positions[moved] += rng.integers(-3, 4, (moved.sum(), 3)) @ system.cell.vectors
    away = (wrapped.positions - plain.positions) @ np.linalg.inv(system.cell.vectors)
    assert np.abs(away - np.rint(away)).max() < 1e-10
    assert np.abs(np.rint(away)).max() >= 1
    assert wrapped.frame().observables["total_energy"] == pytest.approx(
        plain.frame().observables["total_energy"], rel=1e-11
    )


def test_list_and_fresh_search_give_the_same_path():
    """Forces kept with a skin are those of a list built anew at every step."""
    ends = [
        md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.7), md.VelocityVerlet(0.004), skin=skin)
        for skin in (0.0, 0.2, 0.6)
    ]
    for simulation in ends:
        simulation.run(200, every=200)
    assert ends[0].positions == pytest.approx(ends[1].positions, abs=1e-10)
    assert ends[0].positions == pytest.approx(ends[2].positions, abs=1e-10)
    builds = [simulation.report().cost.list_builds for simulation in ends]
    assert builds[0] == 200 > builds[1] > builds[2]


def test_two_runs_are_one_run():
    one, two = (md.Simulation(*chains(), md.VelocityVerlet(0.002)) for _ in range(2))
    one.set_temperature(0.5, seed=1)
    two.set_temperature(0.5, seed=1)
    one.run(200, every=100)
    two.run(100, every=100)
    two.run(100, every=100)
    assert np.array_equal(one.positions, two.positions)
    assert (one.step, two.step) == (200, 200)
    assert two.time == pytest.approx(0.4)


def test_record_observes_the_start_and_every_few_steps():
    record = md.Simulation(*chains(), md.VelocityVerlet(0.002)).run(25, every=10)
    assert record.step.tolist() == [0, 10, 20]
    assert record.time == pytest.approx([0.0, 0.02, 0.04])
    assert record.momentum.shape == (3, 3)
    assert record.total_energy == pytest.approx(record.potential_energy + record.kinetic_energy)


def test_what_nobody_asks_for_is_not_recorded_or_paid():
    simulation = md.Simulation(md.System([[0, 0, 0], [1.2, 0, 0]]), LJ, md.VelocityVerlet(0.001))
    record = simulation.run(10, every=5)
    with pytest.raises(AttributeError, match="pressure was not recorded: the cell has no volume"):
        _ = record.pressure
    with pytest.raises(AttributeError, match="a record has no 'color'"):
        _ = record.color
    assert {"periodic images", "bond loop", "parameter table", "exclusions"} <= set(simulation.report().cost.skipped)


@pytest.mark.parametrize("every", [20, 500])
def test_energy_is_evaluated_only_where_somebody_looks(monkeypatch, every):
    asked = []
    compute = md.Forces.compute
    monkeypatch.setattr(
        md.Forces, "compute", lambda self, detail=0, *unit: (asked.append(detail), compute(self, detail, *unit))[1]
    )
    md.Simulation(*chains(), md.VelocityVerlet(0.002)).run(2 * every, every=every)
    assert len(asked) == 2 * every + 1
    assert sum(detail > 0 for detail in asked) == 3
    asked.clear()
    simulation = md.Simulation(*chains(), md.VelocityVerlet(0.002))
    simulation.set_temperature(1.0, seed=1)
    simulation.equilibrate(100, 1.0)
    assert sum(detail > 0 for detail in asked) == 1  # the look at the start


def test_pressure_is_minus_the_volume_derivative_of_the_free_energy_at_rest():
    """Without motion P = −dU/dV."""
    system, h = liquid(2, jitter=0.03), 1e-5
    at_rest = md.System(system.positions, cell=system.cell)
    energies = [
        md.evaluate(
            md.System(system.positions * s, cell=system.cell.vectors * s), md.LennardJones(1.0, 1.0, 1.3, "switched")
        ).potential_energy
        for s in ((1 - h) ** (1 / 3), (1 + h) ** (1 / 3))
    ]
    frame = md.Simulation(at_rest, md.LennardJones(1.0, 1.0, 1.3, "switched"), md.VelocityVerlet(0.001)).frame()
    assert frame.observables["pressure"] == pytest.approx(
        (energies[0] - energies[1]) / (2 * h * system.volume), rel=1e-6
    )


def test_set_temperature_is_exact_seeded_and_without_momentum():
    simulation = md.Simulation(liquid(3), LJ, md.VelocityVerlet(0.002))
    simulation.set_temperature(1.7, seed=7)
    first, observed = simulation.velocities.copy(), simulation.frame().observables
    assert observed["temperature"] == pytest.approx(1.7, rel=1e-14)
    assert np.abs(observed["momentum"]).max() < 1e-13 * observed["absolute_momentum"]
    simulation.set_temperature(1.7, seed=7)
    assert np.array_equal(first, simulation.velocities)
    simulation.set_temperature(1.7, seed=8)
    assert not np.allclose(first, simulation.velocities)


def test_rescaling_keeps_a_drift_unless_the_center_is_thermal():
    drift = [0.5, 0.0, -1.0]
    sim = md.Simulation(liquid(3), LJ, md.VelocityVerlet(0.002))
    sim.velocities[:] += drift
    sim.equilibrate(20, 1.3)
    assert sim.temperature == pytest.approx(1.3, rel=1e-12)
    assert sim.velocities.mean(axis=0) == pytest.approx(drift, abs=1e-13)  # rounding
    sim.velocities[:] = drift
    assert sim.temperature == 0.0
    with pytest.raises(ValueError, match="velocities"):
        sim.rescale_temperature(1.0)
    sim.method = md.LangevinBAOAB(0.002, 1.0, 1.0, seed=1)
    sim.rescale_temperature(1.0)
    assert sim.temperature == pytest.approx(1.0, rel=1e-12)
    assert sim.velocities[0, 2] == pytest.approx(-2.0 * sim.velocities[0, 0], rel=1e-12)


def test_velocities_are_normal_with_variance_by_mass():
    from scipy import stats

    masses = np.repeat([1.0, 16.0], 4000)
    system = md.System(np.random.default_rng(0).uniform(0, 100, (8000, 3)), masses=masses, cell=100.0)
    simulation = md.Simulation(system, md.HarmonicBond(1, 1), md.VelocityVerlet(0.1))
    simulation.set_temperature(2.0, seed=5)
    for mass in (1.0, 16.0):
        components = simulation.velocities[masses == mass].ravel() * np.sqrt(mass / 2.0)
        assert stats.kstest(components, "norm").pvalue > 0.01  # statistics, seed fixed


def test_equilibrate_reaches_the_temperature_and_starts_the_clock_again():
    simulation = md.Simulation(liquid(3, temperature=3.0), md.LennardJones(1.0, 1.0, 1.85), md.VelocityVerlet(0.004))
    simulation.equilibrate(300, 0.8)
    assert simulation.frame().observables["temperature"] == pytest.approx(0.8, rel=1e-12)
    assert (simulation.step, simulation.time) == (0, 0.0)


def test_simulation_works_on_a_copy():
    system = liquid(2)
    before = system.positions.copy()
    md.Simulation(system, LJ, md.VelocityVerlet(0.004), skin=0.1)
    sim = md.Simulation(md.System(before), LJ, md.VelocityVerlet(0.004))
    sim.run(10)
    assert np.array_equal(system.positions, before)
    assert not np.array_equal(sim.positions, before)


def test_blow_up_says_at_which_step_which_atoms_and_keeps_the_last_good_state():
    """Two fast atoms run into each other with a time step far too large."""
    positions = np.array([[0.0, 0, 0], [8.0, 0.05, 0], [4.0, 6.0, 6.0]])
    system = md.System(positions, velocities=[[10.0, 0, 0], [-10.0, 0, 0], [0, 0, 0]], cell=20.0)
    simulation = md.Simulation(system, LJ, md.VelocityVerlet(0.05))
    with pytest.raises(md.NonFiniteError) as caught:
        simulation.run(1000, every=100)
    message = str(caught.value)
    assert f"At step {simulation.step + 1}:" in message
    assert "atoms 0 and 1" in message
    assert "timestep 0.05 τ too large" in message
    assert 0 < simulation.step < 20
    assert np.isfinite(simulation.positions).all()
    assert np.abs(simulation.velocities).max() < 1e3
    assert simulation.frame().observables["potential_energy"] == pytest.approx(
        md.evaluate(simulation.system, LJ).potential_energy, rel=1e-12
    )
    twin = md.Simulation(system, LJ, md.VelocityVerlet(0.05))
    twin.run(simulation.step, every=1)
    assert simulation.positions == pytest.approx(twin.positions, abs=1e-9)


def test_a_start_that_would_explode_is_refused():
    system = md.System([[0, 0, 0], [0.01, 0, 0], [3, 3, 3]], cell=10.0)
    with pytest.raises(md.NonFiniteError, match=r"atoms 0 and 1, 0\.01 σ apart"):
        md.Simulation(system, LJ, md.VelocityVerlet(0.005)).run(10)


def test_law_that_returns_nan_is_caught():
    def broken(r2, limit):
        return (limit - r2) ** 0.5, 0.0 if r2 > limit else 1.0 / (limit - r2) ** 0.5

    system = md.System([[0, 0, 0], [1.5, 0, 0]], velocities=[[1, 0, 0], [0, 0, 0]])
    with pytest.raises(md.NonFiniteError, match=r"At step \d+: the potential energy is not finite"):
        md.Simulation(system, md.PairPotential(broken, (4.0,), 3.0, "truncated"), md.VelocityVerlet(0.01)).run(
            200, every=1
        )


def test_interrupt_stops_at_a_whole_step():
    simulation = md.Simulation(*chains(), md.VelocityVerlet(0.002))
    with pytest.raises(KeyboardInterrupt):
        simulation.run(
            100_000, every=10, observers=[lambda sim: os.kill(os.getpid(), signal.SIGINT) if sim.step == 50 else None]
        )
    twin = md.Simulation(*chains(), md.VelocityVerlet(0.002))
    twin.run(simulation.step, every=10)
    assert 50 <= simulation.step <= 60
    assert simulation.positions == pytest.approx(twin.positions, abs=1e-12)
    assert len(simulation.record) >= 6


def test_threads_of_python_can_run_simulations():
    """Outside the main thread no signal handler can be set, and none is needed."""
    from concurrent.futures import ThreadPoolExecutor

    def end(seed):
        simulation = md.Simulation(*chains(), md.VelocityVerlet(0.002))
        simulation.set_temperature(0.5, seed)
        simulation.run(50, every=10)
        return simulation.positions

    with ThreadPoolExecutor(2) as pool:
        threaded = list(pool.map(end, (1, 2)))
    assert np.array_equal(threaded[0], end(1))
    assert np.array_equal(threaded[1], end(2))


def test_atoms_moved_from_outside_are_seen():
    simulation = md.Simulation(md.System([[0, 0, 0], [1.5, 0, 0]]), LJ, md.VelocityVerlet(0.001))
    simulation.run(5, every=5)
    simulation.positions[:] = [[0, 0, 0], [1.12, 0, 0]]
    expected = md.evaluate(simulation.system, LJ)
    assert simulation.frame().observables["potential_energy"] == pytest.approx(expected.potential_energy, rel=1e-14)
    simulation.positions[1, 0] = 1.3
    expected = md.evaluate(simulation.system, LJ).potential_energy
    assert simulation.run(0).potential_energy[0] == pytest.approx(expected, rel=1e-14)


def test_observer_that_moves_an_atom_changes_the_next_kick():
    def push(sim):
        if sim.step == 10:
            sim.positions[1, 0] = 1.2

    watched = md.Simulation(md.System([[0, 0, 0], [1.5, 0, 0]]), LJ, md.VelocityVerlet(0.001))
    watched.run(20, every=10, observers=[push])
    twin = md.Simulation(md.System([[0, 0, 0], [1.5, 0, 0]]), LJ, md.VelocityVerlet(0.001))
    twin.run(10, every=10)
    push(twin)
    twin.run(10, every=10)
    assert np.array_equal(watched.positions, twin.positions)


@pytest.mark.parametrize("cells", [(None, 9.0), (9.0, None), (12.0, 4.0), (9.0, [9.0, 9.0, 5.2])])
def test_forces_follow_a_cell_that_changes(cells):
    """Open to periodic and back, below twice the cutoff, with bonds and exclusions."""
    system, potentials = chains()
    changing = md.System(system.positions, cell=cells[0], bonds=system.bonds)
    forces = md.Forces(changing, potentials)
    forces.compute(1)
    changing.cell = md.Cell.of(cells[1])
    forces.compute(1)
    fresh = md.evaluate(md.System(system.positions, cell=cells[1], bonds=system.bonds), potentials)
    assert forces.potential_energy == pytest.approx(fresh.potential_energy, rel=1e-12)
    assert forces.forces == pytest.approx(fresh.forces, rel=1e-11, abs=1e-11)


def test_what_is_fixed_cannot_be_changed_behind_the_engine():
    system = liquid(2)
    for array in (system.masses, system.bonds, system.species_index, system.cell.vectors, system.cell.lattice):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_another_method_is_checked_and_counts_its_degrees_of_freedom():
    sim = md.Simulation(liquid(2), md.LennardJones(1.0, 1.0, cutoff=1.5), md.VelocityVerlet(0.002))
    for wrong in (0.002, md.VelocityVerlet, None):
        with pytest.raises(TypeError, match="method must be an integrator with its time step"):
            sim.method = wrong
    assert isinstance(sim.method, md.VelocityVerlet)
    n_atoms = len(sim.system)
    assert sim.engine.surroundings.bath.n_dof == 3 * n_atoms - 3
    sim.method = md.LangevinBAOAB(0.002, 1.0, 1.0, 1)
    assert sim.n_dof == sim.engine.surroundings.bath.n_dof == 3 * n_atoms
