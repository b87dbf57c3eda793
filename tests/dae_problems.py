"""Differential-algebraic problems with known solutions, mechanisms on manifolds, and how far a path is from them."""

import numpy as np
from numpy import cos, exp, sin

import minimd.integrators as mi

GRAVITY = 13.750371636040745654980191559621  # a pendulum of length 1 released from the horizontal then has the period 2
# E. Hairer, C. Lubich, M. Roche (1989): test problems of index 2 and 3
INDEX1 = (mi.Hessenberg1(lambda t, y, z: cos(t) + y * y - sin(t) ** 2 + z * z - exp(-2 * t),
                         lambda t, y, z: z * exp(y) - exp(sin(t) - t)),
          lambda t: ([sin(t)], [exp(-t)]))  # fmt: skip
INDEX2 = (mi.Hessenberg2(lambda y, z: [y[0] * y[1] ** 2 * z[0] ** 2, y[0] ** 2 * y[1] ** 2 - 3 * y[1] ** 2 * z[0]],
                         lambda y: y[0] ** 2 * y[1] - 1),
          lambda t: ([exp(t), exp(-2 * t)], [exp(2 * t)]))  # fmt: skip
INDEX3 = (mi.Hessenberg3(lambda y, z: [2 * y[0] * y[1] * z[0] * z[1], -y[0] * y[1] * z[1] ** 2],
                         lambda y, z, u: [(y[0] * y[1] + z[0] * z[1]) * u[0], -y[0] * y[1] ** 2 * z[1] ** 2 * u[0]],
                         lambda y: y[0] * y[1] ** 2 - 1),
          lambda t: ([exp(2 * t), exp(-t)], [exp(2 * t), exp(-t)], [exp(t)]))  # fmt: skip
# the same solution as INDEX2, with z linear: Gauss methods whose z is off by order 1 bear no more
INDEX2_LINEAR = (mi.Hessenberg2(lambda y, z: [y[0] * y[1] * z[0], y[1] ** 2 * z[0] - 3 * y[1]],
                                lambda y: y[0] ** 2 * y[1] - 1), INDEX2[1])  # fmt: skip
HORIZONTAL = (1.0, 0.0), (0.0, 0.0)
SWING_START = ([np.sin(1.0), -np.cos(1.0)], [0.0, 0.0])


def pendulum(length=1.0, time=1.0):
    fall = np.array([0.0, -GRAVITY * length / time**2])
    return mi.Mechanical(1.0, lambda q: fall, lambda q: (q @ q - length**2) / 2, lambda q: q)


def implicit_pendulum():
    """q′ = v, v′ = −λ q − g, 0 = (q² − 1)/2, as F alone."""
    return mi.Implicit(
        lambda y, slope: [*slope[:2] - y[2:4], *slope[2:4] + y[4] * y[:2] + [0, GRAVITY], (y[:2] @ y[:2] - 1) / 2]
    )


def stabilized_pendulum():
    """Index 2: q′ = v − q μ, v′ = −q λ − g, 0 = g = G v (C. W. Gear, B. Leimkuhler, G. K. Gupta (1985))."""
    f = lambda y, z: [*y[2:] - y[:2] * z[1], *-y[:2] * z[0] - [0, GRAVITY]]  # noqa: E731
    return mi.Hessenberg2(f, lambda y: [(y[:2] @ y[:2] - 1) / 2, y[:2] @ y[2:]])


def reduced_pendulum():
    """Index 1: the multiplier from the second derivative of the constraint."""
    g = lambda y, z: y[2] ** 2 + y[3] ** 2 - z[0] * (y[0] ** 2 + y[1] ** 2) - GRAVITY * y[1]  # noqa: E731
    return mi.Hessenberg1(lambda y, z: [y[2], y[3], -y[0] * z[0], -y[1] * z[0] - GRAVITY], g)


def path_of_x():
    """x′ = z, 0 = x − t."""
    return mi.Hessenberg2(lambda z: z, lambda t, y: y - t)


def implicit_path_of_x():
    return mi.Implicit(lambda t, y, slope: [slope[0] - y[1], y[0] - t])


def robertson():
    def rates(y, z):
        slow, fast, pair = 0.04 * y[0], 1e4 * y[1] * z[0], 3e7 * y[1] ** 2
        return [fast - slow, slow - fast - pair]

    return mi.Hessenberg1(rates, lambda y, z: y[0] + y[1] + z[0] - 1.0)


def measured_orders(problem, solution, method, n_steps=(16, 32), span=0.5):
    """log₂ of the ratio of the largest errors of each part at the end, the number of steps being doubled."""
    errors = []
    for n in n_steps:
        end = problem.parts(mi.run_steps(problem, method(span / n), solution(0.0), n).y[-1])
        errors.append([np.abs(part - exact).max() for part, exact in zip(end, solution(span), strict=True)])
    return np.log2(np.divide(*errors))


def swing():
    """A pendulum of length 1, for RATTLE; gravity is 1 along −y, here and below."""
    return mi.Holonomic(lambda q: np.array([0.0, -1.0]), lambda q: [0.5 * (q @ q - 1.0)], lambda q: q[None, :])


def double_pendulum(with_jacobian=True):
    """Masses 1 and 2 on rods of lengths 1 and ½; q = (x₁, y₁, x₂, y₂)."""

    def jacobian(q):
        d = q[2:] - q[:2]
        return [[q[0], q[1], 0.0, 0.0], [-d[0], -d[1], d[0], d[1]]]

    fall, masses = np.array([0.0, -1.0, 0.0, -1.0]), [1.0, 1.0, 2.0, 2.0]
    lengths = lambda q: [0.5 * (q[:2] @ q[:2] - 1.0), 0.5 * ((q[2:] - q[:2]) @ (q[2:] - q[:2]) - 0.25)]  # noqa: E731
    return mi.Holonomic(lambda q: fall, lengths, jacobian if with_jacobian else None, masses=masses)


def on_rods(a, b, u, w):
    """(q, v) of the double pendulum at two angles with two rates."""
    q1, q2 = np.array([np.sin(a), -np.cos(a)]), 0.5 * np.array([np.sin(b), -np.cos(b)])
    v1, v2 = u * np.array([np.cos(a), np.sin(a)]), 0.5 * w * np.array([np.cos(b), np.sin(b)])
    return np.concatenate([q1, q1 + q2]), np.concatenate([v1, v1 + v2])


DOUBLE_START = on_rods(1.0, 2.0, 0.0, 0.0)
