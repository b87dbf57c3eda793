"""A vapor condenses during a run. When did the droplet form, and how did it look then?

The birth of the droplet is the step from which half of all continuations become droplets. Bisection finds it among 21
frames, and then among the steps between two frames, which are computed again to the last bit (docs/past.md).
P. G. Bolhuis, Annu. Rev. Phys. Chem. 53, 291 (2002)."""

from bisect import bisect_left

import matplotlib.pyplot as plt
import numpy as np
from scipy.sparse.csgraph import connected_components

import minimd as md

n_atoms, edge, bond, n_steps, n_futures, duration, before, droplet = 150, 22.0, 1.5, 500_000, 8, 20_000, 3_000, 30
noise = [md.LangevinBAOAB(0.01, temperature=0.5, friction=0.1, seed=4 + k) for k in range(n_futures + 1)]


def cluster(sim):  # which atoms are in the largest cluster
    apart = sim.positions[:, None] - sim.positions
    labels = connected_components(((apart - edge * np.rint(apart / edge)) ** 2).sum(axis=2) < bond**2)[1]
    return labels == np.bincount(labels).argmax()


def futures(step):  # sizes of the largest cluster after a step, with other noise
    sim, sizes = past.branch(step), []
    here = sim.snapshot()
    for sim.method in noise[1:]:
        sim.restore(here)
        sim.run(duration, every=500, observers=[lambda now: sizes.append(cluster(now).sum())], progress=False)
    return np.reshape(sizes, (n_futures, -1))


positions = np.random.default_rng(0).permutation(md.lattice.crystal("fcc", (8, 8, 8), edge / 8)[0])[:n_atoms]
lj = md.LennardJones(epsilon=1.0, sigma=1.0, cutoff=2.5, truncation="force-shifted")
sim = md.Simulation(md.System(positions, cell=[edge] * 3), lj, noise[0], precision="fixed-point")
sim.set_temperature(0.5, seed=4)
sim.run(n_steps, every=n_steps // 20, trajectory="vapor.h5md", overwrite=True)

past, seen = md.Past("vapor.h5md", lj), []
sizes = [cluster(past.at(step)).sum() for step in past.steps]
steps = range(*past.steps[(k := bisect_left(sizes[1:-1], droplet)) : k + 2], 100)
born = steps[bisect_left(steps[:-1], 0.5, key=lambda step: (futures(step)[:, -1] > droplet).mean())]
look = [lambda now: seen.append((now.step / 1000, cluster(now).sum()))]
past.observe(look, max(born - before, 0), born)  # at every step
past.observe(look, born, min(born + duration, n_steps), every=500)
then, fan, inside = past.at(born), futures(born), cluster(past.at(born))
print(f"born at step {born}, {inside.sum()} atoms: {sum(fan[:, -1] > droplet)} of {n_futures} futures condense (half)")

figure, (whole, near, space) = plt.subplots(1, 3, figsize=(11.0, 3.6), width_ratios=(4, 4, 3), layout="tight")
whole.plot(past.steps / 1000, sizes, "o-", color="0.4", ms=4, lw=0.6)
whole.set(title="the frames that were kept", xlabel="step / 1000", ylabel="atoms in the largest cluster")
for size in fan:
    near.plot(born / 1000 + np.arange(len(size)) / 2, size, color="C1" if size[-1] > droplet else "C0", lw=0.7)
near.plot(*np.transpose(seen), color="black", lw=1.2)
near.set(title="every step, and futures from the birth", xlabel="step / 1000")
around = then.system.cell.wrapped(then.positions - then.positions[inside][0] + edge / 2)
space.scatter(*around[:, :2].T, s=50, c=np.where(inside, "tab:red", "0.8"))
space.set(title=f"step {born}", aspect="equal", xticks=[], yticks=[])
figure.savefig("droplet_born.png", dpi=130)
