"""Minimization: known minima, ways out of overlaps, constraints kept, the rest left alone."""

import signal
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize
from references import melt_scene
from rigid_scenes import SCENES

import minimd as md
from minimd.forces.forces import Forces
from minimd.minimization.fire import steer
from minimd.potentials.term import FORCES, TOTALS
from minimd.scene import parse_scene, run_scene
from minimd.structure.errors import Interrupted
from minimd.structure.images import nearest_vectors
from minimd.structure.lattice import crystal

LJ = md.LennardJones(1.0, 1.0)
CUT = md.LennardJones(1.0, 1.0, cutoff=2.5, truncation="force-shifted")
LJ13 = -44.326801  # D. J. Wales, J. P. K. Doye, J. Phys. Chem. A 101, 5111 (1997), table 1
LARGE_FORCE = 1e-6  # the default tolerance


def icosahedron(edge=1.1):
    phi = 0.5 * (1.0 + np.sqrt(5.0))
    corners = [p for s in (1.0, -1.0) for t in (phi, -phi) for p in ([0.0, s, t], [s, t, 0.0], [t, 0.0, s])]
    return np.array([[0.0, 0.0, 0.0], *corners]) * edge / np.sqrt(1.0 + phi**2)


def shaken(positions, width=0.1, seed=1):
    return positions + np.random.default_rng(seed).normal(0.0, width, positions.shape)


def random_liquid(n_atoms, density=0.8442, seed=1):
    """Atoms thrown into a cell without looking: some lie nearly upon each other."""
    edge = (n_atoms / density) ** (1.0 / 3.0)
    return md.System(np.random.default_rng(seed).uniform(0.0, edge, (n_atoms, 3)), cell=edge)


def ran(system, potentials):
    return md.Simulation(system, potentials, md.VelocityVerlet(0.001)).run(1)


@pytest.mark.parametrize("seed", range(3))
def test_thirteen_atoms_form_an_icosahedron(seed):
    found = md.minimize(md.System(shaken(icosahedron(), seed=seed)), LJ)
    assert found.converged
    assert found.largest_force <= LARGE_FORCE
    assert found.potential_energy == pytest.approx(LJ13, abs=5e-7)  # six decimals are published
    assert found.n_steps < 250  # what inertia buys


def test_energy_and_forces_are_those_of_the_system_returned():
    start = md.System(shaken(icosahedron()))
    found = md.minimize(start, LJ)
    there, before = md.evaluate(found.system, LJ), md.evaluate(start, LJ)
    assert found.potential_energy == pytest.approx(there.potential_energy, rel=1e-14)  # rounding
    assert found.potential_energy_before == pytest.approx(before.potential_energy, rel=1e-14)
    assert found.largest_force == pytest.approx(np.linalg.norm(there.forces, axis=1).max(), rel=1e-12)  # rounding
    assert found.largest_force_before == pytest.approx(np.linalg.norm(before.forces, axis=1).max(), rel=1e-12)
    assert 100 < found.n_evaluations < 400


def test_the_minimum_is_the_one_that_scipy_finds():
    start = md.System(shaken(crystal("fcc", [3, 3, 3], 1.6)[0], 0.05), cell=4.8)
    there = start.copy()
    forces = Forces(there, CUT)

    def energy_and_gradient(x):
        there.positions[:] = x.reshape(-1, 3)
        forces.compute(TOTALS)
        return forces.potential_energy, -forces.forces.ravel()

    reference = scipy.optimize.minimize(
        energy_and_gradient, start.positions.ravel(), jac=True, method="L-BFGS-B", options={"gtol": 1e-8, "ftol": 0.0}
    )
    found = md.minimize(start, CUT, force_tolerance=1e-8)
    assert found.converged
    assert found.potential_energy == pytest.approx(reference.fun, abs=1e-10)
    assert found.potential_energy < found.potential_energy_before - 10.0


@pytest.mark.parametrize("distance", [0.3, 1e-1, 1e-3, 1e-15, 1e-24, 1e-100, 1.1, 2.0])
@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [0.36, 0.48, 0.8]])
def test_a_dimer_finds_its_length_from_anywhere(distance, direction):
    start = md.System([[0.0, 0.0, 0.0], distance * np.array(direction)], masses=[1.0, 50.0])
    found = md.minimize(start, LJ)
    arm = found.system.positions[1] - found.system.positions[0]
    assert found.converged
    assert found.potential_energy == pytest.approx(-1.0, abs=1e-13)  # a force of 1e-6 leaves (1e-6)²/2u″
    assert np.linalg.norm(arm) == pytest.approx(2 ** (1 / 6), abs=1e-7)
    np.testing.assert_allclose(arm / np.linalg.norm(arm), direction, atol=1e-12)
    assert found.n_steps < 300


