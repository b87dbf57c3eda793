"""Störmer's two-step recursion for q″ = f(q), and its summed form.

    two-step   q_{n+1} − 2q_n + q_{n−1} = Δt² f(q_n)
    summed     d_n = d_{n−1} + Δt² f(q_n),   q_{n+1} = q_n + d_n

Both are velocity Verlet with the velocities eliminated, v_n = (q_{n+1} − q_{n−1})/2Δt. In exact arithmetic they give
the same path. In floating point the recursion adds Δt² f to numbers of order one, and its rounding errors grow as n² ε.
The summed form adds Δt² f to the small increments first, and its errors grow as n ε (P. Henrici, Discrete Variable
Methods in ODEs (1962), 6.4; E. Hairer, S. P. Nørsett, G. Wanner, Solving ODEs I (1993), III.10).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from minimd.integrators.method import Array
from minimd.integrators.ode.drivers import Solution
from minimd.structure.checks import checked_count, checked_number

__all__ = ["stormer_summed", "stormer_two_step"]

Acceleration = Callable[[Array], ArrayLike]


def stormer_two_step(f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int) -> Solution:
    """The two-step recursion, started with q₁ = q₀ + Δt v₀ + ½Δt² f(q₀).

    Parameters
    ----------
    f : acceleration of positions, both of the shape of q0 [length/time²].  q0, v0 : start [length], [length/time].
    timestep : Δt [time], negative to run backwards.  n_steps : at least 1.

    Raises
    ------
    ValueError : if the time step is zero or not finite, n_steps not a whole number, at least 1, or the shapes of q0,
        v0 and f(q0) differ.
    """
    q, _ = _start(f, q0, v0, timestep, n_steps)
    for n in range(1, n_steps + 1):
        q[n + 1] = 2.0 * q[n] - q[n - 1] + timestep**2 * np.asarray(f(q[n]))
    return _solution(q, q[1:] - q[:-1], v0, timestep)


def stormer_summed(f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int) -> Solution:
    """The recursion for the increments d_n = q_{n+1} − q_n: the same path,
    with far less round-off over many small steps.

    Parameters, Raises : as stormer_two_step.
    """
    q, d = _start(f, q0, v0, timestep, n_steps)
    increments = np.empty_like(q[1:])
    increments[0] = d
    for n in range(1, n_steps + 1):
        increments[n] = increments[n - 1] + timestep**2 * np.asarray(f(q[n]))
        q[n + 1] = q[n] + increments[n]
    return _solution(q, increments, v0, timestep)


def _start(f: Acceleration, q0: ArrayLike, v0: ArrayLike, timestep: float, n_steps: int) -> tuple[Array, Array]:
    """Memory for q₀ … q_{n+1} with q₀ and q₁ filled in, and the first increment."""
    q0, v0 = np.asarray(q0, dtype=float), np.asarray(v0, dtype=float)
    checked_number("timestep", timestep, "finite and not zero")
    checked_count("n_steps", n_steps)
    a0 = np.asarray(f(q0), dtype=float)
    if not q0.shape == v0.shape == a0.shape:
        raise ValueError(f"q0, v0 and f(q0) must have the same shape; got {q0.shape}, {v0.shape} and {a0.shape}")
    q, d = np.empty((n_steps + 2, *q0.shape)), timestep * v0 + 0.5 * timestep**2 * a0
    q[0], q[1] = q0, q0 + d
    return q, d


def _solution(q: Array, increments: Array, v0: ArrayLike, timestep: float) -> Solution:
    """The path without the position after the end, which is needed for the last velocity only."""
    n_steps = len(q) - 2
    v = np.empty_like(q[:-1])
    v[0] = v0
    v[1:] = (increments[1:] + increments[:-1]) / (2.0 * timestep)
    t = np.linspace(0.0, n_steps * timestep, n_steps + 1)
    y = np.concatenate([part.reshape(len(t), -1) for part in (q[:-1], v)], axis=1)
    return Solution(t, y, nfev=n_steps + 1, shape=q.shape[1:])
