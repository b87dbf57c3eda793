"""Minimization: known minima, ways out of overlaps, constraints kept, the rest left alone."""

import signal
from pathlib import Path

import numpy as np
import pytest
from references import melt_scene
from rigid_scenes import SCENES
from wrong_calls import answered, assert_answered

import minimd as md
from minimd.core.minimization.minimization import steer
from minimd.core.potentials.term import FORCES
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.errors import Interrupted
from minimd.scene import parse_scene, run_scene

slow = pytest.mark.slow
LJ = md.LennardJones(1.0, 1.0)
CUT = md.LennardJones(1.0, 1.0, cutoff=2.5, truncation="force-shifted")
EXCLUDING = md.LennardJones(1.0, 1.0, cutoff=2.5, truncation="force-shifted", bonded_scale=(0, 1, 1))
LJ13 = -44.326801  # D. J. Wales, J. P. K. Doye, J. Phys. Chem. A 101, 5111 (1997), table 1
LARGE_FORCE = 1e-6  # the default tolerance


def icosahedron(edge=1.1, seed=1):
    """13 atoms near their places."""
    phi = 0.5 * (1.0 + np.sqrt(5.0))
    corners = [p for s in (1.0, -1.0) for t in (phi, -phi) for p in ([0.0, s, t], [s, t, 0.0], [t, 0.0, s])]
    places = np.array([[0.0, 0.0, 0.0], *corners]) * edge / np.sqrt(1.0 + phi**2)
    return md.System(places + np.random.default_rng(seed).normal(0.0, 0.1, places.shape))


def random_liquid(n_atoms, density=0.8442, seed=1):
    """Atoms thrown into a cell without looking: some lie nearly upon each other."""
    edge = (n_atoms / density) ** (1.0 / 3.0)
    return md.System(np.random.default_rng(seed).uniform(0.0, edge, (n_atoms, 3)), cell=edge)


def bonded_pair(distance):
    return md.System([[0.0, 0.0, 0.0], [distance, 0.0, 0.0]], bonds=[[0, 1]])


def largest(forces):
    return np.linalg.norm(forces, axis=1).max()


def run_of(system, potentials):
    return md.Simulation(system, potentials, md.VelocityVerlet(0.001)).run(1)


@pytest.mark.parametrize("seed", range(3))
def test_thirteen_atoms_form_an_icosahedron_and_a_minimum_is_left_alone(seed):
    start = icosahedron(seed=seed)
    found = md.minimize(start, LJ)
    there, before = md.evaluate(found.system, LJ), md.evaluate(start, LJ)
    assert (found.converged, found.largest_force <= LARGE_FORCE) == (True, True)
    assert found.potential_energy == pytest.approx(LJ13, abs=5e-7)  # six decimals are published
    assert found.n_steps < 250  # what inertia buys
    told = found.potential_energy, found.potential_energy_before, found.largest_force, found.largest_force_before
    seen = there.potential_energy, before.potential_energy, largest(there.forces), largest(before.forces)
    assert told == pytest.approx(seen, rel=1e-12)  # rounding
    again = md.minimize(found.system, LJ)
    assert (again.n_steps, "converged after 0 steps" in str(again)) == (0, True)
    assert np.array_equal(again.system.positions, found.system.positions)


@pytest.mark.parametrize("distance", [0.3, 1e-1, 1e-3, 1e-15, 1e-24, 1e-100, 1.1, 2.0])
@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [0.36, 0.48, 0.8]])
def test_a_dimer_finds_its_length_from_anywhere(distance, direction):
    found = md.minimize(md.System([[0.0, 0.0, 0.0], distance * np.array(direction)], masses=[1.0, 50.0]), LJ)
    arm = np.diff(found.system.positions, axis=0)[0]
    assert (found.converged, found.n_steps < 300) == (True, True)
    assert found.potential_energy == pytest.approx(-1.0, abs=1e-13)  # a force of 1e-6 leaves (1e-6)²/2u″
    assert np.linalg.norm(arm) == pytest.approx(2 ** (1 / 6), abs=1e-7)
    np.testing.assert_allclose(arm / np.linalg.norm(arm), direction, atol=1e-12)


def test_velocities_turn_as_published():
    rng, timestep, mixing = np.random.default_rng(3), 0.1, 0.25
    for longest in (100.0, 0.01):
        velocities, forces = rng.standard_normal((2, 5, 3))
        kicked = velocities + timestep * forces
        expected = (1.0 - mixing) * kicked + mixing * np.linalg.norm(kicked) * forces / np.linalg.norm(forces)
        expected *= min(1.0, longest / (timestep * largest(expected)))
        steer(velocities, forces, timestep, mixing, longest)
        np.testing.assert_allclose(velocities, expected, rtol=1e-13)


