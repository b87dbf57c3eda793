"""Liquid argon at constant pressure: does it find the density of the equation of state, and do its fluctuations give the compressibility?

NIST's Monte Carlo results for 500 Lennard-Jones atoms, https://mmlapps.nist.gov/srs/LJ_PURE/mc.htm: at T* = 0.90 the density 0.776 has the
pressure 0.24056. A parabola through this point and those at 0.82 and 0.90 has the slope dp/dρ = 10.2 there: κ = 1/(ρ dp/dρ) = 0.126.
"""

import numpy as np

import minimd as md

n_cells, temperature, pressure = 5, 0.90, 0.24056
timestep, n_equilibration, n_steps, every, seed = 0.004, 10_000, 100_000, 20, 1

positions, edges = md.lattice.crystal("fcc", [n_cells] * 3, (4 / 0.74) ** (1 / 3))  # 500 atoms, 5 % too thin
law = md.LennardJones(1.0, 1.0, cutoff=3.0, truncation="truncated", tail_correction=True)
bath = md.LangevinBAOAB(timestep, temperature, friction=0.5, seed=seed)
barostat = md.StochasticCellRescaling(pressure, compressibility=0.1, relaxation_time=2.0, seed=seed, every=every)
liquid = md.Simulation(md.System(positions, cell=edges), law, bath, barostat=barostat)
liquid.set_temperature(2 * temperature, seed=seed)  # half of it goes into the melting crystal
liquid.run(n_equilibration, every=n_equilibration)

record = liquid.run(n_steps, every=every)
n_atoms, volume = record.n_atoms, record.volume[1:]
blocks = volume[: len(volume) // 10 * 10].reshape(10, -1)
density, compressibility = n_atoms / blocks.mean(axis=1), ((blocks - volume.mean()) ** 2).mean(axis=1) / (temperature * volume.mean())
for name, values, known in [("ρ*", density, 0.776), ("κ*", compressibility, 0.126)]:
    print(f"{name} = {values.mean():.4f} ± {values.std(ddof=1) / np.sqrt(10):.4f}   (NIST: {known})")
print(liquid.report())
