"""Attributes of a simulation that are read from its engine, or measured on it."""

from collections.abc import Callable
from operator import attrgetter
from typing import Any, ClassVar, Generic, TypeVar

from minimd.core.console.words import near
from minimd.core.engine.observation import measure

T = TypeVar("T")
# for names that are not misspelt
OF_METHOD = "; it is sim.method.timestep; change it by sim.method = VelocityVerlet(0.001)"
HINTS = {
    "timestep": OF_METHOD,
    "dt": OF_METHOD,
    "virial": "; see sim.pressure, md.evaluate(sim.system, sim.potentials).virial",
}
ARRAYS = ("positions", "velocities")


class Closed:
    """Base of a class whose objects refuse unknown attributes: setting a misspelt attribute would have no effect.
    One that is asked for is answered with what a user may have meant.

    own : names of attributes that exist only in objects.  Subclasses of users may set any attribute.
    """

    own: ClassVar[tuple[str, ...]] = ()

    def __setattr__(self, name: str, value: Any) -> None:
        kind = type(self)
        is_known = name.startswith("_") or name in kind.own or hasattr(kind, name)
        if "own" in vars(kind) and not is_known:
            raise AttributeError(
                f"a {kind.__name__} has no attribute {name!r} that could be set{_hint(kind, name)}"
            )
        super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        kind = type(self)
        if name.startswith("_") or hasattr(kind, name):
            return super().__getattribute__(name)  # it raises again what was raised within
        raise AttributeError(f"a {kind.__name__} has no attribute {name!r}{_hint(kind, name)}")


def _hint(kind: type[Closed], name: str) -> str:
    """What a user may have meant with an attribute of this name."""
    public = [attribute for attribute in dir(kind) if not attribute.startswith("_")]
    hint = HINTS.get(name) or near(name, [*kind.own, *public])
    return hint or "; dir(...) lists its attributes, docs/where-is.md words of the field"


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
        raise AttributeError(
            f"{self._name} of a Simulation is measured and cannot be set; change the velocities, by set_temperature "
            "for example, or system.cell"
        )
