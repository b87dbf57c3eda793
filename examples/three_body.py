"""Three equal masses chase each other on a figure eight: what keeps their energy if the method does not?

RadauIIA2 is not a geometric method: it loses energy. A projection of each step onto the initial energy prevents this,
and other invariants of the exact flow can be added to the projection. A symplectic method does not need it. Units:
G = m = 1, period 6.3259. A. Chenciner, R. Montgomery, Ann. Math. 152, 881 (2000).
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md
from minimd.integrators import Invariants, RadauIIA2, SecondOrder, projected, run_until

period, rounds, timestep = 6.32591398, 12, 0.1
first, last_velocity = np.array([0.97000436, -0.24308753]), np.array([-0.93240737, -0.86473146])
start = [first, -first, [0.0, 0.0]], [-last_velocity / 2, -last_velocity / 2, last_velocity]


def separations(q):
    return q[[1, 2, 0]] - q  # of the pairs 0-1, 1-2, 2-0


def gravity(q):
    d = separations(q)
    pull = d / (d**2).sum(axis=1, keepdims=True) ** 1.5
    return pull - pull[[2, 0, 1]]


def energy(q, v):
    return 0.5 * (v**2).sum() - (1 / np.linalg.norm(separations(q), axis=1)).sum()


def energy_and_spin(q, v):
    return energy(q, v), (q[:, 0] * v[:, 1] - q[:, 1] * v[:, 0]).sum()


methods = {
    "RadauIIA2": RadauIIA2,
    "RadauIIA2, energy projected": projected(RadauIIA2, Invariants(energy)),
    "… and angular momentum": projected(RadauIIA2, Invariants(energy_and_spin)),
    "velocity Verlet": md.VelocityVerlet,
}
rows = [list(methods)[:3], ["energy"] * 3]
figure, axes = plt.subplot_mosaic(rows, figsize=(11, 6), layout="constrained", height_ratios=[1, 1.3])
for (name, method), color in zip(methods.items(), ["tab:red", "tab:blue", "tab:green", "0.6"], strict=True):
    path = run_until(SecondOrder(gravity), method(timestep), start, rounds * period)
    error = np.abs([energy(q, v) - energy(path.q[0], path.v[0]) for q, v in zip(path.q, path.v, strict=True)])
    axes["energy"].semilogy(path.t[1:] / period, np.maximum(error[1:], 1e-17), color=color, label=name, lw=1)
    expected = "it drifts" if method is RadauIIA2 else "below 1e-14" if "Radau" in method.__name__ else "bounded"
    print(f"{name:28s} energy error {error.max():.0e}   (expected: {expected})")
    if name in axes:
        axes[name].plot(path.q[:, :, 0], path.q[:, :, 1], color=color, lw=0.3)
        axes[name].plot(*path.q[-1].T, "o", color="black", ms=4)
        axes[name].set(title=name, aspect="equal", xlim=(-1.3, 1.3), ylim=(-0.6, 0.6))
axes["energy"].set(xlabel="rounds", ylabel="|energy error| / (G m²/length)", ylim=(1e-17, 1))
axes["energy"].legend(loc="center right")
figure.savefig("three_body.png", dpi=150)
print(f"energy of the figure eight {energy(*map(np.array, start)):.6f}   (expected: -1.287142)")
