"""Units, lists, threads, order of atoms, images, places and cells: what must not change the physics."""

from math import sqrt

import numpy as np
import pytest
import stress_scenes as stress
from cluster_scenes import atoms_per_domain
from stress_scenes import SMOOTH, forces_of, gauss, is_finite, made, oscillation, ran, solid

import minimd as md
from minimd.structure.lattice import BASES, crystal

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them

POWERS = [
    *[(1e-30, 1.0, 1.0), (1e30, 1.0, 1.0), (1.0, 1e-30, 1.0), (1.0, 1e30, 1.0), (1.0, 1.0, 1e-30), (1.0, 1.0, 1e30)],
    (1e-30, 1e30, 1e-30),
]
SI = (3.4e-10, 1.65e-21, 6.63e-26)  # m, J, kg: argon
MIXTURE = {"A": (1.0, 1.0), "B": (0.5, 0.9)}


def largest(difference):
    return np.abs(difference).max()


@pytest.mark.parametrize(
    ("scales", "n_cells", "precision"),
    [
        *((scales, n, "double") for scales in [*POWERS, SI, (1e-60, 1.0, 1.0), (1e60, 1.0, 1.0)] for n in (2, 4)),
        *((scales, 4, "mixed") for scales in [SI, (1e-12, 1e-21, 1e-26), (1e8, 1, 1), (1, 1e-27, 1), (1, 1, 1e30)]),
    ],
)
def test_units_of_any_size_give_the_same_physics(scales, n_cells, precision):
    tolerance = 1e-11 if precision == "double" else 1e-5  # rounding, of float32
    reference = stress.scaled(1.0, 1.0, 1.0, n_cells)
    for found, expected in zip(stress.scaled(*scales, n_cells, precision=precision), reference, strict=True):
        assert largest(found - expected) < tolerance * largest(expected)


def soft_and_rigid_chain(length, energy, _mass):
    """Positions of a chain held by springs, and of one held by constraints, in units of the scales."""
    k = np.arange(8)
    positions = np.column_stack([k, 0.2 * np.sin(k), 0.1 * np.cos(k)]) * length
    pairs, triples = np.column_stack([k[:-1], k[1:]]), np.column_stack([k[:-2], k[1:-1], k[2:]])
    terms = [md.HarmonicAngle(energy, 2.0, triples), md.LennardJones(energy, length)]
    more = {"timestep": 0.002 * length / sqrt(energy), "n_steps": 200, "temperature": 0.1 * energy}
    soft = ran(md.System(positions, bonds=pairs), [md.HarmonicBond(100 * energy / length**2, length), *terms], **more)
    rigid = ran(md.System(positions), terms, constraints=md.DistanceConstraints(pairs), **more)
    return np.concatenate([soft.positions, rigid.positions]) / length


@pytest.mark.parametrize("scales", POWERS[:4])
def test_bonded_and_rigid_chains_of_any_units_move_alike(scales):
    assert largest(soft_and_rigid_chain(*scales) - soft_and_rigid_chain(1.0, 1.0, 1.0)) < 1e-11


@pytest.mark.parametrize("cell", [True, False])
@pytest.mark.parametrize("precision", stress.BOTH)
def test_skins_of_any_width_give_the_same_path(cell, precision):
    skins = [0.3, 0.0, 1e-300, 1.5, 4.2] + [1e6] * (not cell and precision == "double")
    one, *others = (
        ran(solid(cell=cell), SMOOTH, 0.004, 100, temperature=1.0, skin=skin, precision=precision) for skin in skins
    )
    assert max(largest(other.positions - one.positions) for other in others) < stress.ROUNDING[precision]
    assert others[0].engine.interactions.n_builds >= 99


@pytest.mark.parametrize("cutoff", [1e3, 1e30])
def test_a_huge_cutoff_without_a_cell_is_no_cutoff(cutoff):
    system = solid(3, cell=False)
    every = forces_of(system, stress.OPEN).forces
    found = forces_of(system, md.LennardJones(1.0, 1.0, cutoff, "truncated")).forces
    assert largest(found - every) < stress.ROUNDING["double"] * largest(every)


