"""Lists, threads, order of atoms, units: what must not change the physics."""

from math import sqrt

import numpy as np
import pytest
from cluster_scenes import atoms_per_domain
from stress_scenes import OPEN, ROUNDING, SMOOTH, assert_stops, forces_of, oscillation, ran, solid

import minimd as md
from minimd.structure.lattice import crystal

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them

POWERS = [
    (1e-30, 1.0, 1.0),
    (1e30, 1.0, 1.0),
    (1.0, 1e-30, 1.0),
    (1.0, 1e30, 1.0),
    (1.0, 1.0, 1e-30),
    (1.0, 1.0, 1e30),
    (1e-30, 1e30, 1e-30),
]
SI = (3.4e-10, 1.65e-21, 6.63e-26)  # m, J, kg: argon


def scaled(length, energy, mass, n_cells, **options):
    """Positions, forces and total energy of a run, in units of the scales."""
    start = solid(n_cells)
    system = md.System(start.positions * length, cell=start.cell.vectors * length, masses=mass)
    law = md.LennardJones(energy, length, 2.5 * length, "force-shifted")
    simulation = ran(system, law, 0.004 * length * sqrt(mass / energy), 50, temperature=energy, every=10, **options)
    return simulation.positions / length, simulation.forces * length / energy, simulation.record.total_energy / energy


@pytest.mark.parametrize("n_cells", [2, 4])
@pytest.mark.parametrize("scales", [*POWERS, SI, (1e-60, 1.0, 1.0), (1e60, 1.0, 1.0)])
def test_units_of_any_size_give_the_same_physics(scales, n_cells):
    for found, expected in zip(scaled(*scales, n_cells), scaled(1.0, 1.0, 1.0, n_cells), strict=True):
        assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()  # rounding


@pytest.mark.parametrize("scales", [SI, (1e-12, 1e-21, 1e-26), (1e8, 1.0, 1.0), (1.0, 1e-27, 1.0), (1.0, 1.0, 1e30)])
def test_units_of_si_in_mixed_precision_give_the_same_physics(scales):
    for found, expected in zip(scaled(*scales, 4, precision="mixed"), scaled(1.0, 1.0, 1.0, 4), strict=True):
        assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()  # rounding of float32


@pytest.mark.parametrize(
    "scales",
    [
        (1e-30, 1.0, 1.0),
        (1e30, 1.0, 1.0),
        (1e-30, 1e30, 1e-30),
        (1e20, 1e-30, 1.0),
        (1.0, 1e-40, 1.0),
        (1.0, 1e40, 1.0),
    ],
)
def test_units_beyond_float32_are_refused_in_mixed_precision(scales):
    """They gave forces of zero."""
    assert_stops("precision='mixed' has room for", lambda: scaled(*scales, 4, precision="mixed"), ValueError)


@pytest.mark.parametrize("size", [1e-160, 1e160, 1e300])
def test_units_beyond_float64_are_refused(size):
    assert_stops("take other units", lambda: scaled(size, 1.0, 1.0, 2), ValueError)
    assert_stops("take other units", lambda: md.System([[0, 0, 0], [1e160, 0, 0]]), ValueError)


@pytest.mark.parametrize("scales", POWERS[:4])
def test_bonded_and_rigid_chains_of_any_units_move_alike(scales):
    def chain(length, energy, _mass):
        k = np.arange(8)
        positions = np.column_stack([k, 0.2 * np.sin(k), 0.1 * np.cos(k)]) * length
        pairs, triples = np.column_stack([k[:-1], k[1:]]), np.column_stack([k[:-2], k[1:-1], k[2:]])
        terms = [
            md.HarmonicBond(100 * energy / length**2, length),
            md.HarmonicAngle(energy, 2.0, triples),
            md.LennardJones(energy, length),
        ]
        timestep = 0.002 * length / sqrt(energy)
        soft = ran(md.System(positions, bonds=pairs), terms, timestep, 200, temperature=0.1 * energy)
        rigid = ran(
            md.System(positions),
            terms[1:],
            timestep,
            200,
            temperature=0.1 * energy,
            constraints=md.DistanceConstraints(pairs),
        )
        return np.concatenate([soft.positions, rigid.positions]) / length

    assert np.abs(chain(*scales) - chain(1.0, 1.0, 1.0)).max() < 1e-11


@pytest.mark.parametrize("cell", [True, False])
@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_skins_of_any_width_give_the_same_path(cell, precision):
    tolerance = 1e-12 if precision == "double" else 1e-5
    paths = [
        ran(solid(4, cell=cell), SMOOTH, 0.004, 100, temperature=1.0, skin=skin, precision=precision)
        for skin in (0.3, 0.0, 1e-300, 1.5, 4.2)
    ]
    for other in paths[1:]:
        assert np.abs(other.positions - paths[0].positions).max() < tolerance
    assert paths[1].engine.interactions.n_builds >= 99


