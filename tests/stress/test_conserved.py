"""Scenes that nobody asked for, and somebody will run: each conserves its energy within its bound."""

import numpy as np
import pytest
import stress_scenes as stress
from references import brute_force_energy
from stress_scenes import OPEN, SMOOTH, STIFF, is_finite, made, oscillation, pair_at, ran, solid

import minimd as md
from minimd.structure.checks import LARGEST, SMALLEST
from minimd.structure.lattice import crystal

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them

BELOW = [0.1, 0.5, 1.0, 1.5, 1.9, 1.99]  # Δt ω


def momentum_is_kept(simulation, bound=1e-12):
    """To rounding."""
    record = simulation.record
    return np.abs(record.momentum - record.momentum[0]).max() < bound * record.absolute_momentum[0]


def lengths_are_kept(simulation):
    return simulation.record.constraint_violation.max() < 1e-14  # rounding


def is_told(simulation, bound=1e-12):
    """The report finds it too."""
    return simulation.report().energy_is_conserved and momentum_is_kept(simulation, bound)


def gravity(r2, strength):
    r = r2**0.5
    return -strength / r, -strength / (r2 * r)


def planet_and_moon():
    """A million times lighter; a thousand orbits close."""
    system = md.System([[0, 0, 0], [1, 0, 0]], velocities=[[0, -1e-6, 0], [0, 1, 0]], masses=[1e6, 1.0])
    return ran(system, md.PairPotential(gravity, (1.0,), truncation="truncated"), 0.01, 62_832, every=50)


def orbit_closes(simulation):
    return abs(np.linalg.norm(simulation.positions[1] - simulation.positions[0]) - 1.0) < 1e-3


def star():
    """500 springs on one atom, exclusions and all."""
    arms = np.random.default_rng(1).standard_normal((500, 3))
    arms *= 6.0 / np.linalg.norm(arms, axis=1, keepdims=True)
    bonds = np.column_stack([np.zeros(500, int), np.arange(1, 501)])
    soft = md.PairPotential(stress.gauss, (), 2.5, "force-shifted", bonded_scale=(0, 1, 1))
    laws = [soft, md.HarmonicBond(10.0, 6.0)]
    return ran(md.System(np.vstack([[0, 0, 0], arms]), bonds=bonds), laws, 0.002, 1000, temperature=0.5)


def hard_core(r2, epsilon):
    """r⁻⁴⁸ spheres: as steep a wall as anybody uses."""
    s = epsilon / (r2 * r2 * r2) ** 8
    return s, 48.0 * s / r2


def rigid(scene, n_steps):
    system, bonds = scene
    return ran(system, stress.WEAK, 0.002, n_steps, temperature=1.0, constraints=bonds)


def swinging(angle):
    """Atoms without a pair law: the angle passes 180 degrees, where its sine vanishes."""
    positions = [[0, 0, 0], [1, 0, 0], [1 - np.cos(angle + 1e-3), np.sin(angle + 1e-3), 0]]
    system = md.System(positions, bonds=[[0, 1], [1, 2]])
    return ran(system, [md.HarmonicAngle(50.0, angle, [[0, 1, 2]]), STIFF], 0.002, 20_000, temperature=0.5)


def line(along):
    """Of no width in two directions."""
    unit = np.array(along) / np.linalg.norm(along)
    return ran(md.System(1.1 * np.arange(300)[:, None] * unit), SMOOTH, 0.004, 300)


def stays_on(along):
    return lambda simulation: np.abs(np.cross(simulation.positions, along)).max() < 1e-9


def plane(normal):
    grid = np.array(list(np.ndindex(15, 15))) * 1.1
    return ran(md.System(np.insert(grid, normal, 0.0, axis=1)), SMOOTH, 0.004, 300)


def thin_gas():
    sites = np.array(list(np.ndindex(10, 10, 10))) * 21.5
    return ran(md.System(sites, cell=215.0), SMOOTH, 0.005, 5000, temperature=2.0)


def colliding(timestep):
    """At a hundred times thermal speed."""
    system = md.System([[0, 0, 0], [5, 0.1, 0]], velocities=[[100.0, 0, 0], [-100.0, 0, 0]])
    return ran(system, SMOOTH, timestep, round(0.08 / timestep), every=10)


