"""Steps on q′ = g(t, q, v), v′ = f(t, q, v): explicit where they can be, implicit where they must be, on one path."""

import numpy as np
import pytest
import small_problems as small

import minimd.integrators as mi

ONE = (1.0,), (0.5,)
EVERY_FEW = [mi.VelocityVerlet, mi.SE1, mi.SE2, mi.BlanesMoan4]
SOME = [mi.GaussLegendre2, mi.RadauIIA2]
OTHERS = [pytest.param(method, marks=pytest.mark.slow) for method in small.GAUSS + small.RADAU if method not in SOME]


class Unsolvable(mi.Newton):
    """A solver that is not to be asked."""

    iteration = lambda self: self  # noqa: E731

    def solve(self, *_arguments, **_more):
        raise AssertionError("solved")


def drift_in_wind(t, v):
    return v + np.sin(t)


def spring_in_time(t, q):
    return -q * (1.0 + 0.3 * np.cos(t))


def solves(problem, method):
    """Whether a step solves an equation."""
    try:
        mi.run_steps(problem, method(0.1), ONE, 5)
    except AssertionError as asked:
        return str(asked) == "solved"
    return False


@pytest.mark.parametrize("method", small.DETERMINISTIC)
def test_explicit_methods_solve_nothing_where_g_does_not_take_q_and_f_does_not_take_v(method):
    wind = mi.Partitioned(drift_in_wind, spring_in_time, solver=Unsolvable())
    for problem in (wind, mi.SecondOrder(spring_in_time, solver=Unsolvable())):
        assert solves(problem, method) == (not method.is_explicit)


def test_symplectic_euler_is_explicit_in_the_half_that_comes_last():
    """SE2 takes f at the old velocity, SE1 takes g at the old position; their adjoints must solve."""
    resisted = mi.SecondOrder(lambda q, v: -q - 0.1 * v * np.abs(v), solver=Unsolvable())
    curved = mi.Partitioned(lambda q, v: v * (1.0 + q * q), lambda q: -q, solver=Unsolvable())
    assert [solves(resisted, method) for method in (mi.SE2, mi.SE1, mi.VelocityVerlet)] == [False, True, True]
    assert [solves(curved, method) for method in (mi.SE1, mi.SE2, mi.VelocityVerlet)] == [False, True, True]


@pytest.mark.parametrize("method", small.ONE_STEP)
def test_functions_that_take_more_than_they_need_give_the_same_path(method):
    """The equation of a step that is explicit after all is solved by its first guess."""
    wind = mi.Partitioned(drift_in_wind, spring_in_time)
    in_full = mi.Partitioned(lambda t, q, v: drift_in_wind(t, v), lambda t, q, v: spring_in_time(t, q))
    swinging = mi.Partitioned(lambda t, q, v: v, lambda t, q, v: -np.sin(q))
    for short, full in ((wind, in_full), (mi.SecondOrder(lambda q: -np.sin(q)), swinging)):
        one, other = (mi.run_steps(problem, method(0.1), ONE, 20, t0=0.2).y for problem in (short, full))
        assert one == pytest.approx(other, abs=1e-13)  # rounding


@pytest.mark.parametrize("method", [*EVERY_FEW[:2], mi.GaussLegendre3])
def test_jacobians_given_or_found_and_fixed_points_lead_to_the_same_path(method):
    path = mi.run_steps(small.DRIVEN, method(0.1), small.TWISTED_START, 15).y
    g_q = lambda q, v: 2.0 * np.outer(v, q) + np.array([[0.0, 0.0], [0.5, 0.0]])  # noqa: E731
    f_v = lambda q, v: -2.0 * np.outer(q, v) - np.array([[0.0, 0.5], [0.0, 0.0]])  # noqa: E731
    wrong = lambda q, v: np.zeros((2, 2))  # noqa: E731  no harm but more iterations
    for more in ({"g_q": g_q, "f_v": f_v}, {"g_q": wrong, "f_v": wrong}, {"solver": mi.FixedPoint()}):
        problem = mi.Partitioned(small.driven_g, small.driven_f, **more)
        assert mi.run_steps(problem, method(0.1), small.TWISTED_START, 15).y == pytest.approx(path, abs=1e-13)


@pytest.mark.parametrize("damping", [0.5, 7.0, 15.0])
def test_fixed_points_are_found_to_rounding_however_slowly(damping):
    """Corrections that shrink by h damping/2 = 3/4 per iteration only are not taken for rounding before they are."""
    problems = (mi.SecondOrder(lambda q, v: -q - damping * v, solver=one) for one in (mi.Newton(), mi.FixedPoint(1000)))
    newton, fixed = (mi.run_steps(problem, mi.VelocityVerlet(0.1), ONE, 30).y for problem in problems)
    assert fixed == pytest.approx(newton, abs=1e-14)


@pytest.mark.parametrize("method", [*EVERY_FEW[:2], *small.GAUSS, *small.RADAU, mi.BDF3])
def test_units_change_nothing(method):
    def path(scale):
        problem = mi.Partitioned(lambda q, v: v * (1.0 + (q / scale) ** 2), lambda q, v: -q * (1.0 + (v / scale) ** 2))
        return mi.run_steps(problem, method(0.05), ([0.5 * scale], [0.3 * scale]), 20).y / scale

    unit = path(1.0)
    for scale in (1e-20, 1e20):
        assert path(scale) == pytest.approx(unit, abs=1e-12)


@pytest.mark.parametrize("method", SOME + OTHERS)
def test_implicit_steps_come_to_rest(method):
    """At rest the slopes are rounding of the state, which is nothing to solve any further."""
    problem = mi.FirstOrder(lambda y: np.array([y[1] - y[0] ** 3 + 0.3, 1.0 - y[1] + 0.1 * np.sin(y[0])]))
    for timestep in (0.25, 1.0):
        end = mi.run_steps(problem, method(timestep), [0.0, 2.0], round(50.0 / timestep), every=1000).y[-1]
        assert np.abs(problem.field(0.0, end)).max() < 1e-14
