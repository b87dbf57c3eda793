"""Disks that push themselves forward gather in clusters although they only repel each other.

Where they are dense they are slow, and where they are slow they gather: motility-induced phase separation. Disks of
diameter σ run at speed v and forget their direction in the time τ. Below a persistence length v τ of some 20 σ they
stay a fluid; above it dense clusters stand in a thin gas. The local density shows which.

Y. Fily, M. C. Marchetti, Phys. Rev. Lett. 108, 235702 (2012); G. S. Redner, M. F. Hagan, A. Baskaran, Phys. Rev. Lett.
110, 055701 (2013); M. E. Cates, J. Tailleur, Annu. Rev. Condens. Matter Phys. 6, 219 (2015).
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

n, density = (26, 15), 0.75  # 780 disks, 0.59 of the area
timestep, duration = 0.01, 300.0  # σ/v = 1
repulsion = md.SoftRepulsion(3.0, cutoff=1.0)
reach = 3.0

constant = md.lattice.constant_from_density("triangular", density)
positions, edges = md.lattice.crystal("triangular", n, constant)


def run(persistence_time):
    """The disks at the end, and how many others are near each, as a density."""
    push = md.ActiveForce(1.0, persistence_time, seed=1)
    bath = md.BrownianDynamics(timestep, temperature=0.001, friction=1.0, seed=2)
    disks = md.Simulation(md.System(positions, cell=edges, planar=True), [repulsion, push], bath)
    disks.run(round(duration / timestep))
    first = md.neighbor_list("i", disks.system, reach)
    return disks, (np.bincount(first, minlength=len(disks.positions)) + 1) / (np.pi * reach**2)


figure, panels = plt.subplots(1, 2, figsize=(10.0, 5.2), layout="constrained")
for panel, persistence_time in zip(panels, (1.0, 50.0), strict=True):
    disks, local = run(persistence_time)
    places = disks.system.cell.wrapped(disks.positions)
    drawn = panel.scatter(*places[:, :2].T, c=local, s=14, vmin=0.0, vmax=1.3, cmap="viridis")
    panel.set(
        aspect="equal", title=f"v τ = {persistence_time:g} σ: local density {local.mean():.2f} ± {local.std():.2f}"
    )
    print(
        f"v τ = {persistence_time:4g} σ      local density {local.mean():.2f}, standard deviation {local.std():.2f} /σ²"
    )
figure.colorbar(drawn, ax=panels, label="local density  [1/σ²]")
figure.savefig("active_clusters.png", dpi=150)
print("drawn              active_clusters.png")
