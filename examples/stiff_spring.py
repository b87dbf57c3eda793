"""A spring pendulum of growing stiffness k: what is its limit, when the spring is a rod?

    q″ = −λ q/|q| − e_z,  0 = |q| − 1 − λ/k         mass, gravity and length 1; λ is the tension

For k < ∞ the tension follows from the length, index 1. The limit is a differential-algebraic equation of index 3. The
same code solves both. Paths that start without vibration approach the path of the rod as 1/k. Units: length,
√(length/gravity).
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

angle, timestep, end = 1.2, 0.01, 6.0  # released at rest
stiffness = 10.0 ** np.arange(1, 6)  # weight / length


def swing(softness):
    """The path, and the index that minimd determines; softness = 1/k."""

    def equations(y, slope):
        x, z, vx, vz, tension = y
        length = np.hypot(x, z)
        return [
            slope[0] - vx,
            slope[1] - vz,
            slope[2] + tension * x / length,
            slope[3] + tension * z / length + 1,
            length - 1 - softness * tension,
        ]

    problem = md.integrators.Implicit(equations)
    length = 1 + softness * np.cos(angle)  # the spring bears the weight from the start
    start = [length * np.sin(angle), -length * np.cos(angle), 0.0, 0.0, np.cos(angle)]
    path = md.integrators.run_until(problem, md.integrators.RadauIIA3(timestep), start, end)
    return path, problem.index


rod, index = swing(0.0)
print(f"rod: index {index}   (expected: 3)")
figure, (paths, distances) = plt.subplots(1, 2, figsize=(12, 3.6), layout="constrained", width_ratios=[3, 2])
farthest = []
for k, color in zip(stiffness, plt.cm.viridis(np.linspace(0, 0.9, stiffness.size)), strict=True):
    spring, index = swing(1 / k)
    farthest.append(np.abs(spring.y[:, :2] - rod.y[:, :2]).max())
    if k <= 1000:
        paths.plot(spring.y[:, 0], spring.y[:, 1], color=color, lw=1.5, label=f"k = {k:g}, index {index}")
paths.plot(rod.y[:, 0], rod.y[:, 1], "--", color="tab:red", lw=1, label="rod, index 3")
distances.loglog(stiffness, farthest, "o", color="tab:blue", label="measured")
distances.loglog(stiffness, farthest[-1] * stiffness[-1] / stiffness, color="tab:blue", lw=1, label="1/k")
paths.set(xlabel="x / length", ylabel="z / length", title="paths of the mass", aspect="equal")
distances.set(
    xlabel="k / (weight / length)", ylabel="largest distance / length", title="distance from the path with a rod"
)
paths.legend(loc="upper center")
distances.legend()
figure.savefig("stiff_spring.png", dpi=150)
slope = np.polyfit(np.log(stiffness[1:]), np.log(farthest[1:]), 1)[0]
print(f"the distance falls as k^{slope:.3f}   (expected: k^-1)")
