"""A drop of a hundred atoms boils away, all velocities are reversed, and the gas runs back. Is it the drop again?

In float64 it is not: each step rounds, and collisions make a difference of 1e-16 as large as the drop. In fixed-point
arithmetic every step can be undone to the last bit. The total momentum, a linear first integral, does not change at
all. D. Levesque, L. Verlet, J. Stat. Phys. 72, 519 (1993).  docs/fixed-point.md
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

n_atoms, n_steps, every = 100, 6000, 50
colors = {"fixed-point": "tab:blue", "double": "tab:orange"}


def drop():
    """The atoms of a crystal that are nearest to its center."""
    positions, _ = md.lattice.crystal("fcc", (6, 6, 6), 1.6)
    positions -= positions.mean(axis=0)
    return md.System(positions[np.argsort((positions**2).sum(axis=1), kind="stable")[:n_atoms]])


def there_and_back(precision):
    """Positions at the start, at the reversal and at the end; and the change of the momentum at each observation."""
    lj = md.LennardJones(epsilon=1.0, sigma=1.0, cutoff=2.5, truncation="force-shifted")
    sim = md.Simulation(drop(), lj, md.VelocityVerlet(0.004), precision=precision)
    sim.set_temperature(2.2, seed=1)
    sim.make_steps(0)  # rounds to the grid
    start = sim.positions.copy()
    away = sim.run(n_steps, every=every, progress=False)
    turn = sim.positions.copy()
    sim.velocities[:] *= -1.0
    home = sim.run(n_steps, every=every, progress=False)
    momentum = np.concatenate([away.momentum, -home.momentum])
    return start, turn, sim.positions.copy(), np.linalg.norm(momentum - momentum[0], axis=1)


results = {precision: there_and_back(precision) for precision in colors}
for precision, (start, turn, end, change) in results.items():
    n_same, expected = (end == start).all(axis=1).sum(), n_atoms if precision == "fixed-point" else 0
    print(f"{precision}: a drop of {np.ptp(start):.1f} σ became a gas of {np.ptp(turn):.0f} σ and a drop of", end=" ")
    print(f"{np.ptp(end):.1f} σ; {n_same} atoms came back to the last bit ({expected});", end=" ")
    print(f"momentum changed by {change.max():.1e} m σ/τ")

rows = [["start", "back, fixed-point", "back, double"], ["momentum"] * 3]
figure, axes = plt.subplot_mosaic(rows, figsize=(9.0, 6.2), height_ratios=(3, 2))
shown = results["fixed-point"][0], results["fixed-point"][2], results["double"][2]
for title, positions, color in zip(rows[0], shown, ("tab:gray", *colors.values()), strict=True):
    axes[title].scatter(*positions[:, :2].T, s=30, color=color, edgecolor="white", linewidth=0.5)
    axes[title].set(title=title, xlim=(-6, 6), ylim=(-6, 6), aspect="equal", xticks=[], yticks=[])
momentum = axes["momentum"]
for precision, color in colors.items():
    change = results[precision][3] * 1e15
    time = np.arange(len(change) + 1) * every / 1000
    momentum.plot(time[:-1], change, color=color)
    momentum.text(time[-1], change[-1], precision if change.any() else f"{precision}: exactly 0", va="center")
momentum.set(xlabel="steps / 1000", ylabel="|P(t) − P(0)| / 10⁻¹⁵ m σ/τ", xlim=(0, 2.5 * n_steps / 1000))
figure.tight_layout()
figure.savefig("to_the_last_bit.png", dpi=130)
