"""Solving the equations of an implicit step and of a start, down to rounding.

    x ← x − J⁻¹ r(x),   J ≈ ∂r/∂x        simplified Newton: J is kept, and renewed when progress is slow
    x ← x − r(x)                          fixed point: the same with J = 1, for r(x) = x − φ(x)
    x ← x − C⁺ c(x),    C = ∂c/∂x        Gauss-Newton, C⁺ pseudo-inverse of C: the nearest root of fewer equations

An iteration has converged when the correction is at rounding, or is small and no longer shrinks although J is new: with
a looser tolerance symmetric and symplectic methods would drift. Where each unknown has its own size, the columns of J
are scaled by these sizes and its rows to one, because the equations of a differential-algebraic step differ by powers
of h. E. Hairer, R. I. McLachlan, A. Razakarivony, BIT Numer. Math. 48, 231 (2008), 4; E. Hairer, G. Wanner,
Solving ODEs II (1996), IV.8, VII.4.
"""

from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used

from minimd.core.compiled.machine import EPS
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count, checked_kind, checked_number
from minimd.core.structure.errors import ConvergenceError
from minimd.textbook.ode.functions import CENTRAL, Map, central_differences, forward_differences

__all__ = ["FixedPoint", "Newton"]

Sizes = Array | float
SLOW = 0.3  # the Jacobian is renewed if a correction is more than this part of the one before
# corrections, relative to the unknowns, that are taken for rounding once they shrink slowly
NEAR = 16.0 * EPS
# corrections that shrink by less than this factor with a new Jacobian no longer shrink
STALLED = 0.5
# corrections, relative to the unknowns, that are rounding once they no longer shrink: about √EPS
SMALL = 1e-8
SMALL_OF_NOISY = 1e-6  # the same where functions may be numerical derivatives
DEPENDENT = 1e-8  # ratio of singular values below which equations count as dependent on each other
MAX_ITERATIONS = 50
WIDE = 1e-3  # relative step for differences of functions that are numerical derivatives themselves


class Newton:
    """Newton's method with the Jacobian of the problem; if it has none, with one by finite differences.

    Parameters
    ----------
    max_iterations : int; without convergence after so many, the solution has failed.
    small : an iteration has converged if its corrections, relative to x, are below this and no longer shrink.

    Raises
    ------
    ValueError : if max_iterations is not a whole number of at least 1, or small is not positive.
    """

    slow = SLOW

    def __init__(self, max_iterations: int = 50, small: float = SMALL) -> None:
        self.max_iterations = checked_count("max_iterations", max_iterations)
        self.small = checked_number("small", small, "positive and finite")

    def __repr__(self) -> str:
        return f"{type(self).__name__}(max_iterations={self.max_iterations})"

    def iteration(self) -> "Iteration":
        """An iteration that keeps its own Jacobian."""
        return Iteration(self)

    def factorized(
        self, residual: Map, x: Array, r: Array, jacobian: Map | None, sizes: Sizes
    ) -> Any:
        """LU factors of ∂r/∂x at x; where sizes are given, columns are scaled by them and rows to one."""
        matrix = forward_differences(residual, x, r) if jacobian is None else jacobian(x)
        if not np.isfinite(matrix).all():
            raise ConvergenceError("the equations of the step have no finite Jacobian")
        rows = None
        if np.ndim(sizes):
            matrix = matrix * sizes
            rows = 1.0 / np.maximum(np.abs(matrix).max(axis=1), np.finfo(float).tiny)
            matrix *= rows[:, None]
        factors, pivots, zero_pivot = scipy.linalg.lapack.dgetrf(matrix)
        if zero_pivot:
            raise ConvergenceError(
                f"the equations of the step are singular: unknown {zero_pivot - 1} is not determined"
            )
        return factors, pivots, sizes, rows

    def correction(self, factors: Any, r: Array) -> Array:
        """J⁻¹ r."""
        lu, pivots, sizes, rows = factors
        solve = scipy.linalg.lapack.dgetrs
        return solve(lu, pivots, r)[0] if rows is None else sizes * solve(lu, pivots, rows * r)[0]


