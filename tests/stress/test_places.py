"""Where atoms can be: on each other, a million lengths away, on faces, in cells of every size and shape, alone."""

import numpy as np
import pytest
from references import brute_force_energy
from stress_scenes import LAST_GOOD, OPEN, ROUNDING, SMOOTH, assert_stops, forces_of, is_finite, oscillation, ran, solid

import minimd as md
from minimd.structure.cell import Cell
from minimd.structure.lattice import BASES, crystal

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them

GAUSS = md.PairPotential(lambda r2: (np.exp(-r2), 2.0 * np.exp(-r2)), (), 2.5, "force-shifted")
SHAPES = {
    "needle": np.diag([200.0, 3.0, 3.0]),
    "sheet": np.diag([3.0, 40.0, 40.0]),
    "sheared 45 times": [[9.0, 0, 0], [400.0, 9.0, 0], [0, -300.0, 9.0]],
    "nearly flat": [[9.0, 0, 0], [0, 9.0, 0], [8.9, 0.2, 2.6]],
    "left-handed": [[0, 9.0, 0], [9.0, 0, 0], [1.0, 2.0, 9.0]],
}


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("distance", [0.3, 0.1, 1e-3, 1e-30, 0.0])
@pytest.mark.parametrize("scene", ["liquid", "three atoms", "no cutoff"])
def test_overlapping_atoms_are_named(scene, distance, precision):
    if scene == "liquid":
        system = solid(3)
        system.positions[1] = system.positions[0] + [distance, 0, 0]
    else:
        system = md.System([[0, 0, 0], [distance, 0, 0], [3.0, 0, 0]])
    potential = OPEN if scene == "no cutoff" else SMOOTH
    message = assert_stops(LAST_GOOD, lambda: ran(system, potential, 0.004, 1000, precision=precision))
    assert "atoms 0 and 1 overlap" in message
    assert f"atoms 0 and 1, {distance:.3g} σ apart" in message or (
        distance == 1e-30 and "atoms 0 and 1, 0 σ apart" in message
    )


@pytest.mark.parametrize("scene", ["one spot", "modulo the cell", "modulo the cell, thousands of cells away"])
def test_atoms_on_one_spot_are_named(scene):
    start = solid(3, jitter=0.0)
    if scene == "one spot":
        system = md.System(np.ones((100, 3)), cell=9.0)
    else:
        edges = start.cell.vectors[0]
        system = md.System(
            np.vstack([start.positions, start.positions[:1] + edges * (1 if scene == "modulo the cell" else 4096)]),
            cell=start.cell,
        )
    assert "0 σ apart" in assert_stops(LAST_GOOD, lambda: ran(system, SMOOTH, 0.004, 10))
    assert_stops("atoms 0 and", lambda: md.evaluate(system, SMOOTH))


@pytest.mark.parametrize("away", [1e3, 1e6, 1e9])
def test_an_atom_far_away_without_a_cell_changes_nothing_for_the_others(away):
    near, far = solid(3, cell=False), solid(3, cell=False)
    near.positions[7] += 100.0
    far.positions[7] += [away, -away, away]
    assert np.array_equal(forces_of(far, SMOOTH).forces, forces_of(near, SMOOTH).forces)
    simulation = ran(far, SMOOTH, 0.004, 200, temperature=0.5)
    assert oscillation(simulation) < 1e-2
    if away < 1e6:
        return
    assert_stops("precision='mixed' resolves", lambda: forces_of(far, SMOOTH, precision="mixed"), ValueError)


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("away", [1e3, 1e6, 1e9])
def test_an_atom_far_away_in_a_periodic_cell_is_its_image(away, precision):
    near = solid(3)
    cells, edge = round(away / 5.04), near.cell.vectors[0, 0]
    far = near.copy()
    far.positions[7] += np.array([cells, -cells, cells]) * edge
    ulp = np.spacing(np.abs(far.positions).max())
    here, there = (forces_of(system, SMOOTH, precision=precision).forces for system in (near, far))
    assert np.abs(here - there).max() < 1e3 * ulp + (ROUNDING if precision == "double" else 1e-4) * np.abs(here).max()


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("offset", [1e3, 1e6, 1e9])
def test_a_whole_scene_far_from_the_origin_is_the_same_scene(offset, precision):
    for cell in (True, False):
        near = solid(3, cell=cell)
        near.positions += offset  # rounds the coordinates, once
        home = near.copy()
        home.positions -= offset
        here, there = (forces_of(system, SMOOTH, precision=precision) for system in (near, home))
        scale = np.abs(there.forces).max()
        assert np.abs(here.forces - there.forces).max() < (
            ROUNDING if precision == "double" else 1e-4
        ) * scale + 1e3 * np.spacing(offset)


