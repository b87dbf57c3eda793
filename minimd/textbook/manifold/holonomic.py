"""Constrained mechanics of small systems, of index 3: q″ = f(t, q) − M⁻¹ G(q)ᵀ λ with 0 = g(q).

    drift     q₁ = q₀ + h v − M⁻¹ G(q₀)ᵀ λ  with  g(q₁) = 0,      v ← (q₁ − q₀)/h
    end       v ← v − M⁻¹ G(q₁)ᵀ μ          with  G(q₁) v = 0

Kicks are unchanged. With the substeps of velocity Verlet this is RATTLE: order 2, symmetric, symplectic on the
manifold. H. C. Andersen, J. Comput. Phys. 52, 24 (1983); B. Leimkuhler, R. D. Skeel, J. Comput. Phys. 112, 117 (1994).
Symmetric sequences stay symmetric. Compositions of velocity Verlet, such as Yoshida's, keep their order. All others
have order 2 at most, because a constrained drift is not an exact flow: two of them in a row differ from a single one.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.quiet import warn
from minimd.core.integrators.order_conditions import nystrom_order
from minimd.core.integrators.substeps import Drift, Kick, Substeps, are_alike, repeated
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_kind, checked_numbers
from minimd.core.structure.errors import ConvergenceError
from minimd.textbook.ode.functions import (
    Function,
    derivative,
    remark_on_differences,
    time_derivative,
    unit_of_time,
)
from minimd.textbook.ode.newton import Iteration, Newton
from minimd.textbook.ode.problems import SecondOrder

__all__ = ["Holonomic"]

VERLET = (Kick(0.5), Drift(1.0), Kick(0.5))
KEPT = 1e-12  # relative corrections of a start that are made without a warning
# ratio of singular values of G M^(−1/2) below which constraints count as dependent
DEPENDENT = 1e-10


class Holonomic(SecondOrder):
    """Newton's equation on the manifold g(q) = 0.

    Parameters
    ----------
    f : acceleration without the constraints, a function of q, or of t and q [length/time²].
    g : (m,) constraints, a function of q.
    jacobian : (m, n) G = ∂g/∂q, a function of q. By differences of order 6 if not given: G v = 0 then holds to their
        error, which the message of a solution tells.
    masses : (n,) mass of each coordinate, or one number [mass].

    A start that violates g = 0 or G v = 0 is projected, with a warning that says how far it was off.

    Raises
    ------
    ValueError : if f takes v, or constraints depend on each other at the start.
    TypeError : if g or jacobian is no function.
    """

    drifts_on_lines = False

    def __init__(
        self,
        f: Function,
        g: Function,
        jacobian: Function | None = None,
        masses: ArrayLike = 1.0,
        solver: Newton = Newton(),
    ) -> None:
        super().__init__(f, solver=solver)
        if "v" in self.f.takes:
            raise ValueError("a constrained step needs forces that do not depend on v; f takes v")
        self._g = checked_kind("g", g, Callable, "a function g(q)")
        self._jacobian = checked_kind("jacobian", jacobian, Callable | None, "a function of q")
        self._masses = checked_numbers("masses", masses, "numbers")

    def violation(self, q: Array) -> Array:
        """g(q), (m,), for q of length n."""
        return np.array(self._g(q.reshape(self.shape)), dtype=float).reshape(-1)

    def jacobian(self, q: Array) -> Array:
        """G(q), (m, n)."""
        jacobian = self._jacobian
        shaped = jacobian and (lambda x: jacobian(x.reshape(self.shape)))
        return derivative(self.violation, shaped, q)

    def directions(self, gradient: Array) -> Array:
        """M⁻¹ Gᵀ, (n, m), of a gradient G."""
        return gradient.T / self._each_mass()[:, None]

    def _each_mass(self) -> Array:
        """(n,) masses of all coordinates."""
        return np.broadcast_to(self._masses, self.shape).reshape(-1)

    def begin(self, start: tuple[ArrayLike, ArrayLike], t0: float = 0.0) -> Array:
        """(q, v) as one state, projected onto the manifold."""
        q, v = np.split(super().begin(start), 2)
        masses = self._each_mass()
        if not (masses > 0.0).all():
            raise ValueError(f"masses must be positive; the smallest is {masses.min()}")
        sizes = np.linalg.svd(self.jacobian(q) / np.sqrt(masses), compute_uv=False)
        if sizes.size > q.size or not sizes[-1] > DEPENDENT * sizes[0]:
            raise ValueError(
                "the gradients of g must be independent at the start; singular values of G M^(-1/2) from "
                f"{sizes[0]:.1e} to {sizes[-1]:.1e}"
            )

        violation = np.abs(self.violation(q)).max()
        q1 = projected(self, q, q) if violation > 0.0 else q
        v1 = tangent(self, q1, v)
        move = np.abs(q1 - q).max()
        turn = np.abs(v1 - v).max()
        speed = max(np.abs(v).max(), np.finfo(float).tiny)
        if move > KEPT * np.abs(q).max() or turn > KEPT * speed:
            warn(
                f"the start was projected onto the constraints: q by {move:.1e} (g was {violation:.1e}), v by "
                f"{turn:.1e}"
            )

        self.remark = remark_on_differences(self.violation, self._jacobian, q1)
        return np.concatenate([q1, v1])

    def drift(self, t: float, q: Array, v: Array, duration: float, iteration: Iteration) -> None:
        """A constrained drift, in place."""
        new = projected(self, q, q + duration * v, iteration)
        v[:] = (new - q) / duration
        q[:] = new

    def settle(self, q: Array, v: Array) -> None:
        """The projection of velocities, in place."""
        v[:] = tangent(self, q, v)

    def sequence_order(self, substeps: Substeps) -> int:
        """Compositions of velocity Verlet keep their order, as each of their steps is a RATTLE step; others have 2 at
        most."""
        order = nystrom_order(substeps)
        drifts = [substep.coefficient for substep in substeps if isinstance(substep, Drift)]
        is_composed = are_alike(substeps, repeated(VERLET, drifts))
        return order if is_composed else min(order, 2)

    def multipliers(self, t: float, q: ArrayLike, v: ArrayLike) -> Array:
        """λ of the constraint force −Gᵀ λ, (m,): G(q) q″ + (d/dt G) v = 0."""
        q, v = (np.asarray(part, dtype=float).reshape(-1) for part in (q, v))
        gradient = self.jacobian(q)
        turning = time_derivative(lambda e: self.jacobian(q + e * v) @ v, 1, unit_of_time(q, v))
        force = self.f(t, q.reshape(self.shape), v.reshape(self.shape))
        matrix = gradient @ self.directions(gradient)
        return np.asarray(np.linalg.solve(matrix, gradient @ force + turning))


def projected(problem: Holonomic, q0: Array, q: Array, iteration: Iteration | None = None) -> Array:
    """The point q + M⁻¹ G(q0)ᵀ λ with g = 0.
    Raises ConvergenceError if there is none near q."""
    directions = problem.directions(problem.jacobian(q0))
    iteration = iteration or problem.solver.iteration()
    multipliers = iteration.solve(
        lambda x: problem.violation(q + directions @ x),
        np.zeros(directions.shape[1]),
        lambda x: problem.jacobian(q + directions @ x) @ directions,
        scale=np.abs(q).max() / np.abs(directions).max(),
    )
    return q + directions @ multipliers


def tangent(problem: Holonomic, q: Array, v: Array) -> Array:
    """The velocity v + M⁻¹ G(q)ᵀ μ with G v = 0; projected twice, to remove the rounding of the first projection."""
    gradient = problem.jacobian(q)
    directions = problem.directions(gradient)
    matrix = gradient @ directions
    try:
        for _ in range(2):
            v = v - directions @ np.linalg.solve(matrix, gradient @ v)
    except np.linalg.LinAlgError:
        raise ConvergenceError(
            "the gradients of the constraints depend on each other here, so that constraint forces are not determined"
        ) from None
    return np.asarray(v)
