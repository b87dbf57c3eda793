"""Each atom has its share of the degrees of freedom: the shares add up to their number, and the heat to the bath's."""

import warnings

import numpy as np
import pytest

import minimd as md
from minimd.core.constraints.constraint_set import ConstraintSet

RNG = np.random.default_rng(5)
MASSES = RNG.uniform(1.0, 30.0, 12)
PLACES = RNG.normal(size=(12, 3))
CUBE = np.array([*np.ndindex(2, 2, 2)], dtype=float)
TETRAHEDRON = CUBE[[0, 3, 5, 6]]
LINE = np.outer([0.0, 1.1, 2.3], [0.36, 0.48, 0.8])
WATER = np.array([[0.0, 0.0, 0.0], [0.8, 0.6, 0.0], [-0.8, 0.6, 0.0]])
WATER_MASSES, FULL = [16.0, 1.0, 1.0], [(0, 1), (0, 2), (1, 2)]
GRAPHS = {  # positions, masses, pairs
    "no constraint": (PLACES, MASSES, []),
    "dumbbells beside atoms": (PLACES, MASSES, [(0, 1), (2, 3)]),
    "chain": (PLACES, MASSES, [(k, k + 1) for k in range(9)]),
    "ring": (PLACES, MASSES, [(k, (k + 1) % 6) for k in range(6)]),
    "star": (PLACES, MASSES, [(0, k) for k in range(1, 5)]),
    "tree": (PLACES, MASSES, [(0, 1), (0, 2), (1, 3), (1, 4), (2, 5)]),
    "line": (LINE, MASSES[:3], FULL),
    "water": (WATER, WATER_MASSES, FULL),
    "water among others": (np.concatenate([WATER, 5.0 + PLACES]), [*WATER_MASSES, *MASSES], FULL),
    "scalene triangle": (PLACES, MASSES, FULL),
    "rigid body": (TETRAHEDRON, MASSES[:4], [*FULL, (0, 3), (1, 3), (2, 3)]),
    "dumbbell": (PLACES[:2], MASSES[:2], [(0, 1)]),
}
FIXED = {"none": [], "one": [0], "some": [0, 5, 11]}


def constraints_of(pairs, fixed, n_atoms):
    held = np.array([atom for atom in fixed if atom < n_atoms], dtype=int)
    pairs = [pair for pair in pairs if not {*pair} <= {*held.tolist()}]
    distances = [md.DistanceConstraints(pairs)] if pairs else []
    return distances + [md.FixedAtoms(held)] * bool(held.size)


def gradients_of(system, constraint_set):
    """The gradients of constraints and fixed atoms, (K, 3N), in coordinates √m r."""
    bonds, roots = constraint_set.bonds, np.sqrt(system.masses)
    fixed, unit = np.flatnonzero(constraint_set.inverse_masses == 0.0), np.eye(3 * len(roots))
    rows = [unit[3 * i + k] for i in fixed for k in range(3)]
    pairs = np.zeros((0, 2), int) if bonds is None else bonds.pairs
    arms = [] if bonds is None else bonds.bonds(system.positions)
    for (i, j), arm in zip(pairs, arms, strict=True):
        row = np.zeros((len(roots), 3))
        row[i], row[j] = -arm / roots[i], arm / roots[j]
        rows.append(row.ravel())
    return np.array(rows).reshape(-1, 3 * len(roots))


@pytest.mark.parametrize("conserves", [True, False], ids=["center at rest", "center moves"])
@pytest.mark.parametrize("fixed", FIXED)
@pytest.mark.parametrize("graph", GRAPHS)
def test_the_shares_of_all_atoms_add_up_to_the_degrees_of_freedom(graph, fixed, conserves):
    positions, masses, pairs = GRAPHS[graph]
    if fixed != "none" and graph in {"line", "dumbbell", "rigid body"}:
        pytest.skip("other constraints than those of the graph")
    system = md.System(positions, masses=masses)
    constraint_set = ConstraintSet(system, constraints_of(pairs, FIXED[fixed], len(positions)))
    shares = constraint_set.shares(system.positions, conserves)
    assert shares.sum() == pytest.approx(constraint_set.degrees_of_freedom(conserves), abs=1e-9)  # rounding
    assert shares.min() >= 0.0
    assert shares.max() <= 3.0 + 1e-12
    assert not shares[constraint_set.inverse_masses == 0.0].any()
    if graph != "line":  # its constraints depend on each other
        gradients = gradients_of(system, constraint_set)
        kept = np.eye(3 * len(masses)) - np.linalg.pinv(gradients) @ gradients
        expected = np.diag(kept).reshape(-1, 3).sum(axis=1)
        if conserves and not constraint_set.n_fixed:
            expected -= 3.0 * system.masses / system.masses.sum()
        np.testing.assert_allclose(shares, expected, atol=1e-9)  # rounding


