"""Differential-algebraic equations: orders at index 1, 2 and 3, consistent starts, published solutions, any unit;
and derivatives by differences: their digits on functions of every kind, and what a solution says of them.

E. Hairer, C. Lubich, M. Roche (1989), table 2.3; K. E. Brenan, S. L. Campbell, L. R. Petzold (1989), 3.2."""

from math import exp, sqrt

import andrews
import dae_problems as dae
import numpy as np
import pytest
from numpy import cos, sin
from references import load
from small_problems import GAUSS
from wrong_calls import assert_answered

import minimd as md
import minimd.integrators as mi
from minimd.integrators import RadauIIA3, StepControl, run_adaptive, run_steps
from minimd.textbook.ode.functions import accurate_differences, error_of_differences, time_derivative
from minimd.textbook.ode.runge_kutta import StageStep

slow = pytest.mark.slow
RADAU_ORDERS = {mi.ImplicitEuler: [(1, 1), (1, 1), (1, 1, 1)], mi.RadauIIA2: [(3, 3), (3, 2), (3, 2, 1)]}
RADAU_ORDERS |= {RadauIIA3: [(5, 5), (5, 3), (5, 3, 2)]}
GAUSS_ORDERS = [  # at index 1: z has s for even s, s + 1 for odd s, as R(∞) = (−1)ˢ; at index 2
    (mi.GaussLegendre1, (2, 2), dae.INDEX2_LINEAR, (2, 0)), (mi.GaussLegendre2, (4, 2), dae.INDEX2_LINEAR, (2, 0)),
    (mi.GaussLegendre3, (6, 4), dae.INDEX2, (4, 2)),
]  # fmt: skip
VIOLATED = [  # x(0) = 1 with 0 = x − t; positions off the circle, velocities along the rod
    (dae.path_of_x(), ([1.0],), ("constraint 0 = g", "1.00e+00", "y would have to move by 1")),
    (dae.implicit_path_of_x(), [1.0, 0.0], ("equation 1 stays at 1.00e+00",)),
    (dae.pendulum(), ((1.0, 0.1), (0.0, 0.0)), ("constraint 0 = g", "5.00e-03", "q would have to move by 5")),
    (dae.pendulum(), ((1.0, 0.0), (0.3, 0.0)), ("hidden constraint", "3.00e-01", "v would have to move")),
    pytest.param(dae.implicit_pendulum(), [1.0, 0.1, 0, 0, 0], ("equation 4 stays at 5.00e-03",), marks=slow),
    pytest.param(dae.implicit_pendulum(), [1.0, 0, 0.3, 0, 0], ("derivative of equation 4 stays",), marks=slow),
]
RELEASED = ([1.0, 0.0, 0.0, 0.0], [0.0])
RETURNS = [  # problem, start, method, steps of a period, variables that are accurate, periods
    (dae.reduced_pendulum(), RELEASED, mi.GaussLegendre3, 200, 4, 1),
    pytest.param(dae.reduced_pendulum(), RELEASED, RadauIIA3, 300, 4, 1, marks=slow),
    pytest.param(dae.stabilized_pendulum(), RELEASED[:1], RadauIIA3, 300, 4, 1, marks=slow),
    pytest.param(dae.stabilized_pendulum(), RELEASED[:1], mi.GaussLegendre3, 400, 4, 1, marks=slow),
    (dae.pendulum(), dae.HORIZONTAL, RadauIIA3, 300, 2, 1),  # velocities are of order 3: with 2000 steps
    pytest.param(dae.pendulum(), dae.HORIZONTAL, RadauIIA3, 2000, 4, 15, marks=slow),
    pytest.param(dae.pendulum(), dae.HORIZONTAL, mi.BDF5, 1200, 4, 1, marks=slow),
]
FUNCTIONS = {  # a function, a place, its derivative there
    "a length": (lambda q: 0.5 * (q @ q - 1.0), [0.6, -0.8], [0.6, -0.8]),
    "1/r": (lambda q: 1.0 / np.sqrt(q @ q), [0.3, 0.4, 0.0], [-2.4, -3.2, 0.0]),
    "r⁻¹²": (lambda q: (q @ q) ** -6, [3.0, 4.0, 0.0], [-36.0 / 5.0**14, -48.0 / 5.0**14, 0.0]),
    "an angle of zero": (lambda q: [sin(q[0]) + q[1] ** 2], [0.0, 1.3], [1.0, 2.6]),
    "10 km beside an angle": (lambda q: q[0] * 1e-4 - np.cos(q[1]), [1e4, 0.1], [1e-4, sin(0.1)]),
    "a length of 1 Å in meters": (lambda q: 0.5 * (q @ q - 1e-20), [1e-10, 0.0], [1e-10, 0.0]),
    "steep": (lambda q: np.exp(30.0 * q[0]) + q[1], [0.2, 1.0], [30.0 * exp(6.0), 1.0]),
    "near the end of its domain":
        (lambda q: [sqrt(1.0 - q[0] ** 2) + q[1]], [0.995, 1.0], [-0.995 / sqrt(1.0 - 0.995**2), 1.0]),
    # not analytic
    "abs": (lambda q: abs(q[0]) + q[1], [-0.5, 0.3], [-1.0, 1.0]),
    "abs beside its kink": (lambda q: abs(q[0] - 0.501) + q[1], [0.5, 0.3], [-1.0, 1.0]),
    "norm": (lambda q: np.linalg.norm(q), [0.6, -0.8], [0.6, -0.8]),
    "conj": (lambda q: (q * np.conj(q)).sum(), [0.6, -0.8], [1.2, -1.6]),
    "a branch": (lambda q: q[0] if q[0] > 0.0 else -2.0 * q[0], [-0.3, 1.0], [-2.0, 0.0]),
    "cast to real": (lambda q: float(q[0]) ** 2 + np.asarray(q, dtype=float)[1], [0.3, 1.0], [0.6, 1.0]),
}  # fmt: skip


