"""What a run observed, in memory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.whole_file import write_whole
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_flag, checked_path
from minimd.core.structure.statistics import mean_and_error, with_error
from minimd.core.structure.units import UnitSystem

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

# name: attribute of UnitSystem that names its unit; see observation.register
SERIES: dict[str, str] = {}


class Frame(NamedTuple):
    """The observed state at one step. Arrays are those of the running simulation; copy them to keep their values.

    step, time [time].
    positions, velocities, forces : (N, 3).
    observables : name in SERIES to number or (3,) array; pressure only if the cell has a volume.
    reservoir_energy : given by thermostat and barostat so far [energy].
    """

    step: int
    time: float
    positions: Array
    velocities: Array
    forces: Array
    observables: dict[str, Any]
    reservoir_energy: float = 0.0
    cell: Cell | None = None


class Record(Displayed):
    """Time series of a run, one entry for each observed step.

    Attributes
    ----------
    step : (T,) int.
    time : (T,) [time].
    potential_energy, kinetic_energy, total_energy : (T,) [energy].
    temperature : (T,).
    conserved_energy : (T,) [energy], total energy minus reservoir energy and work, only with a bath.
    work : (T,) [energy], ∫ ∂U/∂t dt since the start, only with forces that depend on time.
    volume, cell : (T,) [length³], (T, 3, 3) lattice vectors as rows [length], only with a barostat.
    shadow_energy : (T,) [energy], only if asked for: see minimd.shadow_energy.
    constraint_violation : (T,) largest |r² − d²|/d², only with lengths held fixed.
    pressure : (T,) [energy/length³], only if the cell has a volume.
    stress : (T, 3, 3) [energy/length³], positive under tension, only if asked for: see Simulation.extra_observables.
    momentum, angular_momentum : (T, 3).
    absolute_momentum : (T,) Σ |m v|.
    absolute_angular_momentum : (T,) Σ m |r − r_cm| |v|.
    units : the UnitSystem of all of them.
    n_atoms : N.
    trajectory : the first .h5md file of the run, with the frames of these entries, or None.
    conserves_momentum : whether the run does, from the first entry to the last.
    """

    def __init__(
        self,
        units: UnitSystem,
        n_atoms: int,
        trajectory: Path | None = None,
        conserves_momentum: bool = True,
    ) -> None:
        self.units = units
        self.n_atoms = n_atoms
        self.trajectory = trajectory
        self.conserves_momentum = conserves_momentum
        self._series: dict[str, list[Any]] = {"step": [], "time": []}

    @classmethod
    def of(
        cls,
        units: UnitSystem,
        n_atoms: int,
        series: dict[str, NDArray[Any]],
        conserves_momentum: bool = True,
    ) -> Record:
        """A record of series that exist already, such as those of a file; step and time must be among them."""
        record = cls(units, n_atoms, None, conserves_momentum)
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
            raise AttributeError(
                "pressure was not recorded: the cell has no volume; "
                "it must be periodic in all three directions, pbc = (True, True, True), a plane in two"
            )
        raise AttributeError(f"a record has no {name!r}; it has {', '.join(series)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._series]

    @property
    def names(self) -> list[str]:
        """Names of its series, step and time first."""
        return list(self._series)

    def unit(self, name: str) -> str:
        """The unit of a series, in words; empty for a pure number, or one that minimd does not know."""
        if name == "time":
            return self.units.time
        return str(getattr(self.units, SERIES.get(name) or "", ""))

    def columns(self) -> dict[str, NDArray[Any]]:
        """All series as columns of numbers, (T,) each: vectors as momentum_x, …, tensors as stress_xx, stress_xy, …"""
        columns = {}
        for name in self._series:
            series = getattr(self, name)
            shape = series.shape[1:]
            is_tensor = set(shape) == {3}
            for place in np.ndindex(*shape):
                if is_tensor:
                    label = name + "_" + "".join("xyz"[k] for k in place)
                else:
                    label = "_".join([name, *map(str, place)])
                columns[label] = series[:, *place]
        return columns

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame of columns(), with the steps as its index, and their units in its attrs["units"].

        Raises ModuleNotFoundError if pandas is not installed; minimd itself does not need it.
        """
        try:
            from pandas import DataFrame
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "to_pandas needs pandas, which is not installed: install pandas, "
                "or use record.columns(), a dict of arrays, or record.to_csv(path)"
            ) from error
        table = DataFrame(self.columns()).set_index("step")
        table.attrs["units"] = {name: unit for name in self._series if (unit := self.unit(name))}
        return table

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write columns() as text with commas, names in the first line, numbers with all their digits; return the path.

        A file or link that is replaced stays until the new one is whole. Raises FileExistsError if the file exists and
        overwrite is false; OSError if it cannot be written, or a device would be replaced.
        """
        columns = self.columns()
        path = checked_path("path", path)
        lines = [",".join(columns)]
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            lines.append(",".join(map(repr, row)))
        text = "\n".join([*lines, ""])
        write_whole(path, text, overwrite=checked_flag("overwrite", overwrite))
        return path

    def plot(self) -> Figure:
        """A figure of the run: change of the total energy per atom, temperature, change of the momentum if it is
        conserved, volume if it changes, and pressure or potential energy per atom.

        In a notebook it appears in the cell; .savefig(path) writes a file. Raises ValueError if there are no entries.
        """
        # matplotlib takes its time to load
        from minimd.core.engine.record_picture import picture_of

        return picture_of(self)

    def display_rows(self) -> Rows:
        """See Displayed."""
        if not len(self):
            return [("record", "no entries")]
        step = self.step
        first = self.units.shown(self.time[0])
        last = self.units.shown(self.time[-1])
        entries = f"{len(self)} entries of {self.n_atoms} atoms, step {step[0]} to {step[-1]}, {first} to {last}"
        rows = [("record", entries)]
        for name in self._series:
            if name not in ("step", "time"):
                summary = f"{_summary(getattr(self, name))} {self.unit(name)}"
                rows.append((name.replace("_", " "), summary.rstrip()))
        return rows

    def __repr__(self) -> str:
        return f"Record({len(self)} entries of {', '.join(self._series)})"


def _summary(series: NDArray[Any]) -> str:
    """A series in words, without its unit."""
    if series.ndim > 1:
        return f"change at most {np.abs(series - series[0]).max():.2g}"
    deviation = series.std()
    mean = with_error(*mean_and_error(series)) if deviation > 0.0 else f"{series.mean():.8g}"
    ends = f"first {series[0]:.8g}, last {series[-1]:.8g}"
    return f"{ends}, mean {mean}, standard deviation {deviation:.2g}"
