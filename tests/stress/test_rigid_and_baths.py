"""Constraints and heat baths at their limits."""

import numpy as np
import pytest
from stress_scenes import SMOOTH, assert_stops, is_finite, oscillation, ran, solid

import minimd as md
from minimd.structure.checks import LARGEST, SMALLEST

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them

WEAK = md.LennardJones(1e-3, 0.5)


def ring(n_atoms):
    angles, radius = 2.0 * np.pi * np.arange(n_atoms) / n_atoms, 0.5 / np.sin(np.pi / n_atoms)
    pairs = np.column_stack([np.arange(n_atoms), (np.arange(n_atoms) + 1) % n_atoms])
    positions = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), 0.0 * angles])
    return md.System(positions), md.DistanceConstraints(pairs)


def chain(n_atoms, zigzag):
    k = np.arange(n_atoms)
    return md.System(np.column_stack([k, zigzag * (-1.0) ** k, 0.0 * k])), md.DistanceConstraints(
        np.column_stack([k[:-1], k[1:]])
    )


@pytest.mark.slow
def test_a_ring_is_a_ring_after_a_hundred_thousand_steps():
    system, bonds = ring(12)
    simulation = ran(system, WEAK, 0.002, 100_000, temperature=1.0, constraints=bonds)
    record = simulation.record
    assert record.constraint_violation.max() < 1e-14  # rounding
    assert oscillation(simulation) < 1e-3
    assert simulation.report().energy_is_conserved
    assert np.abs(record.momentum).max() < 1e-11 * record.absolute_momentum[0]


@pytest.mark.parametrize("zigzag", [0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1])
def test_a_rigid_chain_near_180_degrees_bends(zigzag):
    system, bonds = chain(10, zigzag)
    simulation = ran(system, WEAK, 0.002, 2000, temperature=1.0, constraints=bonds)
    assert simulation.record.constraint_violation.max() < 1e-14
    assert oscillation(simulation) < 1e-3


@pytest.mark.parametrize("scene", [ring(12), chain(10, 1e-3)], ids=["ring", "chain"])
@pytest.mark.parametrize("timestep", [0.1, 0.3, 1.0, 10.0, 1e6])
def test_rigid_bonds_with_a_long_time_step_are_named(scene, timestep):
    system, bonds = scene
    words = r"constraint \d+ \(atoms \d+-\d+\) cannot be kept"
    message = assert_stops(
        words, lambda: ran(system, WEAK, timestep, 2000, temperature=1.0, constraints=bonds), md.ConstraintError
    )
    assert "reduce the timestep" in message


@pytest.mark.parametrize("angle", [np.pi, np.pi - 1e-8, np.pi - 1e-3, 3.0, 1e-3, 0.0])
def test_an_angle_near_0_or_180_degrees_swings_through(angle):
    """Atoms without a pair law: the angle passes 180 degrees, where its sine vanishes."""
    positions = [[0, 0, 0], [1, 0, 0], [1 - np.cos(angle + 1e-3), np.sin(angle + 1e-3), 0]]
    system = md.System(positions, bonds=[[0, 1], [1, 2]])
    terms = [md.HarmonicAngle(50.0, angle, [[0, 1, 2]]), md.HarmonicBond(400.0, 1.0)]
    simulation = ran(system, terms, 0.002, 20_000, temperature=0.5)
    assert is_finite(simulation)
    assert oscillation(simulation) < 5e-3


