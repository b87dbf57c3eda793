"""What a minimd file holds: record, restart and description, read back; see h5md_schema for the layout."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from minimd.engine.engine import Snapshot
from minimd.engine.record import SERIES, Record
from minimd.files.h5md_constraints import read_constraints
from minimd.files.h5md_schema import STEPS, TRAJECTORY, all_series, opened, read_state
from minimd.structure.cell import Cell
from minimd.structure.system import System
from minimd.structure.units import SYSTEMS


@dataclass(frozen=True)
class H5MDContents:
    """What a minimd file holds apart from its frames.

    record : Record, one entry for each frame.  system : System at the restart, to the last bit, with the constraints of the run.
    step, time : int, [time], of the restart.  timestep : [time].  method : its name in integrators.METHODS.
    reservoir_energy : [energy], given by a thermostat up to the restart; 0 without one.  conserves_momentum : whether the run did.
    n_frames : int.  has_forces : whether frames hold forces.  title, scene : texts, empty if none were stored.
    """

    record: Record
    system: System
    step: int
    time: float
    timestep: float
    method: str
    reservoir_energy: float
    conserves_momentum: bool
    n_frames: int
    has_forces: bool
    title: str
    scene: str


def read_file(path: str | Path) -> H5MDContents:
    """Record, restart and description of a minimd file.

    Frames that are not in every series, which only a machine that went down while writing can leave, do not count.

    Raises FileNotFoundError, OSError as opened.  ValueError if it is not HDF5, not written by minimd, or holds no frame.
    """
    with opened(path, "r") as h5:
        if "minimd/restart" not in h5:
            raise ValueError(f"file {str(path)!r} was not written by minimd; it has no group 'minimd'")
        n_frames, group = min((len(series) for series in all_series(h5)), default=0), h5["minimd"]
        if n_frames == 0:
            raise ValueError(f"file {str(path)!r} holds no frame; the run ended before its first")
        restart = read_state(group["restart"])
        system = _system(group, restart)
        return H5MDContents(
            record=_record(h5, system, n_frames),
            system=system,
            step=restart.step,
            time=restart.time,
            timestep=float(group.attrs["timestep"]),
            method=str(group.attrs["method"]),
            reservoir_energy=restart.reservoir_energy,
            conserves_momentum=bool(group.attrs["conserves_momentum"]),
            n_frames=n_frames,
            has_forces=f"{TRAJECTORY}/force" in h5,
            title=str(group.attrs["title"]),
            scene=str(group.attrs["scene"]),
        )


def _system(group: h5py.Group, restart: Snapshot) -> System:
    names = group["species_names"]
    labels = names.asstr()[:] if h5py.check_string_dtype(names.dtype) else names[:]
    return System(
        restart.positions,
        masses=group["masses"][:],
        velocities=restart.velocities,
        cell=Cell(group["cell"][:], group.attrs["pbc"].astype(bool)),
        species=np.array(labels.tolist())[group["species_index"][:]],
        bonds=group["bonds"][:],
        units=SYSTEMS[group.attrs["units"]],
        constraints=read_constraints(group),
    )


def _record(h5: h5py.File, system: System, n_frames: int) -> Record:
    known = [name for name in SERIES if name in h5["observables"]]
    names = known + [name for name in h5["observables"] if name not in SERIES]
    series: dict[str, NDArray[Any]] = {"step": h5[STEPS][:n_frames], "time": h5["minimd/time"][:n_frames]}
    series.update({name: h5[f"observables/{name}/value"][:n_frames] for name in names})
    return Record.of(system.units, len(system), series)