@pytest.mark.parametrize("longest", [100.0, 0.01])
def test_velocities_turn_as_published(longest):
    rng = np.random.default_rng(3)
    velocities, forces, timestep, mixing = rng.standard_normal((5, 3)), rng.standard_normal((5, 3)), 0.1, 0.25
    kicked = velocities + timestep * forces
    expected = (1.0 - mixing) * kicked + mixing * np.linalg.norm(kicked) * forces / np.linalg.norm(forces)
    expected *= min(1.0, longest / (timestep * np.linalg.norm(expected, axis=1).max()))
    steer(velocities, forces, timestep, mixing, longest)
    np.testing.assert_allclose(velocities, expected, rtol=1e-13)


@pytest.mark.parametrize("scene", ["overlaps", "far from home"])
def test_no_atom_moves_farther_than_allowed(scene):
    far = md.System([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]], bonds=[[0, 1]])
    start, law = (random_liquid(100), CUT) if scene == "overlaps" else (far, md.HarmonicBond(2.0, 1.0))
    longest = []
    for n_steps in (1, 2, 3, 10, 20, 30, 50, 100):
        here, there = (
            md.minimize(start, law, max_steps=n, max_step_length=0.03).system.positions for n in (n_steps - 1, n_steps)
        )
        longest.append(np.linalg.norm(there - here, axis=1).max())
    assert max(longest) <= 1.5 * 0.03 + 1e-12  # half a step back where the way leads uphill
    assert max(longest) >= 0.03 - 1e-12


def test_a_liquid_thrown_together_comes_to_rest_and_then_runs():
    start = random_liquid(500)
    found = md.minimize(start, CUT)
    assert found.converged
    assert found.potential_energy_before > 1e9
    assert found.potential_energy / 500 < -5.0
    assert np.isfinite(found.system.positions).all()
    simulation = md.Simulation(found.system, CUT, md.VelocityVerlet(0.004))
    simulation.set_temperature(0.7, seed=1)
    record = simulation.run(500, every=10)
    assert np.ptp(record.total_energy) / 500 < 1e-3  # truncation: ε per atom at Δt 0.004


class Field:
    """A constant force, without curvature and without a minimum."""

    def bind(self, _system):
        return self

    def add(self, system, _detail, forces, energies, _virials):
        forces[:, 2] -= 1.0
        energies += system.positions[:, 2]

    def skipped(self):
        return ()


def test_a_constant_force_is_followed_until_the_steps_are_used_up():
    found = md.minimize(md.System([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]), Field(), max_steps=200)
    assert not found.converged
    assert np.ptp(found.system.positions[:, 2]) == 0.0
    assert -20.0 <= found.system.positions[0, 2] < -10.0


def test_masses_do_not_matter():
    positions, edges = crystal("fcc", [4, 4, 4], 1.6)
    light, heavy = (
        md.System(shaken(positions), cell=edges, masses=masses) for masses in (1.0, np.geomspace(1.0, 300.0, 256))
    )
    one, other = (md.minimize(system, CUT) for system in (light, heavy))
    assert np.array_equal(one.system.positions, other.system.positions)


def test_rigid_bonds_are_kept():
    start = random_liquid(60, density=0.1)
    arms = np.random.default_rng(7).standard_normal((60, 3))
    arms *= 0.8 / np.linalg.norm(arms, axis=1)[:, None]
    positions = np.stack([start.positions, start.positions + arms], axis=1).reshape(-1, 3)
    pairs = np.arange(120).reshape(-1, 2)
    system = md.System(positions, cell=start.cell, bonds=pairs, masses=[1.0, 16.0] * 60)
    law = md.LennardJones(1.0, 1.0, cutoff=2.5, truncation="smooth", bonded_scale=(0, 1, 1))
    found = md.minimize(system, law, md.DistanceConstraints(pairs))
    assert found.converged
    bonds = found.system.positions[1::2] - found.system.positions[::2]
    assert np.abs(np.linalg.norm(bonds, axis=1) - 0.8).max() < 1e-10
    forces = md.evaluate(found.system, law).forces
    assert np.linalg.norm(forces, axis=1).max() > 0.1  # along the bonds, which take it
    directions = bonds / 0.8
    torques = np.cross(directions, forces[1::2] - forces[::2])
    assert np.abs(torques).max() < 4.0 * LARGE_FORCE
    assert np.abs(forces[1::2] + forces[::2]).max() < 4.0 * LARGE_FORCE
    assert found.potential_energy < found.potential_energy_before


