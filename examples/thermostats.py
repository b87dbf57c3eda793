"""Argon in a heat bath: is its kinetic energy distributed canonically, and what error has a large time step?

Langevin dynamics acts on each atom, stochastic velocity rescaling on all atoms at once. Both must give a gamma
distribution. A harmonic oscillator at ωΔt = 1.5, near the limit of stability, shows the advantage of BAOAB: its
positions have the exact distribution.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import minimd as md
from minimd.integrators import Bath, State, Surroundings

n_cells, lattice_constant, temperature, seed = 3, 5.78, 94.4, 1  # 108 atoms at Rahman's density [Å, K]
n_equilibration, n_steps, every = 5_000, 40_000, 20
kelvin, fs = md.units.ASE.k_B, md.units.fs  # k_B · 1 K, 1 fs in eV and Å √(u/eV)

positions, edges = md.lattice.crystal("fcc", [n_cells] * 3, lattice_constant)
argon = md.System(positions, masses=39.948, cell=edges, units=md.units.ASE)
law = md.LennardJones(120 * kelvin, 3.4, cutoff=8.0, truncation="switched")
langevin = md.LangevinBAOAB(5 * fs, temperature, friction=1 / (500 * fs), seed=seed)
rescaling = md.StochasticVelocityRescaling(5 * fs, temperature, relaxation_time=200 * fs, seed=seed)

figure, panels = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained", sharey=True)
for panel, method in zip(panels, (langevin, rescaling), strict=True):
    simulation = md.Simulation(argon, law, method)
    simulation.set_temperature(2 * temperature, seed=seed)  # half of it goes into the melting crystal
    simulation.run(n_equilibration, every=n_equilibration)
    kinetic = simulation.run(n_steps, every=every).kinetic_energy / (kelvin * temperature)
    expected = stats.gamma(simulation.n_dof / 2)
    found, exact = (f"{one.mean():6.2f} ± {one.std():5.2f}" for one in (kinetic, expected))
    print(f"{method.name:30s} K / k_B T = {found}   ({exact})")
    grid = np.linspace(*expected.ppf([1e-4, 1 - 1e-4]), 200)
    panel.hist(kinetic, bins=40, density=True, color="0.8", label=f"{len(kinetic)} frames")
    panel.plot(grid, expected.pdf(grid), color="C3", label=f"gamma, {simulation.n_dof} degrees of freedom")
    panel.set(xlabel="kinetic energy / $k_B T$", title=method.name)
    panel.legend(frameon=False, fontsize=8, loc="upper left")
panels[0].set_ylabel("probability density")
panels[0].set_ylim(top=1.15 * panels[0].get_ylim()[1])
figure.savefig("thermostats.png", dpi=150)

n_oscillators, omega = 2000, 1.5  # of unit mass, with Δt = 1 and k_B T = 1
q, v = np.random.default_rng(seed).standard_normal((2, n_oscillators, 3))
state = State(q / omega, v, np.zeros_like(q), np.ones(n_oscillators))
around = Surroundings(bath=Bath(n_dof=3 * n_oscillators))
method, squares = md.LangevinBAOAB(1.0, temperature=1.0, friction=1.0, seed=seed), []


def springs(state, with_energy):
    state.forces[:] = -(omega**2) * state.positions


for _ in range(100):
    method.advance(state, springs, 5, surroundings=around)
    squares.append([(state.positions**2).mean(), (state.velocities**2).mean()])
q2, v2 = np.mean(squares[20:], axis=0)
print(f"oscillator at ωΔt = {omega}: ω²⟨q²⟩/k_B T = {omega**2 * q2:.3f}   (1, exactly)")
print(f"                          ⟨v²⟩/k_B T = {v2:.3f}   ({1 - omega**2 / 4:.3f})")
