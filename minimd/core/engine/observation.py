"""Observables of an engine: the table of them all, and their values for one state."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from minimd.core.console.words import listed, shown
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import SERIES, Frame, Record
from minimd.core.structure import observables
from minimd.core.structure.units import UnitSystem


class Look:
    """Quantities of one state that several observables share, each computed once, when it is first needed.

    Forces, energy and virial of the engine must be current for those that follow from them.
    """

    def __init__(self, engine: Engine) -> None:
        system = engine.system
        self.engine = engine
        self.system = system
        self.bonds: Any = engine.constraint_set.bonds
        self.motion = (system.velocities, system.masses)
        self.path = (system.positions, *self.motion)
        self.grid = engine.interactions.grid
        self.potential_energy = engine.sums.potential_energy

    @cached_property
    def kinetic_energy(self) -> float:
        """K [energy]."""
        rounding = (self.grid.energy,) if self.grid else ()
        return float(observables.kinetic_energy(*self.motion, *rounding))

    @property
    def total_energy(self) -> float:
        """U + K [energy]."""
        return self.potential_energy + self.kinetic_energy

    @property
    def momentum(self) -> Any:
        """(3,)."""
        rounding = (self.grid.momentum,) if self.grid else ()
        return observables.momentum(*self.motion, *rounding)

    @cached_property
    def drift(self) -> Any:
        """See Engine."""
        return self.engine.drift

    @cached_property
    def thermal_energy(self) -> float:
        """K of the motion relative to the drift [energy]."""
        return observables.thermal_energy(self.kinetic_energy, self.drift, self.system.masses)

    @property
    def temperature(self) -> float:
        """T, of the thermal energy."""
        return observables.temperature(
            self.thermal_energy, self.engine.n_dof, self.system.units.k_B
        )

    @property
    def volume(self) -> float:
        """[length³].
        Raises ValueError if the cell has none."""
        check_has_volume(self.engine)
        return float(self.system.volume or 0.0)

    @cached_property
    def virial(self) -> Any:
        """(3, 3) [energy], of forces and constraint forces."""
        engine = self.engine
        virial = engine.sums.virial
        if self.bonds is None:
            return virial
        return virial + self.bonds.virial(*self.path[:2], engine.forces)

    @property
    def stress(self) -> Any:
        """(3, 3) [energy/length³].
        Raises ValueError if the cell has no volume."""
        return observables.stress(
            self.motion[0] - self.drift, self.motion[1], self.virial, self.volume
        )

    @property
    def heat_flux(self) -> Any:
        """(3,) the flux of energy, times the volume [energy length/time], see Forces.heat_flux; velocities are
        relative to the drift, and no bit of the steps to come changes.
        Raises ValueError for potentials without one."""
        velocities = self.motion[0] - self.drift
        energies = 0.5 * self.motion[1] * (velocities**2).sum(axis=1)
        with self._aside() as interactions:
            return energies @ velocities + interactions.heat_flux(velocities)

    @property
    def lines(self) -> Any:
        """See Forces.lines, and those of the constraint forces; no bit of the steps to come changes."""
        with self._aside() as interactions:
            lines = [*interactions.lines()]
        if self.bonds is not None:
            lines.append(self.bonds.lines(*self.path[:2], self.engine.forces))
        return lines

    @contextmanager
    def _aside(self) -> Iterator[Any]:
        """Context of an evaluation of which no trace remains; yields Forces."""
        interactions = self.engine.interactions
        forces = interactions.forces.copy()
        impulses = interactions.impulses.copy()
        lists = interactions.lists_built()
        counts = interactions.counts
        yield interactions
        if interactions.n_builds != counts[1]:
            interactions.build_lists(lists)
        interactions.counts = counts
        interactions.forces[:] = forces
        interactions.impulses[:] = impulses


@dataclass(frozen=True)
class Observable:
    """A number, or an array of numbers, that frames, records and files hold under a name.

    name : in record and file.
    unit : the attribute of UnitSystem that names its unit, empty for a pure number.
    measure : its value, from a Look.
    exists : whether it is defined for an engine; None for every engine.
    demand : for one recorded only if extra_observables names it: raises ValueError for an engine that cannot have it.
    """

    name: str
    unit: str
    measure: Callable[[Look], Any]
    exists: Callable[[Engine], bool] | None = None
    demand: Callable[[Engine], None] | None = None


OBSERVABLES: dict[str, Observable] = {}


def register(observable: Observable) -> None:
    """Add an observable to the record and files of all later runs in which it exists.

    Raises ValueError if its name is in use, or its unit is neither empty nor named by a UnitSystem.
    """
    if observable.name in OBSERVABLES:
        raise ValueError(
            f"an observable must have a name of its own; {observable.name!r} is already in use"
        )
    if observable.unit and observable.unit not in UnitSystem.__dataclass_fields__:
        raise ValueError(
            f"the unit of {observable.name} must be empty or an attribute of UnitSystem, such as 'energy'; "
            f"unit = {observable.unit!r}"
        )
    OBSERVABLES[observable.name] = observable
    SERIES[observable.name] = observable.unit


def check_has_volume(engine: Engine) -> None:
    """Raise ValueError if the cell has no volume."""
    if engine.system.volume is None:
        raise ValueError(
            "pressure and stress need a volume: a cell that is periodic in all three directions, a plane in two; "
            f"its pbc = {engine.system.cell.pbc.tolist()}"
        )


for _observable in (
    Observable("potential_energy", "energy", lambda look: look.potential_energy),
    Observable("kinetic_energy", "energy", lambda look: look.kinetic_energy),
    Observable("total_energy", "energy", lambda look: look.total_energy),
    Observable("temperature", "temperature", lambda look: look.temperature),
    Observable("momentum", "momentum", lambda look: look.momentum),
    Observable(
        "angular_momentum",
        "angular_momentum",
        lambda look: observables.angular_momentum(*look.path),
    ),
    Observable(
        "absolute_momentum", "momentum", lambda look: observables.absolute_momentum(*look.motion)
    ),
    Observable(
        "absolute_angular_momentum",
        "angular_momentum",
        lambda look: observables.absolute_angular_momentum(*look.path),
    ),
    Observable(
        "pressure",
        "pressure",
        lambda look: observables.pressure(
            look.thermal_energy, look.virial, look.volume, look.system.cell.dimensions
        ),
        lambda engine: engine.system.volume is not None,
    ),
    Observable("stress", "pressure", lambda look: look.stress, demand=check_has_volume),
    Observable(
        "conserved_energy",
        "energy",
        lambda look: look.total_energy - look.engine.reservoir_energy - look.engine.work,
        lambda engine: engine.has_bath,
    ),
    Observable(
        "work",
        "energy",
        lambda look: look.engine.work,
        lambda engine: engine.interactions.depend_on_time,
    ),
    Observable(
        "volume", "volume", lambda look: look.volume, lambda engine: engine.barostat is not None
    ),
    Observable(
        "cell",
        "length",
        lambda look: look.system.cell.vectors,
        lambda engine: engine.barostat is not None,
    ),
    Observable(
        "constraint_violation",
        "",
        lambda look: float(look.bonds.violation(look.path[0]).max()),
        lambda engine: bool(engine.constraint_set.bonds),
    ),
):
    register(_observable)


def recorded(engine: Engine) -> list[str]:
    """Names of the observables that frames of this engine have."""
    names = []
    for name, observable in OBSERVABLES.items():
        if observable.demand is not None:
            is_recorded = name in engine.extra_observables
        else:
            is_recorded = observable.exists is None or observable.exists(engine)
        if is_recorded:
            names.append(name)
    return names


def observe(engine: Engine) -> Frame:
    """The present state with its observables; forces, energy and virial are evaluated if they are not current."""
    engine.evaluate()
    look = Look(engine)
    values = {name: OBSERVABLES[name].measure(look) for name in recorded(engine)}
    system = look.system
    state = engine.step, engine.time, system.positions, system.velocities, engine.sums.forces
    return Frame(*state, values, engine.reservoir_energy, system.cell)


def measure(engine: Engine, name: str) -> Any:
    """One observable of the present state, as in observe.
    Raises ValueError for a stress without volume."""
    engine.evaluate()
    return OBSERVABLES[name].measure(Look(engine))


def check_extras(engine: Engine) -> None:
    """Raise ValueError unless extra_observables of the engine names only what can be recorded besides the usual."""
    names = engine.extra_observables
    known = [name for name, observable in OBSERVABLES.items() if observable.demand is not None]
    if isinstance(names, str) or not set(names) <= set(known):
        raise ValueError(
            f"extra_observables must be a tuple with any of {listed(known)}, or empty; it is {shown(names)}"
        )
    for name in names:
        demand = OBSERVABLES[name].demand
        if demand is not None:
            demand(engine)


def extras_in(record: Record) -> Sequence[str]:
    """The extra_observables of the run that made a record."""
    return tuple(
        name
        for name, observable in OBSERVABLES.items()
        if observable.demand is not None and name in record
    )
