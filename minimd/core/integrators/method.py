"""The base class of all one-step methods, and the protocols of problems and steps: y(t) → y(t+h)."""

from collections.abc import Callable
from inspect import signature
from types import ModuleType
from typing import Any, ClassVar, Protocol

from minimd.core.console.display import Displayed, Rows, as_text, call_of
from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import SHORTEST, checked_number

__all__ = ["Method"]


class Problem(Protocol):
    """y′ = f(t, y) or F(t, y, y′) = 0, with initial values. States are one-dimensional arrays.
    solver : Newton() or FixedPoint(), for implicit steps.
    shape : of q and of v, None for problems without them.
    remark : what limits the accuracy of solutions beyond method and rounding, if anything does; known after begin."""

    solver: Any
    shape: Any
    remark: str = ""

    def begin(self, start: Any, t0: float = 0.0) -> Array:
        """The initial values at time t0 as a state; their shapes are checked and remembered."""

    def field(self, t: float, y: Array) -> Array:
        """y′."""

    def residual(self, t: float, y: Array, slope: Array) -> Array:
        """F(t, y, y′), zero on a solution; y′ − f(t, y) if the problem is explicit."""
        return slope - self.field(t, y)


class Step(Protocol):
    """One step of a method on a problem: y(t) → y(t+h). It never changes y, and counts its evaluations in nfev.
    A step may remember what it knows about the state it returned last, its force say, and know it as the same array."""

    @property
    def nfev(self) -> int:
        """Evaluations of the right-hand side so far."""

    def __call__(self, t: float, y: Array, h: float) -> Array:
        """y(t+h) from y(t); h may be negative."""


class ClassProperty:
    """An attribute of a class, or of an instance, that is computed, here from the coefficients of a method, whenever it
    is read."""

    def __init__(self, compute: Callable[[Any], Any]) -> None:
        self._compute = compute

    def __get__(self, instance: object, owner: type) -> Any:
        return self._compute(owner if instance is None else instance)


class Method(Displayed):
    """A method with its time step.

    Parameters
    ----------
    timestep : Δt [time], finite and not zero; a negative one runs time backwards.

    Attributes of each method
    -------------------------
    name, source : key in METHODS; literature.
    order : p of the global error O(Δtᵖ).
    stages : evaluations of the force, or systems of stage equations, per step.
    is_symmetric : whether Φ_Δt ∘ Φ_{−Δt} = 1.
    is_symplectic : for Hamiltonian problems.
    is_explicit : whether separable problems are stepped without solving equations.

    Raises
    ------
    ValueError : if the time step is zero or not finite.
    """

    timestep: float
    name: ClassVar[str]
    source: ClassVar[str]
    order: Any
    stages: Any
    is_symmetric: Any
    is_symplectic: ClassVar[Any]
    is_explicit: ClassVar[bool]

    def __init__(self, timestep: float) -> None:
        self.timestep = checked_number("timestep", timestep, "finite and not zero", SHORTEST)

    def __repr__(self) -> str:
        return call_of(self, self.parameters)

    @property
    def parameters(self) -> dict[str, float]:
        """The constructor arguments that recreate this method, by name: its attributes with the names of arguments,
        without those that have their default."""
        return {
            name: getattr(self, name)
            for name, argument in signature(type(self)).parameters.items()
            if getattr(self, name, argument.default) is not argument.default
        }

    def display_rows(self) -> Rows:
        """See Displayed."""
        properties = f"{type(self).__name__}, order {self.order}"
        if self.is_symmetric:
            properties += ", symmetric"
        if self.is_symplectic:
            properties += ", symplectic"
        rows = [("method", properties)]
        rows += [(name, as_text(value)) for name, value in self.parameters.items()]
        if hasattr(self, "source"):
            rows.append(("source", self.source))
        return rows

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """The step of this method on a problem that has its initial values.
        Raises TypeError if the method cannot be used on such problems."""
        raise NotImplementedError

    @classmethod
    def order_on(cls, problem: Problem) -> int:
        """Order on this problem, which can be lower than on the problems for which the method was made."""
        return cls.order


def check_class(method: Any, kind: type[Method] = Method) -> None:
    """TypeError for anything but the class of a method.
    kind : its base class."""
    if not (isinstance(method, type) and issubclass(method, kind)):
        raise TypeError(
            f"method must be a class, such as VelocityVerlet, not an object; method = {shown(method)}"
        )


def methods_of(*modules: ModuleType) -> dict[str, Any]:
    """The methods that modules define, by name: their public classes that have an attribute `name`."""
    methods = {}
    for module in modules:
        for name, value in vars(module).items():
            if name in module.__all__ and hasattr(value, "name"):
                methods[value.name] = value
    return methods
