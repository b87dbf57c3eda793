"""Drivers: fixed steps, steps up to a time, chosen by their error, reversible ones; what problems and steps take."""

import functools

import numba
import numpy as np
import pytest
import small_problems as small
from small_problems import KEPLER, KEPLER_START, ONE, OSCILLATOR, PERIOD, energy_errors, kepler_orbit, pericentre

import minimd as md
import minimd.integrators as mi
from minimd.integrators import BlanesMoan4, GaussLegendre2, RadauIIA3, SecondOrder, VelocityVerlet, run_steps, run_until

BACKWARDS = np.array([1.0, -1.0, -1.0, 1.0])  # the state at −t of an orbit from its pericentre, from that at t
COMET = pericentre(0.9)
TIMES = [(0, 1.05), (0, 1), (0.7, 0.8), (3, 4.05), (1e6, 1e6 + 1.05), (0, 0.03), (2, 0.95), (-1, -2.05), (0, 0.1 * 3)]
BUFFER = np.zeros((2, 3))
FORCES = {
    "default argument": lambda q, stiffness=1.0: -stiffness * q,
    "all three under other names": lambda time, x, velocity: -x,
    "partial": functools.partial(lambda stiffness, q: -stiffness * q, 1.0), "object": np.poly1d([-1.0, 0.0]),
    "numpy": np.negative, "numba": numba.njit(lambda q: -q), "numba, elementwise": numba.vectorize(lambda x: -x),
    "list": lambda q: [[-x for x in row] for row in q],
    "buffer used again": lambda q: np.negative(q, out=BUFFER if q.shape == BUFFER.shape else None),
    "transposed memory": lambda q: np.asfortranarray(-q), "long double": lambda q: (-q).astype(np.longdouble),
}  # fmt: skip
PUSHED = (1.0,), (0.5,)
EVERY_FEW = [mi.VelocityVerlet, mi.SE1, mi.SE2, mi.BlanesMoan4]
SOME = [mi.GaussLegendre2, mi.RadauIIA2]
OTHERS = [pytest.param(method, marks=pytest.mark.slow) for method in small.GAUSS + small.RADAU if method not in SOME]


def adaptive(method=BlanesMoan4, t_end=6.0, problem=KEPLER, start=KEPLER_START, t0=0.0, **control):
    return mi.run_adaptive(problem, method, start, t_end, t0, mi.StepControl(**control))


def reversible(h, t_end, method=VelocityVerlet, start=COMET, every=1, **control):
    return mi.run_reversible(KEPLER, method(h), start, t_end, control=mi.DensityControl(**control), every=every)


def falling(t, q, v):
    """G of ρ ∝ r^(−3/2)."""
    return -1.5 * (q @ v) / (q @ q)


def test_run_steps_keeps_the_first_state_every_so_many_and_the_last():
    whole = run_steps(OSCILLATOR, VelocityVerlet(0.1), ONE, 10, t0=2.0)
    some = run_steps(OSCILLATOR, VelocityVerlet(0.1), ONE, 10, t0=2.0, every=4)
    assert whole.success
    assert whole.t == pytest.approx(2.0 + 0.1 * np.arange(11), abs=1e-15)
    assert (np.hstack([whole.q, whole.v]) == whole.y).all()
    assert (np.column_stack([some.t, some.y]) == np.column_stack([whole.t, whole.y])[[0, 4, 8, 10]]).all()
    assert run_steps(OSCILLATOR, VelocityVerlet(0.1), ONE, 10, every=99).t == pytest.approx([0.0, 1.0])
    whole, some = (run_until(OSCILLATOR, VelocityVerlet(0.1), ONE, 1.05, every=n) for n in (1, 4))
    assert some.t == pytest.approx([0.0, 0.4, 0.8, 1.05], abs=1e-15)
    assert some.q[-1, 0] == whole.q[-1, 0]


@pytest.mark.parametrize(("t0", "t_end"), TIMES)
def test_run_until_ends_exactly_there(t0, t_end):
    """The last step is the shorter one, and there is none that rounding alone would make."""
    h, t = np.copysign(0.1, t_end - t0), t_end - t0
    path = run_until(SecondOrder(lambda t, q: -q + t - t0), GaussLegendre2(h), ONE, t_end, t0=t0)
    steps = np.diff(path.t) / h
    assert (path.t[0], path.t[-1], len(steps)) == (t0, t_end, np.ceil(round(abs(t) / 0.1, 6)))
    assert steps[:-1] == pytest.approx(1.0, abs=1e-8)
    assert 1e-8 < steps[-1] < 1.0 + 1e-8
    assert path.q[-1, 0] == pytest.approx(np.cos(t) - np.sin(t) + t, abs=1e-6)


