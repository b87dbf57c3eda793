"""Consistent starts, which obey all constraints, given and hidden: numerical time derivatives, and the nearest root.

    c(ε) = g(t + ε, y + ε y′ + ε²/2 y″)        dᵏg/dtᵏ along the solution is dᵏc/dεᵏ at ε = 0
    x ← x − C⁺ c(x)                            Gauss-Newton, C⁺ pseudo-inverse of C = ∂c/∂x: the nearest root

C. C. Pantelides, SIAM J. Sci. Stat. Comput. 9, 213 (1988); B. Leimkuhler, L. R. Petzold, C. W. Gear, SIAM J. Numer.
Anal. 28, 205 (1991).
"""

from collections.abc import Callable

import numpy as np

from minimd.compiled.machine import EPS
from minimd.integrators.method import Array
from minimd.integrators.ode.functions import CENTRAL, central_differences

DEPENDENT = 1e-8  # ratio of singular values below which constraints count as dependent on each other
MAX_ITERATIONS = 50
RESTING = 1e-13  # lower rates are rounding, and the path is at rest [1/time]
WIDE = 1e-3  # relative step for differences of functions that are numerical derivatives themselves
SMALL = 1e-6  # relative corrections below which they are taken for rounding once they no longer shrink
KEPT = 1e-11  # relative moves below which a start is left as it is: the accuracy of the derivatives
REFUSED = 1e-8  # and above which it is refused as inconsistent; moves between the two are made without a warning


def unit_of_time(y: Array, *derivatives: Array) -> float:
    """The time in which a path y + ε y′ + ε²/2 y″ changes by its own size; 1 if it rests."""
    size = np.abs(y).max() or 1.0
    rates = [0.0, *((np.abs(d).max() / size) ** (1.0 / k) for k, d in enumerate(derivatives, start=1))]
    return 1.0 / max(rates) if max(rates) > RESTING else 1.0


def nearest_root(
    function: Callable[[Array], Array], x: Array, step: float = CENTRAL, dependent: float = DEPENDENT, size: float = 0.0
) -> Array:
    """A root of the function near the guess, by Gauss-Newton:
    each correction is the smallest that solves the linearized equations.

    step : of central differences, relative to x; wide for functions that are numerical derivatives themselves.
    dependent : ratio of singular values below which equations count as dependent.  size : of the largest variable,
        where x may be smaller by chance.
    """
    best, least, size = x, np.inf, max(size, np.abs(x).max())
    for _ in range(MAX_ITERATIONS):
        c = function(x)
        if not (c.any() and np.isfinite(c).all()):
            return best if c.any() else x
        dx = np.linalg.lstsq(central_differences(function, x, step, size), -c, rcond=dependent)[0]
        move, largest = float(np.abs(dx).max()), float(max(size, np.abs(x + dx).max()))
        if move > 0.5 * least and move <= SMALL * largest:
            return best
        x, best, least = x + dx, x + dx, move
        if move <= EPS * largest:
            return x
    return best


def are_independent(function: Callable[[Array], Array], x: Array, step: float = CENTRAL, size: float = 0.0) -> bool:
    """Whether the Jacobian of the function has full row rank."""
    sizes = np.linalg.svd(central_differences(function, x, step, size), compute_uv=False)
    return bool(function(x).size <= x.size and sizes[-1] > DEPENDENT * sizes[0])