def test_atoms_bonded_on_one_spot_are_named():
    straight = md.System([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bonds=[[1, 2]])
    assert_stops("atoms 1 and 2, 0 σ apart", lambda: ran(straight, md.HarmonicBond(50.0, 1.0), 0.01, 10))
    assert_stops("atoms 1 and 2, 0 σ apart", lambda: ran(straight, md.HarmonicAngle(5.0, 2.0, [[0, 1, 2]]), 0.01, 10))
    assert_stops(
        "1 and 2 are at the same place",
        lambda: ran(straight, WEAK, 0.01, 10, constraints=md.DistanceConstraints([[1, 2]])),
        ValueError,
    )


@pytest.mark.parametrize("friction", [1e-300, 1e-3, 1.0, 1e3, 1e10, LARGEST])
@pytest.mark.parametrize("temperature", [0.0, 1e-30, 1.0])
def test_langevin_with_any_friction_is_finite_and_cools_or_keeps(friction, temperature):
    simulation = ran(
        solid(3), SMOOTH, 0.002, 300, temperature=1.0, method=md.LangevinBAOAB(0.002, temperature, friction, 1)
    )
    conserved = simulation.record.conserved_energy
    assert is_finite(simulation)
    assert np.ptp(conserved) < 0.2  # 108 atoms that exchange some hundred ε with the bath
    if friction >= 1e3:
        assert simulation.record.temperature[-1] == pytest.approx(
            temperature, rel=0.3, abs=1e-4
        )  # the last half kick comes after the bath


@pytest.mark.parametrize("relaxation_time", [SMALLEST, 1e-3, 1e3, LARGEST])
@pytest.mark.parametrize("temperature", [0.0, 1e-30, 1.0])
def test_rescaling_with_any_relaxation_is_finite(relaxation_time, temperature):
    simulation = ran(
        solid(3),
        SMOOTH,
        0.002,
        300,
        temperature=1.0,
        method=md.StochasticVelocityRescaling(0.002, temperature, relaxation_time, 1),
    )
    assert is_finite(simulation)
    assert np.ptp(simulation.record.conserved_energy) < 0.2


@pytest.mark.parametrize(
    "method",
    [md.LangevinBAOAB(0.002, 1e10, 1e3, 1), md.StochasticVelocityRescaling(0.002, 1e10, 1e-3, 1)],
    ids=["Langevin", "rescaling"],
)
def test_a_bath_too_hot_for_the_step_stops(method):
    assert_stops(
        "moves .* in one step, past every neighbor",
        lambda: ran(solid(3), SMOOTH, 0.002, 300, temperature=1.0, method=method),
    )


@pytest.mark.parametrize("x", [2.1, 3.0])
@pytest.mark.parametrize(
    "bath", [lambda dt: md.LangevinBAOAB(dt, 1.0, 0.01, 1), lambda dt: md.StochasticVelocityRescaling(dt, 1.0, 1e4, 1)]
)
def test_a_weak_bath_does_not_hide_an_instability(bath, x):
    system = md.System([[0, 0, 0], [1.1, 0, 0]], bonds=[[0, 1]])
    assert_stops(
        "conserved energy has gone|not finite",
        lambda: ran(system, md.HarmonicBond(1.0, 1.0), 1.0, 2000, temperature=1.0, method=bath(x / np.sqrt(2.0))),
    )


@pytest.mark.parametrize(("k", "start"), [(400.0, 1.0), (1.0, 0.1)])
def test_equilibration_does_not_hide_a_blow_up(k, start):
    """Velocities are rescaled every few steps: what flies apart would look like a scene at that temperature."""
    law = md.HarmonicBond(k, 1.0) if k > 1.0 else md.LennardJones(1.0, 1.0)
    simulation = md.Simulation(
        md.System([[0, 0, 0], [start + 0.1 * (k > 1.0), 0, 0], [2, 2, 2]], bonds=[[0, 1]]),
        law,
        md.VelocityVerlet(3.0 / 800**0.5),
    )
    simulation.set_temperature(1.0, seed=1)
    assert_stops("(kinetic|total) energy has gone", lambda: simulation.equilibrate(2000, 1.0))
    assert np.abs(simulation.positions).max() < 100.0


def test_equilibration_to_zero_and_to_hot_temperatures():
    simulation = md.Simulation(solid(3), SMOOTH, md.VelocityVerlet(0.002))
    simulation.set_temperature(1.0, seed=1)
    simulation.equilibrate(100, 0.0)
    assert not simulation.velocities.any()
    simulation.set_temperature(1.0, seed=1)
    assert_stops("moves .* in one step", lambda: simulation.equilibrate(100, 1e9))
