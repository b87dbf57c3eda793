"""A pendulum in Cartesian coordinates: a differential-algebraic equation of index 3, compared with its closed form.

    x″ = −λ x,  z″ = −λ z − g,  0 = (x² + z² − 1)/2      rod, mass and gravity 1; λ is the tension of the rod

The method solves for position, velocity and tension together. Their orders are 5, 3 and 2.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import ellipj, ellipk

from minimd.integrators import Mechanical, RadauIIA3, run_until

angle, end = 1.0, 3.0  # rad, released at rest; time √(rod/g)

pendulum = Mechanical(1.0, lambda q: np.array([0.0, -1.0]), g=lambda q: (q @ q - 1) / 2, jacobian=lambda q: q)
start = (np.sin(angle), -np.cos(angle)), (0.0, 0.0)  # minimd computes the tension


def closed_form(t):
    """Position, velocity and tension; sin θ/2 = k sn(K − t), k = sin(angle/2)."""
    k = np.sin(angle / 2)
    sn, cn, _, _ = ellipj(ellipk(k * k) - t, k * k)
    theta, omega = 2 * np.arcsin(k * sn), -2 * k * cn
    q = np.stack([np.sin(theta), -np.cos(theta)], axis=-1)
    v = omega[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    return q, v, (3 * np.cos(theta) - 2 * np.cos(angle))[:, None]


figure, (motion, errors) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
timesteps, worst = end / np.array([10, 20, 40, 80, 160]), []
for timestep in timesteps:
    path = run_until(pendulum, RadauIIA3(timestep), start, end)
    parts = zip(pendulum.parts(path.y), closed_form(path.t), strict=True)
    worst.append([np.abs(part - exact).max() for part, exact in parts])
q, v, tension = pendulum.parts(path.y)
fine = np.linspace(0.0, end, 200)
q_fine, _, tension_fine = closed_form(fine)
for dots, line, label in zip([*q.T, tension], [*q_fine.T, tension_fine], ("x", "z", "tension λ"), strict=True):
    (drawn,) = motion.plot(fine, line, lw=1)
    motion.plot(path.t[::8], dots[::8], "o", ms=4, color=drawn.get_color(), label=label)
for label, error, order in zip(("position", "velocity", "tension"), np.transpose(worst), (5, 3, 2), strict=True):
    (drawn,) = errors.loglog(timesteps, error[-1] * (timesteps / timesteps[-1]) ** order, lw=1)
    errors.loglog(timesteps, error, "o", color=drawn.get_color(), label=f"{label}, slope {order}")
motion.set(xlabel="time / √(rod / g)", ylabel="coordinates / rod,  λ / (m g / rod)")
motion.set(title="Radau IIA (dots) and closed form (lines)")
errors.set(xlabel="time step / √(rod / g)", ylabel="largest error", title="errors fall with the orders of index 3")
errors.set_xticks(timesteps, [f"{timestep:.3g}" for timestep in timesteps])
errors.minorticks_off()
motion.legend()
errors.legend()
figure.savefig("pendulum.png", dpi=150)
theta = np.arctan2(q[-1, 0], -q[-1, 1])
print(f"angle at t = 3: {theta:.10f} rad   (closed form: -0.9487515969)")
print(f"length of the rod: 1 up to {np.abs((q**2).sum(axis=1) - 1).max():.0e}   (expected: rounding, 1e-15)")