def test_no_atom_moves_farther_than_allowed():
    """Half a step back where the way leads uphill."""
    for start, law in ((random_liquid(100), CUT), (bonded_pair(30.0), md.HarmonicBond(2.0, 1.0))):
        moves = []
        for n in (1, 2, 3, 10, 20, 30, 50, 100):
            ends = [md.minimize(start, law, max_steps=k, max_step_length=0.03).system.positions for k in (n - 1, n)]
            moves.append(largest(ends[1] - ends[0]))
        assert 0.03 - 1e-12 <= max(moves) <= 1.5 * 0.03 + 1e-12


def test_a_liquid_thrown_together_comes_to_rest_and_then_runs():
    found = md.minimize(random_liquid(300), CUT)
    assert found.converged
    assert found.potential_energy / 300 < -5.0 < 1e9 < found.potential_energy_before
    simulation = md.Simulation(found.system, CUT, md.VelocityVerlet(0.004))
    simulation.set_temperature(0.7, seed=1)
    record = simulation.run(200, every=10, progress=False)
    assert np.ptp(record.total_energy) / 300 < 1e-3  # truncation: ε per atom at Δt 0.004


def test_a_constant_force_is_followed_until_the_steps_are_used_up():
    pair = md.System([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    found = md.minimize(pair, md.ConstantForce([0.0, 0.0, -1.0]), max_steps=200)
    assert (found.converged, found.n_steps, np.ptp(found.system.positions[:, 2])) == (False, 200, 0.0)
    assert "not converged after 200 steps" in str(found)
    assert -20.0 <= found.system.positions[0, 2] < -10.0
    nothing = md.minimize(icosahedron(), LJ, max_steps=0)
    assert nothing.potential_energy == nothing.potential_energy_before


def test_masses_do_not_matter_and_fixed_atoms_stay_where_they_are():
    system, fixed = random_liquid(200), np.arange(0, 200, 10)
    heavy = md.System(system.positions, cell=system.cell, masses=np.geomspace(1.0, 300.0, 200))
    found, other = (md.minimize(one, CUT, md.FixedAtoms(fixed)) for one in (system, heavy))
    assert (found.converged, np.array_equal(found.system.positions, other.system.positions)) == (True, True)
    assert np.array_equal(found.system.positions[fixed], system.positions[fixed])
    forces = md.evaluate(found.system, CUT).forces
    assert largest(forces[fixed]) > 1.0
    assert largest(np.delete(forces, fixed, axis=0)) < LARGE_FORCE


def test_rigid_bonds_are_kept_and_take_the_forces_along_them():
    start = random_liquid(60, density=0.1)
    arms = np.random.default_rng(7).standard_normal((60, 3))
    arms *= 0.8 / np.linalg.norm(arms, axis=1)[:, None]
    positions = np.stack([start.positions, start.positions + arms], axis=1).reshape(-1, 3)
    pairs = np.arange(120).reshape(-1, 2)
    system = md.System(positions, cell=start.cell, bonds=pairs, masses=[1.0, 16.0] * 60)
    found = md.minimize(system, EXCLUDING, md.DistanceConstraints(pairs))
    assert found.converged
    bonds = found.system.positions[1::2] - found.system.positions[::2]
    assert np.abs(np.linalg.norm(bonds, axis=1) - 0.8).max() < 1e-10
    forces = md.evaluate(found.system, EXCLUDING).forces
    assert largest(forces) > 0.1
    assert np.abs(np.cross(bonds / 0.8, forces[1::2] - forces[::2])).max() < 4.0 * LARGE_FORCE
    assert np.abs(forces[1::2] + forces[::2]).max() < 4.0 * LARGE_FORCE
    assert found.potential_energy < found.potential_energy_before


@pytest.mark.parametrize("shape", ["water", *(pytest.param(one, marks=slow) for one in ("ring", "rod", "chain"))])
def test_constraints_of_any_shape_are_kept(shape):
    one, pairs, masses = SCENES[shape]
    positions, pairs = np.concatenate([one, one + np.array([0.7, 1.5, 1.2])]), np.concatenate([pairs, pairs + len(one)])
    velocities = np.random.default_rng(2).standard_normal(positions.shape)
    system = md.System(positions, masses=np.tile(masses, 2), bonds=pairs, velocities=velocities)
    found = md.minimize(system, EXCLUDING, md.DistanceConstraints(pairs), max_steps=1000)
    arrays = found.system.positions, positions, found.system.velocities
    bonds, before, turning = (each[pairs[:, 1]] - each[pairs[:, 0]] for each in arrays)
    np.testing.assert_allclose(np.linalg.norm(bonds, axis=1), np.linalg.norm(before, axis=1), rtol=1e-10)
    assert np.abs(np.einsum("ij,ij->i", bonds, turning)).max() < 1e-10
    assert found.potential_energy < found.potential_energy_before


@pytest.mark.parametrize("max_steps", [0, 1000])
def test_lengths_that_are_off_are_put_right(max_steps):
    """Those that are given; those of the start in a simulation, whatever it has become since."""
    system = md.System([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0], [0.0, 2.0, 0.0]], bonds=[[0, 1]])
    simulation = md.Simulation(system.copy(), EXCLUDING, md.VelocityVerlet(0.004), md.DistanceConstraints([[0, 1]]))
    simulation.positions[1] += [0.05, 0.0, 0.0]
    given = md.minimize(system, EXCLUDING, md.DistanceConstraints([[0, 1]], 0.5), max_steps=max_steps)
    for found, length in ((given, 0.5), (simulation.minimize(max_steps=max_steps), 0.7)):
        assert np.linalg.norm(np.diff(found.system.positions[:2], axis=0)) == pytest.approx(length, abs=1e-12)
        assert found.converged == (max_steps > 0)


@pytest.mark.parametrize("n_atoms", [2, 3, 13])
def test_atoms_on_one_spot_part_in_the_same_way_each_time(n_atoms):
    system = md.System(np.full((n_atoms, 3), 0.3))
    assert_answered(lambda: run_of(system, LJ), md.NonFiniteError, "minimize")
    found, again = md.minimize(system, LJ), md.minimize(system, LJ)
    assert found.converged
    assert np.array_equal(found.system.positions, again.system.positions)
    if n_atoms < 4:
        assert found.potential_energy == pytest.approx(-n_atoms * (n_atoms - 1) / 2, abs=1e-12)  # all pairs at 2^(1/6)
    else:  # 101 pairs are more than there are pushes; one pair is at two images of a place
        places = 1.5 * np.argwhere(np.ones((5, 5, 5)))[:101]
        pairs = md.System(np.concatenate([places, places]), cell=7.5)
        pairs.positions[150] += 7.5, 0.0, -7.5
        assert md.minimize(pairs, CUT, force_tolerance=1e-3).converged


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("n_chains", "n_beads"), [(4, 10), pytest.param(20, 50, marks=slow)])
def test_chains_that_cross_come_to_rest_without_breaking(n_chains, n_beads, seed):
    """Random walks thrown into a cell, as melts of Kremer and Grest begin."""
    rng, edge = np.random.default_rng(seed), (n_chains * n_beads / 0.85) ** (1.0 / 3.0)
    steps = rng.standard_normal((n_chains, n_beads, 3))
    steps *= 0.97 / np.linalg.norm(steps, axis=2, keepdims=True)
    steps[:, 0] = rng.uniform(0.0, edge, (n_chains, 3))
    atoms = np.arange(n_chains * n_beads).reshape(n_chains, n_beads)
    bonds = np.stack([atoms[:, :-1].ravel(), atoms[:, 1:].ravel()], axis=1)
    system = md.System(np.cumsum(steps, axis=1).reshape(-1, 3), cell=edge, bonds=bonds)
    repulsive = md.LennardJones(1.0, 1.0, 2 ** (1 / 6), bonded_scale=(0, 1, 1))
    found = md.minimize(system, [repulsive, md.FENEBond(30.0, 1.5)])
    assert found.converged
    assert largest(nearest_vectors(found.system.positions, system.cell, system.bonds)) < 1.5


