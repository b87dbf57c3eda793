"""
3. Order and stability
======================

How wrong is a step of length Δt, and how long may it be? The error after a fixed time shrinks as Δtᵖ: p is the order
of the method. But long before a step is accurate, it has to be stable. Both are measured here on a planet and on a
spring.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md
from minimd.integrators import SE1, KahanLi6, KahanLi8, SecondOrder, Suzuki4, compose, run_steps

# %%
# Order
# -----
# A planet on an ellipse, e = 0.3, after a third of a period. (After a whole one the errors of symplectic Euler
# cancel, and it looks better than it is.) The reference is a method of order 8 with many steps.

time, eccentricity = 2.0, 0.3  # a period is 2π
start = (1.0 - eccentricity, 0.0), (0.0, np.sqrt((1.0 + eccentricity) / (1.0 - eccentricity)))
planet = SecondOrder(lambda q: -q / (q @ q) ** 1.5)
exact = run_steps(planet, KahanLi8(time / 400), start, 400).q[-1]
methods = [SE1, md.VelocityVerlet, Suzuki4, KahanLi6]
counts = 25 * 2 ** np.arange(5)

figure, panel = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
for method in methods:
    errors = [np.linalg.norm(run_steps(planet, method(time / n), start, int(n)).q[-1] - exact) for n in counts]
    slope = np.polyfit(np.log(time / counts[:3]), np.log(errors[:3]), 1)[0]
    panel.loglog(time / counts, errors, "o-", label=f"{method.name}, slope {slope:.2f}")
    print(f"{method.name:20} order {slope:.2f}   ({method.order})")
panel.set(xlabel="time step", ylabel="distance from where it should be")
panel.legend(frameon=False)
figure.savefig("3_order_and_stability_1.png", dpi=150)

# %%
# The price
# ---------
# A step of higher order evaluates the force more often. What counts is the error at equal cost: for a rough answer
# the simplest method wins.

figure, panel = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
for method in methods[1:]:
    runs = [run_steps(planet, method(time / n), start, int(n)) for n in counts]
    panel.loglog(
        [run.nfev for run in runs], [np.linalg.norm(run.q[-1] - exact) for run in runs], "o-", label=method.name
    )
panel.set(xlabel="evaluations of the force", ylabel="error")
panel.legend(frameon=False)
figure.savefig("3_order_and_stability_2.png", dpi=150)

# %%
# Order from composition
# ----------------------
# Three steps of velocity Verlet of the lengths w, 1 − 2w, w have order 4 if w = 1/(2 − ∛2): their errors of order 2
# cancel. The middle step goes backwards. No other way exists: a splitting with positive weights has order 2 at most.

for exponent in (1.0 / 3.0, -1.0 / 3.0):
    w = 1.0 / (2.0 - 2.0**exponent)
    jump = compose(*3 * [md.VelocityVerlet], weights=[w, 1.0 - 2.0 * w, w])
    known = "4" if exponent > 0.0 else "2, with the slip of sign that stands in several programs"
    print(f"w = 1/(2 − 2^({exponent:+.2f})) = {w:.5f}   order {jump.order}   ({known})")

# %%
# Stability
# ---------
# A spring of frequency ω. Beyond ωΔt = 2 the amplitude of velocity Verlet grows in each step: a step must be shorter
# than 1/π of the period 2π/ω of the fastest vibration. Below that, it keeps v² + ω²q² (1 − (ωΔt)²/4) to rounding.

spring = SecondOrder(lambda q: -q)
n_steps = 400
figure, panel = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
for phase in (0.5, 1.5, 1.95, 2.01):
    path = run_steps(spring, md.VelocityVerlet(phase), ((1.0,), (0.0,)), n_steps)
    kept = path.v**2 + path.q**2 * (1.0 - phase**2 / 4.0)
    panel.semilogy(np.abs(path.q), ".", markersize=3, label=f"ωΔt = {phase}")
    if phase < 2.0:
        largest, change = np.abs(path.q).max(), np.ptp(kept) / kept[0, 0]
        print(f"ωΔt = {phase:4}   largest |q| {largest:.3f}, shadow energy constant to {change:.0e}   (rounding)")
panel.set(xlabel="steps", ylabel="|q|", ylim=(1e-3, 1e4))
panel.legend(frameon=False)
figure.savefig("3_order_and_stability_3.png", dpi=150)

# %%
# A step of higher order, of your own
# -----------------------------------
# ``md.grade`` takes the order that the step should have as an argument, and says which weight is wrong.


def forest_ruth(x, v, force, m, dt):
    """Three position Verlet steps; is it?"""
    m = m[:, None]
    w = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    for a, b in ((w / 2, w), ((1 - w) / 2, 2 * w - 1), ((1 - w) / 2, w)):
        x = x + a * dt * v
        v = v + b * dt * force(x) / m
    return x + w / 2 * dt * v, v


print(md.grade(forest_ruth, order=4))

# %%
# Tasks
# -----
# 1. Correct ``forest_ruth``.
# 2. Write the classical Runge-Kutta method of order 4 as a step, and grade it. It is more accurate than Verlet over
#    one period: which of the two would you take for a million periods?
# 3. Where is the limit of stability of ``Suzuki4``? Divide by its five evaluations and compare with velocity Verlet.
# 4. Repeat the first figure with e = 0.9. Why do all lines move to the left?
# 5. Measure the order of your own step from its error on the planet, and compare with what ``md.grade`` found.
