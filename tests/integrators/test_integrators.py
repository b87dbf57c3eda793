"""Laws of the splittings: order, symplecticity, reversal, invariants. SPLITTINGS is where a new one is registered."""

import numpy as np
import pytest
from scipy import optimize

from minimd.integrators import (
    SE1,
    SE2,
    SPLITTINGS,
    Drift,
    Kick,
    Leapfrog,
    PositionVerlet,
    Splitting,
    State,
    VelocityVerlet,
    adjoint,
    compose,
)
from minimd.integrators.ode.stormer import stormer_summed, stormer_two_step
from minimd.integrators.splitting.state import Surroundings

REVERSIBLE = [method for method in SPLITTINGS.values() if method.is_symmetric]
OTHERS = [method for method in SPLITTINGS.values() if not method.is_symmetric]
EULERS = [SE1, SE2]
STEPS = {1: 3000, 2: 300, 3: 1000, 4: 100, 6: 60, 8: 20}  # per unit of time, by order: small errors, above rounding


def state(positions, velocities, masses=None):
    positions = np.array(positions, dtype=float).reshape(-1, 3)
    masses = np.ones(len(positions)) if masses is None else np.array(masses, dtype=float)
    return State(positions, np.array(velocities, dtype=float).reshape(-1, 3), np.zeros_like(positions), 1.0 / masses)


def kepler(s, with_energy=False):
    s.forces[:] = -s.positions / np.linalg.norm(s.positions, axis=1, keepdims=True) ** 3


def oscillator(omega):
    def forces(s, with_energy=False):
        s.forces[:] = -(omega**2) * s.positions

    return forces


def springs(s, with_energy=False):
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


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_measured_order_is_the_answered_order(method):
    timesteps = 1.0 / STEPS[method.order] / 1.25 ** np.arange(4)
    slope = np.polyfit(np.log(timesteps), np.log([final_error(method, dt, e=0.6, t=2.0) for dt in timesteps]), 1)[0]
    assert slope == pytest.approx(method.order, abs=0.1)  # truncation


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_kicks_and_drifts_of_a_step_each_add_up_to_one(method):
    for kind in (Kick, Drift):
        assert sum(substep.coefficient for substep in method.substeps if isinstance(substep, kind)) == pytest.approx(
            1.0, abs=1e-15
        )


def returned(method, dt=0.02, n_steps=400):
    """Start, distance travelled, and the state after going there, turning the velocities around, and going back."""
    rng = np.random.default_rng(1)
    start = rng.normal(size=(3, 3)), 0.3 * rng.normal(size=(3, 3))
    s = state(*start)
    method(dt).advance(s, springs, n_steps)
    away = np.abs(s.positions - start[0]).max()
    s.velocities *= -1.0
    method(dt).advance(s, springs, n_steps)
    return away, max(np.abs(s.positions - start[0]).max(), np.abs(s.velocities + start[1]).max())


@pytest.mark.parametrize("method", REVERSIBLE)
def test_reversal_returns_to_the_start(method):
    away, missed = returned(method)
    assert away > 0.1
    assert missed < 1e-10  # rounding, amplified by the dynamics


@pytest.mark.parametrize("method", OTHERS)
def test_a_method_that_is_not_symmetric_does_not_return(method):
    assert returned(method, dt=0.05, n_steps=160)[1] > 1e-9  # truncation; symmetric methods miss by rounding, 1e-12


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_the_adjoint_undoes_a_step_when_time_runs_backwards(method):
    """Φ*_{−Δt} ∘ Φ_Δt = 1; for symmetric methods Φ_{−Δt} ∘ Φ_Δt = 1."""
    for back in [adjoint(method), method] if method.is_symmetric else [adjoint(method)]:
        s = state([0.7, 0.1, 0.0], [-0.1, 1.2, 0.05])
        method(0.05).advance(s, kepler, 20)
        back(-0.05).advance(s, kepler, 20)
        assert np.abs(s.positions - [0.7, 0.1, 0.0]).max() < 1e-13
        assert np.abs(s.velocities - [-0.1, 1.2, 0.05]).max() < 1e-13


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_the_adjoint_of_the_adjoint_is_the_method(method):
    assert adjoint(adjoint(method)).sequence() == method.sequence()
    assert adjoint(method).order == method.order


@pytest.mark.parametrize("method", SPLITTINGS.values())
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


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_step_of_a_linear_problem_is_symplectic_to_rounding(method):
    """The step is a matrix M then, its columns the images of the unit vectors; MᵀJM = J and det M = 1."""
    stiffness = np.array([[2.0, 0.3, -0.1], [0.3, 1.0, 0.2], [-0.1, 0.2, 0.5]])

    def forces(s, with_energy):
        s.forces[:] = -s.positions @ stiffness

    columns = [state(unit[:3], unit[3:]) for unit in np.eye(6)]
    for s in columns:
        method(0.3).advance(s, forces, 1)
    m = np.column_stack([np.concatenate([s.positions[0], s.velocities[0]]) for s in columns])
    j = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    assert np.abs(m.T @ j @ m - j).max() < 1e-14  # rounding
    assert np.linalg.det(m) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_linear_and_angular_momentum_are_kept_to_rounding(method):
    rng = np.random.default_rng(2)
    masses = np.array([1.0, 3.0, 0.2])
    s = state(rng.normal(size=(3, 3)), 0.3 * rng.normal(size=(3, 3)), masses)
    linear, angular = masses @ s.velocities, masses @ np.cross(s.positions, s.velocities)
    method(0.01).advance(s, springs, 500)
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


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_a_long_run_evaluates_forces_as_often_as_answered_and_one_is_with_energyed_at(method):
    with_energys = []

    def forces(s, with_energy):
        with_energys.append(with_energy)
        kepler(s)

    s = state([1, 0, 0], [0, 1, 0])
    method(0.01).advance(s, forces, 50)
    assert 50 * method.stages <= len(with_energys) <= 50 * method.stages + 1
    if isinstance((method.substeps + method.closing)[-1], Kick):
        assert with_energys == [False] * (len(with_energys) - 1) + [True]


