"""Scenes that nobody asked for, and somebody will run."""

from time import perf_counter

import numpy as np
import pytest
from stress_scenes import BOTTOM, OPEN, SMOOTH, assert_stops, forces_of, is_finite, oscillation, ran, solid

import minimd as md
from minimd.neighbors.queries import closest_pair
from minimd.structure.lattice import crystal

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them


def test_a_planet_and_a_moon_a_million_times_lighter():
    """Gravity by a user's law without cutoff: a thousand orbits close."""

    def gravity(r2, strength):
        r = r2**0.5
        return -strength / r, -strength / (r2 * r)

    system = md.System([[0, 0, 0], [1, 0, 0]], velocities=[[0, -1e-6, 0], [0, 1, 0]], masses=[1e6, 1.0])
    simulation = ran(system, md.PairPotential(gravity, (1.0,), truncation="truncated"), 0.01, 62_832, every=50)
    assert oscillation(simulation) < 1e-4
    assert np.linalg.norm(simulation.positions[1] - simulation.positions[0]) == pytest.approx(1.0, abs=1e-3)


def test_a_head_on_collision_on_an_axis_stays_on_it():
    """Symmetric to the last bit: what is one-dimensional remains so, and returns by the way it came."""
    system = md.System([[-3.0, 0, 0], [3.0, 0, 0]], velocities=[[1.0, 0, 0], [-1.0, 0, 0]])
    simulation = ran(system, OPEN, 0.002, 4000)
    assert np.array_equal(simulation.positions[0], -simulation.positions[1])
    assert not simulation.positions[:, 1:].any()
    assert abs(simulation.velocities[1, 0]) == pytest.approx(1.0, abs=1e-3)


def test_a_drifting_scene_is_the_scene_at_rest():
    """Galilei: a whole crystal at fifty times thermal speed, through its periodic cell again and again."""
    rest, drifting = (ran(solid(3), SMOOTH, 0.004, 0, temperature=1.0).system for _ in range(2))
    drifting.velocities[:] += [50.0, -30.0, 10.0]
    here, there = (ran(system, SMOOTH, 0.004, 300) for system in (rest, drifting))
    moved = there.positions - there.time * np.array([50.0, -30.0, 10.0])
    assert np.abs(moved - here.positions).max() < 1e-8  # rounding at 60 σ, times the growth of a disturbance


def test_a_drift_faster_than_the_cutoff_in_a_step_is_refused():
    fast = ran(solid(3), SMOOTH, 0.004, 0, temperature=1.0).system
    fast.velocities[:] += 1e4
    assert_stops("moves .* in one step, past every neighbor", lambda: ran(fast, SMOOTH, 0.004, 10))


def test_a_bond_across_a_thousand_cells_is_short():
    system = md.System([[0.1, 0, 0], [0.1 + 1.2 + 9.0 * 1000, 0, 0]], cell=9.0, bonds=[[0, 1]])
    simulation = ran(system, md.HarmonicBond(100.0, 1.0), 0.004, 2000)
    assert simulation.record.potential_energy[0] == pytest.approx(0.5 * 100.0 * 0.2**2, rel=1e-8)
    assert oscillation(simulation) < 0.05


@pytest.mark.parametrize("stretch", [0.3, 0.49, 0.51, 2.0])
def test_a_bond_as_long_as_half_a_cell_is_taken_at_its_nearest_image(stretch):
    system = md.System([[0, 0, 0], [stretch * 4.0, 0, 0]], cell=4.0, bonds=[[0, 1]])
    expected = min(abs(stretch - np.rint(stretch)) * 4.0, 4.0)
    if expected == 0.0:
        assert_stops("0 σ apart", lambda: ran(system, md.HarmonicBond(1.0, 1.0), 0.004, 10))
        return
    assert md.evaluate(system, md.HarmonicBond(1.0, 1.0)).potential_energy == pytest.approx(0.5 * (expected - 1.0) ** 2)


