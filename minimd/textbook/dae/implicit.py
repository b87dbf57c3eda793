"""Fully implicit differential equations F(t, y, y′) = 0, with the start and the index found from F alone.

    0 = F,  0 = dF/dt,  0 = d²F/dt²         along y + ε y′ + ε²/2 y″ + ε³/6 y‴: the derivative array

A start is consistent if this array, with derivatives up to the index minus one, can be solved for y′, y″ … and for the
variables whose derivative does not occur in F. The index is that of the pencil λ F_y′ + F_y at the start.
S. L. Campbell, SIAM J. Sci. Stat. Comput. 6, 334 (1985); E. Hairer, G. Wanner, Solving ODEs II (1996), VII.1, VII.2.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_numbers
from minimd.textbook.ode.functions import (
    CENTRAL,
    Function,
    central_differences,
    taking,
    time_derivative,
    unit_of_time,
)
from minimd.textbook.ode.newton import WIDE, Newton, nearest_root
from minimd.textbook.ode.problems import DifferentialAlgebraic

__all__ = ["Implicit", "pencil_index"]

ABSENT = 1e-12  # relative to the largest ∂F/∂y′: smaller ones count as zero
# relative singular values that count as zero, of matrices from differences and from differences of differences
RANK = 1e-7
NOISY_RANK = 1e-4
PENCIL_RANK = 1e-10  # singular values of scaled matrices below this are rounding
# mobility of variables whose derivative occurs in F, relative to that of the others
LEAST_MOBILITY = 0.1
# what may be left of an equation, relative to its terms and to its largest variable
SOLVED = 1e-7
NEGLIGIBLE = 1e-12
HIGHEST_INDEX = 3
ADVICE = "give consistent values, or take them from problem.corrected(start, t0)"
ORDINALS = ("", "the first time derivative of ", "the second time derivative of ")


class Implicit(DifferentialAlgebraic):
    """F(t, y, y′) = 0, of index 0 to 3.

    Parameters
    ----------
    F : (n,) function of t, y, slope, or of some of them under these names.
    F_y, F_slope : (n, n) ∂F/∂y and ∂F/∂y′, functions of the same; by finite differences if not given.

    The start is y, or (y, y′) with a guess of y′. Variables whose derivative does not occur in F are guesses as well.
    """

    def __init__(
        self,
        F: Function,
        F_y: Function | None = None,
        F_slope: Function | None = None,
        solver: Newton = Newton(),
    ) -> None:
        super().__init__(solver)
        self._F = taking(F, "t y slope", "F")
        self._slope = np.zeros(0)
        if F_y is not None:
            self.state_jacobian = _matrix(F_y, "F_y")  # type: ignore[method-assign]
        if F_slope is not None:
            self.slope_jacobian = _matrix(F_slope, "F_slope")  # type: ignore[method-assign]

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The start as a state, with variables whose derivative does not occur in F solved for; field(t0, y) is its y′.
        Raises ValueError if F, or a time derivative of it, cannot be zero there; if the index is above 3, or solutions
        are not unique."""
        return self._consistent(start, t0, 0.0)

    def corrected(self, start: Any, t0: float = 0.0) -> Array:
        """A consistent state near the start, where variables whose derivative occurs in F move only if they must."""
        try:
            return self.begin(start, t0)
        except ValueError:
            return self._consistent(start, t0, LEAST_MOBILITY)

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """F(t, y, y′)."""
        return np.asarray(self._F(t, y, slope))

    def field(self, t: float, y: Array) -> Array:
        """The y′ nearest to that of the start with F = 0, in least squares."""
        return nearest_root(lambda slope: self.residual(t, y, slope), self._slope)

    def _consistent(self, start: Any, t: float, least: float) -> Array:
        """y, after solving F = 0 and its derivatives up to the index minus one.
        least : mobility of variables whose derivative occurs in F."""
        is_pair = isinstance(start, tuple) and len(start) == 2 and np.ndim(start[0]) == 1
        pair = start if is_pair else (start, np.zeros(np.shape(start)))
        y, slope = (checked_numbers("start", part, "numbers") for part in pair)
        are_alike = y.ndim == 1 and y.size > 0 and y.shape == slope.shape
        if not are_alike or not np.isfinite([y, slope]).all():
            raise ValueError(
                "the start must be y, or (y, y′), one-dimensional arrays of the same length with finite elements; "
                f"got {shown(start)}"
            )

        n_equations = self.residual(t, y, slope).size
        if n_equations != y.size:
            raise ValueError(
                f"there must be as many equations as variables; F has {n_equations}, y has {y.size}"
            )

        self._slope = slope
        derivatives = np.abs(self.slope_jacobian(t, y, slope))
        mobility = np.where(derivatives.max(axis=0) <= ABSENT * derivatives.max(), 1.0, least)
        size = np.abs(y).max()
        y, slope = self._solved(t, y, [slope], mobility, 1.0, size)
        of_slope, of_state = self._pencil(t, y, slope)
        self.index = pencil_index(of_slope, -of_state, RANK)
        if self.index > HIGHEST_INDEX:
            raise ValueError(
                f"the index must be at most {HIGHEST_INDEX}; that of F_y′ y′ + F_y y at the start is {self.index}; "
                "differentiate constraints"
            )

        if self.index > 1:
            jet = [slope, *np.zeros((self.index - 1, y.size))]
            unit = unit_of_time(np.append(y, size), slope)
            y, slope = self._solved(t, y, jet, mobility, unit, size)

        # the larger levels of those at the start and at a random point near it, where no derivative vanishes by chance
        aside = 0.01 * (np.abs(y).max() or 1.0) * np.random.default_rng(0).uniform(0.5, 1.0, y.size)
        levels = [_levels(*self._pencil(t, state, slope)) for state in (y, y + aside)]
        self.levels = np.maximum(*levels)
        self._slope = slope
        return y

    def _pencil(self, t: float, y: Array, slope: Array) -> tuple[Array, Array]:
        """F_y′ and F_y, to some eleven digits."""
        of_slope = central_differences(lambda x: self.residual(t, y, x), slope)
        return of_slope, central_differences(lambda x: self.residual(t, x, slope), y)

    def _solved(
        self, t: float, y: Array, jet: list[Array], mobility: Array, unit: float, size: float
    ) -> tuple[Array, Array]:
        """y and y′ with F = 0 and dᵏF/dtᵏ = 0 for k below the number of derivatives in the jet (y′, y″, …).
        mobility : (n,) how easily variables move, 0 for fixed ones.
        unit : of time.
        size : of the largest variable.
        """
        order = len(jet)
        scales = unit ** np.arange(1, order + 1)
        is_free = mobility > 0.0
        n_free = is_free.sum()

        def series(x: Array) -> list[Array]:
            """y, y′, y″, … of the unknowns."""
            state = y.copy()
            state[is_free] = mobility[is_free] * x[:n_free]
            return [state, *(x[n_free:].reshape(order, -1) / scales[:, None])]

        def derivative_array(x: Array) -> Array:
            """F and its time derivatives along y + ε y′ + ε²/2 y″ + …, with time in this unit."""
            states = series(x)

            def path(e: float) -> Array:
                return self.residual(t + e, _taylor(states, e), _taylor(states[1:], e))

            derivatives = [unit**k * time_derivative(path, k, unit) for k in range(1, order)]
            return np.concatenate([path(0.0), *derivatives])

        guess = np.concatenate([y[is_free] / mobility[is_free], *(scales[:, None] * jet)])
        step, dependent = (CENTRAL, RANK) if order == 1 else (WIDE, NOISY_RANK)
        x = nearest_root(derivative_array, guess, step, dependent, size)
        rest = derivative_array(x)
        terms = np.abs(central_differences(derivative_array, x, step, size))
        largest = max(np.abs(x).max(), size)
        allowed = SOLVED * (terms @ np.abs(x)) + NEGLIGIBLE * terms.max(axis=1) * largest
        k = np.argmax(np.abs(rest) - allowed)
        if not abs(rest[k]) <= allowed[k]:
            n, equation = divmod(k, y.size)
            raise ValueError(
                f"the start violates F(t, y, y′) = 0: {ORDINALS[n]}equation {equation} stays at "
                f"{rest[k] / unit**n:.2e} at t = {t:g} for every choice of y′ and of the variables that have no "
                f"derivative in F; {ADVICE}"
            )

        state, slope, *_ = series(x)
        return state, slope


