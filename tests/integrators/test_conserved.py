"""What steps conserve: linear and bilinear first integrals exactly, the energy within a bound, a shadow of it on the oscillator."""

import numba
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from small_problems import (
    HENON_HEILES,
    HENON_HEILES_START,
    NOT_SYMPLECTIC,
    ONE_STEP,
    SYMPLECTIC,
)

from minimd.integrators import (
    SE1,
    SE2,
    SPLITTINGS,
    Kick,
    Leapfrog,
    Partitioned,
    PositionVerlet,
    SecondOrder,
    VelocityVerlet,
    run_steps,
)

EPS = np.finfo(float).eps
B, C = np.array([1.0, -2.0, 0.5]), np.array([0.3, 1.0, 1.0])


@numba.njit
def across(direction, x):
    """A vector that depends on all of x, perpendicular to the direction."""
    return np.cross(direction, np.sin(x + 0.3 * x[::-1] + 0.2))


# b·q and c·v are conserved one by one.
APART = Partitioned(lambda v: across(B, v), lambda q: across(C, q))


# Only b·q + c·v is.
def joint_g(q, v):
    return np.sin(q @ v) * C * (B @ B) + across(B, v)


def joint_f(q, v):
    return -np.sin(q @ v) * B * (B @ B) + across(C, q)


JOINT = Partitioned(joint_g, joint_f)
START = (0.2, 0.5, -0.3), (0.4, 0.1, 0.6)


def linear_change(problem, method, h, n_steps, every=1):
    """Largest change of b·q + c·v, in ulps of its terms per step."""
    path = run_steps(problem, method(h), START, n_steps, every=every)
    integral = path.q @ B + path.v @ C
    size = np.abs(path.q * B).max() + np.abs(path.v * C).max()
    assert np.ptp(path.q[:, 0]) > 0.1
    return np.abs(integral - integral[0]).max() / (EPS * size * n_steps)


@pytest.mark.parametrize("method", ONE_STEP)
def test_linear_first_integrals_are_kept_to_rounding(method):
    """Also those of q and v together, by implicit steps too."""
    assert linear_change(APART, method, 0.1, 100) < method.stages
    assert linear_change(JOINT, method, 0.05, 50) < method.stages


@pytest.mark.parametrize("method", [VelocityVerlet, SE1, SE2])
def test_linear_first_integrals_are_kept_over_100_000_steps(method):
    assert linear_change(APART, method, 0.05, 100_000, every=1000) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("method", ONE_STEP)
def test_linear_first_integrals_are_kept_over_100_000_steps_by_every_method(method):
    assert linear_change(APART, method, 0.05, 100_000, every=1000) < method.stages


CENTRE = np.array([0.3, -0.2])


def pull(q):
    d = q - CENTRE
    return -d / (d @ d) ** 1.5


# H = (1 + |d|²)|v|²/2 + |d|²/2 with d = q − centre: turning around the centre changes nothing.
def round_g(q, v):
    d = q - CENTRE
    return (1.0 + d @ d) * v


def round_f(q, v):
    return -(1.0 + v @ v) * (q - CENTRE)


# H = sin(q₀v₀) + (q₀v₀)(q₁v₁): each qᵢvᵢ is conserved.
def scaling_g(q, v):
    a, b = q * v
    return q * np.array([np.cos(a) + b, a])


def scaling_f(q, v):
    a, b = q * v
    return -v * np.array([np.cos(a) + b, a])


TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
BILINEAR = {
    "angular momentum": (SecondOrder(pull), TURN, -TURN @ CENTRE),
    "angular momentum, not separable": (Partitioned(round_g, round_f), TURN, -TURN @ CENTRE),
    "scaling, not separable": (Partitioned(scaling_g, scaling_f), np.diag([1.0, 0.0]), np.zeros(2)),
}


@pytest.mark.parametrize("name", BILINEAR)
@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_bilinear_first_integrals_are_kept_to_rounding(method, name):
    """Those of the form vᵀ(Cq + k), by splittings and by their implicit forms."""
    problem, c, k = BILINEAR[name]
    path = run_steps(problem, method(0.02), ((1.0, 0.1), (0.1, 0.9)), 100)
    integral = np.einsum("ni,ni->n", path.v, path.q @ c.T + k)
    assert np.ptp(path.q) > 0.5
    assert np.abs(integral - integral[0]).max() < 100 * method.stages * EPS


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_other_quadratic_first_integrals_are_not_kept(method):
    """The energy of the oscillator is quadratic, but not of that form."""
    path = run_steps(SecondOrder(lambda q: -q), method(0.8), ((1.0,), (0.0,)), 200)
    assert np.ptp(path.v**2 + path.q**2) > 1e-8  # truncation


def henon_heiles_energy(path):
    (x, y), v = path.q.T, path.v
    return ((v**2).sum(axis=1) + x * x + y * y) / 2.0 + x * x * y - y**3 / 3.0


