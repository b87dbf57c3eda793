"""Steps that end on the manifold g(y) = g₀ of the invariants, whatever the method: projections,
and Lagrange multipliers.

    ỹ = Φ_h(y₀)                     y₁ = ỹ + G(ỹ)ᵀ μ                  projected: standard projection
    ỹ = Φ_h(y₀ + G(y₀)ᵀ μ)          y₁ = ỹ + G(y₁)ᵀ μ                 symmetrically_projected
    y′ = f(t, y) − G(y)ᵀ z          z constant over the step          with_multipliers: the index-2 form, for any method
    the same, 0 = g(y) − g₀         z as the method has it            index_two: the problem, for DAE methods

with μ, or z, such that g(y₁) = g₀. The exact flow keeps g, so that the method keeps its order, and μ, z → 0 with h.
A symplectic method is no longer symplectic afterwards, even where its energy is then constant.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), IV.4 and V.4.1;
U. M. Ascher, L. R. Petzold, SIAM J. Numer. Anal. 28, 1097 (1991), for the index-2 form.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from minimd.compiled.machine import EPS
from minimd.console.words import shown
from minimd.integrators.dae.hessenberg import Hessenberg2
from minimd.integrators.manifold.invariants import Invariants, Manifold, check_invariants, corrected
from minimd.integrators.method import Array, Method, Problem, Step
from minimd.integrators.ode.partitioned import Partitioned
from minimd.integrators.ode.problems import FirstOrder
from minimd.structure.errors import ConvergenceError

__all__ = ["index_two", "projected", "symmetrically_projected", "with_multipliers"]

Arrival = Callable[[Array], Array]
MAX_CORRECTIONS = 50
SMALL = 1e-10  # relative errors of invariants below which they are taken for rounding once they no longer shrink


def projected(method: type[Method], invariants: Invariants) -> type[Method]:
    """The method, with the standard projection onto the manifold after each step. Neither symmetric nor symplectic.

    Parameters
    ----------
    method : any method, such as RadauIIA3; projected(RadauIIA3, energy)(0.05) is then a method with its time step.

    Raises
    ------
    TypeError : for anything but a method and Invariants.
    ConvergenceError : from a run, if a step cannot be brought to the manifold.
    """
    return _wrapped(method, invariants, "projected", StandardProjection)


def symmetrically_projected(method: type[Method], invariants: Invariants) -> type[Method]:
    """The method, with moves of the same size off the manifold before each step and back to it afterwards: symmetric,
    if the method is.

    Parameters, Raises : as for projected.
    """
    return _wrapped(method, invariants, "symmetrically-projected", SymmetricProjection)


def with_multipliers(method: type[Method], invariants: Invariants) -> type[Method]:
    """The method on y′ = f − Gᵀ z, with a z for each step such that it ends on the manifold: the index-2 form.

    Symmetric, if the method is.

    Problems with q and v become Partitioned, and steps implicit.

    Parameters, Raises : as for projected. TypeError from a run for other problems than SecondOrder, Partitioned,
        FirstOrder.
    """
    return _wrapped(method, invariants, "multipliers", MultiplierStep)


def _wrapped(method: type[Method], invariants: Invariants, verb: str, step: type["ManifoldStep"]) -> type[Method]:
    if not (isinstance(method, type) and issubclass(method, Method)):
        raise TypeError(f"method must be a method without a time step, such as RadauIIA3; got {shown(method)}")
    check_invariants(invariants)
    name = f"{verb}({method.name})"
    source = f"{verb}, Hairer, Lubich, Wanner (2006), IV.4, V.4: {method.source}"
    kept = {
        "order": method.order,
        "stages": method.stages,
        "order_on": method.order_on,
        "is_symmetric": step.is_symmetric and method.is_symmetric,
    }
    on = staticmethod(lambda problem: step(problem, method, invariants))
    own = {
        "__doc__": f"{name}.",
        "name": name,
        "source": source,
        "on": on,
        "is_symplectic": False,
        "is_explicit": False,
    }
    return type(f"{verb}({method.__name__})", (Method,), kept | own)


class ManifoldStep:
    """A step that begins and ends on the manifold through the first state of the run.  is_symmetric :
    whether it keeps the symmetry of the method."""

    is_symmetric = True

    def __init__(self, problem: Problem, method: type[Method], invariants: Invariants) -> None:
        self._shape, self._invariants = problem.shape, invariants
        self._manifold: Manifold | None = None  # known with the first state
        self._step: Step = method.on(problem)

    @property
    def nfev(self) -> int:
        """Evaluations of the right-hand side."""
        return self._step.nfev

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        if self._manifold is None:
            self._manifold = self._invariants.through(y, self._shape)
        return self._moved(self._manifold, t, y, h)

    def _moved(self, manifold: Manifold, t: float, y: Array, h: float) -> Array:
        raise NotImplementedError


class StandardProjection(ManifoldStep):
    """y₁ = ỹ + Q a, where the columns of Q span those of G(ỹ)ᵀ."""

    is_symmetric = False

    def _moved(self, manifold: Manifold, t: float, y: Array, h: float) -> Array:
        free = self._step(t, y, h)
        if not manifold.defect(free).any():
            return free
        q, r = manifold.frame(free)
        return arrival(manifold, lambda a: free + q @ a, lambda: r.T)


class SymmetricProjection(ManifoldStep):
    """ỹ = Φ(y₀ + G(y₀)ᵀ μ), y₁ = ỹ + G(y₁)ᵀ μ."""

    def _moved(self, manifold: Manifold, t: float, y: Array, h: float) -> Array:
        gradients = manifold.jacobian(y).T

        def arrive(mu: Array) -> Array:
            """The end y₁ = free + G(y₁)ᵀ μ of the step, by iteration: the image depends weakly on y₁."""
            y1 = free = self._step(t, y + gradients @ mu, h)
            for _ in range(MAX_CORRECTIONS):
                y1, before = free + manifold.jacobian(y1).T @ mu, y1
                if np.abs(y1 - before).max() <= EPS * np.abs(y1).max():
                    break
            return y1

        return arrival(manifold, arrive, lambda: 2.0 * _gram(manifold, y))


class MultiplierStep(ManifoldStep):
    """The step on y′ = f − Gᵀ z, repeated with other z until it ends on the manifold."""

    def __init__(self, problem: Problem, method: type[Method], invariants: Invariants) -> None:
        self._z: Array = np.zeros(0)
        super().__init__(corrected(problem, self._pull, lambda y, shape: None), method, invariants)

    def _pull(self, y: Array) -> Array:
        """−G(y)ᵀ z."""
        return -self._manifold.jacobian(y).T @ self._z if self._z.any() and self._manifold else np.zeros(y.size)

    def _moved(self, manifold: Manifold, t: float, y: Array, h: float) -> Array:
        def arrive(z: Array) -> Array:
            self._z = z
            return self._step(t, y, h)

        return arrival(manifold, arrive, lambda: -h * _gram(manifold, y))


class IndexTwo(Hessenberg2):
    """y′ = f(t, y) − G(y)ᵀ z, 0 = g(y) − g₀. A state holds y and z; z is zero on exact solutions."""

    def __init__(self, problem: Problem, invariants: Invariants) -> None:
        super().__init__(
            lambda t, y, z: problem.field(t, y) - self._manifold.jacobian(y).T @ z,
            lambda y: self._manifold.defect(y),
            problem.solver,
        )
        self._problem, self._invariants = problem, invariants

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The start of the problem itself, (q, v) or y, as a state.

        Raises ValueError if it is not on the manifold of given values,
        or if the gradients of the invariants are not independent.
        """
        y = self._problem.begin(start)
        self._manifold = self._invariants.through(y, self._problem.shape)
        return super().begin((y,), t0)


