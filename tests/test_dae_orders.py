"""Orders of the methods on differential-algebraic equations of index 1, 2 and 3: those of theory, reductions included.

E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems by Runge-Kutta Methods (1989), table 2.3;
K. E. Brenan, S. L. Campbell, L. R. Petzold (1989), 3.2.
"""

import numpy as np
import pytest
from dae_problems import HORIZONTAL, INDEX1, INDEX2_LINEAR, PROBLEMS, measured_orders, pendulum

from minimd.integrators import (
    BDF1,
    BDF2,
    BDF3,
    BDF4,
    BDF5,
    FirstOrder,
    GaussLegendre1,
    GaussLegendre2,
    GaussLegendre3,
    GaussLegendre4,
    ImplicitEuler,
    RadauIIA2,
    RadauIIA3,
    run_adaptive,
    run_steps,
    run_until,
)
from minimd.integrators.ode.bdf import slope_weights
from minimd.integrators.ode.runge_kutta import StageStep

BDFS = [BDF1, BDF2, BDF3, BDF4, BDF5]
RADAU = {  # index: orders of y and z; of q, v and the multiplier
    ImplicitEuler: {1: (1, 1), 2: (1, 1), 3: (1, 1, 1)},
    RadauIIA2: {1: (3, 3), 2: (3, 2), 3: (3, 2, 1)},
    RadauIIA3: {1: (5, 5), 2: (5, 3), 3: (5, 3, 2)},
}
GAUSS_INDEX1 = {GaussLegendre1: (2, 2), GaussLegendre2: (4, 2), GaussLegendre3: (6, 4)}
GAUSS_INDEX2 = {GaussLegendre1: (2, 0), GaussLegendre2: (2, 0), GaussLegendre3: (4, 2)}


@pytest.mark.parametrize("index", [1, 2, 3])
@pytest.mark.parametrize("method", RADAU)
def test_radau_iia_has_order_2s_minus_1_where_the_index_lets_it(method, index):
    """2s − 1 in y and q; s in z of index 2 and v; s − 1 in the multipliers of index 3, but 1 with equal steps for s = 1."""
    assert measured_orders(*PROBLEMS[index], method) == pytest.approx(RADAU[method][index], abs=0.2)  # truncation


@pytest.mark.parametrize("method", GAUSS_INDEX1)
def test_gauss_has_order_2s_in_y_and_the_stage_order_in_z_of_index_1(method):
    """z: s for even s, s + 1 for odd s, as R(∞) = (−1)ˢ."""
    assert measured_orders(*INDEX1, method, n_steps=(6, 12)) == pytest.approx(GAUSS_INDEX1[method], abs=0.2)


@pytest.mark.parametrize("method", GAUSS_INDEX2)
def test_gauss_loses_order_at_index_2(method):
    """y: s + 1 for odd s, s for even s; z: s − 1 and s − 2, nothing for s = 1 and 2."""
    problem = PROBLEMS[2] if method is GaussLegendre3 else INDEX2_LINEAR
    assert measured_orders(*problem, method, n_steps=(20, 40)) == pytest.approx(GAUSS_INDEX2[method], abs=0.1)


@pytest.mark.parametrize("method", [GaussLegendre1, GaussLegendre2, GaussLegendre3, GaussLegendre4])
def test_gauss_is_refused_at_index_3_because_multipliers_do_not_converge(method):
    """Off by as much after steps half as long, or by four times more (s = 2); q of order 2 and 4 and v of order 2 or none would hide it."""
    problem = pendulum()
    with pytest.raises(TypeError, match=f"{method.name} does not converge on problems of index 3"):
        run_steps(problem, method(0.01), HORIZONTAL, 1)
    exact = run_steps(problem, RadauIIA3(0.5 / 500), HORIZONTAL, 500).y[-1]

    def errors(n_steps):
        step, y = StageStep(problem, method.tableau), problem.begin(HORIZONTAL)
        for k in range(n_steps):
            y = step(0.5 * k / n_steps, y, 0.5 / n_steps)
        return [np.abs(part).max() for part in problem.parts(y - exact)]

    coarse, fine = errors(50), errors(100)
    assert fine[0] < 0.3 * coarse[0]
    assert fine[2] > 0.9 * coarse[2] > 10.0


@pytest.mark.parametrize("index", [1, 2, 3])
@pytest.mark.parametrize("method", BDFS)
def test_bdf_has_order_k_in_every_variable(method, index):
    expected = [method.order] * (3 if index == 3 else 2)
    assert measured_orders(*PROBLEMS[index], method, n_steps=(30, 60)) == pytest.approx(
        expected, abs=0.45
    )  # truncation


@pytest.mark.parametrize("method", [*BDFS, *RADAU])
def test_orders_on_an_explicit_problem(method):
    """y′ = −2 t y², y = 1/(1 + t²)."""
    results = []
    for steps in (100, 200):
        results.append(
            run_steps(FirstOrder(lambda t, y: -2 * t * y * y), method(1.0 / steps), [1.0], steps).y[-1, 0] - 0.5
        )
    assert np.log2(results[0] / results[1]) == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize(("k", "expected"), [(1, [1, -1]), (2, [3 / 2, -2, 1 / 2]), (3, [11 / 6, -3, 3 / 2, -1 / 3])])
def test_weights_of_equal_steps_are_those_of_the_books(k, expected):
    assert slope_weights(-np.arange(k + 1.0)) == pytest.approx(expected, abs=1e-15)


def test_weights_differentiate_polynomials_exactly_whatever_the_nodes():
    nodes = np.array([0.0, -0.3, -1.1, -1.9, -3.0])
    for power in range(5):
        assert slope_weights(nodes) @ nodes**power == pytest.approx(float(power == 1), abs=1e-13)


@pytest.mark.parametrize("method", BDFS)
def test_a_shortened_last_step_is_as_accurate_as_the_others(method):
    problem = FirstOrder(lambda t, y: -2 * t * y * y)
    late, shortened = (
        run_until(problem, method(0.01), [1.0], end).y[-1, 0] - 1 / (1 + end**2) for end in (1.0, 0.9963)
    )
    assert shortened == pytest.approx(late, rel=0.1)


@pytest.mark.parametrize("method", BDFS[1:])
def test_step_doubling_refuses_methods_that_look_back(method):
    with pytest.raises(TypeError, match=r"looks back at \d states of its own path"):
        run_adaptive(FirstOrder(lambda y: -y), method, [1.0], 1.0)


def test_bdf_1_and_implicit_euler_are_the_same():
    one, other = (run_steps(pendulum(), method(0.01), HORIZONTAL, 50).y for method in (BDF1, ImplicitEuler))
    assert one == pytest.approx(other, abs=1e-11)


@pytest.mark.parametrize("method", [BDF3, RadauIIA2, RadauIIA3])
def test_constraints_are_kept_to_rounding(method):
    problem = pendulum()
    q, _, _ = problem.parts(run_steps(problem, method(0.01), HORIZONTAL, 400).y)
    assert np.abs((q**2).sum(axis=1) - 1).max() < 3e-15
