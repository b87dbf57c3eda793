"""Kepler's ellipse, e = 0.6, over 100 periods: which method comes closest for its price?

Every separable symplectic method of minimd, and RK45 and DOP853 of SciPy. Units: semi-axis 1, period 2π. The price is paid in
evaluations of the force, or in seconds; forces here are cheap, so that the seconds are those of the loop around them.
"""

from time import perf_counter

import matplotlib.pyplot as plt
import numba
import numpy as np
from scipy.integrate import solve_ivp

import minimd as md

eccentricity = 0.6
n_periods = 100
costs = [100, 200, 400, 800, 1600]  # forces per period
q0, v0, end = np.array([1 - eccentricity, 0.0]), np.array([0.0, np.sqrt((1 + eccentricity) / (1 - eccentricity))]), 2 * np.pi * n_periods


@numba.njit
def attraction(q):
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def symplectic(method, cost):
    n = round(cost / method.stages) * n_periods
    path = md.integrators.run_steps(md.integrators.SecondOrder(attraction), method(end / n), (q0, v0), n, every=n)
    return path.q[-1], path.nfev


def scipy(method, tolerance):
    path = solve_ivp(lambda t, y: np.concatenate([y[2:], attraction(y[:2])]), (0, end), [*q0, *v0], method, [end], rtol=tolerance, atol=tolerance)
    return path.y[:2, -1], path.nfev


def measured(run, method, choice):
    begin = perf_counter()
    q, nfev = run(method, choice)
    return nfev / n_periods, perf_counter() - begin, np.linalg.norm(q - q0)  # whole periods: the start is the exact end


symplectic(md.VelocityVerlet, 100)  # compile
figure, panels = plt.subplots(1, 2, figsize=(13, 5.5), layout="constrained", sharey=True)
colors = {1: "gray", 2: "tab:brown", 3: "tab:olive", 4: "tab:blue", 6: "tab:green", 8: "tab:purple"}
methods = md.integrators.SPLITTINGS.items()
results = {name: (np.array([measured(symplectic, method, cost) for cost in costs]), method.order, "-") for name, method in methods}
for name in ("RK45", "DOP853"):
    results[name] = np.array([measured(scipy, name, rtol) for rtol in 10.0 ** np.arange(-5, -12, -2)]), None, "--"
for marker, (name, (points, order, style)) in zip("ov^<>sDpP*Xhd8v^", results.items(), strict=True):
    for panel, price in zip(panels, points.T, strict=False):
        label = f"{name}, order {order}" if order else f"{name} of SciPy"
        panel.loglog(price, points[:, 2], marker + style, color=colors.get(order, "tab:red"), ms=5, lw=1, label=label)
panels[0].set(xlabel="evaluations of the force per period", ylabel="error of the position at the end / semi-axis", ylim=(1e-6, 5))
panels[1].set(xlabel="seconds")
figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize="small")
figure.savefig("work_precision.png", dpi=150)
candy, best = (results[name][0][-1, 2] for name in ("candy-rozmus-4", "blanes-moan-rkn-4"))
print(f"1600 forces per period: Candy-Rozmus misses by {candy:.1e}, Blanes-Moan by {best:.1e}: {candy / best:.0f} times less   (expected: over 10)")
