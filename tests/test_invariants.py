"""Invariants: kept to rounding by projection and multipliers, restored by stabilization; the order of the method stays."""

import numpy as np
import pytest
from kept_problems import (
    CASIMIR_AND_ENERGY,
    ENERGY,
    KEPLER,
    PERIOD,
    RIGID_BODY,
    ROUNDING,
    START,
    TURNING,
    angular_momentum,
    attraction,
    direction,
    energy,
    energy_slope,
    slope,
    values,
)
from references import load
from scipy.integrate import solve_ivp

import minimd as md
from minimd.integrators import (
    SE1,
    CandyRozmus4,
    GaussLegendre1,
    GaussLegendre2,
    ImplicitEuler,
    Invariants,
    KahanLi8,
    RadauIIA2,
    RadauIIA3,
    SecondOrder,
    StepControl,
    VelocityVerlet,
    index_two,
    projected,
    run_adaptive,
    run_reversible,
    run_steps,
    run_until,
    stabilized,
    symmetrically_projected,
    with_multipliers,
)

WRAPPERS = [projected, symmetrically_projected, with_multipliers]


@pytest.mark.parametrize("wrapper", WRAPPERS)
@pytest.mark.parametrize(
    ("method", "h"), [(VelocityVerlet, 0.02), (RadauIIA2, 0.03), (GaussLegendre2, 0.06), (CandyRozmus4, 0.05)]
)
def test_the_order_is_that_of_the_method(wrapper, method, h):
    on_manifold = wrapper(method, ENERGY)
    assert on_manifold.order == on_manifold.order_on(KEPLER) == method.order
    assert slope(on_manifold, [h, h / 1.5, h / 2.25]) == pytest.approx(method.order, abs=0.2)  # truncation


@pytest.mark.parametrize("wrapper", WRAPPERS)
@pytest.mark.parametrize("method", [VelocityVerlet, RadauIIA2])
def test_what_is_corrected_is_the_local_error(wrapper, method):
    """The exact flow keeps the invariants: corrections and multipliers vanish with h, as hᵖ⁺¹ per step."""
    y, timesteps = run_until(KEPLER, KahanLi8(0.01), START, 0.7).y[-1], np.array([0.04, 0.02, 0.01])
    start, on_manifold = (y[:2], y[2:]), wrapper(method, ENERGY)
    corrections = [
        np.linalg.norm(run_steps(KEPLER, on_manifold(h), start, 1).y[-1] - run_steps(KEPLER, method(h), start, 1).y[-1])
        for h in timesteps
    ]
    assert np.polyfit(np.log(timesteps), np.log(corrections), 1)[0] == pytest.approx(
        method.order + 1, abs=0.15
    )  # truncation


@pytest.mark.parametrize("wrapper", WRAPPERS)
@pytest.mark.parametrize("method", [VelocityVerlet, SE1, RadauIIA3, ImplicitEuler])
def test_the_energy_is_kept_to_rounding(wrapper, method):
    h = 0.002 if method is ImplicitEuler else 0.02  # with longer steps it falls into the sun
    plain = values(energy, run_steps(KEPLER, method(h), START, 500))
    kept = values(energy, run_steps(KEPLER, wrapper(method, ENERGY)(h), START, 500))
    assert np.abs(plain + 0.5).max() > 1e-8
    assert np.abs(kept + 0.5).max() < (10 if method is ImplicitEuler else 1) * ROUNDING  # its steps are noisier than g


@pytest.mark.parametrize(
    ("method", "h"),
    [
        (VelocityVerlet, 0.05),
        pytest.param(ImplicitEuler, 0.01, marks=pytest.mark.slow),
        pytest.param(RadauIIA2, 0.1, marks=pytest.mark.slow),
    ],
)
def test_the_energy_does_not_drift_in_10_000_steps(method, h):
    kept = run_steps(KEPLER, projected(method, ENERGY)(h), START, 10_000, every=10)
    assert np.abs(values(energy, kept) + 0.5).max() < ROUNDING


