"""Drivers: fixed steps, steps up to a time, steps chosen by their error; and what a user may hand to them."""

import functools

import numba
import numpy as np
import pytest
from small_problems import KEPLER, KEPLER_START, kepler_orbit

import minimd as md
from minimd.integrators import (
    BlanesMoan4,
    FirstOrder,
    GaussLegendre2,
    Newton,
    Partitioned,
    RadauIIA3,
    SecondOrder,
    StepControl,
    VelocityVerlet,
    run_adaptive,
    run_steps,
    run_until,
)

OSCILLATOR = SecondOrder(lambda q: -q)
ONE = (1.0,), (0.0,)


def test_run_steps_keeps_the_first_state_every_so_many_and_the_last():
    whole = run_steps(OSCILLATOR, VelocityVerlet(0.1), ONE, 10, t0=2.0)
    some = run_steps(OSCILLATOR, VelocityVerlet(0.1), ONE, 10, t0=2.0, every=4)
    assert whole.t == pytest.approx(2.0 + 0.1 * np.arange(11), abs=1e-15)
    assert (some.t == whole.t[[0, 4, 8, 10]]).all()
    assert (some.y == whole.y[[0, 4, 8, 10]]).all()
    assert run_steps(OSCILLATOR, VelocityVerlet(0.1), ONE, 10, every=99).t == pytest.approx([0.0, 1.0])
    assert (whole.q[:, 0] == whole.y[:, 0]).all()
    assert (whole.v[:, 0] == whole.y[:, 1]).all()
    assert whole.success


@pytest.mark.parametrize(
    ("t0", "t_end"),
    [
        (0.0, 1.05),
        (0.0, 1.0),
        (0.7, 0.8),
        (3.0, 4.05),
        (1e6, 1e6 + 1.05),
        (0.0, 0.03),
        (2.0, 0.95),
        (-1.0, -2.05),
        (0.0, 0.1 * 3),
    ],
)
def test_run_until_ends_exactly_there(t0, t_end):
    """The last step is the shorter one, and there is none that rounding alone would make."""
    h = np.copysign(0.1, t_end - t0)
    path = run_until(SecondOrder(lambda t, q: -q + t - t0), GaussLegendre2(h), ONE, t_end, t0=t0)
    steps = np.diff(path.t) / h
    assert path.t[0] == t0
    assert path.t[-1] == t_end
    assert steps[:-1] == pytest.approx(1.0, abs=1e-8)
    assert 1e-8 < steps[-1] < 1.0 + 1e-8
    assert len(steps) == np.ceil(round(abs(t_end - t0) / 0.1, 6))
    t = t_end - t0
    assert path.q[-1, 0] == pytest.approx(np.cos(t) - np.sin(t) + t, abs=1e-6)


def test_run_until_keeps_the_end_whatever_every_says():
    path = run_until(OSCILLATOR, VelocityVerlet(0.1), ONE, 1.05, every=4)
    assert path.t == pytest.approx([0.0, 0.4, 0.8, 1.05], abs=1e-15)
    assert path.q[-1, 0] == run_until(OSCILLATOR, VelocityVerlet(0.1), ONE, 1.05).q[-1, 0]


@pytest.mark.parametrize("method", [VelocityVerlet, GaussLegendre2])
def test_backwards_in_time_and_back(method):
    there = run_until(KEPLER, method(-0.01), KEPLER_START, -0.995)
    back = run_until(KEPLER, method(0.01), (there.q[-1], there.v[-1]), 0.0, t0=-0.995)
    assert there.y[-1] == pytest.approx(
        kepler_orbit(0.995) * [1.0, -1.0, -1.0, 1.0], abs=2e-2 if method is VelocityVerlet else 1e-5
    )
    assert back.y[-1] == pytest.approx([0.4, 0.0, 0.0, 2.0], abs=1e-3)


@pytest.mark.parametrize("method", [VelocityVerlet, BlanesMoan4, GaussLegendre2, RadauIIA3])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_error_of_adaptive_runs_falls_with_the_tolerance(method, sign):
    """In both directions of time; in proportion to tolerance^(p/(p+1)) for an error per step."""
    exact = kepler_orbit(5.0) * ([1.0, 1.0, 1.0, 1.0] if sign > 0.0 else [1.0, -1.0, -1.0, 1.0])
    controls = [StepControl(tolerance, tolerance) for tolerance in (1e-4, 1e-6, 1e-8)]
    runs = [run_adaptive(KEPLER, method, KEPLER_START, 2.0 + sign * 5.0, 2.0, control) for control in controls]
    errors = [np.abs(run.y[-1] - exact).max() for run in runs]
    assert all(run.success and run.t[-1] == 2.0 + sign * 5.0 for run in runs)
    assert (np.diff(runs[0].t) * sign > 0.0).all()
    slope = np.log(errors[0] / errors[2]) / np.log(1e4)
    assert slope == pytest.approx(method.order / (method.order + 1), abs=0.25)
    assert errors[2] < 1e-4
    assert runs[0].nfev < runs[1].nfev < runs[2].nfev