def largest_energy_errors(method, h, n_steps):
    """In the first and in the second half of a run."""
    energy = henon_heiles_energy(run_steps(HENON_HEILES, method(h), HENON_HEILES_START, n_steps))
    errors = np.abs(energy - energy[0])
    return errors[: n_steps // 2].max(), errors[n_steps // 2 :].max()


@pytest.mark.parametrize("method", SYMPLECTIC)
def test_the_energy_error_of_a_symplectic_method_is_bounded_and_falls_with_the_order(method):
    h = {1: 0.02, 2: 0.1, 3: 0.1, 4: 0.2, 6: 0.4, 8: 0.6}[method.order]
    first, second = largest_energy_errors(method, h, round(400.0 / h))
    half = max(largest_energy_errors(method, h / 2, round(400.0 / h)))
    assert second == pytest.approx(first, rel=0.15)
    assert np.log2(max(first, second) / half) == pytest.approx(method.order, abs=0.4)


@pytest.mark.parametrize("method", NOT_SYMPLECTIC)
def test_the_energy_of_a_method_that_is_not_symplectic_drifts(method):
    """Radau IIA damps; those of order 1 bring all motion to an end."""
    h, time = (0.02, 40.0) if method.order == 1 else (0.5, 100.0)
    first, second = largest_energy_errors(method, h, round(time / h))
    assert second > 1.2 * first


OMEGA = 2.0
OSCILLATOR = SecondOrder(lambda q: -(OMEGA**2) * q)


def shadow(method, h, x, v):
    """What the method conserves of the oscillator, in place of v² + ω²x²."""
    phi2 = (OMEGA * h) ** 2 / 4.0
    forms = {
        VelocityVerlet: v**2 + OMEGA**2 * x**2 * (1.0 - phi2),
        PositionVerlet: v**2 * (1.0 - phi2) + OMEGA**2 * x**2,
        SE1: v**2 + OMEGA**2 * x**2 - h * OMEGA**2 * x * v,
        SE2: v**2 + OMEGA**2 * x**2 + h * OMEGA**2 * x * v,
    }
    return forms[VelocityVerlet if method is Leapfrog else method]


@pytest.mark.parametrize("phase", [0.1, 1.0, 1.9])
@pytest.mark.parametrize("method", [VelocityVerlet, Leapfrog, PositionVerlet, SE1, SE2])
def test_the_shadow_energy_of_the_oscillator_is_conserved_to_rounding(method, phase):
    h = phase / OMEGA
    path = run_steps(OSCILLATOR, method(h), ((1.0,), (0.3,)), 20_000)
    energy, shadows = path.v**2 + OMEGA**2 * path.q**2, shadow(method, h, path.q, path.v)
    assert np.ptp(energy) > 0.2 * phase**2 * shadows[0]
    assert np.ptp(shadows) < 20_000 * EPS * energy.max()


def largest_swing(method, phase, n_steps):
    """Of the oscillator with ωΔt = phase that starts with amplitude one; a run that overflows has swung without bound."""
    y = np.array([1.0, 0.0])
    step = method.on(OSCILLATOR)
    OSCILLATOR.begin(((1.0,), (0.0,)))
    largest = 1.0
    for _ in range(n_steps):
        y = step(0.0, y, phase / OMEGA)
        largest = max(largest, abs(y[0]))
        if largest > 1e12:
            break
    return largest


@pytest.mark.parametrize("method", [VelocityVerlet, Leapfrog, PositionVerlet, SE1, SE2])
def test_verlet_and_symplectic_euler_are_stable_up_to_two_exactly(method):
    assert largest_swing(method, 2.0 - 1e-6, 30_000) < 2e3  # 1/√(1 − (ωΔt)²/4) for some of them
    assert largest_swing(method, 2.0 + 1e-6, 30_000) > 1e12


def stability_limit(method):
    """ωΔt where half the trace of the step, a polynomial in (ωΔt)², first leaves [−1, 1]."""
    (a, b), (c, d) = matrix = [[Polynomial([1.0]), Polynomial([0.0])], [Polynomial([0.0]), Polynomial([1.0])]]
    for substep in method.sequence():
        weight = substep.coefficient
        if isinstance(substep, Kick):  # v Δt −= weight (ωΔt)² q
            matrix = (a, b), (c - Polynomial([0.0, weight]) * a, d - Polynomial([0.0, weight]) * b)
        else:
            matrix = (a + weight * c, b + weight * d), (c, d)
        (a, b), (c, d) = matrix
    roots = np.concatenate([((a + d) / 2.0 - sign).roots() for sign in (1.0, -1.0)])
    return np.sqrt(min(root.real for root in roots if abs(root.imag) < 1e-9 < root.real))


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_splittings_are_stable_up_to_where_theory_says(method):
    limit = stability_limit(method)
    assert largest_swing(method, limit * (1.0 - 1e-4), 10_000) < 1e3
    assert largest_swing(method, limit * (1.0 + 1e-4), 40_000) > 1e12


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_no_splitting_is_more_stable_per_force_evaluation_than_verlet(method):
    """ωΔt < 2s for s evaluations: M. M. Chawla, S. R. Sharma, BIT 21, 455 (1981)."""
    limit = stability_limit(method)
    assert limit == pytest.approx(2.0, abs=1e-12) if method.stages == 1 else 1.0 < limit < 2.0 * method.stages
