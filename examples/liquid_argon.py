"""Liquid argon: how fast do its atoms diffuse, and how far apart are neighbors?

A. Rahman, Phys. Rev. 136, A405 (1964): 864 atoms, 94.4 K, 1.374 g/cm³.
"""

import matplotlib.pyplot as plt
import numpy as np
from ase.build import bulk

import minimd as md

ASE, fs, ps = md.units.ASE, md.units.fs, md.units.ps
temperature = 94.4  # K
epsilon, sigma = 120.0 * ASE.k_B, 3.4  # eV, Å
lattice_constant = 5.780  # Å: four atoms of 39.948 u at 1.374 g/cm³
n_equilibration, n_steps, every = 4000, 16_000, 50
timestep = 10.0 * fs

atoms = bulk("Ar", "fcc", lattice_constant, cubic=True).repeat(6)
argon = md.LennardJones(epsilon, sigma, cutoff=2.5 * sigma, truncation="force-shifted")
simulation = md.Simulation(atoms, argon, md.VelocityVerlet(timestep))
simulation.set_temperature(temperature, seed=1)
simulation.equilibrate(n_equilibration, temperature)  # melts the crystal

frames = []
record = simulation.run(n_steps, every=every, observers=[lambda run: frames.append(run.positions.copy())])
positions = np.array(frames)  # (T, N, 3), never wrapped, so differences are displacements

# D = ⟨|r(t) − r(0)|²⟩ / 6t, averaged over all time origins; the first picosecond is not diffusive
lags = np.arange(1, len(positions) // 3)
squares = np.array([np.mean(np.sum((positions[lag:] - positions[:-lag]) ** 2, axis=2)) for lag in lags])
time = lags * every * timestep / ps
late = time > 1.0
diffusion = np.polyfit(time[late], squares[late], 1)[0] / 6.0 * 1e-4  # 1 Å²/ps = 1e-4 cm²/s

# g(r): the number of neighbors in a shell, divided by that of an ideal gas
edges = np.arange(2.5, 10.0, 0.05)
radii = 0.5 * (edges[1:] + edges[:-1])
counts = np.zeros(len(radii))
for frame in positions[::10]:
    scene = md.System(frame, cell=simulation.system.cell)
    counts += np.histogram(md.neighbor_list("d", scene, edges[-1]), edges)[0]
ideal = len(atoms) ** 2 / simulation.system.volume * 4.0 * np.pi * radii**2 * 0.05 * len(positions[::10])
g = counts / ideal

figure, (shells, paths) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
shells.plot(radii, g)
shells.set(xlabel="distance / Å", ylabel="g(r)", title="neighbors")
paths.plot(time, squares)
paths.plot(time, np.polyval(np.polyfit(time[late], squares[late], 1), time), "k:")
paths.set(xlabel="time / ps", ylabel="mean-square displacement / Å²", title="diffusion, and its slope")
figure.savefig("liquid_argon.png", dpi=150)

print(f"temperature        {record.temperature.mean():.1f} K          (asked for: {temperature})")
print(f"diffusion          {diffusion:.2e} cm²/s   (Rahman: 2.43e-05)")
print(f"first peak of g(r) {radii[g.argmax()]:.2f} Å         (Rahman: 3.7; height here {g.max():.2f})")
print(simulation.report())