def test_an_atom_of_many_bonds():
    """A star of 500 springs on one atom, exclusions and all."""
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((500, 3))
    arms = 6.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    bonds = np.column_stack([np.zeros(500, int), np.arange(1, 501)])
    system = md.System(np.vstack([[0, 0, 0], arms]), bonds=bonds)
    soft = md.PairPotential(
        lambda r2: (np.exp(-r2), 2.0 * np.exp(-r2)), (), 2.5, "force-shifted", bonded_scale=(0, 1, 1)
    )
    simulation = ran(system, [soft, md.HarmonicBond(10.0, 6.0)], 0.002, 1000, temperature=0.5)
    assert oscillation(simulation) < 1e-2
    assert (
        np.abs(simulation.record.momentum - simulation.record.momentum[0]).max()
        < 1e-12 * simulation.record.absolute_momentum[0]
    )


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_all_atoms_in_one_corner_of_a_large_cell(precision):
    """One bin holds everything."""
    positions, _ = crystal("fcc", [4, 4, 4], 1.68)
    everywhere = md.System(positions, cell=500.0)
    across = md.System(positions - 3.0, cell=500.0)  # around the corner: eight corners hold a piece each
    one, other = (ran(system, SMOOTH, 0.004, 100, precision=precision) for system in (everywhere, across))
    assert np.abs(one.positions - other.positions - 3.0).max() < (1e-11 if precision == "double" else 1e-4)
    assert is_finite(one)


@pytest.mark.parametrize("n_atoms", [63, 64, 65, 100, 101])
@pytest.mark.parametrize("cell", [True, False])
def test_scenes_at_the_thresholds_of_lists_agree(n_atoms, cell):
    """Where another list takes over: the energy is that of all pairs."""
    full = solid(3)
    system = md.System(full.positions[:n_atoms], cell=full.cell if cell else None)
    by_pairs = md.neighbor_list("d", system, 2.5)
    expected = 0.5 * SMOOTH.pair_energy(by_pairs).sum()
    assert forces_of(system, SMOOTH).potential_energy == pytest.approx(expected, rel=1e-12)
    assert oscillation(ran(system, SMOOTH, 0.002, 500, temperature=0.5)) < 1e-2


@pytest.mark.parametrize("beside", [0.0, 1e-15, -1e-15, 1e-9, -1e-9])
def test_a_pair_at_the_cutoff_exactly(beside):
    """Force-shifted: energy and force go to zero there, on either side of it."""
    for n_more in (0, 100):
        far = 50.0 + 5.0 * np.array(list(np.ndindex(5, 5, 4)))[:n_more]
        system = md.System(np.vstack([[[0, 0, 0], [2.5 + beside, 0, 0]], *([far] if n_more else [])]))
        result = md.evaluate(system, SMOOTH)
        assert abs(result.potential_energy) < 1e-12
        assert np.abs(result.forces).max() < 1e-8


def test_a_crystal_at_contact_of_hard_cores_is_conserved():
    """r⁻⁴⁸ spheres: as steep a wall as anybody uses."""

    def wall(r2, epsilon):
        s = epsilon / (r2 * r2 * r2) ** 8
        return s, 48.0 * s / r2

    simulation = ran(
        solid(3, jitter=0.02), md.PairPotential(wall, (1.0,), 1.5, "force-shifted"), 0.0002, 5000, temperature=1.0
    )
    assert oscillation(simulation) < 1e-2


@pytest.mark.parametrize("every", [1, 7, 100, 333, 10**9])
def test_how_often_one_looks_is_no_physics(every):
    once, often = (ran(solid(3), SMOOTH, 0.004, 333, temperature=1.0, every=n) for n in (333, every))
    assert np.abs(once.positions - often.positions).max() < 1e-11


def test_a_thousand_short_runs_are_one_long_one():
    parts = md.Simulation(solid(2, cell=False), SMOOTH, md.VelocityVerlet(0.004))
    parts.set_temperature(0.3, seed=1)
    for _ in range(1000):
        parts.run(1)
    whole = ran(solid(2, cell=False), SMOOTH, 0.004, 1000, temperature=0.3, every=1)
    assert parts.step == 1000
    assert np.abs(parts.positions - whole.positions).max() < 1e-11


