"""Scenes that nobody asked for, and somebody will run: each conserves its energy within its bound.

A scene yields simulations that have run, and the bound of its oscillation; what else holds of it, it asserts."""

from functools import partial
from itertools import product

import numpy as np
import pytest
import stress_scenes as stress
from stress_scenes import OPEN, SMOOTH, STIFF, is_finite, made, oscillation, pair_at, ran, solid

import minimd as md
from minimd.core.structure.checks import LARGEST, SMALLEST

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them
WALL = md.PairPotential(lambda r2: (r2**-24, 48.0 * r2**-25), (), 1.5, "force-shifted")  # r⁻⁴⁸, as steep as any
BATHS = [*product([md.LangevinBAOAB], (1e-300, 1e-3, 1.0, 1e3, 1e10, LARGEST))]
BATHS += product([md.StochasticVelocityRescaling], (SMALLEST, 1e-3, 1e3, LARGEST))


def momentum_is_kept(simulation, bound=1e-12):
    """To rounding."""
    record = simulation.record
    return np.abs(record.momentum - record.momentum[0]).max() < bound * record.absolute_momentum[0]


def swinging(angle):
    """Atoms without a pair law: the angle passes 180 degrees, where its sine vanishes."""
    positions = [[0, 0, 0], [1, 0, 0], [1 - np.cos(angle + 1e-3), np.sin(angle + 1e-3), 0]]
    system = md.System(positions, bonds=[[0, 1], [1, 2]])
    return ran(system, [md.HarmonicAngle(50.0, angle, [[0, 1, 2]]), STIFF], 0.002, 20_000, temperature=0.5)


PLANE = np.array(list(np.ndindex(15, 15))) * 1.1
FLYING_BY = md.System([[0, 0, 0], [4.0, 0.1, 0]], velocities=[[1000.0, 0, 0], [-1000.0, 0, 0]])
WITHIN = {  # a run, and the bound of its oscillation
    "hard cores": (lambda: ran(solid(3, jitter=0.02), WALL, 0.0002, 5000, temperature=1.0), 1e-2),
    "hot dense start": (lambda: ran(solid(3), SMOOTH, 0.0005, 2000, temperature=50.0, every=20), 1e-3),
    "jumping over each other": (lambda: ran(FLYING_BY, OPEN, 0.004, 100), 1e-6),  # without a cutoff nothing is seen
}
for _k in range(3):
    WITHIN[f"plane {_k}"] = partial(ran, md.System(np.insert(PLANE, _k, 0.0, axis=1)), SMOOTH, 0.004, 300), 1e-2
for _angle in (np.pi, np.pi - 1e-8, np.pi - 1e-3, 3.0, 1e-3, 0.0):
    WITHIN[f"angle {_angle}"] = partial(swinging, _angle), 5e-3


def open_space():
    """A moon a million times lighter; a bond across a thousand cells; 500 springs on one atom, exclusions and all."""
    gravity = md.PairPotential(lambda r2, q: (-q / r2**0.5, -q / (r2 * r2**0.5)), (1.0,), truncation="truncated")
    system = md.System([[0, 0, 0], [1, 0, 0]], velocities=[[0, -1e-6, 0], [0, 1, 0]], masses=[1e6, 1.0])
    simulation = ran(system, gravity, 0.01, 62_832, every=50)  # a thousand orbits
    assert np.linalg.norm(np.diff(simulation.positions, axis=0)) == pytest.approx(1.0, abs=1e-3)
    yield simulation, 1e-4
    system = md.System([[0.1, 0, 0], [0.1 + 1.2 + 9.0 * 1000, 0, 0]], cell=9.0, bonds=[[0, 1]])
    simulation = ran(system, md.HarmonicBond(100.0, 1.0), 0.004, 2000)
    assert simulation.record.potential_energy[0] == pytest.approx(0.5 * 100.0 * 0.2**2, rel=1e-8)
    yield simulation, 0.05
    arms = np.random.default_rng(1).standard_normal((500, 3))
    arms *= 6.0 / np.linalg.norm(arms, axis=1, keepdims=True)
    system = md.System(np.vstack([[0, 0, 0], arms]), bonds=[[0, k] for k in range(1, 501)])
    gauss = lambda r2: (np.exp(-r2), 2.0 * np.exp(-r2))  # noqa: E731
    soft = md.PairPotential(gauss, (), 2.5, "force-shifted", bonded_scale=(0, 1, 1))
    simulation = ran(system, [soft, md.HarmonicBond(10.0, 6.0)], 0.002, 1000, temperature=0.5)
    assert momentum_is_kept(simulation)
    yield simulation, 1e-2
    thin = md.System(np.array(list(np.ndindex(10, 10, 10))) * 21.5, cell=215.0)
    simulation = ran(thin, SMOOTH, 0.005, 5000, temperature=2.0)
    assert simulation.record.temperature[-1] == pytest.approx(2.0, rel=0.02)
    yield simulation, 1e-4


def rigid(n_steps, scene, momentum):
    """A ring; chains near 180 degrees."""
    system, bonds = scene
    simulation = ran(system, stress.WEAK, 0.002, n_steps, temperature=1.0, constraints=bonds)
    assert simulation.record.constraint_violation.max() < 1e-14  # rounding
    assert simulation.report().energy_is_conserved or momentum == np.inf
    assert momentum_is_kept(simulation, momentum)
    yield simulation, 1e-3