@pytest.mark.parametrize("shape", ["chain", "water", "ring", "rod"])
def test_constraints_of_any_shape_are_kept(shape):
    one, pairs, masses = SCENES[shape]
    positions, pairs = np.concatenate([one, one + np.array([0.7, 1.5, 1.2])]), np.concatenate([pairs, pairs + len(one)])
    velocities = np.random.default_rng(2).standard_normal(positions.shape)
    system = md.System(positions, masses=np.tile(masses, 2), bonds=pairs, velocities=velocities)
    law = md.LennardJones(1.0, 1.0, bonded_scale=(0, 0, 1) if shape in ("water", "rod") else (0, 1, 1))
    found = md.minimize(system, law, md.DistanceConstraints(pairs), max_steps=1000)
    bonds, before = (each[pairs[:, 1]] - each[pairs[:, 0]] for each in (found.system.positions, positions))
    lengths, lengths_before = np.linalg.norm(bonds, axis=1), np.linalg.norm(before, axis=1)
    np.testing.assert_allclose(lengths, lengths_before, rtol=1e-10)
    turning = found.system.velocities[pairs[:, 1]] - found.system.velocities[pairs[:, 0]]
    assert np.abs(np.einsum("ij,ij->i", bonds, turning)).max() < 1e-10
    assert found.potential_energy < found.potential_energy_before


@pytest.mark.parametrize("max_steps", [0, 1000])
def test_lengths_that_are_off_are_put_right(max_steps):
    system = md.System([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0], [0.0, 3.0, 0.0]], bonds=[[0, 1]])
    law = md.LennardJones(1.0, 1.0, bonded_scale=(0, 1, 1))
    found = md.minimize(system, law, md.DistanceConstraints([[0, 1]], 0.5), max_steps=max_steps)
    assert np.linalg.norm(found.system.positions[1] - found.system.positions[0]) == pytest.approx(0.5, abs=1e-12)
    assert found.converged == (max_steps > 0)


def test_fixed_atoms_stay_where_they_are():
    system = random_liquid(200)
    fixed = np.arange(0, 200, 10)
    found = md.minimize(system, CUT, md.FixedAtoms(fixed))
    assert found.converged
    assert np.array_equal(found.system.positions[fixed], system.positions[fixed])
    forces = np.linalg.norm(md.evaluate(found.system, CUT).forces, axis=1)
    assert forces[fixed].max() > 1.0
    assert np.delete(forces, fixed).max() < LARGE_FORCE


@pytest.mark.parametrize("n_atoms", [2, 3, 13])
def test_atoms_on_one_spot_part_in_the_same_way_each_time(n_atoms):
    system = md.System(np.full((n_atoms, 3), 0.3))
    with pytest.raises(md.NonFiniteError, match="minimize moves"):
        md.Simulation(system, LJ, md.VelocityVerlet(0.004)).run(1)
    found, again = md.minimize(system, LJ), md.minimize(system, LJ)
    assert found.converged
    assert np.array_equal(found.system.positions, again.system.positions)
    if n_atoms < 4:
        assert found.potential_energy == pytest.approx(-n_atoms * (n_atoms - 1) / 2, abs=1e-12)  # all pairs at 2^(1/6)


def test_any_number_of_pairs_on_one_spot_part():
    """101 is more than there are pushes; one pair is at two images of a place."""
    places = 1.5 * np.argwhere(np.ones((5, 5, 5)))[:101]
    system = md.System(np.concatenate([places, places]), cell=7.5)
    system.positions[150] += 7.5, 0.0, -7.5
    assert md.minimize(system, CUT, force_tolerance=1e-3).converged


def melt(n_chains, n_beads, seed):
    """Random walks thrown into a cell, as melts of Kremer and Grest begin."""
    rng, edge = np.random.default_rng(seed), (n_chains * n_beads / 0.85) ** (1.0 / 3.0)
    steps = rng.standard_normal((n_chains, n_beads, 3))
    steps *= 0.97 / np.linalg.norm(steps, axis=2, keepdims=True)
    steps[:, 0] = rng.uniform(0.0, edge, (n_chains, 3))
    atoms = np.arange(n_chains * n_beads).reshape(n_chains, n_beads)
    bonds = np.stack([atoms[:, :-1].ravel(), atoms[:, 1:].ravel()], axis=1)
    return md.System(np.cumsum(steps, axis=1).reshape(-1, 3), cell=edge, bonds=bonds)


