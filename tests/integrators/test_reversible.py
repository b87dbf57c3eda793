"""Steps of varying length: reversible ones keep the energy, steps chosen by an error estimate let it drift."""

import numba
import numpy as np
import pytest

import minimd as md
from minimd.integrators import (
    DensityControl,
    Partitioned,
    SecondOrder,
    StepControl,
    run_adaptive,
    run_reversible,
    run_steps,
)

ECCENTRICITY = 0.9
START = (1.0 - ECCENTRICITY, 0.0), (0.0, np.sqrt((1.0 + ECCENTRICITY) / (1.0 - ECCENTRICITY)))
PERIOD = 2.0 * np.pi


@numba.njit
def attraction(q):
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def falling(t, q, v):
    """G of ρ ∝ r^(−3/2)."""
    return -1.5 * (q @ v) / (q @ q)


def energy_errors(solution):
    return 0.5 * (solution.v**2).sum(axis=1) - 1.0 / np.linalg.norm(solution.q, axis=1) + 0.5


def largest_error_by_half(errors):
    half = len(errors) // 2
    return np.abs(errors[:half]).max(), np.abs(errors[half:]).max()


def test_energy_stays_bounded_with_reversible_steps_and_drifts_with_plain_step_control():
    kepler = SecondOrder(attraction)
    reversible = run_reversible(kepler, md.VelocityVerlet(0.002), START, 100 * PERIOD)
    plain = run_adaptive(kepler, md.VelocityVerlet, START, 100 * PERIOD, control=StepControl(rtol=3e-6, atol=3e-6))
    assert plain.nfev > reversible.nfev
    early, late = largest_error_by_half(energy_errors(reversible))
    assert late == pytest.approx(early, rel=1e-3)
    early, late = largest_error_by_half(energy_errors(plain))
    assert late > 1.8 * early


@pytest.mark.slow
def test_energy_stays_bounded_over_1000_periods():
    kepler = SecondOrder(attraction)
    reversible = run_reversible(kepler, md.VelocityVerlet(0.002), START, 1000 * PERIOD)
    plain = run_adaptive(kepler, md.VelocityVerlet, START, 1000 * PERIOD, control=StepControl(rtol=3e-6, atol=3e-6))
    assert plain.nfev > 2 * reversible.nfev
    assert np.abs(energy_errors(reversible)).max() < 0.0075
    assert np.abs(energy_errors(plain)).max() > 0.09


@pytest.mark.parametrize(
    "method", [md.VelocityVerlet, md.PositionVerlet, md.integrators.BlanesMoan4, md.integrators.GaussLegendre2]
)
def test_a_reversed_run_returns_to_the_start(method):
    """Two periods there, from the last whole step back."""
    kepler = SecondOrder(attraction)
    there = run_reversible(kepler, method(0.003), START, 2 * PERIOD, control=DensityControl(falling))
    back = run_reversible(
        kepler,
        method(0.003),
        (there.q[-2], -there.v[-2]),
        there.t[-2],
        control=DensityControl(density=there.density[-2], rate=falling),
    )
    assert len(back.t) == len(there.t) - 1
    assert np.abs(back.q[-1] - START[0]).max() < 1e-9  # rounding, amplified by the close encounters
    assert np.abs(back.v[-1] + START[1]).max() < 1e-9


def test_the_density_that_is_found_is_the_density_in_closed_form():
    """ρ ∝ |f|^¾ = r^(−3/2) for Kepler; the integrated density follows it to the order of the method."""
    found = run_reversible(SecondOrder(attraction), md.VelocityVerlet(0.001), START, PERIOD)
    known = run_reversible(
        SecondOrder(attraction), md.VelocityVerlet(0.001), START, PERIOD, control=DensityControl(falling)
    )
    assert np.abs(found.y - known.y).max() < 1e-6  # truncation of the difference quotient
    exact = (np.linalg.norm(found.q, axis=1) / (1.0 - ECCENTRICITY)) ** -1.5
    assert found.density == pytest.approx(exact, rel=0.02)
    assert found.nfev == known.nfev + 2 * len(known.t)


def test_order_is_that_of_the_method():
    def error(timestep):
        end = run_reversible(
            SecondOrder(attraction), md.VelocityVerlet(timestep), START, PERIOD, control=DensityControl(falling)
        )
        return np.linalg.norm(end.q[-1] - START[0])

    timesteps = [0.0008, 0.0004, 0.0002]
    slope = np.polyfit(np.log(timesteps), np.log([error(h) for h in timesteps]), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1)