@pytest.mark.parametrize("method", [VelocityVerlet, BlanesMoan4, GaussLegendre2, RadauIIA3])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_error_of_adaptive_runs_falls_with_the_tolerance(method, sign):
    """In both directions of time; in proportion to tolerance^(p/(p+1)) for an error per step."""
    exact, end = kepler_orbit(5.0) * (BACKWARDS if sign < 0.0 else 1.0), 2.0 + sign * 5.0
    runs = [adaptive(method, end, t0=2.0, rtol=tolerance, atol=tolerance) for tolerance in (1e-4, 1e-6, 1e-8)]
    errors = [np.abs(run.y[-1] - exact).max() for run in runs]
    assert all(run.success and run.t[-1] == end for run in runs)
    assert (np.diff(runs[0].t) * sign > 0.0).all()
    assert np.log(errors[0] / errors[2]) / np.log(1e4) == pytest.approx(method.order / (method.order + 1), abs=0.25)
    assert errors[2] < 1e-4
    assert runs[0].nfev < runs[1].nfev < runs[2].nfev


@pytest.mark.parametrize("method", [VelocityVerlet, BlanesMoan4, RadauIIA3])
def test_a_step_is_accepted_if_its_estimated_error_is_allowed(method):
    """‖y_h − y_{h/2, h/2}‖ / (2ᵖ − 1), in root mean square, and within 30 % of the true error."""
    one, two = (run_steps(KEPLER, method(0.05 / n), KEPLER_START, n).y[-1] for n in (1, 2))
    estimate = np.sqrt(np.mean((one - two) ** 2)) / (2.0**method.order - 1.0)
    assert estimate == pytest.approx(np.sqrt(np.mean((two - kepler_orbit(0.05)) ** 2)), rel=0.3)
    for atol, n_rejected in ((1.001 * estimate, 0), (0.999 * estimate, 1)):
        run = adaptive(method, 0.05, rtol=0.0, atol=atol, first_step=0.05)
        assert run.n_rejected >= n_rejected
        assert (len(run.t) == 2) == (n_rejected == 0)


def test_steps_of_adaptive_runs_stay_within_their_bounds_and_shorten_where_the_solution_is_fast():
    free, bound = adaptive(rtol=1e-6), adaptive(rtol=1e-6, max_step=0.2, first_step=0.001)
    long = adaptive(rtol=1e-3, atol=1e-3, min_step=0.1)
    assert np.diff(free.t).max() > 3.0 * np.diff(free.t).min()
    assert (np.diff(bound.t).max() <= 0.2 + 1e-15, bound.t[1]) == (True, 0.001)
    assert np.diff(long.t)[:-1].min() >= 0.1 - 1e-15


def test_an_adaptive_run_ends_after_so_many_steps():
    """The last one that is allowed may reach the end. Every step costs two short ones and a long one."""
    run = adaptive(md.PositionVerlet, rtol=1e-4)  # one evaluation each
    assert run.n_rejected > 0
    assert run.nfev == 3 * (len(run.t) - 1 + run.n_rejected)
    whole = adaptive(VelocityVerlet, 1.0, OSCILLATOR, ONE)
    n_tried = len(whole.t) - 1 + whole.n_rejected
    assert adaptive(VelocityVerlet, 1.0, OSCILLATOR, ONE, max_steps=n_tried).success
    some = adaptive(VelocityVerlet, 1.0, OSCILLATOR, ONE, max_steps=n_tried - 1)
    assert (some.success, len(some.t) + some.n_rejected) == (False, n_tried)
    assert f"after {n_tried - 1} steps" in some.message


def test_a_step_that_may_not_be_shorter_ends_the_run_where_it_is():
    run = adaptive(VelocityVerlet, rtol=1e-8, min_step=0.01)
    assert "min_step = 0.01" in run.message
    assert (run.success, run.t[-1] < 6.0) == (False, True)
    for method in (VelocityVerlet, RadauIIA3):  # y′ = y² from 1: infinite at t = 1
        run = adaptive(method, 2.0, SecondOrder(lambda q, v: v * v), ([0.0], [1.0]), rtol=1e-3, min_step=1e-4)
        assert run.t[-1] == pytest.approx(1.0, abs=5e-3)
        assert (run.success, run.message.startswith(f"stopped at t = {run.t[-1]:g}")) == (False, True)


