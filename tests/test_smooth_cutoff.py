"""A cutoff smooth enough for methods of high order: as smooth as it says, and what less smooth ones do to the order."""

import numpy as np
import pytest
from references import liquid
from scipy.special import betainc

import minimd as md
from minimd.integrators import BlanesMoan4, KahanLi6, KahanLi8, Ruth3, VelocityVerlet
from minimd.potentials.law import evaluate_law
from minimd.potentials.truncation import TRUNCATIONS
from minimd.potentials.user_laws import user_law

TIMESTEPS = {
    VelocityVerlet: 0.004,
    Ruth3: 0.004,
    BlanesMoan4: 0.008,
    KahanLi6: 0.01,
    KahanLi8: 0.02,
}  # errors above rounding, below 1e-2 ε


def one(r2):
    """u = 1 everywhere: what is left is the switch."""
    return 1.0, 0.0


def test_the_switch_is_the_incomplete_beta_function():
    """S(y) = I₁₋ᵧ(8, 8), in y = (r² − r_on²)/(r_c² − r_on²), and −S′(r)/r beside it."""
    law = TRUNCATIONS["smooth"].around(user_law(one))
    for y in np.linspace(0.0, 1.0, 101):
        s, f = evaluate_law(law, 4.0 + 2.25 * y, (4.0, 6.25))
        assert s == pytest.approx(betainc(8, 8, 1.0 - y), rel=1e-12, abs=1e-100)  # rounding
        assert f == pytest.approx(2.0 / 2.25 * 51480.0 * (y * (1.0 - y)) ** 7, rel=1e-12, abs=1e-100)
    assert [evaluate_law(law, r2, (4.0, 6.25)) for r2 in (3.9, 6.3)] == [(1.0, 0.0), (0.0, 0.0)]


@pytest.mark.parametrize(("truncation", "power"), [("smooth", 8), ("switched", 3), ("charmm", 2)])
def test_switches_leave_the_law_and_reach_zero_as_flat_as_they_promise(truncation, power):
    """Within δ of either end the energy is off by δ^(k + 1) where k derivatives are continuous: seven, two, one."""
    potential = md.LennardJones(1.0, 1.0, 2.5, truncation, switch_start=2.0)
    law = md.LennardJones(1.0, 1.0, 2.5, "truncated")
    delta = 0.02 / 1.3 ** np.arange(3)
    ends = {"cutoff": potential.pair_energy(2.5 - delta)}
    if truncation != "smooth":  # there the difference drowns in rounding, but see the incomplete beta function
        ends["start"] = potential.pair_energy(2.0 + delta) - law.pair_energy(2.0 + delta)
    for off in ends.values():
        assert np.polyfit(np.log(delta), np.log(np.abs(off)), 1)[0] == pytest.approx(power, abs=0.25)  # truncation


def energy_error(method, timestep, truncation, cutoff, n_cells=3, seed=5):
    """Largest change of the total energy of an argon droplet in one unit of time, in which its atoms leave the lattice."""
    droplet = md.System(liquid(n_cells, jitter=0.02).positions)
    simulation = md.Simulation(droplet, md.LennardJones(1.0, 1.0, cutoff, truncation), method(timestep))
    simulation.set_temperature(0.3, seed=seed)
    n_steps = round(1.0 / timestep)
    energy = simulation.run(n_steps, every=n_steps // 25).total_energy
    return np.abs(energy - energy[0]).max()


def slope(method, timestep, truncation, cutoff):
    """Of the energy error against the time step; geometric mean over four droplets of 32 atoms."""
    errors = [
        [energy_error(method, dt, truncation, cutoff, 2, seed) for dt in (timestep, timestep / 2)] for seed in range(4)
    ]
    return -np.diff(np.log2(errors)).mean()


@pytest.mark.parametrize(("truncation", "cutoff"), [("truncated", None), ("smooth", 2.5)])
@pytest.mark.parametrize("method", TIMESTEPS)
def test_slopes_of_108_atoms_are_the_orders(method, truncation, cutoff):
    errors = [energy_error(method, TIMESTEPS[method] / k, truncation, cutoff) for k in (1, 2)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.2)  # truncation


@pytest.mark.parametrize(("method", "timestep"), [(KahanLi6, 0.005), (KahanLi8, 0.01)])
def test_a_switch_with_two_derivatives_leaves_order_three(method, timestep):
    """Each atom that crosses the kink of u‴ is left with an error of Δt³, whatever the method: too much above order 3."""
    assert slope(method, timestep, "switched", 2.5) == pytest.approx(
        3.0, abs=0.6
    )  # statistics of when a step meets the kink
    assert slope(method, timestep, "smooth", 2.5) > method.order - 0.5


def test_a_liquid_in_a_periodic_cell_keeps_the_order_too():
    errors = []
    for timestep in (0.005, 0.0025):
        simulation = md.Simulation(liquid(4, jitter=0.02), md.LennardJones(1.0, 1.0, 2.5, "smooth"), KahanLi6(timestep))
        energy = simulation.run(round(0.5 / timestep), every=round(0.02 / timestep)).total_energy
        errors.append(np.abs(energy - energy[0]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(6.0, abs=0.2)  # truncation