def slow_but(quick, methods):
    return [method if method is quick else pytest.param(method, marks=slow) for method in methods]


@pytest.mark.parametrize("method", RADAU_ORDERS)
def test_radau_iia_has_order_2s_minus_1_where_the_index_lets_it(method):
    """In y and q; s in z of index 2 and v; s − 1 in multipliers of index 3, but 1 with equal steps for s = 1."""
    for problem, expected in zip((dae.INDEX1, dae.INDEX2, dae.INDEX3), RADAU_ORDERS[method], strict=True):
        assert dae.measured_orders(*problem, method) == pytest.approx(expected, abs=0.2)  # truncation


@pytest.mark.parametrize(("method", "at_index_1", "problem", "at_index_2"), GAUSS_ORDERS)
def test_gauss_loses_order_at_index_2(method, at_index_1, problem, at_index_2):
    """y: s + 1 for odd s, s for even s; z: s − 1 and s − 2, nothing for s = 1 and 2."""
    assert dae.measured_orders(*dae.INDEX1, method, n_steps=(6, 12)) == pytest.approx(at_index_1, abs=0.2)
    assert dae.measured_orders(*problem, method, n_steps=(20, 40)) == pytest.approx(at_index_2, abs=0.1)


@pytest.mark.parametrize("method", slow_but(mi.GaussLegendre2, GAUSS))
def test_gauss_is_refused_at_index_3_because_multipliers_do_not_converge(method):
    """They are off by as much after steps half as long, or by four times more (s = 2); q and v would hide it."""
    problem, errors = dae.pendulum(), []
    assert_answered(lambda: run_steps(problem, method(0.01), dae.HORIZONTAL, 1), TypeError, method.name)
    exact = run_steps(problem, RadauIIA3(0.005), dae.HORIZONTAL, 100).y[-1]
    for n_steps in (50, 100):
        step, y = StageStep(problem, method.tableau), problem.begin(dae.HORIZONTAL)
        for k in range(n_steps):
            y = step(0.5 * k / n_steps, y, 0.5 / n_steps)
        errors.append([np.abs(part).max() for part in problem.parts(y - exact)])
    coarse, fine = errors
    assert fine[0] < 0.3 * coarse[0]
    assert fine[2] > 0.9 * coarse[2] > 10.0


@pytest.mark.parametrize("method", slow_but(mi.BDF3, [mi.BDF1, mi.BDF2, mi.BDF3, mi.BDF4, mi.BDF5]))
def test_bdf_has_order_k_in_every_variable(method):
    """And a shortened last step is as accurate as the others."""
    for problem in (dae.INDEX1, dae.INDEX2, dae.INDEX3):
        orders = dae.measured_orders(*problem, method, n_steps=(30, 60))
        assert orders == pytest.approx([method.order] * orders.size, abs=0.45)  # truncation
    decay, ends = mi.FirstOrder(lambda t, y: -2 * t * y * y), (1.0, 0.9963)
    whole, shortened = (mi.run_until(decay, method(0.01), [1.0], t).y[-1, 0] - 1 / (1 + t**2) for t in ends)
    assert shortened == pytest.approx(whole, rel=0.1)