WCA = md.LennardJones(1.0, 1.0, cutoff=2 ** (1 / 6), bonded_scale=(0, 1, 1))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("n_chains", "n_beads"), [(4, 10), pytest.param(20, 50, marks=pytest.mark.slow)])
def test_chains_that_cross_come_to_rest_without_breaking(n_chains, n_beads, seed):
    system = melt(n_chains, n_beads, seed)
    found = md.minimize(system, [WCA, md.FENEBond(30.0, 1.5)])
    assert found.converged
    arms = nearest_vectors(found.system.positions, system.cell, system.bonds)
    assert np.linalg.norm(arms, axis=1).max() < 1.5


def without_wall(r2):
    """FENE as many write it: beyond R = 1.5 the energy is no number, but the force is one, and pushes."""
    return -0.5 * 30.0 * 2.25 * np.log(1.0 - r2 / 2.25), -30.0 / (1.0 - r2 / 2.25)


def test_a_step_to_where_only_the_energy_has_no_number_is_taken_back():
    system = md.System([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]], bonds=[[0, 1]])
    found = md.minimize(system, [md.LennardJones(1.0, 1.0), md.BondPotential(without_wall)], max_step_length=5.0)
    assert found.converged
    assert 0.9 < np.linalg.norm(np.diff(found.system.positions, axis=0)) < 1.0


@pytest.mark.parametrize(
    ("bond", "is_users"), [(md.FENEBond(30.0, 1.5), False), (md.BondPotential(without_wall), True)]
)
def test_only_laws_of_the_user_need_the_energy_at_each_step(bond, is_users, monkeypatch):
    """minimd's own have no finite force where they have no energy."""
    details, compute = [], Forces.compute
    monkeypatch.setattr(
        Forces, "compute", lambda forces, detail=FORCES: details.append(detail) or compute(forces, detail)
    )
    found = md.minimize(md.System([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0]], bonds=[[0, 1]]), [LJ, bond])
    n_asked = sum(detail != FORCES for detail in details)
    assert found.n_steps > 10
    assert n_asked == (len(details) if is_users else 2)  # at the beginning and at the end


@pytest.mark.parametrize("call", [md.evaluate, md.minimize, md.advise_timestep, ran])
def test_what_has_no_number_is_named_not_the_closest_pair(call):
    system = md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 1.6, 0.0]], bonds=[[0, 1], [2, 3]])
    with pytest.raises(md.NonFiniteError, match=r"FENEBond.* atoms 2 and 3, 1\.6 .*R = 1\.5"):
        call(system, [md.LennardJones(1.0, 1.0), md.FENEBond(30.0, 1.5)])


def test_fixed_atoms_too_close_are_refused():
    system = md.System([[0.0, 0.0, 0.0], [1e-100, 0.0, 0.0]])
    with pytest.raises(md.NonFiniteError, match=r"atoms 0 and 1, .* constraints hold"):
        md.minimize(system, LJ, md.FixedAtoms([0, 1]))


def test_forces_that_are_not_finite_for_another_reason_are_refused():
    def broken(r2):
        return r2, r2 / (r2 - r2)

    with pytest.raises((md.NonFiniteError, ValueError), match="finite"):
        md.minimize(md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), md.PairPotential(broken))


def test_a_search_that_is_cut_short_says_so():
    found = md.minimize(md.System(shaken(icosahedron())), LJ, max_steps=5)
    assert not found.converged
    assert found.n_steps == 5
    assert "not converged after 5 steps" in str(found)
    nothing = md.minimize(md.System(shaken(icosahedron())), LJ, max_steps=0)
    assert nothing.potential_energy == nothing.potential_energy_before


def test_a_minimum_is_left_alone():
    found = md.minimize(md.System(shaken(icosahedron())), LJ)
    again = md.minimize(found.system, LJ)
    assert again.n_steps == 0
    assert again.converged
    assert np.array_equal(again.system.positions, found.system.positions)
    assert "converged after 0 steps" in str(again)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"force_tolerance": 0.0}, "force_tolerance must be positive and finite"),
        ({"max_step_length": np.inf}, "max_step_length must be positive and finite"),
        ({"max_steps": -1}, "max_steps must be a whole number"),
        ({"max_steps": 2.5}, "max_steps must be a whole number"),
    ],
)
def test_choices_out_of_range_are_refused(choice, message):
    with pytest.raises(ValueError, match=message):
        md.minimize(md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), LJ, **choice)


