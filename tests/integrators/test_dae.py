"""Differential-algebraic equations: orders at index 1, 2 and 3, consistent starts, published solutions, any unit.

E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems by Runge-Kutta Methods (1989),
table 2.3; K. E. Brenan, S. L. Campbell, L. R. Petzold (1989), 3.2.
"""

import andrews
import dae_problems as dae
import numpy as np
import pytest
from dae_problems import GRAVITY, HORIZONTAL, INDEX1, INDEX2, INDEX2_LINEAR, INDEX3, pendulum
from numpy import cos, sin
from references import load
from small_problems import GAUSS
from wrong_calls import assert_answered

import minimd.integrators as mi
from minimd.integrators import RadauIIA3, StepControl, run_adaptive, run_steps
from minimd.integrators.ode.bdf import slope_weights
from minimd.integrators.ode.runge_kutta import StageStep
from minimd.structure.errors import ConvergenceError

BDFS = [mi.BDF1, mi.BDF2, mi.BDF3, mi.BDF4, mi.BDF5]


# ---- orders of y and z, or of q, v and the multiplier


@pytest.mark.parametrize(
    ("method", "orders"),
    [
        (mi.ImplicitEuler, [(1, 1), (1, 1), (1, 1, 1)]),
        (mi.RadauIIA2, [(3, 3), (3, 2), (3, 2, 1)]),
        (RadauIIA3, [(5, 5), (5, 3), (5, 3, 2)]),
    ],
)
def test_radau_iia_has_order_2s_minus_1_where_the_index_lets_it(method, orders):
    """In y and q; s in z of index 2 and v; s − 1 in multipliers of index 3, but 1 with equal steps for s = 1."""
    for problem, expected in zip((INDEX1, INDEX2, INDEX3), orders, strict=True):
        assert dae.measured_orders(*problem, method) == pytest.approx(expected, abs=0.2)  # truncation


@pytest.mark.parametrize(("method", "expected"), list(zip(GAUSS[:3], [(2, 2), (4, 2), (6, 4)], strict=True)))
def test_gauss_has_order_2s_in_y_and_the_stage_order_in_z_of_index_1(method, expected):
    """z: s for even s, s + 1 for odd s, as R(∞) = (−1)ˢ."""
    assert dae.measured_orders(*INDEX1, method, n_steps=(6, 12)) == pytest.approx(expected, abs=0.2)


@pytest.mark.parametrize(("method", "expected"), list(zip(GAUSS[:3], [(2, 0), (2, 0), (4, 2)], strict=True)))
def test_gauss_loses_order_at_index_2(method, expected):
    """y: s + 1 for odd s, s for even s; z: s − 1 and s − 2, nothing for s = 1 and 2."""
    problem = INDEX2 if method is mi.GaussLegendre3 else INDEX2_LINEAR
    assert dae.measured_orders(*problem, method, n_steps=(20, 40)) == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("method", GAUSS)
def test_gauss_is_refused_at_index_3_because_multipliers_do_not_converge(method):
    """They are off by as much after steps half as long, or by four times more (s = 2); q and v would hide it."""
    problem = pendulum()
    with pytest.raises(TypeError, match=method.name):
        run_steps(problem, method(0.01), HORIZONTAL, 1)
    exact = run_steps(problem, RadauIIA3(0.5 / 250), HORIZONTAL, 250).y[-1]

    def errors(n_steps):
        step, y = StageStep(problem, method.tableau), problem.begin(HORIZONTAL)
        for k in range(n_steps):
            y = step(0.5 * k / n_steps, y, 0.5 / n_steps)
        return [np.abs(part).max() for part in problem.parts(y - exact)]

    coarse, fine = errors(50), errors(100)
    assert fine[0] < 0.3 * coarse[0]
    assert fine[2] > 0.9 * coarse[2] > 10.0


@pytest.mark.parametrize("method", BDFS)
def test_bdf_has_order_k_in_every_variable(method):
    for problem in (INDEX1, INDEX2, INDEX3):
        orders = dae.measured_orders(*problem, method, n_steps=(30, 60))
        assert orders == pytest.approx([method.order] * orders.size, abs=0.45)  # truncation


def test_weights_of_backward_differences():
    """Those of the books for equal steps; they differentiate polynomials exactly, whatever the nodes."""
    for book in ([1, -1], [3 / 2, -2, 1 / 2], [11 / 6, -3, 3 / 2, -1 / 3]):
        assert slope_weights(-np.arange(float(len(book)))) == pytest.approx(book, abs=1e-15)
    nodes = np.array([0.0, -0.3, -1.1, -1.9, -3.0])
    for power in range(5):
        assert slope_weights(nodes) @ nodes**power == pytest.approx(float(power == 1), abs=1e-13)