def lines_collisions_and_masses():
    """A row of atoms; two at a hundred times thermal speed; masses a million times apart."""
    for along in ([1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]):
        simulation = ran(md.System(1.1 * np.arange(300)[:, None] * along / np.linalg.norm(along)), SMOOTH, 0.004, 300)
        assert np.abs(np.cross(simulation.positions, along)).max() < 1e-9
        yield simulation, 1e-2
    for timestep, bound in ((2e-5, 2e-4), (5e-6, 2e-5)):
        system = md.System([[0, 0, 0], [5, 0.1, 0]], velocities=[[100.0, 0, 0], [-100.0, 0, 0]])
        simulation = ran(system, SMOOTH, timestep, round(0.08 / timestep), every=10)
        assert simulation.velocities[0, 0] < 0.0
        yield simulation, bound
    for ratio in (1e6, 1e-6):  # the light ones set the time step: Δt ∝ √m
        system = solid(3, masses=np.where(np.arange(108) % 2, 1.0, ratio))
        simulation = ran(system, SMOOTH, 0.002 * min(1.0, ratio) ** 0.5, 2000, temperature=1.0)
        assert np.ptp(simulation.record.momentum, axis=0).max() < 1e-13 * simulation.record.absolute_momentum[0]
        yield simulation, 1e-3


def dimer_below_its_limit(potential, x):
    """The well is not a parabola: what is stable for a small amplitude only."""
    simulation = ran(pair_at(stress.BOTTOM + 0.001), potential, x / np.sqrt(2.0 * stress.CURVATURE), 20_000, every=7)
    assert np.ptp(simulation.record.total_energy) < 2e-3
    assert np.linalg.norm(np.diff(simulation.positions, axis=0)) == pytest.approx(stress.BOTTOM, abs=0.05)
    yield simulation, np.inf


def springs_below_their_limit(x):
    """The fastest mode of a chain has ω = 2 √(k/m) at most.
    K + U (1 − (ωΔt)²/4) of an oscillator is a constant of velocity Verlet, to rounding times steps."""
    simulation = ran(stress.in_a_row(20, 0.1 * np.sin(np.arange(20))), STIFF, x / 40.0, 20_000)
    assert simulation.record.total_energy.max() < 3.0 * simulation.record.total_energy[0]
    yield simulation, 1.0
    simulation = ran(pair_at(1.1, bonded=True), stress.SPRING, x / stress.FREQUENCY, 20_000, every=97)
    record = simulation.record
    modified = record.kinetic_energy + (1.0 - 0.25 * x * x) * record.potential_energy
    assert np.ptp(modified) < 1e-9 * record.potential_energy[0]  # rounding
    assert record.total_energy.max() < 1.01 / (1.0 - 0.25 * x * x) * record.total_energy[0]
    yield simulation, np.inf


def million_atoms():
    simulation = ran(solid(63, jitter=0.0), SMOOTH, 0.004, 10, temperature=1.0, every=5)
    assert momentum_is_kept(simulation)
    yield simulation, 1e-3


def stiff_bond_among_its_resonances(x):
    """A stiff dumbbell in a soft well: no growth of the energy at any Δt ω, nor at the resonances of 1, √2 and √3."""
    positions = np.array([[0.0, 0, 0], [1.02, 0, 0], [0.5, stress.BOTTOM, 0], [0.5, -0.1, 1.2]])
    system, soft = md.System(positions, bonds=[[0, 1]]), md.LennardJones(1.0, 1.0, bonded_scale=(0, 1, 1))
    simulation = ran(system, [STIFF, soft], x / np.sqrt(800.0), 30_000, every=50, temperature=0.001)
    width = [np.ptp(part) for part in np.array_split(simulation.record.total_energy, 3)]
    assert width[2] < 2.0 * max(width[0], 1e-6)
    yield simulation, np.inf


ZIGZAGS = (0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1)
CONSERVED = {scene: [()] for scene in (open_space, lines_collisions_and_masses, million_atoms)} | {
    rigid: [(100_000, stress.rigid_ring(), 1e-11), *((2000, stress.rigid_chain(z), np.inf) for z in ZIGZAGS)],
    dimer_below_its_limit: product((OPEN, SMOOTH), (0.1, 0.5, 1.0, 1.5, 1.9)),
    springs_below_their_limit: [(x,) for x in (0.1, 0.5, 1.0, 1.5, 1.9, 1.99)],  # Δt ω
    stiff_bond_among_its_resonances: [(x,) for x in (0.1, 0.5, 0.9, 1.3, 1.41, 1.7, 1.8)],
}
CASES = [(scene, given) for scene, rows in CONSERVED.items() for given in rows]
CASES += [(lambda run=run, bound=bound: [(run(), bound)], ()) for run, bound in WITHIN.values()]


@pytest.mark.parametrize(("scene", "given"), CASES)
def test_energy_is_conserved(scene, given):
    for simulation, bound in scene(*given):
        assert is_finite(simulation)
        assert oscillation(simulation) < bound  # truncation


@pytest.mark.parametrize("temperature", [0.0, 1e-30, 1.0])
@pytest.mark.parametrize(("bath", "speed"), BATHS)
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
