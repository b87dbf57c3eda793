"""Solving the equations of an implicit step, down to rounding.

    x ← x − J⁻¹ r(x),   J ≈ ∂r/∂x        simplified Newton: J is kept from solution to solution, and renewed when progress is slow
    x ← x − r(x)                          fixed point: the same with J = 1, for r(x) = x − φ(x)

An iteration has converged when the correction is at rounding, or no longer shrinks and is small: a looser tolerance would make
symmetric and symplectic methods drift. E. Hairer, R. I. McLachlan, A. Razakarivony, BIT Numer. Math. 48, 231 (2008), 4.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgetrf, dgetrs

from minimd.errors import ConvergenceError

Array = NDArray[np.float64]
Residual = Callable[[Array], Array]
EPS = float(np.finfo(float).eps)
SLOW = 0.3  # a correction shrinks at least by this factor per iteration, or the Jacobian is renewed
SMALL = 1e-8  # corrections, relative to the unknowns, that may be taken for rounding once they no longer shrink


class Newton:
    """Newton's method with the Jacobian of the problem, or one by finite differences.

    Parameters
    ----------
    max_iterations : int, after which the equations count as unsolved.
    small : relative size of corrections that may be taken for rounding once they no longer shrink.

    Raises
    ------
    ValueError : if max_iterations is below 1.
    """

    def __init__(self, max_iterations: int = 50, small: float = SMALL) -> None:
        if not max_iterations >= 1:
            raise ValueError(f"max_iterations must be at least 1; max_iterations = {max_iterations!r}")
        self.max_iterations, self.small = max_iterations, small

    def __repr__(self) -> str:
        return f"{type(self).__name__}(max_iterations={self.max_iterations})"

    def iteration(self) -> "Iteration":
        """An iteration with a memory of its own for the Jacobian."""
        return Iteration(self)

    def factorized(self, residual: Residual, x: Array, r: Array, jacobian: Callable[[Array], Array] | None) -> Any:
        """LU factors of ∂r/∂x at x."""
        matrix = finite_differences(residual, x, r) if jacobian is None else jacobian(x)
        factors, pivots, zero_pivot = dgetrf(matrix)
        if zero_pivot:
            raise ConvergenceError(f"the equations of the step are singular: unknown {zero_pivot - 1} is not determined")
        return factors, pivots

    def correction(self, factors: Any, r: Array) -> Array:
        """J⁻¹ r."""
        return dgetrs(*factors, r)[0]


class FixedPoint(Newton):
    """Fixed-point iteration x ← φ(x): no Jacobian, and convergence only for steps that are short enough.

    Parameters
    ----------
    max_iterations, small : as for Newton.
    """

    def __init__(self, max_iterations: int = 200, small: float = SMALL) -> None:
        super().__init__(max_iterations, small)

    def factorized(self, residual: Residual, x: Array, r: Array, jacobian: Callable[[Array], Array] | None) -> Any:
        """Nothing: the Jacobian is taken for 1."""

    def correction(self, factors: Any, r: Array) -> Array:
        """r itself."""
        return r


Solver = Newton


class Iteration:
    """Solves r(x) = 0 again and again, for equations that change little from one time to the next."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self._factors: Any = None
        self._key: Any = None

    def solve(
        self, residual: Residual, x: Array, jacobian: Callable[[Array], Array] | None = None, key: Any = None, scale: Array | float = 0.0
    ) -> Array:
        """x with residual(x) = 0, to rounding.

        Parameters
        ----------
        residual : function of x.  x : first guess.  jacobian : ∂residual/∂x, a function of x.
        key : the kept Jacobian is renewed when this changes, such as the time step.
        scale : sizes of the unknowns below which errors do not matter, as an array or a number.

        Raises
        ------
        ConvergenceError : with the largest residual.
        """
        before, is_fresh = np.inf, False
        for _ in range(self.solver.max_iterations):
            r = residual(x)
            if not r.any():
                return x
            if not np.isfinite(r).all():
                break
            if self._factors is None or key != self._key:
                self._factors, self._key, is_fresh = self.solver.factorized(residual, x, r, jacobian), key, True
            dx = self.solver.correction(self._factors, r)
            x = x - dx
            size = _relative_size(dx, x, scale)
            if size <= EPS or (size > SLOW * before and size <= self.solver.small):
                return x
            if size > SLOW * before and not is_fresh:
                self._factors, before = None, np.inf
            else:
                is_fresh, before = False, size
        self._factors = None
        largest = f"largest residual {np.abs(r).max():.1e}" if np.isfinite(r).all() else "their residual is not finite"
        raise ConvergenceError(f"the equations of the step were not solved: {largest}")


def _relative_size(dx: Array, x: Array, scale: Array | float) -> float:
    """Largest |Δx| over the size of x; without a scale, unknowns much smaller than the largest one count as that one's rounding."""
    floor = np.maximum(np.abs(x), scale if np.any(scale) else np.abs(x).max())
    return float(np.max(np.abs(dx) / np.maximum(floor, np.finfo(float).tiny)))


def finite_differences(function: Residual, x: Array, at_x: Array) -> Array:
    """∂function/∂x by forward differences, one column per unknown, over steps in proportion to the unknowns whatever their unit."""
    jacobian = np.empty((at_x.size, x.size))
    steps = np.sqrt(EPS) * np.maximum(np.abs(x), 1e-3 * (np.abs(x).max() or 1.0))
    for k in range(x.size):
        moved = x.copy()
        moved[k] += steps[k]
        jacobian[:, k] = (function(moved) - at_x) / (moved[k] - x[k])
    return jacobian
