"""Liquid argon and krypton, one to one: does a mixing rule make unlike neighbors sit at the mean distance?

Lorentz-Berthelot: σ₁₂ = (σ₁ + σ₂)/2, ε₁₂ = √(ε₁ ε₂). Neighbors in a dense liquid are a little closer than the minimum
of their pair potential, 2^(1/6) σ₁₂, because the other atoms press them together.
"""

import matplotlib.pyplot as plt
import numpy as np
from ase.build import bulk

import minimd as md

ASE, fs = md.units.ASE, md.units.fs
temperature = 130.0  # K
parameters = {"Ar": (120.0 * ASE.k_B, 3.40), "Kr": (164.0 * ASE.k_B, 3.65)}  # ε [eV], σ [Å]
n_equilibration, n_steps = 1500, 1500

atoms = bulk("Ar", "fcc", 6.05, cubic=True).repeat(5)
symbols = np.array(["Ar", "Kr"] * (len(atoms) // 2))
np.random.default_rng(5).shuffle(symbols)
atoms.symbols[:] = symbols
atoms.set_masses("defaults")

law = md.LennardJones(parameters, cutoff=9.0, mixing="lorentz-berthelot", truncation="force-shifted")
simulation = md.Simulation(atoms, law, md.VelocityVerlet(5.0 * fs))
simulation.set_temperature(temperature, seed=2)
simulation.equilibrate(n_equilibration, temperature)

edges = np.arange(2.5, 7.0, 0.1)
counts = {("Ar", "Ar"): 0, ("Ar", "Kr"): 0, ("Kr", "Kr"): 0}


def count_neighbors(run):
    i, j, d = md.neighbor_list("ijd", run.system, edges[-1])
    for (a, b), found in counts.items():
        counts[a, b] = found + np.histogram(d[(symbols[i] == a) & (symbols[j] == b)], edges)[0]


simulation.run(n_steps, every=50, observers=[count_neighbors])
radii = 0.5 * (edges[1:] + edges[:-1])
figure, panel = plt.subplots(figsize=(7, 4), layout="constrained")
for (a, b), found in counts.items():
    peak = radii[np.argmax(found / radii**2)]
    minimum = 2 ** (1 / 6) * (parameters[a][1] + parameters[b][1]) / 2
    panel.plot(radii, found / radii**2 / (found / radii**2).max(), label=f"{a}-{b}")
    print(f"{a}-{b}: neighbors at {peak:.2f} Å   (minimum of the pair potential: {minimum:.2f} Å)")
panel.set(xlabel="distance / Å", ylabel="neighbors per volume, highest = 1")
panel.legend()
figure.savefig("mixture.png", dpi=150)
print(simulation.report())
