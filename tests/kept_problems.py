"""Problems with invariants: Kepler's and a rigid body."""

import numpy as np
from references import load

from minimd.integrators import (
    FirstOrder,
    Invariants,
    SecondOrder,
    run_until,
)

START = (0.4, 0.0), (0.0, 2.0)  # Kepler, e = 0.6, at its pericentre, H = −1/2
PERIOD = 2.0 * np.pi
ROUNDING = 4e-15  # a few ulp of the terms of the invariant, which are of order one


def attraction(q):
    return -q / (q @ q) ** 1.5


def energy(q, v):
    return 0.5 * (v @ v) - 1.0 / np.sqrt(q @ q)


def energy_slope(q, v):
    return np.array([q / (q @ q) ** 1.5, v])


def angular_momentum(q, v):
    return q[0] * v[1] - q[1] * v[0]


def eccentricity_vector(q, v):
    return v[1] * angular_momentum(q, v) - q[0] / np.sqrt(q @ q), -v[0] * angular_momentum(q, v) - q[1] / np.sqrt(q @ q)


def direction(q, v):
    """Of the pericentre."""
    x, y = eccentricity_vector(q, v)
    return np.arctan2(y, x)


KEPLER = SecondOrder(attraction)
ENERGY = Invariants(energy, energy_slope)
INERTIA = np.array([1.0, 2.0, 4.0])
RIGID_BODY = FirstOrder(lambda y: np.cross(y, y / INERTIA))
CASIMIR_AND_ENERGY = Invariants(lambda y: [y @ y, 0.5 * y @ (y / INERTIA)], lambda y: [2.0 * y, y / INERTIA])
TURNING = np.array([0.1, 1.0, 0.3])  # about the unstable axis


def values(g, solution):
    return np.array([g(q, v) for q, v in zip(solution.q, solution.v, strict=True)])


def kepler_end():
    """Closed form, at t = 7.5."""
    reference = load("geometric/problems.json")["kepler_e0.6_T7.5"]
    return np.array([*reference["q"], *reference["p"]], dtype=float)


def end_error(method, timestep, problem=KEPLER):
    return np.linalg.norm(run_until(problem, method(timestep), START, 7.5).y[-1] - kepler_end())


def slope(method, timesteps, problem=KEPLER):
    return np.polyfit(np.log(timesteps), np.log([end_error(method, h, problem) for h in timesteps]), 1)[0]
