"""A drop of a hundred atoms boils away, all velocities are reversed, and the gas runs back. Does it become the drop again?

In float64 it does not: each step rounds, and collisions make a difference of 1e-16 as large as the drop. In fixed-point arithmetic every
step can be undone to the last bit, and the total momentum, a linear first integral, does not change at all.
D. Levesque, L. Verlet, J. Stat. Phys. 72, 519 (1993).  docs/fixed-point.md
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

n_atoms, temperature = 100, 2.2
n_steps, every = 6000, 50
colors = {"fixed-point": "tab:blue", "double": "tab:orange"}


def drop():
    """The atoms of a crystal that are nearest to its middle."""
    positions, _ = md.lattice.crystal("fcc", (6, 6, 6), 1.6)
    positions -= positions.mean(axis=0)
    return md.System(positions[np.argsort((positions**2).sum(axis=1), kind="stable")[:n_atoms]])


def there_and_back(precision):
    """Positions at the start, where time turns and at the end; and the change of the momentum at each look."""
    lj = md.LennardJones(epsilon=1.0, sigma=1.0, cutoff=2.5, truncation="force-shifted")
    sim = md.Simulation(drop(), lj, md.VelocityVerlet(0.004), precision=precision)
    sim.set_temperature(temperature, seed=1)
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
    n_same = int((end == start).all(axis=1).sum())
    print(
        f"{precision}: a drop {np.ptp(start):.1f} σ wide became a gas of {np.ptp(turn):.0f} σ and came back {np.ptp(end):.1f} σ wide;",
        end=" ",
    )
    print(
        f"{n_same} atoms returned to the last bit ({n_atoms if precision == 'fixed-point' else 0}); momentum changed by {change.max():.1e} m σ/τ"
    )

figure, axes = plt.subplot_mosaic(
    [["start", "back, fixed-point", "back, double"], ["momentum"] * 3], figsize=(9.0, 6.2), height_ratios=(3, 2)
)
shown = (results["fixed-point"][0], results["fixed-point"][2], results["double"][2])
for (title, axis), positions, color in zip(list(axes.items())[:3], shown, ("tab:gray", *colors.values()), strict=True):
    axis.scatter(positions[:, 0], positions[:, 1], s=30, color=color, edgecolor="white", linewidth=0.5)
    axis.set(title=title, xlim=(-6, 6), ylim=(-6, 6), aspect="equal", xticks=[], yticks=[])
for precision, color in colors.items():
    change = results[precision][3] * 1e15
    axes["momentum"].plot(np.arange(len(change)) * every / 1000, change, color=color)
    axes["momentum"].text(
        len(change) * every / 1000, change[-1], precision if change.any() else f"{precision}: exactly 0", va="center"
    )
axes["momentum"].set(
    xlabel="steps / 1000, there and back", ylabel="|P(t) − P(0)| / 10⁻¹⁵ m σ/τ", xlim=(0, 2.5 * n_steps / 1000)
)
axes["momentum"].spines[["top", "right"]].set_visible(False)
figure.tight_layout()
figure.savefig("to_the_last_bit.png", dpi=130)
