"""Units, lists, threads, order of atoms, images, places and cells: what must not change the physics.

A scene yields what was found, what is expected, and by how much they may differ: rounding and its growth."""

from itertools import product
from math import sqrt

import numpy as np
import pytest
from stress_scenes import OPEN, ROUNDING, SMOOTH, forces_of, made, oscillation, ran, scaled, solid

import minimd as md

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them
POWERS = [(1e-30, 1, 1), (1e30, 1, 1), (1, 1e-30, 1), (1, 1e30, 1), (1, 1, 1e-30), (1, 1, 1e30), (1e-30, 1e30, 1e-30)]
SI = (3.4e-10, 1.65e-21, 6.63e-26)  # m, J, kg: argon
RELATIVE = 1e-12  # of forces


def largest(difference):
    return np.abs(difference).max()


def units(scales, n_cells):
    for found, expected in zip(scaled(*scales, n_cells), scaled(1.0, 1.0, 1.0, n_cells), strict=True):
        yield found, expected, 1e-11 * largest(expected)


def soft_and_rigid(length, energy):
    """Positions of a chain held by springs, and of one held by constraints, in units of the scales."""
    k = np.arange(8)
    positions = np.column_stack([k, 0.2 * np.sin(k), 0.1 * np.cos(k)]) * length
    pairs, triples = np.column_stack([k[:-1], k[1:]]), np.column_stack([k[:-2], k[1:-1], k[2:]])
    terms = [md.HarmonicAngle(energy, 2.0, triples), md.LennardJones(energy, length)]
    more = {"timestep": 0.002 * length / sqrt(energy), "n_steps": 200, "temperature": 0.1 * energy}
    soft = ran(md.System(positions, bonds=pairs), [md.HarmonicBond(100 * energy / length**2, length), *terms], **more)
    rigid = ran(md.System(positions), terms, constraints=md.DistanceConstraints(pairs), **more)
    return np.concatenate([soft.positions, rigid.positions]) / length


def chains(length, energy, _mass):
    yield soft_and_rigid(length, energy), soft_and_rigid(1.0, 1.0), 1e-11


def skins(cell):
    widths = [0.3, 0.0, 1e-300, 1.5, 4.2] + [1e6] * (not cell)
    one, *others = (ran(solid(cell=cell), SMOOTH, 0.004, 100, temperature=1.0, skin=skin) for skin in widths)
    assert others[0].engine.interactions.n_builds >= 99
    for other in others:
        yield other.positions, one.positions, ROUNDING


def of_places():
    """One bin holds everything; around the corner eight corners hold a piece each; atoms exactly on the faces."""
    positions, edges = md.lattice.crystal("fcc", [4, 4, 4], 1.68)
    systems = [md.System(positions - shift, cell=500.0) for shift in (0.0, 3.0)]
    one, other = (ran(system, SMOOTH, 0.004, 100) for system in systems)
    yield one.positions - 3.0, other.positions, 1e-11
    # On 0, on the edge, one ulp beside both, and negative zero.
    expected = forces_of(md.System(positions, cell=edges), SMOOTH).potential_energy
    rng, edge = np.random.default_rng(2), edges[0]
    faces = [0.0, -0.0, edge, -edge, np.nextafter(0, -1), np.nextafter(edge, 9)]
    for _ in range(5):
        moved = np.where(positions == 0.0, rng.choice(faces, positions.shape), positions)
        found = forces_of(md.System(moved, cell=edges), SMOOTH)
        yield found.forces, 0.0, 1e-11
        yield found.potential_energy, expected, 1e-12 * abs(expected)