def test_a_skin_beyond_all_bounds_is_refused_or_right():
    assert_stops("reduce the skin", lambda: ran(solid(4), SMOOTH, 0.004, 10, skin=1e4), ValueError)
    assert_stops(
        "skin must be finite and not negative, between 1e-75 and 1e",
        lambda: ran(solid(4), SMOOTH, 0.004, 10, skin=1e300),
        ValueError,
    )
    wide, usual = (ran(solid(4, cell=False), SMOOTH, 0.004, 50, temperature=1.0, skin=skin) for skin in (1e6, 0.3))
    assert np.abs(wide.positions - usual.positions).max() < 1e-12


@pytest.mark.parametrize("cutoff", [300.0, 1e3, 1e6])
def test_a_huge_cutoff_in_a_small_cell_is_refused(cutoff):
    for system in (solid(4), md.System([[0, 0, 0]], cell=0.5)):
        assert_stops(
            "reduce the cutoff",
            lambda system=system: ran(system, md.LennardJones(1.0, 1.0, cutoff), 0.004, 10),
            ValueError,
        )


def test_a_huge_cutoff_without_a_cell_is_no_cutoff():
    near, far = (
        forces_of(solid(3, cell=False), md.LennardJones(1.0, 1.0, cutoff, "truncated")) for cutoff in (1e3, 1e30)
    )
    every = forces_of(solid(3, cell=False), OPEN)
    assert np.abs(near.forces - every.forces).max() < ROUNDING * np.abs(every.forces).max()
    assert np.abs(far.forces - every.forces).max() < ROUNDING * np.abs(every.forces).max()


def test_a_huge_scene_without_a_cutoff_is_refused():
    system = md.System(np.random.default_rng(1).uniform(0, 1e3, (60_000, 3)))
    assert_stops("pair lists hold up to", lambda: ran(system, OPEN, 0.004, 10), ValueError)


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_one_to_eight_threads_give_the_same_bits(precision):
    with atoms_per_domain(60):
        one, *others = (
            ran(solid(6), SMOOTH, 0.004, 100, temperature=1.5, threads=n, precision=precision) for n in range(1, 9)
        )
    assert one.engine.interactions.n_builds > 1
    for other in others:
        assert np.array_equal(other.positions, one.positions)
        assert np.array_equal(other.record.total_energy, one.record.total_energy)


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_the_order_of_atoms_is_no_physics(precision):
    start = ran(
        solid(4, species=["A", "B"] * 128),
        md.LennardJones({"A": (1.0, 1.0), "B": (0.5, 0.9)}, cutoff=2.5),
        0.004,
        0,
        temperature=1.0,
    ).system
    order = np.random.default_rng(4).permutation(len(start))
    mixed_up = md.System(
        start.positions[order], velocities=start.velocities[order], species=start.species[order], cell=start.cell
    )
    law = md.LennardJones({"A": (1.0, 1.0), "B": (0.5, 0.9)}, cutoff=2.5, truncation="force-shifted")
    one, other = (ran(system, law, 0.004, 100, precision=precision) for system in (start, mixed_up))
    tolerance = 1e-11 if precision == "double" else 1e-4
    assert np.abs(other.positions - one.positions[order]).max() < tolerance
    assert np.abs(other.record.total_energy - one.record.total_energy).max() < 1e2 * tolerance


@pytest.mark.slow
@pytest.mark.parametrize("n_atoms", [60, 108])
def test_a_hundred_thousand_list_builds_conserve_energy(n_atoms):
    """Skin zero: pair lists and cluster lists are built at every step."""
    start = solid(3)
    edges = start.cell.vectors
    system = md.System(
        start.positions[:n_atoms],
        cell=edges * (n_atoms / 108) ** (1 / 3) if n_atoms < 108 else edges,
        pbc=n_atoms == 108,
    )
    simulation = md.Simulation(system, SMOOTH, md.VelocityVerlet(0.002), skin=0.0)
    simulation.set_temperature(0.3, seed=1)
    record = simulation.run(100_000, every=50)
    assert simulation.report().cost.list_builds >= 99_999 or "all pairs" in simulation.engine.interactions.pair_search
    assert oscillation(simulation) < 1e-2
    assert simulation.report().energy_is_conserved
    assert np.abs(record.momentum).max() < 1e-12 * record.absolute_momentum[0]


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_a_million_atoms_make_a_few_steps(precision):
    positions, edges = crystal("fcc", [63, 63, 63], 1.68)
    simulation = ran(md.System(positions, cell=edges), SMOOTH, 0.004, 10, temperature=1.0, every=5, precision=precision)
    assert len(simulation.system) == 1_000_188
    assert oscillation(simulation) < 1e-3
    assert np.abs(simulation.record.momentum).max() < 1e-12 * simulation.record.absolute_momentum[0]