def test_two_opposite_potentials_are_none():
    """A law and its negative: forces cancel to rounding, atoms fly straight."""

    def gauss(r2, sign):
        return sign * np.exp(-r2), 2.0 * sign * np.exp(-r2)

    both = [md.PairPotential(gauss, (sign,), 2.5, "force-shifted") for sign in (1.0, -1.0)]
    simulation = ran(solid(3), both, 0.004, 500, temperature=1.0)
    assert np.abs(simulation.positions - solid(3).positions - simulation.time * simulation.velocities).max() < 1e-11


def test_an_attractive_law_without_a_core_collapses_and_is_told():
    """u = −1/r⁴: atoms fall into each other. Whatever happens ends as a sentence, or as a report that energy was not kept."""

    def falling(r2):
        return -1.0 / (r2 * r2), -4.0 / (r2 * r2 * r2)

    simulation = md.Simulation(solid(3), md.PairPotential(falling, (), 2.5, "force-shifted"), md.VelocityVerlet(0.004))
    assert_stops("atoms .* apart", lambda: simulation.run(5000))
    assert np.isfinite(simulation.positions).all()


def test_fixed_atoms_may_overlap_each_other_and_nothing_is_hidden():
    """Forces between walls are infinite though nothing moves: the energy is not a number, and that is said."""
    system = md.System([[0, 0, 0], [0, 0, 0], [BOTTOM, 0, 0]])
    assert_stops("atoms 0 and 1, 0 σ apart", lambda: ran(system, OPEN, 0.004, 10, constraints=md.FixedAtoms([0, 1])))


def test_everything_fixed_is_refused():
    with pytest.raises(ValueError, match="no degree of freedom is left"):
        ran(solid(2), SMOOTH, 0.004, 10, constraints=md.FixedAtoms(np.ones(32, dtype=bool)))


@pytest.mark.parametrize(
    "method", [md.PositionVerlet, md.Leapfrog, md.integrators.BlanesMoan4, md.integrators.PEFRL, md.integrators.Ruth3]
)
def test_other_methods_are_stopped_past_their_limits_too(method):
    system = md.System([[0, 0, 0], [1.1, 0, 0]], bonds=[[0, 1]])
    assert_stops(
        "total energy has gone|not finite",
        lambda: ran(system, md.HarmonicBond(1.0, 1.0), 4.0, 3000, method=method(12.0 / np.sqrt(2.0))),
    )


@pytest.mark.parametrize("pbc", [False, True])
def test_the_closest_pair_is_found_in_a_crowd_with_one_atom_far_away(pbc):
    """The words of an error must not take longer than the run."""
    positions, _ = crystal("fcc", [28, 28, 28], 1.68)
    positions[5], positions[-1] = positions[4] + [0.01, 0, 0], [1e6, 1e6, 1e6]
    started = perf_counter()
    pair = closest_pair(md.System(positions, cell=2e6 if pbc else None))
    assert str(pair) == "atoms 4 and 5, 0.01 apart"
    assert perf_counter() - started < 30.0


@pytest.mark.parametrize("pbc", [(True, True, True), (False, True, False)])
def test_the_closest_pair_is_the_first_of_all_neighbors(pbc):
    rng = np.random.default_rng(2)
    for n_atoms in (1, 2, 3, 20):
        system = md.System(
            rng.uniform(-20, 20, (n_atoms, 3)), cell=[[3.0, 0, 0], [40.0, 5.0, 0], [1, -20.0, 7.0]], pbc=pbc
        )
        pair = closest_pair(system)
        i, j, d = md.neighbor_list("ijd", system, 60.0)
        assert pair.distance == pytest.approx(d.min(), rel=1e-9)
        assert (pair.first, pair.second) in set(
            zip(i[d < d.min() * 1.000001].tolist(), j[d < d.min() * 1.000001].tolist(), strict=True)
        )
