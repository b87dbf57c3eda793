"""The work of a worker: it runs one member and returns a row of plain values with its results or its failure.

The progress of a member is in a note beside its file, for `minimd scan --status`. A thread writes the note every two
seconds; members that take less time have none. The process holds a lock on the note as long as it lives: a note
without a lock was left behind by a process that was killed.
"""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from minimd.compiled.machine import threads_by_default
from minimd.console.words import shown
from minimd.engine.record import Record
from minimd.ensemble.member import Member, set_aside, stopped_file
from minimd.files.claim import is_locked, new_file, regular
from minimd.files.crash_file import crash_file_place
from minimd.simulation.simulation import Simulation
from minimd.structure.errors import ConstraintError, NonFiniteError, sentence
from minimd.structure.statistics import mean_and_error

SECONDS_BETWEEN_NOTES = 2.0
SUFFIX = ".running"
LENGTH = 60  # characters of a note, so that each writing replaces the whole note


class Note:
    """The note of a member.  simulation : of the member.  first : the step at which its run begins.
    Both are None before the run begins."""

    def __init__(self, member: Member) -> None:
        self._place, self._steps, self._descriptor = note_of(member.file), member.steps, -1
        self.simulation: Simulation | None = None
        self.first: int | None = None

    def write(self) -> None:
        """Write the note to its file.  Raises OSError."""
        if self._descriptor < 0:
            self._descriptor = new_file(self._place)
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        os.write(self._descriptor, f"{self}\n".rjust(LENGTH).encode())

    def remove(self) -> None:
        """Remove the file of the note, also if a process that was killed has left it.  Raises OSError."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._place.unlink(missing_ok=True)

    def __str__(self) -> str:
        if self.simulation is None or self.first is None:
            return "being prepared"
        return f"at step {self.simulation.step - self.first} of {self._steps}"


@contextmanager
def noting(member: Member) -> Iterator[Note]:
    """The note of a member, which a thread writes as long as this context lasts."""
    note, ended = Note(member), threading.Event()

    def keep() -> None:
        while not ended.wait(SECONDS_BETWEEN_NOTES):
            with suppress(OSError):  # a run does not fail because its note cannot be written
                note.write()

    thread = threading.Thread(target=keep, daemon=True)
    thread.start()
    try:
        yield note
    finally:
        ended.set()
        thread.join()
        with suppress(OSError):
            note.remove()


def note_of(file: Path) -> Path:
    """The note of the member with this file."""
    return file.with_suffix(SUFFIX)


def read_note(file: Path) -> str:
    """What the member with this file is doing now; empty if no process runs it,
    or if it began less than two seconds ago."""
    place = note_of(file)
    try:
        with open(place, encoding="utf-8", opener=regular) as note:
            return note.read().strip() if is_locked(place) else ""
    except (OSError, UnicodeDecodeError):
        return ""


DONE, FAILED, BEGUN, MISSING = "done", "failed", "begun", "missing"  # the status of a member
Row = dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """What is done for every member; see ensemble.  call : unique name of this call;
    without it dask would return results of an earlier call."""

    build: Callable[[Member], Simulation]
    prepare: Callable[[Simulation, Member], Any] | None
    run: Callable[[Simulation, Member], Any] | None
    every: int
    call: str


def work(plan: Plan, member: Member, begins_anew: bool) -> Row:
    """Run a member and return its row, which also describes an error.

    Its simulation has one thread, unless build says otherwise.

    begins_anew : do not go on from its file, because a run that has blown up would go another way from there.
    Raises KeyboardInterrupt, SystemExit if it is stopped.
    """
    started, row = perf_counter(), {"index": member.index, "parameters": dict(member.parameters)}
    try:
        with threads_by_default(1), noting(member) as note:
            row |= _made(plan, member, begins_anew, note)
    except Exception as error:  # of build, prepare or run, which are the user's
        file = getattr(error, "file", None)
        told = {
            "status": FAILED,
            "message": f"{type(error).__name__}: {sentence(error)}",
            "traceback": traceback.format_exc(),
        }
        row |= told | {
            "crash_file": "" if file is None else str(file),
            "is_blown_up": isinstance(error, NonFiniteError | ConstraintError),
        }
    return row | {"seconds": perf_counter() - started}


def _made(plan: Plan, member: Member, begins_anew: bool, note: Note) -> Row:
    from minimd.files.h5md_reader import read_file

    simulation = plan.build(member)
    if not isinstance(simulation, Simulation):
        raise TypeError(f"build must return a Simulation; for {member} it returned {shown(simulation)}")
    begins_anew |= _crash_file(member).exists()
    resumed = None if begins_anew or plan.run is not None else _resumed(member.file, simulation)
    if resumed is not None:
        simulation, first = resumed
        note.simulation, note.first, end = simulation, first, first + member.steps
        if simulation.step < end:
            simulation.run(until_step=end, every=plan.every, trajectory=member.file, append=True, progress=False)
        return _described(simulation, read_file(member.file).record, member.steps)
    if plan.run is not None and not begins_anew:
        set_aside(member.file)
    else:
        stopped_file(member.file).unlink(missing_ok=True)
    for file in (member.file, _crash_file(member)):
        file.unlink(missing_ok=True)
    member.file.parent.mkdir(parents=True, exist_ok=True)
    if plan.prepare is not None:
        plan.prepare(simulation, member)
    note.simulation, note.first = simulation, (first := simulation.step)
    if plan.run is not None:
        returned = plan.run(simulation, member)
        stopped_file(member.file).unlink(missing_ok=True)
        return _described(simulation, returned, simulation.step - first)
    record = simulation.run(member.steps, every=plan.every, trajectory=member.file, progress=False)
    return _described(simulation, record, member.steps)


def _crash_file(member: Member) -> Path:
    """The file that the run of a member leaves if it blows up."""
    return crash_file_place(True, member.file) or member.file


def _resumed(file: Path, built: Simulation) -> tuple[Simulation, int] | None:
    """The simulation in the file of a stopped member, and the first step of its run; None if there is no file,
    or a damaged one."""
    from minimd.files.h5md_reader import read_file

    if not file.exists():
        return None
    try:
        resumed = Simulation.resume(file, built.potentials, threads=built.options.threads)
        return resumed, int(read_file(file).record.step[0])
    except (OSError, ValueError):  # the member begins anew, and has the same bits
        return None


def _described(simulation: Simulation, result: Any, n_steps: int) -> Row:
    averages = averages_of(result)
    return {
        "status": DONE,
        "n_steps": n_steps,
        "n_atoms": len(simulation.system),
        "units": simulation.system.units.name,
        "means": {name: mean for name, (mean, _) in averages.items()},
        "errors": {name: error for name, (_, error) in averages.items()},
    }


def averages_of(result: Any) -> dict[str, tuple[float, float]]:
    """Means and errors, by name, of what the function run returned; none for None.

    result : a Record, or a dict of numbers, of tuples (mean, error) or of series.  Raises TypeError,
        ValueError for anything else.
    """
    if result is None:
        return {}
    if isinstance(result, Record):
        return {
            name: mean_and_error(column) for name, column in result.columns().items() if name not in ("step", "time")
        }
    if not isinstance(result, Mapping):
        raise TypeError(
            "run must return a Record, a dict of numbers, of tuples (mean, error) or of series, or None; it returned "
            f"{shown(result)}"
        )
    averages = {}
    for name, value in result.items():
        if not isinstance(name, str) or not name:
            raise TypeError(
                f"the names in the dict that run returns must be texts that are not empty; one is {shown(name)}"
            )
        array = np.asarray(value)
        if array.dtype.kind not in "biuf" or array.ndim > 1:
            raise TypeError(
                f"the values in the dict that run returns must be numbers, tuples (mean, error), or series; {name} = "
                f"{shown(value)}"
            )
        if array.ndim == 0:
            averages[name] = float(array), np.nan
        elif isinstance(value, tuple) and len(value) == 2:
            averages[name] = float(array[0]), float(array[1])
        else:
            averages[name] = mean_and_error(array)
    return averages
