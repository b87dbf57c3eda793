"""Constrained molecular dynamics through Simulation: lengths, energy, temperature, pressure, restart."""

import numpy as np
import pytest
from rigid_scenes import SCENES

import minimd as md
from minimd.constraints.solver import ConstraintSolver
from minimd.diagnosis.report import drift as linear_drift
from minimd.integrators import SPLITTINGS
from minimd.structure.cell import Cell
from minimd.structure.lattice import crystal


def dumbbells(n_cells=3, density=0.9, length=0.5):
    """A fluid of rigid diatomic molecules, 4 n³ of them, in a periodic box."""
    centers, edges = crystal("fcc", [n_cells] * 3, (8.0 / density) ** (1 / 3))
    arms = np.random.default_rng(1).normal(size=centers.shape)
    arms *= 0.5 * length / np.linalg.norm(arms, axis=1)[:, None]
    positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
    pairs = np.arange(len(positions)).reshape(-1, 2)
    return md.System(positions, cell=edges, bonds=pairs), pairs


def law():
    return md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="switched", bonded_scale=(0, 1, 1))


def simulation(method, constraints=None, **options):
    system, pairs = dumbbells()
    sim = md.Simulation(system, law(), method, constraints or md.DistanceConstraints(pairs), **options)
    sim.set_temperature(1.0, seed=2)
    return sim


def test_energy_of_rigid_molecules_oscillates_with_the_square_of_the_timestep():
    start = simulation(md.VelocityVerlet(0.002))
    start.equilibrate(500, 1.0)

    def oscillation(timestep):
        sim = md.Simulation(start.system, law(), md.VelocityVerlet(timestep), start.constraints)
        energy = sim.run(round(0.4 / timestep), every=1).total_energy
        return energy.std()

    slope = np.log2(oscillation(0.002) / oscillation(0.001))
    assert slope == pytest.approx(2.0, abs=0.1)  # truncation


@pytest.mark.parametrize("method", [method for method in SPLITTINGS.values() if method.is_symmetric])
def test_every_symmetric_splitting_runs_constrained_and_returns(method):
    sim = simulation(method(0.002))
    start = sim.positions.copy()
    sim.run(100)
    assert sim.engine.constraint_set.bonds.violation(sim.positions).max() < 1e-13
    assert np.abs(sim.positions - start).max() > 0.1
    sim.velocities[:] *= -1.0
    sim.run(100)
    assert np.abs(sim.positions - start).max() < 1e-9  # rounding, amplified by the dynamics


def test_temperature_counts_what_is_left():
    sim = simulation(md.VelocityVerlet(0.002))
    n_atoms, n_molecules = len(sim.system), len(sim.system) // 2
    assert sim.n_dof == 3 * n_atoms - n_molecules - 3
    record = sim.run(0)
    assert record.temperature[0] == pytest.approx(1.0, rel=1e-14)
    assert 2.0 * record.kinetic_energy[0] / sim.n_dof == pytest.approx(1.0, rel=1e-14)
    fixed = simulation(md.VelocityVerlet(0.002), md.FixedAtoms([0, 3]))
    assert fixed.n_dof == 3 * n_atoms - 6


@pytest.mark.parametrize(
    "method",
    [md.LangevinBAOAB(0.004, 1.0, 2.0, 7), md.StochasticVelocityRescaling(0.004, 1.0, 0.2, 7)],
    ids=["BAOAB", "Bussi"],
)
def test_baths_keep_lengths_and_temperature(method):
    """Translation and rotation have their shares: equipartition, within four standard errors of blocks."""
    sim = simulation(method)
    sim.equilibrate(500, 1.0)
    shares = []

    def look(run):
        v = run.velocities.reshape(-1, 2, 3)
        centers = v.mean(axis=1)
        shares.append(
            [2.0 * (centers**2).sum(axis=1).mean() / 3.0, ((v - centers[:, None]) ** 2).sum(axis=(1, 2)).mean() / 2.0]
        )

    record = sim.run(6000, every=20, observers=[look])
    blocks = np.array(shares[1:]).reshape(15, -1, 2).mean(axis=1)
    error = blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))
    assert (error < 0.02).all()
    assert (np.abs(blocks.mean(axis=0) - 1.0) < 4.0 * error + 0.01).all()  # statistics; molecules share one momentum
    assert record.constraint_violation.max() < 1e-13