@pytest.mark.parametrize("method", [VelocityVerlet, BlanesMoan4, RadauIIA3])
def test_a_step_is_accepted_if_its_estimated_error_is_allowed(method):
    """‖y_h − y_{h/2, h/2}‖ / (2ᵖ − 1), in root mean square, and within 30 % of the true error."""
    one, two = (run_steps(KEPLER, method(0.05 / n), KEPLER_START, n).y[-1] for n in (1, 2))
    estimate = np.sqrt(np.mean((one - two) ** 2)) / (2.0**method.order - 1.0)
    assert estimate == pytest.approx(np.sqrt(np.mean((two - kepler_orbit(0.05)) ** 2)), rel=0.3)
    for atol, n_rejected in ((1.001 * estimate, 0), (0.999 * estimate, 1)):
        run = run_adaptive(
            KEPLER, method, KEPLER_START, 0.05, control=StepControl(rtol=0.0, atol=atol, first_step=0.05)
        )
        assert run.n_rejected >= n_rejected
        assert (len(run.t) == 2) == (n_rejected == 0)


def test_steps_of_adaptive_runs_stay_within_their_bounds_and_shorten_where_the_solution_is_fast():
    free = run_adaptive(KEPLER, BlanesMoan4, KEPLER_START, 6.0, control=StepControl(rtol=1e-6))
    bound = run_adaptive(
        KEPLER, BlanesMoan4, KEPLER_START, 6.0, control=StepControl(rtol=1e-6, max_step=0.2, first_step=0.001)
    )
    long = run_adaptive(KEPLER, BlanesMoan4, KEPLER_START, 6.0, control=StepControl(rtol=1e-3, atol=1e-3, min_step=0.1))
    assert np.diff(free.t).max() > 3.0 * np.diff(free.t).min()
    assert np.diff(bound.t).max() <= 0.2 + 1e-15
    assert bound.t[1] == 0.001
    assert np.diff(long.t)[:-1].min() >= 0.1 - 1e-15
    assert run_adaptive(KEPLER, BlanesMoan4, KEPLER_START, 6.0, control=StepControl(first_step=1.0)).n_rejected > 0


def test_rejected_steps_are_counted():
    """Every step costs two short ones and a long one: 3 evaluations with position Verlet."""
    run = run_adaptive(KEPLER, md.PositionVerlet, KEPLER_START, 6.0, control=StepControl(rtol=1e-4))
    assert run.n_rejected > 0
    assert run.nfev == 3 * (len(run.t) - 1 + run.n_rejected)


def test_an_adaptive_run_ends_after_so_many_steps():
    solution = run_adaptive(
        SecondOrder(lambda q: -q), VelocityVerlet, ([1.0], [0.0]), 10.0, control=StepControl(1e-12, 1e-12, max_steps=50)
    )
    assert not solution.success
    assert "after 50 steps" in solution.message
    assert len(solution.t) + solution.n_rejected == 51


def test_the_last_step_that_is_allowed_may_reach_the_end():
    whole = run_adaptive(OSCILLATOR, VelocityVerlet, ONE, 1.0)
    n_tried = len(whole.t) - 1 + whole.n_rejected
    assert run_adaptive(OSCILLATOR, VelocityVerlet, ONE, 1.0, control=StepControl(max_steps=n_tried)).success
    assert not run_adaptive(OSCILLATOR, VelocityVerlet, ONE, 1.0, control=StepControl(max_steps=n_tried - 1)).success


def test_a_step_that_may_not_be_shorter_ends_the_run_where_it_is():
    run = run_adaptive(KEPLER, VelocityVerlet, KEPLER_START, 6.0, control=StepControl(rtol=1e-8, min_step=0.01))
    assert not run.success
    assert "min_step = 0.01" in run.message
    assert run.t[-1] < 6.0
    assert len(run.t) == len(run.y)


@pytest.mark.parametrize("method", [VelocityVerlet, RadauIIA3])
def test_a_singularity_ends_an_adaptive_run_before_it(method):
    """y′ = y² from 1: infinite at t = 1."""
    run = run_adaptive(SecondOrder(lambda q, v: v * v), method, ([0.0], [1.0]), 2.0, control=StepControl(rtol=1e-4))
    assert not run.success
    assert run.t[-1] == pytest.approx(1.0, abs=1e-3)
    assert run.message.startswith(f"stopped at t = {run.t[-1]:g}")


def test_equations_without_a_solution_reject_the_step():
    """Too long for Newton's method at first; shorter ones are fine."""
    stiff = SecondOrder(lambda q, v: -q - np.exp(5.0 * v), solver=Newton(max_iterations=6))
    with pytest.raises(md.ConvergenceError):
        run_steps(stiff, VelocityVerlet(1.0), ([0.0], [1.0]), 1)
    run = run_adaptive(stiff, VelocityVerlet, ([0.0], [1.0]), 1.0, control=StepControl(rtol=1e-4, first_step=1.0))
    assert run.success
    assert run.n_rejected > 0


