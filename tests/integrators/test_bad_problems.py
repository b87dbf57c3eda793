"""What small problems, methods and drivers refuse, and in which words."""

import numpy as np
import pytest

from minimd.integrators import (
    FirstOrder,
    FixedPoint,
    GaussLegendre2,
    Newton,
    Partitioned,
    SecondOrder,
    StepControl,
    VelocityVerlet,
    run_adaptive,
    run_steps,
    run_until,
    stormer_two_step,
)

OSCILLATOR = SecondOrder(lambda q: -q)
ONE = (1.0,), (0.0,)
THREE = (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)
GRID = np.ones((2, 3)), np.zeros((2, 3))
VERLET = VelocityVerlet(0.1)

ARGUMENTS = {
    "q before t": lambda q, t: -q,
    "v before q": lambda v, q: -q,
    "t last": lambda q, v, t: -q,
    "t last, with a momentum": lambda q, p, t: -q,
    "four": lambda t, q, v, more: -q,
    "two under other names": lambda t, x: -x,
    "any number": lambda t, *rest: -rest[0],
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_functions_whose_arguments_would_be_mistaken_are_refused(name):
    with pytest.raises(
        TypeError, match=r"f must take some of t, q, v, in this order and under these names; it takes \("
    ):
        SecondOrder(ARGUMENTS[name])


def test_functions_of_first_order_problems_take_t_before_y():
    with pytest.raises(TypeError, match=r"f must take y, or t and y, in this order; it takes \(y, t\)"):
        FirstOrder(lambda y, t: -y)
    with pytest.raises(TypeError, match="in this order"):
        FirstOrder(lambda t, y, more: -y)
    with pytest.raises(TypeError, match="jacobian must take y"):
        FirstOrder(lambda y: -y, jacobian=lambda y, t: np.eye(1))


@pytest.mark.parametrize(
    "kind", [SecondOrder, FirstOrder, lambda f: Partitioned(f, lambda q: q), lambda f: Partitioned(lambda v: v, f)]
)
def test_only_functions_are_functions(kind):
    with pytest.raises(TypeError, match=r"must be a function; got 1\.0"):
        kind(1.0)


@pytest.mark.parametrize("method", [VERLET, GaussLegendre2(0.1)])
@pytest.mark.parametrize(
    ("force", "start", "error", "message"),
    [
        (lambda q: q.T, GRID, ValueError, r"f must answer with an array of shape \(2, 3\); got shape \(3, 2\)"),
        (lambda q: 0.0, THREE, ValueError, r"shape \(3,\); got shape \(\)"),
        (
            lambda q: -q if q[0] > 0.95 else 0.0,
            THREE,
            ValueError,
            r"shape \(3,\); got shape \(\)",
        ),  # in the middle of a run
        (lambda q: -q[:2], THREE, ValueError, r"shape \(3,\); got shape \(2,\)"),
        (lambda q: None, ONE, TypeError, "f must answer with real numbers; got None"),
        (lambda q: 1j * q, ONE, TypeError, "real numbers"),
        (lambda q: "a", ONE, TypeError, "real numbers"),
    ],
)
def test_answers_of_another_shape_or_kind_are_refused(method, force, start, error, message):
    with pytest.raises(error, match=message):
        run_steps(SecondOrder(force), method, start, 10)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ([1.0, 0.0, 0.0, 1.0], r"the start must be a pair, \(q, v\)"),
        (None, r"the start must be a pair, \(q, v\); got None"),
        (((1.0, 2.0), (0.0,)), r"the same shape.* got \(2,\) and \(1,\)"),
        (((), ()), "at least one element"),
        (((np.nan,), (0.0,)), "the start must be finite; element 0 is nan"),
        (((0.0,), (np.inf,)), "the start must be finite; element 1 is inf"),
    ],
)
def test_starts_that_do_not_fit_are_refused(start, message):
    with pytest.raises(ValueError, match=message):
        run_steps(OSCILLATOR, VERLET, start, 1)


def test_starts_of_first_order_problems_are_one_dimensional():
    for start in (1.0, [[1.0]], []):
        with pytest.raises(ValueError, match="one-dimensional array with at least one element"):
            run_steps(FirstOrder(lambda y: -y), GaussLegendre2(0.1), start, 1)


