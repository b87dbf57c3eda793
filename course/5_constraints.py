"""
5. Constraints
==============

A nitrogen molecule vibrates with a period of 14 fs, and a step must resolve this vibration, although it is of no
interest. A rigid bond does not vibrate and allows longer steps, but the force along it must be solved for. First one
pendulum, then a liquid of rigid molecules.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md
from minimd.integrators import Holonomic, SecondOrder, run_steps

# %%
# A pendulum in Cartesian coordinates
# -----------------------------------
# A mass on a rod of length 1: q″ = −e_y − λ q with 0 = (|q|² − 1)/2. Differentiated twice, the constraint gives λ as
# a function of q and v, and an ordinary equation. It has the same solutions, but |q| = 1 is then only a first
# integral, and errors let it drift.

down = np.array([0.0, -1.0])
timestep = 0.05
n_steps = 4000
start = (np.sin(1.5), -np.cos(1.5)), (0.0, 0.0)


def differentiated(q, v):
    """The acceleration with λ = (v² + q·e)/q² from the second derivative of the constraint."""
    return down - (v @ v + q @ down) / (q @ q) * q


free = run_steps(SecondOrder(differentiated), md.integrators.RadauIIA2(timestep), start, n_steps)
rod = Holonomic(lambda q: down, lambda q: [(q @ q - 1.0) / 2.0], lambda q: [q])
held = run_steps(rod, md.VelocityVerlet(timestep), start, n_steps)

figure, panels = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
for path, name in ((free, "differentiated twice"), (held, "RATTLE")):
    off = np.abs(np.linalg.norm(path.q, axis=1) - 1.0)
    energy = 0.5 * np.sum(path.v**2, axis=1) + path.q[:, 1]
    panels[0].semilogy(path.t, np.maximum(off, 1e-17), linewidth=0.8, label=name)
    panels[1].plot(path.t, energy - energy[0], linewidth=0.8, label=name)
    print(f"{name:21} length off by {off.max():.1e}, energy by {np.abs(energy - energy[0]).max():.1e}")
panels[0].set(xlabel="time", ylabel="error of the length")
panels[1].set(xlabel="time", ylabel="H − H(0)")
panels[0].legend(frameon=False)
figure.savefig("5_constraints_1.png", dpi=150)

# %%
# SHAKE, by hand
# --------------
# A step without the constraint, then impulses along the *old* bond until the length is right again. For one bond the
# equation is quadratic in λ; SHAKE solves it by sweeps that linearize it, bond after bond.


def shake(new, old, length, masses, tolerance=1e-12):
    """New positions of two atoms, moved along the old bond until they are the length apart; the number of sweeps."""
    new, bond, sweeps = new.copy(), old[1] - old[0], 0
    inverse = 1.0 / masses
    while True:
        d = new[1] - new[0]
        off = d @ d - length**2
        if abs(off) < tolerance or sweeps == 100:
            return new, sweeps
        impulse = off / (2.0 * inverse.sum() * (d @ bond))
        new[0] += impulse * inverse[0] * bond
        new[1] -= impulse * inverse[1] * bond
        sweeps += 1


masses, old = np.array([1.0, 3.0]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
velocities = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.4]])
for h in (0.05, 0.2, 0.4):
    new, sweeps = shake(old + h * velocities, old, 1.0, masses)
    print(f"h = {h:4}   {sweeps:2} sweeps, length {np.linalg.norm(new[1] - new[0]):.12f}   (1), momentum kept: "
          f"{np.allclose(masses @ new, masses @ (old + h * velocities))}")  # fmt: skip

# %%
# A liquid of rigid molecules
# ---------------------------
# 108 nitrogen molecules at 77 K. Lengths are kept to rounding at any time step; the error of the energy grows with
# the square of the step.

ASE, fs = md.units.ASE, md.units.fs
bond, n_equilibration, duration = 1.0897, 1000, 600  # Å, steps, fs
centers, edges = md.lattice.crystal("fcc", [3, 3, 3], 5.65)
arms = 0.5 * bond * np.random.default_rng(1).choice([-1.0, 1.0], centers.shape) / np.sqrt(3.0)
atoms = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
pairs = np.arange(len(atoms)).reshape(-1, 2)
nitrogen = md.System(
    atoms, masses=14.007, cell=edges, bonds=pairs, units=ASE, constraints=[md.DistanceConstraints(pairs)]
)
law = md.LennardJones(37.3 * ASE.k_B, 3.31, cutoff=8.0, truncation="smooth", bonded_scale=(0, 1, 1))
liquid = md.Simulation(nitrogen, law, md.VelocityVerlet(4.0 * fs))
liquid.set_temperature(77.0, seed=1)
liquid.equilibrate(n_equilibration, 77.0)
timesteps, energies = np.array([2, 4, 8, 16]), []
for length in timesteps:
    simulation = md.Simulation(liquid.system, law, md.VelocityVerlet(length * fs))
    record = simulation.run(int(duration // length), every=1, progress=False)
    energies.append(record.total_energy.std() / len(pairs) / ASE.k_B)
    off = record.constraint_violation.max()
    print(f"Δt = {length:2} fs   energy ± {energies[-1]:.3f} K per molecule, bonds off by {off:.0e}")
slope = np.polyfit(np.log(timesteps), np.log(energies), 1)[0]
print(f"the energy fluctuates as Δt to the power {slope:.2f}   (velocity Verlet: 2)")

figure, panel = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
panel.loglog(timesteps, energies, "o-")
panel.set(xlabel="time step / fs", ylabel="fluctuation of the energy / K per molecule")
figure.savefig("5_constraints_2.png", dpi=150)

# %%
# Tasks
# -----
# 1. Move along the *new* bond in ``shake`` in place of the old one. It converges as well. Turn the velocities of a
#    run around: what is lost?
# 2. Extend ``shake`` to a chain of three atoms. How many sweeps does it need now? ``md.DistanceConstraints(pairs,
#    solver="shake")`` sweeps, too.
# 3. Replace the rods by springs of 2359 cm⁻¹. What is the longest stable step? See ``examples/timestep_gain.py``.
# 4. How many degrees of freedom does the liquid have? Compare ``liquid.n_dof`` with 3·216 − 108 − 3.
# 5. Take a time step that is much too long. Which bond does the message name, and why there?
