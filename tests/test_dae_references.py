"""Differential-algebraic equations beside numbers that others computed: pendulum, Robertson, Andrews' mechanism, and SUNDIALS' IDA."""

import andrews
import numpy as np
import pytest
from dae_problems import GRAVITY, HORIZONTAL, pendulum
from references import load

from minimd.integrators import (
    BDF5,
    FirstOrder,
    GaussLegendre3,
    Hessenberg1,
    Hessenberg2,
    Implicit,
    Mechanical,
    RadauIIA3,
    StepControl,
    run_adaptive,
    run_steps,
)

ROBERTSON = load("dae/robertson.json")


def robertson():
    def rates(y, z):
        slow, fast, pair = 0.04 * y[0], 1e4 * y[1] * z[0], 3e7 * y[1] ** 2
        return [fast - slow, slow - fast - pair]

    return Hessenberg1(rates, lambda y, z: y[0] + y[1] + z[0] - 1.0)


def stabilized_pendulum():
    """Index 2: q′ = v − q μ, v′ = −q λ − g, 0 = g = G v (C. W. Gear, B. Leimkuhler, G. K. Gupta (1985))."""

    def rates(y, z):
        x, q, u, v = y
        return [u - x * z[1], v - q * z[1], -x * z[0], -q * z[0] - GRAVITY]

    return Hessenberg2(rates, lambda y: [(y[0] ** 2 + y[1] ** 2 - 1) / 2, y[0] * y[2] + y[1] * y[3]])


def reduced_pendulum():
    """Index 1: the multiplier from the second derivative of the constraint."""
    return Hessenberg1(
        lambda y, z: [y[2], y[3], -y[0] * z[0], -y[1] * z[0] - GRAVITY],
        lambda y, z: y[2] ** 2 + y[3] ** 2 - z[0] * (y[0] ** 2 + y[1] ** 2) - GRAVITY * y[1],
    )


def test_pendulum_of_index_3_returns_after_its_period():
    """Positions to 1e-8 with 300 steps per period, velocities, of order 3, with 2000."""
    problem, period = pendulum(), 2.0
    for n_steps, parts in ((300, 1), (2000, 2)):
        path = run_steps(problem, RadauIIA3(period / n_steps), HORIZONTAL, n_steps)
        for part, start in zip(problem.parts(path.y[-1])[:parts], HORIZONTAL, strict=False):
            assert part == pytest.approx(start, abs=1e-8)  # truncation


@pytest.mark.slow
def test_pendulum_of_index_3_returns_after_15_periods():
    path = run_steps(pendulum(), RadauIIA3(0.001), HORIZONTAL, 30_000, every=2000)
    assert np.abs(path.y[:, :4] - [1.0, 0.0, 0.0, 0.0]).max() < 1e-8  # truncation


@pytest.mark.parametrize(
    ("problem", "start", "method", "n_steps"),
    [
        (reduced_pendulum(), ([1.0, 0.0, 0.0, 0.0], [0.0]), GaussLegendre3, 200),
        (reduced_pendulum(), ([1.0, 0.0, 0.0, 0.0], [0.0]), RadauIIA3, 300),
        (stabilized_pendulum(), ([1.0, 0.0, 0.0, 0.0],), RadauIIA3, 300),
        (stabilized_pendulum(), ([1.0, 0.0, 0.0, 0.0],), GaussLegendre3, 400),
        (pendulum(), HORIZONTAL, BDF5, 2000),
    ],
)
def test_pendulum_of_any_index_returns_after_its_period(problem, start, method, n_steps):
    path = run_steps(problem, method(2.0 / n_steps), start, n_steps)
    assert path.y[-1, :4] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-8)  # truncation


def test_robertson_to_1e11():
    path = run_adaptive(
        robertson(),
        RadauIIA3,
        ([1.0, 0.0], [0.0]),
        ROBERTSON["T"],
        control=StepControl(rtol=1e-9, atol=[1e-15, 1e-19, 1e-9]),
    )
    assert path.success
    assert path.y[-1] == pytest.approx(ROBERTSON["y"], rel=1e-6)  # truncation
    assert len(path.t) < 500


@pytest.mark.parametrize(("gradient", "digits"), [(andrews.gradient, 1e-14), (None, 3e-11)])
def test_andrews_mechanism_starts_as_published(gradient, digits):
    """Accelerations and forces of the constraints follow from the positions; an error of G is multiplied by 500."""
    problem = Mechanical(andrews.mass, andrews.force, andrews.closures, gradient)
    y = problem.begin(andrews.START)
    assert problem.field(0.0, y)[7:9] == pytest.approx(np.array(andrews.DATA["w0_first2"], dtype=float), rel=digits)
    assert problem.parts(y)[2][:2] == pytest.approx(np.array(andrews.DATA["lambda0_first2"], dtype=float), rel=digits)


