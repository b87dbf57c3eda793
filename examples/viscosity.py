"""How viscous is the Lennard-Jones liquid near its triple point, and how fast do its atoms diffuse?

Reduced units. Observers keep sums during the run; no frame is written. Published values:
viscosity 3.258, diffusion coefficient 0.0325 for 1372 atoms, or 0.0353 for an infinite system: K. Meier, A. Laesecke,
S. Kabelac, J. Chem. Phys. 121, 3671 and 9526 (2004); viscosity 3.24 ± 0.04: M. Ferrario, G. Ciccotti, B. L. Holian,
J. P. Ryckaert, Phys. Rev. A 44, 6936 (1991).
"""

import minimd as md

density, temperature, cutoff = 0.8442, 0.722, 3.0  # σ⁻³, ε/k_B, σ
timestep, relaxation_time = (
    0.004,
    10.0,
)  # τ; the bath acts on all atoms alike, and too slowly to change their motion
n_equilibration, n_steps = 10_000, 200_000

edge = md.lattice.constant_from_density("fcc", density)
positions, edges = md.lattice.crystal("fcc", [5, 5, 5], edge)  # 500 atoms
bath = md.StochasticVelocityRescaling.with_relaxation_time(timestep, temperature, relaxation_time, seed=1)
liquid = md.Simulation(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, cutoff), bath)
liquid.set_temperature(2.0 * temperature, seed=1)
liquid.equilibrate(n_equilibration, temperature)

stress = md.observers.Viscosity(every=4)
displacement = md.observers.MeanSquareDisplacement(every=25)
velocity = md.observers.VelocityAutocorrelation(every=5, most_atoms=500)
structure = md.observers.RadialDistribution(r_max=4.0, every=500)
observers = [stress, displacement, velocity, structure, md.observers.Fluctuations(every=20)]
liquid.run(n_steps, every=1000, observers=observers)

eta = stress.result()
eta.plot().savefig("viscosity.png")
print(f"{eta}   (published: 3.258, 3.24 ± 0.04)")
print(f"{velocity.result()}   (of 500 atoms)")
print(f"{displacement.result(viscosity=eta.viscosity)}   (published, for many: 0.0353)")
print(f"{structure.result()}")
print(f"{observers[-1].result()}")
