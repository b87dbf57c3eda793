"""Theorems on one step, one law each, for every method that claims it: order, adjoint, symmetry, reversibility, symplecticity, volume.

METHODS is where a method is registered; what it answers there is measured here.
"""

import pickle
from itertools import pairwise

import numpy as np
import pytest
from small_problems import (
    DETERMINISTIC,
    DRIVEN,
    HENON_HEILES,
    HENON_HEILES_START,
    KEPLER,
    KEPLER_START,
    NOT_SYMMETRIC,
    NOT_SYMPLECTIC,
    ONE_STEP,
    SWAYING,
    SYMMETRIC,
    SYMPLECTIC,
    TWISTED,
    TWISTED_START,
    attraction,
    jacobian,
    kepler_orbit,
    reference,
    symplecticity_defect,
)

import minimd.integrators
from minimd.integrators import (
    METHODS,
    SE1,
    SE2,
    SPLITTINGS,
    GaussLegendre1,
    GaussLegendre2,
    GaussLegendre3,
    McLachlanAtela4,
    Newton,
    Partitioned,
    PositionVerlet,
    Ruth3,
    SecondOrder,
    VelocityVerlet,
    adjoint,
    compose,
    run_steps,
)

ORBIT_START = (0.7, 0.1), (-0.1, 1.2)
STEPS = {1: 200, 2: 100, 3: 200, 4: 60, 5: 40, 6: 30, 8: 16}  # by order: errors small, above rounding
PROBLEMS = {
    "kepler": (KEPLER, KEPLER_START, 2.0, 0.0, kepler_orbit(2.0)),
    "henon-heiles": (HENON_HEILES, HENON_HEILES_START, 8.0, 0.0, reference(HENON_HEILES, HENON_HEILES_START, 8.0)),
    "not separable": (TWISTED, TWISTED_START, 3.0, 0.0, reference(TWISTED, TWISTED_START, 3.0)),
    "driven, not separable": (DRIVEN, TWISTED_START, 3.0, 0.3, reference(DRIVEN, TWISTED_START, 3.0, t0=0.3)),
}
FLIP = np.array([1.0, 1.0, -1.0, -1.0])  # ρ, which turns the velocities around


def measured_order(method, problem, start, time, t0, end, n_steps):
    """Slope between steps of time/n and time/2n."""
    errors = [
        np.linalg.norm(run_steps(problem, method(time / n), start, n, t0=t0, every=n).y[-1] - end)
        for n in (n_steps, 2 * n_steps)
    ]
    return np.log2(errors[0] / errors[1])


@pytest.mark.parametrize(
    ("name", "method"), [(name, m) for name in PROBLEMS for m in (ONE_STEP if name == "kepler" else DETERMINISTIC)]
)
def test_measured_order_is_the_answered_order(method, name):
    """Methods made for q″ = f(q) alone answer a lower one elsewhere. Near a pericentre the errors of BDFs change their sign."""
    order = method.order_on(PROBLEMS[name][0])
    n_steps = (
        STEPS[order]
        * {"kepler": 8 if method is Ruth3 else 2}.get(name, 1)
        * (6 if method not in ONE_STEP and order > 3 else 1)
    )
    assert measured_order(method, *PROBLEMS[name], n_steps) == pytest.approx(order, abs=0.2)  # truncation
    assert order == (3 if method is McLachlanAtela4 and "separable" in name else method.order)


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_the_adjoint_undoes_a_step_with_time_reversed(method):
    """Φ*_{−h} ∘ Φ_h = 1, implicit steps included, and Φ** = Φ."""
    y = DRIVEN.begin(TWISTED_START)
    back = adjoint(method).on(DRIVEN)(0.5, method.on(DRIVEN)(0.3, y, 0.2), -0.2)
    assert np.abs(back - y).max() < 1e-14  # rounding
    assert adjoint(adjoint(method)).sequence() == method.sequence()


def there_and_back(method, problem, start, h=0.1, t0=0.3):
    """How far Φ_{−h} ∘ Φ_h is from the identity."""
    y = problem.begin(start)
    return np.abs(method.on(problem)(t0 + h, method.on(problem)(t0, y, h), -h) - y).max()


