"""
1. One particle and its phase plane
===================================

A pendulum, q″ = −sin q. Its state is a point (q, v) of the phase plane, and its energy H = v²/2 − cos q is constant,
so that the point stays on a curve H = const. Three steps look alike: which of them stays on the curve?
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

timestep = 0.25
n_steps = 2000


def acceleration(q):
    """Mass, length and gravity are 1."""
    return -np.sin(q)


def energy(q, v):
    """Kinetic plus potential."""
    return 0.5 * v**2 - np.cos(q)


# %%
# Three steps
# -----------
# They differ in *when* the force is computed, and with which velocity the position moves.


def explicit_euler(q, v, acceleration, dt):
    """Everything from the old state."""
    return q + dt * v, v + dt * acceleration(q)


def symplectic_euler(q, v, acceleration, dt):
    """First the velocity, then the position with the new velocity."""
    v = v + dt * acceleration(q)
    return q + dt * v, v


def velocity_verlet(q, v, acceleration, dt):
    """Half a kick, a drift, half a kick with the new force."""
    v = v + 0.5 * dt * acceleration(q)
    q = q + dt * v
    return q, v + 0.5 * dt * acceleration(q)


def run(step, q, v, n_steps):
    """The path as arrays of q and v."""
    path = [(q, v)]
    for _ in range(n_steps):
        q, v = step(q, v, acceleration, timestep)
        path.append((q, v))
    return np.array(path).T


# %%
# In the phase plane
# ------------------
# Gray: curves of constant energy. Explicit Euler gains energy in each turn, until the pendulum goes over the top. The
# other two stay near their curve; that of symplectic Euler is sheared.

methods = [explicit_euler, symplectic_euler, velocity_verlet]
figure, panels = plt.subplots(1, 3, figsize=(11.0, 3.8), layout="constrained", sharey=True)
grid_q, grid_v = np.meshgrid(np.linspace(-4.0, 4.0, 200), np.linspace(-3.0, 3.0, 200))
for panel, step in zip(panels, methods, strict=True):
    panel.contour(
        grid_q, grid_v, energy(grid_q, grid_v), levels=np.linspace(-0.9, 2.0, 8), colors="0.8", linewidths=1.0
    )
    q, v = run(step, 1.5, 0.0, 60)
    panel.plot(q, v, ".-", markersize=4, linewidth=0.6)
    panel.set(title=step.__name__.replace("_", " "), xlabel="q", xlim=(-4.0, 4.0), ylim=(-3.0, 3.0))
panels[0].set_ylabel("v")
figure.savefig("1_phase_plane_1.png", dpi=150)

# %%
# The energy
# ----------
# The error of the two symplectic steps oscillates and does not grow: they keep another energy exactly, a *shadow* of H.

figure, panel = plt.subplots(figsize=(7.0, 3.8), layout="constrained")
for step in methods[1:]:
    q, v = run(step, 1.5, 0.0, n_steps)
    change = energy(q, v) - energy(q[0], v[0])
    panel.plot(timestep * np.arange(len(q)), change, linewidth=0.6, label=step.__name__.replace("_", " "))
    worst, last = np.abs(change).max(), np.abs(change[-n_steps // 10 :]).max()
    print(f"{step.__name__:17} energy off by at most {worst:.3f}, in the last tenth by {last:.3f}")
panel.set(xlabel="time", ylabel="H − H(0)")
panel.legend(frameon=False)
figure.savefig("1_phase_plane_2.png", dpi=150)

# %%
# Areas
# -----
# A hundred pendulums start on a circle in the phase plane. Symplectic steps turn and stretch it, and keep its area;
# explicit Euler makes it larger in each step.

angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
figure, panel = plt.subplots(figsize=(6.0, 4.5), layout="constrained")
for step, color in zip(methods, ["C3", "C1", "C0"], strict=True):
    q, v = 1.0 + 0.4 * np.cos(angle), 0.4 * np.sin(angle)
    for count in range(13):
        if count % 6 == 0:
            panel.plot(np.append(q, q[0]), np.append(v, v[0]), color=color, linewidth=1.0 + 0.3 * count / 6)
        area = 0.5 * abs(np.sum(q * np.roll(v, -1) - np.roll(q, -1) * v))
        q, v = step(q, v, acceleration, timestep)
    print(f"{step.__name__:17} area after 12 steps: {area / (0.16 * np.pi):.3f} of that at the start   (symplectic: 1)")
panel.set(xlabel="q", ylabel="v", aspect="equal")
figure.savefig("1_phase_plane_3.png", dpi=150)

# %%
# What is wrong with a step?
# --------------------------
# ``md.grade`` takes a step function, runs it on small problems of its own, and says what it keeps.

print(md.grade(explicit_euler))

# %%
print(md.grade(velocity_verlet))

# %%
# Tasks
# -----
# 1. Write position Verlet: half a drift, a kick, half a drift. Let ``md.grade`` tell you whether it is right.
# 2. In ``velocity_verlet``, forget to compute the force again. What does the energy do? What does ``md.grade`` say?
# 3. Make the time step longer. At which length does the phase plane of ``velocity_verlet`` show islands, and when
#    does it blow up? Small swings have ω = 1: compare with ωΔt = 2.
# 4. Symplectic Euler keeps H + (Δt/2) v sin q better than H. Plot both. (Which comes first, kick or drift, if the
#    term has this sign?)
# 5. Add friction, −γv, to the force. Which of the properties are lost?
