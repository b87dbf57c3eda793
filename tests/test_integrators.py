"""Laws of the splittings: order, symplecticity, reversal, invariants. METHODS is where a new one is registered."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize

from minimd.integrators import METHODS, Drift, Kick, Leapfrog, Splitting, VelocityVerlet

REVERSIBLE = list(METHODS.values())


def state(positions, velocities, masses=None):
    positions = np.array(positions, dtype=float).reshape(-1, 3)
    masses = np.ones(len(positions)) if masses is None else np.array(masses, dtype=float)
    return SimpleNamespace(
        positions=positions,
        velocities=np.array(velocities, dtype=float).reshape(-1, 3),
        forces=np.zeros_like(positions),
        inverse_masses=1.0 / masses,
        forces_are_current=False,
        stop_requested=False,
    )


def kepler(s, look=False):
    s.forces[:] = -s.positions / np.linalg.norm(s.positions, axis=1, keepdims=True) ** 3


def oscillator(omega):
    def forces(s, look=False):
        s.forces[:] = -(omega**2) * s.positions

    return forces


def springs(s, look=False):
    """Three bodies in the plane, each pulling each: translation and rotation invariant, not linear."""
    for i in range(3):
        d = s.positions - s.positions[i]
        s.forces[i] = (d * (np.linalg.norm(d, axis=1, keepdims=True) ** 2)).sum(axis=0)


def final_error(method, dt, e=0.3, t=5.0):
    """Distance from the exact position at time t on the Kepler orbit of unit semi-axis that starts at its pericentre."""
    s = state([1 - e, 0, 0], [0, np.sqrt((1 + e) / (1 - e)), 0])
    n = round(t / dt)
    method(t / n).advance(s, kepler, n)
    anomaly = optimize.brentq(lambda x: x - e * np.sin(x) - t, 0.0, 2 * np.pi, xtol=1e-15)
    exact = [np.cos(anomaly) - e, np.sqrt(1 - e * e) * np.sin(anomaly), 0.0]
    return np.linalg.norm(s.positions[0] - exact)


@pytest.mark.parametrize("method", METHODS.values())
def test_measured_order_is_the_declared_order(method):
    timesteps = 0.02 / 2.0 ** np.arange(4)
    slope = np.polyfit(np.log(timesteps), np.log([final_error(method, dt) for dt in timesteps]), 1)[0]
    assert slope == pytest.approx(method.order, abs=0.1)  # truncation


@pytest.mark.parametrize("method", METHODS.values())
def test_kicks_and_drifts_of_a_step_each_add_up_to_one(method):
    for kind in (Kick, Drift):
        assert sum(stage.coefficient for stage in method.stages if isinstance(stage, kind)) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("method", REVERSIBLE)
def test_reversal_returns_to_the_start(method):
    rng = np.random.default_rng(1)
    start = rng.normal(size=(3, 3)), 0.3 * rng.normal(size=(3, 3))
    s = state(*start)
    method(0.02).advance(s, springs, 400)
    away = np.abs(s.positions - start[0]).max()
    s.velocities *= -1.0
    method(0.02).advance(s, springs, 400)
    assert away > 0.1
    assert np.abs(s.positions - start[0]).max() < 1e-10  # rounding, amplified by the dynamics
    assert np.abs(s.velocities + start[1]).max() < 1e-10


@pytest.mark.parametrize("method", METHODS.values())
def test_step_is_symplectic(method):
    """JᵀΩJ = Ω for the Jacobian of ten steps, by central differences."""
    start, h = np.array([0.7, 0.1, 0.0, -0.1, 1.2, 0.05]), 1e-6

    def flow(z):
        s = state(z[:3], z[3:])
        method(0.1).advance(s, kepler, 10)
        return np.concatenate([s.positions[0], s.velocities[0]])

    jacobian = np.column_stack([(flow(start + h * unit) - flow(start - h * unit)) / (2 * h) for unit in np.eye(6)])
    omega = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    assert np.abs(jacobian.T @ omega @ jacobian - omega).max() < 1e-7  # truncation h², rounding 1/h


@pytest.mark.parametrize("method", METHODS.values())
def test_linear_and_angular_momentum_are_kept_to_rounding(method):
    rng = np.random.default_rng(2)
    masses = np.array([1.0, 3.0, 0.2])
    s = state(rng.normal(size=(3, 3)), 0.3 * rng.normal(size=(3, 3)), masses)
    linear, angular = masses @ s.velocities, masses @ np.cross(s.positions, s.velocities)
    method(0.01).advance(s, springs, 2000)
    assert np.abs(masses @ s.velocities - linear).max() < 1e-12
    assert np.abs(masses @ np.cross(s.positions, s.velocities) - angular).max() < 1e-12


@pytest.mark.parametrize("method", [VelocityVerlet, Leapfrog])
def test_verlet_conserves_the_modified_energy_of_the_oscillator_exactly(method):
    """v² + ω² x² (1 − (ωΔt)²/4) is constant to rounding, up to the stability limit ωΔt = 2."""
    for omega_dt in (0.1, 1.0, 1.9):
        omega, dt = 2.0, omega_dt / 2.0
        s = state([1.0, 0, 0], [0.3, 0, 0])

        def modified(s, omega=omega, dt=dt):
            return (s.velocities[0, 0] ** 2 + omega**2 * s.positions[0, 0] ** 2 * (1 - (omega * dt) ** 2 / 4)).item()

        before = modified(s)
        method(dt).advance(s, oscillator(omega), 10_000)
        assert modified(s) == pytest.approx(before, rel=1e-11)


def test_verlet_is_unstable_just_beyond_its_limit():
    s = state([1.0, 0, 0], [0, 0, 0])
    VelocityVerlet(1.01).advance(s, oscillator(2.0), 500)
    assert np.abs(s.positions).max() > 1e6


def test_leapfrog_positions_are_those_of_velocity_verlet():
    ends = []
    for method in (VelocityVerlet, Leapfrog):
        s = state([0.7, 0, 0], [0, 1.3, 0])
        method(0.01).advance(s, kepler, 1000)
        ends.append((s.positions, s.velocities))
    assert ends[0][0] == pytest.approx(ends[1][0], abs=1e-11)
    assert ends[0][1] == pytest.approx(ends[1][1], abs=1e-11)


@pytest.mark.parametrize("method", METHODS.values())
def test_one_force_evaluation_per_step_and_one_look(method):
    looks = []

    def forces(s, look):
        looks.append(look)
        kepler(s)

    s = state([1, 0, 0], [0, 1, 0])
    method(0.01).advance(s, forces, 50)
    per_step = sum(isinstance(stage, Kick) for stage in method.stages) - (isinstance(method.stages[0], Kick) and isinstance(method.stages[-1], Kick))
    assert len(looks) <= 50 * per_step + 1
    if isinstance((method.stages + method.closing)[-1], Kick):
        assert looks == [False] * (len(looks) - 1) + [True]


@pytest.mark.parametrize("method", METHODS.values())
def test_many_steps_are_the_single_steps(method):
    """Merging kicks between steps changes rounding only."""
    together, alone = (state([0.8, 0, 0.1], [0, 1.1, 0]) for _ in range(2))
    method(0.02).advance(together, kepler, 200)
    for _ in range(200):
        method(0.02).advance(alone, kepler, 1)
    assert together.positions == pytest.approx(alone.positions, abs=1e-11)
    assert together.velocities == pytest.approx(alone.velocities, abs=1e-11)


def test_a_new_method_is_a_row_of_coefficients():
    """Ruth's third-order method, written here as a user would, has order 3."""

    class Ruth3(Splitting):
        name = "ruth-3"
        stages = (Kick(7 / 24), Drift(2 / 3), Kick(3 / 4), Drift(-2 / 3), Kick(-1 / 24), Drift(1.0))
        order = 3
        source = "R. D. Ruth, IEEE Trans. Nucl. Sci. 30, 2669 (1983)"

    timesteps = 0.004 / 2.0 ** np.arange(4)
    slope = np.polyfit(np.log(timesteps), np.log([final_error(Ruth3, dt, t=2.0) for dt in timesteps]), 1)[0]
    assert slope == pytest.approx(3.0, abs=0.1)


def test_stop_request_ends_at_a_whole_step():
    s = state([1, 0, 0], [0, 1, 0])

    def forces(s, look):
        kepler(s)
        s.stop_requested = s.positions[0, 0] < 0.9

    done = VelocityVerlet(0.01).advance(s, forces, 1000)
    other = state([1, 0, 0], [0, 1, 0])
    VelocityVerlet(0.01).advance(other, kepler, done)
    assert done < 100
    assert s.positions == pytest.approx(other.positions, abs=1e-14)
    assert s.velocities == pytest.approx(other.velocities, abs=1e-14)


def test_every_method_names_its_source():
    for name, method in METHODS.items():
        assert method.name == name
        assert len(method.source) > 20
        assert method(0.1).timestep == 0.1
