"""A planet, e = 0.6, whose velocity is reversed: does it return to the start?

Störmer-Verlet is reversible, ρΦρΦ = 1, and returns except for rounding. RK45 makes its errors a second time.
Units: semi-axis 1, period 2π.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import minimd as md
from minimd.integrators import SecondOrder, run_steps

e, timestep = 0.6, 0.05
n_turns = 400  # steps of Störmer-Verlet before the reversal: 20 units of time, 3.2 periods
start = np.array([1 - e, 0.0]), np.array([0.0, np.sqrt((1 + e) / (1 - e))])
end = n_turns * timestep


def attraction(q):
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def field(t, y):
    return np.concatenate([y[2:], attraction(y[:2])])


def verlet(q, v):
    path = run_steps(SecondOrder(attraction), md.VelocityVerlet(timestep), (q, v), n_turns)
    return path.q, path.v


def rk45(tolerance):
    def run(q, v):
        y = solve_ivp(field, (0, end), [*q, *v], rtol=tolerance, atol=tolerance, max_step=end).y.T
        return y[:, :2], y[:, 2:]

    return run


runs = {"Störmer-Verlet": verlet, "RK45, tolerance 1e-4": rk45(1e-4), "RK45, tolerance 1e-8": rk45(1e-8)}
figure, panels = plt.subplots(1, 3, figsize=(13, 3.9), layout="constrained", sharex=True, sharey=True)
for panel, (name, run) in zip(panels, runs.items(), strict=True):
    there, v = run(*start)
    back, w = run(there[-1], -v[-1])
    missed = max(np.abs(back[-1] - start[0]).max(), np.abs(w[-1] + start[1]).max())
    panel.plot(*there.T, ".-", color="tab:blue", lw=0.8, ms=6, label=f"there, {len(there) - 1} steps")
    panel.plot(*back.T, ".-", color="tab:orange", lw=0.6, ms=2.5, label=f"and back, {len(back) - 1} steps")
    panel.plot(*start[0], "o", mfc="none", mec="black", ms=11, label="start")
    panel.plot(*back[-1], "x", color="black", label="the end of the way back")
    panel.plot(0, 0, "*", color="gold", ms=12, mec="black")
    panel.set(title=f"{name}: misses by {missed:.0e}", xlabel="x / semi-axis", ylabel="y / semi-axis")
    panel.set(aspect="equal", xlim=(-1.8, 0.8), ylim=(-1.0, 1.9))
    panel.legend(loc="upper left", fontsize="small")
    expected = "rounding" if run is verlet else "truncation"
    print(f"{name:21s} comes back to the start within {missed:.1e}   (expected: {expected})")
figure.savefig("kepler_reversed.png", dpi=150)
