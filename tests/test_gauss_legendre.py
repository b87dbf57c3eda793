"""Gauss-Legendre methods: order conditions on trees, every quadratic invariant to rounding, symplectic for every Hamiltonian."""

from itertools import combinations_with_replacement
from math import prod

import numpy as np
import pytest
from references import load
from scipy.integrate import solve_ivp

from minimd.integrators import (
    FirstOrder,
    FixedPoint,
    GaussLegendre1,
    GaussLegendre2,
    GaussLegendre3,
    GaussLegendre4,
    ImplicitEuler,
    Partitioned,
    RadauIIA2,
    RadauIIA3,
    SecondOrder,
    collocation,
    run_steps,
    run_until,
)

GAUSS = [GaussLegendre1, GaussLegendre2, GaussLegendre3, GaussLegendre4]
RADAU = [ImplicitEuler, RadauIIA2, RadauIIA3]
ORDERS = dict(zip(GAUSS + RADAU, [2, 4, 6, 8, 1, 3, 5], strict=True))
PROBLEMS = load("geometric/problems.json")
ULPS = 3e-15  # a dozen roundings of numbers of order one, and no growth


def attraction(q):
    return -q / (q @ q) ** 1.5


def henon_heiles(q):
    x, y = q
    return np.array([-x - 2.0 * x * y, -y - x * x + y * y])


KEPLER = SecondOrder(attraction)
PROBLEM_OF = {"kepler_e0.6_T7.5": KEPLER, "henon_heiles_T8": SecondOrder(henon_heiles)}
STARTS = {"kepler_e0.6_T7.5": ((0.4, 0.0), (0.0, 2.0)), "henon_heiles_T8": ((0.0, 0.1), (0.5, 0.0))}


def random_flow(seed=3, n=5):
    """y′ = S(y) C y with S skew and linear in y, which keeps yᵀ C y = 1; C is positive definite, and so is nothing else kept."""
    rng = np.random.default_rng(seed)
    skew = rng.normal(size=(n, n, n))
    skew = skew - skew.transpose(1, 0, 2)
    c = rng.normal(size=(n, n))
    c = c @ c.T / n + np.eye(n)
    start = rng.normal(size=n)
    return lambda y: (0.3 * skew @ y + skew[:, :, 0]) @ (c @ y), c, start / np.sqrt(start @ c @ start)


# ---- tableaus


def rooted_trees(order):
    """All of an order, a tree being the sorted tuple of what hangs on its root."""
    if order == 1:
        return [()]
    trees = set()
    for sizes in partitions(order - 1):
        trees |= {tuple(sorted(t)) for t in forests(sizes)}
    return sorted(trees)


def partitions(n, largest=None):
    largest = n if largest is None else largest
    return [()] if n == 0 else [(k, *rest) for k in range(min(n, largest), 0, -1) for rest in partitions(n - k, k)]


def forests(sizes):
    if not sizes:
        return [()]
    equal = sizes.count(sizes[0])
    return [a + b for a in combinations_with_replacement(rooted_trees(sizes[0]), equal) for b in forests(sizes[equal:])]


def size(tree):
    return 1 + sum(size(branch) for branch in tree)


def density(tree):
    """γ(t): the product of the sizes of all its subtrees."""
    return size(tree) * prod(density(branch) for branch in tree)


def stage_weights(tableau, tree):
    """(s,) Π over the branches of Σ_j β_ij …"""
    return np.prod(
        [tableau.beta @ stage_weights(tableau, branch) for branch in tree] + [np.ones(tableau.nodes.size)], axis=0
    )


def worst_condition(tableau, order):
    """Largest |Σ_i w_i Φ_i(t) − 1/γ(t)| over the trees of an order."""
    return max(
        abs(tableau.weights @ stage_weights(tableau, tree) - 1.0 / density(tree)) for tree in rooted_trees(order)
    )


def test_there_are_as_many_rooted_trees_as_cayley_says():
    assert [len(rooted_trees(order)) for order in range(1, 9)] == [1, 1, 2, 4, 9, 20, 48, 115]


@pytest.mark.parametrize("method", ORDERS)
def test_order_conditions_hold_up_to_the_order_and_no_further(method):
    assert method.order == method.tableau.order == ORDERS[method]
    assert max(worst_condition(method.tableau, order) for order in range(1, method.order + 1)) < 1e-15
    assert worst_condition(method.tableau, method.order + 1) > 1e-7


