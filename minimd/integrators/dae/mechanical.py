"""Constrained mechanics as a differential-algebraic equation of index 3, for methods that solve its equations together.

    q′ = v        M(q) v′ = f(t, q, v) − G(t, q)ᵀ λ        0 = g(t, q)        G = ∂g/∂q

The hidden constraints are 0 = G v + g_t and 0 = G v′ + (G v + g_t)_q v + …, which determines λ. The mass matrix and the force are
arbitrary, and constraints may depend on time. For particles and forces that do not depend on v, RATTLE on a Holonomic problem is
cheaper, and symplectic.
E. Hairer, G. Wanner, Solving ODEs II (1996), VII.1, eq. 1.46.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.integrators.dae.consistent_start import unit_of_time
from minimd.integrators.dae.hessenberg import Hessenberg3
from minimd.integrators.method import Array
from minimd.integrators.ode.differences import accurate_differences, forward_differences, remark_on_differences, time_derivative
from minimd.integrators.ode.functions import Function, taking
from minimd.integrators.ode.newton import Newton, Solver

__all__ = ["Mechanical"]


class Mechanical(Hessenberg3):
    """q′ = v, M v′ = f(t, q, v) − Gᵀ λ, 0 = g(t, q): index 3.

    Parameters
    ----------
    mass : number, (n,) diagonal, (n, n) matrix, or a function of q that answers with one of them [mass].
    force : function of t, q, v, or of some of them under these names [force].
    g : (m,) constraints, function of t, q.  gradient : (m, n) G = ∂g/∂q, a function of the same; by differences of order 6 if not given.

    The start is (q, v), or (q, v, λ) with a guess of λ; the force of the constraints is −Gᵀ λ. An error of G is one of this force: for
    all digits of λ and v′ give the gradient. The message of a solution says how large the error is.
    """

    names, functions, regular = ("q", "v", "λ"), ("q′", "force", "g"), "G M⁻¹ Gᵀ"
    chain = ("g", "dg/dt = G v + g_t", "d²g/dt²")

    def __init__(self, mass: ArrayLike | Function, force: Function, g: Function, gradient: Function | None = None, solver: Solver = Newton()) -> None:  # noqa: B008
        of_time_and_q = taking(g, ("t", "q"), "g")
        super().__init__(lambda t, y, z: z, lambda t, y, z, u: self._highest_derivative(t, y, z, u), lambda t, y: of_time_and_q(t, y), solver)
        self._force = taking(force, ("t", "q", "v"), "force")
        self._gradient = gradient if gradient is None else taking(gradient, ("t", "q"), "gradient")
        self._mass = taking(mass, ("q",), "mass") if callable(mass) else lambda q: np.array(mass, dtype=float).reshape(-1)

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """See Hessenberg."""
        y = super().begin(start, t0)
        q = self.parts(y)[0]
        self.remark = remark_on_differences("G = ∂g/∂q", lambda x: self.g(t0, x), q) if self._gradient is None else ""
        return y

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """q′ − v, M v′ − f + Gᵀ λ and g."""
        q, v, multipliers = self.parts(y)
        q_slope, v_slope, _ = self.parts(slope)
        return np.concatenate([q_slope - v, np.dot(self.mass(q), v_slope) - self._pull(t, q, v, multipliers), self.g(t, q)])

    def field(self, t: float, y: Array) -> Array:
        """v, M⁻¹ (f − Gᵀ λ), and zero for λ."""
        parts = self.parts(y)
        return np.concatenate([parts[1], self._highest_derivative(t, *parts), np.zeros(parts[2].size)])

    def state_jacobian(self, t: float, y: Array, slope: Array) -> Array:
        """∂F/∂y, by blocks: ∂(q′ − v)/∂v = −1, G and Gᵀ; the others by finite differences."""
        q, v, multipliers = self.parts(y)
        v_slope = self.parts(slope)[1]
        of_q, of_v, of_multipliers = self._slices

        def momentum(q: Array, v: Array) -> Array:
            return np.dot(self.mass(q), v_slope) - self._pull(t, q, v, multipliers)

        here, gradient, matrix = momentum(q, v), self.gradient(t, q), np.zeros((y.size, y.size))
        matrix[of_q, of_v] = -np.eye(q.size)
        matrix[of_v, of_q] = forward_differences(lambda x: momentum(x, v), q, here)
        matrix[of_v, of_v] = forward_differences(lambda x: momentum(q, x), v, here)
        matrix[of_v, of_multipliers], matrix[of_multipliers, of_q] = gradient.T, gradient
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
        turning = time_derivative(lambda e: self.g(t + e, q + e * v), 2, unit_of_time(q, v, q_second))
        return self.gradient(t, q) @ q_second + turning

    def mass(self, q: Array) -> Array:
        """M(q), (n, n)."""
        mass, n = self._mass(q), q.size
        if mass.size not in (1, n, n * n):
            raise ValueError(f"mass must be one number, {n} or {n} × {n}, as q has {n} elements; got {mass.size} numbers")
        return mass.reshape(n, n) if mass.size == n * n else np.eye(n) * mass

    def gradient(self, t: float, q: Array) -> Array:
        """G(t, q), (m, n)."""
        return accurate_differences(lambda x: self.g(t, x), q) if self._gradient is None else self._gradient(t, q).reshape(-1, q.size)

    def _answers(self, t: float, *parts: Array) -> tuple[Array, ...]:
        q, v, _ = parts
        return v, self._force(t, q, v), self.g(t, q)

    def _pull(self, t: float, q: Array, v: Array, multipliers: Array) -> Array:
        return self._force(t, q, v) - multipliers @ self.gradient(t, q)

    def _highest_derivative(self, t: float, *parts: Array) -> Array:
        """q″ = M⁻¹ (f − Gᵀ λ)."""
        try:
            return np.asarray(np.linalg.solve(self.mass(parts[0]), self._pull(t, *parts)))
        except np.linalg.LinAlgError:
            raise ValueError(f"the mass matrix must be regular; it is singular at q = {parts[0]}") from None
