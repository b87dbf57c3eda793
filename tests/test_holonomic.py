"""RATTLE on manifolds g(q) = 0: order, symmetry, symplecticity, energy; every row of the catalogue."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import minimd as md
from minimd.integrators import SPLITTINGS, Holonomic, StepControl, run_adaptive, run_steps, run_until

GRAVITY = np.array([0.0, -1.0])
ANGLE_AT_3 = -0.94875159694619818661  # of θ″ = −sin θ from θ = 1 at rest; Jacobi's elliptic functions
STEPS = {1: 0.01, 2: 0.05, 4: 0.1, 6: 0.3, 8: 0.3}  # time steps where errors are small, and above rounding


def pendulum():
    return Holonomic(lambda q: GRAVITY, lambda q: [0.5 * (q @ q - 1.0)], lambda q: q[None, :])


def double_pendulum():
    """Masses 1 and 2 on rods of lengths 1 and ½; q = (x₁, y₁, x₂, y₂)."""

    def lengths(q):
        return [0.5 * (q[:2] @ q[:2] - 1.0), 0.5 * ((q[2:] - q[:2]) @ (q[2:] - q[:2]) - 0.25)]

    return Holonomic(lambda q: np.tile(GRAVITY, 2), lengths, masses=[1.0, 1.0, 2.0, 2.0])


DOUBLE_START = (
    [np.sin(1.0), -np.cos(1.0), np.sin(1.0) + 0.5 * np.sin(2.0), -np.cos(1.0) - 0.5 * np.cos(2.0)],
    np.zeros(4),
)
START = ([np.sin(1.0), -np.cos(1.0)], [0.0, 0.0])


def angle(q):
    return np.arctan2(q[..., 0], -q[..., 1])


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_order_on_the_pendulum(method):
    order = method.order_on(pendulum())
    timesteps = 3.0 / np.round(3.0 / (STEPS[order] / 1.25 ** np.arange(4)))
    errors = [abs(angle(run_until(pendulum(), method(h), START, 3.0).q[-1]) - ANGLE_AT_3) for h in timesteps]
    slope = np.polyfit(np.log(timesteps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.3 if order > 4 else 0.1)  # truncation


def test_rows_of_velocity_verlet_keep_their_order_and_others_do_not():
    orders = {name: method.order_on(pendulum()) for name, method in SPLITTINGS.items()}
    assert (orders["suzuki-4"], orders["yoshida-6"], orders["kahan-li-8"]) == (4, 6, 8)
    assert (orders["pefrl"], orders["candy-rozmus-4"], orders["blanes-moan-rkn-4"]) == (2, 2, 2)


def test_the_double_pendulum_against_its_angles():
    """The same mechanism in two angles, integrated by DOP853."""
    m1, m2, l1, l2 = 1.0, 2.0, 1.0, 0.5

    def in_angles(t, y):
        a, b, u, w = y
        c, s = np.cos(a - b), np.sin(a - b)
        mass = np.array([[(m1 + m2) * l1, m2 * l2 * c], [l1 * c, l2]])
        return [
            u,
            w,
            *np.linalg.solve(mass, [-m2 * l2 * w * w * s - (m1 + m2) * np.sin(a), l1 * u * u * s - np.sin(b)]),
        ]

    exact = solve_ivp(in_angles, (0.0, 2.0), [1.0, 2.0, 0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    q = run_until(double_pendulum(), SPLITTINGS["kahan-li-6"](0.05), DOUBLE_START, 2.0).q[-1]
    assert angle(q[:2]) == pytest.approx(exact[0], abs=1e-6)
    assert angle(q[2:] - q[:2]) == pytest.approx(exact[1], abs=1e-6)


def test_constraints_are_kept_to_rounding():
    problem = double_pendulum()
    path = run_steps(problem, md.VelocityVerlet(0.02), DOUBLE_START, 2000)
    assert max(np.abs(problem.violation(q)).max() for q in path.q) < 1e-14
    exact = exact_gradients()
    exact.begin(DOUBLE_START)
    assert (
        max(np.abs(exact.gradient(q) @ v).max() for q, v in zip(path.q, path.v, strict=True)) < 1e-12
    )  # G by differences


@pytest.mark.parametrize("method", [method for method in SPLITTINGS.values() if method.is_symmetric])
def test_a_reversed_run_returns_to_the_start(method):
    there = run_steps(double_pendulum(), method(0.02), DOUBLE_START, 50)
    back = run_steps(double_pendulum(), method(0.02), (there.q[-1], -there.v[-1]), 50)
    assert np.abs(there.q[-1] - there.q[0]).max() > 0.1
    assert np.abs(back.q[-1] - there.q[0]).max() < 1e-9


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_the_step_is_symplectic_on_the_manifold(method):
    """ω(Φ′ξ, Φ′η) = ω(ξ, η) for tangent vectors ξ, η, with ω = Σ m dq ∧ dv; Φ′ by differences along charts of two angles."""
    masses = np.array([1.0, 1.0, 2.0, 2.0])

    def place(z):
        a, b, u, w = z
        q1, q2 = np.array([np.sin(a), -np.cos(a)]), 0.5 * np.array([np.sin(b), -np.cos(b)])
        v1, v2 = u * np.array([np.cos(a), np.sin(a)]), 0.5 * w * np.array([np.cos(b), np.sin(b)])
        return np.concatenate([q1, q1 + q2]), np.concatenate([v1, v1 + v2])

    def step(z):
        path = run_steps(exact_gradients(), method(0.1), place(z), 3)
        return np.concatenate([path.q[-1], path.v[-1]])

    def derivative(function, z, h=1e-5):
        return np.column_stack([(function(z + h * unit) - function(z - h * unit)) / (2.0 * h) for unit in np.eye(4)])

    def form(columns):
        q, v = columns[:4], columns[4:]
        return q.T @ (masses[:, None] * v) - v.T @ (masses[:, None] * q)

    z = np.array([1.0, 2.0, 0.3, -0.5])
    before = form(derivative(lambda z: np.concatenate(place(z)), z))
    assert np.abs(form(derivative(step, z)) - before).max() < 1e-8  # truncation h², rounding 1/h
    assert np.abs(before).max() > 0.1


def exact_gradients():
    problem = double_pendulum()

    def jacobian(q):
        d = q[2:] - q[:2]
        return [[q[0], q[1], 0.0, 0.0], [-d[0], -d[1], d[0], d[1]]]

    return Holonomic(lambda q: np.tile(GRAVITY, 2), problem._g, jacobian, masses=[1.0, 1.0, 2.0, 2.0])


@pytest.mark.slow
def test_energy_of_a_bead_on_an_ellipse_oscillates_and_does_not_drift():
    bead = Holonomic(lambda q: GRAVITY, lambda q: [0.5 * (q[0] ** 2 / 4.0 + q[1] ** 2 - 1.0)])

    def error(timestep, n_steps):
        path = run_steps(bead, md.VelocityVerlet(timestep), ([2.0, 0.0], [0.0, 0.5]), n_steps)
        energy = 0.5 * (path.v**2).sum(axis=1) + path.q[:, 1]
        return np.abs(energy - energy[0]).reshape(4, -1).max(axis=1) if n_steps % 4 == 3 else np.abs(energy - energy[0])

    errors = error(0.02, 8003)
    assert errors[-1] < 1.05 * errors[0]
    slope = np.log2(error(0.02, 1000).max() / error(0.01, 2000).max())
    assert slope == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("jacobian", [lambda q: q[None, :], None])
def test_multipliers_are_the_tension(jacobian):
    """λ = |v|² + cos θ for unit length, mass and gravity."""
    problem = Holonomic(lambda q: GRAVITY, lambda q: [0.5 * (q @ q - 1.0)], jacobian)
    problem.begin(START)
    q, v = np.array([np.sin(0.4), -np.cos(0.4)]), 0.7 * np.array([np.cos(0.4), np.sin(0.4)])
    assert problem.multipliers(0.0, q, v)[0] == pytest.approx(0.49 + np.cos(0.4), rel=1e-11)


def test_a_start_off_the_manifold_is_projected_and_told():
    start = [1.1, 0.0], [0.3, 0.2]
    with pytest.warns(UserWarning, match=r"projected onto the constraints: q by .* v by") as warned:
        path = run_steps(pendulum(), md.VelocityVerlet(0.01), start, 1)
    with pytest.warns(UserWarning, match=r"projected onto the constraints: q by .* v by") as warned_too:
        pendulum().begin(start)
    assert [warning.filename for warning in (*warned, *warned_too)] == 2 * [
        __file__
    ]  # the caller's line, however deep in minimd
    assert path.q[0] == pytest.approx([1.0, 0.0], abs=1e-15)
    assert path.v[0] == pytest.approx([0.0, 0.2], abs=1e-15)


def test_step_doubling_works_on_manifolds():
    loose = run_adaptive(pendulum(), md.VelocityVerlet, START, 3.0, control=StepControl(rtol=1e-4, atol=1e-4))
    tight = run_adaptive(pendulum(), md.VelocityVerlet, START, 3.0, control=StepControl(rtol=1e-8, atol=1e-8))
    assert abs(angle(tight.q[-1]) - ANGLE_AT_3) < 1e-2 * abs(angle(loose.q[-1]) - ANGLE_AT_3)


def test_bad_problems_are_told():
    with pytest.raises(ValueError, match="do not depend on v"):
        Holonomic(lambda q, v: -v, lambda q: [q @ q - 1.0])
    twice = Holonomic(lambda q: GRAVITY, lambda q: [q @ q - 1.0, 2.0 * (q @ q - 1.0)])
    with pytest.raises(ValueError, match="must be independent"):
        twice.begin(START)
    with pytest.raises(ValueError, match="masses must be positive"):
        Holonomic(lambda q: GRAVITY, lambda q: [q @ q - 1.0], masses=[1.0, 0.0]).begin(START)
    with pytest.raises(md.ConvergenceError, match=r"step \d+"):
        run_steps(pendulum(), md.VelocityVerlet(5.0), START, 10)
