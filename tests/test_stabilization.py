"""Problems changed so that their invariants are kept: stabilization, and the form of index 2."""

import numpy as np
import pytest
from kept_problems import (
    ENERGY,
    INERTIA,
    KEPLER,
    PERIOD,
    RIGID_BODY,
    ROUNDING,
    START,
    TURNING,
    energy,
    energy_slope,
    kepler_end,
    slope,
    values,
)

from minimd.integrators import (
    GaussLegendre2,
    GaussLegendre3,
    GaussLegendre4,
    ImplicitEuler,
    Invariants,
    KahanLi8,
    Partitioned,
    RadauIIA2,
    RadauIIA3,
    VelocityVerlet,
    index_two,
    run_steps,
    run_until,
    stabilized,
)


@pytest.mark.parametrize(("method", "h"), [(VelocityVerlet, 0.02), (RadauIIA2, 0.04), (GaussLegendre2, 0.06)])
def test_the_order_of_a_method_on_the_stabilized_problem_is_its_own(method, h):
    assert slope(method, [h, h / 1.5, h / 2.25], stabilized(KEPLER, ENERGY, 1.0)) == pytest.approx(
        method.order, abs=0.2
    )  # truncation


@pytest.mark.parametrize(("gamma", "method"), [(0.5, GaussLegendre3), (2.0, RadauIIA3)])
def test_a_stabilized_invariant_decays_exponentially(gamma, method):
    """(g − g₀)′ = −γ (g − g₀), whatever the flow along the manifold."""
    path = run_until(stabilized(KEPLER, Invariants(energy, value=-0.45), gamma), method(0.01), START, 3.0)
    defect = values(energy, path) + 0.45
    assert defect[0] == pytest.approx(-0.05)
    assert defect == pytest.approx(-0.05 * np.exp(-gamma * path.t), rel=1e-6)  # truncation


def test_two_stabilized_invariants_decay_at_the_same_rate():
    off = Invariants(lambda y: [y @ y, 0.5 * y @ (y / INERTIA)], lambda y: [2.0 * y, y / INERTIA], value=[1.0, 0.26])
    path = run_until(stabilized(RIGID_BODY, off, 1.5), GaussLegendre3(0.05), TURNING, 4.0)
    defect = np.array([off.g(y, None) - off.value for y in path.y])
    assert defect == pytest.approx(np.exp(-1.5 * path.t)[:, None] * defect[0], rel=1e-6)  # truncation


def test_stabilization_with_one_invariant_is_the_energy_form():
    """y′ = f − γ (H − H₀) ∇H / |∇H|²."""
    problem = stabilized(KEPLER, Invariants(energy, energy_slope, value=-0.3), 0.7)
    y = problem.begin(START)
    gradient = energy_slope(y[:2], y[2:]).reshape(-1)
    expected = KEPLER.field(0.0, KEPLER.begin(START)) - 0.7 * (-0.5 + 0.3) * gradient / (gradient @ gradient)
    assert problem.field(0.0, y) == pytest.approx(expected, abs=ROUNDING)
    halves = problem.g(0.0, y[:2], y[2:]), problem.f(0.0, y[:2], y[2:])
    assert np.concatenate(halves) == pytest.approx(expected, abs=ROUNDING)


@pytest.mark.slow
def test_stabilization_bounds_an_energy_that_drifts_otherwise():
    plain = values(energy, run_steps(KEPLER, RadauIIA2(0.05), START, 2000))
    steadied = values(energy, run_steps(stabilized(KEPLER, ENERGY, 5.0), RadauIIA2(0.05), START, 2000))
    early, late = np.abs(steadied[:1000] + 0.5).max(), np.abs(steadied[1000:] + 0.5).max()
    assert late == pytest.approx(early, rel=0.1)
    assert np.abs(plain + 0.5)[-1] > 10 * late


def test_a_problem_on_its_manifold_is_not_changed_by_stabilization():
    exact, problem = run_until(KEPLER, KahanLi8(0.02), START, PERIOD), stabilized(KEPLER, ENERGY, 3.0)
    assert isinstance(problem, Partitioned)
    assert (
        np.abs(run_until(problem, GaussLegendre4(0.02), START, PERIOD).y - exact.y).max() < 1e-10
    )  # truncation of both


@pytest.mark.parametrize(
    ("method", "h"), [pytest.param(ImplicitEuler, 0.002, marks=pytest.mark.slow), (RadauIIA2, 0.02), (RadauIIA3, 0.05)]
)
def test_the_problem_of_index_2_has_the_solutions_of_the_problem_itself(method, h):
    """The energy is a constraint, to rounding; the multiplier vanishes with h, and the error as hᵖ."""
    problem = index_two(KEPLER, ENERGY)
    paths = [run_until(problem, method(step), START, 7.5) for step in (h, h / 2.0)]
    errors = [np.linalg.norm(problem.parts(path.y)[0][-1] - kepler_end()) for path in paths]
    multipliers = [np.abs(problem.parts(path.y)[1]).max() for path in paths]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.3)  # truncation
    assert 1e-14 < multipliers[1] < 0.6 * multipliers[0]
    energies = [energy(y[:2], y[2:]) for y in problem.parts(paths[1].y)[0]]
    assert np.abs(np.array(energies) + 0.5).max() < 3 * ROUNDING