def test_tolerances_may_differ_from_component_to_component():
    """A component without tolerance to speak of drives the steps, one with a large tolerance does not."""
    problem = SecondOrder(lambda q: -np.array([1.0, 100.0]) * q)
    start = (1.0, 1.0), (0.0, 0.0)
    controls = [StepControl(rtol=0.0, atol=[1e-8, fast, 1e-8, fast]) for fast in (1e3, 1e-8)]
    loose, tight = (run_adaptive(problem, BlanesMoan4, start, 5.0, control=control) for control in controls)
    assert len(tight.t) > 3 * len(loose.t)
    assert loose.q[-1, 0] == pytest.approx(np.cos(5.0), abs=1e-6)


def test_components_that_are_zero_need_no_absolute_tolerance():
    run = run_adaptive(KEPLER, VelocityVerlet, KEPLER_START, 1.0, control=StepControl(rtol=1e-5, atol=0.0))
    assert run.success
    flat = run_adaptive(
        SecondOrder(lambda q: -q),
        VelocityVerlet,
        ((1.0, 0.0), (0.3, 0.0)),
        1.0,
        control=StepControl(rtol=1e-5, atol=0.0),
    )
    assert flat.success
    assert (flat.q[:, 1] == 0.0).all()


def test_a_path_that_is_no_longer_finite_ends_the_run_with_what_was():
    falls = SecondOrder(lambda t, q: -q if t < 0.45 else np.nan * q)
    with pytest.raises(
        md.NonFiniteError, match=r"not finite at t = 0.5; the last finite one is at t = 0.4; .*timestep \(0.1\)"
    ) as caught:
        run_steps(falls, VelocityVerlet(0.1), ONE, 20)
    assert np.isfinite(caught.value.solution.y).all()
    assert caught.value.solution.t[-1] == pytest.approx(0.4)
    assert not caught.value.solution.success
    assert not run_adaptive(falls, VelocityVerlet, ONE, 1.0, control=StepControl(rtol=1e-3)).success


@numba.njit
def compiled(q):
    return -q


@numba.vectorize
def elementwise(x):
    return -x


class Spring:
    def force(self, q):
        return -q

    def __call__(self, t, q, v):
        return -q


BUFFER = np.zeros((2, 3))


def into_buffer(q):
    return np.negative(q, out=BUFFER[: len(q)] if q.shape == BUFFER.shape else None)


FORCES = {
    "lambda": lambda q: -q,
    "other name": lambda x: -x,
    "default argument": lambda q, stiffness=1.0: -stiffness * q,
    "all three under other names": lambda time, x, velocity: -x,
    "partial": functools.partial(lambda stiffness, q: -stiffness * q, 1.0),
    "bound method": Spring().force,
    "object": Spring(),
    "numpy": np.negative,
    "numba": compiled,
    "numba, elementwise": elementwise,
    "list": lambda q: [[-x for x in row] for row in q],
    "buffer used again": into_buffer,
    "transposed memory": lambda q: np.asfortranarray(-q),
    "long double": lambda q: (-q).astype(np.longdouble),
}


@pytest.mark.parametrize("name", FORCES)
@pytest.mark.parametrize("method", [VelocityVerlet, GaussLegendre2])
def test_any_function_is_a_force(method, name):
    start = np.arange(6).reshape(2, 3), np.ones((2, 3), dtype=int)
    path = run_steps(SecondOrder(FORCES[name]), method(0.1), start, 10)
    assert path.q.shape == path.v.shape == (11, 2, 3)
    assert path.y == pytest.approx(run_steps(OSCILLATOR, method(0.1), start, 10).y, abs=1e-14)


@pytest.mark.parametrize("method", [VelocityVerlet, GaussLegendre2])
def test_one_number_is_a_state_too(method):
    path = run_steps(SecondOrder(lambda q: -q), method(0.1), (1, 0), 10)
    assert path.q.shape == (11,)
    assert path.q == pytest.approx(run_steps(SecondOrder(lambda q: -q[0]), method(0.1), ONE, 10).q[:, 0], abs=1e-15)


def test_the_start_is_not_touched_and_a_function_that_answers_with_its_argument_is_copied():
    start = np.array([1.0, 2.0]), np.array([0.5, 0.0])
    path = run_steps(Partitioned(lambda v: v, lambda q: q), VelocityVerlet(0.1), start, 10)
    assert path.q[-1] == pytest.approx(start[0] * np.cosh(1.0) + start[1] * np.sinh(1.0), rel=1e-2)
    assert (start[0] == [1.0, 2.0]).all()


def test_functions_are_not_called_outside_the_time_of_the_run():
    """f(t) = 1/t² is no problem from t = 1 on."""
    path = run_until(SecondOrder(lambda t, q: -2.0 / t**2 * q), GaussLegendre2(0.1), ONE, 2.0, t0=1.0)
    assert path.t[-1] == 2.0
    assert run_until(FirstOrder(lambda t: [1.0 / t]), GaussLegendre2(0.1), [0.0], 2.0, t0=1.0).y[-1] == pytest.approx(
        [np.log(2.0)], abs=1e-6
    )
    assert run_adaptive(FirstOrder(lambda t, y: -y / t), GaussLegendre2, [1.0], 2.0, t0=1.0).y[-1] == pytest.approx(
        [0.5], abs=1e-5
    )
