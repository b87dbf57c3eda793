"""One float64 file for a run: trajectory, observables and restart, in the layout of H5MD; see h5md_schema.

Frames are collected in memory for a second, or longer if writing them would take more than 2 % of the time. Then the
frames, and the state from which the run can go on, are written in one commit of the journaled file: whenever the
process is killed, the file holds the frames up to a commit, and the restart of that commit.
"""

import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import h5py
import numpy as np

from minimd.console.quiet import outside_minimd
from minimd.console.words import listed
from minimd.engine.engine import Engine
from minimd.engine.observation import extras_in, recorded
from minimd.engine.record import Frame
from minimd.files import h5md_schema as layout
from minimd.files.claim import Claim
from minimd.files.first_look import looked_at
from minimd.files.h5md_digest import (
    BLOCKS,
    add_block,
    drop_frames,
    read_restart,
    set_aside_damaged,
    sign,
    write_restart,
)
from minimd.files.h5md_observers import describe_observers, restore_observers, states_of, write_answers
from minimd.files.h5md_opening import admitted, damage_told, opened
from minimd.files.h5md_reader import H5MDContents, check_description, contents_of
from minimd.files.journaled_file import JournaledFile
from minimd.observers.accumulator import Accumulator

SECONDS_BETWEEN_FLUSHES = 1.0
# shortest time between flushes, in durations of a flush: 2 % of the time; less if the block of frames is full
MOST_OFTEN = 50.0
BLOCK_BYTES, MOST_FRAMES = 32 * 1024**2, 4096  # of a block of frames
BESIDE = "beside."  # in the names of arrays that are kept with a restart


