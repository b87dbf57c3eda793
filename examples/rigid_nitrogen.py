"""Liquid nitrogen of rigid molecules: does a longer time step affect the energy or the bonds?

ASE builds the molecules with FixBondLengths, which minimd reads. Two-center Lennard-Jones model of P. S. Y. Cheung and
J. G. Powles, Mol. Phys. 30, 921 (1975). Bonds are kept to rounding at any time step. The error of the energy grows with
the square of the time step.
"""

import matplotlib.pyplot as plt
import numpy as np
from ase import Atoms
from ase.constraints import FixBondLengths

import minimd as md

density, temperature, bond = 0.808 * md.units.GRAM_PER_CM3, 77.0, 1.0897  # u/Å³, K, Å
n_equilibration, duration = 2000, 800  # steps, fs
timesteps = [2, 4, 8, 16]  # fs
kelvin, fs = md.units.ASE.k_B, md.units.fs

centers, edges = md.lattice.crystal("fcc", [3, 3, 3], md.lattice.constant_from_density("fcc", density, 2 * 14.007))
arms = 0.5 * bond * np.random.default_rng(1).choice([-1.0, 1.0], centers.shape) / np.sqrt(3.0)
positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
pairs = np.arange(len(positions)).reshape(-1, 2)
molecules = Atoms(f"N{len(positions)}", positions, cell=edges, pbc=True, constraint=FixBondLengths(pairs))

law = md.LennardJones(37.3 * kelvin, 3.31, cutoff=8.0, truncation="smooth", bonded_scale=(0, 1, 1))
start = md.Simulation(md.System.from_ase(molecules, bonds=pairs), law, md.VelocityVerlet(4 * fs))
start.set_temperature(temperature, seed=1)
start.equilibrate(n_equilibration, temperature)

energies, bonds, shares = [], [], []
for timestep in timesteps:
    simulation = md.Simulation(start.system, law, md.VelocityVerlet(timestep * fs))
    record = simulation.run(duration // timestep, every=1)
    energies.append(record.total_energy.std() / len(pairs) / kelvin)
    bonds.append(record.constraint_violation.max())
    turning = simulation.velocities[pairs[:, 1]] - simulation.velocities[pairs[:, 0]]
    shares.append(0.25 * 14.007 * np.sum(turning**2) / record.kinetic_energy[-1])
slope = np.polyfit(np.log(timesteps), np.log(energies), 1)[0]

figure, panel = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
panel.loglog(timesteps, energies, "o-", label="total energy, rms fluctuation / K per molecule")
panel.loglog(timesteps, bonds, "s-", label="bonds, largest $|r^2-d^2|/d^2$")
panel.set(
    xlabel="time step / fs",
    xticks=timesteps,
    xticklabels=timesteps,
    title=f"{len(pairs)} rigid nitrogen molecules, {duration} fs",
)
panel.minorticks_off()
panel.legend()
figure.savefig("rigid_nitrogen.png", dpi=150)
print(f"energy fluctuates as the time step to the power {slope:.2f}   (velocity Verlet: 2)")
print(f"bonds are off by at most {max(bonds):.0e} of their square   (rounding: 1e-14)")
print(f"share of the rotation in the kinetic energy {np.mean(shares):.2f}   (equipartition: 2 of 5, 0.40)")