@pytest.mark.parametrize(("problem", "solution"), [dae.INDEX1, dae.INDEX2, dae.INDEX3])
def test_algebraic_variables_are_computed(problem, solution):
    for t in (0.0, 0.4):
        *given, algebraic = solution(t)
        if problem.index < 3:
            given.append([1.3 * algebraic[0]])  # a guess, as there are two roots, or g depends on both
        computed = problem.parts(problem.begin(tuple(given), t))
        assert computed[-1] == pytest.approx(algebraic, rel=1e-8)  # of differences
        assert all(np.array_equal(*parts) for parts in zip(computed[:-1], given, strict=False))


def test_a_support_that_moves_is_seen_in_the_hidden_constraint():
    """A bead on a wire that rotates at constant rate about the origin: 0 = y cos ωt − x sin ωt."""
    omega, t = 2.0, 0.3
    problem = mi.Mechanical(1.0, lambda q: np.zeros(2), lambda t, q: q[1] * cos(omega * t) - q[0] * sin(omega * t))
    along, across = np.array([cos(omega * t), sin(omega * t)]), np.array([-sin(omega * t), cos(omega * t)])
    y = problem.begin((along, omega * across + 0.5 * along), t)
    assert y[4] == pytest.approx(-2 * omega * 0.5, abs=1e-8)  # the Coriolis force, 2 ω r′
    assert_answered(lambda: problem.begin((along, 0.5 * along), t), ValueError, "hidden constraint", "G v + g_t")


@pytest.mark.parametrize(("problem", "wrong", "said"), VIOLATED)
def test_a_violated_constraint_is_named_and_corrected_if_asked(problem, wrong, said):
    assert_answered(lambda: problem.begin(wrong), ValueError, "t = 0", *said)
    x, z, *v = problem.corrected(wrong)[:4]
    left = (x * x + z * z - 1.0, x * v[0] + z * v[1]) if v else (x, z - 1.0)
    assert left == pytest.approx((0.0, 0.0), abs=1e-8 if isinstance(problem, mi.Implicit) else 1e-12)


@slow
def test_a_fully_implicit_pendulum_knows_its_slopes_its_index_and_its_path():
    problem = dae.implicit_pendulum()
    y = problem.begin([1.0, 0.0, 0.0, 2.0, 0.0])
    assert y == pytest.approx([1.0, 0.0, 0.0, 2.0, 4.0], abs=1e-8)
    assert problem.field(0.0, y)[:4] == pytest.approx([0.0, 2.0, -4.0, -dae.GRAVITY], abs=1e-8)
    assert (problem.index, *problem.levels) == (3, 0, 0, 1, 1, 2)
    starts = (problem, y), (dae.pendulum(), (y[:2], y[2:4]))
    one, other = (run_steps(p, RadauIIA3(0.01), start, 10).y for p, start in starts)
    assert one[1:] == pytest.approx(other[1:], abs=1e-8)  # the tension is rounding/h²


def test_a_fully_implicit_path_is_that_of_the_structured_form():
    assert dae.implicit_path_of_x().begin([1.0, 0.0], 1.0) == pytest.approx([1.0, 1.0], abs=1e-9)
    path = run_steps(dae.path_of_x(), RadauIIA3(0.1), ([1.0],), 3, t0=1.0)
    assert path.y == pytest.approx(np.array([[1, 1], [1.1, 1], [1.2, 1], [1.3, 1]]), abs=1e-10)
    plain = mi.FirstOrder(lambda y: [y[1], -sin(y[0])])
    residual = mi.Implicit(lambda y, slope: [slope[0] - y[1], slope[1] + sin(y[0])])
    one, other = (run_steps(problem, mi.GaussLegendre3(0.1), [1.0, 0.0], 10).y for problem in (plain, residual))
    assert other == pytest.approx(one, abs=1e-13)
    problem = mi.Implicit(lambda y, slope: slope**2 + y**2 - 1)  # y(0) = 0: sine, up or down, as the guess says
    for sign in (1.0, -1.0):
        end = run_steps(problem, RadauIIA3(0.05), ([0.0], [0.8 * sign]), 20).y[-1]
        assert end == pytest.approx([sign * sin(1.0)], abs=1e-9)


