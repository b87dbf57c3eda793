"""SPC/E water at 298 K: density at 1 bar, structure, diffusion and viscosity.

Values in the literature: density 0.998 g/cm³; first peak of g(r) at 2.75 Å; D = 2.7 to 2.8 · 10⁻⁵ cm²/s in an infinite
cell; η = 0.729 ± 0.07 mPa s (S. Tazi et al., J. Phys.: Condens. Matter 24, 284117 (2012)).
"""

import minimd as md

n_molecules, temperature, timestep = 216, 298.0, 2.0 * md.units.fs
n_equilibration, n_pressure, n_steps = 10_000, 40_000, 60_000
ps, bar = md.units.ps, md.units.BAR

system, potentials, rigid = md.water("SPC/E", n_molecules, cutoff=8.3, accuracy=1e-4)
bath = md.LangevinBAOAB(timestep, temperature, friction=2.0 / ps, seed=1)
barostat = md.StochasticCellRescaling(1.0 * bar, compressibility=4.5e-5 / bar, relaxation_time=2.0 * ps, seed=2)
pressed = md.Simulation(system, potentials, bath, rigid, barostat=barostat)
pressed.minimize(force_tolerance=0.1)
pressed.set_temperature(temperature, seed=3)
pressed.run(n_equilibration, every=1000)
volume = pressed.run(n_pressure, every=20).volume
mass = system.masses.sum() / md.units.GRAM_PER_CM3
density, error = md.mean_and_error(mass / volume)
print(f"density {density:.4f} ± {error:.4f} g/cm³")

system, potentials, rigid = md.water("SPC/E", n_molecules, density, cutoff=8.3, accuracy=1e-4)
sim = md.Simulation(system, potentials, bath, rigid)
sim.minimize(force_tolerance=0.1)
sim.set_temperature(temperature, seed=3)
sim.run(n_equilibration, every=1000)
sim.method = md.StochasticVelocityRescaling(timestep, temperature, relaxation_time=5.0 * ps, seed=4)
sim.velocities -= sim.drift
structure = md.observers.RadialDistribution(every=50, pairs="O-O")
motion, flow = md.observers.MeanSquareDisplacement(every=10, of="molecules"), md.observers.Viscosity(every=2)
sim.run(n_steps, every=1000, observers=[structure, motion, flow])
print(structure.result(), flow.result(), sep="\n")
print(motion.result(viscosity=flow.result().viscosity))
structure.result().plot().savefig("spce_water.png")
print(sim.report())
