"""Attributes of a simulation that are read from its engine, or measured on it."""

from collections.abc import Callable
from difflib import get_close_matches
from operator import attrgetter
from typing import Any, ClassVar, Generic, TypeVar

from minimd.core.engine.observation import measure

T = TypeVar("T")
# for names that are not misspelt
HINTS = dict.fromkeys(
    ("timestep", "dt"), "give it to a new method: sim.method = VelocityVerlet(0.001)"
)
ARRAYS = ("positions", "velocities")


class Closed:
    """Base of a class whose objects refuse unknown attributes: setting a misspelt attribute would have no effect.

    own : names of attributes that exist only in objects.  Subclasses of users may set any attribute.
    """

    own: ClassVar[tuple[str, ...]] = ()

    def __setattr__(self, name: str, value: Any) -> None:
        kind = type(self)
        is_known = name.startswith("_") or name in kind.own or hasattr(kind, name)
        if "own" in vars(kind) and not is_known:
            hint = _hint(kind, name)
            raise AttributeError(
                f"a {kind.__name__} has no attribute {name!r} that could be set; {hint}"
            )
        super().__setattr__(name, value)


def _hint(kind: type[Closed], name: str) -> str:
    """What a user may have meant with an attribute of this name."""
    if name in HINTS:
        return HINTS[name]
    public = [attribute for attribute in dir(kind) if not attribute.startswith("_")]
    near = get_close_matches(name, [*kind.own, *public], n=1)
    return f"did you mean {near[0]!r}?" if near else "dir(...) lists its attributes"


class EngineAttribute(Generic[T]):
    """Attribute of a simulation that reads and sets the one of its engine with this name; read-only with a path.
    Forces are evaluated if they are not current. Positions and velocities are copied into the arrays of the system.

    check : function of the engine that raises an error for a value that it cannot have; the old value is then restored.
    """

    def __init__(
        self, doc: str, path: str = "", check: Callable[[Any], None] | None = None
    ) -> None:
        self.__doc__ = doc
        self._path = path
        self._check = check

    def __set_name__(self, _owner: type, name: str) -> None:
        self._name = name

    def __get__(self, simulation: Any, _owner: type) -> T:
        if simulation is not None and self._name == "forces":
            simulation.engine.enter()
            simulation.engine.evaluate()
        value: Any = self
        if simulation is not None:
            value = attrgetter(self._path or self._name)(simulation.engine)
        return value  # type: ignore[no-any-return]

    def __set__(self, simulation: Any, value: T) -> None:
        if self._path:
            raise AttributeError(
                f"{self._name} of a Simulation cannot be set; make a new Simulation"
            )
        if self._name == "forces":
            raise AttributeError("forces of a Simulation are computed and cannot be set")
        if self._name in ARRAYS:
            setattr(simulation.engine.system, self._name, value)
            return
        before = getattr(simulation.engine, self._name)
        setattr(simulation.engine, self._name, value)
        if self._check is not None:
            try:
                self._check(simulation.engine)
            except BaseException:
                setattr(simulation.engine, self._name, before)
                raise


class MeasuredAttribute(Generic[T]):
    """Read-only attribute of a simulation: the observable of this name, of the present state;
    forces are evaluated if they are not current."""

    def __init__(self, doc: str) -> None:
        self.__doc__ = f"{doc[:-1]}, of the present state."

    def __set_name__(self, _owner: type, name: str) -> None:
        self._name = name

    def __get__(self, simulation: Any, _owner: type) -> T:
        if simulation is None:
            itself: Any = self
            return itself  # type: ignore[no-any-return]
        simulation.engine.enter()
        value: T = measure(simulation.engine, self._name)
        return value

    def __set__(self, _simulation: Any, _value: T) -> None:
        see = "change the velocities, by set_temperature for example, or system.cell"
        raise AttributeError(f"{self._name} of a Simulation is measured and cannot be set; {see}")
