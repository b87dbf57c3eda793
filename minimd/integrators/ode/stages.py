"""The equations of the stages of an implicit step, for all stages and all variables together.

    F(t_i, b_i + h Σ_j β_ij K_j, K_i) = 0,  i = 1 … s             unknown are the slopes K
    ∂/∂K_j = δ_ij F_y′ + h β_ij F_y                              of stage i

F is the residual of the problem. Slopes are found to the rounding of h K, which they add to the state, in each variable separately.
In variables of index 2 and 3 rounding is amplified by 1/h and 1/h² (E. Hairer, G. Wanner, Solving ODEs II (1996), VII.4).
"""

import numpy as np

from minimd.integrators.method import Array, Problem
from minimd.integrators.ode.differences import forward_differences
from minimd.integrators.ode.problems import DifferentialAlgebraic, FirstOrder

AMPLIFIED = 3e1  # factor of rounding per level, for steps of some hundredth of the time in which the solution varies
UNSEEN = 1e-22  # of the state: a millionth of its rounding, too small to change even a compensated sum
VANISHING = 1e-30  # smallest size of a variable relative to the largest one, so that no size is zero


class StageEquations:
    """Solves for the slopes of each step; nfev counts evaluations of the right-hand side."""

    def __init__(self, problem: Problem) -> None:
        self.nfev = 0
        self._problem, self._iteration = problem, problem.solver.iteration()

    def slopes(self, times: Array, base: Array, weights: Array, guess: Array, h: float) -> Array:
        """(s, n) K with F(t_i, b_i + Σ_j weights_ij K_j, K_i) = 0.  Raises ConvergenceError with the largest residual.

        times : (s,).  base : (n,) b, the same for all stages.  weights : (s, s) h β.  guess : (s, n).  h : the step [time].
        """

        def residual(unknowns: Array) -> Array:
            k = unknowns.reshape(guess.shape)
            return np.concatenate([self._residual(*stage) for stage in zip(times, base + weights @ k, k, strict=True)])

        def jacobian(unknowns: Array) -> Array:
            k = unknowns.reshape(guess.shape)
            n, matrix = base.size, np.empty((k.size, k.size))
            for i, stage in enumerate(zip(times, base + weights @ k, k, strict=True)):
                of_state, of_slope = self._jacobians(*stage)
                rows = matrix[i * n : (i + 1) * n]
                rows[:] = np.kron(weights[i], of_state)
                rows[:, i * n : (i + 1) * n] += of_slope
            return matrix

        return self._iteration.solve(residual, guess.reshape(-1), jacobian, (h, *weights[0]), *self._sizes(base, guess, h)).reshape(guess.shape)

    def _residual(self, t: float, y: Array, slope: Array) -> Array:
        self.nfev += 1
        return self._problem.residual(t, y, slope)

    def _jacobians(self, t: float, y: Array, slope: Array) -> tuple[Array, Array]:
        """F_y and F_y′."""
        problem = self._problem
        if isinstance(problem, DifferentialAlgebraic):
            self.nfev += y.size
            return problem.state_jacobian(t, y, slope), problem.slope_jacobian(t, y, slope)
        if isinstance(problem, FirstOrder) and problem.jacobian is not None:
            return -np.asarray(problem.jacobian(t, y), dtype=float), np.eye(y.size)
        at_y = self._residual(t, y, slope)
        return forward_differences(lambda x: self._residual(t, x, slope), y, at_y), np.eye(y.size)

    def _sizes(self, base: Array, guess: Array, h: float) -> tuple[Array | float, Array | float, float]:
        """scale, floor and nothing of Iteration.solve.

        Explicit problems: the slopes are compared with the state over h once they no longer shrink, because at rest slopes vanish
        and the state does not. Differential-algebraic ones: each variable has its own size; corrections of algebraic variables
        that no longer shrink are rounding if the others are solved for.
        """
        problem = self._problem
        if not isinstance(problem, DifferentialAlgebraic):
            largest = float(np.abs(base).max())
            return 0.0, largest / abs(h), UNSEEN * largest / abs(h)
        sizes = np.maximum(np.abs(base), np.abs(h * guess).max(axis=0))
        own = np.maximum(sizes, VANISHING * sizes.max()) * AMPLIFIED**problem.levels / abs(h)
        floor = np.where(problem.levels > 0, np.inf, sizes[problem.levels == 0].max(initial=0.0) / abs(h))
        return np.tile(own, len(guess)), np.tile(floor, len(guess)), 0.0
