"""Paths on a manifold: RATTLE on g(q) = 0; invariants kept by projection, multipliers, stabilization, index 2."""

import numpy as np
import pytest
import small_problems as small
from dae_problems import DOUBLE_START, SWING_START, double_pendulum, on_rods, swing
from small_problems import ENERGY, KEPLER, KEPLER_START, PERIOD, ROUNDING, SPLITTINGS, energy, energy_errors

import minimd.integrators as mi
from minimd.integrators import Invariants, RadauIIA2, VelocityVerlet, projected, run_steps, run_until, stabilized

slow = pytest.mark.slow
ANGLE_AT_3 = -0.94875159694619818661  # of θ″ = −sin θ from θ = 1 at rest; Jacobi's elliptic functions
QUICK = [VelocityVerlet, mi.Ruth3, mi.Suzuki4, mi.Yoshida6]
SOME = QUICK + [pytest.param(method, marks=slow) for method in SPLITTINGS if method not in QUICK]
OF_INDEX_2 = (mi.ImplicitEuler, 0.002), (mi.RadauIIA3, 0.05)
OF_INDEX_2 = [(RadauIIA2, 0.02), *(pytest.param(*row, marks=slow) for row in OF_INDEX_2)]
WRAPPERS = [projected, mi.symmetrically_projected, mi.with_multipliers]
wrappers = pytest.mark.parametrize("wrapper", WRAPPERS)
STEPS = {VelocityVerlet: 0.02, RadauIIA2: 0.03, mi.GaussLegendre2: 0.06, mi.CandyRozmus4: 0.05}
WRAPPED = [(projected, *row) for row in STEPS.items()] + [(mi.symmetrically_projected, VelocityVerlet, 0.02)]
WRAPPED += [pytest.param(mi.symmetrically_projected, *row, marks=slow) for row in list(STEPS.items())[1:]]
WRAPPED += [pytest.param(mi.with_multipliers, *row, marks=slow) for row in STEPS.items()]
LONG = (VelocityVerlet, 0.05, 10_000), (mi.ImplicitEuler, 0.01, 10_000), (RadauIIA2, 0.1, 100_000)
KEPT = [(one, method, 0.02, 60) for one in WRAPPERS for method in (VelocityVerlet, mi.SE1, mi.RadauIIA3)]
KEPT += [pytest.param(one, mi.ImplicitEuler, 0.002, 60, marks=slow) for one in WRAPPERS]  # it falls into the sun
KEPT += [(projected, VelocityVerlet, 0.05, 500), *(pytest.param(projected, *row, marks=slow) for row in LONG)]


@pytest.mark.parametrize("method", SOME)
def test_order_on_the_pendulum(method):
    order = method.order_on(swing())
    h = {1: 0.01, 2: 0.05, 4: 0.1, 6: 0.3, 8: 0.3}[order] / 1.25 ** np.arange(3)
    end = lambda h: run_until(swing(), method(h), SWING_START, 3.0).q[-1]  # noqa: E731
    slope = small.slope(lambda h: abs(np.arctan2(*end(h) * [1, -1]) - ANGLE_AT_3), 3.0 / np.round(3.0 / h))
    assert slope == pytest.approx(order, abs=0.3 if order > 4 else 0.1)  # truncation


def test_rows_of_velocity_verlet_keep_their_order_and_others_do_not():
    orders = {name: method.order_on(swing()) for name, method in mi.SPLITTINGS.items()}
    assert (orders["suzuki-4"], orders["yoshida-6"], orders["kahan-li-8"]) == (4, 6, 8)
    assert (orders["pefrl"], orders["candy-rozmus-4"], orders["blanes-moan-rkn-4"]) == (2, 2, 2)


def test_constraints_are_kept_to_rounding():
    exact, by_differences = double_pendulum(), double_pendulum(with_jacobian=False)
    path = run_steps(by_differences, VelocityVerlet(0.02), DOUBLE_START, 60)
    exact.begin(DOUBLE_START)
    assert max(np.abs(exact.violation(q)).max() for q in path.q) < 1e-14
    sliding = [np.abs(exact.jacobian(q) @ v).max() for q, v in zip(path.q, path.v, strict=True)]
    assert max(sliding) < 1e-12  # G by differences