def test_equations_without_a_solution_reject_the_step():
    stiff = SecondOrder(lambda q, v: -q - np.exp(5.0 * v), solver=mi.Newton(max_iterations=6))
    with pytest.raises(md.ConvergenceError):
        run_steps(stiff, VelocityVerlet(1.0), ([0.0], [1.0]), 1)
    run = adaptive(VelocityVerlet, 1.0, stiff, ([0.0], [1.0]), rtol=1e-4, first_step=1.0)
    assert (run.success, run.n_rejected > 0) == (True, True)


def test_tolerances_may_differ_from_component_to_component():
    """A component without tolerance to speak of drives the steps, one with a large tolerance does not."""
    problem, start = SecondOrder(lambda q: -np.array([1.0, 100.0]) * q), ((1.0, 1.0), (0.0, 0.0))
    tolerances = ([1e-8, fast, 1e-8, fast] for fast in (1e3, 1e-8))
    loose, tight = (adaptive(BlanesMoan4, 5.0, problem, start, rtol=0.0, atol=atol) for atol in tolerances)
    assert len(tight.t) > 3 * len(loose.t)
    assert loose.q[-1, 0] == pytest.approx(np.cos(5.0), abs=1e-6)
    flat = adaptive(VelocityVerlet, 1.0, OSCILLATOR, ((1.0, 0.0), (0.3, 0.0)), rtol=1e-5, atol=0.0)  # one stays zero
    assert (flat.success, flat.q[:, 1].any()) == (True, False)


def test_a_path_that_is_no_longer_finite_ends_the_run_with_what_was():
    falls = SecondOrder(lambda t, q: -q if t < 0.45 else np.nan * q)
    with pytest.raises(md.NonFiniteError, match=r"at t = 0.5; .* at t = 0.4; .*timestep \(0.1\)") as caught:
        run_steps(falls, VelocityVerlet(0.1), ONE, 20)
    found = caught.value.solution
    assert (found.success, np.isfinite(found.y).all(), round(found.t[-1], 9)) == (False, True, 0.4)
    assert not adaptive(VelocityVerlet, 1.0, falls, ONE, rtol=1e-3).success
    with pytest.raises(md.NonFiniteError, match=r"step \d+") as caught:
        mi.run_reversible(falls, VelocityVerlet(0.01), ONE, 1.0, control=mi.DensityControl(lambda t, q, v: 0.0))
    assert caught.value.solution.t[-1] < 0.5


@pytest.mark.parametrize("n_periods", [24, pytest.param(1000, marks=pytest.mark.slow)])
def test_energy_stays_bounded_with_reversible_steps_and_drifts_with_plain_step_control(n_periods):
    kept = reversible(0.002, n_periods * PERIOD)
    plain = adaptive(VelocityVerlet, n_periods * PERIOD, start=COMET, rtol=3e-6, atol=3e-6)
    halves = (np.array_split(np.abs(energy_errors(path)), 2) for path in (kept, plain))
    (early, late), (early_plain, late_plain) = (map(np.max, pair) for pair in halves)
    assert plain.nfev > kept.nfev * (2 if n_periods > 100 else 1)
    assert late == pytest.approx(early, rel=1e-3)
    assert max(early, late) < 0.0075
    assert late_plain > (0.09 if n_periods > 100 else 1.4 * early_plain)


@pytest.mark.parametrize("method", [VelocityVerlet, md.PositionVerlet, BlanesMoan4, GaussLegendre2])
def test_a_reversed_run_returns_to_the_start(method):
    there = reversible(0.003, PERIOD, method, rate=falling)
    end = there.q[-2], -there.v[-2]
    back = reversible(0.003, there.t[-2], method, start=end, density=there.density[-2], rate=falling)
    assert len(back.t) == len(there.t) - 1
    assert np.abs([back.q[-1] - COMET[0], back.v[-1] + COMET[1]]).max() < 1e-9  # rounding, amplified near the center


def test_the_density_that_is_found_is_the_density_in_closed_form():
    """ρ ∝ |f|^¾ = r^(−3/2) for Kepler; the integrated density follows it to the order of the method."""
    found, known = reversible(0.001, PERIOD), reversible(0.001, PERIOD, rate=falling)
    assert np.abs(found.y - known.y).max() < 1e-6  # truncation of the difference quotient
    assert found.density == pytest.approx((np.linalg.norm(found.q, axis=1) / 0.1) ** -1.5, rel=0.02)
    assert found.nfev == known.nfev + 2 * len(known.t)
    errors = [np.linalg.norm(reversible(h, PERIOD, rate=falling).q[-1] - COMET[0]) for h in (0.0008, 0.0004, 0.0002)]
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([2.0, 2.0], abs=0.15)
    constant = reversible(0.002, 0.2, rate=lambda t, q, v: 0.0)
    assert np.abs(constant.y - run_steps(KEPLER, VelocityVerlet(0.002), COMET, 100).y).max() < 1e-13


