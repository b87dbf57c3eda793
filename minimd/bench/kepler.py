"""Kepler's ellipse for work-precision: every explicit splitting and every symmetric implicit method, over some periods."""

from collections.abc import Iterator, Sequence
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.integrators.methods import IMPLICIT, SPLITTINGS
from minimd.structure.errors import ConvergenceError

ECCENTRICITY, PERIODS = 0.6, 20
TEXT = f"Kepler's ellipse, eccentricity {ECCENTRICITY}, {PERIODS} periods; units a (half axis) and v (velocity in a circle)"
Q0 = np.array([1.0 - ECCENTRICITY, 0.0])
V0 = np.array([0.0, np.sqrt((1.0 + ECCENTRICITY) / (1.0 - ECCENTRICITY))])
END = 2.0 * np.pi * PERIODS


def attraction(q):
    """−q/|q|³."""
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def about_line(time: NDArray[np.float64], energies: NDArray[np.float64]) -> tuple[float, float]:
    """Oscillation, the standard deviation about the line of regression, and drift, its |slope|; infinite if the run failed.  Both (T,)."""
    if not np.isfinite(energies).all():
        return np.inf, np.inf
    slope, start = np.polyfit(time, energies, 1)
    return float((energies - start - slope * time).std()), float(abs(slope))


def runs(costs: Sequence[int], repeats: int) -> Iterator[tuple[str, int, float, float, float, float, float, float]]:
    """For each run: method, order, Δt, forces per unit of time, seconds, oscillation, drift, distance.  costs : ten times the forces per time."""
    from numba import njit

    problem = md.integrators.SecondOrder(njit(attraction))
    for method in (*SPLITTINGS.values(), *(method for method in IMPLICIT.values() if method.is_symmetric)):
        for cost in costs:
            n = PERIODS * max(1, round(cost / method.stages * END / PERIODS / 10))  # a tenth of the forces: orbits are slow
            seconds = np.inf
            try:
                for _ in range(repeats):
                    started = perf_counter()
                    path = md.integrators.run_steps(problem, method(END / n), (Q0, V0), n, every=max(1, n // (20 * PERIODS)))
                    seconds = min(seconds, perf_counter() - started)
            except (ConvergenceError, ArithmeticError):
                yield method.name, method.order, END / n, cost, np.inf, np.inf, np.inf, np.inf
                continue
            energy = 0.5 * (path.v**2).sum(axis=1) - 1.0 / np.linalg.norm(path.q, axis=1)
            distance = float(np.linalg.norm(path.q[-1] - Q0))
            yield method.name, method.order, END / n, path.nfev / END, seconds, *about_line(path.t / END, energy), distance
