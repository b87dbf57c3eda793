"""The members of an ensemble: index, parameters, seeds, file, and the run in that file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from minimd.console.words import listed, shown
from minimd.engine.record import Record
from minimd.simulation.simulation import Simulation
from minimd.structure.checks import checked_count

Value = bool | int | float | str
OWN_COLUMNS = ("index", "status", "n_steps", "n_atoms", "n_members", "file", "message")  # of tables
OWN_ENDINGS = ("_mean", "_error")
PER_FOLDER = 1000  # files of members
MOST_MEMBERS = 10**6  # their table takes some gigabytes


@dataclass(frozen=True)
class Member:
    """One run of an ensemble. member["temperature"] is its parameter of that name.

    index : from 0.  parameters : value of each name.  steps : number of steps asked for.  file : its H5MD file.
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
            raise KeyError(f"a member has no parameter {name!r}; it has {listed(self.parameters) or 'none'}") from None

    @cached_property
    def seed_sequence(self) -> np.random.SeedSequence:
        """The child of SeedSequence(entropy) with the index of the member;
        it does not depend on the number of members."""
        return np.random.SeedSequence(self.entropy, spawn_key=(self.index,))

    @property
    def seed(self) -> int:
        """An integer from 0 to 2⁶³ − 1, drawn from the seed sequence, for set_temperature and the noise of a bath."""
        return int(self.seed_sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))

    def run(self, simulation: Simulation, every: int = 100) -> Record:
        """For use in the function `run` of an ensemble: make the steps of the member, write its file,
        and return the record of all its frames.

        If an earlier call was stopped before the end, the simulation takes over the state in the file and makes the
        remaining steps: file and record have the same bits as without the interruption.

        every : steps between observations.  Raises as Simulation.run; FileExistsError if it is called twice.
        """
        return run_in_file(simulation, self.file, self.steps, checked_count("every", every))

    def __str__(self) -> str:
        told = ", ".join(f"{name} = {value}" for name, value in self.parameters.items())
        return f"member {self.index}" + (f" ({told})" if told else "")


def file_of(index: int) -> Path:
    """The place of the file of a member in the folder of its ensemble; a thousand members share a folder."""
    first = index - index % PER_FOLDER
    return Path(f"{first:04d}-{first + PER_FOLDER - 1:04d}") / f"{index:04d}.h5md"


def checked_parameters(parameters: Any) -> list[dict[str, Value]]:
    """The parameters of each member.  parameters : number of members, columns of values,
    or one mapping for each member.

    Raises ValueError, TypeError for anything else, no members, columns of different lengths, members with different
    names, values that are neither numbers nor texts, and names that are reserved for columns of the table.
    """
    if isinstance(parameters, Mapping):
        rows = _from_columns(parameters)
    elif (
        isinstance(parameters, Sequence)
        and not isinstance(parameters, str)
        and all(isinstance(one, Mapping) for one in parameters)
    ):
        rows = [dict(one) for one in parameters]
    elif isinstance(parameters, Sequence | np.ndarray) or hasattr(parameters, "columns"):
        raise TypeError(
            "parameters must be the number of members, a dict of columns such as {'temperature': [0.8, 0.9]}, or a "
            f"list of dicts, one for each member; parameters = {shown(parameters)}"
        )
    else:
        rows = [{} for _ in range(checked_count("the number of members", parameters, 1, MOST_MEMBERS + 1))]
    if not rows:
        raise ValueError("an ensemble must have at least one member; parameters is empty")
    for index, row in enumerate(rows):
        if row.keys() != rows[0].keys():
            raise ValueError(
                f"all members must have the same parameters; member 0 has {listed(rows[0])}, member {index} has "
                f"{listed(row)}"
            )
    for name in rows[0]:
        if not isinstance(name, str) or not name or name in OWN_COLUMNS or name.endswith(OWN_ENDINGS):
            taken = f"{listed(OWN_COLUMNS)}, and must not end in {' or '.join(OWN_ENDINGS)}"
            raise ValueError(
                f"the name of a parameter must be a text, not one of {taken}: these are columns of the table; it is "
                f"{shown(name)}"
            )
    return [{name: _checked_value(name, index, row[name]) for name in rows[0]} for index, row in enumerate(rows)]


def _from_columns(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    lists = {}
    for name, values in columns.items():
        if isinstance(values, str) or not hasattr(values, "__len__"):
            raise TypeError(f"parameter {name!r} must be a list of values, one for each member; it is {shown(values)}")
        lists[name] = list(values)
    lengths = {name: len(values) for name, values in lists.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name!r} has {length}" for name, length in lengths.items())
        raise ValueError(
            f"all parameters must have as many values as there are members; {told}. For all combinations of values, "
            "give a list of dicts"
        )
    return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]


def _checked_value(name: str, index: int, value: Any) -> Value:
    plain = value.item() if isinstance(value, np.generic) else value
    if not isinstance(plain, bool | int | float | str):
        raise TypeError(
            f"parameter {name!r} must be a number, a text, True or False; for member {index} it is {shown(value)}"
        )
    return plain


STOPPED = ".stopped.h5md"


def stopped_file(file: Path) -> Path:
    """The name under which the file of a stopped member is kept."""
    return file.with_suffix(STOPPED)


def set_aside(file: Path) -> None:
    """Rename the file of a stopped member, so that `run` may write a new file, or go on with the old one."""
    if file.exists():
        os.replace(file, stopped_file(file))


def run_in_file(simulation: Simulation, file: Path, steps: int, every: int) -> Record:
    """Make the steps of a member, or the remaining ones if it was stopped, and write them to its file;
    returns the record of all frames.

    To go on, the simulation takes over the state in the file, to the last bit.  Raises as Simulation.run.
    """
    from minimd.files.h5md_reader import read_file

    first = _taken_up(simulation, stopped_file(file))
    if first is None:
        return simulation.run(steps, every=every, trajectory=file, progress=False)
    os.replace(stopped_file(file), file)
    if simulation.step < first + steps:
        simulation.run(until_step=first + steps, every=every, trajectory=file, append=True, progress=False)
    return read_file(file).record


def _taken_up(simulation: Simulation, file: Path) -> int | None:
    """Take over the last state in a file; returns the first step of its run,
    or None if there is no file or it is damaged or of another system."""
    from minimd.files.h5md_reader import read_file, verify_frames

    if not file.exists():
        return None
    try:
        verify_frames(file)
        contents = read_file(file)
    except (OSError, ValueError):  # the member begins anew, and has the same bits
        return None
    if len(contents.system) != len(simulation.system):
        return None
    simulation.engine.go_on_from(contents.restart)
    return int(contents.record.step[0])
