"""Kicks and drifts on a harmonic oscillator: the longest stable step, and the oscillation of the energy.

    q″ = −ω²q, h = ωΔt, in units of q and v/ω:   drift (1 ch; 0 1)   kick (1 0; −ch 1)   step M(h): product, det M = 1

Powers of M stay bounded while |tr M| < 2. E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006),
I.5.2; B. Leimkuhler, S. Reich, Simulating Hamiltonian Dynamics (2004), 2.6.
"""

from functools import cache

import numpy as np
from numpy.polynomial import Polynomial

from minimd.integrators.method import Array
from minimd.integrators.splitting.substeps import Kick, Substeps, mechanical

__all__ = ["accurate_step", "energy_oscillation", "stability_limit"]

ROUNDING = 1e-12  # of tr M: a product of some forty matrices with entries of order one
REAL = 1e-6  # relative imaginary part that rounding may leave of a double root: about the square root of rounding
SCANNED = 101  # lengths of a step, scanned for the first that is too long
BISECTIONS = 50  # halvings of an interval, down to rounding


def propagation(substeps: Substeps, h: float) -> Array:
    """M(h) of one step, (2, 2), on (q, v/ω).  h : ωΔt.  Substeps Thermalize are left out."""
    matrix = np.eye(2)
    for substep in mechanical(substeps):
        c = substep.coefficient * h
        matrix = np.array([[1.0, 0.0], [-c, 1.0]] if isinstance(substep, Kick) else [[1.0, c], [0.0, 1.0]]) @ matrix
    return matrix


@cache
def stability_limit(substeps: Substeps) -> float:
    """The stability limit of h = ωΔt: |tr M(h)| ≤ 2 for all h up to it; 2 for velocity Verlet, 0 if no step is stable.

    tr M is a polynomial in x = h². It is evaluated once between each two neighboring roots of tr M = ±2, so that no
    window of instability is too narrow to be found. A root at which tr M only touches ±2 is no limit.
    """
    trace = trace_polynomial(substeps)
    roots = np.concatenate([(trace - 2.0).roots(), (trace + 2.0).roots()])
    edges = np.unique(roots[(abs(roots.imag) <= REAL * abs(roots)) & (roots.real > REAL)].real)
    start = 0.0
    for end in edges:
        if abs(np.trace(propagation(substeps, np.sqrt(0.5 * (start + end))))) - 2.0 > ROUNDING:
            break
        start = end
    return float(np.sqrt(start))


def trace_polynomial(substeps: Substeps) -> Polynomial:
    """tr M as a polynomial in x = h², from M = (a hb; −hc d), where a, b, c and d are polynomials in x."""
    (a, b), (c, d) = (Polynomial([1.0]), Polynomial([0.0])), (Polynomial([0.0]), Polynomial([1.0]))
    x = Polynomial([0.0, 1.0])
    for substep in mechanical(substeps):
        if isinstance(substep, Kick):
            c, d = c + substep.coefficient * a, d - substep.coefficient * x * b
        else:
            a, b = a - substep.coefficient * x * c, b + substep.coefficient * d
    return a + d


def energy_oscillation(substeps: Substeps, h: float) -> float:
    """Relative amplitude of the energy of an oscillator: (E_max − E_min)/(E_max + E_min); infinite if unstable.

    A stable step M = (a b; c d) conserves the quadratic form −c q² + (a − d) q v + b v². States lie on an ellipse; on
    its axes the energy (q² + v²)/2 is largest and smallest. Velocity Verlet has h²/(8 − h²):
    1/80 at 20 steps per period.  h : ωΔt.
    """
    (a, b), (c, d) = propagation(substeps, h)
    if abs(a + d) >= 2.0:
        return float("inf")
    form = np.array([[-c, 0.5 * (a - d)], [0.5 * (a - d), b]])
    smallest, largest = np.sort(abs(np.linalg.eigvalsh(form)))
    return float((largest - smallest) / (largest + smallest))


@cache
def accurate_step(substeps: Substeps, oscillation: float) -> float:
    """The largest ωΔt, at most half the stability limit, up to which energy_oscillation stays within a fraction."""
    steps = np.linspace(0.0, 0.5 * stability_limit(substeps), SCANNED)
    too_long = [energy_oscillation(substeps, h) > oscillation for h in steps[1:]]
    if not any(too_long):
        return float(steps[-1])
    low, high = steps[np.argmax(too_long)], steps[np.argmax(too_long) + 1]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if energy_oscillation(substeps, middle) <= oscillation else (low, middle)
    return float(low)
