"""Liquid nitrogen with rigid bonds and with springs: how much longer a time step do rigid bonds allow?

Two-center Lennard-Jones molecules: P. S. Y. Cheung, J. G. Powles, Mol. Phys. 30, 921 (1975). The spring vibrates at
2359 cm⁻¹: no step longer than 2/ω = 4.5 fs is stable. With rigid bonds only the liquid limits the step. The script
measures the oscillation of the total energy over a picosecond, in k_B T √(degrees of freedom)."""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

ASE, fs = md.units.ASE, md.units.fs
warnings.filterwarnings("ignore", message="timestep")  # too long steps are tested here
temperature, length, mass = 77.0, 1.098, 14.007  # K, Å, u
omega = 2.0 * np.pi * 2.99792458e-5 * 2359.0 / fs  # c = 2.998e-5 cm/fs
stiffness = 0.5 * mass * omega**2  # eV/Å²: reduced mass · ω²
n_equilibration, duration, n_cells = 4000, 1000.0, 4  # steps of 0.5 fs; fs; 256 molecules
timesteps = "0.5 0.7 1.0 1.4 2.0 2.8 3.4 4.0 4.4 4.7 5.6 8.0 11.0 16.0 22.0 32.0 44.0 60.0"  # fs
timesteps = np.array(timesteps.split(), dtype=float)

centers, edges = md.lattice.crystal("fcc", [n_cells] * 3, 6.13)  # 0.807 g/cm³
arms = 0.5 * length / np.sqrt(3.0) * np.random.default_rng(1).choice([-1.0, 1.0], centers.shape)
positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
pairs = np.arange(2 * len(centers)).reshape(-1, 2)
start = md.System(positions, cell=edges, masses=mass, species=["N"] * len(positions), bonds=pairs, units=ASE)
nitrogen = md.LennardJones(37.3 * ASE.k_B, 3.31, cutoff=10.0, truncation="smooth", bonded_scale=(0.0, 1.0, 1.0))
rigid, spring = md.DistanceConstraints(pairs, length), md.HarmonicBond(stiffness, length)


def oscillation(liquid, timestep):
    """Standard deviation of the total energy, in k_B T √n_dof; infinite if the run fails."""
    run = md.Simulation(liquid.system, liquid.potentials, md.VelocityVerlet(timestep * fs), liquid.constraints)
    try:
        energy = run.run(round(duration / timestep), every=1, progress=False).total_energy
    except (md.NonFiniteError, md.ConstraintError):
        return np.inf
    return energy.std() / (ASE.k_B * temperature * np.sqrt(run.n_dof))


curves = {}
for name, potentials, constraints in (("springs", [nitrogen, spring], ()), ("rigid bonds", [nitrogen], rigid)):
    liquid = md.Simulation(start, potentials, md.VelocityVerlet(0.5 * fs), constraints)
    liquid.set_temperature(temperature, seed=2)
    liquid.equilibrate(n_equilibration, temperature)
    curves[name] = np.array([oscillation(liquid, timestep) for timestep in timesteps])
    stable = timesteps[np.isfinite(curves[name])].max()
    print(f"{name:12s} largest stable of these steps {stable:g} fs   (2/ω of the spring: {2.0 / omega / fs:.2f} fs)")

plt.figure(figsize=(7, 4), layout="constrained")
for name, curve in curves.items():
    plt.loglog(timesteps[curve < 1.0], curve[curve < 1.0], "o-", label=name)
at, fine = np.interp(1.0, timesteps, curves["springs"]), curves["rigid bonds"] < 1.0
equal = np.exp(np.interp(np.log(at), np.log(curves["rigid bonds"][fine]), np.log(timesteps[fine])))
print(f"energy with springs at 1 fs oscillates by {at:.1e}, with rigid bonds so much at {equal:.1f} fs")
plt.axvline(2.0 / omega / fs, color="gray", ls=":", label="2/ω of the spring")
plt.gca().set(xlabel="time step / fs", ylabel="oscillation of the energy / k_B T √n")
plt.legend()
plt.savefig("timestep_gain.png", dpi=150)