def test_a_step_to_where_only_the_energy_has_no_number_is_taken_back(monkeypatch):
    """minimd's own have no finite force where they have no energy: they need it at the beginning and at the end."""
    # FENE as many write it: beyond R = 1.5 the energy is no number, but the force is one, and pushes
    without_wall = lambda r2: (-33.75 * np.log(1.0 - r2 / 2.25), -30.0 / (1.0 - r2 / 2.25))  # noqa: E731
    bonds, asked, compute = (md.FENEBond(30.0, 1.5), md.BondPotential(without_wall)), [], md.Forces.compute
    found = md.minimize(bonded_pair(0.2), [LJ, bonds[1]], max_step_length=5.0)
    assert found.converged
    assert 0.9 < np.linalg.norm(np.diff(found.system.positions, axis=0)) < 1.0
    noted = lambda self, detail=FORCES: asked.append(detail) or compute(self, detail)  # noqa: E731
    monkeypatch.setattr(md.Forces, "compute", noted)
    for bond in bonds:
        asked.clear()
        assert md.minimize(bonded_pair(1.2), [LJ, bond]).n_steps > 10
        assert sum(detail != FORCES for detail in asked) == (2 if bond is bonds[0] else len(asked))


BROKEN = md.System([[0.0, 0.0, 0.0], [1, 0, 0], [5, 0, 0], [5, 1.6, 0]], bonds=[[0, 1], [2, 3]])
CLOSE = md.System([[0.0, 0.0, 0.0], [1e-100, 0.0, 0.0]])
ENDLESS = md.PairPotential(lambda r2: (r2, r2 / (r2 - r2)), truncation="truncated")
CUT_SHORT = [{"force_tolerance": 0.0}, {"max_step_length": np.inf}, {"max_steps": -1}, {"max_steps": 2.5}]
test_what_cannot_be_minimized_is_named = answered(
    *(
        (lambda call=call: call(BROKEN, [LJ, md.FENEBond(30.0, 1.5)]), md.NonFiniteError, "FENEBond", "2 and 3, 1.6")
        for call in (md.evaluate, md.minimize, md.advise_timestep, run_of)  # not the closest pair
    ),
    (lambda: md.minimize(CLOSE, LJ, md.FixedAtoms([0, 1])), md.NonFiniteError, "atoms 0 and 1", "constraints hold"),
    (lambda: md.minimize(bonded_pair(1.0), ENDLESS), md.NonFiniteError, "finite"),
    *((lambda more=more: md.minimize(BROKEN, LJ, **more), ValueError, *map(str, *more.items())) for more in CUT_SHORT),
    (lambda: run_of(icosahedron(1e-3), CUT), md.NonFiniteError, "minimize"),
)