@pytest.mark.parametrize("cutoffs", [1.01, 1.5, 2.0, 2.3, 3.0, 10.0, 30.0, 100.0])
@pytest.mark.parametrize("n_atoms", [2, 100])
def test_boxes_of_any_number_of_cutoffs_hold_the_energy_of_all_pairs(cutoffs, n_atoms):
    edge = 2.5 * cutoffs
    rng = np.random.default_rng(3)
    system = md.System(rng.uniform(0, edge, (n_atoms, 3)) + edge * rng.integers(-3, 4, (n_atoms, 3)), cell=edge)
    expected = brute_force_energy(system, lambda r: float(GAUSS.pair_energy(r)), 2.5)
    result = md.evaluate(system, GAUSS)
    assert result.potential_energy == pytest.approx(expected, rel=1e-11, abs=1e-13)
    assert np.abs(result.forces.sum(axis=0)).max() < 1e-11


@pytest.mark.parametrize("edge", [0.9, 1.3, 2.4])
@pytest.mark.parametrize("pbc", [(True, True, True), (True, False, True), (False, False, True)])
def test_a_box_smaller_than_the_cutoff_is_its_supercell(edge, pbc):
    """All images within the cutoff count."""
    copies = 1 + 2 * np.array(pbc)
    small = md.System([[0, 0, 0], [0.45 * edge, 0.4 * edge, 0.3 * edge]], cell=edge, pbc=pbc)
    shifts = np.array(list(np.ndindex(*copies))) * edge
    large = md.System((small.positions + shifts[:, None]).reshape(-1, 3), cell=edge * copies, pbc=pbc)
    one, many = md.evaluate(small, GAUSS), md.evaluate(large, GAUSS)
    assert many.potential_energy == pytest.approx(len(shifts) * one.potential_energy, rel=1e-12)
    assert np.abs(many.forces[:2] - one.forces).max() < 1e-11 * np.abs(one.forces).max()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("pbc", [True, (True, False, True), (False, True, False)])