@pytest.mark.parametrize("method", [one for one in SPLITTINGS if one.is_symmetric and one.stages < 7])
def test_a_reversed_run_returns_to_the_start(method):
    there = run_steps(double_pendulum(), method(0.05), DOUBLE_START, 12)
    back = run_steps(double_pendulum(), method(0.05), (there.q[-1], -there.v[-1]), 12)
    assert np.abs(there.q[-1] - there.q[0]).max() > 0.1
    assert np.abs(back.q[-1] - there.q[0]).max() < 1e-9


@pytest.mark.parametrize("method", SPLITTINGS)
def test_the_step_is_symplectic_on_the_manifold(method):
    """ω(Φ′ξ, Φ′η) = ω(ξ, η) for tangent ξ, η, with ω = Σ m dq ∧ dv; Φ′ by differences along charts of two angles."""
    masses, z, h = np.array([1.0, 1.0, 2.0, 2.0]), np.array([1.0, 2.0, 0.3, -0.5]), 1e-5

    def step(z):
        path = run_steps(double_pendulum(), method(0.1), on_rods(*z), 1)
        return np.concatenate([path.q[-1], path.v[-1]])

    def form(function):
        columns = [(function(z + h * unit) - function(z - h * unit)) / (2.0 * h) for unit in np.eye(4)]
        q, v = np.split(np.column_stack(columns), 2)
        return q.T @ (masses[:, None] * v) - v.T @ (masses[:, None] * q)

    before = form(lambda z: np.concatenate(on_rods(*z)))
    assert np.abs(before).max() > 0.1
    assert np.abs(form(step) - before).max() < 1e-8  # truncation h², rounding 1/h


def test_multipliers_are_the_tension():
    """λ = |v|² + cos θ for unit length, mass and gravity."""
    q, v = np.array([np.sin(0.4), -np.cos(0.4)]), 0.7 * np.array([np.cos(0.4), np.sin(0.4)])
    for jacobian in (lambda q: q[None, :], None):
        problem = mi.Holonomic(lambda q: np.array([0.0, -1.0]), lambda q: [0.5 * (q @ q - 1.0)], jacobian)
        problem.begin(SWING_START)
        assert problem.multipliers(0.0, q, v)[0] == pytest.approx(0.49 + np.cos(0.4), rel=1e-11)


def test_a_start_off_the_manifold_is_projected_and_told():
    start = [1.1, 0.0], [0.3, 0.2]
    with pytest.warns(UserWarning, match="projected onto the constraints") as warned:
        path = run_steps(swing(), VelocityVerlet(0.01), start, 1)
    assert [w.filename for w in warned] == [__file__]  # the caller's line, however deep in minimd
    assert path.y[0] == pytest.approx([1.0, 0.0, 0.0, 0.2], abs=1e-15)


@pytest.mark.parametrize(("wrapper", "method", "h"), WRAPPED)
def test_the_order_is_that_of_the_method(wrapper, method, h):
    """What is corrected is the local error, as the exact flow keeps the invariants: hᵖ⁺¹ per step."""
    on_manifold, y = wrapper(method, ENERGY), small.kepler_orbit(0.7)
    assert on_manifold.order == on_manifold.order_on(KEPLER) == method.order
    assert small.kepler_slope(on_manifold, [h, h / 1.5]) == pytest.approx(method.order, abs=0.2)  # truncation
    if method in (VelocityVerlet, RadauIIA2):
        step = lambda m, h: run_steps(KEPLER, m(h), (y[:2], y[2:]), 1).y[-1]  # noqa: E731
        long, short = (np.linalg.norm(step(on_manifold, h) - step(method, h)) for h in (0.04, 0.01))
        assert np.log2(long / short) / 2 == pytest.approx(method.order + 1, abs=0.15)  # truncation