def interrupting(monkeypatch, n_evaluations):
    compute, calls = md.Forces.compute, iter(range(1, 10**6))

    def stopping(forces, *arguments):
        if next(calls) == n_evaluations:
            signal.raise_signal(signal.SIGINT)
        return compute(forces, *arguments)

    monkeypatch.setattr(md.Forces, "compute", stopping)


def test_ctrl_c_ends_after_a_step_with_all_that_was_reached(monkeypatch):
    interrupting(monkeypatch, 60)
    with pytest.raises(Interrupted, match="stopped after step") as caught:
        md.minimize(icosahedron(), LJ)
    result = caught.value.result
    assert (10 < result.n_steps < 60, result.converged) == (True, False)
    assert result.potential_energy == pytest.approx(md.evaluate(result.system, LJ).potential_energy, rel=1e-14)
    assert result.potential_energy < result.potential_energy_before


def test_a_simulation_minimizes_in_place():
    simulation = md.Simulation(random_liquid(200), CUT, md.VelocityVerlet(0.004))
    simulation.velocities[:] = 0.1 * np.random.default_rng(2).standard_normal((200, 3))
    velocities, simulation.step, simulation.time = simulation.velocities.copy(), 7, 0.035
    result = simulation.minimize(force_tolerance=1e-3)
    assert (result.converged, result.system, simulation.step, simulation.time) == (True, simulation.system, 7, 0.035)
    assert np.array_equal(simulation.velocities, velocities)
    assert simulation.frame().observables["potential_energy"] == pytest.approx(result.potential_energy, rel=1e-14)


def test_a_scene_minimizes_first_and_writes_nothing_if_it_is_interrupted(tmp_path, monkeypatch):
    text = melt_scene(2, 20, "seed = 3\n[minimization]\nmax_steps = 3\n[output]\nevery = 5\n")
    cold, told = text.replace("temperature = 1.44\n", ""), []
    run_scene(parse_scene(cold, Path("scene.toml")), trajectory=tmp_path / "a.h5md", tell=told.append)
    assert any("minimization" in line and "steps" in line for line in told)
    wrong = text.replace("max_steps = 3", "force_tolerance = -1.0")
    assert_answered(lambda: parse_scene(wrong, Path("scene.toml")), ValueError, "minimization.force_tolerance", "-1.0")
    interrupting(monkeypatch, 3)
    endless = parse_scene(text.replace("max_steps = 3", "force_tolerance = 1e-20"), Path("scene.toml"))
    with pytest.raises(KeyboardInterrupt, match="of the minimization; nothing was written"):
        run_scene(endless, trajectory=tmp_path / "b.h5md", tell=lambda line: None)
    assert not (tmp_path / "b.h5md").exists()
