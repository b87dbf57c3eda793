"""Runge-Kutta methods of collocation: order conditions on trees, stability functions, quadratic invariants."""

from functools import cache
from math import prod

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_problems import GAUSS, RADAU

import minimd.integrators as mi

ORDERS = dict(zip(GAUSS + RADAU, [2, 4, 6, 8, 1, 3, 5], strict=True))


def random_flow(seed=3, n=5):
    """y′ = S(y) C y, S skew and linear in y, which keeps yᵀ C y = 1 and nothing else; C > 0."""
    rng = np.random.default_rng(seed)
    any_, root, start = rng.normal(size=(n, n, n)), rng.normal(size=(n, n)), rng.normal(size=n)
    skew, c = any_ - any_.transpose(1, 0, 2), root @ root.T / n + np.eye(n)
    return lambda y: (0.3 * skew @ y + skew[:, :, 0]) @ (c @ y), c, start / np.sqrt(start @ c @ start)


@cache
def rooted_trees(order):
    """All of an order, a tree being the sorted tuple of what hangs on its root: the smaller ones with one leaf more."""
    return sorted({t for smaller in rooted_trees(order - 1) for t in with_a_leaf(smaller)}) if order > 1 else [()]


def with_a_leaf(tree):
    """On its root, or anywhere on a branch."""
    grown = [(*tree[:k], t, *tree[k + 1 :]) for k, branch in enumerate(tree) for t in with_a_leaf(branch)]
    return [tuple(sorted(t)) for t in [(*tree, ()), *grown]]


def counts(tree):
    """The number of nodes; and γ(t), the product of the sizes of all its subtrees."""
    sizes, densities = zip((1, 1), *map(counts, tree), strict=True)
    return sum(sizes), sum(sizes) * prod(densities)


def stage_weights(tableau, tree):
    """(s,) Π over the branches of Σ_j β_ij …"""
    ones = np.ones(tableau.nodes.size)
    return np.prod([ones, *(tableau.beta @ stage_weights(tableau, branch) for branch in tree)], axis=0)


def worst_condition(tableau, order):
    """Largest |Σ_i w_i Φ_i(t) − 1/γ(t)| over the trees of an order."""
    return max(abs(tableau.weights @ stage_weights(tableau, t) - 1.0 / counts(t)[1]) for t in rooted_trees(order))


@pytest.mark.parametrize("method", ORDERS)
def test_order_conditions_hold_up_to_the_order_and_no_further(method):
    assert [len(rooted_trees(order)) for order in range(1, 9)] == [1, 1, 2, 4, 9, 20, 48, 115]  # Cayley
    assert method.order == method.tableau.order == ORDERS[method]
    assert max(worst_condition(method.tableau, order) for order in range(1, method.order + 1)) < 1e-15
    assert worst_condition(method.tableau, method.order + 1) > 1e-7
    assert method.is_symplectic == method.is_symmetric == (method in GAUSS)
    defect = np.abs(method.tableau.symplecticity_defect).max()
    # two roundings of products of at most 1/8; which of them are made depends on the library that multiplies
    assert defect <= 2.0**-55 if method in GAUSS else defect > 1e-3


@pytest.mark.parametrize("method", ORDERS)
def test_a_step_of_a_linear_problem_is_the_pade_approximant(method):
    """R(z) of degree s over s for Gauss, s − 1 over s for Radau: it agrees with eᶻ to its order, and is unique."""
    s, k = method.stages, method.stages - (method not in GAUSS)

    def factor(degree, other, z):
        """Σ degree!/(degree − j)! · (degree + other − j)!/(degree + other)! · zʲ/j!"""
        return sum(prod((degree - i) / (degree + other - i) / (i + 1) * z for i in range(j)) for j in range(degree + 1))

    for z in (-0.3, 0.2, -4.0):
        end = mi.run_steps(mi.FirstOrder(lambda y, z=z: z * y), method(1.0), [1.0], 1).y[-1, 0]
        assert end == pytest.approx(factor(k, s, z) / factor(s, k, -z), rel=1e-14)


@pytest.mark.parametrize("method", ORDERS)
def test_gauss_keeps_every_quadratic_invariant_to_rounding_and_radau_none(method):
    f, c, start = random_flow()
    path = mi.run_steps(mi.FirstOrder(f), method(0.04), start, 60)
    error = np.abs(np.einsum("ti,ij,tj->t", path.y, c, path.y) - 1.0).max()
    assert np.linalg.norm(path.y[-1] - start) > 0.1  # it does move
    assert error < 3e-15 if method in GAUSS else error > 1e-6  # a dozen roundings, and no growth


@pytest.mark.parametrize("name", ["RK45", "DOP853", "LSODA"])
def test_scipy_keeps_no_quadratic_invariant(name):
    f, c, start = random_flow()
    y = solve_ivp(lambda t, y: f(y), (0.0, 40.0), start, method=name, rtol=1e-6, atol=1e-9).y[:, -1]
    assert abs(y @ c @ y - 1.0) > 1e-7


def random_walk(method, n_steps, forget):
    """(n_steps,) errors of yᵀ C y; forget makes each step begin without what the rounding of the last one took."""
    f, c, y = random_flow()
    step, errors = method.on(mi.FirstOrder(f)), np.empty(n_steps)
    for n in range(n_steps):
        y = step(0.0, y.copy() if forget else y, 0.04)
        errors[n] = y @ c @ y - 1.0
    return errors


@pytest.mark.slow
def test_the_compensated_sum_is_what_keeps_them_to_rounding():
    """Without it each step adds a rounding; with it a dozen roundings, as above, last for 4000 steps."""
    kept, forgotten = (np.abs(random_walk(mi.GaussLegendre2, 4000, forget)).max() for forget in (False, True))
    assert kept < 3e-15
    assert forgotten > 3.0 * kept


@pytest.mark.slow
@pytest.mark.parametrize("method", [mi.GaussLegendre1, mi.GaussLegendre2, mi.GaussLegendre4])
def test_quadratic_invariants_do_not_drift_in_100_000_steps(method):
    """Roundings of one sign would make 2e-11, a random walk of them EPS √n = 7e-14; what is left is a tenth of that."""
    assert np.abs(random_walk(method, 100_000, forget=False)).max() < 0.2 * np.finfo(float).eps * np.sqrt(100_000)
