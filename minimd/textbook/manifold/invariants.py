"""Invariants g(y), which the exact flow keeps, the manifold that they define, stabilization, and projected steps.

    ỹ = Φ_h(y₀)                     y₁ = ỹ + G(ỹ)ᵀ μ                  projected: standard projection
    ỹ = Φ_h(y₀ + G(y₀)ᵀ μ)          y₁ = ỹ + G(y₁)ᵀ μ                 symmetrically_projected
    y′ = f(t, y) − G(y)ᵀ z          z constant over the step          with_multipliers: the index-2 form, for any method
    the same, 0 = g(y) − g₀         z as the method has it            index_two: the problem, for DAE methods
    y′ = f(t, y) − γ F(y) (g(y) − g₀)    F = D (G D)⁻¹,  D = Gᵀ       stabilized: the problem, for any method

with G = ∂g/∂y and μ, or z, such that g(y₁) = g₀. The exact flow keeps g, so that the method keeps its order, and
μ, z → 0 with h. A symplectic method is no longer symplectic afterwards, even where its energy is then constant.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), IV.4 and V.4.1;
U. M. Ascher, L. R. Petzold, SIAM J. Numer. Anal. 28, 1097 (1991), for the index-2 form.

Stabilization changes nothing on the manifold g = g₀; away from it g − g₀ decays like e^(−γt), whatever f does along the
manifold. U. M. Ascher, H. Chin, S. Reich, Numer. Math. 67, 131 (1994); U. M. Ascher, L. R. Petzold, Computer Methods
for Ordinary Differential Equations and Differential-Algebraic Equations (1998), 9.2.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.compiled.machine import EPS
from minimd.core.integrators.method import Method, Problem, Step, check_class
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_kind, checked_number, checked_numbers
from minimd.core.structure.errors import ConvergenceError
from minimd.textbook.dae.hessenberg import Hessenberg2
from minimd.textbook.ode.functions import Function, Map, checked_values, derivative, reading
from minimd.textbook.ode.problems import FirstOrder, Partitioned

__all__ = [
    "Invariants",
    "index_two",
    "projected",
    "stabilized",
    "symmetrically_projected",
    "with_multipliers",
]

Shape = tuple[int, ...] | None
# sine of the angle between a gradient and the span of the others below which they count as dependent
PARALLEL = 1e-8
MAX_CORRECTIONS = 50
# relative errors of invariants below which they are taken for rounding once they no longer shrink
SMALL = 1e-10


class Invariants:
    """m quantities that are constant along solutions.

    Parameters
    ----------
    g : function of y, or of q and v (or of one of them), in the shape of the start; a number or an array of m numbers.
    jacobian : G = ∂g/∂y as a function of the same, m × (size of y) numbers in any shape; q and v are concatenated to y.
        By differences of order 6 if not given.
    value : (m,) numbers to be kept; g of the start if not given.

    Raises
    ------
    TypeError : for anything but functions, or arguments other than y, q, v.
    """

    def __init__(
        self, g: Function, jacobian: Function | None = None, value: ArrayLike | None = None
    ) -> None:
        self.g = _of_state(g, "g")
        self.jacobian = jacobian if jacobian is None else _of_state(jacobian, "jacobian")
        self.value = None
        if value is not None:
            self.value = checked_numbers("value", value, "numbers").reshape(-1)

    def through(self, y: Array, shape: Shape = None) -> "Manifold":
        """The manifold g = value, or g = g(y) if no value was given.
        y : (n,) state.
        shape : of q and v, None for problems without them.
        Raises ValueError if the numbers of values, derivatives and unknowns do not fit, or values are not finite."""
        return Manifold(self, y, shape)


class Manifold:
    """{y : g(y) = value}. value : (m,).  Arguments and errors : see Invariants.through."""

    def __init__(self, invariants: Invariants, y: Array, shape: Shape) -> None:
        answer = invariants.g(y, shape)
        self.value = answer if invariants.value is None else invariants.value
        self._invariants = invariants
        self._shape = shape
        if answer.size != self.value.size:
            raise ValueError(
                f"value must have one number per invariant; g has {answer.size}, value has {self.value.size}"
            )

        if not 0 < answer.size < y.size:
            raise ValueError(
                f"there must be fewer invariants than unknowns, and at least one; got {answer.size} invariants of "
                f"{y.size} unknowns"
            )

        if not (np.isfinite(answer).all() and np.isfinite(self.value).all()):
            raise ValueError(
                f"g and its value must be finite at the start; g = {_brief(answer)}, value = {_brief(self.value)}"
            )

        if invariants.jacobian is None:
            return
        size = invariants.jacobian(y, shape).size
        if size != answer.size * y.size:
            raise ValueError(
                f"jacobian must have {answer.size} × {y.size} numbers, ∂g/∂y; got {size}"
            )

    def defect(self, y: Array) -> Array:
        """(m,) g(y) − value."""
        return self._invariants.g(y, self._shape) - self.value

    def jacobian(self, y: Array) -> Array:
        """(m, n) G(y)."""
        jacobian: Any = self._invariants.jacobian
        of_state = jacobian and (lambda x: jacobian(x, self._shape))
        return derivative(self.defect, of_state, y)

    def frame(self, y: Array) -> tuple[Array, Array]:
        """Gᵀ = Q R: (n, m) orthonormal directions Q that span the gradients, and upper triangular (m, m) R.
        Raises ConvergenceError where the gradients of the invariants are not independent."""
        gradients = self.jacobian(y).T
        q, r = np.linalg.qr(gradients)
        sizes = np.maximum(np.linalg.norm(gradients, axis=0), np.finfo(float).tiny)
        is_independent = np.abs(np.diagonal(r)) / sizes > PARALLEL
        if not is_independent.all():
            k = np.argmin(is_independent)
            raise ConvergenceError(
                f"invariant {k} is not independent: its gradient {_brief(gradients[:, k])} vanishes, or lies in the "
                "span of earlier gradients; the Jacobian of invariants must have full rank"
            )
        return q, r


def check_invariants(invariants: Invariants) -> None:
    """TypeError for anything but Invariants."""
    checked_kind(
        "invariants", invariants, Invariants, "Invariants(g), with a function g(y) or g(q, v)"
    )


Begun = Callable[[Array, Shape], None]


class Corrected(Problem):
    """A problem with a correction of y′, a function of the state.
    begun : called with each start and its shape."""

    def __init__(self, problem: Any, correction: Map, begun: Begun, *functions: Function) -> None:
        super().__init__(*functions, solver=problem.solver)  # type: ignore[call-arg]
        self._problem = problem
        self._correction = correction
        self._begun = begun
        self.shape = problem.shape

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The start as a state."""
        y: Array = self._problem.begin(start)
        self.shape = self._problem.shape
        self._begun(y, self.shape)
        return y

    def field(self, t: float, y: Array) -> Array:
        """y′ of the problem, plus the correction."""
        return np.asarray(self._problem.field(t, y) + self._correction(y))


