"""One float64 file for a run: trajectory, observables and restart, in the layout of H5MD; see h5md_schema.

Frames are collected in memory for a second, or longer if writing them would take more than 2 % of the time. Then the
frames, and the state from which the run can go on, are written in one commit of the journaled file: whenever the
process is killed, the file holds the frames up to a commit, and the restart of that commit.
"""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import monotonic

import h5py
import numpy as np

from minimd.core.console.quiet import warn
from minimd.core.console.words import listed
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import extras_in, recorded
from minimd.core.engine.observer import StoredObserver
from minimd.core.engine.record import Frame
from minimd.core.files import h5md_digest as digest, h5md_schema as layout
from minimd.core.files.claim import Claim, JournaledFile
from minimd.core.files.h5_items import Item, put
from minimd.core.files.h5md_reader import (
    H5MDContents,
    admitted,
    contents_of,
    damage_told,
    looked_at,
    opened,
)

SECONDS_BETWEEN_FLUSHES = 1.0
# shortest time between flushes, in durations of a flush: 2 % of the time; less if the block of frames is full
MOST_OFTEN = 50.0
# of a block of frames
BLOCK_BYTES = 32 * 1024**2
MOST_FRAMES = 4096
ANEW = "write to a new file; a scene with [structure] file begins one from the state of this file"
BESIDE = "beside."  # in the names of arrays that are kept with a restart


