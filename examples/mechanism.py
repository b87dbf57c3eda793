"""A mechanism: two rods join a middle point to two points on the lines y = ±l, and all three points are pulled along x.

No coordinate is eliminated: six coordinates obey four constraints, and the multipliers are the forces of rods and
lines. The kinetic energy must equal the work of the pulls. As long as the outer points are functions of the middle
point, solve_ivp must find the same path.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

from minimd.integrators import Mechanical, RadauIIA3, run_until

l, r1, r2 = 1.0, 2.0, 1.5  # m
timestep, end = 0.05, 8.0  # s
m1, m2, m3 = mass = np.array([1.0, 1.0, 2.0])  # kg: upper, middle, lower point
pull = np.array([-1.0, 0.5, 1.5])  # N, along x


def constraints(q):
    (x1, y1), (x2, y2), (x3, y3) = q.reshape(3, 2)
    rods = ((x1 - x2) ** 2 + (y1 - y2) ** 2 - r1**2) / 2, ((x3 - x2) ** 2 + (y3 - y2) ** 2 - r2**2) / 2
    return [y1 - l, y3 + l, *rods]


def reduced(t, state):
    """The same for the middle point (x, y) alone: x1 = x − s1(y), x3 = x + s3(y)."""
    _, y, vx, vy = state
    s1, s3 = np.sqrt(r1**2 - (l - y) ** 2), np.sqrt(r2**2 - (l + y) ** 2)
    c1, c3 = -(l - y) / s1, -(l + y) / s3  # dx1/dy and dx3/dy, then second derivatives
    b1, b3 = r1**2 / s1**3 * vy**2, -(r2**2) / s3**3 * vy**2
    inertia = [[mass.sum(), m1 * c1 + m3 * c3], [m1 * c1 + m3 * c3, m2 + m1 * c1**2 + m3 * c3**2]]
    force = [pull.sum() - m1 * b1 - m3 * b3, pull[0] * c1 + pull[2] * c3 - m1 * c1 * b1 - m3 * c3 * b3]
    return [vx, vy, *np.linalg.solve(inertia, force)]


mechanism = Mechanical(np.repeat(mass, 2), lambda q: np.stack([pull, np.zeros(3)], axis=1), constraints)
y0 = -0.7
points = [-np.sqrt(r1**2 - (l - y0) ** 2), l, 0.0, y0, np.sqrt(r2**2 - (l + y0) ** 2), -l]
path = run_until(mechanism, RadauIIA3(timestep), (points, np.zeros(6)), end)
q, v, multipliers = mechanism.parts(path.y)
other = solve_ivp(reduced, (0.0, end), [0.0, y0, 0.0, 0.0], method="DOP853", rtol=1e-11, atol=1e-11)

figure, (motion, forces) = plt.subplots(2, 1, figsize=(9, 4.5), layout="constrained")
for t, row in zip(path.t[::20], q[::20], strict=True):
    motion.plot(row[::2], row[1::2], "-o", color=plt.cm.viridis(0.9 * t / end), ms=4)
motion.plot(q[:, 2], q[:, 3], color="tab:red", lw=1, label="middle point")
motion.hlines([l, -l], *motion.get_xlim(), color="0.8", zorder=0)
motion.set(xlabel="x / m", ylabel="y / m", title="once a second, from dark to light", aspect="equal")
forces.plot(path.t, [r1, r2] * multipliers[:, 2:], label=["upper rod", "lower rod"])
forces.set(xlabel="time / s", ylabel="tension / N", title="forces in the rods")
for panel in (motion, forces):
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
figure.savefig("mechanism.png", dpi=150)
kinetic, work = 0.5 * v**2 @ np.repeat(mass, 2), (q - q[0])[:, ::2] @ pull
kept = max(np.abs(constraints(one)).max() for one in q)
print(f"constraints violated by at most {kept:.0e}   (expected: rounding, 1e-15)")
print(f"kinetic energy at the end {kinetic[-1]:.6f} J   (work of the pulls: {work[-1]:.6f})")
print(f"middle point ends at x = {q[-1, 2]:.6f} m   (solve_ivp with two coordinates: {other.y[0, -1]:.6f})")