@pytest.mark.parametrize("method", SPLITTINGS.values())
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
        substeps = (Kick(7 / 24), Drift(2 / 3), Kick(3 / 4), Drift(-2 / 3), Kick(-1 / 24), Drift(1.0))
        source = "R. D. Ruth, IEEE Trans. Nucl. Sci. 30, 2669 (1983)"

    assert Ruth3.order == 3
    timesteps = 0.004 / 2.0 ** np.arange(4)
    slope = np.polyfit(np.log(timesteps), np.log([final_error(Ruth3, dt, t=2.0) for dt in timesteps]), 1)[0]
    assert slope == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(
    ("composed", "method"), [(compose(SE2, SE1), VelocityVerlet), (compose(SE1, SE2), PositionVerlet)]
)
def test_verlet_is_the_composition_of_symplectic_euler_with_its_adjoint(composed, method):
    """(A) = SE2 ∘ SE1 and (B) = SE1 ∘ SE2 over half steps: to the last bit as rows, to rounding as two runs."""
    merged, named, apart = (state([0.7, 0, 0], [0, 1.3, 0]) for _ in range(3))
    composed(0.01).advance(merged, kepler, 100)
    method(0.01).advance(named, kepler, 100)
    outer, inner = EULERS[::-1] if method is VelocityVerlet else EULERS
    for _ in range(100):
        inner(0.005).advance(apart, kepler, 1)
        outer(0.005).advance(apart, kepler, 1)
    assert composed.sequence() == method.sequence()
    assert np.array_equal([merged.positions, merged.velocities], [named.positions, named.velocities])
    assert apart.positions == pytest.approx(named.positions, abs=1e-13)


def test_symplectic_euler_methods_are_adjoint_to_each_other_and_not_symmetric():
    assert adjoint(SE1).sequence() == SE2.sequence()
    assert adjoint(SE2).sequence() == SE1.sequence()
    assert not SE1.is_symmetric
    assert not SE2.is_symmetric
    assert (SE1.order, SE2.order, compose(SE2, SE1).order) == (1, 1, 2)


@pytest.mark.parametrize("recursion", [stormer_two_step, stormer_summed])
def test_the_recursions_are_velocity_verlet(recursion):
    s = state([0.7, 0, 0], [0, 1.3, 0])
    solution = recursion(lambda q: -q / np.linalg.norm(q) ** 3, s.positions, s.velocities, 0.01, 300)
    VelocityVerlet(0.01).advance(s, kepler, 300)
    assert solution.t[-1] == pytest.approx(3.0)
    assert solution.nfev == 301
    assert solution.q[-1] == pytest.approx(s.positions, abs=1e-11)
    assert solution.v[-1] == pytest.approx(s.velocities, abs=1e-9)  # a difference of positions, over Δt


def test_round_off_of_the_recursion_grows_as_the_square_of_the_steps_and_of_its_summed_form_does_not():
    """On the oscillator the recursion is solved by cos(nφ), 2 sin(φ/2) = Δt: what differs is rounding."""
    dt, n = 2e-4, 50_000
    exact = np.cos(2.0 * np.arcsin(dt / 2.0) * np.arange(n + 1))
    plain, summed = (
        np.abs(form(lambda q: -q, 1.0, 0.0, dt, n).q - exact).max() for form in (stormer_two_step, stormer_summed)
    )
    assert summed < 1e-13
    assert plain > 50 * summed


@pytest.mark.parametrize("recursion", [stormer_two_step, stormer_summed])
def test_the_recursions_run_backwards_and_refuse_bad_input(recursion):
    there = recursion(np.negative, [1.0, 0.2], [0.0, 0.5], 0.1, 100)
    back = recursion(np.negative, there.q[-1], there.v[-1], -0.1, 100)
    assert back.q[-1] == pytest.approx([1.0, 0.2], abs=1e-12)
    for dt, n, what in [(0.0, 10, "timestep"), (np.nan, 10, "timestep"), (0.1, 0, "n_steps")]:
        with pytest.raises(ValueError, match=what):
            recursion(np.negative, 1.0, 0.0, dt, n)
    with pytest.raises(ValueError, match="same shape"):
        recursion(np.negative, [1.0, 2.0], 0.0, 0.1, 10)


def test_stop_request_ends_at_a_whole_step():
    s = state([1, 0, 0], [0, 1, 0])

    def forces(s, with_energy):
        kepler(s)
        around.stop_requested = s.positions[0, 0] < 0.9

    around = Surroundings()
    done = VelocityVerlet(0.01).advance(s, forces, 1000, surroundings=around)
    other = state([1, 0, 0], [0, 1, 0])
    VelocityVerlet(0.01).advance(other, kepler, done)
    assert done < 100
    assert s.positions == pytest.approx(other.positions, abs=1e-14)
    assert s.velocities == pytest.approx(other.velocities, abs=1e-14)


def test_every_method_names_its_source():
    for name, method in SPLITTINGS.items():
        assert method.name == name
        assert len(method.source) > 20
        assert method(0.1).timestep == 0.1
