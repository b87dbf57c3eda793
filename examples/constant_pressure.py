"""Liquid argon at constant pressure: are density and compressibility those of the equation of state?

NIST has Monte Carlo results for 500 Lennard-Jones atoms, https://mmlapps.nist.gov/srs/LJ_PURE/mc.htm. At T* = 0.90 the
density 0.776 has the pressure 0.24056. A parabola through this point and the points at 0.82 and 0.90 has the slope
dp/dρ = 10.2 at 0.776, so κ = 1/(ρ dp/dρ) = 0.126.
"""

import matplotlib.pyplot as plt

import minimd as md

n_cells, temperature, pressure = 5, 0.90, 0.24056
timestep, n_equilibration, n_steps, every, seed = 0.004, 10_000, 100_000, 20, 1

positions, edges = md.lattice.crystal("fcc", [n_cells] * 3, (4 / 0.74) ** (1 / 3))  # 500 atoms; density 5 % too low
law = md.LennardJones(1.0, 1.0, cutoff=3.0, truncation="truncated", tail_correction=True)
bath = md.LangevinBAOAB(timestep, temperature, friction=0.5, seed=seed)
barostat = md.StochasticCellRescaling(pressure, compressibility=0.1, relaxation_time=2.0, seed=seed, every=every)
liquid = md.Simulation(md.System(positions, cell=edges), law, bath, barostat=barostat)
liquid.set_temperature(2 * temperature, seed=seed)  # half of it goes into the melting crystal
liquid.run(n_equilibration, every=n_equilibration)

fluctuations = md.observers.Fluctuations(every=every)
record = liquid.run(n_steps, every=every, observers=[fluctuations])
density, found = md.mean_and_error(record.n_atoms / record.volume), fluctuations.result()
for name, (value, error), known in [
    ("ρ*", density, 0.776),
    ("κ*", (found.compressibility, found.compressibility_error), 0.126),
]:
    print(f"{name} = {value:.4f} ± {error:.4f}   (NIST: {known})")
print(found)
print(liquid.report())

figure, panel = plt.subplots(figsize=(6, 4), layout="constrained")
panel.plot(record.time, record.n_atoms / record.volume, lw=0.5, color="0.6", label="run")
panel.axhline(density[0], color="C0", label=f"mean {density[0]:.4f} ± {density[1]:.4f}")
panel.axhline(0.776, color="C3", ls="--", label="NIST 0.776")
panel.set(xlabel="time / τ", ylabel="density / σ⁻³")
figure.legend(loc="outside upper center", ncols=3, fontsize="small")
figure.savefig("constant_pressure.png", dpi=150)
