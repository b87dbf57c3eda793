"""Equations of stages: solved to rounding in every variable, whatever its size and unit, with the Jacobian of the problem."""

import numpy as np
import pytest
from dae_problems import GRAVITY
from test_dae_references import robertson

from minimd.integrators import FirstOrder, ImplicitEuler, Mechanical, RadauIIA3, StepControl, run_adaptive, run_steps


@pytest.mark.parametrize(("length", "time"), [(1e-10, 1e-12), (1e-9, 1e3), (1.0, 1e6), (1e3, 1e-3)])
@pytest.mark.parametrize("n_steps", [200, 5000])
def test_a_pendulum_of_index_3_swings_in_any_unit(length, time, n_steps):
    def path(length, time):
        problem = Mechanical(
            1.0, lambda q: np.array([0.0, -GRAVITY * length / time**2]), lambda q: (q @ q - length**2) / 2, lambda q: q
        )
        q, v, tension = problem.parts(
            run_steps(problem, RadauIIA3(2.0 * time / n_steps), ((length, 0.0), (0.0, 0.0)), 100).y[1:]
        )
        return np.hstack([q / length, v * time / length, tension * time**2])

    assert path(length, time) == pytest.approx(path(1.0, 1.0), abs=1e-6)  # rounding/h² in the tension


def test_a_variable_that_is_smaller_by_13_powers_of_ten_is_solved_for_as_well():
    """Robertson's y₂ in balance: 0.04 y₁ = 10⁴ y₂ y₃ + 3 10⁷ y₂² after an implicit Euler step that is long beside its relaxation."""
    y = run_adaptive(
        robertson(), RadauIIA3, ([1.0, 0.0], [0.0]), 1e9, control=StepControl(rtol=1e-6, atol=[1e-12, 1e-18, 1e-8])
    ).y[-1]
    y1, y2, y3 = run_steps(robertson(), ImplicitEuler(1e9), (y[:2], y[2:]), 1).y[-1]
    gain, loss = 0.04 * y1, 1e4 * y2 * y3 + 3e7 * y2**2
    assert y2 < 1e-11
    assert gain - loss == pytest.approx((y2 - y[1]) / 1e9 + 0.0, abs=1e-12 * gain)


def test_the_jacobian_of_the_problem_is_used():
    calls = []

    def jacobian(y):
        calls.append(y)
        return [[0.0, 1.0], [-np.cos(y[0]), 0.0]]

    def slopes(y):
        return [y[1], -np.sin(y[0])]

    given, found = (run_steps(FirstOrder(slopes, jac), RadauIIA3(0.1), [1.0, 0.0], 50) for jac in (jacobian, None))
    assert given.y == pytest.approx(found.y, abs=1e-14)
    assert calls
    assert given.nfev < found.nfev