@pytest.mark.slow
def test_the_energy_does_not_drift_in_100_000_steps():
    kept = run_steps(KEPLER, projected(RadauIIA2, ENERGY)(0.1), START, 100_000, every=100)
    assert np.abs(values(energy, kept) + 0.5).max() < ROUNDING


def test_a_planet_whose_invariants_are_all_kept_stays_on_its_ellipse():
    """Energy, angular momentum and direction of the pericentre: r + e x = a (1 − e²), with a first-order method."""
    orbit = Invariants(lambda q, v: [energy(q, v), angular_momentum(q, v), direction(q, v)])
    path = run_steps(KEPLER, projected(ImplicitEuler, orbit)(0.005), START, 1500)
    assert np.linalg.norm(path.q, axis=1) + 0.6 * path.q[:, 0] == pytest.approx(0.64, abs=10 * ROUNDING)
    plain = run_steps(KEPLER, ImplicitEuler(0.005), START, 300)
    assert np.abs(np.linalg.norm(plain.q, axis=1) + 0.6 * plain.q[:, 0] - 0.64).max() > 0.04


@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_a_rigid_body_keeps_both_its_invariants(wrapper):
    path = run_steps(RIGID_BODY, wrapper(RadauIIA2, CASIMIR_AND_ENERGY)(0.1), TURNING, 300)
    kept = np.array([CASIMIR_AND_ENERGY.g(y, None) for y in path.y])
    assert np.abs(kept - kept[0]).max() < ROUNDING
    plain = run_steps(RIGID_BODY, RadauIIA2(0.1), TURNING, 300)
    assert abs(plain.y[-1] @ plain.y[-1] - TURNING @ TURNING) > 1e-6


@pytest.mark.slow
def test_seven_invariants_of_the_outer_solar_system():
    """Energy, momentum and angular momentum of six bodies, q and v of shape (6, 3)."""
    sun = load("geometric/problems.json")["outer_solar_system"]
    m, x, v = (np.array(sun[key], dtype=float) for key in ("m", "x0", "v0"))
    first, second = np.triu_indices(6, 1)

    def gravity(q):
        d = q[None] - q[:, None]
        r3 = ((d**2).sum(axis=2) + np.eye(6)) ** 1.5
        return 2.95912208286e-4 * (m[None, :, None] * d / r3[:, :, None]).sum(axis=1)

    def conserved(q, v):
        potential = -2.95912208286e-4 * (m[first] * m[second] / np.linalg.norm(q[first] - q[second], axis=1)).sum()
        return [0.5 * m @ (v**2).sum(axis=1) + potential, *(m @ v), *(m @ np.cross(q, v))]

    path = run_steps(SecondOrder(gravity), projected(RadauIIA2, Invariants(conserved))(100.0), (x, v), 40)
    plain = run_steps(SecondOrder(gravity), RadauIIA2(100.0), (x, v), 40)
    speeds, distances = np.linalg.norm(v, axis=1), np.linalg.norm(x, axis=1)
    size = np.repeat(
        [0.5 * m @ speeds**2, m @ speeds, m @ (distances * speeds)], [1, 3, 3]
    )  # of the terms, which may cancel
    error, plain_error = (np.abs(np.array(conserved(s.q[-1], s.v[-1])) - conserved(x, v)) / size for s in (path, plain))
    assert path.q.shape == (41, 6, 3)
    assert error.max() < 1e-14  # rounding
    assert plain_error[0] > 1e-7


@pytest.mark.parametrize("wrapper", WRAPPERS)
@pytest.mark.parametrize("method", [VelocityVerlet, GaussLegendre1, RadauIIA2])
def test_reversal_returns_to_the_start_if_and_only_if_the_answer_is_symmetric(wrapper, method):
    on_manifold = wrapper(method, ENERGY)
    there = run_steps(KEPLER, on_manifold(0.05), START, 40)
    back = run_steps(KEPLER, on_manifold(-0.05), (there.q[-1], there.v[-1]), 40, t0=2.0)
    distance = np.abs(back.y[-1] - there.y[0]).max()
    assert on_manifold.is_symmetric == (wrapper is not projected and method is not RadauIIA2)
    assert (distance < 1e-12) if on_manifold.is_symmetric else (distance > 1e-7)


