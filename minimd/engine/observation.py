"""Observables of an engine: the table of all of them, and their values for one state."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from minimd.engine.engine import Engine
from minimd.engine.record import SERIES, Frame
from minimd.structure import observables
from minimd.structure.units import UnitSystem


class Look:
    """Quantities that several observables share, each computed once. Forces, energy and virial of the engine must be current."""

    def __init__(self, engine: Engine) -> None:
        self.engine, self.system = engine, engine.system
        self.volume: Any = engine.system.volume
        self.bonds: Any = engine.constraint_set.bonds
        self.motion = (engine.velocities, engine.system.masses)
        self.path = (engine.positions, *self.motion)
        self.potential_energy = engine.interactions.potential_energy
        self.kinetic_energy = observables.kinetic_energy(*self.motion)
        self.total_energy = self.potential_energy + self.kinetic_energy

    @cached_property
    def virial(self) -> Any:
        """(3, 3) [energy], of forces and constraint forces."""
        engine, virial = self.engine, self.engine.interactions.virial
        return virial if self.bonds is None else virial + self.bonds.virial(engine.positions, engine.velocities, engine.forces)


@dataclass(frozen=True)
class Observable:
    """A number, or an array of numbers, that frames, records and files hold under a name.

    name : in record and file.  unit : the attribute of UnitSystem that names its unit, empty for a pure number.
    measure : its value, from a Look.  exists : whether it is defined for an engine.
    """

    name: str
    unit: str
    measure: Callable[[Look], Any]
    exists: Callable[[Engine], bool] = lambda _engine: True


OBSERVABLES: dict[str, Observable] = {}


def register(observable: Observable) -> None:
    """Add an observable to record and files of all later runs in which it exists.

    Raises ValueError if its name is in use, or its unit is neither empty nor named by a UnitSystem.
    """
    if observable.name in OBSERVABLES:
        raise ValueError(f"an observable must have a name of its own; {observable.name!r} is known already")
    if observable.unit and observable.unit not in UnitSystem.__dataclass_fields__:
        raise ValueError(f"the unit of {observable.name} must be empty or an attribute of UnitSystem, such as 'energy'; unit = {observable.unit!r}")
    OBSERVABLES[observable.name] = observable
    SERIES[observable.name] = observable.unit


for _observable in (
    Observable("potential_energy", "energy", lambda look: look.potential_energy),
    Observable("kinetic_energy", "energy", lambda look: look.kinetic_energy),
    Observable("total_energy", "energy", lambda look: look.total_energy),
    Observable("temperature", "temperature", lambda look: observables.temperature(*look.motion, look.system.units.k_B, look.engine.n_dof)),
    Observable("momentum", "momentum", lambda look: observables.momentum(*look.motion)),
    Observable("angular_momentum", "angular_momentum", lambda look: observables.angular_momentum(*look.path)),
    Observable("absolute_momentum", "momentum", lambda look: observables.absolute_momentum(*look.motion)),
    Observable("absolute_angular_momentum", "angular_momentum", lambda look: observables.absolute_angular_momentum(*look.path)),
    Observable(
        "pressure",
        "pressure",
        lambda look: observables.pressure(look.kinetic_energy, look.virial, look.volume),
        lambda engine: engine.system.volume is not None,
    ),
    Observable("conserved_energy", "energy", lambda look: look.total_energy - look.engine.reservoir_energy, lambda one: one.method.is_thermostat),
    Observable("constraint_violation", "", lambda look: float(look.bonds.violation(look.path[0]).max()), lambda one: bool(one.constraint_set.bonds)),
):
    register(_observable)


def observe(engine: Engine) -> Frame:
    """The present state with its observables; forces, energy and virial are evaluated if they are not current."""
    engine.evaluate()
    look = Look(engine)
    values = {one.name: one.measure(look) for one in OBSERVABLES.values() if one.exists(engine)}
    return Frame(engine.step, engine.time, engine.positions, engine.velocities, engine.forces, values, engine.reservoir_energy)
