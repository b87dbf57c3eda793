"""Derivatives by differences: their digits on functions of every kind, and what a solution says of them."""

import math

import numpy as np
import pytest
from dae_problems import DOUBLE_START, HORIZONTAL, double_pendulum, pendulum

import minimd.integrators as mi
from minimd.integrators.ode.differences import accurate_differences, error_of_differences, time_derivative

FUNCTIONS = {  # a function, a place, its derivative there
    "a length": (lambda q: 0.5 * (q @ q - 1.0), [0.6, -0.8], [0.6, -0.8]),
    "1/r": (lambda q: 1.0 / np.sqrt(q @ q), [0.3, 0.4, 0.0], [-2.4, -3.2, 0.0]),
    "r⁻¹²": (lambda q: (q @ q) ** -6, [3.0, 4.0, 0.0], [-36.0 / 5.0**14, -48.0 / 5.0**14, 0.0]),
    "an angle of zero": (lambda q: [math.sin(q[0]) + q[1] ** 2], [0.0, 1.3], [1.0, 2.6]),
    "10 km beside an angle": (lambda q: q[0] * 1e-4 - np.cos(q[1]), [1e4, 0.1], [1e-4, math.sin(0.1)]),
    "a length of 1 Å in meters": (lambda q: 0.5 * (q @ q - 1e-20), [1e-10, 0.0], [1e-10, 0.0]),
    "steep": (lambda q: np.exp(30.0 * q[0]) + q[1], [0.2, 1.0], [30.0 * math.exp(6.0), 1.0]),
    "near the end of its domain": (
        lambda q: [math.sqrt(1.0 - q[0] ** 2) + q[1]],
        [0.995, 1.0],
        [-0.995 / math.sqrt(1.0 - 0.995**2), 1.0],
    ),
    # not analytic
    "abs": (lambda q: abs(q[0]) + q[1], [-0.5, 0.3], [-1.0, 1.0]),
    "abs beside its kink": (lambda q: abs(q[0] - 0.501) + q[1], [0.5, 0.3], [-1.0, 1.0]),
    "norm": (lambda q: np.linalg.norm(q), [0.6, -0.8], [0.6, -0.8]),
    "conj": (lambda q: (q * np.conj(q)).sum(), [0.6, -0.8], [1.2, -1.6]),
    "a branch": (lambda q: q[0] if q[0] > 0.0 else -2.0 * q[0], [-0.3, 1.0], [-2.0, 0.0]),
    "cast to real": (lambda q: float(q[0]) ** 2 + np.asarray(q, dtype=float)[1], [0.3, 1.0], [0.6, 1.0]),
}


def derivative(function, place):
    return accurate_differences(lambda x: np.array(function(x), dtype=float).reshape(-1), np.array(place))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_differences_have_twelve_digits(name):
    function, place, exact = FUNCTIONS[name]
    assert derivative(function, place)[0] == pytest.approx(np.array(exact), rel=1e-12, abs=1e-12 * np.abs(exact).max())


def single(q):
    """In single precision, where differences have five digits."""
    return np.array([float(np.float32(q[0]) * np.float32(q[1]))])


def test_the_estimate_is_the_error_and_noise_is_not_taken_for_a_derivative():
    """Single precision is flat over narrow spacings: two formulas that agree on zero."""
    place = np.array([1.3, 0.7])
    error = np.abs(accurate_differences(single, place) - place[::-1]).max() / 1.3
    assert 1e-7 < error < 1e-4
    assert 0.1 < error_of_differences(single, place) / error < 10.0
    for x in np.random.default_rng(1).uniform(0.5, 2.0, (300, 2)):
        assert derivative(single, x)[0] == pytest.approx(x[::-1], rel=2e-3)


def test_there_is_no_derivative_where_a_function_has_no_values():
    with np.errstate(invalid="ignore"):
        assert np.isnan(derivative(lambda q: np.sqrt(q - 1.0), [1.0])).all()


@pytest.mark.parametrize(("order", "digits"), [(1, 1e-12), (2, 1e-9)])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_time_derivatives_in_any_unit(order, digits, unit):
    found = time_derivative(lambda t: np.array([np.exp(2.0 * t / unit) + t / unit]), order, unit)
    assert found == pytest.approx([3.0, 4.0][order - 1] / unit**order, rel=digits)


SWINGING = mi.Mechanical(1.0, lambda q: np.array([0.0, -1.0]), lambda q: (q @ q - 1) / 2)


@pytest.mark.parametrize(
    ("given", "by_differences", "method", "start"),
    [
        (double_pendulum(), double_pendulum(with_jacobian=False), mi.VelocityVerlet, DOUBLE_START),
        (pendulum(), SWINGING, mi.RadauIIA3, HORIZONTAL),
    ],
)
def test_a_solution_tells_how_its_derivatives_were_found(given, by_differences, method, start):
    """The error is the number before the last words."""
    said = mi.run_steps(given, method(0.01), start, 2).message
    more = mi.run_steps(by_differences, method(0.01), start, 2).message
    assert more.startswith(said + "; G = ∂g/∂q by differences")
    assert 1e-16 < float(more.removesuffix(" at the start").split()[-1]) < 1e-12