class CorrectedPartitioned(Corrected, Partitioned):
    """q′ = g + c_q, v′ = f + c_v with a correction c(q, v)."""


class CorrectedFirstOrder(Corrected, FirstOrder):
    """y′ = f + c(y)."""


def corrected(
    problem: Problem, correction: Map, begun: Begun
) -> CorrectedPartitioned | CorrectedFirstOrder:
    """A problem of the same kind with a term added to y′; one with q and v is then Partitioned, and its steps implicit.
    Raises TypeError for problems of other kinds."""
    if isinstance(problem, FirstOrder):
        return CorrectedFirstOrder(problem, correction, begun, problem.field)
    if not isinstance(problem, Partitioned):
        raise TypeError(
            f"y′ can be corrected in SecondOrder, Partitioned and FirstOrder problems; got {type(problem).__name__}"
        )

    def of(q: Array, v: Array) -> Array:
        return correction(np.concatenate([q.reshape(-1), v.reshape(-1)]))

    return CorrectedPartitioned(
        problem,
        correction,
        begun,
        lambda t, q, v: problem.g(t, q, v) + of(q, v)[: q.size],
        lambda t, q, v: problem.f(t, q, v) + of(q, v)[q.size :],
    )


def stabilized(
    problem: Problem, invariants: Invariants, gamma: float
) -> CorrectedPartitioned | CorrectedFirstOrder:
    """The problem y′ = f − γ Gᵀ (G Gᵀ)⁻¹ (g − g₀), for any method: its solutions approach the manifold g = g₀.

    For one invariant, such as the energy, it reads y′ = f − γ (H − H₀) ∇H / |∇H|². Distances are those of y: choose
    units in which its components have similar sizes. A problem with q and v becomes Partitioned, and its steps
    implicit. Far from the manifold give the Jacobian of the invariants in closed form: y′ contains the noise of
    differences, 1e-13, with which implicit steps may not be solved.

    Parameters
    ----------
    problem : SecondOrder, Partitioned or FirstOrder.
    gamma : rate γ at which g − g₀ decays [1/time], positive; γΔt should be at most about one.

    Raises
    ------
    ValueError : if γ is not positive and finite.
    TypeError : for problems of other kinds.
    ConvergenceError : from a run, where the gradients of the invariants are not independent.
    """
    check_invariants(invariants)
    checked_number("gamma", gamma, "positive and finite")
    manifold: Manifold

    def begin(y: Array, shape: Shape) -> None:
        nonlocal manifold
        manifold = invariants.through(y, shape)

    def correction(y: Array) -> Array:
        """−γ Gᵀ (G Gᵀ)⁻¹ (g − g₀) = −γ Q R⁻ᵀ (g − g₀)."""
        defect = manifold.defect(y)
        if not defect.any():
            return np.zeros(y.size)
        q, r = manifold.frame(y)
        return -float(gamma) * (q @ np.linalg.solve(r.T, defect))

    return corrected(problem, correction, begin)


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
    """The method, with moves of the same size off the manifold before each step and back to it: symmetric, if it is.

    Parameters, Raises : as for projected."""
    return _wrapped(method, invariants, "symmetrically-projected", SymmetricProjection)


