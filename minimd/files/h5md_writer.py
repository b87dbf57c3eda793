"""One float64 file for a run: trajectory, observables and restart, laid out as H5MD; see h5md_schema.

A frame is whole or absent. Frames are collected in memory for up to a second; then the room for them is reserved on the disk,
and only then does HDF5 append them. (Where HDF5 itself runs out of room it leaves a file that cannot be opened, or crashes.)
"""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic

import h5py
import numpy as np

from minimd.engine.engine import Engine
from minimd.engine.record import Frame
from minimd.files import h5md_schema as layout
from minimd.files.h5md_constraints import difference, n_bytes
from minimd.files.h5md_reader import H5MDContents, read_file
from minimd.files.h5md_schema import opened, write_state

SECONDS_BETWEEN_FLUSHES = 1.0
BUFFER_BYTES = 8 * 1024**2  # of frames kept in memory between two flushes
METADATA_BYTES = 256 * 1024  # room for HDF5's own tables, far above what a flush was seen to need
BYTES_PER_ATOM, BYTES_PER_BOND = 96, 32  # of what is written once: masses, species, restart; bonds
FULL = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)


class H5MDWriter:
    """A new H5MD file that takes frames.

    After each flush, at least once a second while frames come, and after close the file is valid, whatever ended the run.
    Its restart is the last frame; or the end of the run, where that lies beyond the last frame and close is told that it was reached.

    file : replaced if it exists.  engine : whose frames will come.  store_forces : also write forces.

    Raises OSError if the file cannot be created or has no room.
    """

    _last_step: int
    _flushed: float

    def __init__(self, file: Path, engine: Engine, store_forces: bool) -> None:
        self._begin(Path(file), engine, opened(file, "w"), store_forces)
        system = engine.system
        with self._telling("begin"):
            self._reserve(BYTES_PER_ATOM * len(system) + BYTES_PER_BOND * len(system.bonds) + n_bytes(engine.constraints))
            layout.describe(self._h5, engine)
            self._h5.flush()

    @classmethod
    def append_to(cls, file: Path, engine: Engine, store_forces: bool = False) -> "H5MDWriter":
        """A writer that continues a file from its restart; frames behind the restart are dropped.

        Forces are written if the file has them. The frame at the restart, which a resumed run observes again, is not doubled.

        Raises ValueError if the file holds another system or other constraints, no forces although store_forces, or if the simulation does not
        stand at the step of the restart.  OSError if the file cannot be written.
        """
        contents = read_file(file)
        _check_continues(file, contents, engine, store_forces)
        writer = cls.__new__(cls)
        writer._begin(Path(file), engine, opened(file, "r+"), contents.has_forces)
        with writer._telling("be continued"):
            writer._n_frames = int(np.searchsorted(contents.record.step, contents.step, side="right"))
            writer._take_back()
            writer._last_step = int(writer._h5[layout.STEPS][-1])
            layout.describe_method(writer._h5["minimd"], engine)
        return writer

    def write(self, frame: Frame) -> None:
        """Take one frame; a second one of the same step is passed over.

        Raises OSError if the file has no room or cannot be written; what it held before stays valid.  ValueError if it is closed.
        """
        if not self._h5:
            raise ValueError(f"trajectory {str(self._file)!r} is closed; it takes no frame of step {frame.step}")
        if frame.step == self._last_step:
            return
        copies = {name: getattr(frame, name).copy() for name in ("positions", "velocities", "forces")}
        self._pending.append(frame._replace(**copies))
        self._last_step = frame.step
        is_full = 3 * frame.positions.nbytes * len(self._pending) > BUFFER_BYTES
        if is_full or monotonic() - self._flushed >= SECONDS_BETWEEN_FLUSHES:
            self._flush()

    def close(self, completed: bool) -> None:
        """Write what is left and close the file; do nothing if it is closed or has failed.

        completed : whether the run came to its end; the restart is then that end, else the last frame.

        Raises OSError if what is left cannot be written.
        """
        if not self._h5:
            return
        try:
            self._flush()
            engine = self._engine
            if completed and engine.step > self._last_step:
                with self._telling(f"take the end of the run, step {engine.step}"):
                    self._write_restart(engine)
        finally:
            self._shut()

    def _begin(self, file: Path, engine: Engine, h5: h5py.File, store_forces: bool) -> None:
        self._file, self._engine, self._h5, self._store_forces = file, engine, h5, store_forces
        self._pending: list[Frame] = []
        self._n_frames: int = 0  # in the file
        self._last_step, self._flushed = -1, -np.inf  # that was taken; when [s]

    def _flush(self) -> None:
        """Append the pending frames, all of them or none."""
        frames = self._pending
        if not frames:
            return
        with self._telling(f"take the frame of step {frames[0].step}"):
            table = layout.columns(self._engine.system, list(frames[0].observables), self._store_forces)
            entries = [np.asarray(column.entry(frames[0])) for column in table]
            self._reserve(sum(one.nbytes * (len(frames) + layout.chunk_rows(one)) for one in entries))  # one chunk of each series may be new
            for column in table:
                series = layout.series_of(self._h5, column, frames[0])
                series.resize(self._n_frames + len(frames), axis=0)
                series[self._n_frames :] = np.array([column.entry(frame) for frame in frames])
            self._write_restart(frames[-1])
        self._n_frames += len(frames)
        self._pending, self._flushed = [], monotonic()

    def _write_restart(self, state: Engine | Frame) -> None:
        write_state(self._h5["minimd/restart"], state)
        self._h5.flush()

    def _reserve(self, n_bytes: int) -> None:
        """Make sure that the disk has room for so many bytes more [B].  Raises OSError if it has not. A filesystem that cannot reserve is trusted."""
        if not hasattr(os, "posix_fallocate"):
            return
        try:
            os.posix_fallocate(self._h5.id.get_vfd_handle(), self._h5.id.get_filesize(), n_bytes + METADATA_BYTES)
        except OSError as error:
            if error.errno in FULL:
                raise

    @contextmanager
    def _telling(self, what: str) -> Iterator[None]:
        """Turn a failure into a sentence and give the file up; after Ctrl-C take half a block back, close will write it."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            self._pending = []
            for give_up in (self._take_back, self._shut):
                with suppress(OSError, RuntimeError):
                    give_up()
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            raise OSError(f"trajectory {str(self._file)!r} could not {what}: {reason}; its {self._n_frames} frames before that are valid") from error
        except BaseException:
            self._take_back()
            raise

    def _take_back(self) -> None:
        """Drop what lies behind the last whole frame."""
        for series in layout.all_series(self._h5):
            if len(series) > self._n_frames:
                series.resize(self._n_frames, axis=0)
        self._h5.flush()

    def _shut(self) -> None:
        """Close the file and return the room that was reserved and not needed."""
        if not self._h5:
            return
        size = self._h5.id.get_filesize()
        self._h5.close()
        if self._file.stat().st_size > size:
            os.truncate(self._file, size)


def annotate(path: str | Path, *, title: str | None = None, scene: str | None = None) -> None:
    """Store a title, or the text of the scene file that a run came from, in a minimd file; also from an observer of that run.

    Raises FileNotFoundError, OSError, ValueError if there is no such file.
    """
    with opened(path, "r+") as h5:
        if "minimd" not in h5:
            raise ValueError(f"file {str(path)!r} was not written by minimd; it has no group 'minimd'")
        h5["minimd"].attrs.update({name: text for name, text in (("title", title), ("scene", scene)) if text is not None})


def _check_continues(file: Path, contents: H5MDContents, engine: Engine, store_forces: bool) -> None:
    """Raise ValueError unless the simulation can continue the file."""
    ours, theirs = engine.system, contents.system
    same = {
        "units": ours.units.name == theirs.units.name,
        "the number of atoms": len(ours) == len(theirs),
        "masses": np.array_equal(ours.masses, theirs.masses),
        "species": np.array_equal(ours.species, theirs.species),
        "bonds": np.array_equal(ours.bonds, theirs.bonds),
        "the cell": ours.cell.same_as(theirs.cell),
    }
    for name, is_same in same.items():
        if not is_same:
            raise ValueError(f"trajectory {str(file)!r} holds another system: {name} of file and simulation differ; write to a new file")
    if held := difference(theirs.constraints, engine.constraints, theirs.positions):
        raise ValueError(f"trajectory {str(file)!r} holds a run with other constraints: {held}; go on with those of the file, or write to a new file")
    if engine.step != contents.step:
        raise ValueError(f"trajectory {str(file)!r} continues from step {contents.step}; the simulation stands at step {engine.step}")
    if engine.method.is_thermostat != ("conserved_energy" in contents.record):
        raise ValueError(
            f"trajectory {str(file)!r} was written {'without' if engine.method.is_thermostat else 'with'} a thermostat, "
            f"{engine.method.name} would continue it otherwise; write to a new file"
        )
    if ("shadow_energy" in contents.record) != ("shadow_energy" in engine.extra_observables):
        wanted = "('shadow_energy',)" if "shadow_energy" in contents.record else "()"
        raise ValueError(f"trajectory {str(file)!r} was begun with simulation.extra_observables = {wanted}; set them so, or write to a new file")
    if store_forces and not contents.has_forces:
        raise ValueError(f"trajectory {str(file)!r} was begun without forces; resume without storing them, or write to a new file")
