"""How laws end at their cutoff, how smooth that is, and what less smooth ends do to methods of high order."""

import numpy as np
import pytest
from references import liquid
from scipy.special import betainc

import minimd as md
from minimd.core.potentials.law import evaluate_law, law_at, user_law
from minimd.core.potentials.truncation import TRUNCATIONS
from minimd.integrators import BlanesMoan4, KahanLi6, KahanLi8, Ruth3, VelocityVerlet

CUTOFF, START = 2.5, 2.0
LJ = md.LennardJones(1.0, 1.0, CUTOFF, "truncated")
FULL = [0.0163, 0.0390, 0.113]  # |u|, |u′|, |u″| of the law at 2.5
# errors above rounding, below 1e-2 ε
TIMESTEPS = {VelocityVerlet: 0.004, Ruth3: 0.004, BlanesMoan4: 0.008, KahanLi6: 0.01, KahanLi8: 0.02}
SMOOTHNESS = {"truncated": 0, "shifted": 1, "force-shifted": 2, "charmm": 2, "switched": 3, "smooth": 3}


def derivatives(potential, r, h=1e-4):
    """u, u′ and u″ around r."""
    u = [float(potential.pair_energy(r + k * h)) for k in (-2, -1, 0, 1, 2)]
    return np.array([u[2], (u[3] - u[1]) / (2 * h), (u[3] - 2 * u[2] + u[1]) / h**2])


@pytest.mark.parametrize("truncation", TRUNCATIONS)
def test_force_is_minus_the_derivative_of_the_truncated_law(truncation):
    potential, h = md.LennardJones(1.0, 1.0, CUTOFF, truncation), 1e-6
    numbers = tuple(potential.table((None,))[0, 0, 1:].tolist())
    for r in np.linspace(0.95, CUTOFF - 1e-3, 40).tolist():
        low, high = (law_at(potential.law, r + s, numbers)[0] for s in (-h, h))
        assert law_at(potential.law, r, numbers)[1] * r == pytest.approx((low - high) / (2 * h), rel=1e-7, abs=1e-8)


@pytest.mark.parametrize(("truncation", "smoothness"), SMOOTHNESS.items())
def test_truncation_is_as_smooth_as_it_promises_and_no_smoother(truncation, smoothness):
    """Continuous derivatives at the cutoff: none; u; u, u′; u, u′, u″ for smoothness 0 to 3; smooth has more."""
    potential = md.LennardJones(1.0, 1.0, CUTOFF, truncation)
    jumps = np.abs(derivatives(potential, CUTOFF - 1e-3) - derivatives(potential, CUTOFF + 1e-3)) / FULL
    assert (jumps[:smoothness] < 0.1).all()
    assert (jumps[smoothness : smoothness + 1] > 0.3).all()


@pytest.mark.parametrize(("truncation", "power"), [("smooth", 8), ("switched", 3), ("charmm", 2)])
def test_switches_leave_the_law_and_reach_zero_as_flat_as_they_promise(truncation, power):
    """Within δ of either end the energy is off by δ^(k + 1) where k derivatives are continuous: seven, two, one."""
    potential = md.LennardJones(1.0, 1.0, CUTOFF, truncation, switch_start=START)
    r, before = np.linspace(1.9, CUTOFF, 30), np.linspace(0.9, 1.99, 40)  # the default start is at 0.8 of the cutoff
    assert np.array_equal(md.LennardJones(1.0, 1.0, CUTOFF, truncation).pair_energy(r), potential.pair_energy(r))
    assert potential.pair_energy(before) == pytest.approx(LJ.pair_energy(before), rel=1e-14)
    delta = 0.02 / 1.3 ** np.arange(3)
    ends = {"cutoff": potential.pair_energy(CUTOFF - delta)}
    if truncation != "smooth":  # there the difference drowns in rounding, but see the incomplete beta function
        ends["start"] = potential.pair_energy(START + delta) - LJ.pair_energy(START + delta)
    for off in ends.values():
        assert np.polyfit(np.log(delta), np.log(np.abs(off)), 1)[0] == pytest.approx(power, abs=0.25)  # truncation


