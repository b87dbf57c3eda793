"""A star in a galaxy, after Hénon and Heiles: does its motion have a third invariant besides energy and time?

H = (vx² + vy² + x² + y²)/2 + x² y − y³/3. Each time an orbit passes x = 0 with vx > 0, a point (y, vy) is drawn. At low
energy the points of an orbit form a curve, because there is a third invariant. Near the energy of escape, 1/6, most
orbits are chaotic and fill an area. M. Hénon, C. Heiles, Astron. J. 69, 73 (1964).
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.interpolate import CubicHermiteSpline

import minimd as md
from minimd.integrators import BlanesMoan4, KahanLi6, SecondOrder, Suzuki4, run_until


def potential(x, y):
    return (x * x + y * y) / 2 + x * x * y - y**3 / 3


def energy(path):
    return 0.5 * (path.v**2).sum(axis=1) + potential(path.q[:, 0], path.q[:, 1])


def points(path, k):
    """y and vy where orbit k passes x = 0 with vx > 0."""
    x, y = (CubicHermiteSpline(path.t, path.q[:, i, k], path.v[:, i, k]) for i in (0, 1))
    passes = x.roots(extrapolate=False)
    upwards = passes[x(passes, 1) > 0]
    return y(upwards), y(upwards, 1)


galaxy = SecondOrder(lambda q: np.array([-q[0] - 2 * q[0] * q[1], -q[1] - q[0] ** 2 + q[1] ** 2]))
figure, (regular, chaotic, accuracy) = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
low, high = (1 / 12, np.linspace(-0.34, 0.44, 14)), (1 / 6.05, np.linspace(-0.41, 0.9, 14))
for axes, (level, y), kind in ((regular, low, "regular"), (chaotic, high, "mostly chaotic")):
    start = [0 * y, y], [np.sqrt(2 * (level - potential(0, y))), 0 * y]  # all orbits at once, q of shape (2, 14)
    path = run_until(galaxy, BlanesMoan4(0.2), start, 2000.0)
    for k in range(y.size):
        axes.plot(*points(path, k), ".", ms=2.5, mew=0)
    axes.set(xlabel="y", ylabel="vy", title=f"energy 1/{1 / level:.3g}: {kind}")
    error, n_steps = np.abs(energy(path) / level - 1).max(), path.t.size - 1
    print(f"energy 1/{1 / level:.3g}: off by {error:.0e} of itself at most, {n_steps} steps   (expected: below 1e-6)")

timesteps, start = 0.4 / 2.0 ** np.arange(4), ([[0.0], [0.1]], [[0.5], [0.0]])
for method in (md.VelocityVerlet, Suzuki4, BlanesMoan4, KahanLi6):
    errors = [np.ptp(energy(run_until(galaxy, method(h), start, 100.0))) for h in timesteps]
    slope = np.polyfit(np.log(timesteps[1:]), np.log(errors[1:]), 1)[0]
    accuracy.loglog(timesteps, errors, "o-", ms=4, label=f"{method.name}, slope {slope:.1f}")
    print(f"{method.name:16s} energy error ∝ timestep to the {slope:.2f}   (expected: order {method.order})")
accuracy.set_xticks(timesteps, [f"{h:g}" for h in timesteps], minor=False)
accuracy.set_xticks([], minor=True)
accuracy.set(xlabel="timestep", ylabel="energy fluctuation", title="energy 0.13, time 100", ylim=(1e-13, 1e-1))
accuracy.legend(loc="lower right", fontsize=8)
figure.savefig("henon_heiles.png", dpi=150)
