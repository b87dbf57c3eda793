"""Time steps: up to the limit of stability 2/ω energies are bounded, past it the run is stopped with a sentence."""

import numpy as np
import pytest
from stress_scenes import BOTTOM, CURVATURE, LAST_GOOD, OPEN, SMOOTH, assert_stops, is_finite, oscillation, ran, solid

import minimd as md

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them

BELOW = [0.1, 0.5, 1.0, 1.5, 1.9, 1.99]  # Δt ω
ABOVE = [2.001, 2.01, 2.1, 2.5, 4.0]
FREQUENCY = np.sqrt(2.0)  # of two unit masses on a spring with k = 1
SPRING = md.HarmonicBond(1.0, 1.0)
BEADS = np.arange(20)


def dumbbell():
    return md.System([[0, 0, 0], [1.1, 0, 0]], bonds=[[0, 1]])


def chain():
    return md.System(
        np.column_stack([BEADS, 0.1 * np.sin(BEADS), 0.0 * BEADS]), bonds=np.column_stack([BEADS[:-1], BEADS[1:]])
    )


def dimer():
    return md.System([[0, 0, 0], [BOTTOM + 0.001, 0, 0]])


@pytest.mark.parametrize("x", BELOW)
def test_an_oscillator_below_its_limit_keeps_its_modified_energy(x):
    """K + U (1 − (ωΔt)²/4) is a constant of velocity Verlet, to rounding times steps."""
    record = ran(dumbbell(), SPRING, x / FREQUENCY, 20_000, every=97).record
    modified = record.kinetic_energy + (1.0 - 0.25 * x * x) * record.potential_energy
    assert np.ptp(modified) < 1e-9 * record.potential_energy[0]  # rounding
    assert record.total_energy.max() < 1.01 / (1.0 - 0.25 * x * x) * record.total_energy[0]


@pytest.mark.parametrize("n_steps", [150, 1000, 5000])
@pytest.mark.parametrize("x", ABOVE)
def test_an_oscillator_above_its_limit_is_stopped(x, n_steps):
    if x == 2.001 and n_steps == 150:
        pytest.skip("the energy has only doubled ten times")
    for every in (100, 10**6):
        simulation = md.Simulation(dumbbell(), SPRING, md.VelocityVerlet(x / FREQUENCY))
        message = assert_stops(
            "total energy has gone from 0.005 to|not finite",
            lambda sim=simulation, every=every: sim.run(n_steps, every=every),
        )
        assert "too large" in message
        assert np.abs(simulation.positions).max() < 1e4  # the state it was left in is one from before


@pytest.mark.parametrize("potential", [OPEN, SMOOTH])
@pytest.mark.parametrize("x", [0.1, 0.5, 1.0, 1.5, 1.9])
def test_a_lennard_jones_dimer_below_its_limit_is_bounded(potential, x):
    """The well is not a parabola: what is stable for a small amplitude only."""
    simulation = ran(dimer(), potential, x / np.sqrt(2.0 * CURVATURE), 20_000, every=7)
    assert np.ptp(simulation.record.total_energy) < 2e-3
    assert np.linalg.norm(simulation.positions[1] - simulation.positions[0]) == pytest.approx(BOTTOM, abs=0.05)


@pytest.mark.parametrize("potential", [OPEN, SMOOTH])
@pytest.mark.parametrize("x", [2.2, 3.0, 5.0, 10.0, 30.0])
def test_a_lennard_jones_dimer_above_its_limit_is_stopped_or_told(potential, x):
    """It is thrown apart once: with an energy that a scene might have, which the report tells, or with one that stops the run."""
    simulation = md.Simulation(dimer(), potential, md.VelocityVerlet(x / np.sqrt(2.0 * CURVATURE)))
    words = ""
    try:
        simulation.run(5000)
    except md.NonFiniteError as error:
        words = str(error)
    if words:
        assert "atoms 0 and 1" in words
        assert "too large" in words
    else:
        assert is_finite(simulation)
        assert np.ptp(simulation.record.total_energy) > 0.5
        assert not simulation.report().energy_is_conserved


@pytest.mark.parametrize("x", BELOW)
def test_a_bead_chain_below_its_limit_is_bounded(x):
    """Its fastest mode has ω = 2 √(k/m) at most."""
    simulation = ran(chain(), md.HarmonicBond(400.0, 1.0), x / 40.0, 20_000)
    assert oscillation(simulation) < 1.0
    assert simulation.record.total_energy.max() < 3.0 * simulation.record.total_energy[0]


@pytest.mark.parametrize("x", [2.05, 2.5, 4.0])
def test_a_bead_chain_above_its_limit_is_stopped(x):
    message = assert_stops(
        "total energy has gone from", lambda: ran(chain(), md.HarmonicBond(400.0, 1.0), x / 40.0, 5000)
    )
    assert "too large" in message