@pytest.mark.parametrize("method", BDFS)
def test_a_shortened_last_step_is_as_accurate_as_the_others(method):
    problem = mi.FirstOrder(lambda t, y: -2 * t * y * y)
    late, shortened = (
        mi.run_until(problem, method(0.01), [1.0], end).y[-1, 0] - 1 / (1 + end**2) for end in (1.0, 0.9963)
    )
    assert shortened == pytest.approx(late, rel=0.1)


def test_bdf_1_and_implicit_euler_are_the_same():
    one, other = (run_steps(pendulum(), method(0.01), HORIZONTAL, 50).y for method in (mi.BDF1, mi.ImplicitEuler))
    assert one == pytest.approx(other, abs=1e-11)


@pytest.mark.parametrize("method", [mi.BDF3, mi.RadauIIA2, RadauIIA3])
def test_constraints_are_kept_to_rounding(method):
    problem = pendulum()
    q, _, _ = problem.parts(run_steps(problem, method(0.02), HORIZONTAL, 200).y)
    assert np.abs((q**2).sum(axis=1) - 1).max() < 3e-15


# ---- consistent starts


@pytest.mark.parametrize(("problem", "solution"), [INDEX1, INDEX2, INDEX3])
@pytest.mark.parametrize("t", [0.0, 0.4])
def test_algebraic_variables_are_computed(problem, solution, t):
    *given, algebraic = solution(t)
    if problem.index < 3:
        given.append([1.3 * algebraic[0]])  # a guess, as there are two roots, or g depends on both
    computed = problem.parts(problem.begin(tuple(given), t))
    assert computed[-1] == pytest.approx(algebraic, rel=1e-8)  # of differences
    for part, exact in zip(computed[:-1], given, strict=False):
        assert np.array_equal(part, exact)


def test_the_tension_of_a_pendulum_is_computed_with_its_centrifugal_part():
    """λ = m (v² + q·g) on the unit circle."""
    q, v = np.array([0.6, -0.8]), 1.7 * np.array([0.8, 0.6])
    heavy = mi.Mechanical(3.0, lambda q: 3.0 * np.array([0.0, -GRAVITY]), lambda q: (q @ q - 1) / 2)
    for problem, mass in ((pendulum(), 1.0), (heavy, 3.0)):
        assert problem.begin((q, v))[4] == pytest.approx(mass * (v @ v + 0.8 * GRAVITY), rel=1e-9)


def test_a_support_that_moves_is_seen_in_the_hidden_constraint():
    """A bead on a wire that rotates at constant rate about the origin: 0 = y cos ωt − x sin ωt."""
    omega, t = 2.0, 0.3
    problem = mi.Mechanical(1.0, lambda q: np.zeros(2), lambda t, q: q[1] * cos(omega * t) - q[0] * sin(omega * t))
    along, across = np.array([cos(omega * t), sin(omega * t)]), np.array([-sin(omega * t), cos(omega * t)])
    y = problem.begin((along, omega * across + 0.5 * along), t)
    assert y[4] == pytest.approx(-2 * omega * 0.5, abs=1e-8)  # the Coriolis force, 2 ω r′
    assert_answered(lambda: problem.begin((along, 0.5 * along), t), ValueError, "hidden constraint", "G v + g_t")


@pytest.mark.parametrize(
    ("problem", "wrong", "said"),
    [
        (dae.path_of_x(), ([1.0],), ("constraint 0 = g", "1.00e+00", "y would have to move by 1")),
        (dae.implicit_path_of_x(), [1.0, 0.0], ("equation 1 stays at 1.00e+00",)),
        (pendulum(), ((1.0, 0.1), (0.0, 0.0)), ("constraint 0 = g", "5.00e-03", "q would have to move by 5")),
        (pendulum(), ((1.0, 0.0), (0.3, 0.0)), ("hidden constraint", "3.00e-01", "v would have to move")),
        (dae.implicit_pendulum(), [1.0, 0.1, 0.0, 0.0, 0.0], ("equation 4 stays at 5.00e-03",)),
        (dae.implicit_pendulum(), [1.0, 0.0, 0.3, 0.0, 0.0], ("derivative of equation 4 stays at 2.",)),
    ],
)
def test_a_violated_constraint_is_named_and_corrected_if_asked(problem, wrong, said):
    """x(0) = 1 with 0 = x − t; positions off the circle, velocities along the rod."""
    assert_answered(lambda: problem.begin(wrong), ValueError, "t = 0", *said)
    x, z, *v = problem.corrected(wrong)[:4]
    left = (x * x + z * z - 1.0, x * v[0] + z * v[1]) if v else (x, z - 1.0)
    assert left == pytest.approx((0.0, 0.0), abs=1e-8 if isinstance(problem, mi.Implicit) else 1e-12)


