"""Kepler's ellipse, e = 0.6, over 100 periods: which method is most accurate for its cost?

Four symplectic methods of minimd are compared with RK45 and DOP853 of SciPy. Units: semi-axis 1, period 2π. The cost is
the number of force evaluations, which take nearly all the time of a step with atoms.
"""

import matplotlib.pyplot as plt
import numba
import numpy as np
from scipy.integrate import solve_ivp

import minimd as md
from minimd.integrators import BlanesMoan4, CandyRozmus4, KahanLi8, SecondOrder, run_steps

e, n_periods = 0.6, 100  # eccentricity
costs = 100 * 2 ** np.arange(5)  # forces per period
q0, v0 = np.array([1 - e, 0.0]), np.array([0.0, np.sqrt((1 + e) / (1 - e))])
end = 2 * np.pi * n_periods


@numba.njit
def attraction(q):
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def field(t, y):
    return np.concatenate([y[2:], attraction(y[:2])])


def symplectic(method, cost):
    n = round(cost / method.stages) * n_periods
    path = run_steps(SecondOrder(attraction), method(end / n), (q0, v0), n, every=n)
    return path.nfev / n_periods, np.linalg.norm(path.q[-1] - q0)  # whole periods: the exact end is the start


def scipy(method, tolerance):
    path = solve_ivp(field, (0, end), [*q0, *v0], method, [end], rtol=tolerance, atol=tolerance)
    return path.nfev / n_periods, np.linalg.norm(path.y[:2, -1] - q0)


methods = {
    "velocity Verlet, 2": md.VelocityVerlet,
    "Candy-Rozmus, 4": CandyRozmus4,
    "Blanes-Moan, 4": BlanesMoan4,
    "Kahan-Li, 8": KahanLi8,
}
results = {name: np.array([symplectic(method, cost) for cost in costs]) for name, method in methods.items()}
for name, order in (("RK45", 5), ("DOP853", 8)):
    results[f"{name}, {order}"] = np.array([scipy(name, tolerance) for tolerance in 10.0 ** np.arange(-5, -12, -2)])

figure, panel = plt.subplots(figsize=(8, 5), layout="constrained")
for k, (name, points) in enumerate(results.items()):
    panel.loglog(*points.T, "o-" if name in methods else "s--", color=f"C{k}", ms=5)
    beside = (-30, -16) if name.startswith("Kahan") else (8, -4)
    panel.annotate(name, points[-1], beside, textcoords="offset points", color=f"C{k}", annotation_clip=False)
panel.set(xlabel="forces per period", ylabel="error at the end / semi-axis", ylim=(5e-7, 5), title="orders of methods")
figure.savefig("work_precision.png", dpi=150)
candy, best = (results[name][-1, 1] for name in ("Candy-Rozmus, 4", "Blanes-Moan, 4"))
print(f"1600 forces per period: Candy-Rozmus misses by {candy:.1e}, Blanes-Moan by {best:.1e},", end=" ")
print(f"{candy / best:.0f} times less   (expected: over 10)")