def two_or_many():
    """Symmetric to the last bit: what is one-dimensional remains so, and returns by the way it came."""
    system = md.System([[-3.0, 0, 0], [3.0, 0, 0]], velocities=[[1.0, 0, 0], [-1.0, 0, 0]])
    simulation = ran(system, OPEN, 0.002, 4000)
    yield simulation.positions[0], -simulation.positions[1], 0.0
    yield simulation.positions[:, 1:], 0.0, 0.0
    yield abs(simulation.velocities[1, 0]), 1.0, 1e-3
    # Galilei: a whole crystal at fifty times thermal speed, through its periodic cell again and again.
    velocity = np.array([50.0, -30.0, 10.0])
    rest, drifting = (made(solid(3), SMOOTH, 0.004, temperature=1.0).system for _ in range(2))
    drifting.velocities[:] += velocity
    here, there = (ran(system, SMOOTH, 0.004, 300) for system in (rest, drifting))
    yield there.positions - there.time * velocity, here.positions, 1e-8  # rounding at 60 σ
    # A law and its negative: forces cancel to rounding, atoms fly straight.
    signed = lambda r2, sign: (sign * np.exp(-r2), 2.0 * sign * np.exp(-r2))  # noqa: E731
    both = [md.PairPotential(signed, (sign,), 2.5, "force-shifted") for sign in (1.0, -1.0)]
    simulation = ran(solid(3), both, 0.004, 500, temperature=1.0)
    yield simulation.positions, solid(3).positions + simulation.time * simulation.velocities, 1e-11


def far_away(away):
    """Images of an atom; an atom without a cell; the whole scene, with a cell and without one."""
    near, far = solid(3, cell=False), solid(3, cell=False)
    near.positions[7] += 100.0
    far.positions[7] += [away, -away, away]
    yield forces_of(far, SMOOTH).forces, forces_of(near, SMOOTH).forces, 0.0
    yield oscillation(ran(far, SMOOTH, 0.004, 200, temperature=0.5)), 0.0, 1e-2
    near = solid(3)
    far = near.copy()
    far.positions[7] += np.array([1, -1, 1]) * round(away / 5.04) * near.cell.vectors[0, 0]
    here, there = (forces_of(system, SMOOTH).forces for system in (near, far))
    yield there, here, 1e3 * np.spacing(largest(far.positions)) + RELATIVE * largest(here)
    for cell in (True, False):
        near = solid(3, cell=cell)
        near.positions += away  # rounds the coordinates, once
        home = near.copy()
        home.positions -= away
        there, here = (forces_of(system, SMOOTH).forces for system in (near, home))
        yield there, here, RELATIVE * largest(here) + 1e3 * np.spacing(away)


def sites_of_a_crystal(lattice):
    """Forces are zero to rounding; where the lattice is unstable the run is too short for rounding to grow."""
    if lattice == "hcp":
        basis = np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 5 / 6, 0.5], [0, 1 / 3, 0.5]])
        edges = np.array([1.1, 1.1 * 3**0.5, 1.1 * (8 / 3) ** 0.5])
        positions = ((np.array(list(np.ndindex(5, 3, 3)))[:, None] + basis) * edges).reshape(-1, 3)
        edges = edges * [5, 3, 3]
    else:
        spacing, n_cells = {"sc": (1.1, 5), "bcc": (1.26, 5), "fcc": (1.56, 5), "diamond": (2.54, 3)}[lattice]
        positions, edges = md.lattice.crystal(lattice, [n_cells] * 3, spacing)
    system, n_steps = md.System(positions, cell=edges), 50 if lattice in ("sc", "bcc", "diamond") else 1000
    yield forces_of(system, SMOOTH).forces, 0.0, 1e-11
    yield ran(system, SMOOTH, 0.004, n_steps).positions, positions, 1e-10


FAR, OF_UNITS = (1e3, 1e6, 1e9), product([*POWERS, SI, (1e-60, 1, 1), (1e60, 1, 1)], (2, 4))
SAME = {two_or_many: [()], of_places: [()], units: OF_UNITS, chains: POWERS[:4], skins: product((True, False))}
SAME |= {far_away: product(FAR), sites_of_a_crystal: product([*md.lattice.BASES, "hcp"])}


@pytest.mark.parametrize(("scene", "given"), [(scene, given) for scene, rows in SAME.items() for given in rows])
def test_the_physics_is_the_same(scene, given):
    for found, expected, tolerance in scene(*given):
        assert largest(found - expected) <= tolerance
