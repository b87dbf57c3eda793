"""Runs with constraints: what a Simulation keeps, counts and promises of rigid molecules and of fixed atoms."""

import numpy as np
import pytest
from rigid_scenes import PAIRS, VERLET, cube, dumbbells, water
from scenes import BONDED, LJ
from wrong_calls import answered

import minimd as md
from minimd.core.constraints.solver import ConstraintSolver
from minimd.core.structure.statistics import mean_and_error
from minimd.integrators import SPLITTINGS, Bath, State, Surroundings

SPARSE = md.LennardJones(1e-30, 0.01, 0.5, "force-shifted")
# rigid molecules in a Langevin bath. B. Leimkuhler, C. Matthews, Proc. R. Soc. A 472, 20160138 (2016)
TRIANGLE, SIDES = np.array([[0.0, 0.0, 0.0], [0.816, 0.577, 0.0], [-0.816, 0.577, 0.0]]), [[0, 1], [0, 2], [1, 2]]
MOLECULES = {
    "dumbbell": (np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), [1.0, 3.0], [[0, 1]], 0.1),
    "water": (TRIANGLE, [16.0, 1.0, 1.0], SIDES, 0.05),
    "triangle": (TRIANGLE, [1.0, 1.0, 1.0], SIDES, 0.1),
}


def kept(sim):
    return sim.engine.constraint_set.bonds.violation(sim.positions).max()


def test_energy_of_rigid_molecules_oscillates_with_the_square_of_the_timestep():
    start = dumbbells()
    start.equilibrate(200, 1.0)

    def oscillation(timestep):
        sim = md.Simulation(start.system, [BONDED], md.VelocityVerlet(timestep), start.constraints)
        return sim.run(round(0.4 / timestep), every=1).total_energy.std()

    assert np.log2(oscillation(0.002) / oscillation(0.001)) == pytest.approx(2.0, abs=0.1)  # truncation


@pytest.mark.parametrize("method", [one for one in SPLITTINGS.values() if one.is_symmetric], ids=lambda one: one.name)
def test_every_symmetric_splitting_runs_constrained_and_returns(method):
    sim = dumbbells(method=method(0.002))
    start = sim.positions.copy()
    sim.run(100)
    assert kept(sim) < 1e-13
    assert np.abs(sim.positions - start).max() > 0.1
    sim.velocities[:] *= -1.0
    sim.run(100)
    assert np.abs(sim.positions - start).max() < 1e-9  # rounding, amplified by the dynamics


def test_temperature_counts_what_is_left_of_wrapped_atoms_too():
    sim = dumbbells()
    sim.positions[::2, 0] += sim.system.cell.vectors[0, 0]
    sim.set_temperature(1.0, seed=2)
    record = sim.run(0)
    assert sim.n_dof == 3 * 64 - 32 - 3
    assert [record.temperature[0], 2.0 * record.kinetic_energy[0] / sim.n_dof] == pytest.approx([1.0, 1.0], rel=1e-12)


@pytest.mark.parametrize("method", [md.VelocityVerlet, md.PositionVerlet, md.Leapfrog])
def test_how_often_one_looks_and_wrapped_atoms_change_nothing(method):
    """Drifts with constraints are no flow: those of two steps are not merged where nobody looks."""
    often, seldom, wrapped = (dumbbells(method=method(0.002)) for _ in range(3))
    edges, rng = np.diagonal(often.system.cell.vectors), np.random.default_rng(3)
    wrap = lambda run: np.add(run.positions, rng.integers(-2, 3, (64, 3)) * edges, out=run.positions)  # noqa: E731
    often.run(100, every=1)
    seldom.run(100, every=100)
    assert wrapped.run(100, every=20, observers=[wrap]).constraint_violation.max() < 1e-12
    assert np.abs(often.positions - seldom.positions).max() < 1e-10  # rounding, amplified
    apart = wrapped.positions - seldom.positions
    assert np.abs(apart - np.round(apart / edges) * edges).max() < 1e-9  # rounding, amplified


def test_frames_and_reports_know_constraints_before_the_first_run_and_where_the_bonds_of_wrapped_atoms_are():
    sim = dumbbells()
    assert sim.frame().observables["pressure"] == pytest.approx(sim.run(0).pressure[0], rel=1e-9)
    sim.run(100, every=20)
    pressure, report = sim.frame().observables["pressure"], str(sim.report())
    sim.positions[::2, 0] += sim.system.cell.vectors[0, 0]
    assert sim.frame().observables["pressure"] == pytest.approx(pressure, rel=1e-9)  # rounding
    sim.positions[::2, 0] += sim.system.cell.vectors[0, 0]
    for text in (report, str(sim.report())):
        assert "NOT OBEYED" not in text
        assert "lengths        kept to" in text


