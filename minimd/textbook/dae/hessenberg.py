"""Differential-algebraic equations in Hessenberg form, of index 1, 2 and 3, and constrained mechanics.

    index 1     y′ = f(t, y, z)                             0 = g(t, y, z)    gives z
    index 2     y′ = f(t, y, z)                             0 = g(t, y)       0 = dg/dt = g_t + g_y f gives z
    index 3     y′ = f(t, y, z),  z′ = k(t, y, z, u)        0 = g(t, y)       0 = dg/dt is hidden, 0 = d²g/dt² gives u
    mechanics   q′ = v,  M(q) v′ = f(t, q, v) − G(q)ᵀ λ     0 = g(t, q)       hidden: 0 = G v + g_t; 0 = d²g/dt² gives λ

The state holds its parts one after the other. A start that violates one of these constraints is refused, with the
reason. E. Hairer, G. Wanner, Solving ODEs II (1996), VI.1, VII.1.
"""

from functools import partial
from itertools import accumulate
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_numbers
from minimd.textbook.dae.implicit import ADVICE
from minimd.textbook.ode.functions import (
    CENTRAL,
    Function,
    derivative,
    forward_differences,
    remark_on_differences,
    taking,
    time_derivative,
    unit_of_time,
)
from minimd.textbook.ode.newton import WIDE, Newton, are_independent, nearest_root
from minimd.textbook.ode.problems import DifferentialAlgebraic

__all__ = ["Hessenberg1", "Hessenberg2", "Hessenberg3", "Mechanical"]

Parts = tuple[Array, ...]
KEPT = 1e-11  # relative moves below which a start is left as it is: the accuracy of the derivatives
# and above which it is refused as inconsistent; moves between the two are made without a warning
REFUSED = 1e-8