@pytest.mark.slow
def test_pressure_with_constraints_is_the_slope_of_the_free_energy():
    """Rigid molecules whose centers are scaled: p = (2 K_cm + Σ F_cm · r_cm)/3V, averaged, equals the atomic pressure with constraint forces."""
    sim = simulation(md.StochasticVelocityRescaling(0.004, 1.0, 0.2, 7))
    sim.equilibrate(500, 1.0)
    pairs, volume = sim.system.bonds, sim.system.volume
    molecular = []

    def look(run):
        result = md.evaluate(run.system, law())
        v = run.velocities[pairs].mean(axis=1)
        r = run.positions[pairs] - run.positions[pairs].mean(axis=1, keepdims=True)
        inner = (
            run.forces[pairs] * r
        ).sum()  # Σ F_i · (r_i − r_cm), what the atomic virial has beyond the molecular one
        molecular.append((2.0 * (v**2).sum() + np.trace(result.virial) - inner) / (3.0 * volume))

    record = sim.run(8000, every=20, observers=[look])
    difference = (record.pressure - np.array(molecular))[1:].reshape(16, -1).mean(axis=1)
    error = difference.std(ddof=1) / 4.0
    assert error < 0.02 * abs(record.pressure.mean())
    assert abs(difference.mean()) < 4.0 * error  # statistics


def test_bonds_across_the_boundary_and_wrapped_atoms_change_nothing():
    plain, wrapped = simulation(md.VelocityVerlet(0.002)), simulation(md.VelocityVerlet(0.002))
    edges = np.diagonal(wrapped.system.cell.vectors)
    rng = np.random.default_rng(3)

    def wrap(run):
        run.positions[:] += rng.integers(-2, 3, run.positions.shape) * edges

    plain.run(100, every=20)
    record = wrapped.run(100, every=20, observers=[wrap])
    apart = wrapped.positions - plain.positions
    assert np.abs(apart - np.round(apart / edges) * edges).max() < 1e-9  # rounding, amplified
    assert record.constraint_violation.max() < 1e-12


@pytest.mark.parametrize("method", [md.VelocityVerlet, md.PositionVerlet, md.Leapfrog])
def test_how_often_one_looks_changes_nothing(method):
    """Drifts with constraints are no flow: those of two steps are not merged where nobody looks."""
    often, seldom = simulation(method(0.004)), simulation(method(0.004))
    often.run(60, every=1)
    seldom.run(60, every=60)
    assert np.abs(often.positions - seldom.positions).max() < 1e-10  # rounding, amplified


def test_velocities_are_drawn_for_wrapped_atoms_too():
    sim = simulation(md.VelocityVerlet(0.002))
    edge = sim.system.cell.vectors[0, 0]
    sim.positions[::2, 0] += edge
    sim.set_temperature(1.0, seed=2)
    assert sim.run(0).temperature[0] == pytest.approx(1.0, rel=1e-12)


def test_a_frame_before_the_first_run_knows_the_constraints():
    sim = simulation(md.VelocityVerlet(0.002))
    assert sim.frame().observables["pressure"] == pytest.approx(sim.run(0).pressure[0], rel=1e-9)


def test_a_frame_and_a_report_of_wrapped_atoms_know_where_the_bonds_are():
    sim = simulation(md.VelocityVerlet(0.002))
    sim.run(10, every=5)
    pressure, report = sim.frame().observables["pressure"], str(sim.report())
    sim.positions[::2, 0] += sim.system.cell.vectors[0, 0]
    assert sim.frame().observables["pressure"] == pytest.approx(pressure, rel=1e-9)  # rounding
    assert "NOT OBEYED" not in report
    sim.positions[::2, 0] += sim.system.cell.vectors[0, 0]
    assert "NOT OBEYED" not in str(sim.report())