def test_lengths_that_are_violated_at_the_start_are_put_right_with_a_warning():
    sim, system = dumbbells(md.DistanceConstraints(PAIRS, 0.48)), md.System([[0.2] * 3, [9.2, 0.2, 0.2]])
    with pytest.warns(UserWarning, match="relative errors were"):
        sim.run(1)
    assert kept(sim) < 1e-13
    system.cell = md.Cell.of(10.0)
    sim = md.Simulation(system, SPARSE, md.VelocityVerlet(0.001), md.DistanceConstraints([[0, 1]]))
    sim.run(1)
    sim.system.cell = md.Cell.of(10.5)
    with pytest.warns(UserWarning, match="relative errors were"):
        sim.run(1)
    assert sim.positions[0, 0] - sim.positions[1, 0] + 10.5 == pytest.approx(1.0, rel=1e-12)


def test_fixed_atoms_stay_and_may_overlap_and_the_report_promises_no_momentum():
    sim = dumbbells([md.DistanceConstraints(PAIRS), md.FixedAtoms([0, 5])])
    start = sim.positions.copy()
    sim.run(100, every=20)
    assert (sim.positions[[0, 5]] == start[[0, 5]]).all()
    assert np.abs(sim.positions - start).max() > 0.05
    assert "not a constant" in str(sim.report())
    for none in ([], np.zeros(64, dtype=bool)):
        sim = dumbbells(md.FixedAtoms(none))
        assert (sim.conserves_momentum, sim.n_dof) == (True, 3 * 64 - 3)
    positions = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [1.5, 0.0, 0.0]]
    sim = md.Simulation(md.System(positions), LJ, VERLET, md.FixedAtoms([0, 1]))
    sim.run(50)  # they overlap, but a force on an atom that does not move throws nothing across the scene
    assert (sim.positions[:2] == positions[:2]).all()
    assert abs(sim.positions[2, 0] - 1.5) > 1e-3
    with pytest.raises(md.NonFiniteError, match="the force on atom 1 would move it"):
        md.Simulation(md.System(positions), LJ, VERLET, md.FixedAtoms([0])).run(1)


def solver(pairs, lengths=None, x=cube()[0], inverse_masses=None, **options):  # noqa: B008
    weights = np.ones(len(x)) if inverse_masses is None else inverse_masses
    return ConstraintSolver(md.DistanceConstraints(pairs, lengths, **options), x, weights)


test_wrong_constraints_are_answered = answered(
    (lambda: solver([[0, 0]]), ValueError, "pairs", "[0, 0]"),
    (lambda: solver([[2, 1], [0, 1], [1, 0], [1, 2], [0, 1]]), ValueError, "pairs[0]", "[2, 1]"),  # as it is given
    (lambda: solver([[0, 1]], -1.0), ValueError, "lengths", "-1.0"),
    (lambda: solver([[0, 99]]), ValueError, "99"),
    (lambda: solver([[0, 1]], tolerance=1.0), ValueError, "tolerance", "1.0"),
    (lambda: solver([*cube()[1], [0, 7]]), ValueError, "follows from the other constraints", "atoms"),
    (lambda: solver([[0, 1]], inverse_masses=np.zeros(8)), ValueError, "(atoms 0-1)", "held fixed"),
    (lambda: solver([[0, 1], [1, 2], [0, 2]], [1.0, 1.0, 2.5], water(1)[0]), ValueError, "triangle", "[2, 1, 0]"),
    (lambda: dumbbells(md.FixedAtoms(np.ones(5, dtype=bool))), ValueError, "fixed atoms", "5 bools"),
    (lambda: dumbbells(md.FixedAtoms([-1])), ValueError, "fixed atoms", "[-1]"),
    (lambda: dumbbells([md.FixedAtoms([0]), "x"]), TypeError, "constraints"),
)


@pytest.mark.parametrize(("skew", "length"), [(0.0, 0.9), (0.7, 1.2), (0.7, 3.1)])
def test_bonds_longer_than_half_the_cell_turn_as_they_are(length, skew):
    """In a cell of edge 2, where another image comes nearer: beside the same bond in open space, wrapped or not."""
    cell, rng = np.array([[2.0, 0.0, 0.0], [skew, 2.0, 0.0], [skew, 0.3, 2.0]]), np.random.default_rng(1)
    positions, velocities = np.outer([0.0, length], [0.8, 0.6, 0.0]), np.outer([-1.0, 1.0], [-0.3, 0.4, 0.5])
    wrap, sims = lambda run: np.add(run.positions, rng.integers(-2, 3, (2, 3)) @ cell, out=run.positions), []
    for edges, observers in ((None, []), (cell, []), (cell, [wrap])):
        start = md.System(positions, velocities=velocities, cell=edges)
        sim = md.Simulation(start, SPARSE, md.VelocityVerlet(0.01), md.DistanceConstraints([[0, 1]], length))
        assert sim.run(200, every=7, observers=observers).constraint_violation.max() < 1e-12
        sim.run(20)
        sims.append(sim)
    free, plain, wrapped = sims
    assert np.abs(plain.positions - free.positions).max() < 1e-10  # rounding
    assert np.abs(wrapped.velocities - free.velocities).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("name", MOLECULES)