@pytest.mark.parametrize(
    ("problem", "start"), [(KEPLER, ORBIT_START), (TWISTED, TWISTED_START), (DRIVEN, TWISTED_START)]
)
@pytest.mark.parametrize("method", SYMMETRIC)
def test_a_symmetric_method_is_its_own_inverse_with_time_reversed(method, problem, start):
    assert there_and_back(method, problem, start) < 3e-15  # rounding


@pytest.mark.parametrize(
    ("problem", "start"), [(KEPLER, ORBIT_START), (TWISTED, TWISTED_START), (DRIVEN, TWISTED_START)]
)
@pytest.mark.parametrize("method", NOT_SYMMETRIC)
def test_a_method_answered_as_not_symmetric_is_not(method, problem, start):
    assert there_and_back(method, problem, start) > 1e-9  # truncation


def turned_around(method, problem, start, h=0.1):
    """How far ρ Φ_h ρ is from Φ_{−h}, and ρ Φ_h ρ Φ_h from the identity."""
    y = problem.begin(start)
    there = method.on(problem)(0.0, y, h)
    turned, returned = (FLIP * method.on(problem)(0.0, FLIP * z, h) for z in (y, there))
    return np.abs(turned - method.on(problem)(0.0, y, -h)).max(), np.abs(returned - y).max()


@pytest.mark.parametrize(("problem", "start"), [(KEPLER, ORBIT_START), (SWAYING, TWISTED_START)])
@pytest.mark.parametrize("method", ONE_STEP)
def test_reversible_problems_are_reversed_by_symmetric_methods_alone(method, problem, start):
    """ρ Φ_h ρ = Φ_{−h} for all of them, and = Φ_h⁻¹ for the symmetric ones."""
    turned, returned = turned_around(method, problem, start)
    assert turned < 3e-15  # rounding
    assert (returned < 3e-15) if method.is_symmetric else (returned > 1e-9)


@pytest.mark.parametrize(
    ("problem", "start"), [(KEPLER, ORBIT_START), (TWISTED, TWISTED_START), (DRIVEN, TWISTED_START)]
)
@pytest.mark.parametrize("method", SYMPLECTIC)
def test_a_symplectic_step_keeps_the_symplectic_form_and_the_volume(method, problem, start):
    """Φ′ᵀ J Φ′ = J and det Φ′ = 1, for H(q, v) and H(t, q, v) too."""
    m = jacobian(problem, method, start, 0.2, t0=0.3)
    assert np.abs(m - np.eye(4)).max() > 0.1
    assert symplecticity_defect(m) < 1e-11  # truncation of the differences, rounding in them
    assert np.linalg.det(m) == pytest.approx(1.0, abs=1e-11)


@pytest.mark.parametrize(("problem", "start"), [(KEPLER, ORBIT_START), (TWISTED, TWISTED_START)])
@pytest.mark.parametrize("method", NOT_SYMPLECTIC)
def test_a_method_answered_as_not_symplectic_is_not(method, problem, start):
    m = jacobian(problem, method, start, 0.2)
    assert symplecticity_defect(m) > 1e-8
    assert abs(np.linalg.det(m) - 1.0) > 1e-8


# q′ = g(v), v′ = f(q) has no divergence whatever g and f are; these are no gradients, so nothing is symplectic here.
def g_plane(v):
    return np.array([v[1] + 0.3 * v[0] ** 2, np.sin(v[0]) * v[1]])


def f_plane(q):
    return np.array([q[0] * q[1] - 1.0, np.cos(q[0]) - q[1] ** 2])


def g_space(v):
    return np.array([np.sin(v[1] * v[2]) + v[0] ** 2, v[0] * v[2], np.cos(v[0] - v[1])])


def f_space(q):
    return np.array([q[1] * q[2] - q[0], np.sin(q[0]) * q[1], np.exp(-q[1]) + 0.3 * q[2] ** 2])