def test_known_shares():
    """A dumbbell: 2 + m/(m₁ + m₂). A line: that of its ends, and nothing across it for one that is between them."""
    system = md.System(PLACES[:2], masses=[1.0, 3.0])
    shares = ConstraintSet(system, md.DistanceConstraints([(0, 1)])).shares(system.positions, False)
    np.testing.assert_allclose(shares, [2.25, 2.75], rtol=1e-12)
    linear = md.System([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], masses=[2.0, 1.0, 2.0])
    shares = ConstraintSet(linear, md.DistanceConstraints(FULL)).shares(linear.positions, False)
    # along the line m/M each; across it the middle one goes with the center, m/M, and the ends also turn
    np.testing.assert_allclose(shares, [0.4 + 2 * 0.9, 0.2 + 2 * 0.2, 0.4 + 2 * 0.9], rtol=1e-12)


def slab():
    """A crystal whose lowest layer is fixed."""
    places, edges = md.lattice.crystal("fcc", [4, 4, 4], 1.6)
    system = md.System(places, cell=edges)
    lower = places[:, 2] < 1.0
    return system, md.FixedAtoms(np.flatnonzero(lower)), [md.LennardJones(1.0, 1.0, 2.5)], 4


def mixture():
    """Rigid dumbbells below, single atoms above, in harmonic traps that do not let them mix."""
    generator = np.random.default_rng(2)
    lower, upper = (generator.uniform((0, 0, z), (8, 8, z + 1.5), (200, 3)) for z in (1.0, 5.5))
    direction = generator.normal(size=(200, 3))
    ends = lower + direction / np.linalg.norm(direction, axis=1)[:, None]
    system = md.System(np.concatenate([lower, ends, upper]), cell=np.diag([8.0, 8.0, 8.0]))
    pairs = np.column_stack([np.arange(200), np.arange(200, 400)])
    return system, md.DistanceConstraints(pairs), [md.Restraint(5.0, system.positions)], 2


@pytest.mark.parametrize("scene", [slab, mixture])
def test_every_layer_has_the_temperature_of_the_bath(scene):
    system, constraints, potentials, n_bins = scene()
    sim = md.Simulation(system, potentials, md.LangevinBAOAB(0.004, 0.5, friction=5.0, seed=1), constraints)
    sim.set_temperature(0.5, seed=1)
    sim.run(300)
    profile = md.observers.Profile("c", n_bins, every=10)
    sim.run(3000, observers=[profile])
    result = profile.result()
    moving = np.isfinite(result.temperature)
    assert moving.sum() >= 2
    np.testing.assert_allclose(result.temperature[moving], 0.5, atol=0.02)  # statistics, and 1 % by the time step


def test_a_layer_of_fixed_atoms_has_no_temperature():
    system, constraints, potentials, _ = slab()
    sim = md.Simulation(system, potentials, md.LangevinBAOAB(0.004, 0.5, friction=5.0, seed=1), constraints)
    profile = md.observers.Profile("c", 8, every=10)
    sim.run(50, observers=[profile])
    assert np.isnan(profile.result().temperature[0])


def test_a_blow_up_tells_the_temperature_of_the_atoms_that_move():
    """Half of the atoms are fixed; the others are far too hot for the time step."""
    places, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.7)
    sim = md.Simulation(md.System(places, cell=edges), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.02),
                        md.FixedAtoms(np.arange(0, len(places), 2)))  # fmt: skip
    sim.set_temperature(300.0, seed=1)
    with warnings.catch_warnings(action="ignore"), pytest.raises(md.NonFiniteError) as blown:
        sim.run(2000, crash_report=False)
    cause = str(blown.value)
    assert "hot" in cause, cause
    told = float(cause.partition("too large: at ")[2].split()[0])
    assert told == pytest.approx(temperature_at(sim, sim.guard.failed_from), rel=1e-2)


def temperature_at(sim, snapshot):
    kinetic = 0.5 * (sim.system.masses[:, None] * snapshot.velocities**2).sum()
    return 2.0 * kinetic / sim.n_dof


def test_a_profile_of_a_bath_that_gets_hotter_is_refused():
    system, constraints, potentials, _ = slab()
    sim = md.Simulation(system, potentials, md.LangevinBAOAB(0.004, 0.5, friction=5.0, seed=1), constraints)

    def heat(simulation):
        simulation.method.temperature = 0.5 + 0.01 * simulation.step

    with pytest.raises(ValueError, match="temperature"):
        sim.run(40, every=10, observers=[heat, md.observers.Profile("c", 4, every=10)])
