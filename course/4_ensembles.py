"""
4. Ensembles
============

Without a bath the energy is constant and the temperature fluctuates; in a bath it is the other way round, and both
fluctuate as statistical mechanics says. Here are 108 atoms of argon alone, in two good baths, and in one that only
looks like a bath.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import minimd as md

kelvin, fs = md.units.ASE.k_B, md.units.fs
temperature, timestep = 94.4, 5.0 * fs
every = 10
n_equilibration = 3000
n_steps = 30_000

positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 5.78)
argon = md.System(positions, masses=39.948, cell=edges, units=md.units.ASE)
law = md.LennardJones(120.0 * kelvin, 3.4, cutoff=8.0, truncation="switched")

# %%
# The baths
# ---------
# Langevin dynamics pushes and brakes each atom; stochastic velocity rescaling acts on the kinetic energy of all at
# once. Both draw random numbers, and must.

methods = {
    "alone": md.VelocityVerlet(timestep),
    "Langevin": md.LangevinBAOAB(timestep, temperature, friction=1.0 / (500.0 * fs), seed=1),
    "rescaling": md.StochasticVelocityRescaling(timestep, temperature, relaxation_time=200.0 * fs, seed=1),
}
kinetic, total, potential = {}, {}, {}
for name, method in methods.items():
    simulation = md.Simulation(argon, law, method)
    simulation.set_temperature(2.0 * temperature, seed=2)
    simulation.equilibrate(n_equilibration, temperature)
    record = simulation.run(n_steps, every=every, progress=False)
    kinetic[name], total[name], potential[name] = record.kinetic_energy, record.total_energy, record.potential_energy
    warm = record.temperature
    print(
        f"{name:10} T = {warm.mean():6.1f} ± {warm.std():4.1f} K, energy ± {record.total_energy.std() / kelvin:8.2f} K"
    )

n_dof = simulation.n_dof
print(
    f"expected in a bath: T ± {temperature * np.sqrt(2.0 / n_dof):.1f} K   (√(2/n) T, n = {n_dof} degrees of freedom)"
)

# %%
# The distribution of the kinetic energy
# --------------------------------------
# In the canonical ensemble K/k_BT is gamma distributed, whatever the forces are. Without a bath its distribution is
# narrower: what the kinetic energy gains, the potential energy must lose, and it has less to give than a bath.

figure, panels = plt.subplots(1, 3, figsize=(11.0, 3.6), layout="constrained", sharey=True)
expected = stats.gamma(n_dof / 2.0)
grid = np.linspace(*expected.ppf([1e-5, 1.0 - 1e-5]), 200)
for panel, (name, energies) in zip(panels, kinetic.items(), strict=True):
    mean = kelvin * temperature if name != "alone" else 2.0 * energies.mean() / n_dof
    panel.hist(energies / mean, bins=40, density=True, color="0.8")
    panel.plot(grid, expected.pdf(grid), "C3")
    panel.set(title=name, xlabel="K / k_B T")
figure.savefig("4_ensembles.png", dpi=150)

# %%
# Heat capacity, twice
# --------------------
# In a bath the variance of the energy is k_B T² C. Without one, that of the kinetic energy gives C: ⟨δK²⟩ = (n/2)(k_B
# T)² (1 − n k_B/2C) (J. L. Lebowitz, J. K. Percus, L. Verlet, Phys. Rev. 153, 250 (1967)).

n_atoms = len(argon)
for name in ("Langevin", "rescaling"):
    capacity = total[name].var() / (kelvin * temperature**2) / (n_atoms * kelvin)
    print(f"{name:10} C/N = {capacity:.2f} k_B   (liquid argon near its triple point: 2.3 to 2.5)")
t = 2.0 * kinetic["alone"].mean() / n_dof
capacity = (n_dof / 2.0) / (1.0 - kinetic["alone"].var() / (n_dof / 2.0 * t**2)) / n_atoms
print(f"alone      C/N = {capacity:.2f} k_B   (the same, from the kinetic energy)")

# %%
# What is not a bath
# ------------------
# Velocities that are rescaled to the same temperature in every step give the right mean and no fluctuation at all.
# Nothing in a picture of the atoms shows it; ``md.grade`` does, because the step is neither reversible nor a solution
# of Newton's equation.


def rescaled(x, v, force, m, dt):
    """Velocity Verlet, then all velocities times a factor."""
    m = m[:, None]
    v = v + 0.5 * dt * force(x) / m
    x = x + dt * v
    v = v + 0.5 * dt * force(x) / m
    now = np.sum(m * v**2) / v.size
    return x, v * np.sqrt(0.4 / now)


print(md.grade(rescaled))

# %%
# Tasks
# -----
# 1. Which friction is too weak for the kinetic energy to be canonical within this run, and which is so strong that
#    the atoms hardly diffuse?
# 2. Write Langevin's step yourself, with ``np.random``. Why can ``md.grade`` not judge it?
# 3. Compare the histogram of the potential energy in both baths. Must they agree?
# 4. Take a time step of 20 fs. The kinetic temperature of Langevin dynamics is off by O(Δt²), where configurations
#    are far better: see ``examples/thermostats.py``.
# 5. Estimate the error of C from blocks of the run. How long must it be for two digits?