@pytest.mark.parametrize("precision", stress.BOTH)
def test_one_to_eight_threads_give_the_same_bits(precision):
    with atoms_per_domain(60):
        one, *others = (
            ran(solid(6), SMOOTH, 0.004, 100, temperature=1.5, threads=n, precision=precision) for n in range(1, 9)
        )
    assert one.engine.interactions.n_builds > 1
    for other in others:
        assert np.array_equal(other.positions, one.positions)
        assert np.array_equal(other.record.total_energy, one.record.total_energy)


@pytest.mark.parametrize("precision", stress.BOTH)
def test_the_order_of_atoms_is_no_physics(precision):
    law = md.LennardJones(MIXTURE, cutoff=2.5, truncation="force-shifted")
    start = made(solid(4, species=["A", "B"] * 128), law, 0.004, temperature=1.0).system
    order = np.random.default_rng(4).permutation(len(start))
    mixed_up = md.System(
        start.positions[order], velocities=start.velocities[order], species=start.species[order], cell=start.cell
    )
    one, other = (ran(system, law, 0.004, 100, precision=precision) for system in (start.copy(), mixed_up))
    tolerance = 1e-11 if precision == "double" else 1e-4
    assert largest(other.positions - one.positions[order]) < tolerance
    assert largest(other.record.total_energy - one.record.total_energy) < 1e2 * tolerance


def test_a_head_on_collision_on_an_axis_stays_on_it():
    """Symmetric to the last bit: what is one-dimensional remains so, and returns by the way it came."""
    system = md.System([[-3.0, 0, 0], [3.0, 0, 0]], velocities=[[1.0, 0, 0], [-1.0, 0, 0]])
    simulation = ran(system, stress.OPEN, 0.002, 4000)
    assert np.array_equal(simulation.positions[0], -simulation.positions[1])
    assert not simulation.positions[:, 1:].any()
    assert abs(simulation.velocities[1, 0]) == pytest.approx(1.0, abs=1e-3)


def test_a_drifting_scene_is_the_scene_at_rest():
    """Galilei: a whole crystal at fifty times thermal speed, through its periodic cell again and again."""
    drift = np.array([50.0, -30.0, 10.0])
    rest, drifting = (made(solid(3), SMOOTH, 0.004, temperature=1.0).system for _ in range(2))
    drifting.velocities[:] += drift
    here, there = (ran(system, SMOOTH, 0.004, 300) for system in (rest, drifting))
    moved = there.positions - there.time * drift
    assert largest(moved - here.positions) < 1e-8  # rounding at 60 σ, times the growth of a disturbance


@pytest.mark.parametrize("stretch", [0.3, 0.49, 0.51])
def test_a_bond_as_long_as_half_a_cell_is_taken_at_its_nearest_image(stretch):
    system = md.System([[0, 0, 0], [stretch * 4.0, 0, 0]], cell=4.0, bonds=[[0, 1]])
    distance = abs(stretch - np.rint(stretch)) * 4.0
    found = md.evaluate(system, md.HarmonicBond(1.0, 1.0)).potential_energy
    assert found == pytest.approx(0.5 * (distance - 1.0) ** 2)


@pytest.mark.parametrize("precision", stress.BOTH)
def test_all_atoms_in_one_corner_of_a_large_cell(precision):
    """One bin holds everything; and around the corner eight corners hold a piece each."""
    positions, _ = crystal("fcc", [4, 4, 4], 1.68)
    one, other = (
        ran(md.System(positions - shift, cell=500.0), SMOOTH, 0.004, 100, precision=precision) for shift in (0.0, 3.0)
    )
    assert largest(one.positions - other.positions - 3.0) < (1e-11 if precision == "double" else 1e-4)
    assert is_finite(one)