def test_andrews_mechanism():
    problem = Mechanical(andrews.mass, andrews.force, andrews.closures, andrews.gradient)
    path = run_adaptive(problem, RadauIIA3, andrews.START, andrews.DATA["T"], control=StepControl(rtol=1e-8, atol=1e-8))
    assert path.y[-1, [0, 2, 4, 6]] == pytest.approx(andrews.DATA["q_end_components_1_3_5_7"], rel=1e-6)  # truncation


@pytest.mark.slow
def test_andrews_mechanism_to_eight_digits():
    problem = Mechanical(andrews.mass, andrews.force, andrews.closures, andrews.gradient)
    path = run_steps(problem, RadauIIA3(andrews.DATA["T"] / 1500), andrews.START, 1500)
    assert path.y[-1, [0, 2, 4, 6]] == pytest.approx(andrews.DATA["q_end_components_1_3_5_7"], rel=1e-8)


def test_step_control_meets_its_tolerance_at_index_3():
    """The error of the position falls with rtol, the multiplier being weighted by h²."""
    ends = [
        run_adaptive(pendulum(), RadauIIA3, HORIZONTAL, 2.0, control=StepControl(rtol=rtol, atol=rtol))
        for rtol in (1e-5, 1e-7, 1e-9)
    ]
    errors = [np.abs(path.y[-1, :2] - [1.0, 0.0]).max() for path in ends]
    for rtol, error in zip((1e-5, 1e-7, 1e-9), errors, strict=True):
        assert error < 10 * rtol
    assert len(ends[-1].t) < 2000


@pytest.fixture
def ida():
    """SUNDIALS' IDA: variable-order BDF, for index 1, and 2 with algebraic variables left out of its error test."""
    return pytest.importorskip("sksundae.ida")


def test_robertson_beside_ida(ida):
    def residual(t, y, slope, answer):
        slow, fast, pair = 0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
        answer[:] = slope[0] + slow - fast, slope[1] - slow + fast + pair, y.sum() - 1.0

    solver = ida.IDA(residual, algebraic_idx=[2], rtol=1e-9, atol=[1e-12, 1e-16, 1e-12], max_num_steps=100_000)
    theirs = solver.solve([0.0, 4e5], np.array([1.0, 0.0, 0.0]), np.array([-0.04, 0.04, 0.0]))
    ours = run_adaptive(
        robertson(), RadauIIA3, ([1.0, 0.0], [0.0]), 4e5, control=StepControl(rtol=1e-9, atol=[1e-12, 1e-16, 1e-9])
    )
    assert ours.y[-1] == pytest.approx(theirs.y[-1], rel=1e-6)


def test_pendulum_of_index_1_beside_ida(ida):
    def residual(t, y, slope, answer):
        x, q, u, v, tension = y
        answer[:4] = slope[0] - u, slope[1] - v, slope[2] + x * tension, slope[3] + q * tension + GRAVITY
        answer[4] = u * u + v * v - tension * (x * x + q * q) - GRAVITY * q

    solver = ida.IDA(residual, algebraic_idx=[4], rtol=1e-10, atol=1e-12, max_num_steps=100_000)
    theirs = solver.solve([0.0, 1.7], np.array([1.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, -GRAVITY, 0.0]))
    ours = run_steps(reduced_pendulum(), RadauIIA3(0.005), ([1.0, 0.0, 0.0, 0.0], [0.0]), 340)
    assert ours.y[-1] == pytest.approx(theirs.y[-1], abs=1e-6)
    of_index_3 = run_steps(pendulum(), RadauIIA3(0.001), HORIZONTAL, 1700)
    assert of_index_3.y[-1, :4] == pytest.approx(theirs.y[-1, :4], abs=1e-7)


def test_gauss_on_an_ordinary_equation_given_as_a_residual_is_gauss_on_the_equation():
    plain = run_steps(FirstOrder(lambda y: [y[1], -np.sin(y[0])]), GaussLegendre3(0.1), [1.0, 0.0], 30)
    implicit = run_steps(
        Implicit(lambda y, slope: [slope[0] - y[1], slope[1] + np.sin(y[0])]), GaussLegendre3(0.1), [1.0, 0.0], 30
    )
    assert implicit.y == pytest.approx(plain.y, abs=1e-13)  # rounding