def test_equations_that_lose_their_solution_end_the_run_before():
    """y′ = 1 on the circle y² + z² = 1 ends at y = 1."""
    problem = mi.Hessenberg1(lambda: 1.0, lambda y, z: y * y + z * z - 1)
    with pytest.raises(md.ConvergenceError, match=r"step \d+ from t = .* with timestep 0\.03") as told:
        run_steps(problem, RadauIIA3(0.03), ([0.0], [1.0]), 40)
    assert told.value.solution.t[-1] > 0.95
    stopped = run_adaptive(problem, RadauIIA3, ([0.0], [1.0]), 2.0, control=StepControl(min_step=1e-4))
    assert not stopped.success
    assert stopped.t[-1] == pytest.approx(1.0, abs=1e-3)


def weierstrass(blocks, n_regular, rng):
    """M, A of a regular pencil whose nilpotent blocks have these sizes, hidden by random matrices."""
    n = n_regular + sum(blocks)
    m, a, end = np.eye(n), np.eye(n), n_regular
    a[:n_regular, :n_regular] = rng.normal(size=(n_regular, n_regular))
    for block in blocks:
        m[end : end + block, end : end + block] = np.eye(block, k=1)
        end += block
    left, right = rng.normal(size=(2, n, n))
    return left @ m @ right, 10.0 ** rng.uniform(-6, 6) * left @ a @ right


@pytest.mark.parametrize("blocks", [(), (1,), (1, 1, 1), (2,), (3, 1), (2, 2), (4,), (5, 2, 1)])
def test_index_of_a_pencil_is_that_of_its_largest_nilpotent_block(blocks):
    for n_regular in (1, 4):
        rng = np.random.default_rng(1)
        for _ in range(10):
            assert mi.pencil_index(*weierstrass(blocks, n_regular, rng)) == max(blocks, default=0)


@pytest.mark.parametrize(("problem", "start", "method", "n_steps", "n_kept", "n_periods"), RETURNS)
def test_pendulum_of_any_index_returns_after_its_period(problem, start, method, n_steps, n_kept, n_periods):
    path = run_steps(problem, method(2.0 / n_steps), start, n_periods * n_steps, every=n_steps)
    assert len(path.t) == n_periods + 1
    if isinstance(problem, mi.Mechanical):
        assert np.abs((path.y[:, :2] ** 2).sum(axis=1) - 1).max() < 3e-15  # rounding
    assert np.abs(path.y[:, :n_kept] - [1.0, 0.0, 0.0, 0.0][:n_kept]).max() < 1e-8  # truncation


@slow
def test_robertson_to_1e11():
    known = load("dae/robertson.json")
    control = StepControl(rtol=1e-9, atol=[1e-15, 1e-19, 1e-9])
    path = run_adaptive(dae.robertson(), RadauIIA3, ([1.0, 0.0], [0.0]), known["T"], control=control)
    assert (path.success, len(path.t) < 500) == (True, True)
    assert path.y[-1] == pytest.approx(known["y"], rel=1e-6)  # truncation


def test_andrews_mechanism_starts_as_published():
    """Accelerations and forces of the constraints follow from the positions; an error of G is multiplied by 500."""
    w, multipliers = (np.array(andrews.DATA[key], dtype=float) for key in ("w0_first2", "lambda0_first2"))
    for gradient, digits in ((andrews.gradient, 1e-14), (None, 3e-11)):
        problem = mi.Mechanical(andrews.mass, andrews.force, andrews.closures, gradient)
        y = problem.begin(andrews.START)
        assert problem.field(0.0, y)[7:9] == pytest.approx(w, rel=digits)
        assert problem.parts(y)[2][:2] == pytest.approx(multipliers, rel=digits)


@slow
def test_andrews_mechanism():
    problem, end = mi.Mechanical(andrews.mass, andrews.force, andrews.closures, andrews.gradient), andrews.DATA["T"]
    path = run_steps(problem, RadauIIA3(end / 1500), andrews.START, 1500)
    assert path.y[-1, [0, 2, 4, 6]] == pytest.approx(andrews.DATA["q_end_components_1_3_5_7"], rel=1e-8)