class H5MDWriter:
    """An H5MD file that takes frames: a new one, or one that goes on from its restart, see append_to.

    Its restart is the state of the engine at the last flush, checkpoint or close.

    claim : on the file.
    engine : whose frames are written.
    store_forces : also write forces.
    every : steps between two frames.
    n_frames : number of frames expected, None if it is not known.
    observers : of the run; their state is kept with each restart, and their results are written at the end of the run.
    bring_others : brings other trajectories to the disk before a restart; the marks that it returns are kept until
        the end of the run.

    Raises OSError if the file cannot be created or has no room.
    """

    def __init__(
        self,
        claim: Claim,
        engine: Engine,
        store_forces: bool,
        every: int = 1,
        observers: Sequence[StoredObserver] = (),
        n_frames: int | None = None,
        bring_others: Callable[[Claim], list[bytes]] = lambda claim: [],
    ) -> None:
        self.claim = claim
        self._engine = engine
        self._store_forces = store_forces
        self._observers = observers
        self._n_expected = n_frames
        self._bring_others = bring_others
        self._every: int | None = every  # None for a continued file that does not hold it
        # of other trajectories, in the restart from which a file is continued
        self.marks: list[bytes] = []
        self._columns: list[layout.Column] = []
        # what does not change; it is written with the first frame of a new file
        self.description: dict[str, Item] = {}
        # of frames that wait to be written, by path: it is reused, because new memory would take longer than copying
        self._room: dict[str, np.ndarray] = {}
        self._n_frames = 0  # in the file
        self._n_waiting = 0  # in memory
        self._last_step = -1  # step of the frame taken last
        self._next_flush = monotonic() + SECONDS_BETWEEN_FLUSHES  # [s]
        self._disk = JournaledFile(claim)
        self._h5 = admitted(h5py.File(self._disk, "w" if claim.is_new else "r+"), claim.name)
        try:
            if claim.is_new:
                self.description = layout.description(engine) | digest.of_observers(observers)
            else:
                self._continue()
        except BaseException:
            self._give_up()
            raise

    @classmethod
    def append_to(
        cls,
        file: str | Path,
        engine: Engine,
        store_forces: bool = False,
        every: int = 1,
        observers: Sequence[StoredObserver] = (),
    ) -> "H5MDWriter":
        """A writer that continues a file from its restart; frames after the restart are removed.

        Forces are written if the file has them. A frame at the step of the restart is not written twice. Observers that
        have not looked yet take over the state of those in the file with the same names.

        Warns if the steps to come are those of another method, barostat or precision.

        Raises ValueError if the file holds another system, other constraints or other observables, if
        only one of them has a barostat, if the file has no forces and store_forces asks for them, or if the simulation
        is not at the step of the restart.
        OSError if the file cannot be written, or is damaged.
        """
        opened(file).close()
        try:
            claim = Claim(file, is_new=False)
        except OSError as error:
            raise OSError(f"file {str(file)!r} cannot be changed: {error.strerror}") from None

        try:
            looked_at(claim.path, partial(rehearse, claim))
            return cls(claim, engine, store_forces, every, observers)
        except BaseException:
            claim.release()
            raise

    def _continue(self) -> None:
        """Continue the file from its restart.
        Raises as append_to."""
        h5 = self._h5
        file = self.claim.name
        contents = contents_of(h5, file)
        obstacle = _obstacle(contents, self._engine, self._store_forces)
        if obstacle:
            raise ValueError(f"trajectory {file!r} {obstacle}")
        methods = layout.other_method(contents, self._engine)
        if methods:
            warn(
                f"the run in {file!r} is continued with another method, barostat or precision: {methods}; "
                "frames before and after belong to different runs"
            )

        restart = digest.read_restart(h5)
        digest.restore_observers(h5, file, restart, self._observers)
        self._store_forces = contents.has_forces
        if f"observables/{layout.SPACING}" not in h5:
            self._every = None

        with self._telling("be continued"):
            steps = contents.record.step
            self._n_frames = int(np.searchsorted(steps, contents.step, side="right"))
            self._last_step = int(steps[self._n_frames - 1])
            self.marks = [
                array.tobytes() for name, array in restart.arrays.items() if name.startswith(BESIDE)
            ]
            digest.set_aside_damaged(h5)
            digest.drop_frames(h5, self._n_frames)
            put(h5, digest.of_observers(self._observers))
            attributes = h5["minimd"].attrs
            notes = self._engine.notes
            if notes["scene"]:  # the scene with which the run goes on
                title = notes["title"] or contents.title
                attributes.update({"scene": notes["scene"], "title": title})
            state = restart.checkpoint.state
            is_same = np.array_equal(self._engine.positions, state.positions)
            if not (is_same and np.array_equal(self._engine.velocities, state.velocities)):
                # the frame of this step is another state
                attributes["since"] = self._engine.step + 1
            self._describe_method()

    def write(self, frame: Frame) -> None:
        """Take one frame, of the present step of the engine; a second frame of the same step is ignored.

        Raises OSError if the file has no room or cannot be written; what it held before stays valid.
        ValueError if it is closed.
        """
        if not self._h5:
            raise ValueError(
                f"trajectory {self.claim.name!r} is closed; it cannot take the frame of step {frame.step}"
            )

        if frame.step == self._last_step:
            return
        if not self._room:
            spacing = None if self._every is None else self._every * self._engine.method.duration
            self._columns = layout.columns(
                self._engine.system, list(frame.observables), self._store_forces, spacing
            )
            entries = {column.path: np.asarray(column.entry(frame)) for column in self._columns}
            n_bytes = sum(entry.nbytes for entry in entries.values())
            n_rows = int(np.clip(BLOCK_BYTES // n_bytes, 1, MOST_FRAMES))
            self._room = {
                path: np.empty((n_rows, *entry.shape), entry.dtype)
                for path, entry in entries.items()
            }

        for column in self._columns:
            self._room[column.path][self._n_waiting] = column.entry(frame)
        self._n_waiting += 1
        self._last_step = frame.step
        if self._n_waiting == len(self._room[layout.STEPS]) or monotonic() >= self._next_flush:
            self.checkpoint()

    def checkpoint(self) -> None:
        """Write all frames, and the present state of the engine as the restart, to the disk.
        Raises as write."""
        started = monotonic()
        if self._h5 and self._n_frames + self._n_waiting:
            with self._taking():
                self._h5.flush()
        now = monotonic()
        self._next_flush = now + max(SECONDS_BETWEEN_FLUSHES, MOST_OFTEN * (now - started))

    @contextmanager
    def _taking(self) -> Iterator[None]:
        """Give the frames that wait, and the restart, to HDF5; at the end of this context, commit them."""
        first = self._n_frames
        n_frames = self._n_frames + self._n_waiting
        entries = {}
        if self._n_waiting:
            entries = {path: room[: self._n_waiting] for path, room in self._room.items()}
        step = entries[layout.STEPS][0] if entries else self._engine.step
        is_restart = self._engine.is_whole or first == 0
        marks = self._bring_others(self.claim) if is_restart else []

        with self._telling(f"take the frame of step {step}"), uninterrupted():
            if entries:  # repeated after an error, this gives the same file
                items = layout.series(self._columns, entries, first, self._n_expected)
                if first == 0:
                    items = self.description | items
                put(self._h5, items)
                digest.add_block(self._h5, n_frames, entries)
                if first == 0:
                    digest.sign(self._h5, items)

            if layout.goes_on_otherwise(self._engine, self._h5["minimd"].attrs):
                self._describe_method()
            if is_restart:
                checkpoint = self._engine.checkpoint()
                beside = {
                    f"{BESIDE}{k}": np.frombuffer(mark, np.uint8) for k, mark in enumerate(marks)
                }
                digest.write_restart(self._h5, checkpoint, n_frames, self._observers, beside)

            yield
            self._disk.commit()
            self._n_frames = n_frames
            self._n_waiting = 0

    def close(self) -> None:
        """Write the remaining frames, the restart of the present state and results of observers; close the file.
        Nothing if it is closed or failed.
        Raises OSError if they cannot be written."""
        if not self._h5:
            return
        # whole files have no marks: nothing is to be cut off
        others = self._bring_others
        self._bring_others = lambda claim: []
        try:
            others(self.claim)
        finally:
            try:
                if self._observers:
                    self.checkpoint()  # an answer that fails costs no frame
                if self._h5 and self._n_frames + self._n_waiting:
                    with self._taking():  # a short run without observers has this commit alone
                        if self._observers:
                            digest.write_answers(self._h5, self._observers)
                            digest.sign(self._h5)
                        self._h5.close()
            finally:
                if self.claim.descriptor >= 0:
                    self._give_up()

    def _describe_method(self) -> None:
        """Describe the method again: it, or one of its parameters, may have been replaced."""
        put(self._h5, {"minimd": Item(layout.of_method(self._engine, self._h5["minimd"].attrs))})
        digest.sign(self._h5)

    @contextmanager
    def _telling(self, what: str) -> Iterator[None]:
        """Turn an error into one sentence and close the file, which then is as it was at the last commit."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            self._give_up()
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            raise OSError(
                f"trajectory {self.claim.name!r} could not {what}: {reason}; "
                f"the {self._n_frames} earlier frames are valid"
            ) from error

    def _give_up(self) -> None:
        self._h5.close()
        self.claim.release()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Context that Ctrl-C does not interrupt; it takes effect at the end."""
    is_main = threading.current_thread() is threading.main_thread()
    if not (is_main and hasattr(signal, "pthread_sigmask")):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def rehearse(claim: Claim) -> None:
    """Do in memory what a run will do with a claimed minimd file that it continues: add the last frame once more,
    and two restarts. Nothing is committed.

    To be called in a child process, as looked_at does: damage that is not noticed in reading, such as a wrong count of
    links, can crash HDF5 when it writes.
    Raises as read_file if the file cannot be continued.
    """
    with admitted(h5py.File(JournaledFile(claim), "r+"), claim.name) as h5:
        contents_of(h5, claim.name)

    with damage_told(claim.name), h5py.File(JournaledFile(claim), "r+") as h5:
        digest.set_aside_damaged(h5)
        restart, n_frames, _, _ = digest.read_restart(h5)
        digest.drop_frames(h5, n_frames)
        last = {name: h5[name][-1:] for name in h5[digest.BLOCKS].attrs["series"]}
        for name, entry in last.items():
            h5[name].resize(n_frames + 1, axis=0)
            h5[name][n_frames:] = entry
        digest.add_block(h5, n_frames + 1, last)
        for _ in range(2):
            digest.write_restart(h5, restart, n_frames + 1)
            h5.flush()
        digest.sign(h5)


def _obstacle(contents: H5MDContents, engine: Engine, store_forces: bool) -> str:
    """Why the simulation cannot continue a file, and what to do; empty if it can."""
    ours = engine.system
    theirs = contents.system
    fixed = ("masses", "charges", "species", *ours.groups())
    same = {
        "units": ours.units.name == theirs.units.name,
        "the number of atoms": len(ours) == len(theirs),
        **{name: np.array_equal(getattr(ours, name), getattr(theirs, name)) for name in fixed},
        "the cell": ours.cell.same_as(theirs.cell),
        "the massless sites": ours.sites == theirs.sites,
    }
    different = [name for name, is_same in same.items() if not is_same]
    if different:
        return f"holds another system: {different[0]} of file and simulation differ; write to a new file"
    constraints = layout.other_constraints(theirs.constraints, engine.constraints, theirs.positions)
    if constraints:
        obstacle = f"holds a run with other constraints: {constraints}"
        return f"{obstacle}; use the constraints of the file, or write to a new file"
    if engine.step != contents.step:
        return (
            f"continues from step {contents.step}, but the simulation is at step {engine.step}; "
            "take the state of the file with minimd.Simulation.resume, or write to a new file"
        )
    if (engine.barostat is None) != (contents.barostat is None):
        has_one = "without" if contents.barostat is None else "with"
        return f"was written {has_one} a barostat, the simulation has {engine.barostat!r}; {ANEW}"
    return _obstacle_of_observables(contents, engine, store_forces)


def _obstacle_of_observables(contents: H5MDContents, engine: Engine, store_forces: bool) -> str:
    """As _obstacle, of what frames hold."""
    names = contents.record.names
    if engine.has_bath != ("conserved_energy" in names):
        thermostat = "without" if engine.method.is_thermostat else "with"
        return f"was written {thermostat} a thermostat; it cannot be continued with {engine.method.name}; {ANEW}"
    extras = extras_in(contents.record)
    if set(extras) != set(engine.extra_observables):
        return (
            f"was begun with simulation.extra_observables = {extras}; "
            "set the same extra_observables, or write to a new file"
        )
    records = recorded(engine)
    unknown = [name for name in records if name not in names]
    if unknown:
        return (
            f"was begun without {listed(unknown)}, which this run records: a file has the same observables in all "
            "frames; append before you register other observables, or write to a new file"
        )
    missing = [name for name in names if name not in ("step", "time", *records)]
    if missing:
        return (
            f"holds {listed(missing)}, which this run does not record; "
            "register these observables, or write to a new file"
        )
    if store_forces and not contents.has_forces:
        return "was begun without forces; continue it without store_forces, or write to a new file"
    return ""
