"""Differential-algebraic equations F(t, y, y′) = 0: what all of their forms have in common.

    index 1   y′ = f(t, y, z)       0 = g(t, y, z)                     g_z regular
    index 2   y′ = f(t, y, z)       0 = g(t, y)                        g_y f_z regular
    index 3   y′ = f(t, y, z)       z′ = k(t, y, z, u)    0 = g(t, y)  g_y f_z k_u regular

The index counts how often equations must be differentiated until they say what y′ is. Constraints that appear on the way are
hidden, and a start must obey them too. E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems
by Runge-Kutta Methods (1989); E. Hairer, G. Wanner, Solving ODEs II (1996), VI and VII.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.integrators.ode.arguments import argument_names
from minimd.integrators.ode.differences import forward_differences
from minimd.integrators.ode.newton import FixedPoint, Newton, Solver

Array = NDArray[np.float64]
Function = Callable[..., Any]


class DifferentialAlgebraic:
    """F(t, y, y′) = 0.

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
            raise TypeError(f"differential-algebraic equations need Newton's method, they are no fixed-point equations; got solver = {solver!r}")
        self.solver = solver

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The start as a state, its algebraic variables solved for.

        Raises
        ------
        ValueError : for a start that violates a constraint, given or hidden, or for a problem that has no solution through it.
        """
        raise NotImplementedError

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """F(t, y, y′)."""
        raise NotImplementedError

    def field(self, t: float, y: Array) -> Array:
        """y′ of a consistent state; that of variables which have no equation for it is given as zero."""
        raise NotImplementedError

    def state_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y, (n, n)."""
        return forward_differences(lambda x: self.residual(t, x, slope), y, self.residual(t, y, slope))

    def slope_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y′, (n, n)."""
        return forward_differences(lambda x: self.residual(t, y, x), slope, self.residual(t, y, slope))

    def error_weights(self, h: float) -> Array:
        """(n,) min(1, |h|)^level: by this much errors of a variable are to be multiplied before they are compared with others.

        An error ε of the equations appears as ε/h in variables of index 2, and as ε/h² in those of index 3, from where it acts on
        the solution with the same factors again. Time should have a unit in which the solution varies in about 1.
        E. Hairer, G. Wanner, Solving ODEs II (1996), VII.4 and the code RADAU5.
        """
        return min(1.0, abs(h)) ** self.levels


def begun(problem: Any, start: Any, t0: float) -> Array:
    """The start as a state; constraints are those at time t0."""
    return problem.begin(start, t0) if isinstance(problem, DifferentialAlgebraic) else problem.begin(start)


def error_weights(problem: Any, h: float) -> Array | float:
    """By how much errors of the variables are to be multiplied before they are compared with others; 1 unless algebraic ones are among them."""
    return problem.error_weights(h) if isinstance(problem, DifferentialAlgebraic) else 1.0


def taking(function: Function, names: tuple[str, ...], label: str) -> Function:
    """The function as one of all the named arguments, of which it may take some, under these names and in this order; its answer is flat.

    Raises
    ------
    TypeError : for anything but a function, or one with other arguments.
    """
    known = argument_names(function, label, f"a function of {', '.join(names)}")
    takes = list(names) if known is None else known
    if len(takes) == len(names):
        return lambda *values: np.array(function(*values), dtype=float).reshape(-1)
    if takes != [name for name in names if name in takes]:
        raise TypeError(f"{label} must take some of {', '.join(names)}, in this order and under these names; it takes ({', '.join(takes)})")
    chosen = [names.index(name) for name in takes]
    return lambda *values: np.array(function(*(values[k] for k in chosen)), dtype=float).reshape(-1)
