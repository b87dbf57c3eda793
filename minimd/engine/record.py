"""What a run observed, in memory."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.structure.units import UnitSystem

SERIES: dict[str, str] = {}  # name in record and file: attribute of UnitSystem that names its unit; see observation.register


class Frame(NamedTuple):
    """The observed state of one step. Arrays are those of the running simulation; copy them to keep their values.

    step, time [time].  positions, velocities, forces : (N, 3).  observables : name in SERIES to number or (3,) array;
    pressure is missing unless the cell has a volume.  reservoir_energy : given by a thermostat since the start [energy].
    """

    step: int
    time: float
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    forces: NDArray[np.float64]
    observables: dict[str, Any]
    reservoir_energy: float = 0.0


class Record:
    """Time series of a run, one entry for each observed step.

    Attributes
    ----------
    step : (T,) int.  time : (T,) [time].
    potential_energy, kinetic_energy, total_energy : (T,) [energy].  temperature : (T,).
    conserved_energy : (T,) [energy], total energy minus reservoir energy, only with a thermostat.
    shadow_energy : (T,) [energy], only where asked for: see minimd.shadow_energy.
    constraint_violation : (T,) largest |r² − d²|/d², only with lengths held fixed.
    pressure : (T,) [energy/length³], only where the cell has a volume.
    momentum, angular_momentum : (T, 3).  absolute_momentum : (T,) Σ |m v|.
    absolute_angular_momentum : (T,) Σ m |r − r_cm| |v|.
    units : the UnitSystem of all of them.  n_atoms : N.
    trajectory : the first .h5md file of the run, with the frames of these entries, or None.
    """

    view: ClassVar[Callable[["Record"], Any]]  # pages are a floor above; minimd/__init__ sets it

    def __init__(self, units: UnitSystem, n_atoms: int, trajectory: Path | None = None) -> None:
        self.units, self.n_atoms, self.trajectory = units, n_atoms, trajectory
        self._series: dict[str, list[Any]] = {"step": [], "time": []}

    @classmethod
    def of(cls, units: UnitSystem, n_atoms: int, series: dict[str, NDArray[Any]]) -> "Record":
        """A record of series that exist already, such as those of a file; step and time must be among them."""
        record = cls(units, n_atoms)
        record._series.update({name: list(values) for name, values in series.items()})
        return record

    def append(self, frame: Frame) -> None:
        """Append the observables of a frame."""
        self._series["step"].append(frame.step)
        self._series["time"].append(frame.time)
        for name, value in frame.observables.items():
            self._series.setdefault(name, []).append(value)

    def __contains__(self, name: str) -> bool:
        return name in self._series

    def __len__(self) -> int:
        return len(self._series["step"])

    def __getattr__(self, name: str) -> NDArray[Any]:
        series = self.__dict__.get("_series", {})
        if name in series:
            return np.array(series[name])
        if name == "pressure":
            raise AttributeError("pressure was not recorded: the cell has no volume, it must be periodic in all three directions")
        raise AttributeError(f"a record has no {name!r}; it has {', '.join(series)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._series]

    def __repr__(self) -> str:
        return f"Record({len(self)} entries of {', '.join(self._series)})"
