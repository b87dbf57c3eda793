"""What MDAnalysis reads: files of minimd, with frames turned to fit the cell, and frames of a running simulation,
kept in memory."""

from typing import Any

import numpy as np
from MDAnalysis.coordinates.H5MD import H5MDReader
from MDAnalysis.coordinates.memory import MemoryReader
from MDAnalysis.lib.util import store_init_arguments
from numpy.typing import NDArray

from minimd.files.h5md_reader import admitted
from minimd.files.turned_cell import ROTATION, Turn, cell_dimensions, turn_of
from minimd.simulation.simulation import Simulation
from minimd.structure.system import System


class Frames:
    """An observer that keeps frames in memory, for universe().

        frames = Frames()
        sim.run(1000, every=10, observers=[frames])
        u = universe(frames)

    Positions and velocities are kept in float32, as MDAnalysis uses them, observables in float64: 24 bytes for each
    atom and frame. A step that is observed twice, at the end of a run and at the start of the next, is kept once.

    Attributes
    ----------
    system : System, a copy made with the first frame; None before.
    conserves_momentum : whether the simulation does.
    turn : Turn of a cell that MDAnalysis holds in another orientation, in which positions and velocities are kept; or
        None.
    """

    def __init__(self) -> None:
        self.system: System | None = None
        self.turn: Turn | None = None
        self.conserves_momentum = False
        self._rows: list[dict[str, Any]] = []
        self._moving: list[tuple[NDArray[np.float32], ...]] = []

    def __repr__(self) -> str:
        return f"Frames({len(self)} frames of {'no' if self.system is None else len(self.system)} atoms)"

    def __len__(self) -> int:
        return len(self._rows)

    def __call__(self, simulation: Simulation) -> None:
        """Keep the present state.  Raises ValueError for another number of atoms than before."""
        system = simulation.system
        if self.system is None:
            self.system, self.turn = system.copy(), turn_of(system.cell, system.units.to_angstrom)
            self.conserves_momentum = simulation.conserves_momentum
        if len(system) != len(self.system):
            these = f"of {len(self.system)} atoms; this one has {len(system)}"
            raise ValueError(f"Frames keeps frames of one simulation, {these}")
        frame, units = simulation.frame(), system.units
        if self._rows and self._rows[-1]["step"] == frame.step:
            return
        row = {"step": frame.step, "time": frame.time * units.to_picosecond, **frame.observables}
        positions = frame.positions * units.to_angstrom
        velocities = frame.velocities * (units.to_angstrom / units.to_picosecond)
        dimensions = cell_dimensions(system.cell, units.to_angstrom)
        if self.turn is not None:
            row[ROTATION], dimensions = self.turn.of(system.cell.vectors)
            positions, velocities = positions @ row[ROTATION], velocities @ row[ROTATION]
        self._rows.append(row)
        boxes = np.zeros(6) if dimensions is None else dimensions
        self._moving.append(tuple(np.asarray(one, dtype=np.float32) for one in (positions, velocities, boxes)))

    def series(self, name: str) -> NDArray[Any]:
        """(T, ...) an observable, "step", or "time" [ps, or τ], of all frames."""
        return np.array([row[name] for row in self._rows])

    def reader_arguments(self, dt: float) -> dict[str, Any]:
        """Arguments for RecordedReader.  dt : time between frames [ps, or τ]."""
        positions, velocities, dimensions = (np.stack(one) for one in zip(*self._moving, strict=True))
        arrays = {"coordinate_array": positions, "velocities": velocities, "dimensions": dimensions}
        return {**arrays, "dt": dt, "rows": self._rows}


class RecordedReader(MemoryReader):
    """MDAnalysis' reader of arrays, with the recorded times and observables.
    rows : for each frame the entries of ts.data, with its time."""

    def __init__(self, coordinate_array: NDArray, rows: list[dict[str, Any]] | None = None, **options: Any) -> None:
        self._recorded = rows
        super().__init__(coordinate_array, order="fac", **options)

    def _read_next_timestep(self, ts: Any = None) -> Any:
        ts = super()._read_next_timestep(ts)
        if self._recorded is not None:
            ts.data.update(self._recorded[ts.frame])
        return ts


class RunReader(H5MDReader):
    """Frames of a minimd file.  turn : of its cell, or None; a transformation could be set only once."""

    @store_init_arguments
    def __init__(self, filename: str, turn: Turn | None = None, **kwargs: Any) -> None:
        self._turn = turn
        super().__init__(filename, **kwargs)

    def open_trajectory(self) -> None:
        """Called by MDAnalysis, which opens the file itself; see admitted."""
        super().open_trajectory()
        admitted(self._file, self.filename)

    def _read_frame(self, frame: int) -> Any:
        ts = super()._read_frame(frame)
        return ts if self._turn is None else self._turn(ts)