def test_the_smooth_switch_is_the_incomplete_beta_function():
    """S(y) = I₁₋ᵧ(8, 8), in y = (r² − r_on²)/(r_c² − r_on²), and −S′(r)/r beside it, of a law that is 1 everywhere."""
    law = TRUNCATIONS["smooth"].around(user_law(lambda r2: (1.0, 0.0)))
    for y in np.linspace(0.0, 1.0, 101):
        s, f = evaluate_law(law, 4.0 + 2.25 * y, (4.0, 6.25))
        assert s == pytest.approx(betainc(8, 8, 1.0 - y), rel=1e-12, abs=1e-100)  # rounding
        assert f == pytest.approx(2.0 / 2.25 * 51480.0 * (y * (1.0 - y)) ** 7, rel=1e-12, abs=1e-100)
    assert [evaluate_law(law, r2, (4.0, 6.25)) for r2 in (3.9, 6.3)] == [(1.0, 0.0), (0.0, 0.0)]


def test_pairs_count_up_to_the_cutoff_scaled_ones_too():
    for distance, expected in ((CUTOFF * (1.0 - 1e-9), 4.0 * (CUTOFF**-12 - CUTOFF**-6)), (CUTOFF * (1.0 + 1e-9), 0.0)):
        found = md.evaluate(md.System([[0, 0, 0], [distance, 0, 0]]), LJ).potential_energy
        assert found == pytest.approx(expected, rel=1e-7)
    far = md.System([[0, 0, 0], [1.2, 0, 0], [2.5, 0, 0]], bonds=[[0, 1], [1, 2]])
    scaled = md.evaluate(far, md.LennardJones(1.0, 1.0, 2.4, "truncated", bonded_scale=(0.0, 0.5, 1.0)))
    assert scaled.potential_energy == 0.0


def energy_error(start, method, timestep, truncation, cutoff, time=1.0):
    """Largest change of the total energy in a time, seen 25 times."""
    simulation = md.Simulation(start.copy(), md.LennardJones(1.0, 1.0, cutoff, truncation), method(timestep))
    n_steps = round(time / timestep)
    energy = simulation.run(n_steps, every=n_steps // 25, progress=False).total_energy
    return np.abs(energy - energy[0]).max()


def droplet(n_cells=3, seed=5):
    """Argon whose atoms leave the lattice within a unit of time."""
    atoms, law = md.System(liquid(n_cells, jitter=0.02).positions), md.LennardJones(1.0, 1.0, CUTOFF, "smooth")
    simulation = md.Simulation(atoms, law, VelocityVerlet(0.004))
    simulation.set_temperature(0.3, seed=seed)
    return simulation.system


@pytest.mark.parametrize(("truncation", "cutoff"), [("truncated", None), ("smooth", CUTOFF)])
@pytest.mark.parametrize("method", TIMESTEPS)
def test_slopes_of_108_atoms_are_the_orders(method, truncation, cutoff):
    start = droplet()
    errors = [energy_error(start, method, TIMESTEPS[method] / k, truncation, cutoff) for k in (1, 2)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.2)  # truncation


@pytest.mark.slow
@pytest.mark.parametrize(("method", "timestep"), [(KahanLi6, 0.005), (KahanLi8, 0.01)])
def test_a_switch_with_two_derivatives_leaves_order_three(method, timestep):
    """Each atom that crosses the kink of u‴ is left with an error of Δt³, whatever the method: too much above order 3.
    Geometric mean over four droplets of 32 atoms."""
    slopes = {}
    for truncation in ("switched", "smooth"):
        both = [(seed, dt) for seed in range(4) for dt in (timestep, timestep / 2)]
        errors = [energy_error(droplet(2, seed), method, dt, truncation, CUTOFF) for seed, dt in both]
        slopes[truncation] = -np.diff(np.log2(errors).reshape(4, 2)).mean()
    assert slopes["switched"] == pytest.approx(3.0, abs=0.6)  # statistics of when a step meets the kink
    assert slopes["smooth"] > method.order - 0.5
    errors = [energy_error(liquid(4, jitter=0.02), KahanLi6, dt, "smooth", CUTOFF, 0.5) for dt in (0.005, 0.0025)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(6.0, abs=0.2)  # truncation; also in a periodic cell