def test_constant_density_is_a_fixed_step():
    kepler = SecondOrder(attraction)
    constant = run_reversible(kepler, md.VelocityVerlet(0.002), START, 0.2, control=DensityControl(lambda t, q, v: 0.0))
    assert np.abs(constant.y - run_steps(kepler, md.VelocityVerlet(0.002), START, 100).y).max() < 1e-13


def test_every_keeps_first_and_last_and_the_end_is_met_backwards_in_time_too():
    kepler = SecondOrder(attraction)
    whole = run_reversible(kepler, md.VelocityVerlet(-0.002), START, -1.0)
    some = run_reversible(kepler, md.VelocityVerlet(-0.002), START, -1.0, every=7)
    assert whole.t[-1] == some.t[-1] == -1.0
    assert (some.y[:-1] == whole.y[::7][: len(some.y) - 1]).all()
    assert (some.y[-1] == whole.y[-1]).all()


@pytest.mark.parametrize(("length", "time"), [(1e-10, 1e-12), (1e-4, 1e3), (1e11, 3e7)])
def test_steps_are_the_same_in_any_unit(length, time):
    """An orbit that passes close by the origin of an attraction, ring-shaped, which is where f is largest and |q| smallest."""

    def path(length, time):
        def f(q):
            x = q / length
            return length / time**2 * -x / (x @ x + 1e-8) ** 1.5

        start = (length, 0.0), (0.0, 1e-4 * length / time)
        return run_reversible(SecondOrder(f), md.VelocityVerlet(0.002 * time), start, 1.5 * time)

    here, there = path(1.0, 1.0), path(length, time)
    assert np.linalg.norm(here.q, axis=1).min() < 1e-3
    assert len(here.t) == len(there.t)
    assert there.density == pytest.approx(here.density, rel=1e-6)  # rounding in the slope of ln |f|, amplified


def test_a_reversible_run_ends_after_so_many_steps():
    kepler = SecondOrder(attraction)
    whole = run_reversible(kepler, md.VelocityVerlet(0.002), START, 1.0)
    n_steps = len(whole.t) - 1
    some = run_reversible(kepler, md.VelocityVerlet(0.002), START, 1.0, control=DensityControl(max_steps=50), every=7)
    assert whole.success
    assert run_reversible(
        kepler, md.VelocityVerlet(0.002), START, 1.0, control=DensityControl(max_steps=n_steps)
    ).success
    assert not run_reversible(
        kepler, md.VelocityVerlet(0.002), START, 1.0, control=DensityControl(max_steps=n_steps - 1)
    ).success
    assert not some.success
    assert some.message.startswith(f"stopped at t = {whole.t[50]:g} after 50 steps")
    assert (some.y[-1] == whole.y[50]).all()


def test_bad_input_is_told():
    kepler = SecondOrder(attraction)
    for wrong in ({"density": 0.0}, {"density": np.nan}, {"max_steps": 0}, {"max_steps": 1.5}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            DensityControl(**wrong)
    with pytest.raises(TypeError, match="control must be DensityControl"):
        run_reversible(kepler, md.VelocityVerlet(0.01), START, 1.0, control=falling)
    with pytest.raises(ValueError, match="symmetric method"):
        run_reversible(kepler, md.integrators.SE1(0.01), START, 1.0)
    with pytest.raises(ValueError, match="must lie ahead"):
        run_reversible(kepler, md.VelocityVerlet(0.01), START, -1.0)
    with pytest.raises(TypeError, match="with its time step"):
        run_reversible(kepler, md.VelocityVerlet, START, 1.0)
    with pytest.raises(ValueError, match="finite"):
        run_reversible(kepler, md.VelocityVerlet(0.01), START, np.nan)


def test_a_density_that_is_no_longer_positive_ends_the_run_with_the_path_before():
    kepler = SecondOrder(attraction)
    with pytest.raises(md.ConvergenceError, match=r"step \d+ .* density of steps fell to") as caught:
        run_reversible(kepler, md.VelocityVerlet(0.5), START, 10.0)
    assert np.isfinite(caught.value.solution.y).all()
    assert (caught.value.solution.q[0] == START[0]).all()


def test_a_state_that_is_no_longer_finite_ends_the_run_with_the_path_before():
    falls = Partitioned(lambda v: v, lambda t, q: q if t < 0.5 else np.nan * q)
    with pytest.raises(md.NonFiniteError, match=r"step \d+") as caught:
        run_reversible(
            falls, md.VelocityVerlet(0.01), ((1.0,), (0.0,)), 1.0, control=DensityControl(lambda t, q, v: 0.0)
        )
    assert caught.value.solution.t[-1] < 0.6