def test_x_equal_to_time_can_start_at_one_at_time_one():
    path = run_steps(dae.path_of_x(), RadauIIA3(0.1), ([1.0],), 3, t0=1.0)
    assert path.y == pytest.approx(np.array([[1, 1], [1.1, 1], [1.2, 1], [1.3, 1]]), abs=1e-10)
    assert dae.implicit_path_of_x().begin([1.0, 0.0], 1.0) == pytest.approx([1.0, 1.0], abs=1e-9)


def test_a_fully_implicit_problem_knows_its_slopes_its_index_and_how_rounding_is_amplified():
    problem = dae.implicit_pendulum()
    y = problem.begin([1.0, 0.0, 0.0, 2.0, 0.0])
    assert y == pytest.approx([1.0, 0.0, 0.0, 2.0, 4.0], abs=1e-8)
    assert problem.field(0.0, y)[:4] == pytest.approx([0.0, 2.0, -4.0, -GRAVITY], abs=1e-8)
    assert problem.index == 3
    assert list(problem.levels) == [0, 0, 1, 1, 2]


def test_a_fully_implicit_path_is_that_of_the_structured_form():
    one = run_steps(dae.implicit_pendulum(), RadauIIA3(0.01), [1.0, 0.0, 0.0, 0.0, 0.0], 40).y
    other = run_steps(pendulum(), RadauIIA3(0.01), HORIZONTAL, 40).y
    assert one[1:] == pytest.approx(other[1:], abs=1e-8)  # the tension is rounding/h²
    plain = run_steps(mi.FirstOrder(lambda y: [y[1], -np.sin(y[0])]), mi.GaussLegendre3(0.1), [1.0, 0.0], 30)
    residual = mi.Implicit(lambda y, slope: [slope[0] - y[1], slope[1] + np.sin(y[0])])
    assert run_steps(residual, mi.GaussLegendre3(0.1), [1.0, 0.0], 30).y == pytest.approx(plain.y, abs=1e-13)


def test_a_problem_that_is_nonlinear_in_its_slope_follows_the_branch_of_the_guess():
    """y′² + y² = 1, y(0) = 0: sine, up or down."""
    problem = mi.Implicit(lambda y, slope: slope**2 + y**2 - 1)
    for sign in (1.0, -1.0):
        end = run_steps(problem, RadauIIA3(0.05), ([0.0], [0.8 * sign]), 20).y[-1]
        assert end == pytest.approx([sign * sin(1.0)], abs=1e-9)


def test_equations_that_lose_their_solution_end_the_run_before():
    """y′ = 1 on the circle y² + z² = 1 ends at y = 1."""
    problem = mi.Hessenberg1(lambda: 1.0, lambda y, z: y * y + z * z - 1)
    with pytest.raises(ConvergenceError, match=r"step \d+ from t = .* with timestep 0\.03") as told:
        run_steps(problem, RadauIIA3(0.03), ([0.0], [1.0]), 40)
    assert told.value.solution.t[-1] > 0.95
    stopped = run_adaptive(problem, RadauIIA3, ([0.0], [1.0]), 2.0, control=StepControl(min_step=1e-6))
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
@pytest.mark.parametrize("n_regular", [1, 4])
def test_index_of_a_pencil_is_that_of_its_largest_nilpotent_block(blocks, n_regular):
    rng = np.random.default_rng(1)
    for _ in range(10):
        assert mi.pencil_index(*weierstrass(blocks, n_regular, rng)) == max(blocks, default=0)


# ---- beside numbers that others computed

RELEASED = ([1.0, 0.0, 0.0, 0.0], [0.0])


@pytest.mark.parametrize(
    ("problem", "start", "method", "n_steps", "n_kept"),
    [
        (dae.reduced_pendulum(), RELEASED, mi.GaussLegendre3, 200, 4),
        (dae.reduced_pendulum(), RELEASED, RadauIIA3, 300, 4),
        (dae.stabilized_pendulum(), RELEASED[:1], RadauIIA3, 300, 4),
        (dae.stabilized_pendulum(), RELEASED[:1], mi.GaussLegendre3, 400, 4),
        (pendulum(), HORIZONTAL, RadauIIA3, 300, 2),  # velocities are of order 3: with 2000 steps
        pytest.param(pendulum(), HORIZONTAL, RadauIIA3, 2000, 4, marks=pytest.mark.slow),
        (pendulum(), HORIZONTAL, mi.BDF5, 1200, 4),
    ],
)
def test_pendulum_of_any_index_returns_after_its_period(problem, start, method, n_steps, n_kept):
    path = run_steps(problem, method(2.0 / n_steps), start, n_steps)
    assert path.y[-1, :n_kept] == pytest.approx([1.0, 0.0, 0.0, 0.0][:n_kept], abs=1e-8)  # truncation


