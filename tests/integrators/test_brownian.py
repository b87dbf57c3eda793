"""Brownian dynamics and Langevin dynamics with long steps: diffusion, harmonic averages, order; restarts, advice."""

import numpy as np
import pytest
from scipy.integrate import quad
from wrong_calls import answered

import minimd as md

T, GAMMA, MASS = 1.3, 4.0, 2.0
test_wrong_calls_are_answered = answered(
    (lambda: md.BrownianDynamics(0.01, 1.0, 0.0, 1), ValueError, "friction", "0.0"),
    (lambda: md.BrownianDynamics(-0.01, 1.0, 1.0, 1), ValueError, "timestep", "-0.01"),
    (lambda: md.grade(md.BrownianDynamics(0.01, 1.0, 1.0, 1)), TypeError, "BrownianDynamics", "inertia"),
)


def trapped(k, timestep, n=5000, temperature=T):
    """Atoms of MASS in traps of their own, u = ½ k r²."""
    method = md.BrownianDynamics(timestep, temperature, friction=GAMMA, seed=1)
    system = md.System(np.zeros((n, 3)), masses=MASS)
    return md.Simulation(system, md.Restraint(k, np.zeros(3)), method)


def test_free_particles_diffuse_as_einstein_says():
    """⟨Δx²⟩ = 2 D t, D = k_B T/(mγ), but for the two ends of the path, which have half their noise."""
    sim = trapped(0.0, 0.01)
    sim.set_temperature(T, seed=2)
    sim.run(100)
    displacement = sim.positions.ravel()
    expected = 2.0 * T / (MASS * GAMMA) * 0.01 * (100 - 0.5)
    assert np.square(displacement).mean() == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / displacement.size))
    assert sim.temperature == pytest.approx(T, rel=4.0 * np.sqrt(2.0 / displacement.size))
    assert np.ptp(sim.record.conserved_energy) < 1e-9  # rounding of the kinetic energy of 5000 atoms


@pytest.mark.parametrize("phase", [0.1, 1.0, 1.8])  # ω² Δt/γ; unstable from 2 on
def test_a_harmonic_average_is_exact_at_any_stable_step(phase):
    k = 4.0
    sim, squares = trapped(k, phase * GAMMA * MASS / k), []
    sim.set_temperature(T, seed=2)
    sim.run(60 if phase > 0.5 else 200)
    sim.run(200, every=20, observers=[lambda sim: squares.append(np.square(sim.positions).mean())])
    assert np.mean(squares) * k / T == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 15_000 / 4))  # statistics
    assert abs(sim.report().mean_temperature - T) < 4.0 * sim.report().temperature_error


def test_beyond_the_limit_it_blows_up_and_says_at_which_step_it_does_not():
    sim = trapped(4.0, 2.5 * GAMMA * MASS / 4.0, n=50)
    sim.set_temperature(T, seed=2)
    with pytest.raises(md.NonFiniteError, match=r"stable up to 4 τ"):
        sim.run(2000)
    assert md.advise_timestep(sim.system, sim.potentials, method=sim.method).limit == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize("phase", [0.3, 1.0])  # γΔt
@pytest.mark.parametrize("method", [md.LangevinGJF, md.LangevinBAOAB])
def test_diffusion_and_harmonic_averages_of_langevin_methods(method, phase):
    """N. Grønbech-Jensen, O. Farago (2013): their method has Einstein's D at any step, and both have the exact ⟨x²⟩.
    The slope of ⟨Δx²⟩ is taken where velocities have forgotten themselves."""
    n, k, timestep = 5000, 4.0, phase / GAMMA
    at_rest, origin = md.System(np.zeros((n, 3)), masses=MASS), np.zeros(3)
    free = md.Simulation(at_rest.copy(), md.Restraint(0.0, origin), method(timestep, T, GAMMA, seed=1))
    free.set_temperature(T, seed=2)
    squares = []
    free.run(120, every=40, observers=[lambda sim: squares.append(np.square(sim.positions).mean())])
    measured = (squares[3] - squares[1]) / (2.0 * 80 * timestep) * MASS * GAMMA / T
    half = 0.5 * phase
    expected = 1.0 if method is md.LangevinGJF else half / np.tanh(half)
    assert measured == pytest.approx(expected, abs=4.0 * 1.5 * np.sqrt(2.0 / (3 * n)))  # ends of paths correlate
    well = md.Simulation(at_rest.copy(), md.Restraint(k, origin), method(1.0, T, GAMMA, seed=1))
    well.set_temperature(T, seed=2)
    well.run(40)
    inside = []
    well.run(200, every=20, observers=[lambda sim: inside.append(np.square(sim.positions).mean())])
    assert np.mean(inside) * k / T == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (3 * n) / 4))


