"""Two particles in double wells, coupled by a spring: can the energy replace one of the four equations?

The energy H = v₁²/2 + v₂²/2 + V(x₁) + V(x₂) + k (x₁ − x₂)²/2 with V = (x² − 1)²/4 is constant. So x₂ could be computed
from x₁, v₁ and v₂, in a differential-algebraic problem of index 1. This fails: ∂H/∂x₂ is minus the force on particle 2.
When this force vanishes, as it does in each swing, two roots for x₂ meet and the equations are singular. Beyond this
point both roots have the right energy.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md
from minimd.integrators import GaussLegendre4, Hessenberg1, RadauIIA3, SecondOrder, run_until

spring, t_end = 0.3, 6.0
x, v = np.array([-1.0, 0.2]), np.array([0.7, 0.8])
np.seterr(over="ignore")  # attempts to solve the singular equations overflow


def force(q):
    return q - q**3 - spring * (q - q[::-1])


def energy(x1, x2, v1, v2):
    return (v1**2 + v2**2) / 2 + ((x1**2 - 1) ** 2 + (x2**2 - 1) ** 2) / 4 + spring * (x1 - x2) ** 2 / 2


def slopes(y, z):
    return [y[1], *force(np.array([y[0], z[0]]))]


total = energy(*x, *v)
whole = SecondOrder(force)
reduced = Hessenberg1(slopes, lambda y, z: [energy(y[0], z[0], y[1], y[2]) - total])  # y = x₁, v₁, v₂ and z = x₂
figure, (paths, errors) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for timestep, color in ((0.04, "tab:orange"), (0.02, "tab:green"), (0.01, "tab:red"), (0.005, "tab:blue")):
    exact = run_until(whole, GaussLegendre4(timestep), (x, v), t_end)
    safe = run_until(whole, RadauIIA3(timestep), (x, v), t_end)
    try:
        path, ending = run_until(reduced, RadauIIA3(timestep), ([x[0], *v], [x[1]]), t_end), "reached the end"
    except md.ConvergenceError as reason:
        path, ending = reason.solution, "no root found"
    (x1, v1, v2), x2 = (part.T for part in reduced.parts(path.y))
    error, safe_error = np.abs(x2[0] - exact.q[: path.t.size, 1]), np.abs(safe.q - exact.q).max()
    errors.semilogy(path.t[1:], error[1:], color=color, label=f"Δt = {timestep:g}, {ending}")
    paths.plot(path.t, x2[0], color=color, label=f"x₂ eliminated, Δt = {timestep:g}", lw=1)
    kept = np.abs(energy(x1, x2[0], v1, v2) - total).max()
    print(f"Δt = {timestep:<5g}  x₂ eliminated: {ending} at {path.t[-1]:.2f}, off by {error.max():.0e}", end=", ")
    print(f"its energy by {kept:.0e}   (x₂ integrated: off by {safe_error:.0e})")
errors.semilogy(safe.t[1:], np.abs(safe.q - exact.q)[1:, 1], color="0.6", label=f"x₂ integrated, Δt = {timestep:g}")
paths.plot(exact.t, exact.q[:, 1], "k:", label="x₂ integrated")
pulls = np.array([force(q)[1] for q in exact.q])
for axes in (paths, errors):
    for t in exact.t[1:][pulls[1:] * pulls[:-1] < 0]:
        axes.axvline(t, color="0.8", lw=1, zorder=0)
    axes.set(xlabel="time", xlim=(0, t_end))
    axes.legend(fontsize=8)
paths.set(ylabel="x₂", title="gray lines: no force on particle 2")
errors.set(ylabel="error of x₂", ylim=(1e-17, 1e9), title="a shorter timestep need not be better")
figure.savefig("coupled_wells.png", dpi=150)