def with_multipliers(method: type[Method], invariants: Invariants) -> type[Method]:
    """The method on y′ = f − Gᵀ z, with a z for each step such that it ends on the manifold: the index-2 form.

    Symmetric, if the method is. Problems with q and v become Partitioned, and steps implicit.

    Parameters, Raises : as for projected. TypeError from a run for other problems than SecondOrder, Partitioned,
        FirstOrder."""
    return _wrapped(method, invariants, "multipliers", MultiplierStep)


def _wrapped(
    method: type[Method], invariants: Invariants, verb: str, step: "type[ManifoldStep]"
) -> type[Method]:
    check_class(method)
    check_invariants(invariants)
    name = f"{verb}({method.name})"
    members = {
        "__doc__": f"{name}.",
        "name": name,
        "source": f"{verb}, Hairer, Lubich, Wanner (2006), IV.4, V.4: {method.source}",
        "order": method.order,
        "order_on": method.order_on,
        "stages": method.stages,
        "on": staticmethod(lambda problem: step(problem, method, invariants)),
        "is_symmetric": step.is_symmetric and method.is_symmetric,
        "is_symplectic": False,
        "is_explicit": False,
    }
    return type(f"{verb}({method.__name__})", (Method,), members)


class ManifoldStep:
    """A step that begins and ends on the manifold through the first state of the run."""

    is_symmetric = True  # whether it keeps the symmetry of the method

    def __init__(self, problem: Problem, method: type[Method], invariants: Invariants) -> None:
        self._shape = problem.shape
        self._invariants = invariants
        self._manifold: Any = None  # known with the first state
        self._step: Step = method.on(problem)

    @property
    def nfev(self) -> int:
        """Evaluations of the right-hand side."""
        return self._step.nfev

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h)."""
        if self._manifold is None:
            self._manifold = self._invariants.through(y, self._shape)
        return self._moved(t, y, h)

    def _moved(self, t: float, y: Array, h: float) -> Array:
        raise NotImplementedError


class StandardProjection(ManifoldStep):
    """y₁ = ỹ + Q a, where the columns of Q span those of G(ỹ)ᵀ."""

    is_symmetric = False

    def _moved(self, t: float, y: Array, h: float) -> Array:
        manifold = self._manifold
        free = self._step(t, y, h)
        if not manifold.defect(free).any():
            return free
        q, r = manifold.frame(free)
        return arrival(manifold, lambda a: free + q @ a, lambda: r.T)


class SymmetricProjection(ManifoldStep):
    """ỹ = Φ(y₀ + G(y₀)ᵀ μ), y₁ = ỹ + G(y₁)ᵀ μ."""

    def _moved(self, t: float, y: Array, h: float) -> Array:
        manifold = self._manifold
        gradients = manifold.jacobian(y).T

        def arrive(mu: Array) -> Array:
            """The end y₁ = free + G(y₁)ᵀ μ of the step, by iteration: the image depends weakly on y₁."""
            y1 = free = self._step(t, y + gradients @ mu, h)
            for _ in range(MAX_CORRECTIONS):
                before = y1
                y1 = free + manifold.jacobian(y1).T @ mu
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
        if not self._z.any():
            return np.zeros(y.size)
        return -self._manifold.jacobian(y).T @ self._z

    def _moved(self, t: float, y: Array, h: float) -> Array:
        def arrive(z: Array) -> Array:
            self._z = z
            return self._step(t, y, h)

        manifold = self._manifold
        return arrival(manifold, arrive, lambda: -h * _gram(manifold, y))


class IndexTwo(Hessenberg2):
    """y′ = f(t, y) − G(y)ᵀ z, 0 = g(y) − g₀. A state holds y and z; z is zero on exact solutions."""

    def __init__(self, problem: Problem, invariants: Invariants) -> None:
        super().__init__(
            lambda t, y, z: problem.field(t, y) - self._manifold.jacobian(y).T @ z,
            lambda y: self._manifold.defect(y),
            problem.solver,
        )
        self._problem = problem
        self._invariants = invariants

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The start of the problem itself, (q, v) or y, as a state.
        Raises ValueError if it is not on the manifold of given values, or if the gradients are not independent."""
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
    wanted = "SecondOrder, Partitioned or FirstOrder"
    return IndexTwo(checked_kind("problem", problem, Partitioned | FirstOrder, wanted), invariants)