class FixedPoint(Newton):
    """Fixed-point iteration x ← φ(x), without a Jacobian; for short steps only.
    Parameters, Raises : as Newton."""

    slow = 1.0  # there is no Jacobian to renew

    def __init__(self, max_iterations: int = 200, small: float = SMALL) -> None:
        super().__init__(max_iterations, small)

    def factorized(
        self, residual: Map, x: Array, r: Array, jacobian: Map | None, sizes: Sizes
    ) -> Any:
        """None: the Jacobian is taken for 1."""

    def correction(self, factors: Any, r: Array) -> Array:
        """r itself."""
        return r


def checked_solver(solver: Newton) -> Newton:
    """TypeError for anything but a solver."""
    return checked_kind("solver", solver, Newton, "Newton() or FixedPoint()")


class Iteration:
    """Solves r(x) = 0 repeatedly, for equations that change little between solutions."""

    _factors: Any = None
    _key: Any = None

    def __init__(self, solver: Newton) -> None:
        self.solver = solver

    def solve(
        self,
        residual: Map,
        x: Array,
        jacobian: Map | None = None,
        key: Any = None,
        scale: Sizes = 0.0,
        floor: Sizes | None = None,
        nothing: float = 0.0,
    ) -> Array:
        """x with residual(x) = 0, to rounding, from a first guess.
        Raises ConvergenceError with the largest residual.
        jacobian : ∂residual/∂x, a function of x.
        key : what J depends on beside x, such as the time step; J is renewed when it changes.
        scale : least sizes of the unknowns for relative errors, one number or an array; the equations are scaled by an
            array too.
        floor : the same for corrections that no longer shrink; scale if not given.
        nothing : corrections up to this size end the iteration, whatever the unknowns."""
        floor = scale if floor is None else floor
        before = np.inf
        last = np.inf
        slow = self.solver.slow

        for _ in range(self.solver.max_iterations):
            r = residual(x)
            if not r.any():
                return x
            if not np.isfinite(r).all():
                break
            if self._factors is None or key != self._key:
                self._factors = self.solver.factorized(residual, x, r, jacobian, scale)
                self._key = key
            dx = self.solver.correction(self._factors, r)
            x = x - dx
            size = _relative_size(dx, x, scale)
            if size <= EPS or np.abs(dx).max() <= nothing:
                return x
            if size >= slow * before:
                is_small = _relative_size(dx, x, floor) <= self.solver.small
                if size <= NEAR or (is_small and size > STALLED * last):
                    return x
                last = size if is_small else np.inf
                before = np.inf
                self._factors = None
            else:
                before = size

        self._factors = None
        residual_reached = "their residual is not finite"
        if np.isfinite(r).all():
            residual_reached = f"largest residual {np.abs(r).max():.1e}"
        raise ConvergenceError(f"the equations of the step were not solved: {residual_reached}")


def _relative_size(dx: Array, x: Array, scale: Sizes) -> float:
    """Largest |Δx| relative to |x|, or to scale where that is larger; without a scale, relative to the largest |x|."""
    sizes = np.abs(x)
    sizes = np.maximum(sizes, scale if np.any(scale) else sizes.max())
    return float(np.max(np.abs(dx) / np.maximum(sizes, np.finfo(float).tiny)))


def nearest_root(
    function: Map, x: Array, step: float = CENTRAL, dependent: float = DEPENDENT, size: float = 0.0
) -> Array:
    """A root of the function near the guess, by Gauss-Newton: each correction is the smallest that solves the
    linearized equations.
    step : of central differences, relative to x; WIDE for functions that are numerical derivatives themselves.
    dependent : ratio of singular values below which equations count as dependent.
    size : of the largest variable, where x may be smaller by chance."""
    least = np.inf
    size = max(size, np.abs(x).max())

    for _ in range(MAX_ITERATIONS):
        c = function(x)
        if not (c.any() and np.isfinite(c).all()):
            return x
        jacobian = central_differences(function, x, step, size)
        dx = np.linalg.lstsq(jacobian, -c, rcond=dependent)[0]
        move = np.abs(dx).max()
        largest = max(size, np.abs(x + dx).max())
        if move > 0.5 * least and move <= SMALL_OF_NOISY * largest:
            break
        x = x + dx
        least = move
        if move <= EPS * largest:
            break

    return x


def are_independent(function: Map, x: Array, step: float = CENTRAL, size: float = 0.0) -> bool:
    """Whether the Jacobian of the function has full row rank."""
    sizes = np.linalg.svd(central_differences(function, x, step, size), compute_uv=False)
    return bool(function(x).size <= x.size and sizes[-1] > DEPENDENT * sizes[0])
