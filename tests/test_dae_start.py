"""Consistent starts: computed, corrected, or refused with the constraint that is violated; the index of a problem and of a pencil."""

import numpy as np
import pytest
from dae_problems import GRAVITY, HORIZONTAL, INDEX1, INDEX2, INDEX3, pendulum
from numpy import cos, sin

from minimd.integrators import (
    FixedPoint,
    Hessenberg1,
    Hessenberg2,
    Hessenberg3,
    Implicit,
    Mechanical,
    RadauIIA3,
    StepControl,
    pencil_index,
    run_adaptive,
    run_steps,
)
from minimd.structure.errors import ConvergenceError


def implicit_pendulum():
    """q′ = v, v′ = −λ q − g, 0 = (q² − 1)/2, as F alone."""

    def equations(y, slope):
        x, z, vx, vz, tension = y
        return [
            slope[0] - vx,
            slope[1] - vz,
            slope[2] + tension * x,
            slope[3] + tension * z + GRAVITY,
            (x * x + z * z - 1) / 2,
        ]

    return Implicit(equations)


def path_of_x():
    """x′ = z, 0 = x − t."""
    return Hessenberg2(lambda z: z, lambda t, y: y - t)


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
    """λ = v² + q·g on the unit circle."""
    q, v = np.array([0.6, -0.8]), 1.7 * np.array([0.8, 0.6])
    problem = pendulum()
    assert problem.parts(problem.begin((q, v)))[2] == pytest.approx(v @ v + 0.8 * GRAVITY, rel=1e-9)
    assert Mechanical(3.0, lambda q: 3.0 * np.array([0.0, -GRAVITY]), lambda q: (q @ q - 1) / 2).begin((q, v))[
        4
    ] == pytest.approx(3.0 * (v @ v + 0.8 * GRAVITY), rel=1e-9)


def test_a_support_that_moves_is_seen_in_the_hidden_constraint():
    """A bead on a wire that rotates at constant rate about the origin: 0 = y cos ωt − x sin ωt."""
    omega, t = 2.0, 0.3
    problem = Mechanical(1.0, lambda q: np.zeros(2), lambda t, q: q[1] * cos(omega * t) - q[0] * sin(omega * t))
    along, across = np.array([cos(omega * t), sin(omega * t)]), np.array([-sin(omega * t), cos(omega * t)])
    y = problem.begin((along, omega * across + 0.5 * along), t)
    assert y[4] == pytest.approx(-2 * omega * 0.5, abs=1e-8)  # the Coriolis force, 2 ω r′
    with pytest.raises(ValueError, match=r"hidden constraint 0 = dg/dt = G v \+ g_t"):
        problem.begin((along, 0.5 * along), t)


def test_x_equal_to_time_cannot_start_at_one():
    """x′ = z, 0 = x − t, x(0) = 1: refused in Hessenberg form, and as F alone."""
    with pytest.raises(
        ValueError,
        match=r"violates the constraint 0 = g: its element 0 is 1\.00e\+00 at t = 0, and y would have to move by 1",
    ):
        run_steps(path_of_x(), RadauIIA3(0.1), ([1.0],), 3)
    implicit = Implicit(lambda t, y, slope: [slope[0] - y[1], y[0] - t])
    with pytest.raises(ValueError, match=r"violates F\(t, y, y′\) = 0: equation 1 stays at 1\.00e\+00 at t = 0"):
        run_steps(implicit, RadauIIA3(0.1), [1.0, 0.0], 3)


def test_it_can_start_at_one_at_time_one_or_be_corrected():
    assert run_steps(path_of_x(), RadauIIA3(0.1), ([1.0],), 3, t0=1.0).y == pytest.approx(
        np.array([[1, 1], [1.1, 1], [1.2, 1], [1.3, 1]]), abs=1e-10
    )
    assert path_of_x().corrected(([1.0],)) == pytest.approx([0.0, 1.0], abs=1e-12)
    implicit = Implicit(lambda t, y, slope: [slope[0] - y[1], y[0] - t])
    assert implicit.begin([1.0, 0.0], 1.0) == pytest.approx([1.0, 1.0], abs=1e-9)
    assert implicit.corrected([1.0, 0.0]) == pytest.approx([0.0, 1.0], abs=1e-9)


@pytest.mark.parametrize(
    ("start", "what"),
    [
        (
            ((1.0, 0.1), (0.0, 0.0)),
            r"the constraint 0 = g: its element 0 is 5\.00e-03 at t = 0, and q would have to move by 5",
        ),
        (
            ((1.0, 0.0), (0.3, 0.0)),
            r"the hidden constraint 0 = dg/dt = G v \+ g_t: its element 0 is 3\.00e-01 at t = 0, and v would have",
        ),
    ],
)
def test_a_violated_constraint_of_a_mechanism_is_named_and_corrected_if_asked(start, what):
    problem = pendulum()
    with pytest.raises(ValueError, match=what):
        problem.begin(start)
    q, v, _ = problem.parts(problem.corrected(start))
    assert q @ q == pytest.approx(1.0, abs=1e-14)
    assert q @ v == pytest.approx(0.0, abs=1e-12)
    problem.begin((q, v))


@pytest.mark.parametrize(
    ("start", "what"),
    [
        ([1.0, 0.1, 0.0, 0.0, 0.0], r"0: equation 4 stays at 5\.00e-03"),
        ([1.0, 0.0, 0.3, 0.0, 0.0], r"0: the first time derivative of equation 4 stays at 2\.\d+e-01"),
    ],
)
def test_hidden_constraints_are_found_from_the_equations_alone(start, what):
    with pytest.raises(ValueError, match=what):
        implicit_pendulum().begin(start)
    x, z, vx, vz, _ = implicit_pendulum().corrected(start)
    assert (x * x + z * z, x * vx + z * vz) == pytest.approx((1.0, 0.0), abs=1e-8)


