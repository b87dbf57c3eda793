"""How smooth must a cutoff be for a method of order 6? The energy error of an argon droplet.

An atom that crosses a cutoff where the third derivative of u jumps gets an error of order Δt³ with any method. So the
usual switch, with two continuous derivatives, limits the order to 3. The smooth switch has seven continuous
derivatives.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md
from minimd.integrators import BlanesMoan4, KahanLi6, KahanLi8

n_cells, density, temperature = 3, 0.8442, 0.3  # 108 atoms of solid argon in reduced Lennard-Jones units, in free space
cutoff, duration, n_looks = 2.5, 1.0, 20
timesteps = {
    md.VelocityVerlet: 0.004 / 2.0 ** np.arange(4),
    BlanesMoan4: 0.012 / 2.0 ** np.arange(4),
    KahanLi6: 0.020 / 2.0 ** np.arange(4),
    KahanLi8: 0.040 / 2.0 ** np.arange(4),
}

edge = (4.0 / density) ** (1.0 / 3.0)
positions = md.lattice.crystal("fcc", [n_cells] * 3, edge)[0]
positions += 0.02 * np.random.default_rng(1).standard_normal(positions.shape)


def energy_error(method, timestep, truncation):
    """Largest change of the total energy."""
    simulation = md.Simulation(md.System(positions), md.LennardJones(1.0, 1.0, cutoff, truncation), method(timestep))
    simulation.set_temperature(temperature, seed=5)
    n_steps = round(duration / timestep)
    energy = simulation.run(n_steps, every=n_steps // n_looks).total_energy
    return np.abs(energy - energy[0]).max()


figure, axes = plt.subplots(figsize=(7.0, 5.0), layout="constrained")
for color, (method, steps) in zip(("C0", "C1", "C2", "C3"), timesteps.items(), strict=True):
    cost = method.stages / steps  # force evaluations per unit of time
    for truncation, style in (("switched", "o--"), ("smooth", "o-")):
        errors = [energy_error(method, timestep, truncation) for timestep in steps]
        slope = np.log2(errors[-2] / errors[-1])
        found = f"error {errors[0]:.1e} to {errors[-1]:.1e} ε, last slope {slope:4.1f}"
        print(f"{method.name:18s} {truncation:9s} {found}   (order {method.order})")
        axes.loglog(cost, errors, style, color=color, ms=4, label=method.name if truncation == "smooth" else None)
axes.set(xlabel="force evaluations per τ", ylabel="largest change of the total energy  [ε]")
axes.set_title("108 atoms, cutoff 2.5 σ: two continuous derivatives (dashed) and seven (solid)", fontsize=10)
axes.legend(frameon=False, fontsize=8)
figure.savefig("smooth_cutoff.png", dpi=150)
print("drawn              smooth_cutoff.png")
