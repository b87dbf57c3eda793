"""
6. Diffusion and viscosity
==========================

Transport coefficients are integrals over the memory of a liquid at rest (Green and Kubo). D from velocities and from
displacements must agree; the viscosity follows from the stress. And D depends on the size of the box, in a way that
the viscosity determines.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

density, temperature, timestep = 0.8442, 0.722, 0.004  # σ⁻³, ε/k_B, τ: near the triple point
every = 5
n_equilibration = 5000
n_steps = 60_000

# %%
# The run
# -------
# 256 atoms. The stress is not recorded by default: it must be asked for.

positions, edges = md.lattice.crystal("fcc", [4, 4, 4], md.lattice.constant_from_density("fcc", density))
liquid = md.System(positions, cell=edges)
law = md.LennardJones(1.0, 1.0, 2.5, truncation="force-shifted")
simulation = md.Simulation(liquid, law, md.VelocityVerlet(timestep))
simulation.extra_observables = ("stress",)
simulation.set_temperature(2.0 * temperature, seed=1)
simulation.equilibrate(n_equilibration, temperature)

velocities, places = [], []


def look(run):
    """Velocities at each look, positions too."""
    velocities.append(run.velocities.astype(np.float32))
    places.append(run.positions.astype(np.float32))


record = simulation.run(n_steps, every=every, observers=[look], progress=False)
v, paths, stress = np.array(velocities), np.array(places), record.stress
spacing, volume, t = every * timestep, simulation.system.volume, record.temperature.mean()
print(f"temperature {t:.3f}   ({temperature})")


# %%
# Memory
# ------
# ⟨A(0) A(t)⟩ over all starts in time, by Fourier transforms: the same as a double loop, and fast.


def memory(series, n_lags):
    """⟨A(0)·A(t)⟩ for the first lags; series : (T, …), averaged over what is behind the first index."""
    flat = np.asarray(series, dtype=float).reshape(len(series), -1)
    total = np.zeros(n_lags)
    for part in np.array_split(flat, max(1, flat.shape[1] // 64), axis=1):
        waves = np.fft.rfft(part, 2 * len(part), axis=0)
        total += np.fft.irfft(np.abs(waves) ** 2, axis=0)[:n_lags].sum(axis=1)
    return total / (len(flat) - np.arange(n_lags)) / flat.shape[1]


def integral(values):
    """∫₀ᵗ, by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))]) * spacing


# %%
# Diffusion, twice
# ----------------
# D = ∫ ⟨v_x(0) v_x(t)⟩ dt = lim ⟨|r(t) − r(0)|²⟩/6t. The two are one formula, integrated by parts.

n_lags = min(300, len(v) // 3)
lags = spacing * np.arange(n_lags)
correlation = memory(v, n_lags)
green_kubo = integral(correlation)
chosen = np.unique(np.linspace(1, n_lags - 1, 40).astype(int))
squares = np.array([np.mean(np.sum((paths[k:] - paths[:-k]) ** 2, axis=2)) for k in chosen])
late = lags[chosen] > 0.5 * lags[-1]
einstein = np.polyfit(lags[chosen][late], squares[late], 1)[0] / 6.0
diffusion = green_kubo[n_lags // 2 :].mean()
print(f"D = {diffusion:.4f} by Green and Kubo, {einstein:.4f} by Einstein   (they must agree)")

# %%
# Viscosity
# ---------
# η = V/k_BT ∫ ⟨σ_xy(0) σ_xy(t)⟩ dt. A liquid has one stress, not one for each atom, so this converges far more
# slowly. Five independent components help: xy, yz, zx, and (xx − yy)/2, (yy − zz)/2.

xx, yy, zz = (stress[:, k, k] for k in range(3))
shear = [stress[:, 0, 1], stress[:, 1, 2], stress[:, 2, 0], (xx - yy) / 2.0, (yy - zz) / 2.0]
running = volume / t * integral(memory(np.stack(shear, axis=1), n_lags))
viscosity = running[n_lags // 3 : n_lags // 2].mean()
print(f"η = {viscosity:.2f}   (3.2 to 3.3 for the law without a cutoff, less with one; this run is good to some 0.3)")

figure, panels = plt.subplots(1, 3, figsize=(12.0, 3.6), layout="constrained")
panels[0].plot(lags, correlation / correlation[0])
panels[0].set(xlabel="t / τ", ylabel="⟨v(0)·v(t)⟩ / ⟨v²⟩", xlim=(0.0, 1.5))
panels[1].plot(lags, green_kubo, label="Green-Kubo")
panels[1].plot(lags[chosen], squares / (6.0 * lags[chosen]), "--", label="⟨r²⟩/6t")
panels[1].set(xlabel="t / τ", ylabel="D(t)", ylim=(0.0, 1.6 * green_kubo.max()))
panels[1].legend(frameon=False)
panels[2].plot(lags, running)
panels[2].set(xlabel="t / τ", ylabel="η(t)")
figure.savefig("6_diffusion_and_viscosity.png", dpi=150)

# %%
# The size of the box
# -------------------
# A diffusing atom drags the liquid along, and its images with it: D is too small by ξ k_BT/6πηL, ξ = 2.837297 (B.
# Dünweg, K. Kremer 1993; I.-C. Yeh, G. Hummer, J. Phys. Chem. B 108, 15873 (2004)).

correction = 2.837297 * t / (6.0 * np.pi * viscosity * volume ** (1.0 / 3.0))
known = "0.033 to 0.034 for the law without a cutoff, more with one"
print(f"D of an endless liquid: {diffusion + correction:.4f}   ({known})")

# %%
# Tasks
# -----
# 1. Take 500 and 1372 atoms, and plot D against 1/L. Does the line end where the correction says?
# 2. Where does η(t) stop rising, and where does it become noise? Split the run into five parts and draw all five
#    integrals.
# 3. Show that D(t) of Green and Kubo is the derivative of ⟨r²⟩/6, not ⟨r²⟩/6t. Which of the two converges faster?
# 4. Stokes and Einstein: is D = k_BT/(4πηR) with a sensible radius R?
# 5. Do the same for Rahman's argon (lesson 2), and give η in mPa s. Liquid argon at 94 K has 0.20.