class Hessenberg(DifferentialAlgebraic):
    """What the forms have in common: parts of the state, and a chain of constraints, each of which determines one of
    the last parts.
    functions : of the user, in the order in which they are named, each of t and of its first parts."""

    names: ClassVar[tuple[str, ...]]  # of the parts
    # one for each part: its name, of how many parts it is a function
    functions: ClassVar[tuple[tuple[str, int], ...]]
    # what is zero, from g on; the last one determines the algebraic variables
    chain: ClassVar[tuple[str, ...]]
    regular: ClassVar[str]  # the matrix that must have full rank for this
    _slices: tuple[slice, ...] = ()

    def __init__(self, solver: Newton, *functions: Function) -> None:
        super().__init__(solver)
        self._functions = []
        for function, (name, n) in zip(functions, self.functions, strict=True):
            arguments = " ".join(("t", *self.names[:n]))
            self._functions.append(taking(function, arguments, name))
        self.f = self._functions[0]
        self.g = self._functions[-1]

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The start as a state, its algebraic variables solved for.
        start : the parts, such as (q, v); algebraic variables may be left out; if given they are a first guess.
        Raises ValueError for a start that violates a constraint, given or hidden; corrected gives one that does not."""
        return self._consistent(start, t0, KEPT, REFUSED)

    def corrected(self, start: Any, t0: float = 0.0) -> Array:
        """The consistent state nearest to a start, found part by part."""
        return self._consistent(start, t0, 0.0, np.inf)

    def parts(self, y: ArrayLike) -> Parts:
        """Views of the parts of a state, or of many: y may be (n,), or (n_times, n) as in a solution."""
        y = np.asarray(y)
        return tuple(y[..., part] for part in self._slices)

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """(y′ − f, g), or (y′ − f, z′ − k, g)."""
        *rates, g = self._answers(t, *self.parts(y))
        n = self._slices[-1].start
        return np.concatenate([slope[:n] - np.concatenate(rates), g])

    def field(self, t: float, y: Array) -> Array:
        """(f, 0), or (f, k, 0): zero for the algebraic variables."""
        *rates, g = self._answers(t, *self.parts(y))
        return np.concatenate([*rates, np.zeros(g.size)])

    def constraint(self, k: int, t: float, *parts: Array) -> Array:
        """dᵏg/dtᵏ along the solution, from central differences: zero on solutions."""
        y = parts[0]
        if k == 0:
            return self.g(t, *parts[: self.functions[-1][1]])
        rate = self.f(t, *parts[:2])
        second = self._highest_derivative(t, *parts) if k == 2 else np.zeros_like(rate)

        def path(e: float) -> Array:
            return self.g(t + e, y + e * rate + e * e / 2.0 * second)

        return time_derivative(path, k, unit_of_time(y, rate, second))

    def slope_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """1 for the differential variables, 0 for the algebraic ones."""
        is_differential = np.arange(y.size) < self._slices[-1].start
        return np.diag(is_differential.astype(float))

    def _consistent(self, start: Any, t: float, kept: float, refused: float) -> Array:
        """The state whose parts are roots of the constraints that determine them.
        kept, refused : moves of a part, relative to its size, up to which it stays as it is, and above which the
            start is refused."""
        parts = self._begun(start, t)
        n_fixed = len(parts) - len(self.chain)

        for i, equation in enumerate(self.chain, n_fixed):
            k = i - n_fixed
            is_last = i == len(parts) - 1
            name = self.names[i]
            part = parts[i]
            step = WIDE if k > 0 else CENTRAL

            def violation(x: Array) -> Array:
                return self.constraint(k, t, *parts[:i], x, *parts[i + 1 :])

            if is_last:
                own = self._size_of_algebraic(t, parts)
            else:
                own = np.abs(part).max()
                largest = max(np.abs(other).max() for other in parts)
                if own <= KEPT * largest:  # it is only rounding
                    own = largest

            if not are_independent(violation, part, step, own):
                raise ValueError(
                    f"{self.regular} must have full rank at the start, t = {t:g}, or the index is higher than "
                    f"{self.index}: the constraints 0 = {equation} do not determine {name}"
                )

            root = nearest_root(violation, part, step, size=own)
            move = np.abs(root - part).max()
            size = max(own, np.abs(root).max())
            if not is_last and move > refused * size:
                defect = violation(part)
                worst = np.argmax(np.abs(defect))
                kind = "hidden constraint" if k > 0 else "constraint"
                raise ValueError(
                    f"the start violates the {kind} 0 = {equation}: its element {worst} is {defect[worst]:.2e} "
                    f"at t = {t:g}, and {name} would have to move by {move:.1e}; {ADVICE}"
                )

            if is_last or move > kept * size:
                parts[i] = root

        return np.concatenate(parts)

    def _size_of_algebraic(self, t: float, parts: list[Array]) -> float:
        """Size of algebraic variables that would change the highest derivative of the path by its own size."""
        *others, algebraic = parts
        highest = self._highest_derivative(t, *parts)
        response = np.abs(self._highest_derivative(t, *others, algebraic + 1.0) - highest).max()
        size = np.abs(highest).max() or np.abs(parts[0]).max()
        return float(size / response) if size > 0.0 < response else 1.0

    def _highest_derivative(self, t: float, *parts: Array) -> Array:
        """The derivative of y in the last constraint of the chain: it depends on the algebraic variables."""
        return parts[-1]

    def _begun(self, start: Any, t: float) -> list[Array]:
        """The parts of a start, with zeros for algebraic variables that are not given; sizes are remembered."""
        names = self.names
        n = len(names)
        is_guess_needed = self.functions[-1][1] == n  # as g depends on it
        n_least = n if is_guess_needed else n - 1
        if not isinstance(start, tuple) or not n_least <= len(start) <= n:
            option = "as a guess, because g depends on it" if is_guess_needed else "may be left out"
            raise ValueError(
                f"the start must be a tuple of {', '.join(names)} ({names[-1]} {option}); got {shown(start)}"
            )

        parts = []
        for name, part in zip(names, start, strict=False):
            numbers = checked_numbers(f"{name} of the start", part, "numbers")
            parts.append(numbers.reshape(-1))
        if len(parts) < n:
            parts.append(np.zeros(self.constraint(0, t, *parts).size))

        for name, part in zip(names, parts, strict=True):
            if part.size == 0 or not np.isfinite(part).all():
                raise ValueError(
                    f"{name} of the start must have at least one element, and finite ones; got {part}"
                )

        sizes = [part.size for part in parts]
        ends = list(accumulate(sizes, initial=0))
        self._slices = tuple(map(slice, ends, ends[1:]))
        self.levels = np.repeat(np.maximum(np.arange(n) + self.index - n, 0), sizes)
        answers = self._answers(t, *parts)

        for (name, _), answer, part in zip(self.functions, answers, parts, strict=True):
            if answer.size != part.size:
                raise ValueError(
                    f"{name} must answer with as many numbers as it has variables, {part.size} as in the start; got "
                    f"{answer.size}"
                )

        return parts

    def _answers(self, t: float, *parts: Array) -> Parts:
        """The values of the functions, in the order of the parts."""
        pairs = zip(self._functions, self.functions, strict=True)
        return tuple(f(t, *parts[:n]) for f, (_, n) in pairs)


class Hessenberg1(Hessenberg):
    """y′ = f(t, y, z), 0 = g(t, y, z), with g_z regular: index 1.

    Parameters
    ----------
    f, g : functions of t, y, z, or of some of them under these names.

    The start is (y, z), with a guess of z.
    """

    index = 1
    names = ("y", "z")
    functions = (("f", 2), ("g", 2))
    chain = ("g",)
    regular = "g_z"

    def __init__(self, f: Function, g: Function, solver: Newton = Newton()) -> None:
        super().__init__(solver, f, g)


class Hessenberg2(Hessenberg):
    """y′ = f(t, y, z), 0 = g(t, y), with g_y f_z regular: index 2.

    Parameters
    ----------
    f : function of t, y, z.
    g : of t, y; or of some of them under these names.

    The start is (y,), or (y, z) with a guess of z.
    """

    index = 2
    names = ("y", "z")
    functions = (("f", 2), ("g", 1))
    regular = "g_y f_z"
    chain = ("g", "dg/dt = g_t + g_y f")

    def __init__(self, f: Function, g: Function, solver: Newton = Newton()) -> None:
        super().__init__(solver, f, g)

    def _highest_derivative(self, t: float, *parts: Array) -> Array:
        return self.f(t, *parts)


class Hessenberg3(Hessenberg):
    """y′ = f(t, y, z), z′ = k(t, y, z, u), 0 = g(t, y), with g_y f_z k_u regular: index 3.

    Parameters
    ----------
    f : function of t, y, z.
    k : of t, y, z, u.
    g : of t, y; or of some of them under these names.

    The start is (y, z), or (y, z, u) with a guess of u.
    """

    index = 3
    names = ("y", "z", "u")
    functions = (("f", 2), ("k", 3), ("g", 1))
    regular = "g_y f_z k_u"
    chain = ("g", "dg/dt = g_t + g_y f", "d²g/dt²")

    def __init__(self, f: Function, k: Function, g: Function, solver: Newton = Newton()) -> None:
        super().__init__(solver, f, k, g)
        self.k = self._functions[1]

    def _highest_derivative(self, t: float, *parts: Array) -> Array:
        """y″ = f_t + f_y f + f_z k."""
        y, z, _ = parts
        rate = self.f(t, y, z)
        z_rate = self.k(t, *parts)

        def path(e: float) -> Array:
            return self.f(t + e, y + e * rate, z + e * z_rate)

        return time_derivative(path, 1, min(unit_of_time(y, rate), unit_of_time(z, z_rate)))


class Mechanical(Hessenberg):
    """Constrained mechanics, for methods that solve its equations together: index 3.

        q′ = v        M(q) v′ = f(t, q, v) − G(t, q)ᵀ λ        0 = g(t, q)        G = ∂g/∂q

    The hidden constraints are 0 = G v + g_t and 0 = G v′ + (G v + g_t)_q v + …, which determines λ. The mass matrix and
    the force are arbitrary, and constraints may depend on time. For particles and forces that do not depend on v,
    RATTLE on a Holonomic problem is cheaper, and symplectic. Hairer, Wanner (1996), VII.1, eq. 1.46.

    Parameters
    ----------
    mass : number, (n,) diagonal, (n, n) matrix, or a function of q that answers with one of them [mass].
    force : function of t, q, v, or of some of them under these names [force].
    g : (m,) constraints, function of t, q.
    jacobian : (m, n) G = ∂g/∂q, a function of the same; by differences of order 6 if not given.

    The start is (q, v), or (q, v, λ) with a guess of λ; the force of the constraints is −Gᵀ λ. An error of G is one of
    this force: for all digits of λ and v′ give the jacobian. The message of a solution says how large the error is.
    """

    index = 3
    names = ("q", "v", "λ")
    functions = (("q′", 2), ("force", 2), ("g", 1))
    regular = "G M⁻¹ Gᵀ"
    chain = ("g", "dg/dt = G v + g_t", "d²g/dt²")

    def __init__(
        self,
        mass: ArrayLike | Function,
        force: Function,
        g: Function,
        jacobian: Function | None = None,
        solver: Newton = Newton(),
    ) -> None:
        super().__init__(solver, lambda v: v, force, g)
        self._force = self._functions[1]
        self._jacobian = jacobian if jacobian is None else taking(jacobian, "t q", "jacobian")
        self._mass = taking(mass if callable(mass) else lambda: mass, "q", "mass")

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """See Hessenberg."""
        y = super().begin(start, t0)
        self.remark = remark_on_differences(partial(self.g, t0), self._jacobian, self.parts(y)[0])
        return y

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """q′ − v, M v′ − f + Gᵀ λ and g."""
        q, v, multipliers = self.parts(y)
        q_slope, v_slope, _ = self.parts(slope)
        momentum = np.dot(self.mass(q), v_slope) - self._pull(t, q, v, multipliers)
        return np.concatenate([q_slope - v, momentum, self.g(t, q)])

    def field(self, t: float, y: Array) -> Array:
        """v, M⁻¹ (f − Gᵀ λ), and zero for λ."""
        parts = self.parts(y)
        acceleration = self._highest_derivative(t, *parts)
        return np.concatenate([parts[1], acceleration, np.zeros(parts[2].size)])

    def state_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y, by blocks: ∂(q′ − v)/∂v = −1, G and Gᵀ; the others by finite differences."""
        q, v, multipliers = self.parts(y)
        v_slope = self.parts(slope)[1]
        of_q, of_v, of_multipliers = self._slices

        def momentum(q: Array, v: Array) -> Array:
            return np.dot(self.mass(q), v_slope) - self._pull(t, q, v, multipliers)

        momenta = momentum(q, v)
        jacobian = self.jacobian(t, q)
        matrix = np.zeros((y.size, y.size))
        matrix[of_q, of_v] = -np.eye(q.size)
        matrix[of_v, of_q] = forward_differences(lambda x: momentum(x, v), q, momenta)
        matrix[of_v, of_v] = forward_differences(lambda x: momentum(q, x), v, momenta)
        matrix[of_v, of_multipliers] = jacobian.T
        matrix[of_multipliers, of_q] = jacobian
        return matrix

    def slope_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y′ = diag(1, M, 0)."""
        matrix = super().slope_jacobian(t, y, slope)
        of_q, of_v, _ = self._slices
        matrix[of_v, of_v] = self.mass(y[of_q])
        return matrix

    def constraint(self, k: int, t: float, *parts: Array) -> Array:
        """g, dg/dt or d²g/dt² = G q″ + ∂²g(t + ε, q + ε v)/∂ε²."""
        if k < 2:
            return super().constraint(k, t, *parts)
        q, v, _ = parts
        q_second = self._highest_derivative(t, *parts)
        unit = unit_of_time(q, v, q_second)
        turning = time_derivative(lambda e: self.g(t + e, q + e * v), 2, unit)
        return self.jacobian(t, q) @ q_second + turning

    def mass(self, q: Array) -> Array:
        """M(q), (n, n)."""
        mass = self._mass(q)
        n = q.size
        if mass.size not in (1, n, n * n):
            raise ValueError(
                f"mass must be one number, {n} or {n} × {n}, as q has {n} elements; got {mass.size} numbers"
            )
        return mass.reshape(n, n) if mass.size == n * n else np.eye(n) * mass

    def jacobian(self, t: float, q: Array) -> Array:
        """G(t, q), (m, n)."""
        return derivative(partial(self.g, t), self._jacobian and partial(self._jacobian, t), q)

    def _pull(self, t: float, q: Array, v: Array, multipliers: Array) -> Array:
        return self._force(t, q, v) - multipliers @ self.jacobian(t, q)

    def _highest_derivative(self, t: float, *parts: Array) -> Array:
        """q″ = M⁻¹ (f − Gᵀ λ)."""
        try:
            return np.asarray(np.linalg.solve(self.mass(parts[0]), self._pull(t, *parts)))
        except np.linalg.LinAlgError:
            raise ValueError(
                f"the mass matrix must be regular; it is singular at q = {parts[0]}"
            ) from None