def interrupting(monkeypatch, n_evaluations):
    compute, calls = Forces.compute, []

    def stopping(forces, *arguments):
        calls.append(1)
        if len(calls) == n_evaluations:
            signal.raise_signal(signal.SIGINT)
        return compute(forces, *arguments)

    monkeypatch.setattr(Forces, "compute", stopping)


def test_ctrl_c_ends_after_a_step_with_all_that_was_reached(monkeypatch):
    interrupting(monkeypatch, 60)
    with pytest.raises(KeyboardInterrupt, match="stopped after step") as caught:
        md.minimize(md.System(shaken(icosahedron())), LJ)
    assert isinstance(caught.value, Interrupted)
    result = caught.value.result
    assert 10 < result.n_steps < 60
    assert not result.converged
    assert result.potential_energy == pytest.approx(md.evaluate(result.system, LJ).potential_energy, rel=1e-14)
    assert result.potential_energy < result.potential_energy_before


def test_a_simulation_minimizes_in_place():
    system = md.System(shaken(icosahedron(0.6)), cell=20.0)
    with pytest.raises(md.NonFiniteError, match="minimize moves atoms apart"):
        md.Simulation(system, CUT, md.VelocityVerlet(0.05)).run(100)
    simulation = md.Simulation(system, CUT, md.VelocityVerlet(0.005))
    simulation.set_temperature(0.1, seed=1)
    velocities = simulation.velocities.copy()
    simulation.step, simulation.time = 7, 0.035
    result = simulation.minimize()
    assert result.converged
    assert result.system is simulation.system
    assert (simulation.step, simulation.time) == (7, 0.035)
    assert np.array_equal(simulation.velocities, velocities)
    assert simulation.frame().observables["potential_energy"] == pytest.approx(result.potential_energy, rel=1e-14)
    record = simulation.run(500, every=10)
    assert np.ptp(record.total_energy) < 1e-3  # truncation


def test_a_simulation_in_mixed_precision_minimizes_too():
    simulation = md.Simulation(random_liquid(500), CUT, md.VelocityVerlet(0.004), precision="mixed")
    assert simulation.minimize(force_tolerance=1e-3).converged


def test_a_simulation_minimizes_with_its_lengths():
    """Those of its start, whatever it has become since."""
    system = md.System([[0.0, 0.0, 0.0], [0.9, 0.0, 0.0], [0.4, 1.2, 0.0]], bonds=[[0, 1]])
    law = md.LennardJones(1.0, 1.0, bonded_scale=(0, 1, 1))
    simulation = md.Simulation(system, law, md.VelocityVerlet(0.004), md.DistanceConstraints([[0, 1]]))
    simulation.positions[1] += [0.05, 0.0, 0.0]
    simulation.minimize()
    assert np.linalg.norm(simulation.positions[1] - simulation.positions[0]) == pytest.approx(0.9, abs=1e-12)


def test_a_scene_minimizes_first(tmp_path):
    text = melt_scene(2, 20, "seed = 3\n[minimization]\nmax_steps = 3\n[output]\nevery = 5\n").replace(
        "temperature = 1.44\n", ""
    )
    told = []
    run_scene(parse_scene(text, Path("scene.toml")), trajectory=tmp_path / "a.h5md", tell=told.append)
    assert any("minimization" in line and "steps" in line for line in told)
    with pytest.raises(ValueError, match=r"minimization\.force_tolerance"):
        parse_scene(text.replace("max_steps = 3", "force_tolerance = -1.0"), Path("scene.toml"))


def test_an_interrupted_minimization_of_a_scene_has_written_nothing(tmp_path, monkeypatch):
    text = melt_scene(2, 20, "seed = 3\n[minimization]\nforce_tolerance = 1e-20\n[output]\nevery = 5\n")
    interrupting(monkeypatch, 3)
    with pytest.raises(KeyboardInterrupt, match="of the minimization; nothing was written"):
        run_scene(parse_scene(text, Path("scene.toml")), trajectory=tmp_path / "a.h5md", tell=lambda line: None)
    assert not (tmp_path / "a.h5md").exists()
