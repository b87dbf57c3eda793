"""The Lennard-Jones melt in float64 and in fixed-point arithmetic: how exact are forces, does the energy drift?

Reduced units. The reference is the same sum over pairs in extended precision, if the machine has it.
"""

import matplotlib.pyplot as plt
import numpy as np
from ase.build import bulk

import minimd as md

density, temperature, cutoff = 0.8442, 1.44, 2.5  # σ⁻³, ε/k_B, σ
timestep, every = 0.002, 20  # τ
n_equilibration, n_steps = 2000, 20_000

crystal = bulk("X", "fcc", (4.0 / density) ** (1 / 3), cubic=True).repeat(10)
law = md.LennardJones(1.0, 1.0, cutoff, truncation="force-shifted")
melt = md.Simulation(md.System(crystal.positions, cell=crystal.cell.array), law, md.VelocityVerlet(timestep))
melt.set_temperature(temperature, seed=1)
melt.equilibrate(n_equilibration, temperature)


def force(r):  # −u′(r)
    return 24.0 * (2.0 * r**-13 - r**-7)


i, j, image = md.neighbor_list("ijS", melt.system, cutoff)
exact = melt.positions.astype(np.longdouble)
separation = exact[j] - exact[i] + image @ melt.system.cell.vectors.astype(np.longdouble)
r = np.sqrt((separation**2).sum(axis=1))
reference = np.zeros_like(exact)
np.add.at(reference, i, -((force(r) - force(np.longdouble(cutoff))) / r)[:, None] * separation)
largest = np.linalg.norm(reference, axis=1).max()

figure, panel = plt.subplots(figsize=(6, 4), layout="constrained")
for precision in ("double", "fixed-point"):
    run = md.Simulation(melt.system, law, md.VelocityVerlet(timestep), precision=precision)
    run.run(0)
    errors = np.linalg.norm(run.forces - reference, axis=1) / largest
    record = run.run(n_steps, every=every)
    drift, change = run.report().energy_drift, run.report().momentum_change
    print(precision)
    rms, slope = np.sqrt(np.mean(errors**2)), f"{drift.slope:+.1e} ± {drift.error:.1e} ε per atom per τ"
    print(f"    error of the forces   rms {rms:.1e}, largest {errors.max():.1e}, of the largest force")
    print(f"    drift of the energy   {slope}   (expected: zero within its error)")
    print(f"    change of momentum    {change:.1e} of the sum of |mv|   (expected: some 1e-16; zero in fixed-point)")
    panel.hist(np.log10(errors), bins=60, alpha=0.6, label=precision)
panel.set(xlabel="log₁₀ of the error of a force, over the largest force", ylabel="atoms")
panel.legend(frameon=False)
figure.savefig("precision.png", dpi=150)
