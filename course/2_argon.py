"""
2. Argon as Rahman did it
=========================

In 1964 A. Rahman followed 864 atoms of liquid argon at 94.4 K and 1.374 g/cm³ (Phys. Rev. 136, A405): the first
simulation of a liquid with continuous forces. He found that they diffuse with D = 2.43·10⁻⁵ cm²/s, and that neighbors
stand at 3.7 Å, the next ones at 7.0 and 10.4 Å. Here is the same liquid.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

fs, ps, kelvin = md.units.fs, md.units.ps, md.units.ASE.k_B
temperature, sigma, epsilon = 94.4, 3.4, 120.0 * kelvin  # K, Å, eV
timestep, every = 10.0 * fs, 10
n_equilibration = 3000
n_steps = 12_000

# %%
# The liquid
# ----------
# Atoms start on a lattice with random velocities. The lattice melts within a few picoseconds, which takes half of the
# kinetic energy: velocities are rescaled meanwhile.

positions, edges = md.lattice.crystal("fcc", [6, 6, 6], 5.78)  # Å: four atoms of 39.948 u at 1.374 g/cm³
argon = md.System(positions, masses=39.948, cell=edges, units=md.units.ASE)
law = md.LennardJones(epsilon, sigma, cutoff=2.5 * sigma, truncation="force-shifted")
simulation = md.Simulation(argon, law, md.VelocityVerlet(timestep))
simulation.set_temperature(temperature, seed=1)
simulation.equilibrate(n_equilibration, temperature)

frames, velocities = [], []


def look(run):
    """Keep positions and velocities."""
    frames.append(run.positions.astype(np.float32))
    velocities.append(run.velocities.astype(np.float32))


record = simulation.run(n_steps, every=every, observers=[look], progress=False)
paths, speeds = np.array(frames), np.array(velocities) * ps  # Å, Å/ps
time = np.arange(len(paths)) * every * timestep / ps  # ps
print(f"temperature        {record.temperature.mean():.1f} K   (Rahman: 94.4)")

# %%
# Where the neighbors are
# -----------------------
# g(r) counts the atoms in a shell around an atom, relative to an ideal gas of the same density.

bins = np.arange(2.5, 14.0, 0.1)
radii = 0.5 * (bins[1:] + bins[:-1])
looked_at = paths[:: max(1, len(paths) // 20)]
counts = sum(
    np.histogram(md.neighbor_list("d", md.System(frame.astype(float), cell=simulation.system.cell), bins[-1]), bins)[0]
    for frame in looked_at
)
shells = 4.0 / 3.0 * np.pi * (bins[1:] ** 3 - bins[:-1] ** 3)
g = counts / len(looked_at) / (len(argon) ** 2 / simulation.system.volume * shells)
peaks = [
    r
    for r, left, here, right in zip(radii[1:], g, g[1:], g[2:], strict=False)
    if here > max(left, right) and here > 1.05
]
print(f"first peak of g(r) {radii[g.argmax()]:.2f} Å, height {g.max():.2f}   (Rahman: 3.7 Å)")

figure, panel = plt.subplots(figsize=(7.0, 3.8), layout="constrained")
panel.plot(radii, g)
for r in (3.7, 7.0, 10.4):
    panel.axvline(r, color="0.8", linewidth=1.0, zorder=0)
panel.set(xlabel="r / Å", ylabel="g(r)", title="gray: the maxima that Rahman found")
figure.savefig("2_argon_1.png", dpi=150)

# %%
# How fast they go
# ----------------
# ⟨|r(t) − r(0)|²⟩ grows as t² at first, while an atom flies freely, and as 6Dt later. minimd never wraps positions,
# so that displacements can be read off.

lags = np.arange(1, len(paths) // 4)
squares = np.array(
    [np.mean(np.sum((paths[lag:] - paths[:-lag]) ** 2, axis=2)) for lag in lags[:: max(1, len(lags) // 60)]]
)
lag_time = time[lags[:: max(1, len(lags) // 60)]]
late = lag_time > lag_time[-1] / 5.0
diffusion = np.polyfit(lag_time[late], squares[late], 1)[0] / 6.0  # Å²/ps
print(f"diffusion          {diffusion * 1e-4:.2e} cm²/s   (Rahman: 2.43e-05)")

figure, panels = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
panels[0].loglog(lag_time, squares, ".-")
panels[0].loglog(lag_time, 6.0 * diffusion * lag_time, "--", color="0.5", label="6Dt")
panels[0].loglog(lag_time[:8], np.mean(speeds**2) * 3.0 * lag_time[:8] ** 2, ":", color="0.5", label="⟨v²⟩t²")
panels[0].set(xlabel="t / ps", ylabel="⟨|r(t) − r(0)|²⟩ / Å²")
panels[0].legend(frameon=False)

# %%
# The memory of velocities
# ------------------------
# ⟨v(t)·v(0)⟩ goes below zero after a third of a picosecond: an atom bounces back from the cage of its neighbors. That
# was the surprise of the paper, because Langevin's equation predicts nothing of the kind.

delays = np.arange(min(20, len(speeds) // 2))
memory = np.array([np.mean(np.sum(speeds[: len(speeds) - k] * speeds[k:], axis=2)) for k in delays])
panels[1].plot(time[delays], memory / memory[0], ".-")
panels[1].axhline(0.0, color="0.8", linewidth=1.0, zorder=0)
panels[1].set(xlabel="t / ps", ylabel="⟨v(t)·v(0)⟩ / ⟨v²⟩")
figure.savefig("2_argon_2.png", dpi=150)

# %%
# A force of your own
# -------------------
# This is the loop that every course begins with. ``md.grade`` compares it with minimd's own force, and looks for the
# usual faults.


def forces(positions, box, cutoff):
    """Lennard-Jones in reduced units: forces and energy; the energy is shifted to zero at the cutoff."""
    total, energy = np.zeros_like(positions), 0.0
    for i in range(len(positions)):
        for j in range(i + 1, len(positions)):
            d = positions[i] - positions[j]
            d -= box * np.round(d / box)
            r2 = d @ d
            if r2 < cutoff**2:
                s6 = 1.0 / r2**3
                pair = 24.0 * s6 * (2.0 * s6 - 1.0) / r2 * d
                total[i] += pair
                total[j] -= pair
                energy += 4.0 * s6 * (s6 - 1.0) - 4.0 * (cutoff**-12 - cutoff**-6)
    return total, energy


print(md.grade(forces, cell=8.0, cutoff=2.5))

# %%
# Tasks
# -----
# 1. Break ``forces``: forget ``total[j] -= pair``; divide by r instead of r²; leave out ``np.round``; do not shift
#    the energy. What does ``md.grade`` find each time?
# 2. Rahman's cutoff was 2.25σ. What does it do to D, and to the height of the first peak?
# 3. How many neighbors are below the first minimum of g(r), at about 5.4 Å? Integrate 4πr²ρ g(r).
# 4. Double the number of atoms in each direction. D grows a little: why? (Lesson 6 has the answer.)
# 5. Compute ⟨|r(t) − r(0)|⁴⟩ and the parameter (3⟨r⁴⟩/5⟨r²⟩²) − 1, which is zero for a Gaussian. Rahman found that it
#    rises within a few picoseconds and falls again. Do you?