def test_a_bond_across_the_boundary_of_a_new_cell_is_put_right():
    system = md.System([[0.2, 5.0, 5.0], [9.2, 5.0, 5.0]], cell=10.0)
    sim = md.Simulation(
        system, md.LennardJones(1.0, 0.5, 1.2), md.VelocityVerlet(0.001), md.DistanceConstraints([[0, 1]])
    )
    sim.run(1)
    sim.system.cell = Cell.of(10.5)
    with pytest.warns(UserWarning, match="relative errors were"):
        sim.run(1)
    assert sim.positions[0, 0] - sim.positions[1, 0] + 10.5 == pytest.approx(1.0, rel=1e-12)


def test_a_violated_start_is_projected_with_a_warning():
    system, pairs = dumbbells()
    sim = md.Simulation(system, law(), md.VelocityVerlet(0.002), md.DistanceConstraints(pairs, 0.48))
    with pytest.warns(UserWarning, match="relative errors were"):
        sim.run(1)
    assert sim.engine.constraint_set.bonds.violation(sim.positions).max() < 1e-13


def test_a_run_that_breaks_a_bond_keeps_the_last_good_state():
    sim, twin = simulation(md.VelocityVerlet(0.08)), simulation(md.VelocityVerlet(0.08))
    with pytest.raises(
        md.ConstraintError,
        match=r"reduce the timestep.*\n.* constraint \d+ \(atoms \d+-\d+\) cannot be kept .* error of r² is",
    ) as caught:
        sim.run(100)
    assert f"At step {sim.step + 1}:" in str(caught.value)
    twin.run(sim.step)
    assert np.abs(sim.positions - twin.positions).max() < 1e-9
    assert sim.engine.constraint_set.bonds.violation(sim.positions).max() < 1e-13


def test_fixed_atoms_stay_and_the_report_promises_no_momentum():
    sim = simulation(md.VelocityVerlet(0.002), [md.DistanceConstraints(dumbbells()[1]), md.FixedAtoms([0, 5])])
    start = sim.positions.copy()
    sim.run(100, every=20)
    assert (sim.positions[[0, 5]] == start[[0, 5]]).all()
    assert np.abs(sim.positions - start).max() > 0.05
    assert "not a constant" in str(sim.report())


@pytest.mark.parametrize("length", [0.9, 1.2, 3.1])
@pytest.mark.parametrize("skew", [0.0, 0.7])
def test_bonds_longer_than_half_the_cell_turn_as_they_are(length, skew):
    """In a cell of edge 2, where another image comes nearer as they turn: beside the same bond in open space, wrapped or not."""
    cell, rng = np.array([[2.0, 0.0, 0.0], [skew, 2.0, 0.0], [skew, 0.3, 2.0]]), np.random.default_rng(1)
    positions, velocities = np.outer([0.0, length], [0.8, 0.6, 0.0]), np.outer([-1.0, 1.0], [-0.3, 0.4, 0.5])
    far = md.LennardJones(1e-30, 0.01, cutoff=0.5)

    def turning(edges, observers):
        start = md.System(positions, velocities=velocities, cell=edges)
        sim = md.Simulation(start, far, md.VelocityVerlet(0.01), md.DistanceConstraints([[0, 1]], length))
        return sim, sim.run(600, every=7, observers=observers)

    def wrap(run):
        run.positions[:] += rng.integers(-2, 3, run.positions.shape) @ cell

    (free, _), (wrapped, record), (plain, _) = turning(None, []), turning(cell, [wrap]), turning(cell, [])
    plain.run(50)
    free.run(50)
    wrapped.run(50)
    assert record.constraint_violation.max() < 1e-12
    assert np.abs(plain.positions - free.positions).max() < 1e-10  # rounding
    assert np.abs(wrapped.velocities - free.velocities).max() < 1e-10


@pytest.mark.parametrize("none", [[], (), np.zeros(216, dtype=bool)])
def test_no_fixed_atoms_are_none(none):
    sim = md.Simulation(dumbbells()[0], law(), md.VelocityVerlet(0.002), md.FixedAtoms(none))
    assert sim.conserves_momentum
    assert sim.n_dof == 3 * len(sim.system) - 3


