"""Small problems whose solutions or invariants are known, and what is measured on them, for laws of integrators."""

import numba
import numpy as np
from scipy.integrate import solve_ivp

import minimd.integrators as mi

NOT_BARE = [mi.RESPA, *mi.THERMOSTATS.values()]  # they need bonds, or a temperature
DETERMINISTIC = [method for method in mi.METHODS.values() if method not in NOT_BARE]
ONE_STEP = [method for method in DETERMINISTIC if not hasattr(method, "n_past")]  # a BDF looks back
SPLITTINGS = [method for method in mi.SPLITTINGS.values() if method not in NOT_BARE]
GAUSS = [mi.GaussLegendre1, mi.GaussLegendre2, mi.GaussLegendre3, mi.GaussLegendre4]
RADAU = [mi.ImplicitEuler, mi.RadauIIA2, mi.RadauIIA3]
ROUNDING = 4e-15  # a few ulp of the terms of an invariant, which are of order one
PERIOD = 2.0 * np.pi


@numba.njit(cache=True)
def attraction(q):
    """A unit mass at the origin, GM = 1."""
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def henon_heiles_energy(q, v):
    return ((v * v).sum(axis=0) + (q * q).sum(axis=0)) / 2.0 + q[0] ** 2 * q[1] - q[1] ** 3 / 3.0


@numba.njit(cache=True)
def henon_heiles_force(q):
    return np.array([-q[0] - 2.0 * q[0] * q[1], -q[1] - q[0] * q[0] + q[1] * q[1]])


def pericentre(e):
    """(q, v) on the orbit with semi-axis 1 and period 2π."""
    return (1.0 - e, 0.0), (0.0, np.sqrt((1.0 + e) / (1.0 - e)))


def kepler_orbit(time, e=0.6):
    """(q, v) on the orbit from the pericentre, by Kepler's equation x − e sin x = t, solved to rounding."""
    x = time
    for _ in range(50):
        x -= (x - e * np.sin(x) - time) / (1.0 - e * np.cos(x))
    b = np.sqrt(1.0 - e * e)
    return np.array([np.cos(x) - e, b * np.sin(x), *np.array([-np.sin(x), b * np.cos(x)]) / (1.0 - e * np.cos(x))])


KEPLER = mi.SecondOrder(attraction)
KEPLER_START = pericentre(0.6)  # H = −1/2
HENON_HEILES = mi.SecondOrder(henon_heiles_force), ((0.0, 0.1), (0.5, 0.0))
OSCILLATOR = mi.SecondOrder(lambda q: -q)
ONE = (1.0,), (0.0,)
# H = (1 + |q|²)(1 + |v|²)/2 + q₀v₁/2: each of q′ and v′ depends on both
TWISTED = mi.Partitioned(
    lambda q, v: (1.0 + q @ q) * v + [0.0, 0.5 * q[0]], lambda q, v: -(1.0 + v @ v) * q - [0.5 * v[1], 0.0]
)


# The same in a field that oscillates: H(t, q, v) = that − q₀ cos 2t + v₁ sin t / 5
def driven_g(t, q, v):
    return (1.0 + q @ q) * v + [0.0, 0.5 * q[0] + 0.2 * np.sin(t)]


def driven_f(t, q, v):
    return -(1.0 + v @ v) * q + [np.cos(2.0 * t) - 0.5 * v[1], 0.0]


# H = (1 + |q|²)|v|²/2 + |q|²/2 + q₁: not separable, and even in v
SWAYING = mi.Partitioned(lambda q, v: (1.0 + q @ q) * v, lambda q, v: -(1.0 + v @ v) * q - [0.0, 1.0])
DRIVEN = mi.Partitioned(driven_g, driven_f)
TWISTED_START = (0.5, -0.2), (0.3, 0.6)


def energy(q, v):
    """Of KEPLER."""
    return 0.5 * (v @ v) - 1.0 / np.sqrt(q @ q)


def energy_slope(q, v):
    return np.array([q / (q @ q) ** 1.5, v])


def angular_momentum(q, v):
    return q[0] * v[1] - q[1] * v[0]


def energy_errors(solution):
    """Of KEPLER from a pericentre, (n + 1,)."""
    return 0.5 * (solution.v**2).sum(axis=1) - 1.0 / np.linalg.norm(solution.q, axis=1) + 0.5


ENERGY = mi.Invariants(energy, energy_slope)
INERTIA = np.array([1.0, 2.0, 4.0])
RIGID_BODY = mi.FirstOrder(lambda y: np.cross(y, y / INERTIA))
CASIMIR_AND_ENERGY = mi.Invariants(lambda y: [y @ y, 0.5 * y @ (y / INERTIA)], lambda y: [2.0 * y, y / INERTIA])
TURNING = np.array([0.1, 1.0, 0.3])  # about the unstable axis


def reference(problem, start, time, t0=0.0):
    """The solution by SciPy's eighth-order method, to some 1e-13."""
    y = problem.begin(start)
    return solve_ivp(problem.field, (t0, t0 + time), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def slope(error, timesteps):
    """Exponent p of error ∝ Δtᵖ."""
    return np.polyfit(np.log(timesteps), np.log([error(h) for h in timesteps]), 1)[0]


def kepler_slope(method, timesteps, problem=KEPLER):
    """Measured order at t = 2."""
    end = lambda h: mi.run_until(problem, method(h), KEPLER_START, 2.0).y[-1]  # noqa: E731
    return slope(lambda h: np.linalg.norm(end(h) - kepler_orbit(2.0)), timesteps)


def jacobian(problem, method, start, h, t0=0.0):
    """Φ′, the derivative of a step by the state, by differences of order six: truncation and rounding, some 1e-12."""
    y0, delta = problem.begin(start), 3e-3
    step, weights = method.on(problem), {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    unit = delta * np.eye(y0.size)
    difference = lambda k, e: step(t0, y0 + k * e, h) - step(t0, y0 - k * e, h)  # noqa: E731
    return np.column_stack([sum(w * difference(k, e) for k, w in weights.items()) / delta for e in unit])


def symplecticity_defect(m):
    """Largest element of MᵀJM − J."""
    n = len(m) // 2
    j = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return np.abs(m.T @ j @ m - j).max()
