"""The members of an ensemble: index, parameters, seeds, file, and the run in that file; and the work of a worker,
which runs one member and returns a row of plain values with its results or its failure.

The progress of a member is in a note beside its file, for `minimd scan --status`. A thread writes the note every two
seconds; members that take less time have none. The process holds a lock on the note as long as it lives: a note
without a lock was left behind by a process that was killed.
"""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from minimd.core.compiled.machine import threads_by_default
from minimd.core.console.signals import Terminated
from minimd.core.console.whole_file import is_locked, new_file, regular
from minimd.core.console.words import listed, shown
from minimd.core.diagnosis.run_report import densities
from minimd.core.engine.record import Record
from minimd.core.files.crash_file import crash_file_place
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.checks import checked_count
from minimd.core.structure.errors import ConstraintError, NonFiniteError, sentence
from minimd.core.structure.statistics import mean_and_error

Value = bool | int | float | str
Row = dict[str, Any]
Job = tuple["Member", bool]  # what work needs beside the plan
# the status of a member
DONE, FAILED, BEGUN, MISSING = STATES = "done", "failed", "begun", "missing"
OWN_COLUMNS = ("index", "status", "n_steps", "n_atoms", "n_members", "file", "message")  # of tables
OWN_ENDINGS = ("_mean", "_error")
PER_FOLDER = 1000  # files of members
MOST_MEMBERS = 10**6  # their table takes some gigabytes
# endings of the note, and of the file of a stopped member that is kept
NOTE = ".running"
STOPPED = ".stopped.h5md"
SECONDS_BETWEEN_NOTES = 2.0
LENGTH = 60  # characters of a note, so that each writing replaces the whole note


@dataclass(frozen=True)
class Member:
    """One run of an ensemble. member["temperature"] is its parameter of that name.

    index : from 0.
    parameters : value of each name.
    steps : number of steps asked for.
    file : its H5MD file.
    entropy : of the ensemble; the seeds of all members are derived from it.
    """

    index: int
    parameters: Mapping[str, Value]
    entropy: int
    steps: int
    file: Path

    def __getitem__(self, name: str) -> Any:
        try:
            return self.parameters[name]
        except KeyError:
            raise KeyError(
                f"a member has no parameter {name!r}; it has {listed(self.parameters) or 'none'}"
            ) from None

    @cached_property
    def seed_sequence(self) -> np.random.SeedSequence:
        """The child of SeedSequence(entropy) with the index of the member; it does not depend on the number of
        members."""
        return np.random.SeedSequence(self.entropy, spawn_key=(self.index,))

    @property
    def seed(self) -> int:
        """An integer from 0 to 2⁶³ − 1, drawn from the seed sequence, for set_temperature and the noise of a bath."""
        return int(self.seed_sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))

    def run(self, simulation: Simulation, every: int = 100) -> Record:
        """For use in the function `run` of an ensemble: make the steps of the member, write its file, and return the
        record of all its frames.

        If an earlier call was stopped before the end, the simulation takes over the state in the file and makes the
        remaining steps: file and record have the same bits as without the interruption.

        every : steps between observations.
        Raises as Simulation.run; FileExistsError if it is called twice.
        """
        from minimd.core.files.h5md_reader import read_file, verify_frames

        every = checked_count("every", every)
        stopped = self.file.with_suffix(STOPPED)
        contents = None
        # there is none, or it is damaged: the member begins anew, to the same bits
        with suppress(OSError, ValueError):
            verify_frames(stopped)
            contents = read_file(stopped)
        if contents is None or len(contents.system) != len(simulation.system):
            return steps_in_file(simulation, self, None, every)
        simulation.engine.go_on_from(contents.restart)
        os.replace(stopped, self.file)
        return steps_in_file(simulation, self, int(contents.record.step[0]), every)

    def __str__(self) -> str:
        return member_text(self.index, self.parameters)


