"""Reading a minimd file: record, restart and description; see h5md_schema for the layout."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Displayed, Rows
from minimd.console.words import printable
from minimd.engine.engine import Checkpoint
from minimd.engine.record import SERIES, Record
from minimd.files.first_look import looked_at
from minimd.files.h5md_digest import damaged_frames, damaged_restart, is_signed, n_whole_frames, read_restart
from minimd.files.h5md_observers import lack_results, observers_of
from minimd.files.h5md_opening import damage_told, opened
from minimd.files.h5md_schema import SPACING, STEPS, TRAJECTORY, read_constraints
from minimd.integrators.methods import METHODS
from minimd.integrators.splitting.barostats import StochasticCellRescaling
from minimd.integrators.splitting.splitting import Splitting
from minimd.observers import Accumulator
from minimd.structure.bond_graph import GROUPS
from minimd.structure.cell import Cell
from minimd.structure.system import System
from minimd.structure.units import SYSTEMS


@dataclass(frozen=True, repr=False)
class H5MDContents(Displayed):
    """The contents of a minimd file, apart from its frames.

    record : Record, one entry for each frame.
    system : System at the restart, to the last bit, with the constraints of the run.
    restart : Checkpoint.  step, time : int, [time], of the restart.  timestep : [time].
    method : its name in integrators.METHODS.  parameters : arguments with which it can be made again.
    barostat : StochasticCellRescaling, or None.  precision, skin : of the options.  potentials : in words.
    too_long_a_step : the warning of a Report that the time step is too long, or empty.
    reservoir_energy : [energy], given by a thermostat up to the restart; 0 without one.
    conserves_momentum : whether the run did.
    n_frames : int.  has_forces : whether frames hold forces.  title, scene : texts, empty if none were stored.
    observers : of minimd.observers, by name, in their state at the restart, see observers_of.  lacks_results : whether
        they have looked since their results were written.
    repaired : a sentence if the newest restart is damaged and the one before it is used; else empty.
    """

    record: Record
    system: System
    restart: Checkpoint
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
    parameters: dict[str, Any]
    precision: Any
    skin: float | None
    potentials: list[str]
    repaired: str
    observers: dict[str, Accumulator]
    lacks_results: bool
    barostat: StochasticCellRescaling | None = None
    too_long_a_step: str = ""

    def __repr__(self) -> str:
        return f"H5MDContents({self.n_frames} frames of {len(self.system)} atoms, {self.method}, step {self.step})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        shown = self.system.units.shown
        rows = [("title", self.title)] if self.title else []
        rows += [("system", repr(self.system)), ("method", f"{self.method}, timestep {shown(self.timestep)}")]
        rows += [("potential", one) for one in self.potentials]
        rows += [("frames", f"{self.n_frames}, {'with' if self.has_forces else 'without'} forces")]
        rows += [("restart", f"step {self.step}, {shown(self.time)}")]
        rows += [("scene", "stored" if self.scene else "none stored")]
        return rows + ([("repaired", self.repaired)] if self.repaired else [])

    def integrator(self) -> Splitting:
        """The method with its time step.  Raises ValueError if it is not a method of minimd."""
        if self.method not in METHODS:
            made_with = f"the run was made with the method {self.method!r}, which minimd does not have"
            raise ValueError(f"{made_with}; pass the method of that run")
        made: Any = METHODS[self.method](**self.parameters)
        return made


def read_file(path: str | Path) -> H5MDContents:
    """Read record, restart and description of a minimd file.

    Checksums of description and restart are verified, those of frames in verify_frames.

    Raises FileNotFoundError, OSError as opened, and OSError if it is damaged.  ValueError if it is not HDF5,
    or not written by minimd.
    """
    with opened(path) as h5:
        return contents_of(h5, path)


def contents_of(h5: h5py.File, path: str | Path) -> H5MDContents:
    """Record, restart and description of an open minimd file.  path : for messages.  Raises as read_file."""
    check_description(h5, path)
    with damage_told(path):
        n_frames, group = n_whole_frames(h5), h5["minimd"]
        (restart, _, _, is_earlier), repaired = read_restart(h5), ""
        observers = observers_of(h5)
        system, at = _system(group, restart), group.attrs
        if is_earlier:
            step = restart.state.step
            repaired = f"the newest restart in {path} is damaged; the one before it is used, of step {step}"
        return H5MDContents(
            record=_record(h5, system, n_frames),
            system=system,
            restart=restart,
            step=restart.state.step,
            time=restart.state.time,
            timestep=float(at["timestep"]),
            method=printable(str(at["method"])),
            reservoir_energy=restart.state.reservoir_energy,
            conserves_momentum=bool(at["conserves_momentum"]),
            n_frames=n_frames,
            has_forces=f"{TRAJECTORY}/force" in h5,
            title=printable(str(at["title"])),
            scene=str(at["scene"]),
            parameters=json.loads(at["parameters"]),
            precision=str(at["precision"]),
            skin=None if np.isnan(at["skin"]) else float(at["skin"]),
            potentials=[printable(one) for one in at["potentials"]],
            repaired=repaired,
            observers=observers,
            lacks_results=lack_results(h5, observers),
            barostat=StochasticCellRescaling(**json.loads(words)) if (words := at.get("barostat", "")) else None,
            too_long_a_step=printable(str(at.get("too_long_a_step", ""))),
        )


def frame_arrays(path: str | Path, frame: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and velocities of a frame, (N, 3) float64.  Raises as opened."""
    with opened(path) as h5, damage_told(path):
        positions, velocities = (h5[f"{TRAJECTORY}/{name}/value"][frame] for name in ("position", "velocity"))
        return positions, velocities