@pytest.mark.parametrize(("wrapper", "method", "h", "n_steps"), KEPT)
def test_the_energy_is_kept_to_rounding_and_does_not_drift(wrapper, method, h, n_steps):
    every = max(1, n_steps // 10_000)
    kept = run_steps(KEPLER, wrapper(method, ENERGY)(h), KEPLER_START, n_steps, every=every)
    assert np.abs(energy_errors(run_steps(KEPLER, method(h), KEPLER_START, 60))).max() > 1e-8
    noise = 10 if h == 0.002 else 1  # the steps of implicit Euler are noisier than g
    assert np.abs(energy_errors(kept)).max() < noise * ROUNDING


def test_a_planet_whose_invariants_are_all_kept_stays_on_its_ellipse():
    """Energy, angular momentum and direction of the pericentre: r + e x = a (1 − e²), with a first-order method."""

    def direction(q, v):
        spin, r = small.angular_momentum(q, v), np.sqrt(q @ q)
        return np.arctan2(-v[0] * spin - q[1] / r, v[1] * spin - q[0] / r)

    orbit = Invariants(lambda q, v: [energy(q, v), small.angular_momentum(q, v), direction(q, v)])
    methods = projected(mi.ImplicitEuler, orbit), mi.ImplicitEuler
    paths = (run_steps(KEPLER, method(0.005), KEPLER_START, 60).q for method in methods)
    kept, plain = (np.abs(np.linalg.norm(q, axis=1) + 0.6 * q[:, 0] - 0.64).max() for q in paths)
    assert kept < 10 * ROUNDING
    assert plain > 1e-3


@wrappers
def test_a_rigid_body_keeps_both_its_invariants(wrapper):
    methods = wrapper(RadauIIA2, small.CASIMIR_AND_ENERGY), RadauIIA2
    kept, plain = (run_steps(small.RIGID_BODY, method(0.1), small.TURNING, 30) for method in methods)
    values = np.array([small.CASIMIR_AND_ENERGY.g(y, None) for y in kept.y])
    assert np.abs(values - values[0]).max() < ROUNDING
    assert abs(plain.y[-1] @ plain.y[-1] - small.TURNING @ small.TURNING) > 1e-8


@wrappers
@pytest.mark.parametrize("method", [VelocityVerlet, mi.GaussLegendre1, RadauIIA2])
def test_reversal_returns_to_the_start_if_and_only_if_the_answer_is_symmetric(wrapper, method):
    on_manifold = wrapper(method, ENERGY)
    there = run_steps(KEPLER, on_manifold(0.05), KEPLER_START, 15)
    back = run_steps(KEPLER, on_manifold(-0.05), (there.q[-1], there.v[-1]), 15, t0=0.75)
    distance = np.abs(back.y[-1] - there.y[0]).max()
    assert on_manifold.is_symmetric == (wrapper is not projected and method is not RadauIIA2)
    assert distance < 1e-12 if on_manifold.is_symmetric else distance > 1e-7


@wrappers
def test_a_projected_symplectic_method_is_not_symplectic(wrapper):
    """Its steps go to a manifold that does not hold the state."""
    on_manifold = wrapper(VelocityVerlet, Invariants(energy, small.energy_slope, value=-0.8))
    assert (on_manifold.is_symplectic, on_manifold.is_explicit) == (False, False)
    start = (0.5, 0.3), (-0.4, 1.3)
    defects = [small.symplecticity_defect(small.jacobian(KEPLER, m, start, 0.1)) for m in (on_manifold, VelocityVerlet)]
    assert defects[0] > 1e-3
    assert defects[1] < 1e-8  # truncation of the difference quotient


@wrappers
def test_nothing_is_changed_where_nothing_needs_correction_and_a_given_value_is_reached_at_once(wrapper):
    """An invariant that the method keeps anyway; a state of rest, where the gradient of the energy vanishes."""
    plain, method = run_steps(KEPLER, VelocityVerlet(0.02), KEPLER_START, 100), VelocityVerlet
    kept = run_steps(KEPLER, wrapper(method, Invariants(small.angular_momentum))(0.02), KEPLER_START, 100)
    assert np.abs(kept.y - plain.y).max() < 1e-11  # rounding, growing with the square of time
    spring, rest = Invariants(lambda q, v: q @ q + v @ v), ([0.0], [0.0])
    assert not run_steps(small.OSCILLATOR, wrapper(method, spring)(0.1), rest, 5).y.any()
    assert not run_steps(stabilized(small.OSCILLATOR, spring, 1.0), mi.GaussLegendre1(0.1), rest, 5).y.any()
    method = wrapper(mi.GaussLegendre2, Invariants(energy, small.energy_slope, value=-0.49))
    path = run_steps(KEPLER, method(0.05), KEPLER_START, 3)
    assert energy_errors(path) == pytest.approx([0.0, 0.01, 0.01, 0.01], abs=10 * ROUNDING)


def test_jacobians_by_differences_are_those_in_closed_form():
    y = np.array([0.5, 0.3, -0.4, 1.3])
    for invariants in (Invariants(energy), Invariants(lambda y: energy(y[:2], y[2:]))):
        assert invariants.through(y, (2,)).jacobian(y) == pytest.approx(ENERGY.through(y, (2,)).jacobian(y), abs=1e-12)


def test_drivers_with_varying_steps_keep_the_invariants_too():
    control, method = mi.StepControl(rtol=1e-6), mi.with_multipliers(mi.GaussLegendre1, ENERGY)
    adaptive = mi.run_adaptive(KEPLER, projected(mi.RadauIIA3, ENERGY), KEPLER_START, PERIOD, control=control)
    for path in (adaptive, mi.run_reversible(KEPLER, method(0.1), KEPLER_START, PERIOD)):
        assert np.ptp(np.diff(path.t)) > 0.05
        assert np.abs(energy_errors(path)).max() < ROUNDING


@pytest.mark.parametrize(("method", "h"), [pytest.param(VelocityVerlet, 0.02, marks=slow), (mi.GaussLegendre2, 0.06)])
def test_the_order_of_a_method_on_the_stabilized_problem_is_its_own(method, h):
    order = small.kepler_slope(method, [h, h / 1.5], stabilized(KEPLER, ENERGY, 1.0))
    assert order == pytest.approx(method.order, abs=0.2)  # truncation


@pytest.mark.parametrize(("gamma", "method"), [pytest.param(0.5, mi.GaussLegendre3, marks=slow), (2.0, mi.RadauIIA3)])
def test_a_stabilized_invariant_decays_exponentially(gamma, method):
    """(g − g₀)′ = −γ (g − g₀), whatever the flow along the manifold."""
    path = run_until(stabilized(KEPLER, Invariants(energy, value=-0.45), gamma), method(0.02), KEPLER_START, 0.4)
    assert energy_errors(path) - 0.05 == pytest.approx(-0.05 * np.exp(-gamma * path.t), rel=1e-6)  # truncation


def test_two_stabilized_invariants_decay_at_the_same_rate():
    g, jacobian = (lambda y: [y @ y, 0.5 * y @ (y / small.INERTIA)]), (lambda y: [2.0 * y, y / small.INERTIA])
    problem = stabilized(small.RIGID_BODY, Invariants(g, jacobian, value=[1.0, 0.26]), 1.5)
    path = run_until(problem, mi.GaussLegendre3(0.05), small.TURNING, 2.0)
    defect = np.array([g(y) for y in path.y]) - [1.0, 0.26]
    assert defect == pytest.approx(np.exp(-1.5 * path.t)[:, None] * defect[0], rel=1e-6)  # truncation


@pytest.mark.parametrize(("method", "h"), OF_INDEX_2)
def test_the_problem_of_index_2_has_the_solutions_of_the_problem_itself(method, h):
    """The energy is a constraint, to rounding; the multiplier vanishes with h, and the error as hᵖ."""
    problem, errors, multipliers = mi.index_two(KEPLER, ENERGY), [], []
    for step in (h, h / 2.0):
        y, z = problem.parts(run_until(problem, method(step), KEPLER_START, 1.0).y)
        errors.append(np.linalg.norm(y[-1] - small.kepler_orbit(1.0)))
        multipliers.append(np.abs(z).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.3)  # truncation
    assert 1e-14 < multipliers[1] < 0.6 * multipliers[0]
    assert max(abs(energy(x[:2], x[2:]) + 0.5) for x in y) < 3 * ROUNDING
