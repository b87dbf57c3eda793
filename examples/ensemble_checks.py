"""Is it the right ensemble? physical_validation judges runs of liquid argon (P. T. Merz, M. R. Shirts, 2018).

Without a bath the oscillation of the energy must be ∝ Δt². With a bath, kinetic energies must be gamma distributed, and
the energy distributions of runs at two temperatures must differ by Boltzmann's factor. PLOS ONE 13, e0202764.
Needs: pip install '.[validation]'"""

import matplotlib.pyplot as plt
import numpy as np
import physical_validation as pv
from scipy.stats import gamma

import minimd as md

ASE, fs = md.units.ASE, md.units.fs
temperatures = np.array([94.4, 100.0])  # K
n_melting, n_production, every = 5000, 50_000, 25
in_kj_mol_nm_ps_bar = 96.485, 0.1, 1e-3, 1.0, 1.602e6, 1e-3 / fs  # values of 1 eV, Å, Å³, K, eV/Å³, Å √(u/eV)
units = pv.data.UnitData(ASE.k_B, *in_kj_mol_nm_ps_bar)
argon = md.LennardJones(120 * ASE.k_B, 3.4, 8.0, "smooth")
positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 5.78)
n = len(positions)
melt = md.Simulation(md.System(positions, masses=39.948, cell=edges, units=ASE), argon, md.VelocityVerlet(8 * fs))
melt.set_temperature(2 * temperatures[0], seed=1)
melt.equilibrate(n_melting, temperatures[0])


def run(method, temperature, n_steps, every):
    """A simulation after its run, and its data for physical_validation."""
    liquid = md.Simulation(melt.system, argon, method)
    record = liquid.run(n_steps, every=every)
    kinetic, potential, total = record.kinetic_energy, record.potential_energy, record.total_energy
    each = {"mass": np.full(n, 39.948), "molecule_idx": np.arange(n), "nconstraints_per_molecule": np.zeros(n)}
    lost = {"nconstraints": 0, "ndof_reduction_tra": 3 * n - liquid.n_dof, "ndof_reduction_rot": 0}
    system = pv.data.SystemData(natoms=n, **lost, **each)
    kind, size = "NVT" if method.is_thermostat else "NVE", {"natoms": n, "volume": edges.prod()}
    ensemble = pv.data.EnsembleData(kind, temperature=temperature, **size)
    observed = pv.data.ObservableData(kinetic, potential, total, constant_of_motion=total)
    return liquid, pv.data.SimulationData(units, method.timestep, system, ensemble, observed)


free = [run(md.VelocityVerlet(step * fs), 94.4, round(8000 / step), 1)[1] for step in (16, 8, 4)]
worst = pv.integrator.convergence(free, verbose=False)
print(f"without a bath the energy falls with Δt² but for {worst:.3f}   (expected: near 0)")
baths = [md.LangevinBAOAB(8 * fs, T, friction=1 / (500 * fs), seed=k) for k, T in enumerate(temperatures)]
runs = [run(bath, T, n_production, every) for bath, T in zip(baths, temperatures, strict=True)]
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for (liquid, data), temperature, color in zip(runs, temperatures, ("tab:blue", "tab:red"), strict=True):
    off = pv.kinetic_energy.distribution(data, strict=False, verbosity=0, bootstrap_seed=1)
    print(
        f"{temperature} K: mean and width of K off by {off[0]:.1f}, {off[1]:.1f} standard errors   (expected: below 3)"
    )
    kinetic = liquid.record.kinetic_energy / (ASE.k_B * temperature)
    axes.hist(kinetic, 40, density=True, alpha=0.4, color=color, label=f"{temperature} K")
    x = np.linspace(kinetic.min(), kinetic.max(), 200)
    axes.plot(x, gamma.pdf(x, 0.5 * liquid.n_dof), color=color)
(off,) = pv.ensemble.check(*(data for _, data in runs), verbosity=0, bootstrap_seed=1)
print(f"the two ensembles overlap as they should but for {off:.1f} standard errors   (expected: below 3)")
axes.set(xlabel="kinetic energy / k_B T", ylabel="probability density", title="108 argon atoms in a Langevin bath")
axes.legend()
figure.savefig("ensemble_checks.png", dpi=150)