def test_free_rigid_molecules_have_the_temperature_of_the_bath_at_any_timestep(name):
    """All 3N − K degrees of freedom share it, translation and rotation each; a step is a tenth of a turn."""
    shape, masses, pairs, timestep = MOLECULES[name]
    n, size, mass = 2000, len(shape), sum(masses)
    pairs = (np.array(pairs) + size * np.arange(n)[:, None, None]).reshape(-1, 2)
    positions, m, shares = np.tile(shape, (n, 1)), np.tile(masses, n)[:, None], []
    bonds = ConstraintSolver(md.DistanceConstraints(pairs), positions, 1.0 / m[:, 0])
    velocities = np.random.default_rng(1).normal(size=positions.shape) / np.sqrt(m)
    bonds.project_velocities(velocities, positions)
    state, around = State(positions, velocities, np.zeros_like(positions), 1.0 / m[:, 0]), Surroundings(bonds, Bath())
    method = md.LangevinBAOAB(timestep, 1.0, friction=2.0, seed=3)
    for _ in range(200):
        method.advance(state, lambda state, with_energy: None, max(1, round(0.4 / timestep)), surroundings=around)
        translation = ((m * velocities).reshape(n, size, 3).sum(axis=1) ** 2).sum() / mass
        rotation = (m * velocities**2).sum() - translation
        shares.append([translation / (3 * n), rotation / (3 * size * n - bonds.n_constraints - 3 * n)])
    for values in np.array(shares[10:]).T:
        mean, error = mean_and_error(values)
        assert error < 0.003
        assert abs(mean - 1.0) < 4.0 * error  # statistics


def temperature_of_a_liquid_of_triangles(timestep, seed):
    """Mean and error of the kinetic temperature beside that of the bath: 64 rigid triangles of Lennard-Jones atoms."""
    positions = (1.85 * np.array(list(np.ndindex(4, 4, 4)))[:, None] + 0.6 * TRIANGLE).reshape(-1, 3)
    pairs = (np.array(SIDES) + 3 * np.arange(64)[:, None, None]).reshape(-1, 2)
    lj = md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="switched", bonded_scale=(0, 0, 0))
    bath, rigid = md.LangevinBAOAB(timestep, 1.0, friction=5.0, seed=seed), md.DistanceConstraints(pairs)
    sim = md.Simulation(md.System(positions, cell=7.4, bonds=pairs), lj, bath, rigid, threads=1)
    sim.set_temperature(1.0, seed)
    sim.equilibrate(round(10.0 / timestep), 1.0)
    return mean_and_error(sim.run(round(400.0 / timestep), every=round(0.04 / timestep)).temperature[1:])


@pytest.mark.slow
def test_the_temperature_of_interacting_molecules_is_off_by_the_square_of_the_timestep():
    """T(Δt) = T − c Δt², as for oscillators, where c is ω²/4: extrapolated from two steps it is that of the bath."""
    long, error_long = temperature_of_a_liquid_of_triangles(0.02, 1)
    short, error_short = temperature_of_a_liquid_of_triangles(0.01, 1)
    error = np.hypot(4.0 * error_short, error_long) / 3.0
    assert 1.0 - long > 6.0 * error_long
    assert (4.0 * short - long) / 3.0 == pytest.approx(1.0, abs=4.0 * error)  # statistics
    assert error < 0.004


@pytest.mark.parametrize("drifts", [1, 3])
def test_more_drifts_come_nearer_to_the_geodesic(drifts):
    """A rigid rotor turns by ωt; each drift over h turns it by arcsin ωh."""
    rod = md.System([[-0.5, 0, 0], [0.5, 0, 0]], velocities=[[0, -0.5, 0], [0, 0.5, 0]], bonds=[[0, 1]])
    method = md.LangevinBAOAB(0.2, 0.0, 0.0, 1, drifts=drifts)
    simulation = md.Simulation(rod, [], method, md.DistanceConstraints(rod.bonds))
    simulation.run(50, progress=False)
    x, y, _ = simulation.positions[1] - simulation.positions[0]
    late = (10.0 - np.arctan2(y, x) + np.pi) % (2.0 * np.pi) - np.pi
    n = 100 * drifts
    assert late == pytest.approx(10.0 - n * np.arcsin(10.0 / n), rel=1e-9)
    assert np.linalg.norm(simulation.velocities[1]) == pytest.approx(0.5, rel=1e-12)