@pytest.mark.parametrize(
    ("atoms", "message"),
    [
        (np.ones(5, dtype=bool), "one bool for each of 216 atoms; got 5 bools"),
        (np.zeros(217, dtype=bool), "one bool for each of 216 atoms; got 217 bools"),
        ([216], "must be among 0 to 215; they name atom 216"),
        ([0.5], r"must be a list of indices, counted from 0, or one bool for each atom: some are fractions"),
        ([-1], "must be a list of indices"),
        ([[0, 1]], "must be a list of indices"),
    ],
)
def test_fixed_atoms_that_do_not_exist_are_refused(atoms, message):
    with pytest.raises(ValueError, match=message):
        md.Simulation(dumbbells()[0], law(), md.VelocityVerlet(0.002), md.FixedAtoms(atoms))


def test_fixed_atoms_may_overlap_each_other_but_not_one_that_moves():
    """A force on an atom that does not move throws nothing across the scene."""
    positions = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [1.5, 0.0, 0.0]]
    lj = md.LennardJones(1.0, 1.0, cutoff=2.5)
    sim = md.Simulation(md.System(positions), lj, md.VelocityVerlet(0.002), md.FixedAtoms([0, 1]))
    sim.run(50)
    assert (sim.positions[:2] == positions[:2]).all()
    assert abs(sim.positions[2, 0] - 1.5) > 1e-3
    with pytest.raises(md.NonFiniteError, match="the force on atom 1 would move it"):
        md.Simulation(md.System(positions), lj, md.VelocityVerlet(0.002), md.FixedAtoms([0])).run(1)


def test_the_report_tells_of_constraints():
    sim = simulation(md.VelocityVerlet(0.002))
    sim.run(100, every=20)
    text = str(sim.report())
    assert "108 in bonds of their own" in text
    assert "lengths        kept to" in text
    free = md.Simulation(dumbbells()[0], law(), md.VelocityVerlet(0.0005))
    free.run(10, every=5)
    assert "lengths" not in str(free.report())
    assert free.engine.surroundings.constraints is None


@pytest.mark.parametrize("constraints", ["rigid", [md.FixedAtoms([0]), "x"], [1]])
def test_other_constraints_are_refused(constraints):
    with pytest.raises(TypeError, match="must be DistanceConstraints or FixedAtoms"):
        md.Simulation(dumbbells()[0], law(), md.VelocityVerlet(0.002), constraints)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_lengths_are_kept_to_rounding_over_100_000_steps(name):
    """After every single one, with Newton's method; and the energy of the free motion does not drift."""
    positions, pairs, masses = SCENES[name]
    n_steps, timestep = (20_000, 0.002) if name == "sheet" else (100_000, 0.01)
    masses = np.asarray(masses, dtype=float)
    positions = positions - masses @ positions / masses.sum()
    bonds = ConstraintSolver(md.DistanceConstraints(pairs, solver="newton"), positions, 1.0 / masses)
    velocities = np.random.default_rng(2).normal(size=positions.shape)
    velocities -= masses @ velocities / masses.sum()
    bonds.project_velocities(velocities, positions)
    energies, worst = [], 0.0
    for step in range(n_steps):
        bonds.drift(positions, velocities, timestep)
        bonds.project_velocities(velocities, positions)
        limit = 20.0 * np.finfo(float).eps * np.abs(positions).max() / bonds.lengths.min()
        worst = max(
            worst,
            bonds.violation(positions).max() / limit,
            bonds.velocity_violation(positions, velocities).max() / limit,
        )
        if step % 100 == 0:
            energies.append(0.5 * masses @ (velocities**2).sum(axis=1))
    assert worst < 1.0
    drift = linear_drift(timestep * 100 * np.arange(len(energies)), np.array(energies))
    assert abs(drift.slope) < 4.0 * drift.error or abs(drift.slope) * n_steps * timestep < 1e-9 * energies[0]
