"""A whole simulation: what it conserves, in long runs too, how it follows changes, how it stops, and what it leaves."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from scenes import BONDED, LJ, SCENES, Scene
from scipy import stats
from wrong_calls import assert_answered

import minimd as md
from minimd.commands import main as cli
from minimd.core.diagnosis.report import conservation_report
from minimd.mdanalysis import diffusion_coefficient, radial_distribution

SMOOTH = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
EXAMPLES = Path(__file__).parents[2] / "examples"


def springs():
    """Pairs held by springs, in a cell; in each pair no other force."""
    return Scene(SCENES["dumbbells"]().system, [BONDED, md.HarmonicBond(300.0, 0.5)], timestep=0.002)


def pair(x, **options):
    return Scene(md.System([[0.0, 0, 0], [x, 0, 0]], **options), [LJ], timestep=0.001)


@pytest.mark.parametrize("scene", [SCENES["argon"], springs])
def test_wrapping_any_atom_at_any_step_changes_nothing(scene):
    plain, wrapped = scene().simulation(), scene().simulation()
    rng, cell = np.random.default_rng(8), plain.system.cell.vectors
    for _ in range(20):
        plain.run(10, every=10)
        wrapped.run(10, every=10)
        moved = rng.random(len(plain.system)) < 0.3
        wrapped.positions[moved] += rng.integers(-3, 4, (moved.sum(), 3)) @ cell
    away = (wrapped.positions - plain.positions) @ np.linalg.inv(cell)
    assert np.abs(away - np.rint(away)).max() < 1e-10
    assert np.abs(np.rint(away)).max() >= 1
    assert (plain.step, plain.time) == (200, pytest.approx(200 * plain.method.timestep))
    assert wrapped.record.total_energy == pytest.approx(plain.record.total_energy, rel=1e-11)


def test_set_temperature_is_exact_seeded_normal_and_without_momentum():
    masses = np.repeat([1.0, 16.0], 4000)
    system = md.System(np.random.default_rng(0).uniform(0, 100, (8000, 3)), masses=masses, cell=100.0)
    simulation, drawn = Scene(system, [LJ]).simulation(), []
    for seed in (5, 5, 8):
        simulation.set_temperature(2.0, seed=seed)
        drawn.append(simulation.velocities.copy())
    assert (np.array_equal(drawn[0], drawn[1]), np.allclose(drawn[0], drawn[2])) == (True, False)
    observed = simulation.frame().observables
    assert observed["temperature"] == pytest.approx(2.0, rel=1e-14)
    assert np.abs(observed["momentum"]).max() < 1e-13 * observed["absolute_momentum"]
    for mass in (1.0, 16.0):
        components = drawn[0][masses == mass].ravel() * np.sqrt(mass / 2.0)
        assert stats.kstest(components, "norm").pvalue > 0.01  # statistics, seed fixed


def test_rescaling_keeps_a_drift_unless_the_center_is_thermal(argon):
    drift, sim = [0.5, 0.0, -1.0], argon.simulation()
    sim.velocities[:] += drift
    sim.equilibrate(20, 1.3)
    assert (sim.step, sim.time, sim.temperature) == (0, 0.0, pytest.approx(1.3, rel=1e-12))
    assert sim.velocities.mean(axis=0) == pytest.approx(drift, abs=1e-13)  # rounding
    sim.velocities[:] = drift
    assert sim.temperature == 0.0
    assert_answered(lambda: sim.rescale_temperature(1.0), ValueError, "velocities")
    sim.method = md.LangevinBAOAB(0.002, 1.0, 1.0, seed=1)
    sim.rescale_temperature(1.0)
    assert sim.temperature == pytest.approx(1.0, rel=1e-12)
    assert sim.velocities[0, 2] == pytest.approx(-2.0 * sim.velocities[0, 0], rel=1e-12)


def test_another_method_is_checked_and_counts_its_degrees_of_freedom(argon):
    sim, n_atoms = argon.simulation(), len(argon.system)
    for wrong in (0.002, md.VelocityVerlet, None):
        assert_answered(lambda: setattr(sim, "method", wrong), TypeError, "method")
    assert sim.engine.surroundings.bath.n_dof == 3 * n_atoms - 3
    sim.method = md.LangevinBAOAB(0.002, 1.0, 1.0, 1)
    assert sim.n_dof == sim.engine.surroundings.bath.n_dof == 3 * n_atoms


@pytest.mark.parametrize("in_place", [True, False])
def test_another_time_step_leaves_the_time_before_it_as_it_was(argon, in_place):
    sim = argon.simulation(md.VelocityVerlet(0.004))
    sim.run(10)
    if in_place:
        sim.method.timestep = 0.001
    else:
        sim.method = md.VelocityVerlet(0.001)
    assert sim.time == pytest.approx(0.04, rel=1e-14)
    sim.run(5)
    assert sim.time == pytest.approx(0.045, rel=1e-14)
    sim.restore(sim.snapshot())
    assert sim.time == pytest.approx(0.045, rel=1e-14)


def test_simulation_works_on_a_copy_and_what_is_fixed_cannot_be_changed(argon):
    system, sim = argon.system, argon.simulation()
    before = system.positions.copy()
    sim.run(10)
    assert [np.array_equal(one.positions, before) for one in (system, sim)] == [True, False]
    fixed = system.masses, system.charges, system.bonds, system.species_index, system.cell.vectors, system.cell.lattice
    for array in fixed:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_what_is_assigned_to_positions_and_velocities_is_copied_into_their_arrays(argon):
    assigned, in_place = argon.simulation(), argon.simulation()
    rng, arrays = np.random.default_rng(5), (assigned.positions, assigned.velocities)
    positions, velocities = assigned.positions + rng.normal(scale=1e-3, size=(108, 3)), rng.normal(size=(108, 3))
    assigned.positions, assigned.velocities = positions, velocities.tolist()
    assert (assigned.positions is arrays[0], assigned.velocities is arrays[1]) == (True, True)
    in_place.positions[:], in_place.velocities[:] = positions, velocities
    positions[:] = 0.0  # no longer theirs
    for wrong in (velocities[1:], velocities.T, 1.0, "v", np.full((108, 3), np.nan), None):
        assert_answered(lambda wrong=wrong: setattr(assigned, "velocities", wrong), ValueError, "velocities")
    for sim in (assigned, in_place):
        sim.run(10, progress=False)
    assert np.array_equal(assigned.positions, in_place.positions)


def test_no_trajectory_is_no_file(argon, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert len(argon.simulation().run(4, every=2, trajectory=None, append="auto", progress=False)) == 3
    assert [*tmp_path.iterdir()] == []


def test_atoms_moved_by_anybody_are_seen_at_the_next_look_and_in_the_next_kick():
    simulation = pair(1.5).simulation()
    simulation.run(5, every=5)
    for x, looked in ((1.12, lambda: simulation.potential_energy), (1.3, lambda: simulation.run(0).potential_energy)):
        simulation.positions[:] = [[0, 0, 0], [x, 0, 0]]
        assert looked() == pytest.approx(md.evaluate(simulation.system, LJ).potential_energy, rel=1e-14)

    def push(sim):
        sim.positions[1, 0] = 1.2 if sim.step == 10 else sim.positions[1, 0]

    watched, twin = pair(1.5).simulation(), pair(1.5).simulation()
    watched.run(20, every=10, observers=[push])
    twin.run(10, every=10)
    push(twin)
    twin.run(10, every=10)
    assert np.array_equal(watched.positions, twin.positions)


@pytest.mark.parametrize("cells", [(None, 12.0), (12.0, None), (16.0, [12.0, 3.0, 3.0]), (12.0, [12.0, 12.0, 3.0])])
def test_forces_follow_a_cell_that_changes(cells, chain):
    """Open to periodic and back, below twice the cutoff, with bonds and exclusions."""
    parts, potentials = {"positions": chain.system.positions, "bonds": chain.system.bonds}, [BONDED, *chain.laws]
    changing = md.System(cell=cells[0], **parts)
    forces = md.Forces(changing, potentials)
    forces.compute(1)
    changing.cell = md.Cell.of(cells[1])
    sums = forces.compute(1)
    fresh = md.evaluate(md.System(cell=cells[1], **parts), potentials)
    assert sums.potential_energy == pytest.approx(fresh.potential_energy, rel=1e-12)
    assert sums.forces == pytest.approx(fresh.forces, rel=1e-11, abs=1e-11)


def test_blow_up_says_at_which_step_which_atoms_and_keeps_the_last_good_state():
    """Two fast atoms run into each other with a time step far too large."""
    positions = np.array([[0.0, 0, 0], [8.0, 0.05, 0], [4.0, 6.0, 6.0]])
    system = md.System(positions, velocities=[[10.0, 0, 0], [-10.0, 0, 0], [0, 0, 0]], cell=20.0)
    simulation, twin = (Scene(system, [LJ], timestep=0.05).simulation() for _ in range(2))
    shown = ["atoms 0 and 1", "timestep 0.05"]
    message = assert_answered(lambda: simulation.run(1000, every=100), md.NonFiniteError, *shown)
    assert f"At step {simulation.step + 1}:" in message
    assert 0 < simulation.step < 20
    assert np.abs([simulation.positions, simulation.velocities]).max() < 1e3  # and they are numbers
    expected = md.evaluate(simulation.system, LJ).potential_energy
    assert simulation.potential_energy == pytest.approx(expected, rel=1e-12)
    twin.run(simulation.step, every=1)
    assert simulation.positions == pytest.approx(twin.positions, abs=1e-9)


@pytest.mark.parametrize("method", [md.VelocityVerlet(0.004), md.PositionVerlet(0.004)])
def test_forces_are_those_of_the_present_state(argon, method):
    sim = argon.simulation(method)
    for move in (0.0, 0.01):
        sim.positions[0] += move
        expected = md.evaluate(sim.system, LJ).forces
        assert expected.any()
        np.testing.assert_allclose(sim.forces, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())  # rounding
    whole = md.Simulation(sim.system, LJ, method)
    for each, look in ((sim, True), (whole, False)):
        each.run(20, every=2, observers=[lambda sim: sim.forces.sum()] if look else [])
    np.testing.assert_array_equal(sim.positions, whole.positions)


@pytest.mark.parametrize("method", [md.VelocityVerlet(0.004), md.PositionVerlet(0.004)])
def test_looks_are_no_force_evaluations_of_the_steps(argon, method):
    counts = []
    for every in (1, 50):
        sim = argon.simulation(method)
        sim.run(50, every=every)
        counts.append(sim.report().cost.n_evaluations)
    assert counts[0] == counts[1]
    assert 50 <= counts[0] <= 51


def turned(vectors):
    """About no axis of coordinates."""
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    return vectors @ axes


@pytest.mark.parametrize("orientation", [np.asarray, turned])
@pytest.mark.parametrize(("n_flat", "times"), [(1, 1.5), (2, 3.0), (0, None)])
def test_atoms_in_a_plane_or_on_a_line_are_told(n_flat, times, orientation):
    generator = np.random.default_rng(1)
    places = 1.2 * np.array([*np.ndindex(4, 4 if n_flat < 2 else 1, 4 if n_flat < 1 else 1)], dtype=float)
    velocities = generator.normal(size=places.shape)
    velocities[:, 3 - n_flat :] = 0.0
    system = md.System(orientation(places), velocities=orientation(velocities - velocities.mean(axis=0)))
    sim = md.Simulation(system, LJ, md.VelocityVerlet(0.001))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim.run(10)
    told = [str(one.message) for one in caught if "lie and move" in str(one.message)]
    assert len(told) == bool(n_flat)
    kinetic = 0.5 * (sim.velocities**2).sum()
    assert sim.temperature == pytest.approx(2.0 * kinetic / (3 * len(system) - 3))
    if told:
        assert f" {times:g} times" in told[0]
        assert ("plane" if n_flat == 1 else "line") in told[0]


def test_atoms_that_leave_a_plane_are_not_told():
    places = 1.2 * np.array([*np.ndindex(4, 4, 1)], dtype=float)
    lifted = places + np.where(np.arange(16)[:, None] == 7, [0.0, 0.0, 0.01], 0.0)
    for positions, potentials in ((lifted, [LJ]), (places, [LJ, md.ConstantForce([0.0, 0.0, 1.0])])):
        velocities = np.random.default_rng(2).normal(size=(16, 3)) * [1.0, 1.0, 0.0]
        sim = md.Simulation(md.System(positions, velocities=velocities), potentials, md.VelocityVerlet(0.001))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            sim.run(10)
        assert not [one for one in caught if "lie and move" in str(one.message)]


def test_a_law_whose_energies_are_no_numbers_is_refused():
    broken = lambda r2, a: ((a - r2) ** 0.5, 0.0 if r2 > a else 1.0 / (a - r2) ** 0.5)  # noqa: E731
    law = md.PairPotential(broken, (4.0,), 3.0, "truncated")
    leaving = Scene(pair(1.5, velocities=[[1, 0, 0], [0, 0, 0]]).system, [law], timestep=0.01).simulation()
    assert_answered(lambda: leaving.run(200, every=1), md.NonFiniteError, "At step ", "potential energy")


def test_what_was_probably_forgotten_is_told():
    """Bonds, for a law that acts on them; constraints of a kind that is not given again."""
    fixed, held = md.FixedAtoms([2]), md.DistanceConstraints([[0, 1]])

    def made(given, law=LJ, constraints=None):
        atoms = md.System(np.diag([1.0, 0.0, 2.2]), **given)
        return md.Simulation(atoms, [LJ, law], md.VelocityVerlet(0.001), constraints)

    for law in (BONDED, md.HarmonicBond(1.0, 1.0)):
        with pytest.warns(UserWarning, match="bonds="):
            made({}, law)
    with pytest.warns(UserWarning, match=r"FixedAtoms\(1 atoms\) is lost"):
        made({"constraints": [fixed]}, LJ, [held])
    with warnings.catch_warnings(action="error"):
        made({"bonds": [[0, 1]]}, BONDED)
        for constraints in ([held, fixed], ()):
            made({"constraints": [fixed]}, LJ, constraints)


@pytest.mark.slow
def test_argon_is_rahmans(tmp_path):
    """D = 2.43e-5 cm²/s, first peak of g(r) at 3.7 Å, both by MDAnalysis from the file."""
    file = tmp_path / "argon.h5md"
    assert cli.main(["run", str(EXAMPLES / "argon.toml"), "--out", str(file), "--quiet"]) == 0
    g = radial_distribution(file)
    peak, diffusion = g.r[np.argmax(g.g)], diffusion_coefficient(file)
    print(f"peak of g(r) {peak:.3f} Å, {diffusion}")
    assert peak == pytest.approx(3.7, abs=0.1)
    assert diffusion.cm2_per_s == pytest.approx(2.43e-5, abs=0.25e-5)
    assert cli.main(["check", str(file)]) == 0


@pytest.mark.slow
def test_a_hundred_thousand_steps_conserve_energy_and_momentum():
    melt = md.Simulation(SCENES["melt"]().system, SMOOTH, md.VelocityVerlet(0.004))
    melt.equilibrate(1500, 1.44)
    melt.run(500)
    simulation = md.Simulation(melt.system, SMOOTH, md.VelocityVerlet(0.002))
    report = conservation_report(simulation.run(100_000, every=50), angular=False)
    print(report)
    assert abs(report.energy_drift.slope) < max(report.energy_drift.error, 1e-6)
    assert report.momentum_change < 1e-14
