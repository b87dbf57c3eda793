"""A planet, e = 0.6, by Störmer-Verlet and by SciPy's RK45: which of them leaves the ellipse?

RK45 runs twice: with the same number of force evaluations over the same time, and with steps from SciPy's tolerances.
Units: semi-axis 1, period 2π. On the ellipse the distances from the two foci add up to 2.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import RK45, solve_ivp

from minimd.integrators import SecondOrder, VelocityVerlet, run_steps

e, timestep = 0.6, 0.05
focus = np.array([-2 * e, 0.0])  # the focus without the sun
q0, v0 = np.array([1 - e, 0.0]), np.array([0.0, np.sqrt((1 + e) / (1 - e))])


def attraction(q):
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def field(t, y):
    return np.concatenate([y[2:], attraction(y[:2])])


def verlet(n):
    path = run_steps(SecondOrder(attraction), VelocityVerlet(timestep), (q0, v0), n)
    return path.q, path.nfev


def rk45_fixed(n):
    step = timestep * n / (n // 6)  # six forces per step; tolerances that never shorten it
    path = solve_ivp(field, (0, n * timestep), [*q0, *v0], first_step=step, max_step=step, rtol=1e9, atol=1e9)
    return path.y[:2].T, path.nfev


def rk45_adaptive(n):
    solver, path = RK45(field, 0, [*q0, *v0], np.inf), [q0]
    while len(path) <= n:
        solver.step()
        path.append(solver.y[:2])
    return np.array(path), solver.nfev


angle = np.linspace(0, 2 * np.pi, 500)
ellipse = np.cos(angle) - e, np.sqrt(1 - e**2) * np.sin(angle)
figure, panels = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
runs = {"Störmer-Verlet": verlet, "RK45, as many forces": rk45_fixed, "RK45, as many adaptive steps": rk45_adaptive}
for panel, n in zip(panels, (100, 200), strict=True):
    panel.plot(*ellipse, color="lightgray", lw=5, label="the ellipse")
    for (name, run), style in zip(runs.items(), (".-b", ".-r", ".g"), strict=True):
        q, nfev = run(n)
        both = np.linalg.norm(q, axis=1) + np.linalg.norm(q - focus, axis=1)
        panel.plot(*q.T, style, lw=0.8, ms=3, label=f"{name} ({nfev} forces)")
        found = f"sum of distances {both.min():.2f} … {both.max():.2f}"
        print(f"{n} steps, {name:28s} {nfev:4d} forces: {found}   (on the ellipse: 2)")
    panel.plot(0, 0, "*", color="gold", ms=12, mec="black")
    panel.set(title=f"{n} steps; lengths in semi-axes", aspect="equal", xlim=(-1.8, 0.8), ylim=(-1.0, 1.5))
    panel.legend(loc="upper left", fontsize="small")
figure.savefig("kepler.png", dpi=150)