@pytest.mark.parametrize("x", [0.1, 0.5, 0.9, 1.3, 1.41, 1.7, 1.8])
def test_a_stiff_bond_does_not_resonate_with_the_steps(x):
    """A stiff dumbbell in a soft well: no growth of the energy at any Δt ω, also not at 1, √2 and √3 with their resonances."""
    positions = np.array([[0.0, 0, 0], [1.02, 0, 0], [0.5, BOTTOM, 0], [0.5, -0.1, 1.2]])
    bond, soft = md.HarmonicBond(400.0, 1.0), md.LennardJones(1.0, 1.0, bonded_scale=(0, 1, 1))
    system = md.System(positions, bonds=[[0, 1]])
    record = ran(system, [bond, soft], x / np.sqrt(800.0), 30_000, every=50, temperature=0.001).record
    width = [np.ptp(part) for part in np.array_split(record.total_energy, 3)]
    assert width[2] < 2.0 * max(width[0], 1e-6)


def test_a_hot_dense_start_is_conserved_with_a_small_step():
    """T* = 50 at density 0.84: atoms come as near as 0.6 σ."""
    simulation = ran(solid(3), SMOOTH, 0.0005, 2000, temperature=50.0, every=20)
    assert is_finite(simulation)
    assert oscillation(simulation) < 1e-3  # truncation


def test_a_hot_dense_start_with_a_large_step_is_stopped():
    assert_stops(
        f"too hot, timestep 0.01 τ too large.*\\n.*moves .* in one step.*atoms .* σ apart.* {LAST_GOOD}",
        lambda: ran(solid(3), SMOOTH, 0.01, 2000, temperature=50.0),
    )


@pytest.mark.parametrize(("timestep", "bound"), [(2e-5, 2e-4), (5e-6, 2e-5)])
def test_a_collision_at_a_hundred_times_thermal_speed_is_conserved_with_a_small_step(timestep, bound):
    system = md.System([[0, 0, 0], [5, 0.1, 0]], velocities=[[100.0, 0, 0], [-100.0, 0, 0]])
    simulation = ran(system, SMOOTH, timestep, round(0.08 / timestep), every=10)
    assert oscillation(simulation) < bound  # truncation
    assert simulation.velocities[0, 0] < 0.0


@pytest.mark.parametrize("speed", [100.0, 1000.0])
@pytest.mark.parametrize("potential", [OPEN, SMOOTH])
def test_a_collision_at_a_hundred_times_thermal_speed_with_a_large_step_is_stopped(potential, speed):
    """Without a cutoff nothing says that an atom has passed another: the energy must."""
    system = md.System([[0, 0, 0], [4.0, 0.1, 0]], velocities=[[speed, 0, 0], [-speed, 0, 0]])
    if potential is OPEN and speed == 1000.0:
        simulation = ran(system, potential, 0.004, 100)  # they jump over each other, and meet nobody
        assert oscillation(simulation) < 1e-6
        return
    assert_stops("moves .* in one step|total energy has gone", lambda: ran(system, potential, 0.004, 100))


def test_a_negative_time_step_runs_back():
    start = solid(3)
    there = ran(start, SMOOTH, 0.004, 300, temperature=1.0)
    back = ran(there.system, SMOOTH, -0.004, 300)
    assert np.abs(back.positions - start.positions).max() < 1e-10  # rounding, times the growth of a disturbance
    assert back.time == pytest.approx(-1.2)


def test_no_step_is_a_look():
    simulation = ran(solid(2, cell=False), SMOOTH, 0.004, 0, temperature=1.0)
    assert simulation.step == 0
    assert len(simulation.record) == 1


@pytest.mark.parametrize("masses", [1e6, 1e-6])
def test_masses_a_million_times_apart_conserve_energy(masses):
    """The light ones set the time step: Δt ∝ √m."""
    system = solid(3, masses=np.where(np.arange(108) % 2, 1.0, masses))
    simulation = ran(system, SMOOTH, 0.002 * min(1.0, masses) ** 0.5, 2000, temperature=1.0)
    assert oscillation(simulation) < 1e-3
    assert np.ptp(simulation.record.momentum, axis=0).max() < 1e-13 * simulation.record.absolute_momentum[0]


@pytest.mark.slow
def test_a_million_steps_drift_less_than_their_standard_error():
    """A cluster of 13 atoms bound at T = 0.1: four standard errors."""
    simulation = ran(solid(2, cell=False, jitter=0.02), SMOOTH, 0.004, 20_000, temperature=0.1)
    record = simulation.run(1_000_000, every=100)
    drift = simulation.report().energy_drift
    print(f"drift {drift}, oscillation {oscillation(simulation):.1e}, momentum {np.abs(record.momentum).max():.1e}")
    assert abs(drift.slope) < 4.0 * drift.error
    assert oscillation(simulation) < 1e-2
    assert np.abs(record.momentum - record.momentum[0]).max() < 1e-12 * record.absolute_momentum[0]
