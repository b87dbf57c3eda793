"""A comet, e = 0.9, over 1000 periods with steps of varying length: does its energy drift?

A comet needs short steps near the sun and long steps far from it. With steps chosen by an error estimate, the energy
of Störmer-Verlet drifts. It does not drift with reversible steps, whose density is integrated with the state by a
leapfrog. Units: semi-axis 1, period 2π.
"""

import matplotlib.pyplot as plt
import numba
import numpy as np

import minimd as md

eccentricity, timestep, tolerance = 0.9, 0.002, 3e-6
n_periods = 1000


@numba.njit
def attraction(q):
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


kepler = md.integrators.SecondOrder(attraction)
start = (1 - eccentricity, 0.0), (0.0, np.sqrt((1 + eccentricity) / (1 - eccentricity)))
end = 2 * np.pi * n_periods

reversible = md.integrators.run_reversible(kepler, md.VelocityVerlet(timestep), start, end)
estimated = md.integrators.run_adaptive(
    kepler, md.VelocityVerlet, start, end, control=md.integrators.StepControl(rtol=tolerance, atol=tolerance)
)

figure, (orbits, energies) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for label, path, color in (("by an error estimate", estimated, "tab:red"), ("reversible", reversible, "tab:blue")):
    energy = 0.5 * (path.v**2).sum(axis=1) - 1 / np.hypot(*path.q.T)
    error = np.abs(energy + 0.5)
    blocks = np.array_split(error, 500)
    energies.plot(
        np.linspace(0, n_periods, 500),
        [block.max() for block in blocks],
        color=color,
        label=f"{label}, {path.nfev} forces",
    )
    orbits.plot(*path.q[-600:].T, ".-", color=color, lw=0.5, ms=2, label=label)
    first, last = blocks[0].max(), blocks[-1].max()
    expected = "the same at both ends" if path is reversible else "growing with time"
    print(
        f"steps {label:20s}  energy error {first:.1e} in the beginning, {last:.1e} at the end   (expected: {expected})"
    )
orbits.set(xlabel="x / semi-axis", ylabel="y / semi-axis", title="the end of the run", aspect="equal")
energies.set(
    xlabel="periods",
    ylabel="energy error / (GMm/a)",
    yscale="log",
    title="largest energy error in each 500th of the time",
)
orbits.plot(0, 0, "*", color="gold", ms=12, mec="black")
energies.legend()
figure.savefig("adaptive_kepler.png", dpi=150)