@pytest.mark.parametrize("n", [0, -1, 1.0, True, "3", None])
def test_counts_are_whole_and_positive(n):
    for arguments in ({"n_steps": n}, {"n_steps": 3, "every": n}):
        with pytest.raises(ValueError, match="must be a whole number, at least 1"):
            run_steps(OSCILLATOR, VERLET, ONE, **arguments)
    with pytest.raises(ValueError, match="n_steps must be a whole number, at least 1"):
        stormer_two_step(lambda q: -q, 1.0, 0.0, 0.1, n)


def test_counts_may_be_integers_of_numpy():
    assert len(run_steps(OSCILLATOR, VERLET, ONE, np.int32(3)).t) == 4


def test_times_are_finite_and_lie_ahead():
    for t0 in (np.nan, np.inf):
        with pytest.raises(ValueError, match="t0 must be finite"):
            run_steps(OSCILLATOR, VERLET, ONE, 3, t0=t0)
    for t_end in (np.nan, np.inf, 0.0, -1.0):
        with pytest.raises(ValueError, match=r"t_end must be finite( and lie ahead|; t_end = )"):
            run_until(OSCILLATOR, VERLET, ONE, t_end)
    for t_end in (np.nan, -np.inf, 0.0):
        with pytest.raises(ValueError, match=r"must be finite( and differ|; t_end = )"):
            run_adaptive(OSCILLATOR, VelocityVerlet, ONE, t_end)


def test_methods_come_with_a_time_step_or_without_one():
    for driver, last in ((run_steps, 3), (run_until, 1.0)):
        for wrong in (VelocityVerlet, "verlet", None):
            with pytest.raises(TypeError, match=r"with its time step, such as VelocityVerlet\(0.05\); got"):
                driver(OSCILLATOR, wrong, ONE, last)
    for wrong in (VERLET, "verlet", None):
        with pytest.raises(TypeError, match="without a time step, such as VelocityVerlet; got"):
            run_adaptive(OSCILLATOR, wrong, ONE, 1.0)
    for timestep in (0.0, np.nan, np.inf, "0.1", None):
        with pytest.raises(ValueError, match="timestep must be finite and not zero"):
            VelocityVerlet(timestep)


def test_problems_are_problems():
    for wrong in (np.negative, None, 3.0):
        for driver, method in ((run_steps, VERLET), (run_until, VERLET), (run_adaptive, VelocityVerlet)):
            with pytest.raises(TypeError, match=r"problem must be .* such as SecondOrder\(f\); got"):
                driver(wrong, method, ONE, 1)
    with pytest.raises(TypeError, match="velocity-verlet needs a problem with q and v"):
        run_steps(FirstOrder(lambda y: -y), VERLET, [1.0], 1)


def test_solvers_are_solvers():
    for wrong in (None, Newton, "newton"):
        for problem in (lambda s: SecondOrder(np.negative, solver=s), lambda s: FirstOrder(np.negative, solver=s)):
            with pytest.raises(TypeError, match=r"solver must be Newton\(\) or FixedPoint\(\)"):
                problem(wrong)
    for kind in (Newton, FixedPoint):
        with pytest.raises(ValueError, match="max_iterations must be a whole number, at least 1"):
            kind(max_iterations=0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rtol": -1e-6}, "rtol and atol must not be negative"),
        ({"rtol": np.nan}, "rtol must be finite"),
        ({"rtol": "1e-6"}, "rtol must be finite; rtol = '1e-6'"),
        ({"atol": np.ma.masked_equal([1e-9, 1e-6], 1e-6)}, "atol must be .* some are masked"),
        ({"rtol": 0.0, "atol": 0.0}, "nor both zero"),
        ({"atol": [1e-9, -1e-9]}, "rtol and atol must not be negative"),
        ({"atol": [1e-9, 1e-9, 1e-9]}, r"array of length 2, .* got shape \(3,\)"),
        ({"atol": [[1e-9], [1e-9]]}, r"array of length 2, .* got shape \(2, 1\)"),
        ({"first_step": 0.0}, "first_step must be positive and finite"),
        ({"first_step": np.nan}, "first_step must be positive and finite"),
        ({"first_step": -0.1}, "first_step must be positive and finite"),
        ({"min_step": 0.2, "max_step": 0.1}, "0 <= min_step <= max_step"),
        ({"max_step": 0.0}, "0 <= min_step <= max_step"),
        ({"min_step": np.nan}, "min_step must be finite"),
    ],
)
def test_tolerances_and_lengths_of_steps_are_positive(arguments, message):
    with pytest.raises(ValueError, match=message):
        run_adaptive(OSCILLATOR, VelocityVerlet, ONE, 1.0, control=StepControl(**arguments))