def value_text(value: Value) -> str:
    """The value of a parameter in tables for readers: fractions to 10 digits, so that 3 · 0.1 is 0.3."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def member_text(index: int, parameters: Mapping[str, Value]) -> str:
    """A member in words: "member 3 (temperature = 0.8)"."""
    values = ", ".join(f"{name} = {value_text(value)}" for name, value in parameters.items())
    return f"member {index} ({values})" if values else f"member {index}"


def steps_in_file(simulation: Simulation, member: Member, first: int | None, every: int) -> Record:
    """Make the steps of a member, or the remaining ones if its run has begun at the step `first`, and write them to its
    file; returns the record of all frames.
    Raises as Simulation.run."""
    from minimd.core.files.h5md_reader import read_file

    if first is None:
        return simulation.run(member.steps, every=every, trajectory=member.file, progress=False)
    file = member.file
    end = first + member.steps
    if simulation.step < end:
        simulation.run(until_step=end, every=every, trajectory=file, append=True, progress=False)
    return read_file(file).record


def file_of(index: int) -> Path:
    """The place of the file of a member in the folder of its ensemble; a thousand members share a folder."""
    first = index - index % PER_FOLDER
    return Path(f"{first:04d}-{first + PER_FOLDER - 1:04d}") / f"{index:04d}.h5md"


def checked_parameters(parameters: Any) -> list[dict[str, Value]]:
    """The parameters of each member.
    parameters : number of members, columns of values, or a mapping for each member.

    Raises ValueError, TypeError for anything else, no members, columns of different lengths, members with different
    names, values that are neither numbers nor texts, and names that are reserved for columns of the table.
    """
    is_list = isinstance(parameters, Sequence) and not isinstance(parameters, str)
    if isinstance(parameters, Mapping):
        rows = _from_columns(parameters)
    elif is_list and all(isinstance(row, Mapping) for row in parameters):
        rows = [dict(row) for row in parameters]
    elif isinstance(parameters, Sequence | np.ndarray) or hasattr(parameters, "columns"):
        raise TypeError(
            "parameters must be the number of members, a dict of columns such as {'temperature': [0.8, 0.9]}, or a "
            f"list of dicts, one for each member; parameters = {shown(parameters)}"
        )
    else:
        n_members = checked_count("the number of members", parameters, 1, MOST_MEMBERS + 1)
        return [{} for _ in range(n_members)]

    if not rows:
        raise ValueError("an ensemble must have at least one member; parameters is empty")
    names = rows[0]

    for name in names:
        is_text = isinstance(name, str) and name != ""
        if not is_text or name in OWN_COLUMNS or name.endswith(OWN_ENDINGS):
            raise ValueError(
                f"the name of a parameter must be a text, not one of {listed(OWN_COLUMNS)}, nor end in "
                f"{' or '.join(OWN_ENDINGS)}: these are columns of the table; it is {shown(name)}"
            )

    for index, row in enumerate(rows):
        if row.keys() != names.keys():
            raise ValueError(
                f"all members must have the same parameters; member 0 has {listed(names)}, member {index} has "
                f"{listed(row)}"
            )
        for name, value in row.items():
            if isinstance(value, np.generic):
                row[name] = value.item()
            if not isinstance(row[name], Value):
                raise TypeError(
                    f"parameter {name!r} must be a number, a text, True or False; for member {index} it is "
                    f"{shown(value)}"
                )

    return [{name: row[name] for name in names} for row in rows]


def _from_columns(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    for name, values in columns.items():
        if isinstance(values, str) or not hasattr(values, "__len__"):
            raise TypeError(
                f"parameter {name!r} must be a list of values, one for each member; it is {shown(values)}"
            )
    if len({len(values) for values in columns.values()}) > 1:
        sizes = ", ".join(f"{name!r} has {len(values)}" for name, values in columns.items())
        raise ValueError(
            f"all parameters must have as many values as there are members; {sizes}. For all combinations of values, "
            "give a list of dicts"
        )
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


@dataclass(frozen=True)
class Plan:
    """What is done for every member; see ensemble.
    call : unique name of this call of ensemble."""

    build: Callable[[Member], Simulation]
    prepare: Callable[[Simulation, Member], Any] | None
    run: Callable[[Simulation, Member], Any] | None
    every: int
    call: str


@contextmanager
def noting(member: Member) -> Iterator[list[Any]]:
    """A note of what the member is doing, which a thread writes as long as this context lasts.

    Yields a list, for the simulation and the step at which its run begins: empty until then.
    """
    place = member.file.with_suffix(NOTE)
    ended = threading.Event()
    now = list[Any]()

    def keep() -> None:
        descriptor = -1

        while not ended.wait(SECONDS_BETWEEN_NOTES):
            state = "being prepared"
            if now:
                simulation, first = now
                state = f"at step {simulation.step - first} of {member.steps}"

            with suppress(OSError):  # a run does not fail because its note cannot be written
                if descriptor < 0:
                    descriptor = new_file(place)
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, f"{state}\n".rjust(LENGTH).encode())

        if descriptor >= 0:
            os.close(descriptor)

    thread = threading.Thread(target=keep, daemon=True)
    thread.start()
    try:
        yield now
    finally:
        ended.set()
        thread.join()
        with suppress(OSError):
            place.unlink(missing_ok=True)  # also that of a process that was killed


def read_note(file: Path) -> str:
    """What the member with this file is doing now; empty if no process runs it, or if it began less than two seconds
    ago."""
    place = file.with_suffix(NOTE)
    try:
        with open(place, encoding="utf-8", opener=regular) as note:
            return note.read().strip() if is_locked(place) else ""
    except (OSError, UnicodeDecodeError):
        return ""


def work(plan: Plan, member: Member, begins_anew: bool) -> Row:
    """Run a member and return its row, which also describes an error.

    Its simulation has one thread, unless build says otherwise.

    begins_anew : do not go on from its file, because a run that has blown up would go another way from there.
    A transient error may be gone in another attempt: one of files, connections or memory, but none of physics.
    Raises KeyboardInterrupt, Terminated if it is stopped.
    """
    started = perf_counter()
    row = {"index": member.index, "parameters": dict(member.parameters)}
    try:
        with threads_by_default(1), noting(member) as now:
            row |= _results(plan, member, begins_anew, now)
    except Terminated:
        raise
    except (Exception, SystemExit) as error:  # of build, prepare or run, which are the user's
        file = getattr(error, "file", None)
        message = f"{type(error).__name__}: {sentence(error)}"
        row |= {"status": FAILED, "message": message, "traceback": traceback.format_exc()}
        row["crash_file"] = "" if file is None else str(file)
        row["is_blown_up"] = isinstance(error, NonFiniteError | ConstraintError)
        row["is_transient"] = isinstance(error, OSError | MemoryError)

    return row | {"seconds": perf_counter() - started}


def work_through(plan: Plan, jobs: list[Job], _number: int) -> list[Row]:
    """Do several jobs, one after the other.
    _number : of this call, unique; dask would return the results of an equal call."""
    return [work(plan, *job) for job in jobs]


def _results(plan: Plan, member: Member, begins_anew: bool, now: list[Any]) -> Row:
    from minimd.core.files.h5md_reader import read_file

    simulation = plan.build(member)
    first = None
    n_steps = member.steps
    if not isinstance(simulation, Simulation):
        raise TypeError(
            f"build must return a Simulation; for {member} it returned {shown(simulation)}"
        )

    file = member.file
    stopped = file.with_suffix(STOPPED)
    crash = crash_file_place(True, file) or file
    begins_anew |= crash.exists()
    if not begins_anew and plan.run is None:
        threads = simulation.options.threads
        # there is none, or it is damaged: the member begins anew, to the same bits
        with suppress(OSError, ValueError):
            simulation = Simulation.resume(file, simulation.potentials, threads=threads)
            first = int(read_file(file).record.step[0])

    if first is None:
        if begins_anew or plan.run is None:
            stopped.unlink(missing_ok=True)
        elif file.exists():  # `run` may write a new file, or go on with the old one
            os.replace(file, stopped)

        file.unlink(missing_ok=True)
        crash.unlink(missing_ok=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        if plan.prepare is not None:
            plan.prepare(simulation, member)

    begun = simulation.step if first is None else first
    now += (simulation, begun)
    if plan.run is None:
        result: Any = steps_in_file(simulation, member, first, plan.every)
    else:
        result = plan.run(simulation, member)
        stopped.unlink(missing_ok=True)
        n_steps = simulation.step - begun

    averages = averages_of(result, float(simulation.system.masses.sum()))
    return {
        "status": DONE,
        "n_steps": n_steps,
        "n_atoms": len(simulation.system),
        "units": simulation.system.units.name,
        "means": {name: mean for name, (mean, _) in averages.items()},
        "errors": {name: error for name, (_, error) in averages.items()},
    }


def averages_of(result: Any, mass: float) -> dict[str, tuple[float, float]]:
    """Means and errors, by name, of what the function run returned; none for None. Where a record has volumes, the
    density is among them; in a periodic cell, where it is no constant, the angular momentum is not.

    result : a Record, or a dict of numbers, of tuples (mean, error) or of series.
    mass : of all atoms.
    Raises TypeError, ValueError for anything else.
    """
    demand = (
        "run must return a Record, a dict of numbers, of tuples (mean, error) or of series, or None"
    )
    averages: dict[str, tuple[float, float]] = {}
    if result is None:
        return averages
    if isinstance(result, Record):
        for name, column in result.columns().items():
            is_turning = "angular_momentum" in name and "pressure" in result
            if name not in ("step", "time") and not is_turning:
                averages[name] = mean_and_error(column)
        if "volume" in result:
            averages["density"] = mean_and_error(densities(result, mass)[0])
        return averages

    if not isinstance(result, Mapping):
        raise TypeError(f"{demand}; it returned {shown(result)}")

    for name, value in result.items():
        if not isinstance(name, str) or not name:
            raise TypeError(
                f"{demand}, with texts as names; a name in the dict that it returned is {shown(name)}"
            )

        array = np.asarray(value)
        if array.dtype.kind not in "biuf" or array.ndim > 1:
            raise TypeError(f"{demand}; in the dict that it returned {name} = {shown(value)}")
        if array.ndim == 0:
            averages[name] = float(array), np.nan
        elif isinstance(value, tuple) and len(value) == 2:
            averages[name] = float(array[0]), float(array[1])
        else:
            averages[name] = mean_and_error(array)

    return averages
