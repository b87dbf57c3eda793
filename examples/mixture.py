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

neighbors = md.observers.RadialDistribution(r_max=7.0, n_bins=70, every=50)
simulation.run(n_steps, every=50, observers=[neighbors])
found = neighbors.result()
figure, panel = plt.subplots(figsize=(7, 4), layout="constrained")
for pair, g in zip(found.pairs, found.g_of_pairs, strict=True):
    a, b = pair.split("-")
    minimum = 2 ** (1 / 6) * (parameters[a][1] + parameters[b][1]) / 2
    panel.plot(found.r, g, label=pair)
    print(f"{pair}: neighbors at {found.r[np.argmax(g)]:.2f} Å   (minimum of the pair potential: {minimum:.2f} Å)")
panel.set(xlabel="r / Å", ylabel="g(r)", xlim=(2.5, 7.0))
panel.legend()
figure.savefig("mixture.png", dpi=150)
print(simulation.report())
