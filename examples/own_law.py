"""A law of one's own: a diatomic molecule with a Morse potential, and a Yukawa law added to a built-in law.

    Morse    u(r) = D [(1 − e^(−a(r − r₀)))² − 1],   small oscillations at ω = a √(2D/μ)
    Yukawa   u(r) = A e^(−κr)/r

A law takes r² and its parameters and returns u and f = −u′(r)/r; minimd compiles it.
"""

from math import exp, sqrt

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

depth, width, length = 10.0, 2.0, 1.2  # ε, 1/σ, σ
strength, screening = 5.0, 1.5  # ε σ, 1/σ


def morse(r2, d, a, r0):
    r = sqrt(r2)
    e = exp(-a * (r - r0))
    return d * ((1.0 - e) ** 2 - 1.0), -2.0 * d * a * e * (1.0 - e) / r


def yukawa(r2, a, k):
    r = sqrt(r2)
    u = a * exp(-k * r) / r
    return u, u * (k + 1.0 / r) / r


# One molecule, stretched by a thousandth of its length: what is its frequency?
molecule = md.System([[0.0, 0.0, 0.0], [1.001 * length, 0.0, 0.0]], bonds=[(0, 1)])
bond = md.BondPotential(morse, (depth, width, length))
simulation = md.Simulation(molecule, bond, md.VelocityVerlet(0.002))
distances = []
simulation.run(5000, every=1, observers=[lambda run: distances.append(run.positions[1, 0] - run.positions[0, 0])])
swings = np.array(distances) - np.mean(distances)
crossings = np.flatnonzero((swings[:-1] < 0) & (swings[1:] >= 0))
frequency = 2.0 * np.pi * (len(crossings) - 1) / (0.002 * (crossings[-1] - crossings[0]))
figure, panel = plt.subplots(figsize=(6, 4), layout="constrained")
time = 0.002 * np.arange(1, 601)
panel.plot(time, 1e3 * swings[:600], lw=4, color="0.8", label="run")
panel.plot(time, 1.2 * np.cos(width * sqrt(2 * depth / 0.5) * time), "C3--", label="cos ωt, ω = a √(2D/μ)")
panel.set(xlabel="time / τ", ylabel="r − mean / 10⁻³ σ")
figure.legend(loc="outside upper center", ncols=2)
figure.savefig("own_law.png", dpi=150)
print(f"Morse bond     ω = {frequency:.3f}/τ   (small oscillations: {width * sqrt(2 * depth / 0.5):.3f}/τ)")

# A hundred atoms with both Lennard-Jones and Yukawa: is the force minus the gradient of the energy?
grid = np.indices((5, 5, 4)).reshape(3, -1).T * 1.2 + np.random.default_rng(1).normal(0.0, 0.05, (100, 3))
laws = [md.LennardJones(1.0, 1.0, 2.5), md.PairPotential(yukawa, (strength, screening), cutoff=2.9)]
cluster = md.System(grid, cell=[6.0, 6.0, 5.9])
force = md.evaluate(cluster, laws).forces[0, 0]
energies = [
    md.evaluate(md.System(grid + step * np.eye(1, 300).reshape(100, 3), cell=[6.0, 6.0, 5.9]), laws).potential_energy
    for step in (1e-5, -1e-5)
]
print(f"force          {force:.6f} ε/σ   (central difference: {(energies[1] - energies[0]) / 2e-5:.6f} ε/σ)")
