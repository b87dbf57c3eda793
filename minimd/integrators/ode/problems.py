"""Problems whose state is one array: y′ = f(t, y), and the differential-algebraic F(t, y, y′) = 0.

The index is how often equations must be differentiated until they determine y′. Constraints that appear on the way are
hidden, and a start must obey them too. E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic
Systems by Runge-Kutta Methods (1989); E. Hairer, G. Wanner, Solving ODEs II (1996), VI and VII.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from minimd.integrators.method import Array, Problem
from minimd.integrators.ode.functions import (
    Function,
    check_finite,
    checked_values,
    forward_differences,
    of_time_and_state,
)
from minimd.integrators.ode.newton import FixedPoint, Newton, Solver, checked_solver

__all__ = ["FirstOrder"]


class FirstOrder:
    """y′ = f(t, y).

    Parameters
    ----------
    f : function of t and y, or of y.  jacobian : (n, n) ∂f/∂y as a function of the same,
        found by finite differences if not given.
    solver : Newton() or FixedPoint().
    """

    shape, remark = None, ""

    def __repr__(self) -> str:
        return f"{type(self).__name__}(f)"

    def __init__(self, f: Function, jacobian: Function | None = None, solver: Solver = Newton()) -> None:
        self._f = of_time_and_state(f, "f")
        self.jacobian = jacobian if jacobian is None else of_time_and_state(jacobian, "jacobian")
        self.solver = checked_solver(solver)

    def begin(self, start: ArrayLike, t0: float = 0.0) -> Array:
        """The start as a state of length n.

        Raises ValueError if it is not an array of one dimension, or a value is not finite; from f,
        if its answers have another shape.
        """
        y = np.array(start, dtype=float)
        if y.ndim != 1 or y.size == 0:
            raise ValueError(
                f"the start must be a one-dimensional array with at least one element; got shape {y.shape}"
            )
        check_finite(y)
        return y

    def field(self, t: float, y: Array) -> Array:
        """f(t, y)."""
        return checked_values(self._f(t, y), y.shape, "f")

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """y′ − f(t, y)."""
        return slope - self.field(t, y)


class DifferentialAlgebraic(Problem):
    """F(t, y, y′) = 0: what the forms of differential-algebraic problems have in common.

    begin refuses a start that violates a constraint, given or hidden, or that has no solution through it, with a
    ValueError. It solves for the algebraic variables; field is zero for those.

    Attributes of each problem
    --------------------------
    index : how often equations must be differentiated until they determine y′; known once there is a start.
    levels : (n,) how many powers of 1/h amplify errors of each variable: 0, or 1 and 2 for those of index 2 and 3.
    """

    shape = None
    index: int
    levels: Array

    def __init__(self, solver: Solver) -> None:
        if not isinstance(solver, Newton) or isinstance(solver, FixedPoint):
            raise TypeError(
                "differential-algebraic equations need Newton's method, they are no fixed-point equations; got solver "
                f"= {solver!r}"
            )
        self.solver = solver

    def state_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y, (n, n)."""
        return forward_differences(lambda x: self.residual(t, x, slope), y, self.residual(t, y, slope))

    def slope_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y′, (n, n)."""
        return forward_differences(lambda x: self.residual(t, y, x), slope, self.residual(t, y, slope))

    def error_weights(self, h: float) -> Array:
        """(n,) min(1, |h|)^level: the factors of the errors of variables in an error norm.

        An error ε of the equations appears as ε/h in variables of index 2 and as ε/h² in those of index 3. These act on
        the solution with the inverse factors. The unit of time should be one in which the solution varies.
        E. Hairer, G. Wanner, Solving ODEs II (1996), VII.4 and the code RADAU5.
        """
        return min(1.0, abs(h)) ** self.levels
