"""Small problems whose solutions or invariants are known, and what is measured on them, for the laws of the integrators."""

import numba
import numpy as np
from scipy.integrate import solve_ivp

from minimd.integrators import METHODS, Partitioned, SecondOrder

DETERMINISTIC = [method for method in METHODS.values() if not getattr(method, "is_thermostat", False)]
ONE_STEP = [
    method for method in DETERMINISTIC if getattr(method, "n_past", 1) == 1
]  # a BDF looks back at several states
SYMMETRIC = [method for method in ONE_STEP if method.is_symmetric]
NOT_SYMMETRIC = [method for method in ONE_STEP if not method.is_symmetric]
SYMPLECTIC = [method for method in ONE_STEP if method.is_symplectic]
NOT_SYMPLECTIC = [method for method in ONE_STEP if not method.is_symplectic]


@numba.njit
def attraction(q):
    """A unit mass at the origin, GM = 1."""
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


@numba.njit
def henon_heiles_force(q):
    """H = (v² + q²)/2 + x²y − y³/3."""
    return np.array([-q[0] - 2.0 * q[0] * q[1], -q[1] - q[0] * q[0] + q[1] * q[1]])


ECCENTRICITY = 0.6
KEPLER_START = (0.4, 0.0), (0.0, 2.0)  # pericentre of the orbit with semi-axis 1 and period 2π
KEPLER = SecondOrder(attraction)
HENON_HEILES = SecondOrder(henon_heiles_force)
HENON_HEILES_START = (0.0, 0.1), (0.5, 0.0)


# H = (1 + |q|²)(1 + |v|²)/2 + q₀v₁/2: each of q′ and v′ depends on both. Signatures as short as they can be, and full ones.
def twisted_g(q, v):
    return (1.0 + q @ q) * v + np.array([0.0, 0.5 * q[0]])


def twisted_f(q, v):
    return -(1.0 + v @ v) * q - np.array([0.5 * v[1], 0.0])


# The same in a field that oscillates: H(t, q, v) = that − q₀ cos 2t + v₁ sin t / 5
def driven_g(t, q, v):
    return twisted_g(q, v) + np.array([0.0, 0.2 * np.sin(t)])


def driven_f(t, q, v):
    return twisted_f(q, v) + np.array([np.cos(2.0 * t), 0.0])


# H = (1 + |q|²)|v|²/2 + |q|²/2 + q₁: not separable, and even in v
def swaying_g(q, v):
    return (1.0 + q @ q) * v


def swaying_f(q, v):
    return -(1.0 + v @ v) * q - np.array([0.0, 1.0])


SWAYING = Partitioned(swaying_g, swaying_f)
TWISTED = Partitioned(twisted_g, twisted_f)
DRIVEN = Partitioned(driven_g, driven_f)
TWISTED_START = (0.5, -0.2), (0.3, 0.6)


def kepler_orbit(time):
    """(q, v) on the orbit of KEPLER_START, by Kepler's equation x − e sin x = t, solved to rounding."""
    e, x = ECCENTRICITY, time
    for _ in range(50):
        x -= (x - e * np.sin(x) - time) / (1.0 - e * np.cos(x))
    q = np.array([np.cos(x) - e, np.sqrt(1.0 - e * e) * np.sin(x)])
    return np.concatenate([q, np.array([-np.sin(x), np.sqrt(1.0 - e * e) * np.cos(x)]) / (1.0 - e * np.cos(x))])


def reference(problem, start, time, t0=0.0):
    """The solution by SciPy's eighth-order method, to some 1e-13."""
    y = problem.begin(start)
    return solve_ivp(problem.field, (t0, t0 + time), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def slope(error, timesteps):
    """Exponent p of error ∝ Δtᵖ."""
    return np.polyfit(np.log(timesteps), np.log([error(h) for h in timesteps]), 1)[0]


def jacobian(problem, method, start, h, t0=0.0, n_steps=1):
    """Φ′, the derivative of n_steps steps by the state, by differences of order six: truncation and rounding are both some 1e-12."""
    y0, delta = problem.begin(start), 3e-3
    step = method.on(problem)

    def flow(y):
        for n in range(n_steps):
            y = step(t0 + n * h, y, h)
        return y

    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    columns = [
        sum(w * (flow(y0 + k * delta * unit) - flow(y0 - k * delta * unit)) for k, w in weights.items()) / delta
        for unit in np.eye(y0.size)
    ]
    return np.column_stack(columns)


def symplecticity_defect(m):
    """Largest element of MᵀJM − J."""
    n = len(m) // 2
    j = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return np.abs(m.T @ j @ m - j).max()
