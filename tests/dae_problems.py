"""Differential-algebraic problems with known solutions, and how far a path is from them."""

import numpy as np
from numpy import cos, exp, sin

from minimd.integrators import Hessenberg1, Hessenberg2, Hessenberg3, Mechanical, run_steps

GRAVITY = (
    13.750371636040745654980191559621  # of a pendulum of length 1 released from the horizontal, whose period is then 2
)

INDEX1 = (
    Hessenberg1(
        lambda t, y, z: cos(t) + y * y - sin(t) ** 2 + z * z - exp(-2 * t), lambda t, y, z: z * exp(y) - exp(sin(t) - t)
    ),
    lambda t: ([sin(t)], [exp(-t)]),
)
# E. Hairer, C. Lubich, M. Roche (1989): test problems of index 2 and 3
INDEX2 = (
    Hessenberg2(
        lambda y, z: [y[0] * y[1] ** 2 * z[0] ** 2, y[0] ** 2 * y[1] ** 2 - 3 * y[1] ** 2 * z[0]],
        lambda y: y[0] ** 2 * y[1] - 1,
    ),
    lambda t: ([exp(t), exp(-2 * t)], [exp(2 * t)]),
)
INDEX3 = (
    Hessenberg3(
        lambda y, z: [2 * y[0] * y[1] * z[0] * z[1], -y[0] * y[1] * z[1] ** 2],
        lambda y, z, u: [(y[0] * y[1] + z[0] * z[1]) * u[0], -y[0] * y[1] ** 2 * z[1] ** 2 * u[0]],
        lambda y: y[0] * y[1] ** 2 - 1,
    ),
    lambda t: ([exp(2 * t), exp(-t)], [exp(2 * t), exp(-t)], [exp(t)]),
)
# the same solution, with z linear: Gauss methods whose z is off by order 1 bear no more
INDEX2_LINEAR = (
    Hessenberg2(lambda y, z: [y[0] * y[1] * z[0], y[1] ** 2 * z[0] - 3 * y[1]], lambda y: y[0] ** 2 * y[1] - 1),
    lambda t: ([exp(t), exp(-2 * t)], [exp(2 * t)]),
)
PROBLEMS = {1: INDEX1, 2: INDEX2, 3: INDEX3}


def pendulum():
    return Mechanical(1.0, lambda q: np.array([0.0, -GRAVITY]), lambda q: (q @ q - 1) / 2, lambda q: q)


HORIZONTAL = (1.0, 0.0), (0.0, 0.0)


def errors(problem, solution, method, n_steps, span=0.5):
    """Largest error of each part of the state at the end of the span."""
    path = run_steps(problem, method(span / n_steps), solution(0.0), n_steps)
    return np.array(
        [np.abs(part - exact).max() for part, exact in zip(problem.parts(path.y[-1]), solution(span), strict=True)]
    )


def measured_orders(problem, solution, method, n_steps=(16, 32), span=0.5):
    """log₂ of the ratio of the errors of each part, the number of steps being doubled."""
    coarse, fine = (errors(problem, solution, method, n, span) for n in n_steps)
    return np.log2(coarse / fine)
