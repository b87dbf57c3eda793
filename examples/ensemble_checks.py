"""Is it the right ensemble? physical_validation judges runs of liquid argon: P. T. Merz, M. R. Shirts, PLOS ONE 13, e0202764 (2018).

Without a bath the oscillation of the energy must be ∝ Δt². With one, kinetic energies must be gamma distributed, and runs at two
temperatures must overlap as Boltzmann's factor says. Needs: pip install '.[validation]'
"""

import matplotlib.pyplot as plt
import numpy as np
import physical_validation
from physical_validation.data import EnsembleData, ObservableData, SimulationData, SystemData, UnitData
from scipy.stats import gamma

import minimd as md

ASE, fs = md.units.ASE, md.units.fs
temperatures = np.array([94.4, 100.0])  # K
n_melting, n_production, every = 5000, 50_000, 25
units = UnitData(
    ASE.k_B, 96.485, 0.1, 1e-3, 1.0, 1.602e6, 1e-3 / fs
)  # what eV, Å, Å³, K, eV/Å³, Å √(u/eV) are in kJ/mol, nm, ps, bar
argon = md.LennardJones(120 * ASE.k_B, 3.4, 8.0, "smooth")
positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 5.78)
n_atoms = len(positions)
melt = md.Simulation(md.System(positions, masses=39.948, cell=edges, units=ASE), argon, md.VelocityVerlet(8 * fs))
melt.set_temperature(2 * temperatures[0], seed=1)
melt.equilibrate(n_melting, temperatures[0])
start = melt.system


def run(method, temperature, n_steps, every):
    """A simulation after its run, and the same for physical_validation."""
    liquid = md.Simulation(start, argon, method)
    record = liquid.run(n_steps, every=every)
    atoms = {
        "mass": np.full(n_atoms, 39.948),
        "molecule_idx": np.arange(n_atoms),
        "nconstraints_per_molecule": np.zeros(n_atoms),
    }
    return liquid, SimulationData(
        units=units,
        dt=method.timestep,
        system=SystemData(
            natoms=n_atoms, nconstraints=0, ndof_reduction_tra=3 * n_atoms - liquid.n_dof, ndof_reduction_rot=0, **atoms
        ),
        ensemble=EnsembleData(
            "NVT" if method.is_thermostat else "NVE", natoms=n_atoms, volume=edges.prod(), temperature=temperature
        ),
        observables=ObservableData(
            record.kinetic_energy, record.potential_energy, record.total_energy, constant_of_motion=record.total_energy
        ),
    )


free = [run(md.VelocityVerlet(step * fs), 94.4, round(8000 / step), 1)[1] for step in (16, 8, 4)]
worst = physical_validation.integrator.convergence(free, verbose=False)
print(f"without a bath the energy falls with Δt² but for {worst:.3f}   (expected: near 0)")
baths = [
    run(md.LangevinBAOAB(8 * fs, T, friction=1 / (500 * fs), seed=k), T, n_production, every)
    for k, T in enumerate(temperatures)
]
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for (liquid, data), temperature, color in zip(baths, temperatures, ("tab:blue", "tab:red"), strict=True):
    mean, width = physical_validation.kinetic_energy.distribution(data, strict=False, verbosity=0, bootstrap_seed=1)
    print(
        f"{temperature} K: mean and width of the kinetic energy are off by {mean:.1f} and {width:.1f} standard errors   (expected: below 3)"
    )
    kinetic = liquid.record.kinetic_energy / (ASE.k_B * temperature)
    axes.hist(kinetic, 40, density=True, alpha=0.4, color=color, label=f"{temperature} K")
    x = np.linspace(kinetic.min(), kinetic.max(), 200)
    axes.plot(x, gamma.pdf(x, 0.5 * liquid.n_dof), color=color)
(off,) = physical_validation.ensemble.check(*(data for _, data in baths), verbosity=0, bootstrap_seed=1)
print(f"the two ensembles overlap as they should but for {off:.1f} standard errors   (expected: below 3)")
axes.set(
    xlabel="kinetic energy / k_B T",
    ylabel="probability density",
    title="108 argon atoms under Langevin dynamics, and the gamma distribution",
)
axes.legend()
figure.savefig("ensemble_checks.png", dpi=150)