def quartic_average(timestep, n, n_steps):
    """⟨x²⟩ in u = x⁴/4 + y²/2 + z²/2, and its error by the atoms, which are independent."""
    well = md.Field(lambda x, y, z, t: (0.25 * x**4 + 0.5 * y * y + 0.5 * z * z, -(x**3), -y, -z))
    method = md.BrownianDynamics(timestep, 1.0, friction=1.0, seed=5)
    sim, sums = md.Simulation(md.System(np.zeros((n, 3))), well, method), np.zeros(n)
    sim.set_temperature(1.0, seed=2)
    sim.make_steps(40)
    count = 0
    for _ in range(n_steps):
        sim.make_steps(1)
        sums += sim.positions[:, 0] ** 2
        count += 1
    means = sums / count
    return means.mean(), means.std() / np.sqrt(n)


@pytest.mark.slow
def test_averages_have_order_2():
    """Errors at Δt = 0.2 and 0.1 beside those of order 1, which would be 0.05 and more at Δt = 0.1."""
    weight = lambda x: np.exp(-0.25 * x**4)  # noqa: E731
    exact = quad(lambda x: x * x * weight(x), 0.0, 9.0)[0] / quad(weight, 0.0, 9.0)[0]
    (coarse, its_error), (fine, other_error) = (quartic_average(h, 100_000, 300) for h in (0.2, 0.1))
    assert max(its_error, other_error) < 1e-3
    assert abs(coarse - exact) > 5.0 * its_error
    assert (coarse - exact) / (fine - exact) == pytest.approx(4.0, rel=0.5)
    assert abs(fine - exact) < 0.01


def liquid():
    positions, edges = md.lattice.crystal("fcc", [4, 4, 4], 1.7)
    method = md.BrownianDynamics(2e-4, md.Ramp(1.0, 2.0, 200), friction=5.0, seed=4)
    sim = md.Simulation(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, cutoff=2.5), method)
    sim.set_temperature(1.0, seed=2)
    return sim


def test_a_resumed_liquid_has_the_bits_of_one_that_was_not_interrupted(tmp_path):
    """The noise of the next step is in the velocities."""
    whole = liquid()
    whole.run(160)
    part = liquid()
    part.run(70, trajectory=tmp_path / "a.h5md")
    again = md.Simulation.resume(tmp_path / "a.h5md", part.potentials)
    assert type(again.method) is md.BrownianDynamics
    again.run(until_step=160)
    assert again.positions.tobytes() == whole.positions.tobytes()
    assert whole.time == pytest.approx(160 * 2e-4)


def test_pressure_and_energy_are_those_of_langevin_dynamics():
    """A fluid at T* = 1.5, ρ* = 0.5 by both; the means within 4 standard errors."""
    results = []
    positions, edges = md.lattice.crystal("fcc", [4, 4, 4], 2.0)
    for method in (
        md.BrownianDynamics(1e-3, 1.5, friction=2.0, seed=1),
        md.LangevinBAOAB(0.005, 1.5, friction=2.0, seed=1),
    ):
        sim = md.Simulation(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, cutoff=2.5), method)
        sim.set_temperature(1.5, seed=2)
        sim.run(2000)
        sim.run(6000, every=10)
        record = sim.record
        results.append([md.mean_and_error(series) for series in (record.potential_energy, record.pressure)])
    for (mean, error), (other, its) in zip(*results, strict=True):
        assert abs(mean - other) < 4.0 * np.hypot(error, its)
