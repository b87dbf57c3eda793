"""Differential equations as the methods for small systems see them.

    SecondOrder   q″ = f(t, q, v)                               planets, pendulums, particles
    Partitioned   q′ = g(t, q, v),  v′ = f(t, q, v)             any Hamiltonian, with v for the momenta
    FirstOrder    y′ = f(t, y)

A function is written with the arguments it needs, called t, q and v: what it does not take it cannot depend on, and that
is how a method knows that a step is explicit. A function that takes all three is never trusted to ignore one: the step is
then solved as an implicit one, and is done at once where it turns out to be explicit after all.
"""

from collections.abc import Callable
from math import prod
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.integrators.method import Step
from minimd.integrators.ode.arguments import argument_names
from minimd.integrators.ode.newton import Newton, Solver
from minimd.integrators.ode.partitioned import EulerStep, SequenceStep
from minimd.integrators.splitting.order_conditions import nystrom_order, separable_order
from minimd.integrators.splitting.substeps import Substeps

Array = NDArray[np.float64]
Function = Callable[..., Any]


class Problem(Protocol):
    """y′ = f(t, y) or F(t, y, y′) = 0, given a start. States are one-dimensional arrays."""

    solver: Solver

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Shape of q and of v, None for problems without them."""
        ...

    def begin(self, start: Any) -> Array:
        """The start as a state; shapes are checked and remembered."""
        ...

    def field(self, t: float, y: Array) -> Array:
        """y′."""
        ...

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """F(t, y, y′), zero on a solution; y′ − f(t, y) if the problem is explicit."""
        ...


class Field:
    """A function of the user, called with t, q, v whatever it takes, and answering with a fresh flat array."""

    def __init__(self, function: Function, usual: str, name: str) -> None:
        self.takes = _arguments(function, usual, name)
        self.name = name
        self.shape: tuple[int, ...] | None = None  # of its answers, known once there is a start
        self._call = _CALLS[self.takes](function)

    def __call__(self, t: float, q: Array, v: Array) -> Array:
        """(n,) values of the function."""
        return _values(self._call(t, q, v), self.shape, self.name)


def _values(answer: Any, shape: tuple[int, ...] | None, name: str) -> Array:
    """A fresh flat array of what a function of the user answered, if that has the right shape; one number may come without its brackets."""
    values = np.array(answer)
    if values.dtype.kind not in "fiub":
        raise TypeError(f"{name} must answer with real numbers; got {answer!r}")
    if shape is not None and values.shape != shape and not values.size == prod(shape) == 1:
        raise ValueError(f"{name} must answer with an array of shape {shape}; got shape {values.shape}")
    return values.reshape(-1).astype(float, copy=False)


_CALLS: dict[str, Callable[[Function], Function]] = {
    "": lambda f: lambda t, q, v: f(),
    "t": lambda f: lambda t, q, v: f(t),
    "q": lambda f: lambda t, q, v: f(q),
    "v": lambda f: lambda t, q, v: f(v),
    "tq": lambda f: lambda t, q, v: f(t, q),
    "tv": lambda f: lambda t, q, v: f(t, v),
    "qv": lambda f: lambda t, q, v: f(q, v),
    "tqv": lambda f: f,
}


def _arguments(function: Function, usual: str, name: str) -> str:
    """Which of t, q, v a function takes: by their names, else by their number if it is the usual one or three."""
    names = argument_names(function, name)
    if names is None:
        return usual
    if set(names) <= set("tqv") and "".join(names) in _CALLS:
        return "".join(names)
    substeps = "tqv" if len(names) == 3 else usual
    if len(names) == len(substeps) and all(given == substep or given not in ("t", "q", "v") for given, substep in zip(names, substeps, strict=True)):
        return substeps
    raise TypeError(f"{name} must take some of t, q, v, in this order and under these names; it takes ({', '.join(names)})")


class Partitioned:
    """q′ = g(t, q, v), v′ = f(t, q, v).

    Parameters
    ----------
    g, f : functions of t, q, v, or of those of them they depend on: g(v), f(q), f(t, q), …; q and v have the shape of the start,
        and so have the answers. q and v are not to be changed.
    g_q, f_v : (n, n) Jacobians ∂g/∂q and ∂f/∂v, functions of t, q, v; found by finite differences if not given.
    solver : Newton() or FixedPoint(), for steps that turn out implicit.

    Raises
    ------
    TypeError : for anything but functions, or functions whose arguments are called otherwise.
    """

    def __init__(self, g: Function, f: Function, g_q: Function | None = None, f_v: Function | None = None, solver: Solver = Newton()) -> None:  # noqa: B008
        self.g, self.f = Field(g, "v", "g"), Field(f, "q", "f")
        self.g_q = g_q if g_q is None else Field(g_q, "tqv", "g_q")
        self.f_v = f_v if f_v is None else Field(f_v, "tqv", "f_v")
        self.solver = _checked(solver)
        self.shape: tuple[int, ...] = ()  # of q and of v, known once there is a start
        self.g_is_v = False

    @property
    def is_separable(self) -> bool:
        """Whether g takes v alone and f does not take v, so that each half can be solved exactly."""
        return self.g.takes in ("", "v") and "v" not in self.f.takes

    def begin(self, start: tuple[ArrayLike, ArrayLike]) -> Array:
        """(q, v) as one state of length 2n.

        Raises
        ------
        ValueError : if q and v do not have the same shape, or a value is not finite; g and f answer with that shape, or raise it.
        """
        if not isinstance(start, (tuple, list, np.ndarray)) or len(start) != 2:
            raise ValueError(f"the start must be a pair, (q, v); got {start!r}")
        q, v = (np.array(part, dtype=float) for part in start)
        if q.shape != v.shape or q.size == 0:
            raise ValueError(f"q and v of the start must have the same shape, and at least one element; got {q.shape} and {v.shape}")
        self.shape = self.g.shape = self.f.shape = q.shape
        y = np.concatenate([q.reshape(-1), v.reshape(-1)])
        _check_finite(y)
        return y

    def sequence_step(self, row: Substeps) -> Step:
        """The step of a splitting: kicks and drifts if the problem is separable, else the implicit form of the method."""
        return SequenceStep(self, row) if self.is_separable else EulerStep(self, row)

    def sequence_order(self, row: Substeps) -> int:
        """Order of a splitting on this problem; rows made for q″ = f(q) alone can have a higher one there than elsewhere."""
        return separable_order(row)

    def halves(self, y: Array) -> tuple[Array, Array]:
        """Views of q and v, in their shape."""
        n = y.size // 2
        q, v = y[:n], y[n:]
        return (q, v) if len(self.shape) == 1 else (q.reshape(self.shape), v.reshape(self.shape))

    def field(self, t: float, y: Array) -> Array:
        """(g, f) as one array of length 2n."""
        q, v = self.halves(y)
        return np.concatenate([self.g(t, q, v), self.f(t, q, v)])

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """y′ − (g, f)."""
        return slope - self.field(t, y)


class SecondOrder(Partitioned):
    """q″ = f(t, q, v): Newton's equation, f being force over mass.

    Parameters
    ----------
    f : a function of q, of t and q, or of t, q and v.  f_v, solver : as for Partitioned.
    """

    def __init__(self, f: Function, f_v: Function | None = None, solver: Solver = Newton()) -> None:  # noqa: B008
        super().__init__(lambda v: v, f, f_v=f_v, solver=solver)
        self.g_is_v = True

    def sequence_order(self, row: Substeps) -> int:
        """See Partitioned."""
        return nystrom_order(row) if self.is_separable else separable_order(row)


class FirstOrder:
    """y′ = f(t, y).

    Parameters
    ----------
    f : function of t and y, or of y.  jacobian : (n, n) ∂f/∂y as a function of the same, found by finite differences if not given.
    solver : Newton() or FixedPoint().
    """

    shape = None

    def __init__(self, f: Function, jacobian: Function | None = None, solver: Solver = Newton()) -> None:  # noqa: B008
        self._f = _of_time_and_state(f, "f")
        self.jacobian = jacobian if jacobian is None else _of_time_and_state(jacobian, "jacobian")
        self.solver = _checked(solver)

    def begin(self, start: ArrayLike) -> Array:
        """The start as a state of length n.

        Raises
        ------
        ValueError : if it is no array of one dimension, or a value is not finite; f answers with its shape, or raises it.
        """
        y = np.array(start, dtype=float)
        if y.ndim != 1 or y.size == 0:
            raise ValueError(f"the start must be a one-dimensional array with at least one element; got shape {y.shape}")
        _check_finite(y)
        return y

    def field(self, t: float, y: Array) -> Array:
        """f(t, y)."""
        return _values(self._f(t, y), y.shape, "f")

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """y′ − f(t, y)."""
        return slope - self.field(t, y)


def _of_time_and_state(function: Function, name: str) -> Function:
    names = argument_names(function, name) or ["y"]
    if names == ["t"]:
        return lambda t, y: function(t)
    if len(names) > 2 or (len(names) == 2 and (names[0] == "y" or names[1] == "t")):
        raise TypeError(f"{name} must take y, or t and y, in this order; it takes ({', '.join(names)})")
    return function if len(names) == 2 else lambda t, y: function(y)


def _checked(solver: Solver) -> Solver:
    if not isinstance(solver, Newton):
        raise TypeError(f"solver must be Newton() or FixedPoint(); got {solver!r}")
    return solver


def _check_finite(y: Array) -> None:
    if not np.isfinite(y).all():
        k = int(np.argmin(np.isfinite(y)))
        raise ValueError(f"the start must be finite; element {k} is {y[k]}")