def symplecticity_defect(method):
    """Largest element of Φ′ᵀJΦ′ − J, Φ′ by central differences."""
    y, d = np.array([0.5, 0.3, -0.4, 1.3]), 1e-5
    sides = [
        [run_steps(KEPLER, method(0.1), (z[:2], z[2:]), 1).y[-1] for z in (y + d * e, y - d * e)] for e in np.eye(4)
    ]
    jacobian = np.array([(ahead - behind) / (2.0 * d) for ahead, behind in sides]).T
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    return np.abs(jacobian.T @ form @ jacobian - form).max()


@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_a_projected_symplectic_method_is_not_symplectic(wrapper):
    on_manifold = wrapper(VelocityVerlet, Invariants(energy, energy_slope, value=-0.8))
    assert not on_manifold.is_symplectic
    assert symplecticity_defect(on_manifold) > 1e-3
    assert symplecticity_defect(VelocityVerlet) < 1e-8  # truncation of the difference quotient
    assert not wrapper(VelocityVerlet, ENERGY).is_explicit


def test_an_invariant_that_the_method_keeps_anyway_changes_nothing():
    plain = run_steps(KEPLER, VelocityVerlet(0.02), START, 300)
    for wrapper in WRAPPERS:
        kept = run_steps(KEPLER, wrapper(VelocityVerlet, Invariants(angular_momentum))(0.02), START, 300)
        assert np.abs(kept.y - plain.y).max() < 1e-11  # rounding, growing with the square of time


def test_jacobians_by_differences_are_those_in_closed_form():
    y = np.array([0.5, 0.3, -0.4, 1.3])
    for invariants in (Invariants(energy), Invariants(lambda y: energy(y[:2], y[2:]))):
        assert invariants.through(y, (2,)).jacobian(y) == pytest.approx(ENERGY.through(y, (2,)).jacobian(y), abs=1e-12)
    by_differences = run_until(KEPLER, projected(RadauIIA2, Invariants(energy))(0.05), START, PERIOD)
    in_closed_form = run_until(KEPLER, projected(RadauIIA2, ENERGY)(0.05), START, PERIOD)
    assert np.abs(by_differences.y - in_closed_form.y).max() < 1e-9


def test_drivers_with_varying_steps_keep_the_invariants_too():
    adaptive = run_adaptive(KEPLER, projected(RadauIIA3, ENERGY), START, 2 * PERIOD, control=StepControl(rtol=1e-6))
    reversible = run_reversible(KEPLER, with_multipliers(GaussLegendre1, ENERGY)(0.1), START, 2 * PERIOD)
    for path in (adaptive, reversible):
        assert np.ptp(np.diff(path.t)) > 0.05
        assert np.abs(values(energy, path) + 0.5).max() < ROUNDING


def test_scipy_keeps_no_energy():
    """The yardstick: an error-controlled explicit method, whose energy drifts."""
    ivp = solve_ivp(
        lambda t, y: [*y[2:], *attraction(y[:2])], (0.0, 20 * PERIOD), [*START[0], *START[1]], rtol=1e-6, atol=1e-9
    )
    assert abs(energy(ivp.y[:2, -1], ivp.y[2:, -1]) + 0.5) > 1e-5


def test_a_given_value_is_reached_in_the_first_step():
    for wrapper in WRAPPERS:
        path = run_steps(KEPLER, wrapper(GaussLegendre2, Invariants(energy, energy_slope, value=-0.49))(0.05), START, 3)
        assert values(energy, path) == pytest.approx([-0.5, -0.49, -0.49, -0.49], abs=10 * ROUNDING)


def test_a_state_of_rest_stays_where_it_is():
    """The gradient of the energy vanishes there, but nothing needs correction."""
    spring, oscillator = Invariants(lambda q, v: q @ q + v @ v), SecondOrder(lambda q: -q)
    for wrapper in WRAPPERS:
        assert not run_steps(oscillator, wrapper(VelocityVerlet, spring)(0.1), ([0.0], [0.0]), 5).y.any()
    assert not run_steps(stabilized(oscillator, spring, 1.0), GaussLegendre1(0.1), ([0.0], [0.0]), 5).y.any()