def test_two_and_three_stages_have_their_closed_form():
    """J. C. Butcher (1964); Hairer, Lubich, Wanner (2006), table II.1.1."""
    r, root = np.sqrt(3.0) / 6.0, np.sqrt(15.0)
    two, three = GaussLegendre2.tableau, GaussLegendre3.tableau
    assert np.abs(two.nodes - [0.5 - r, 0.5 + r]).max() == 0.0
    assert np.abs(two.beta - [[0.25, 0.25 - r], [0.25 + r, 0.25]]).max() == 0.0
    assert np.abs(collocation(two.nodes).beta - two.beta).max() < 1e-16
    assert three.weights == pytest.approx([5 / 18, 4 / 9, 5 / 18], abs=1e-16)
    closed = [
        [5 / 36, 2 / 9 - root / 15, 5 / 36 - root / 30],
        [5 / 36 + root / 24, 2 / 9, 5 / 36 - root / 24],
        [5 / 36 + root / 30, 2 / 9 + root / 15, 5 / 36],
    ]
    assert np.abs(three.beta - closed).max() < 2e-16


@pytest.mark.parametrize("method", ORDERS)
def test_gauss_is_symplectic_and_symmetric_and_radau_is_neither(method):
    assert method.is_symplectic == method.is_symmetric == (method in GAUSS)
    defect = np.abs(method.tableau.symplecticity_defect).max()
    assert (defect < 2e-17) if method in GAUSS else (defect > 1e-3)


@pytest.mark.parametrize("method", ORDERS)
@pytest.mark.parametrize("z", [-0.3, 0.2, -4.0])
def test_a_step_of_a_linear_problem_is_the_pade_approximant(method, z):
    """R(z) of degree s over s for Gauss, s − 1 over s for Radau: the approximant agrees with eᶻ to its order, and is unique."""
    s = method.stages
    numerator, denominator = (s if method in GAUSS else s - 1), s
    k = np.arange(max(numerator, denominator) + 1)

    def factor(degree, other, sign):
        terms = [
            prod(range(degree - j + 1, degree + 1)) / prod(range(degree + other - j + 1, degree + other + 1))
            for j in k[: degree + 1]
        ]
        return sum(c * (sign * z) ** j / prod(range(1, j + 1)) for j, c in enumerate(terms))

    expected = factor(numerator, denominator, 1.0) / factor(denominator, numerator, -1.0)
    assert run_steps(FirstOrder(lambda y: z * y), method(1.0), [1.0], 1).y[-1, 0] == pytest.approx(expected, rel=1e-14)


# ---- order