@pytest.mark.slow
def test_reversible_steps_are_the_same_in_any_unit():
    """An orbit that passes close by the origin of a ring-shaped attraction, where f is largest and |q| smallest."""

    def path(length, time):
        problem = SecondOrder(lambda q: length / time**2 * -(q / length) / (q @ q / length**2 + 1e-8) ** 1.5)
        start = (length, 0.0), (0.0, 1e-4 * length / time)
        return mi.run_reversible(problem, VelocityVerlet(0.002 * time), start, 1.2 * time)

    here = path(1.0, 1.0)
    assert np.linalg.norm(here.q, axis=1).min() < 1e-3
    for length, time in [(1e-10, 1e-12), (1e11, 3e7)]:
        there = path(length, time)
        assert len(here.t) == len(there.t)
        assert there.density == pytest.approx(here.density, rel=1e-6)  # rounding in the slope of ln |f|, amplified


def test_a_reversible_run_ends_after_so_many_steps():
    """And at its end, backwards in time too; every keeps the first and the last."""
    whole, some = (reversible(-0.002, -1.0, every=every) for every in (1, 7))
    assert (whole.t[-1], (some.y == [*whole.y[:-1:7], whole.y[-1]]).all()) == (-1.0, True)
    whole, some = reversible(0.002, 1.0), reversible(0.002, 1.0, max_steps=50, every=7)
    n_steps = len(whole.t) - 1
    ended = [reversible(0.002, 1.0, max_steps=n).success for n in (n_steps, n_steps - 1)]
    assert [whole.success, *ended, some.success] == [True, True, False, False]
    assert some.message.startswith(f"stopped at t = {whole.t[50]:g} after 50 steps")
    assert (some.y[-1] == whole.y[50]).all()


@pytest.mark.parametrize("force", FORCES.values(), ids=FORCES)
def test_any_function_is_a_force(force):
    start = np.arange(6).reshape(2, 3), np.ones((2, 3), dtype=int)
    for method in (VelocityVerlet, GaussLegendre2):
        path = run_steps(SecondOrder(force), method(0.1), start, 5)
        assert path.q.shape == path.v.shape == (6, 2, 3)
        assert path.y == pytest.approx(run_steps(OSCILLATOR, method(0.1), start, 5).y, abs=1e-14)


def test_one_number_is_a_state_too_and_arrays_of_the_start_are_not_touched():
    for method in (VelocityVerlet, GaussLegendre2):
        path, row = (run_steps(OSCILLATOR, method(0.1), start, 10) for start in ((1, 0), ONE))
        assert path.q.shape == (11,)
        assert path.q == pytest.approx(row.q[:, 0], abs=1e-15)
    start = np.array([1.0, 2.0]), np.array([0.5, 0.0])
    path = run_steps(mi.Partitioned(lambda v: v, lambda q: q), VelocityVerlet(0.1), start, 10)  # answer: the argument
    assert path.q[-1] == pytest.approx(start[0] * np.cosh(1.0) + start[1] * np.sinh(1.0), rel=1e-2)
    assert (start[0] == [1.0, 2.0]).all()


def test_functions_are_not_called_outside_the_time_of_the_run():
    """f(t) = 1/t² is no problem from t = 1 on."""
    grown = run_until(mi.FirstOrder(lambda t: [1.0 / t]), GaussLegendre2(0.1), [0.0], 2.0, t0=1.0)
    fallen = mi.run_adaptive(mi.FirstOrder(lambda t, y: -y / t), GaussLegendre2, [1.0], 2.0, t0=1.0)
    assert run_until(SecondOrder(lambda t, q: -2.0 / t**2 * q), GaussLegendre2(0.1), ONE, 2.0, t0=1.0).t[-1] == 2.0
    assert (grown.y[-1, 0], fallen.y[-1, 0]) == pytest.approx((np.log(2.0), 0.5), abs=1e-5)


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
        mi.run_steps(problem, method(0.1), PUSHED, 5)
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
        one, other = (mi.run_steps(problem, method(0.1), PUSHED, 20, t0=0.2).y for problem in (short, full))
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
    newton, fixed = (mi.run_steps(problem, mi.VelocityVerlet(0.1), PUSHED, 30).y for problem in problems)
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
