"""A melt of bead-spring chains: is the total energy conserved, and does every spring hold k_B T/2?

Reduced units. Between bonded beads only the spring acts, because pairs one bond apart have no Lennard-Jones repulsion.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

n_chains, n_beads = 36, 20
density, temperature = 0.5, 1.0
stiffness, length = 400.0, 1.0  # ε/σ², σ
n_equilibration, n_steps = 4000, 8000

# Each chain starts as a straight rod; the rods form a square array.
edge = (n_chains * n_beads / density / n_beads) ** 0.5  # σ, across the rods
side = int(np.sqrt(n_chains))
feet = (np.indices((side, side)).reshape(2, -1).T + 0.5) * edge / side
positions = np.array([[x, y, z * length] for x, y in feet for z in range(n_beads)])
bonds = [(i, i + 1) for i in range(n_chains * n_beads) if (i + 1) % n_beads]
system = md.System(positions, cell=[edge, edge, n_beads * length], bonds=bonds)

repulsion = md.LennardJones(1.0, 1.0, cutoff=2 ** (1 / 6), truncation="shifted", bonded_scale=(0, 1, 1))
springs = md.HarmonicBond(stiffness, length)
simulation = md.Simulation(system, [repulsion, springs], md.VelocityVerlet(0.001))
simulation.set_temperature(temperature, seed=3)
simulation.equilibrate(n_equilibration, temperature)

stretches = []


def measure_stretch(run):
    i, j = run.system.bonds.T
    stretches.append(np.linalg.norm(run.positions[j] - run.positions[i], axis=1) - length)


record = simulation.run(n_steps, every=10, observers=[measure_stretch])
spring_energy = 0.5 * stiffness * np.mean(np.square(stretches))
now, energy = record.temperature.mean(), record.total_energy
width = energy.std() / len(system)
print(f"total energy   {energy[0]:.3f} to {energy[-1]:.3f} ε; ± {width:.1e} ε per bead   (expected: below 1e-3)")
print(f"spring energy  {spring_energy:.3f} ε per bond   (equipartition: about k_B T/2 = {0.5 * now:.3f})")
print(simulation.report())

figure, panel = plt.subplots(figsize=(6, 4), layout="constrained")
x = np.linspace(-4.0, 4.0, 200) * np.sqrt(now / stiffness)
gauss = np.exp(-stiffness * x**2 / (2.0 * now)) * np.sqrt(stiffness / (2.0 * np.pi * now))
panel.hist(np.ravel(stretches), x[::5], density=True, color="0.8", label="springs of the run")
panel.plot(x, gauss, "C3", label="Boltzmann, spring alone")
panel.set(xlabel="stretch / σ", ylabel="probability density / σ⁻¹", ylim=(0.0, 1.5 * gauss.max()))
panel.legend(frameon=False)
figure.savefig("bead_chain.png", dpi=150)