@pytest.mark.parametrize("name", PROBLEM_OF)
@pytest.mark.parametrize(
    ("method", "n_steps"), [(GaussLegendre1, 800), (GaussLegendre2, 200), (GaussLegendre3, 140), (GaussLegendre4, 120)]
)
def test_measured_order_on_references(method, n_steps, name):
    reference, end = PROBLEMS[name], float(PROBLEMS[name]["T"])
    n_steps //= 4 if name == "henon_heiles_T8" else 1  # a smoother path
    exact, counts = np.array([*reference["q"], *reference["p"]], dtype=float), np.array([n_steps, 3 * n_steps // 2])
    errors = [
        np.linalg.norm(run_until(PROBLEM_OF[name], method(end / n), STARTS[name], end).y[-1] - exact) for n in counts
    ]
    assert -np.diff(np.log(errors))[0] / np.diff(np.log(counts))[0] == pytest.approx(
        method.order, abs=0.35
    )  # truncation, with two step sizes


def test_newton_and_fixed_point_solve_the_same_equations():
    newton = run_steps(KEPLER, GaussLegendre3(0.05), STARTS["kepler_e0.6_T7.5"], 100)
    fixed = run_steps(
        SecondOrder(attraction, solver=FixedPoint()), GaussLegendre3(0.05), STARTS["kepler_e0.6_T7.5"], 100
    )
    assert np.abs(newton.y - fixed.y).max() < 1e-11  # rounding, growing with the square of time


# ---- invariants


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("method", GAUSS)
def test_every_quadratic_invariant_is_kept_to_rounding(method, seed):
    f, c, start = random_flow(seed)
    path = run_steps(FirstOrder(f), method(0.04), start, 400)
    assert np.abs(np.einsum("ti,ij,tj->t", path.y, c, path.y) - 1.0).max() < ULPS
    assert np.linalg.norm(path.y[-1] - start) > 0.1  # and it does move


@pytest.mark.parametrize("method", RADAU)
def test_radau_keeps_no_quadratic_invariant(method):
    f, c, start = random_flow()
    path = run_steps(FirstOrder(f), method(0.04), start, 200)
    assert abs(path.y[-1] @ c @ path.y[-1] - 1.0) > 1e-6


@pytest.mark.parametrize("name", ["RK45", "DOP853", "LSODA"])
def test_scipy_keeps_no_quadratic_invariant(name):
    f, c, start = random_flow()
    y = solve_ivp(lambda t, y: f(y), (0.0, 40.0), start, method=name, rtol=1e-6, atol=1e-9).y[:, -1]
    assert abs(y @ c @ y - 1.0) > 1e-7


@pytest.mark.parametrize("method", GAUSS)
def test_angular_momentum_is_kept_to_rounding(method):
    path = run_steps(KEPLER, method(0.05), STARTS["kepler_e0.6_T7.5"], 1000)
    assert np.abs(path.q[:, 0] * path.v[:, 1] - path.q[:, 1] * path.v[:, 0] - 0.8).max() < ULPS


def random_walk(method, n_steps, forget):
    """(n_steps,) errors of yᵀ C y; forget makes each step begin without what the rounding of the last one took."""
    f, c, y = random_flow()
    step, errors = method.on(FirstOrder(f)), np.empty(n_steps)
    for n in range(n_steps):
        y = step(0.0, y.copy() if forget else y, 0.04)
        errors[n] = y @ c @ y - 1.0
    return errors


@pytest.mark.slow
def test_the_compensated_sum_is_what_keeps_them_to_rounding():
    """Without it each step adds a rounding; with it the error has no memory: it does not grow."""
    kept, forgotten = (np.abs(random_walk(GaussLegendre2, 4000, forget)).max() for forget in (False, True))
    assert kept < 1e-15
    assert forgotten > 3.0 * kept


@pytest.mark.slow
@pytest.mark.parametrize("method", [GaussLegendre1, GaussLegendre2, GaussLegendre4])
def test_quadratic_invariants_do_not_drift_in_100_000_steps(method):
    """One rounding per step, all of one sign, would make 2e-11, a random walk of them EPS √n = 7e-14; what is left is a tenth of that."""
    errors = random_walk(method, 100_000, forget=False)
    assert np.abs(errors).max() < 0.2 * np.finfo(float).eps * np.sqrt(100_000)


# ---- geometry


def coupled(q, p):
    """H = (p₁² (1 + q₂²) + p₂² (2 + sin q₁))/2 + q₁² q₂²/2 + q₁² + q₂², not separable: its slopes ∂H/∂q and ∂H/∂p."""
    h_q = [
        0.5 * p[1] ** 2 * np.cos(q[0]) + q[0] * q[1] ** 2 + 2.0 * q[0],
        p[0] ** 2 * q[1] + q[0] ** 2 * q[1] + 2.0 * q[1],
    ]
    return np.array(h_q), np.array([p[0] * (1.0 + q[1] ** 2), p[1] * (2.0 + np.sin(q[0]))])


HAMILTONIAN = Partitioned(lambda t, q, v: coupled(q, v)[1], lambda t, q, v: -coupled(q, v)[0])


def step_jacobian(problem, method, h, y):
    """Φ′ by central differences of order 4."""
    d, n = 1e-3, y.size // 2

    def end(z):
        return run_steps(problem, method(h), (z[:n], z[n:]), 1).y[-1]

    return np.array(
        [
            (8.0 * (end(y + d * e) - end(y - d * e)) - (end(y + 2.0 * d * e) - end(y - 2.0 * d * e))) / (12.0 * d)
            for e in np.eye(2 * n)
        ]
    ).T


@pytest.mark.parametrize("problem", [HAMILTONIAN, KEPLER])
@pytest.mark.parametrize("method", GAUSS + RADAU)
def test_a_step_is_symplectic_for_every_hamiltonian_and_keeps_volume(method, problem):
    jacobian = step_jacobian(problem, method, 0.2, np.array([0.9, 0.4, -0.5, 0.8]))
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    defects = np.abs(jacobian.T @ form @ jacobian - form).max(), abs(np.linalg.det(jacobian) - 1.0)
    if method in GAUSS:
        assert max(defects) < 1e-9  # truncation of the difference quotient
    else:
        assert min(defects) > 1e-7


@pytest.mark.parametrize("problem", [HAMILTONIAN, KEPLER])
@pytest.mark.parametrize("method", GAUSS + RADAU)
def test_a_step_back_undoes_a_step_of_gauss_methods_only(method, problem):
    start = (0.9, 0.4), (-0.5, 0.8)
    there = run_steps(problem, method(0.05), start, 20)
    back = run_steps(problem, method(-0.05), (there.q[-1], there.v[-1]), 20)
    distance = np.abs(back.y[-1] - there.y[0]).max()
    assert (distance < 1e-12) if method in GAUSS else (distance > 1e-9)


@pytest.mark.parametrize("method", GAUSS)
def test_the_energy_of_a_problem_that_is_not_separable_oscillates_and_does_not_drift(method):
    def hamiltonian(q, p):
        return (
            0.5 * (p[0] ** 2 * (1.0 + q[1] ** 2) + p[1] ** 2 * (2.0 + np.sin(q[0])) + q[0] ** 2 * q[1] ** 2)
            + q[0] ** 2
            + q[1] ** 2
        )

    path = run_steps(HAMILTONIAN, method(0.1), ((0.9, 0.4), (-0.5, 0.8)), 1200)
    errors = np.abs(
        [hamiltonian(q, p) - hamiltonian(path.q[0], path.v[0]) for q, p in zip(path.q, path.v, strict=True)]
    )
    assert errors[600:].max() < 1.5 * errors[:600].max() + ULPS