def test_cells_of_any_shape_hold_the_energy_of_all_pairs(shape, pbc):
    rng = np.random.default_rng(5)
    cell = Cell.of(SHAPES[shape], pbc)
    system = md.System(rng.uniform(-1, 1, (80, 3)) @ cell.lattice, cell=cell)
    expected = brute_force_energy(
        md.System(system.positions, cell=Cell.of(cell.lattice, pbc)), lambda r: float(GAUSS.pair_energy(r)), 2.5
    )
    assert forces_of(system, GAUSS).potential_energy == pytest.approx(expected, rel=1e-10)
    simulation = ran(system, GAUSS, 0.01, 300, temperature=1.0, every=10)
    assert oscillation(simulation) < 1e-2


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_atoms_exactly_on_the_faces_of_cells_belong_to_one_of_them(precision):
    """On 0, on the edge, one ulp beside both, and negative zero."""
    positions, edges = crystal("fcc", [4, 4, 4], 1.68)
    edge, simple = edges[0], md.System(positions, cell=edges)
    expected = forces_of(simple, SMOOTH, precision=precision)
    rng = np.random.default_rng(2)
    for _ in range(5):
        moved = np.where(
            positions == 0.0,
            rng.choice([0.0, -0.0, edge, -edge, np.nextafter(0, -1), np.nextafter(edge, 9)], positions.shape),
            positions,
        )
        found = forces_of(md.System(moved, cell=edges), SMOOTH, precision=precision)
        assert np.abs(found.forces).max() < (1e-11 if precision == "double" else 1e-3)
        assert found.potential_energy == pytest.approx(
            expected.potential_energy, rel=1e-12 if precision == "double" else 1e-6
        )


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("lattice", [*BASES, "hcp"])
def test_atoms_on_the_sites_of_a_crystal_stay_there(lattice, precision):
    """Forces are zero to rounding, at 0 K nothing moves; where the lattice is unstable the run is too short for rounding to grow."""
    if lattice == "hcp":
        basis = np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 5 / 6, 0.5], [0, 1 / 3, 0.5]])
        edges = np.array([1.1, 1.1 * 3**0.5, 1.1 * (8 / 3) ** 0.5])
        sites = ((np.array(list(np.ndindex(5, 3, 3)))[:, None] + basis) * edges).reshape(-1, 3)
        system = md.System(sites, cell=edges * [5, 3, 3])
    else:
        spacing = {"sc": 1.1, "bcc": 1.26, "fcc": 1.56, "diamond": 2.54}[lattice]
        positions, edges = crystal(lattice, [5, 5, 5] if lattice != "diamond" else [3, 3, 3], spacing)
        system = md.System(positions, cell=edges)
    simulation = ran(system, SMOOTH, 0.004, 50 if lattice in ("sc", "bcc", "diamond") else 1000, precision=precision)
    assert np.abs(forces_of(system, SMOOTH, precision=precision).forces).max() < (
        1e-11 if precision == "double" else 1e-3
    )
    assert np.abs(simulation.positions - system.positions).max() < (1e-10 if precision == "double" else 1e-3)


def test_one_atom_flies_straight():
    for cell in (None, 1.2, 30.0):
        system = md.System([[0.1, 0.2, 0.3]], cell=cell, velocities=[[3.0, -2.0, 1.0]])
        simulation = ran(system, SMOOTH, 0.004, 1000)
        assert np.abs(simulation.positions - [[12.1, -7.8, 4.3]]).max() < 1e-11
        assert is_finite(simulation)


@pytest.mark.parametrize("along", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
def test_atoms_on_a_line_or_a_plane_without_a_cell(along):
    """A scene of no width in two directions, or in one."""
    steps = 1.1 * np.arange(300)[:, None]
    line = ran(md.System(steps * np.array(along) / np.linalg.norm(along)), SMOOTH, 0.004, 300)
    assert oscillation(line) < 1e-2
    assert np.abs(np.cross(line.positions, along)).max() < 1e-9
    grid = np.array(list(np.ndindex(15, 15))) * 1.1
    plane = ran(md.System(np.insert(grid, np.argmax(along), 0.0, axis=1)), SMOOTH, 0.004, 300)
    assert oscillation(plane) < 1e-2


@pytest.mark.parametrize("edge", [100.0, 1e4, 1e8])
def test_a_droplet_in_vacuum_is_a_droplet(edge):
    """Whatever surrounds it: the same as without a cell, to rounding."""
    drop, alone = solid(3), solid(3, cell=False)
    inside = md.System(drop.positions + 0.25 * edge, cell=edge)
    boxed, free = (ran(system, SMOOTH, 0.004, 200, temperature=0.5) for system in (inside, alone))
    assert np.abs(boxed.positions - 0.25 * edge - free.positions).max() < 1e5 * np.spacing(edge)
    assert oscillation(boxed) < 1e-2


def test_a_gas_of_density_1e_4_is_conserved():
    sites = np.array(list(np.ndindex(10, 10, 10))) * 21.5
    simulation = ran(md.System(sites, cell=215.0), SMOOTH, 0.005, 5000, temperature=2.0)
    assert oscillation(simulation) < 1e-4
    assert simulation.record.temperature[-1] == pytest.approx(2.0, rel=0.02)