def jumping():
    """So fast that they jump over each other, and meet nobody: without a cutoff nothing is seen of it."""
    system = md.System([[0, 0, 0], [4.0, 0.1, 0]], velocities=[[1000.0, 0, 0], [-1000.0, 0, 0]])
    return ran(system, OPEN, 0.004, 100)


def of_masses(ratio):
    """The light ones set the time step: Δt ∝ √m."""
    system = solid(3, masses=np.where(np.arange(108) % 2, 1.0, ratio))
    return ran(system, SMOOTH, 0.002 * min(1.0, ratio) ** 0.5, 2000, temperature=1.0)


def dimer(potential, x):
    """The well is not a parabola: what is stable for a small amplitude only."""
    return ran(pair_at(stress.BOTTOM + 0.001), potential, x / np.sqrt(2.0 * stress.CURVATURE), 20_000, every=7)


def stays_at_the_bottom(simulation):
    arm = np.linalg.norm(simulation.positions[1] - simulation.positions[0])
    return np.ptp(simulation.record.total_energy) < 2e-3 and abs(arm - stress.BOTTOM) < 0.05


def beads(x):
    """The fastest mode of the chain has ω = 2 √(k/m) at most."""
    return ran(stress.in_a_row(20, 0.1 * np.sin(np.arange(20))), STIFF, x / 40.0, 20_000)


def stays_below_three(simulation):
    return simulation.record.total_energy.max() < 3.0 * simulation.record.total_energy[0]


def part_of_a_crystal(n_atoms, cell):
    full = solid(3)
    return md.System(full.positions[:n_atoms], cell=full.cell if cell else None)


def built_at_every_step(n_atoms):
    """Pair lists and cluster lists, a hundred thousand times."""
    start = solid(3)
    cell = start.cell.vectors * (n_atoms / 108) ** (1 / 3)
    system = md.System(start.positions[:n_atoms], cell=cell, pbc=n_atoms == 108)
    return ran(system, SMOOTH, 0.002, 100_000, every=50, temperature=0.3, skin=0.0)


def was_built(simulation):
    builds, search = simulation.report().cost.list_builds, simulation.engine.interactions.pair_search
    return (builds >= 99_999 or "all pairs" in search) and is_told(simulation)


def a_million(precision):
    positions, edges = crystal("fcc", [63, 63, 63], 1.68)
    return ran(md.System(positions, cell=edges), SMOOTH, 0.004, 10, temperature=1.0, every=5, precision=precision)


def cluster():
    """Bound at T = 0.1; its drift is below four standard errors."""
    simulation = ran(solid(2, cell=False, jitter=0.02), SMOOTH, 0.004, 20_000, temperature=0.1)
    simulation.run(1_000_000, every=100, progress=False)
    return simulation


def does_not_drift(simulation):
    drift = simulation.report().energy_drift
    return abs(drift.slope) < 4.0 * drift.error and momentum_is_kept(simulation)


def far_bond():
    """Across a thousand cells."""
    system = md.System([[0.1, 0, 0], [0.1 + 1.2 + 9.0 * 1000, 0, 0]], cell=9.0, bonds=[[0, 1]])
    return ran(system, md.HarmonicBond(100.0, 1.0), 0.004, 2000)


def is_short(simulation):
    return abs(simulation.record.potential_energy[0] - 2.0) < 2e-8


