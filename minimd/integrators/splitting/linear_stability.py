"""What a row of kicks and drifts does to a harmonic oscillator: up to which step it stays bounded, and how far its energy swings.

    q″ = −ω²q, h = ωΔt, in units of q and v/ω:   drift (1 ch; 0 1)   kick (1 0; −ch 1)   step M(h), the product, det M = 1

Powers of M stay bounded while |tr M| < 2. E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), I.5.2;
B. Leimkuhler, S. Reich, Simulating Hamiltonian Dynamics (2004), 2.6.
"""

from functools import cache

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from minimd.integrators.splitting.substeps import Kick, Substeps, Thermalize

ROUNDING = 1e-12  # of tr M: products of some forty matrices with entries of order one
REAL = 1e-6  # imaginary part of a double root, relative, that rounding may leave
SCANNED = 101  # steps at which a first crossing is sought
BISECTIONS = 50  # halvings: down to rounding


def propagation(row: Substeps, h: float) -> NDArray[np.float64]:
    """M(h) of one step, (2, 2), on (q, v/ω).  h : ωΔt.  Contacts with a bath are left out."""
    matrix = np.eye(2)
    for substep in _mechanical(row):
        c = substep.coefficient * h
        matrix = np.array([[1.0, 0.0], [-c, 1.0]] if isinstance(substep, Kick) else [[1.0, c], [0.0, 1.0]]) @ matrix
    return matrix


@cache
def stability_limit(row: Substeps) -> float:
    """The largest ωΔt up to which every step is stable: |tr M(h)| ≤ 2 for all h below it; 2 for velocity Verlet, 0 if there is none.

    tr M is a polynomial in x = h². Its sections between the roots of tr M = ±2 are looked at one by one, so that no window of
    instability is too narrow to be seen; where tr M only touches ±2, the limit is not yet reached.
    """
    trace = trace_polynomial(row)
    roots = np.concatenate([(trace - 2.0).roots(), (trace + 2.0).roots()])
    edges = np.unique(roots[(abs(roots.imag) <= REAL * abs(roots)) & (roots.real > REAL)].real)
    start = 0.0
    for end in edges:
        if _trace_excess(row, 0.5 * (start + end)) > ROUNDING:
            return float(np.sqrt(start))
        start = end
    return float(np.sqrt(start))


def trace_polynomial(row: Substeps) -> Polynomial:
    """tr M as a polynomial in x = h²: of h from the left column of a drift and the lower row of a kick, x each time they meet."""
    (a, b), (c, d) = (Polynomial([1.0]), Polynomial([0.0])), (Polynomial([0.0]), Polynomial([1.0]))  # M = (a hb; −hc d)
    x = Polynomial([0.0, 1.0])
    for substep in _mechanical(row):
        if isinstance(substep, Kick):
            c, d = c + substep.coefficient * a, d - substep.coefficient * x * b
        else:
            a, b = a - substep.coefficient * x * c, b + substep.coefficient * d
    return a + d


def energy_oscillation(row: Substeps, h: float) -> float:
    """Amplitude of the energy of an oscillator around its mean, relative: (E_max − E_min)/(E_max + E_min); infinite if unstable.

    A stable step keeps the quadratic form −c q² + (a − d) q v + b v² of M = (a b; c d); the energy (q² + v²)/2 swings between the
    axes of that ellipse. Velocity Verlet has h²/(8 − h²): an 80th part at 20 steps a period.  h : ωΔt.
    """
    (a, b), (c, d) = propagation(row, h)
    if abs(a + d) >= 2.0:
        return float("inf")
    form = np.array([[-c, 0.5 * (a - d)], [0.5 * (a - d), b]])
    smallest, largest = np.sort(abs(np.linalg.eigvalsh(form)))
    return float((largest - smallest) / (largest + smallest))


@cache
def accurate_step(row: Substeps, oscillation: float) -> float:
    """The largest ωΔt, at most half the stability limit, up to which the energy of an oscillator swings by no more than this fraction."""
    steps = np.linspace(0.0, 0.5 * stability_limit(row), SCANNED)
    too_long = [energy_oscillation(row, h) > oscillation for h in steps[1:]]
    if not any(too_long):
        return float(steps[-1])
    low, high = steps[np.argmax(too_long)], steps[np.argmax(too_long) + 1]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if energy_oscillation(row, middle) <= oscillation else (low, middle)
    return float(low)


def _mechanical(row: Substeps) -> Substeps:
    return tuple(substep for substep in row if not isinstance(substep, Thermalize))


def _trace_excess(row: Substeps, x: float) -> float:
    return float(abs(np.trace(propagation(row, np.sqrt(x)))) - 2.0)