def _matrix(function: Function, name: str) -> Function:
    """A function of t, y and slope with n × n numbers, as one that answers with an (n, n) array."""
    answer = taking(function, "t y slope", name)
    return lambda t, y, slope: answer(t, y, slope).reshape(y.size, y.size)


def _taylor(coefficients: list[Array], e: float) -> Array:
    """Σ eʲ/j! c_j, by Horner's rule."""
    total = np.zeros_like(coefficients[0])
    for j, coefficient in reversed(list(enumerate(coefficients, 1))):
        total = coefficient + total * (e / j)
    return total


def _levels(of_slope: Array, of_state: Array) -> Array:
    """(n,) powers of 1/h by which errors of equations are amplified in each variable, 0, 1 or 2: from (F_y′/h + F_y)⁻¹
    at two small h."""
    m = of_slope / (np.abs(of_slope).max() or 1.0)
    a = of_state / (np.abs(of_state).max() or 1.0)
    long, short = (np.abs(np.linalg.inv(m / h + a)).max(axis=1) for h in (1e-3, 1e-4))
    return np.clip(np.round(np.log10(short / long)), 0, HIGHEST_INDEX - 1).astype(int)


def pencil_index(M: ArrayLike, A: ArrayLike, tolerance: float = PENCIL_RANK) -> int:
    """Index ν of the pencil λM − A: how often M y′ = A y must be differentiated to give y′. 0 if M is regular.

        P M Q = diag(1, N),  P A Q = diag(C, 1)          Weierstrass' form; the index is that of N: Nᵛ = 0 ≠ Nᵛ⁻¹

    Shuffle algorithm: orthogonal row operations bring M to (M₁; 0) with M₁ of full rank and A to (A₁; A₂); the
    equations 0 = A₂ y are differentiated, 0 = A₂ y′, and become rows of M. It ends when M is regular; the number of
    rounds is the index.

    Parameters
    ----------
    M, A : (n, n).
    tolerance : singular values below this part of the largest one are zero; rows and time are scaled.

    Raises
    ------
    ValueError : for other shapes, or a singular pencil, det(λM − A) = 0 for all λ: its solutions are not determined.

    F. R. Gantmacher, The Theory of Matrices, vol. 2 (1959), XII; D. G. Luenberger, Automatica 14, 473 (1978);
    ranks by singular values: P. Van Dooren, Linear Algebra Appl. 27, 103 (1979).
    """
    m = checked_numbers("M", M, "a matrix")
    a = checked_numbers("A", A, "a matrix")
    if m.ndim != 2 or m.shape[0] != m.shape[1] or m.shape != a.shape or m.size == 0:
        raise ValueError(
            f"M and A must be square matrices of the same size; got shapes {m.shape} and {a.shape}"
        )

    if not (np.isfinite(m).all() and np.isfinite(a).all()):
        raise ValueError("M and A must be finite")
    n = len(m)
    index = 0
    # in a unit of time of its own, on which the index does not depend
    m = m / (np.abs(m).max() or 1.0)
    a = a / (np.abs(a).max() or 1.0)

    while True:
        left, sizes, _ = np.linalg.svd(m)
        rank = int((sizes > tolerance * max(sizes[0], np.abs(a).max())).sum())
        if rank == n:
            return index
        regular = left[:, :rank].T
        constraints = left[:, rank:].T @ a
        independent = np.linalg.svd(constraints, compute_uv=False)
        if not independent[-1] > tolerance or index == n:
            raise ValueError(
                f"the pencil is singular, det(λM − A) = 0 for all λ: after {index} differentiations {n - rank} "
                f"equations without y′ depend on each other (singular values from {independent[0]:.1e} to "
                f"{independent[-1]:.1e}), so that some variable is not determined"
            )

        m = np.vstack([regular @ m, constraints])
        a = np.vstack([regular @ a, np.zeros_like(constraints)])
        sizes = np.linalg.norm(m, axis=1)
        m = m / sizes[:, None]
        a = a / sizes[:, None]
        index += 1