CONSERVED = {  # a simulation that has run, the bound of its oscillation, what else holds
    "planet and moon": (planet_and_moon, 1e-4, orbit_closes),
    "a bond across a thousand cells": (far_bond, 0.05, is_short),
    "star": (star, 1e-2, momentum_is_kept),
    "hard cores": (lambda: ran(solid(3, jitter=0.02), md.PairPotential(hard_core, (1.0,), 1.5, "force-shifted"), 0.0002,
                               5000, temperature=1.0), 1e-2, is_finite),
    "rigid ring": (lambda: rigid(stress.rigid_ring(), 100_000), 1e-3,
                   lambda sim: lengths_are_kept(sim) and is_told(sim, 1e-11)),
    **{f"rigid chain {zigzag}": (lambda zigzag=zigzag: rigid(stress.rigid_chain(zigzag), 2000), 1e-3, lengths_are_kept)
       for zigzag in (0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1)},
    **{f"angle {angle:.9g}": (lambda angle=angle: swinging(angle), 5e-3, is_finite)
       for angle in (np.pi, np.pi - 1e-8, np.pi - 1e-3, 3.0, 1e-3, 0.0)},
    **{f"line {along}": (lambda along=along: line(along), 1e-2, stays_on(along))
       for along in ([1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1])},
    **{f"plane {normal}": (lambda normal=normal: plane(normal), 1e-2, is_finite) for normal in range(3)},
    "thin gas": (thin_gas, 1e-4, lambda sim: abs(sim.record.temperature[-1] - 2.0) < 0.04),
    "hot and dense": (lambda: ran(solid(3), SMOOTH, 0.0005, 2000, temperature=50.0, every=20), 1e-3, is_finite),
    **{f"collision {timestep}": (lambda timestep=timestep: colliding(timestep), bound,
                                 lambda sim: sim.velocities[0, 0] < 0.0)
       for timestep, bound in ((2e-5, 2e-4), (5e-6, 2e-5))},
    "jump over each other": (jumping, 1e-6, is_finite),
    **{f"masses {ratio}": (lambda ratio=ratio: of_masses(ratio), 1e-3, lambda sim: momentum_is_kept(sim, 5e-14))
       for ratio in (1e6, 1e-6)},
    **{f"dimer {potential.cutoff} {x}": (lambda potential=potential, x=x: dimer(potential, x), np.inf,
                                         stays_at_the_bottom)
       for potential in (OPEN, SMOOTH) for x in (0.1, 0.5, 1.0, 1.5, 1.9)},
    **{f"beads {x}": (lambda x=x: beads(x), 1.0, stays_below_three) for x in BELOW},
    **{f"list built at every step {n}": (lambda n=n: built_at_every_step(n), 1e-2, was_built) for n in (60, 108)},
    **{f"a million atoms {precision}": (lambda precision=precision: a_million(precision), 1e-3, momentum_is_kept)
       for precision in stress.BOTH},
    "a million steps": (cluster, 1e-2, does_not_drift),
}  # fmt: skip


@pytest.mark.parametrize("name", CONSERVED)
def test_energy_is_conserved(name):
    run, bound, also = CONSERVED[name]
    simulation = run()
    assert oscillation(simulation) < bound  # truncation
    assert also(simulation)


@pytest.mark.parametrize("cell", [None, 1.2, 30.0])
def test_one_atom_flies_straight(cell):
    system = md.System([[0.1, 0.2, 0.3]], cell=cell, velocities=[[3.0, -2.0, 1.0]])
    simulation = ran(system, SMOOTH, 0.004, 1000)
    assert np.abs(simulation.positions - [[12.1, -7.8, 4.3]]).max() < 1e-11
    assert is_finite(simulation)


@pytest.mark.parametrize("x", BELOW)
def test_an_oscillator_below_its_limit_keeps_its_modified_energy(x):
    """K + U (1 − (ωΔt)²/4) is a constant of velocity Verlet, to rounding times steps."""
    record = ran(pair_at(1.1, bonded=True), stress.SPRING, x / stress.FREQUENCY, 20_000, every=97).record
    modified = record.kinetic_energy + (1.0 - 0.25 * x * x) * record.potential_energy
    assert np.ptp(modified) < 1e-9 * record.potential_energy[0]  # rounding
    assert record.total_energy.max() < 1.01 / (1.0 - 0.25 * x * x) * record.total_energy[0]


@pytest.mark.parametrize("x", [0.1, 0.5, 0.9, 1.3, 1.41, 1.7, 1.8])
def test_a_stiff_bond_does_not_resonate_with_the_steps(x):
    """A stiff dumbbell in a soft well: no growth of the energy at any Δt ω, nor at the resonances of 1, √2 and √3."""
    positions = np.array([[0.0, 0, 0], [1.02, 0, 0], [0.5, stress.BOTTOM, 0], [0.5, -0.1, 1.2]])
    laws = [STIFF, md.LennardJones(1.0, 1.0, bonded_scale=(0, 1, 1))]
    record = ran(
        md.System(positions, bonds=[[0, 1]]), laws, x / np.sqrt(800.0), 30_000, every=50, temperature=0.001
    ).record
    width = [np.ptp(part) for part in np.array_split(record.total_energy, 3)]
    assert width[2] < 2.0 * max(width[0], 1e-6)