@pytest.mark.parametrize("beside", [0.0, 1e-15, -1e-15, 1e-9, -1e-9])
def test_a_pair_at_the_cutoff_exactly(beside):
    """Force-shifted: energy and force go to zero there, on either side of it."""
    crowd = 50.0 + 5.0 * np.array(list(np.ndindex(5, 5, 4)))
    for more in (crowd[:0], crowd):
        found = md.evaluate(md.System(np.vstack([stress.pair_at(2.5 + beside).positions, more])), SMOOTH)
        assert abs(found.potential_energy) < 1e-12
        assert largest(found.forces) < 1e-8


@pytest.mark.parametrize("every", [1, 7, 100, 333, 10**9])
def test_how_often_one_looks_is_no_physics(every):
    once, often = (ran(solid(3), SMOOTH, 0.004, 333, temperature=1.0, every=n) for n in (333, every))
    assert largest(once.positions - often.positions) < 1e-11


def test_a_thousand_short_runs_are_one_long_one():
    parts = made(solid(2, cell=False), SMOOTH, 0.004, temperature=0.3)
    for _ in range(1000):
        parts.run(1, progress=False)
    whole = ran(solid(2, cell=False), SMOOTH, 0.004, 1000, temperature=0.3, every=1)
    assert parts.step == 1000
    assert largest(parts.positions - whole.positions) < 1e-11


def test_two_opposite_potentials_are_none():
    """A law and its negative: forces cancel to rounding, atoms fly straight."""

    def signed(r2, sign):
        return sign * np.exp(-r2), 2.0 * sign * np.exp(-r2)

    both = [md.PairPotential(signed, (sign,), 2.5, "force-shifted") for sign in (1.0, -1.0)]
    simulation = ran(solid(3), both, 0.004, 500, temperature=1.0)
    assert largest(simulation.positions - solid(3).positions - simulation.time * simulation.velocities) < 1e-11


@pytest.mark.parametrize("away", [1e3, 1e6, 1e9])
def test_an_atom_far_away_without_a_cell_changes_nothing_for_the_others(away):
    near, far = solid(3, cell=False), solid(3, cell=False)
    near.positions[7] += 100.0
    far.positions[7] += [away, -away, away]
    assert np.array_equal(forces_of(far, SMOOTH).forces, forces_of(near, SMOOTH).forces)
    assert oscillation(ran(far, SMOOTH, 0.004, 200, temperature=0.5)) < 1e-2


@pytest.mark.parametrize("precision", stress.BOTH)
@pytest.mark.parametrize("away", [1e3, 1e6, 1e9])
def test_an_atom_far_away_in_a_periodic_cell_is_its_image(away, precision):
    near = solid(3)
    far = near.copy()
    far.positions[7] += np.array([1, -1, 1]) * round(away / 5.04) * near.cell.vectors[0, 0]
    here, there = (forces_of(system, SMOOTH, precision=precision).forces for system in (near, far))
    relative = 1e-12 if precision == "double" else 1e-4
    assert largest(here - there) < 1e3 * np.spacing(largest(far.positions)) + relative * largest(here)


@pytest.mark.parametrize("precision", stress.BOTH)
@pytest.mark.parametrize("offset", [1e3, 1e6, 1e9])
def test_a_whole_scene_far_from_the_origin_is_the_same_scene(offset, precision):
    for cell in (True, False):
        near = solid(3, cell=cell)
        near.positions += offset  # rounds the coordinates, once
        home = near.copy()
        home.positions -= offset
        here, there = (forces_of(system, SMOOTH, precision=precision).forces for system in (near, home))
        relative = 1e-12 if precision == "double" else 1e-4
        assert largest(here - there) < relative * largest(there) + 1e3 * np.spacing(offset)


@pytest.mark.parametrize("edge", [0.9, 1.3, 2.4])
@pytest.mark.parametrize("pbc", [(True, True, True), (True, False, True), (False, False, True)])
def test_a_box_smaller_than_the_cutoff_is_its_supercell(edge, pbc):
    """All images within the cutoff count."""
    copies = 1 + 2 * np.array(pbc)
    small = md.System([[0, 0, 0], [0.45 * edge, 0.4 * edge, 0.3 * edge]], cell=edge, pbc=pbc)
    shifts = np.array(list(np.ndindex(*copies))) * edge
    large = md.System((small.positions + shifts[:, None]).reshape(-1, 3), cell=edge * copies, pbc=pbc)
    law = md.PairPotential(gauss, (), 2.5, "force-shifted")
    one, many = md.evaluate(small, law), md.evaluate(large, law)
    assert many.potential_energy == pytest.approx(len(shifts) * one.potential_energy, rel=1e-12)
    assert largest(many.forces[:2] - one.forces) < 1e-11 * largest(one.forces)


