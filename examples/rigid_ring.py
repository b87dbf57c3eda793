"""A closed chain that moves along itself: does it keep its shape?

A flexible, inextensible loop of line density μ keeps any shape if all its points move along it with speed v. Where the
curvature is κ, the tension T = μ v² gives the force T κ per length, which equals the centripetal force μ v² κ. Here
the loop is a ring of beads on rigid bonds of length b; it keeps its shape to a fraction of b. The same ring, squeezed,
does not. No forces; mass 1, speed 1, b about 1.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md
from minimd.core.constraints import ConstraintSolver

n_beads, timestep = 200, 0.05
n_steps = 4000  # one revolution: n_beads / timestep

angle = np.linspace(0.0, 2.0 * np.pi, 20_001)  # a peanut, cut into pieces of equal length
curve = (1.0 + 0.35 * np.cos(2.0 * angle)) * np.array([np.cos(angle), np.sin(angle)])
arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve), axis=0)))
curve *= n_beads / arc[-1]
where = np.arange(n_beads) / n_beads * arc[-1]
positions = np.column_stack([*(np.interp(where, arc, x) for x in curve), np.zeros(n_beads)])
pairs = np.column_stack([np.arange(n_beads), (np.arange(n_beads) + 1) % n_beads])
ahead = np.roll(positions, -1, axis=0) - np.roll(positions, 1, axis=0)
along = ahead / np.linalg.norm(ahead, axis=1)[:, None]


def off_the_curve(points):
    """Distance of each bead from the curve on which it started [b]."""
    return np.sqrt(((points[:, :2, None] - curve[:, ::5]) ** 2).sum(axis=1).min(axis=1))


figure, panels = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained", sharex=True, sharey=True)
squeezed = positions * [-0.008, 0.008, 0.0]
rigid = md.DistanceConstraints(pairs)
for velocities in (along, squeezed):
    ConstraintSolver(rigid, positions, np.ones(n_beads)).project_velocities(velocities, positions)
for panel, (name, velocities) in zip(
    panels, {"runs along itself": along, "is squeezed": squeezed}.items(), strict=True
):
    system = md.System(positions, velocities=velocities, constraints=[rigid])
    ring = md.Simulation(system, [], md.VelocityVerlet(timestep))
    panel.plot(*curve, color="0.8", lw=6, solid_capstyle="round")
    for quarter in range(4):
        record = ring.run(n_steps // 4)
        panel.plot(
            *np.vstack([ring.positions, ring.positions[:1]])[:, :2].T, lw=1, label=f"{(quarter + 1) / 4:.2f} rounds"
        )
    panel.plot(*ring.positions[0, :2], "o", color="black", ms=5)
    panel.set(title=name, xlabel="x / b", aspect="equal")
    expected = "a fraction of b" if velocities is along else "many b"
    off, bonds = off_the_curve(ring.positions).max(), record.constraint_violation.max()
    print(f"{name:18s} off its curve by {off:.2f} b   (expected: {expected}), bonds by {bonds:.0e}   (rounding: 1e-13)")
panels[0].set_ylabel("y / b")
panels[0].legend(loc="center")
figure.savefig("rigid_ring.png", dpi=150)