@pytest.mark.slow
def test_pendulum_of_index_3_returns_after_15_periods():
    path = run_steps(pendulum(), RadauIIA3(0.001), HORIZONTAL, 30_000, every=2000)
    assert np.abs(path.y[:, :4] - [1.0, 0.0, 0.0, 0.0]).max() < 1e-8  # truncation


def test_robertson_to_1e11():
    known = load("dae/robertson.json")
    control = StepControl(rtol=1e-9, atol=[1e-15, 1e-19, 1e-9])
    path = run_adaptive(dae.robertson(), RadauIIA3, ([1.0, 0.0], [0.0]), known["T"], control=control)
    assert path.success
    assert path.y[-1] == pytest.approx(known["y"], rel=1e-6)  # truncation
    assert len(path.t) < 500


@pytest.mark.parametrize(("gradient", "digits"), [(andrews.gradient, 1e-14), (None, 3e-11)])
def test_andrews_mechanism_starts_as_published(gradient, digits):
    """Accelerations and forces of the constraints follow from the positions; an error of G is multiplied by 500."""
    problem = mi.Mechanical(andrews.mass, andrews.force, andrews.closures, gradient)
    y = problem.begin(andrews.START)
    known = {key: np.array(andrews.DATA[key], dtype=float) for key in ("w0_first2", "lambda0_first2")}
    assert problem.field(0.0, y)[7:9] == pytest.approx(known["w0_first2"], rel=digits)
    assert problem.parts(y)[2][:2] == pytest.approx(known["lambda0_first2"], rel=digits)


@pytest.mark.parametrize("n_steps", [0, pytest.param(1500, marks=pytest.mark.slow)])
def test_andrews_mechanism(n_steps):
    problem, end = mi.Mechanical(andrews.mass, andrews.force, andrews.closures, andrews.gradient), andrews.DATA["T"]
    if n_steps:
        path, digits = run_steps(problem, RadauIIA3(end / n_steps), andrews.START, n_steps), 1e-8
    else:
        control = StepControl(rtol=1e-8, atol=1e-8)
        path, digits = run_adaptive(problem, RadauIIA3, andrews.START, end, control=control), 1e-6
    assert path.y[-1, [0, 2, 4, 6]] == pytest.approx(andrews.DATA["q_end_components_1_3_5_7"], rel=digits)


def test_step_control_meets_its_tolerance_at_index_3():
    """The error of the position falls with rtol, the multiplier being weighted by h²."""
    for rtol in (1e-5, 1e-7):
        path = run_adaptive(pendulum(), RadauIIA3, HORIZONTAL, 2.0, control=StepControl(rtol=rtol, atol=rtol))
        assert np.abs(path.y[-1, :2] - [1.0, 0.0]).max() < 10 * rtol
    assert len(path.t) < 500


def test_pendulum_beside_sundials():
    """IDA: variable-order BDF, for index 1."""
    ida = pytest.importorskip("sksundae.ida")

    def residual(t, y, slope, answer):
        x, q, u, v, tension = y
        answer[:4] = slope[0] - u, slope[1] - v, slope[2] + x * tension, slope[3] + q * tension + GRAVITY
        answer[4] = u * u + v * v - tension * (x * x + q * q) - GRAVITY * q

    solver = ida.IDA(residual, algebraic_idx=[4], rtol=1e-10, atol=1e-12, max_num_steps=100_000)
    theirs = solver.solve([0.0, 1.7], np.array([1.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, -GRAVITY, 0.0]))
    ours = run_steps(dae.reduced_pendulum(), RadauIIA3(0.005), RELEASED, 340)
    assert ours.y[-1] == pytest.approx(theirs.y[-1], abs=1e-6)
    of_index_3 = run_steps(pendulum(), RadauIIA3(0.001), HORIZONTAL, 1700)
    assert of_index_3.y[-1, :4] == pytest.approx(theirs.y[-1, :4], abs=1e-7)


# ---- equations of stages, solved to rounding in every variable


@pytest.mark.parametrize("n_steps", [200, 5000])
def test_a_pendulum_of_index_3_swings_in_any_unit(n_steps):
    def path(length, time):
        problem = pendulum(length, time)
        start = (length, 0.0), (0.0, 0.0)
        y = run_steps(problem, RadauIIA3(2.0 * time / n_steps), start, 40).y[1:]
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
    calls = []

    def jacobian(y):
        calls.append(y)
        return [[0.0, 1.0], [-np.cos(y[0]), 0.0]]

    given, found = (
        run_steps(mi.FirstOrder(lambda y: [y[1], -np.sin(y[0])], jac), RadauIIA3(0.1), [1.0, 0.0], 50)
        for jac in (jacobian, None)
    )
    assert given.y == pytest.approx(found.y, abs=1e-14)
    assert calls
    assert given.nfev < found.nfev