def index_two(problem: Problem, invariants: Invariants) -> IndexTwo:
    """The differential-algebraic problem y′ = f − Gᵀ z, 0 = g − g₀ of index 2, for methods such as RadauIIA3.

    Its start is that of the problem. index_two(…).parts(solution.y) are y, that is (q, v) as one array, and z.

    Parameters
    ----------
    problem : SecondOrder, Partitioned or FirstOrder, with Newton() as its solver.

    Raises
    ------
    TypeError : for problems of other kinds.
    """
    check_invariants(invariants)
    if not isinstance(problem, (Partitioned, FirstOrder)):
        raise TypeError(f"problem must be SecondOrder, Partitioned or FirstOrder; got {type(problem).__name__}")
    return IndexTwo(problem, invariants)


def arrival(manifold: Manifold, arrive: Arrival, slope: Callable[[], Array]) -> Array:
    """arrive(z) with g(arrive(z)) = g₀, to rounding: Newton's method from z = 0,
    the matrix updated by Broyden's formula.

    arrive : (n,) state as a function of (m,) numbers z.  slope : a function that returns a guess of ∂g(arrive(z))/∂z,
        (m, m).
    Raises ConvergenceError with the largest error of an invariant.
    C. G. Broyden, Math. Comput. 19, 577 (1965), eq. 4.2.
    """
    z = np.zeros(manifold.value.size)
    y = best = arrive(z)
    # rounding errors of the invariants are EPS times |g₀|, or Σ |G y|, whose terms may cancel in g
    scale = np.maximum(np.abs(manifold.value), np.abs(manifold.jacobian(y)) @ np.abs(y)) + np.finfo(float).tiny
    defect = manifold.defect(y)
    least, n_stalls = float(np.max(np.abs(defect) / scale)), 0
    matrix = slope() if least > EPS else np.eye(z.size)
    for _ in range(MAX_CORRECTIONS):
        if least <= EPS or n_stalls > 1 or not np.isfinite(defect).all() or not np.linalg.det(matrix):
            break
        dz = -np.linalg.solve(matrix, defect)
        z = z + dz
        y = arrive(z)
        defect = manifold.defect(y)
        error = float(np.max(np.abs(defect) / scale))
        if error < least or error > SMALL:  # else it is rounding, from which no slope follows
            matrix = matrix + np.outer(defect, dz) / (dz @ dz)
        n_stalls += least <= error <= SMALL
        best, least = (y, error) if error < least else (best, least)
    if least <= SMALL:
        return best
    k = int(np.argmax(np.abs(defect) / scale))
    raise ConvergenceError(
        f"the state could not be brought to the manifold of the invariants: invariant {k} is off by {defect[k]:.1e}"
    )


def _gram(manifold: Manifold, y: Array) -> Array:
    """G Gᵀ = Rᵀ R."""
    r = manifold.frame(y)[1]
    return r.T @ r