@pytest.mark.parametrize("precision", stress.BOTH)
def test_atoms_exactly_on_the_faces_of_cells_belong_to_one_of_them(precision):
    """On 0, on the edge, one ulp beside both, and negative zero."""
    positions, edges = crystal("fcc", [4, 4, 4], 1.68)
    expected = forces_of(md.System(positions, cell=edges), SMOOTH, precision=precision).potential_energy
    rng, edge = np.random.default_rng(2), edges[0]
    faces = [0.0, -0.0, edge, -edge, np.nextafter(0, -1), np.nextafter(edge, 9)]
    force, energy = (1e-11, 1e-12) if precision == "double" else (1e-3, 1e-6)
    for _ in range(5):
        moved = np.where(positions == 0.0, rng.choice(faces, positions.shape), positions)
        found = forces_of(md.System(moved, cell=edges), SMOOTH, precision=precision)
        assert largest(found.forces) < force
        assert found.potential_energy == pytest.approx(expected, rel=energy)


def on_sites(lattice):
    if lattice == "hcp":
        basis = np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 5 / 6, 0.5], [0, 1 / 3, 0.5]])
        edges = np.array([1.1, 1.1 * 3**0.5, 1.1 * (8 / 3) ** 0.5])
        sites = ((np.array(list(np.ndindex(5, 3, 3)))[:, None] + basis) * edges).reshape(-1, 3)
        return md.System(sites, cell=edges * [5, 3, 3])
    spacing, n_cells = {"sc": (1.1, 5), "bcc": (1.26, 5), "fcc": (1.56, 5), "diamond": (2.54, 3)}[lattice]
    positions, edges = crystal(lattice, [n_cells] * 3, spacing)
    return md.System(positions, cell=edges)


@pytest.mark.parametrize("precision", stress.BOTH)
@pytest.mark.parametrize("lattice", [*BASES, "hcp"])
def test_atoms_on_the_sites_of_a_crystal_stay_there(lattice, precision):
    """Forces are zero to rounding; where the lattice is unstable the run is too short for rounding to grow."""
    system = on_sites(lattice)
    n_steps = 50 if lattice in ("sc", "bcc", "diamond") else 1000
    force, way = (1e-11, 1e-10) if precision == "double" else (1e-3, 1e-3)
    assert largest(forces_of(system, SMOOTH, precision=precision).forces) < force
    assert largest(ran(system.copy(), SMOOTH, 0.004, n_steps, precision=precision).positions - system.positions) < way


@pytest.mark.parametrize("edge", [100.0, 1e4, 1e8])
def test_a_droplet_in_vacuum_is_a_droplet(edge):
    """Whatever surrounds it: the same as without a cell, to rounding."""
    inside = md.System(solid(3).positions + 0.25 * edge, cell=edge)
    boxed, free = (ran(system, SMOOTH, 0.004, 200, temperature=0.5) for system in (inside, solid(3, cell=False)))
    assert largest(boxed.positions - 0.25 * edge - free.positions) < 1e5 * np.spacing(edge)
    assert oscillation(boxed) < 1e-2


def test_a_negative_time_step_runs_back():
    there = ran(solid(3), SMOOTH, 0.004, 300, temperature=1.0)
    back = ran(there.system, SMOOTH, -0.004, 300)
    assert largest(back.positions - solid(3).positions) < 1e-10  # rounding, times the growth of a disturbance
    assert back.time == pytest.approx(-1.2)
    look = ran(solid(2, cell=False), SMOOTH, 0.004, 0, temperature=1.0)
    assert (look.step, len(look.record)) == (0, 1)