def arrival(manifold: Manifold, arrive: Map, slope: Callable[[], Array]) -> Array:
    """arrive(z) with g(arrive(z)) = g₀, to rounding: Newton's method from z = 0, the matrix updated as by Broyden.
    arrive : (n,) state as a function of (m,) numbers z.
    slope : answers with a guess of ∂g(arrive(z))/∂z, (m, m).
    Raises ConvergenceError with the largest error of an invariant.
    C. G. Broyden, Math. Comput. 19, 577 (1965), eq. 4.2."""
    z = np.zeros(manifold.value.size)
    y = best = arrive(z)
    # rounding errors of the invariants are EPS times |g₀|, or Σ |G y|, whose terms may cancel in g
    terms = np.abs(manifold.jacobian(y)) @ np.abs(y)
    scale = np.maximum(np.abs(manifold.value), terms) + np.finfo(float).tiny
    defect = manifold.defect(y)
    least = np.max(np.abs(defect) / scale)
    n_stalls = 0
    matrix = slope() if least > EPS else np.eye(z.size)

    for _ in range(MAX_CORRECTIONS):
        has_ended = least <= EPS or n_stalls > 1
        if has_ended or not np.isfinite(defect).all() or not np.linalg.det(matrix):
            break
        dz = -np.linalg.solve(matrix, defect)
        z = z + dz
        y = arrive(z)
        defect = manifold.defect(y)
        error = np.max(np.abs(defect) / scale)
        if error < least or error > SMALL:  # else it is rounding, from which no slope follows
            matrix = matrix + np.outer(defect, dz) / (dz @ dz)
        n_stalls += least <= error <= SMALL
        if error < least:
            best = y
            least = error

    if least <= SMALL:
        return best
    k = np.argmax(np.abs(defect) / scale)
    raise ConvergenceError(
        f"the state could not be brought to the manifold of the invariants: invariant {k} is off by {defect[k]:.1e}"
    )


def _gram(manifold: Manifold, y: Array) -> Array:
    """G Gᵀ = Rᵀ R."""
    r = manifold.frame(y)[1]
    return r.T @ r


def _of_state(function: Function, name: str) -> Callable[[Array, Shape], Array]:
    """The function as one of the state and the shape of q and v, with fresh flat answers."""
    taken, call = reading(
        function, "t y q v", name, "q v", "a function of y, or of q and v", unknown="y"
    )
    takes_halves = "q" in taken or "v" in taken
    if "t" in taken:
        raise TypeError(
            f"{name} must not depend on t; invariants are functions of y, or of q and v"
        )

    def answer(y: Array, shape: Shape) -> Array:
        if takes_halves and shape is None:
            raise TypeError(
                f"{name} takes q and v, but the problem has none; write it as a function of y"
            )

        halves = y.reshape(2, *shape) if takes_halves and shape is not None else (y, y)
        return checked_values(call(0.0, y, *halves), None, name)

    return answer


def _brief(numbers: Array) -> str:
    return np.array2string(numbers, precision=3, threshold=8)