def test_a_fully_implicit_problem_knows_its_slopes_its_index_and_how_rounding_is_amplified():
    problem = implicit_pendulum()
    y = problem.begin([1.0, 0.0, 0.0, 2.0, 0.0])
    assert y == pytest.approx([1.0, 0.0, 0.0, 2.0, 4.0], abs=1e-8)
    assert problem.field(0.0, y)[:4] == pytest.approx([0.0, 2.0, -4.0, -GRAVITY], abs=1e-8)
    assert problem.index == 3
    assert list(problem.levels) == [0, 0, 1, 1, 2]


def test_a_fully_implicit_path_is_that_of_the_structured_form():
    start = [1.0, 0.0, 0.0, 0.0, 0.0]
    one, other = (
        run_steps(implicit_pendulum(), RadauIIA3(0.01), start, 100),
        run_steps(pendulum(), RadauIIA3(0.01), HORIZONTAL, 100),
    )
    assert one.y[1:] == pytest.approx(other.y[1:], abs=1e-8)  # the tension is rounding/h²


def test_a_problem_that_is_nonlinear_in_its_slope_follows_the_branch_of_the_guess():
    """y′² + y² = 1, y(0) = 0: sine, up or down."""
    problem = Implicit(lambda y, slope: slope**2 + y**2 - 1)
    for sign in (1.0, -1.0):
        assert run_steps(problem, RadauIIA3(0.05), ([0.0], [0.8 * sign]), 20).y[-1] == pytest.approx(
            [sign * sin(1.0)], abs=1e-9
        )


@pytest.mark.parametrize(
    ("make", "start", "what"),
    [
        (lambda: Hessenberg1(lambda z: z, lambda y, z: y - 1 + 0 * z), ([1.0], [0.0]), "g_z must have full rank"),
        (
            lambda: Hessenberg2(lambda y, z: [z[0], -y[0]], lambda y: y[1] - 1),
            ([0.0, 1.0],),
            "g_y f_z must have full rank",
        ),
        (
            lambda: Hessenberg3(lambda z: z, lambda y, u: 0 * u - y, lambda y: y),
            ([0.0], [0.0]),
            "g_y f_z k_u must have full rank",
        ),
        (
            lambda: Mechanical(1.0, lambda q: 0 * q, lambda q: [q[0], 2 * q[0]]),
            ((0.0, 1.0), (0.0, 0.0)),
            "G M⁻¹ Gᵀ must have full rank",
        ),
        (
            lambda: Mechanical(np.ones(3), lambda q: 0 * q, lambda q: q[0]),
            ((0.0, 1.0), (0.0, 0.0)),
            "mass must be one number, 2 or 2 × 2",
        ),
        (
            lambda: Mechanical([1.0, 0.0], lambda q: 0 * q, lambda q: q[0]),
            ((0.0, 1.0), (0.0, 0.0)),
            "mass matrix must be regular",
        ),
        (lambda: Implicit(lambda y, slope: [slope[0] - y[1], slope[0] - y[1]]), [0.0, 1.0], "the pencil is singular"),
        (path_of_x, [1.0], "must be a tuple of y, z, of which z may be left out"),
        (path_of_x, ([np.nan],), "y of the start must have at least one element, and finite ones"),
        (
            lambda: Implicit(lambda y, slope: slope[:1] - y[:1]),
            [1.0, 0.0],
            "as many equations as variables; F has 1, y has 2",
        ),
        (lambda: Implicit(lambda y, slope: slope - y), [[1.0]], "one-dimensional"),
        (
            lambda: Hessenberg2(lambda y, z: y[:1] + z, lambda y: y[0] - 1),
            ([1.0, 2.0],),
            "f must answer with as many numbers as it has variables, 2",
        ),
    ],
)
def test_starts_of_other_indices_or_shapes_are_refused(make, start, what):
    with pytest.raises(ValueError, match=what):
        make().begin(start)


def test_what_is_no_problem_is_refused():
    with pytest.raises(TypeError, match="need Newton's method"):
        Hessenberg2(lambda z: z, lambda t, y: y - t, solver=FixedPoint())
    with pytest.raises(TypeError, match="f must take some of t, y, z"):
        Hessenberg2(lambda x: x, lambda t, y: y - t)
    with pytest.raises(TypeError, match="g must be a function of t, y"):
        Hessenberg2(lambda z: z, 3.0)


def test_equations_that_lose_their_solution_name_time_step_and_residual():
    """y′ = 1 on the circle y² + z² = 1 ends at y = 1."""
    problem = Hessenberg1(lambda: 1.0, lambda y, z: y * y + z * z - 1)
    with pytest.raises(ConvergenceError, match=r"step \d+ from t = .* with timestep 0\.03: .*") as told:
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
        assert pencil_index(*weierstrass(blocks, n_regular, rng)) == max(blocks, default=0)


@pytest.mark.parametrize(
    ("m", "a", "what"),
    [
        ([[1, 0], [0, 0]], [[1, 1], [0, 0]], "the pencil is singular"),
        ([[1, 1], [1, 1]], [[1, 1], [1, 1]], "the pencil is singular"),
        ([[0, 1, 0], [0, 0, 0], [0, 0, 0]], [[0, 0, 1], [1, 0, 0], [0, 0, 0]], "the pencil is singular"),
        (np.zeros((2, 2)), np.zeros((2, 2)), "the pencil is singular"),
        (np.eye(2), np.eye(3), "square matrices of the same size"),
        ([[np.nan]], [[1.0]], "must be finite"),
    ],
)
def test_pencils_without_index_are_refused(m, a, what):
    with pytest.raises(ValueError, match=what):
        pencil_index(m, a)