@pytest.mark.parametrize(("g", "f"), [(g_plane, f_plane), (g_space, f_space)])
@pytest.mark.parametrize("method", [*SPLITTINGS.values(), GaussLegendre1, GaussLegendre2])
def test_the_volume_is_kept_where_the_divergence_is_none(method, g, f):
    """By each kick and each drift; of Gauss methods only by those with one or two stages (Hairer, Lubich, Wanner, VI.9)."""
    start = np.array([0.3, 0.2, 0.5]), np.array([0.1, -0.4, 0.6])
    n = 2 if g is g_plane else 3
    m = jacobian(Partitioned(lambda v: g(v), lambda q: f(q)), method, (start[0][:n], start[1][:n]), 0.3)
    assert np.linalg.det(m) == pytest.approx(1.0, abs=1e-11)
    assert symplecticity_defect(m) > 1e-2


def test_three_stages_of_gauss_do_not_keep_that_volume():
    start = (0.3, 0.2, 0.5), (0.1, -0.4, 0.6)
    m = jacobian(Partitioned(lambda v: g_space(v), lambda q: f_space(q)), GaussLegendre3, start, 0.6)
    assert abs(np.linalg.det(m) - 1.0) > 1e-8


@pytest.mark.parametrize(
    ("composed", "named"), [(compose(SE2, SE1), VelocityVerlet), (compose(SE1, SE2), PositionVerlet)]
)
@pytest.mark.parametrize(
    ("problem", "start"), [(KEPLER, ORBIT_START), (TWISTED, TWISTED_START), (DRIVEN, TWISTED_START)]
)
def test_verlet_is_the_composition_of_symplectic_euler_with_its_adjoint(composed, named, problem, start):
    """SE2 ∘ SE1 is (A) and SE1 ∘ SE2 is (B) over half steps: to the last bit as one method, to rounding as two."""
    one, other = (run_steps(problem, method(0.1), start, 20, t0=0.3).y for method in (composed, named))
    assert np.array_equal(one, other)
    inner, outer = (SE1.on(problem), SE2.on(problem)) if named is VelocityVerlet else (SE2.on(problem), SE1.on(problem))
    y = problem.begin(start)
    for t in 0.3 + 0.1 * np.arange(20):
        y = outer(t + 0.05, inner(t, y, 0.05), 0.05)
    assert y == pytest.approx(other[-1], abs=1e-13)


class Unsolvable(Newton):
    """A solver that is not to be asked."""

    def iteration(self):
        return self

    def solve(self, *_arguments, **_more):
        raise AssertionError("solved")


@pytest.mark.parametrize("method", DETERMINISTIC)
def test_explicit_methods_solve_nothing(method):
    problem = SecondOrder(attraction, solver=Unsolvable())
    if method.is_explicit:
        run_steps(problem, method(0.1), ORBIT_START, 3)
    else:
        with pytest.raises(AssertionError, match="solved"):
            run_steps(problem, method(0.1), ORBIT_START, 3)


@pytest.mark.parametrize("method", DETERMINISTIC)
def test_stages_are_the_evaluations_or_the_stage_equations_of_a_step(method):
    """As the function of the user counts them; those of implicit methods by the times they are at."""
    times = []

    def force(t, q):
        times.append(t)
        return attraction(q)

    solution = run_steps(SecondOrder(force), method(0.01), ORBIT_START, 100)
    if method.is_explicit:
        assert 100 * method.stages <= len(times) <= 100 * method.stages + 1
        assert solution.nfev == len(times)
    else:
        inside = [t for t in times if 0.5 + 1e-9 < t < 0.51 + 1e-9]
        assert len(np.unique(np.round(inside, 9))) == method.stages


@pytest.mark.parametrize("method", METHODS.values())
def test_methods_are_classes_of_minimd_that_can_be_pickled(method):
    assert pickle.loads(pickle.dumps(method)) is method is getattr(minimd.integrators, method.__name__)


def test_the_table_says_what_the_methods_answer():
    header, *lines = str(METHODS).splitlines()
    assert header.split() == ["name", "order", "stages", "symmetric", "symplectic", "explicit", "source"]
    assert len(lines) == len(METHODS)
    columns = [header.index(word) for word in header.split()] + [None]
    for line, (name, method) in zip(lines, METHODS.items(), strict=True):
        entries = [line[start:end].strip() for start, end in pairwise(columns)]
        answers = [
            ("no", "yes")[bool(answer)] for answer in (method.is_symmetric, method.is_symplectic, method.is_explicit)
        ]
        assert entries == [name, str(method.order), str(method.stages), *answers, method.source]