class FrameBlock:
    """Entries of the series of a file for frames that wait to be written, in memory that is reused:
    allocating new memory would take longer than copying the frames.

    columns : of the file.  frame : an example of the frames to come.  n_frames : number of frames in the block.
    """

    def __init__(self, columns: list[layout.Column], frame: Frame) -> None:
        entries = {column.path: np.asarray(column.entry(frame)) for column in columns}
        capacity = int(np.clip(BLOCK_BYTES // sum(entry.nbytes for entry in entries.values()), 1, MOST_FRAMES))
        self.n_frames, self.columns, self._capacity = 0, columns, capacity
        self._entries = {path: np.empty((capacity, *entry.shape), entry.dtype) for path, entry in entries.items()}

    def take(self, frame: Frame) -> bool:
        """Copy the entries of a frame; returns whether there is no room for another one."""
        for column in self.columns:
            self._entries[column.path][self.n_frames] = column.entry(frame)
        self.n_frames += 1
        return self.n_frames == self._capacity

    def entries(self) -> dict[str, np.ndarray]:
        """(n_frames, ...) for each series, by its path."""
        return {path: entries[: self.n_frames] for path, entries in self._entries.items()}


class H5MDWriter:
    """A new H5MD file that takes frames.

    Its restart is the state of the engine at the last flush, checkpoint or close.

    claim : on the file.  engine : whose frames are written.  store_forces : also write forces.
    every : steps between two frames.  n_frames : number of frames expected, None if it is not known.
    observers : of the run; their state is kept with each restart, and their results are written at the end of the run.
    bring_others : brings other trajectories to the disk before a restart;
        the marks that it returns are kept until the end of the run.

    Raises OSError if the file cannot be created or has no room.
    """

    _n_expected: int | None = None
    marks: list[bytes]  # of other trajectories, in the restart from which a file is continued
    _pending: FrameBlock | None
    _every: int | None  # None for a continued file that does not hold it

    def _begin(self, claim: Claim, engine: Engine, store_forces: bool, mode: Any) -> None:
        self.claim, self._engine, self._method, self._store_forces = claim, engine, engine.method, store_forces
        self._disk = JournaledFile(claim)
        self._h5 = admitted(h5py.File(self._disk, mode), claim.name)
        self._pending, self._n_frames = None, 0  # frames that are not yet in the file, and the number of those that are
        self._last_step, self._next_flush = -1, -np.inf  # step of the frame taken last; time of the next flush [s]

    def __init__(
        self,
        claim: Claim,
        engine: Engine,
        store_forces: bool,
        every: int = 1,
        observers: Sequence[Accumulator] = (),
        n_frames: int | None = None,
        bring_others: Callable[[Claim], list[bytes]] = lambda claim: [],
    ) -> None:
        self._begin(claim, engine, store_forces, "w")
        self._every, self._observers, self._n_expected = every, observers, n_frames
        self._bring_others = bring_others
        with self._telling("begin"):
            layout.describe(self._h5, engine)
            describe_observers(self._h5, observers)

    @classmethod
    def append_to(
        cls,
        file: str | Path,
        engine: Engine,
        store_forces: bool = False,
        every: int = 1,
        observers: Sequence[Accumulator] = (),
    ) -> "H5MDWriter":
        """A writer that continues a file from its restart; frames after the restart are removed.

        Forces are written if the file has them. A frame at the step of the restart is not written twice. Observers that
        have not looked yet take over the state of those in the file with the same names.

        Warns if the steps to come are those of another method, bath or precision.

        Raises ValueError if the file holds another system, other constraints, another barostat or other observables, if
        it has no forces and store_forces asks for them, or if the simulation is not at the step of the restart.
        OSError if the file cannot be written, or is damaged.
        """
        claim, writer = _claimed(file), cls.__new__(cls)
        try:
            looked_at(claim.path, partial(rehearse, claim))
            writer._begin(claim, engine, store_forces, "r+")
        except BaseException:
            claim.release()
            raise
        try:
            writer._continue(file, every, observers)
        except BaseException:
            writer._give_up()
            raise
        return writer

    def _continue(self, file: str | Path, every: int, observers: Sequence[Accumulator]) -> None:
        """Continue the file from its restart.  Raises as append_to."""
        contents = contents_of(self._h5, file)
        if words := _obstacle(contents, self._engine, self._store_forces):
            raise ValueError(f"trajectory {str(file)!r} {words}")
        if other := layout.other_method(contents.method, contents.parameters, contents.precision, self._engine):
            goes_on = f"the run in {str(file)!r} goes on with other steps: {other}"
            warnings.warn(f"{goes_on}; frames before and after belong to different runs", stacklevel=outside_minimd())
        restore_observers(self._h5, file, observers)
        self._observers, self._store_forces = observers, contents.has_forces
        self._every = every if f"observables/{layout.SPACING}" in self._h5 else None
        with self._telling("be continued"):
            self._n_frames = int(np.searchsorted(contents.record.step, contents.step, side="right"))
            self._last_step = int(contents.record.step[self._n_frames - 1])
            kept = read_restart(self._h5).arrays.items()
            self.marks = [array.tobytes() for name, array in kept if name.startswith(BESIDE)]
            self._bring_others = lambda claim: []
            set_aside_damaged(self._h5)
            drop_frames(self._h5, self._n_frames)
            describe_observers(self._h5, observers)
            if scene := self._engine.notes["scene"]:  # the scene with which the run goes on
                title = self._engine.notes["title"] or contents.title
                self._h5["minimd"].attrs.update({"scene": scene, "title": title})
            self._describe_method()

    def write(self, frame: Frame) -> None:
        """Take one frame, of the present step of the engine; a second frame of the same step is ignored.

        Raises OSError if the file has no room or cannot be written; what it held before stays valid.
        ValueError if it is closed.
        """
        if not self._h5:
            raise ValueError(f"trajectory {self.claim.name!r} is closed; it cannot take the frame of step {frame.step}")
        if frame.step == self._last_step:
            return
        if self._pending is None:
            spacing = None if self._every is None else self._every * self._engine.method.timestep
            columns = layout.columns(self._engine.system, list(frame.observables), self._store_forces, spacing)
            self._pending = FrameBlock(columns, frame)
        is_full, self._last_step = self._pending.take(frame), frame.step
        if is_full or monotonic() >= self._next_flush:
            self.checkpoint()

    def checkpoint(self) -> None:
        """Write all frames, and the present state of the engine as the restart, to the disk.
        Raises OSError as write."""
        pending = self._pending.entries() if self._pending else {}
        n_frames = self._n_frames + len(pending.get(layout.STEPS, ()))
        if not self._h5 or n_frames == 0:
            return
        started, step = monotonic(), pending[layout.STEPS][0] if n_frames > self._n_frames else self._engine.step
        is_restart = self._engine.is_whole or self._n_frames == 0
        marks = enumerate(self._bring_others(self.claim) if is_restart else [])
        with self._telling(f"take the frame of step {step}"), uninterrupted():
            if self._pending and n_frames > self._n_frames:
                self._add(self._pending.columns, pending, n_frames)
            if self._method is not self._engine.method:
                self._describe_method()
            if is_restart:
                beside = {f"{BESIDE}{k}": np.frombuffer(mark, np.uint8) for k, mark in marks}
                write_restart(self._h5, self._engine.checkpoint(), n_frames, states_of(self._observers) | beside)
            self._commit()
            self._n_frames = n_frames
            if self._pending:
                self._pending.n_frames = 0
        now = monotonic()
        self._next_flush = now + max(SECONDS_BETWEEN_FLUSHES, MOST_OFTEN * (now - started))

    def close(self) -> None:
        """Write the remaining frames, the restart of the present state and results of observers; close the file.

        Nothing if it is closed or failed.

        Raises OSError if they cannot be written.
        """
        # whole files have no marks: nothing is to be cut off
        others, self._bring_others = self._bring_others, lambda claim: []
        try:
            if self._h5:
                others(self.claim)
        finally:
            try:
                self.checkpoint()
                if self._h5 and self._n_frames and self._observers:
                    with self._telling("take the answers of the observers"), uninterrupted():
                        write_answers(self._h5, self._observers)
                        sign(self._h5)
                        self._commit()
            finally:
                self._shut()

    def _add(self, columns: list[layout.Column], pending: dict[str, np.ndarray], n_frames: int) -> None:
        """Add the pending frames to the series, and their digest; repeated after an error, this gives the same file."""
        for column in columns:
            series = layout.series_of(self._h5, column, pending[column.path][0], self._n_expected)
            series.resize(n_frames, axis=0)
            series[self._n_frames :] = pending[column.path]
        add_block(self._h5, n_frames, pending)
        if self._n_frames == 0:
            sign(self._h5)  # now that the series exist

    def _describe_method(self) -> None:
        """Describe the method again: it may have been replaced."""
        layout.describe_method(self._h5["minimd"], self._engine)
        sign(self._h5)
        self._method = self._engine.method

    def _commit(self) -> None:
        self._h5.flush()
        self._disk.commit()

    @contextmanager
    def _telling(self, what: str) -> Iterator[None]:
        """Turn an error into one sentence and close the file, which then is as it was at the last commit."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            self._pending = None
            self._give_up()
            failed = f"trajectory {self.claim.name!r} could not {what}"
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            raise OSError(f"{failed}: {reason}; the {self._n_frames} frames before it are valid") from error

    def _give_up(self) -> None:
        self._h5.close()
        self._disk.close()

    def _shut(self) -> None:
        """Close the file, for which HDF5 writes its tables, and commit them."""
        if not self._h5:
            return
        with self._telling("be closed"), uninterrupted():
            try:
                self._h5.close()
                if self._n_frames:
                    self._disk.commit()
            finally:
                self._disk.close()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Context that Ctrl-C does not interrupt; it takes effect at the end."""
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def edit(path: str | Path, change: Any) -> None:
    """Change a minimd file in one commit.  change : function that is called with the h5py.File.

    Raises as read_file, and OSError if a run is writing the file.
    """
    claim = _claimed(path)
    try:
        disk = JournaledFile(claim)
        with admitted(h5py.File(disk, "r+"), path) as h5:
            check_description(h5, path)
            change(h5)
            sign(h5)
        disk.commit()
    finally:
        claim.release()


def _claimed(path: str | Path) -> Claim:
    """The claim on an HDF5 file that exists.  Raises as opened, and OSError if another run writes it."""
    opened(path).close()
    try:
        return Claim(path, is_new=False)
    except OSError as error:
        raise OSError(f"file {str(path)!r} cannot be changed: {error.strerror}") from None


def rehearse(claim: Claim) -> None:
    """Do in memory what a run will do with a claimed minimd file that it continues: add the last frame once more,
    and two restarts. Nothing is committed.

    To be called in a child process, as looked_at does: damage that is not noticed in reading, such as a wrong count of
    links, can crash HDF5 when it writes.  Raises as read_file if the file cannot be continued.
    """
    with admitted(h5py.File(JournaledFile(claim), "r+"), claim.name) as h5:
        contents_of(h5, claim.name)
    with damage_told(claim.name), h5py.File(JournaledFile(claim), "r+") as h5:
        set_aside_damaged(h5)
        restart, n_frames, _, _ = read_restart(h5)
        drop_frames(h5, n_frames)
        last = {name: h5[name][-1:] for name in h5[BLOCKS].attrs["series"]}
        for name, entry in last.items():
            h5[name].resize(n_frames + 1, axis=0)
            h5[name][n_frames:] = entry
        add_block(h5, n_frames + 1, last)
        for _ in range(2):
            write_restart(h5, restart, n_frames + 1)
            h5.flush()
        sign(h5)


def _obstacle(contents: H5MDContents, engine: Engine, store_forces: bool) -> str:
    """Why the simulation cannot continue a file, and what to do; empty if it can."""
    ours, theirs = engine.system, contents.system
    same = {
        "units": ours.units.name == theirs.units.name,
        "the number of atoms": len(ours) == len(theirs),
        "masses": np.array_equal(ours.masses, theirs.masses),
        "species": np.array_equal(ours.species, theirs.species),
        **{name: np.array_equal(members, theirs.groups()[name]) for name, members in ours.groups().items()},
        "the cell": ours.cell.same_as(theirs.cell),
    }
    if differ := [name for name, is_same in same.items() if not is_same]:
        return f"holds another system: {differ[0]} of file and simulation differ; write to a new file"
    if held := layout.other_constraints(theirs.constraints, engine.constraints, theirs.positions):
        return f"holds a run with other constraints: {held}; use the constraints of the file, or write to a new file"
    if engine.step != contents.step:
        steps = f"continues from step {contents.step}, but the simulation is at step {engine.step}"
        return f"{steps}; take the state of the file with minimd.Simulation.resume, or write to a new file"
    if engine.barostat != contents.barostat:
        before, now = ("no barostat" if bath is None else repr(bath) for bath in (contents.barostat, engine.barostat))
        return f"holds a run with {before}; the simulation has {now}: write to a new file"
    if engine.has_bath != ("conserved_energy" in contents.record):
        bath = f"was written {'without' if engine.method.is_thermostat else 'with'} a thermostat"
        return f"{bath}; it cannot be continued with {engine.method.name}: write to a new file"
    if set(wanted := extras_in(contents.record)) != set(engine.extra_observables):
        return f"was begun with simulation.extra_observables = {wanted}; set the same, or write to a new file"
    records = recorded(engine)  # each observable in a file has an entry for every frame
    if new := [name for name in records if name not in contents.record.names]:
        why = f"was begun without {listed(new)}, which this run records: a file has the same observables in all frames"
        return f"{why}; append before you register others, or write to a new file"
    if missing := [name for name in contents.record.names if name not in ("step", "time", *records)]:
        why = f"holds {listed(missing)}, which this run does not record"
        return f"{why}; register what is missing, or write to a new file"
    if store_forces and not contents.has_forces:
        return "was begun without forces; continue it without store_forces, or write to a new file"
    return ""