def test_step_control_meets_its_tolerance_at_index_3():
    """The error of the position falls with rtol, the multiplier being weighted by h²."""
    for rtol in (1e-4, 1e-6):
        path = run_adaptive(dae.pendulum(), RadauIIA3, dae.HORIZONTAL, 1.0, control=StepControl(rtol=rtol, atol=rtol))
        assert np.abs(path.y[-1, :2] - [-1.0, 0.0]).max() < 10 * rtol
    assert len(path.t) < 500


@pytest.mark.parametrize("n_steps", [200, pytest.param(5000, marks=slow)])
def test_a_pendulum_of_index_3_swings_in_any_unit(n_steps):
    def path(length, time):
        problem = dae.pendulum(length, time)
        y = run_steps(problem, RadauIIA3(2.0 * time / n_steps), ((length, 0.0), (0.0, 0.0)), 15).y[1:]
        q, v, tension = problem.parts(y)
        return np.hstack([q / length, v * time / length, tension * time**2])

    here = path(1.0, 1.0)
    for length, time in [(1e-10, 1e-12), (1e-9, 1e3), (1.0, 1e6), (1e3, 1e-3)]:
        assert path(length, time) == pytest.approx(here, abs=1e-6)  # rounding/h² in the tension


def test_a_variable_that_is_smaller_by_13_powers_of_ten_is_solved_for_as_well():
    """Robertson's y₂ in balance, 0.04 y₁ = 10⁴ y₂ y₃ + 3 10⁷ y₂², after a step that is long beside its relaxation."""
    control = StepControl(rtol=1e-6, atol=[1e-12, 1e-18, 1e-8])
    y = run_adaptive(dae.robertson(), RadauIIA3, ([1.0, 0.0], [0.0]), 1e9, control=control).y[-1]
    y1, y2, y3 = run_steps(dae.robertson(), mi.ImplicitEuler(1e9), (y[:2], y[2:]), 1).y[-1]
    gain, loss = 0.04 * y1, 1e4 * y2 * y3 + 3e7 * y2**2
    assert y2 < 1e-11
    assert gain - loss == pytest.approx((y2 - y[1]) / 1e9, abs=1e-12 * gain)


def test_the_jacobian_of_the_problem_is_used():
    jacobians = (lambda y: [[0.0, 1.0], [-cos(y[0]), 0.0]]), None
    problems = (mi.FirstOrder(lambda y: [y[1], -sin(y[0])], jacobian) for jacobian in jacobians)
    given, found = (run_steps(problem, RadauIIA3(0.1), [1.0, 0.0], 50) for problem in problems)
    assert given.y == pytest.approx(found.y, abs=1e-14)
    assert given.nfev < found.nfev


def derivative(function, place):
    return accurate_differences(lambda x: np.array(function(x), dtype=float).reshape(-1), np.array(place))


@pytest.mark.parametrize(("function", "place", "exact"), FUNCTIONS.values(), ids=FUNCTIONS)
def test_differences_have_twelve_digits(function, place, exact):
    assert derivative(function, place)[0] == pytest.approx(np.array(exact), rel=1e-12, abs=1e-12 * np.abs(exact).max())


def test_the_estimate_is_the_error_and_noise_is_not_taken_for_a_derivative():
    """Single precision, five digits for differences, is flat over narrow spacings: two formulas agree on zero."""
    single = lambda q: np.array([float(np.float32(q[0]) * np.float32(q[1]))])  # noqa: E731
    place = np.array([1.3, 0.7])
    error = np.abs(accurate_differences(single, place) - place[::-1]).max() / 1.3
    assert 1e-7 < error < 1e-4
    assert 0.1 < error_of_differences(single, place) / error < 10.0
    for x in np.random.default_rng(1).uniform(0.5, 2.0, (300, 2)):
        assert derivative(single, x)[0] == pytest.approx(x[::-1], rel=2e-3)
    with np.errstate(invalid="ignore"):
        assert np.isnan(derivative(lambda q: np.sqrt(q - 1.0), [1.0])).all()  # there are no values on one side


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_time_derivatives_in_any_unit(unit):
    for order, exact, digits in ((1, 3.0, 1e-12), (2, 4.0, 1e-9)):
        found = time_derivative(lambda t: np.array([np.exp(2.0 * t / unit) + t / unit]), order, unit)
        assert found == pytest.approx(exact / unit**order, rel=digits)