@pytest.mark.parametrize("temperature", [0.0, 1e-30, 1.0])
@pytest.mark.parametrize(
    ("bath", "speed"),
    [
        *((md.LangevinBAOAB, friction) for friction in (1e-300, 1e-3, 1.0, 1e3, 1e10, LARGEST)),
        *((md.StochasticVelocityRescaling, time) for time in (SMALLEST, 1e-3, 1e3, LARGEST)),
    ],
)
def test_baths_of_any_friction_or_relaxation_are_finite_and_cool_or_keep(bath, speed, temperature):
    simulation = ran(solid(3), SMOOTH, 0.002, 300, temperature=1.0, method=bath(0.002, temperature, speed, 1))
    assert is_finite(simulation)
    assert np.ptp(simulation.record.conserved_energy) < 0.2  # 108 atoms exchange some hundred ε with the bath
    if bath is md.LangevinBAOAB and speed >= 1e3:  # the last half kick comes after the bath
        assert simulation.record.temperature[-1] == pytest.approx(temperature, rel=0.3, abs=1e-4)


def test_equilibration_to_zero_stops_all_motion():
    simulation = made(solid(3), SMOOTH, 0.002, temperature=1.0)
    simulation.equilibrate(100, 0.0)
    assert not simulation.velocities.any()


@pytest.mark.parametrize("n_atoms", [63, 64, 65, 100, 101])
@pytest.mark.parametrize("cell", [True, False])
def test_scenes_at_the_thresholds_of_lists_agree(n_atoms, cell):
    """Where another list takes over: the energy is that of all pairs."""
    system = part_of_a_crystal(n_atoms, cell)
    expected = 0.5 * SMOOTH.pair_energy(md.neighbor_list("d", system, 2.5)).sum()
    assert stress.forces_of(system, SMOOTH).potential_energy == pytest.approx(expected, rel=1e-12)
    assert oscillation(ran(system, SMOOTH, 0.002, 500, temperature=0.5)) < 1e-2


SHAPES = {
    "needle": np.diag([200.0, 3.0, 3.0]),
    "sheet": np.diag([3.0, 40.0, 40.0]),
    "sheared 45 times": [[9.0, 0, 0], [400.0, 9.0, 0], [0, -300.0, 9.0]],
    "nearly flat": [[9.0, 0, 0], [0, 9.0, 0], [8.9, 0.2, 2.6]],
    "left-handed": [[0, 9.0, 0], [9.0, 0, 0], [1.0, 2.0, 9.0]],
}
GAUSS = md.PairPotential(stress.gauss, (), 2.5, "force-shifted")


def energy_of_all_pairs(positions, cell):
    return brute_force_energy(md.System(positions, cell=cell), lambda r: float(GAUSS.pair_energy(r)), 2.5)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("pbc", [True, (True, False, True), (False, True, False)])
def test_cells_of_any_shape_hold_the_energy_of_all_pairs(shape, pbc):
    cell = md.Cell.of(SHAPES[shape], pbc)
    system = md.System(np.random.default_rng(5).uniform(-1, 1, (80, 3)) @ cell.lattice, cell=cell)
    expected = energy_of_all_pairs(system.positions, md.Cell.of(cell.lattice, pbc))
    assert stress.forces_of(system, GAUSS).potential_energy == pytest.approx(expected, rel=1e-10)
    assert oscillation(ran(system, GAUSS, 0.01, 300, temperature=1.0, every=10)) < 1e-2


@pytest.mark.parametrize("cutoffs", [1.01, 1.5, 2.0, 2.3, 3.0, 10.0, 30.0, 100.0])
@pytest.mark.parametrize("n_atoms", [2, 100])
def test_boxes_of_any_number_of_cutoffs_hold_the_energy_of_all_pairs(cutoffs, n_atoms):
    edge, rng = 2.5 * cutoffs, np.random.default_rng(3)
    positions = rng.uniform(0, edge, (n_atoms, 3)) + edge * rng.integers(-3, 4, (n_atoms, 3))
    found = md.evaluate(md.System(positions, cell=edge), GAUSS)
    expected = energy_of_all_pairs(positions, md.Cell.of(edge))
    assert found.potential_energy == pytest.approx(expected, rel=1e-11, abs=1e-13)
    assert np.abs(found.forces.sum(axis=0)).max() < 1e-11