def velocities_of(path: str | Path, n_frames: int) -> Iterator[NDArray[np.float64]]:
    """The velocities of each frame in turn, (N, 3) float64.  Raises as opened."""
    with opened(path) as h5, damage_told(path):
        for frame in range(n_frames):
            yield h5[f"{TRAJECTORY}/velocity/value"][frame]


def damage(path: str | Path) -> str:
    """The frames, or else the restart, of a minimd file that are not as they were written, in words;
    empty if there are none.

    The whole file is read in a child process, which damaged bytes may crash.  Raises as read_file.
    """
    frames, restart = looked_at(path, partial(_damage, path))
    return frames or restart


def verify_frames(path: str | Path) -> None:
    """Raise OSError unless all frames of a minimd file are as they were written.  Raises as read_file, too."""
    if which := looked_at(path, partial(_damage, path))[0]:
        words = f"{which} are not those that were written"
        raise OSError(f"file {str(path)!r} is damaged: {words}; copy it again, or run again")


def _damage(path: str | Path) -> tuple[str, str]:
    """The damaged frames and the damaged restart, in words; see damage."""
    with opened(path) as h5:
        check_description(h5, path)
        with damage_told(path):
            n_frames, found = read_restart(h5).n_frames, n_whole_frames(h5)
            return damaged_frames(h5) or (f"frames from {found} on" if found < n_frames else ""), damaged_restart(h5)


def check_description(h5: h5py.File, path: str | Path) -> None:
    """Raise as read_file unless the description of the file is as it was written."""
    with damage_told(path):
        if not is_signed(h5):
            raise ValueError("its description is not the one that was written")


def _system(group: h5py.Group, restart: Checkpoint) -> System:
    names = group["species_names"]
    labels = names.asstr()[:] if h5py.check_string_dtype(names.dtype) else names[:]
    return System(
        restart.state.positions,
        masses=group["masses"][:],
        velocities=restart.state.velocities,
        cell=restart.state.cell or Cell(group["cell"][:], group.attrs["pbc"].astype(bool)),
        species=np.array(labels.tolist())[group["species_index"][:]],
        **{name: group[name][:] for name in GROUPS if name in group},
        units=SYSTEMS[group.attrs["units"]],
        constraints=read_constraints(group),
    )


def _record(h5: h5py.File, system: System, n_frames: int) -> Record:
    known = [name for name in SERIES if name in h5["observables"]]
    names = known + [name for name in h5["observables"] if name not in SERIES and name != SPACING]
    series: dict[str, NDArray[Any]] = {"step": h5[STEPS][:n_frames], "time": h5["minimd/time"][:n_frames]}
    series.update({name: h5[f"observables/{name}/value"][:n_frames] for name in names})
    return Record.of(system.units, len(system), series)