def test_dependent_invariants_are_told():
    twice = Invariants(lambda q, v: [energy(q, v), 2.0 * energy(q, v)])
    for wrapper in WRAPPERS:
        with pytest.raises(
            md.ConvergenceError, match=r"step 1 from t = 0 .* invariant 1 is not independent.* full rank"
        ):
            run_steps(KEPLER, wrapper(RadauIIA2, twice)(0.05), START, 5)
    with pytest.raises(md.ConvergenceError, match="invariant 1 is not independent"):
        run_steps(
            stabilized(KEPLER, Invariants(lambda q, v: [energy(q, v), 2.0 * energy(q, v)], value=[-0.4, -0.8]), 1.0),
            RadauIIA2(0.05),
            START,
            5,
        )
    with pytest.raises(md.ConvergenceError, match=r"invariant 0 .*vanishes"):
        run_steps(KEPLER, projected(RadauIIA2, Invariants(lambda q, v: q[0] * 0.0, value=1.0))(0.05), START, 5)


def test_a_manifold_out_of_reach_is_told_with_the_path_before():
    impossible = Invariants(lambda q, v: v @ v, value=-1.0)
    with pytest.raises(md.ConvergenceError, match=r"step 1 .* invariant 0 is off by") as caught:
        run_steps(KEPLER, projected(VelocityVerlet, impossible)(0.05), START, 5)
    assert (caught.value.solution.q[0] == START[0]).all()


def test_bad_input_is_told():
    for gamma in (0.0, -1.0, np.nan, "much"):
        with pytest.raises(ValueError, match="gamma must be positive and finite; gamma = "):
            stabilized(KEPLER, ENERGY, gamma)
    for wrapper in WRAPPERS:
        with pytest.raises(TypeError, match="method must be a method without a time step"):
            wrapper(VelocityVerlet(0.1), ENERGY)
        with pytest.raises(TypeError, match=r"invariants must be Invariants\(g\)"):
            wrapper(VelocityVerlet, energy)
    with pytest.raises(TypeError, match="g must be a function of y, or of q and v"):
        Invariants(3.0)
    with pytest.raises(TypeError, match="must not depend on t"):
        Invariants(lambda t, q, v: q[0])
    with pytest.raises(TypeError, match="problem must be SecondOrder, Partitioned or FirstOrder; got object"):
        index_two(object(), ENERGY)
    with pytest.raises(ValueError, match="the start violates the constraint 0 = g"):
        run_steps(index_two(KEPLER, Invariants(energy, value=-0.4)), RadauIIA2(0.05), START, 5)
    with pytest.raises(TypeError, match="Partitioned and FirstOrder problems; got object"):
        stabilized(object(), ENERGY, 1.0)


@pytest.mark.parametrize(
    ("invariants", "sentence"),
    [
        (Invariants(energy, value=[1.0, 2.0]), "one number per invariant; g has 1, value has 2"),
        (Invariants(energy, lambda q, v: v), r"jacobian must have 1 × 4 numbers, ∂g/∂y; got 2"),
        (Invariants(lambda y: y), "fewer invariants than unknowns, and at least one; got 4 of 4"),
        (Invariants(lambda y: []), "at least one; got 0 of 4"),
        (Invariants(lambda y: np.nan * y[0]), "must be finite at the start"),
    ],
)
def test_invariants_that_do_not_fit_the_problem_are_told(invariants, sentence):
    with pytest.raises(ValueError, match=sentence):
        run_steps(KEPLER, projected(RadauIIA2, invariants)(0.05), START, 5)
    with pytest.raises(ValueError, match=sentence):
        run_steps(stabilized(KEPLER, invariants, 1.0), RadauIIA2(0.05), START, 5)


def test_invariants_of_q_and_v_need_a_problem_that_has_them():
    with pytest.raises(TypeError, match="takes q and v, but the problem has none"):
        run_steps(RIGID_BODY, projected(RadauIIA2, ENERGY)(0.05), TURNING, 5)
