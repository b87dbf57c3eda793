"""The folder of an ensemble: a description of what was asked for, one line for each member that has ended,
and a file for each member.

ensemble.json          seed, steps, every, functions, and the parameters of all members
members.jsonl          a line for each member that has ended, in that order; a later line replaces an earlier one
0000-0999/0012.h5md    the run of member 12
table.csv, table.json  the table, written when a call ends

A line is appended when a member ends: 10⁵ members need 10⁵ lines,
and a process that is killed loses at most the line that it is writing.
"""

from __future__ import annotations

import functools
import json
import os
import re
import secrets
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from minimd.compiled.machine import version
from minimd.console.words import shown
from minimd.ensemble.member import Value, checked_parameters, file_of, stopped_file
from minimd.ensemble.work import DONE, FAILED, Row
from minimd.ensemble.work import SUFFIX as NOTE
from minimd.files.claim import locked, regular, write_whole
from minimd.files.crash_file import crash_file_place
from minimd.structure.checks import COUNTS, checked_count

DESCRIPTION, JOURNAL = "ensemble.json", "members.jsonl"
BYTES_AT_ONCE = 2**20  # of the journal, read in one piece
ENTROPIES = 2**128  # seeds are below it
FOLDER = re.compile(r"\d{4,}-\d{4,}")  # of members
# in a row; all others are texts
KINDS = {"index": int, "n_steps": int, "n_atoms": int, "means": dict, "errors": dict, "is_blown_up": bool}
NEEDED = {DONE: ("n_steps", "means", "errors"), FAILED: ("message", "traceback")}  # in a row with this status


class Asked(NamedTuple):
    """What was asked for.  seed : entropy of all random numbers.  parameters : of each member.  build, prepare, run :
    names of functions."""

    seed: int
    steps: int
    every: int
    parameters: list[dict[str, Value]]
    build: str
    prepare: str
    run: str


class EnsembleFolder:
    """The folder of an ensemble; if it is opened for writing, it is locked until it is closed.

    path : of the folder.  asked : what the last call asked for, None in a new folder.  rows :
        of members that have ended, by index.
    """

    def __init__(self, path: Path, *, writes: bool) -> None:
        self.path, self._lock = path, -1
        if writes:
            path.mkdir(parents=True, exist_ok=True)
            try:
                self._lock = locked(path / JOURNAL, create=True)
            except OSError as error:
                advice = (
                    ": an ensemble is running there; wait for its end, or choose another folder"
                    if isinstance(error, BlockingIOError)
                    else "; choose another folder"
                )
                raise OSError(f"folder {str(path)!r} cannot be used: {error.strerror}{advice}") from None
        try:
            self.asked, self.rows = self._read_description(), dict[int, Row]()
            if self.asked is not None:
                self.rows = {row["index"]: row for row in self._lines()}
            if self.asked is not None or writes:
                self._folders()
        except BaseException:
            self.close()
            raise

    def begin(self, asked: Asked, resume: bool) -> Asked:
        """Write the description of what is asked for now, and return it;
        the parameters of further members from earlier calls are appended.

        resume : True to go on with the members in the folder, False to remove them.
        Raises ValueError if the folder holds another ensemble.
        """
        if resume and self.asked is not None:
            self._check_is(self.asked, asked)
            asked = asked._replace(parameters=asked.parameters + self.asked.parameters[len(asked.parameters) :])
        else:
            for index in range(len(self.asked.parameters) if self.asked is not None else 0):
                file = self.file(index)  # of a member, which must not go on from a run of another ensemble
                for one in (file, crash_file_place(True, file), stopped_file(file), file.with_suffix(NOTE)):
                    if one is not None:
                        one.unlink(missing_ok=True)
            self.rows = {}
            os.ftruncate(self._lock, 0)
        told = asked._asdict() | {
            "parameters": columns_of(asked.parameters),
            "members": len(asked.parameters),
            "minimd": version("minimd"),
        }
        write_whole(self.path / DESCRIPTION, json.dumps(told, indent=1))
        self.asked = asked
        return asked

    def take(self, row: Row) -> None:
        """Append the row of a member that has ended.  Raises OSError if it cannot be written,
        such as on a full disk."""
        self.rows[row["index"]] = row
        try:
            os.lseek(self._lock, 0, os.SEEK_END)
            text = memoryview(f"{json.dumps(row)}\n".encode())
            while text:
                text = text[os.write(self._lock, text) :]
        except OSError as error:
            raise OSError(
                f"{self.path / JOURNAL} cannot store the results of member {row['index']}: {error.strerror}"
            ) from None

    def file(self, index: int) -> Path:
        """The absolute path of the H5MD file of a member: the current folder of a worker may be another one."""
        return self.path.absolute() / file_of(index)

    def files(self) -> set[str]:
        """Names of all files of members, such as 0000-0999/0012.h5md;
        a thousand files need a single listing of a folder."""
        return {f"{place.name}/{name}" for place in self._folders() for name in os.listdir(place)}

    def close(self) -> None:
        """Release the lock of the folder."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> EnsembleFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _folders(self) -> list[os.DirEntry[str]]:
        """The folders of members.  Raises OSError if one of them is a link: what it leads to may belong to others."""
        found = [place for place in os.scandir(self.path) if FOLDER.fullmatch(place.name)]
        for place in found:
            if not place.is_dir(follow_symlinks=False):
                raise OSError(
                    f"{place.path!r} must be a real folder, for members: it is a link or a file; remove it, or choose "
                    "another folder"
                )
        return found

    def _read_description(self) -> Asked | None:
        file = self.path / DESCRIPTION
        try:
            with open(file, encoding="utf-8", opener=regular) as description:
                told = json.load(description)
            rows = checked_parameters(told["parameters"] or told["members"])
            if told["members"] != len(rows):
                raise ValueError(f"members = {shown(told['members'])}, but each parameter has {len(rows)} values")
            for name in ("build", "prepare", "run"):
                if not isinstance(told[name], str):
                    raise ValueError(f"{name} must be a text; {name} = {shown(told[name])}")
            seed, steps = checked_count("seed", told["seed"], 0, ENTROPIES), checked_count("steps", told["steps"], 0)
            return Asked(
                seed, steps, checked_count("every", told["every"]), rows, told["build"], told["prepare"], told["run"]
            )
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(
                f"{file} is not a description of an ensemble ({type(error).__name__}: {error}); choose another folder, "
                "or remove it"
            ) from None

    def _lines(self) -> Iterator[Row]:
        """Rows of the journal.

        An incomplete last line comes from a process that was killed; it is removed if the folder is open for writing.
        """
        file, whole = self.path / JOURNAL, 0
        with open(file, "rb", opener=regular) as lines:
            while some := lines.readlines(BYTES_AT_ONCE):
                for row in _rows_in(some):
                    if not _is_sound(row):
                        raise ValueError(
                            f"{file} is not a journal of members: it has the line {shown(row)}; choose another folder, "
                            "or remove it"
                        )
                    yield row
                whole += sum(map(len, some)) - (0 if some[-1].endswith(b"\n") else len(some[-1]))
        if self._lock >= 0:
            os.ftruncate(self._lock, whole)

    def _check_is(self, before: Asked, asked: Asked) -> None:
        """Raise ValueError unless this is the same ensemble; it may have more members and, without a function run,
        more steps."""
        for name in ("seed", "every", "build", "prepare", "run"):
            there, here = (value if (value := getattr(one, name)) != "" else None for one in (before, asked))
            self._refuse_unless(there == here, f"{name} = {there} there, {here} here")
        may_grow = not asked.run and asked.steps > before.steps
        self._refuse_unless(
            asked.steps == before.steps or may_grow, f"steps = {before.steps} there, {asked.steps} here"
        )
        pairs = zip(before.parameters, asked.parameters, strict=False)
        index = next((k for k, (one, other) in enumerate(pairs) if one != other), None)
        if index is not None:
            there, here = shown(before.parameters[index]), shown(asked.parameters[index])
            self._refuse_unless(False, f"member {index} has the parameters {there} there, {here} here")

    def _refuse_unless(self, is_same: bool, words: str) -> None:
        if not is_same:
            raise ValueError(
                f"folder {str(self.path)!r} holds another ensemble: {words}; choose another folder, or replace what is "
                "there with resume=False"
            )


def _rows_in(lines: list[bytes]) -> list[Row]:
    """Rows of the complete lines of the journal.

    If the lines are read in one piece, rows share their names, which halves the memory.
    """
    whole = [line for line in lines if line.endswith(b"\n")]
    with suppress(ValueError, RecursionError):
        rows: list[Row] = json.loads(b"[%b]" % b",".join(whole))
        if len(rows) == len(whole):
            return rows
    found = []
    for line in whole:
        with suppress(ValueError):
            try:
                found.append(json.loads(line))
            except RecursionError:
                found.append(line.decode(errors="replace"))  # which is no row
    return found


def _is_sound(row: Any) -> bool:
    """Whether a line of the journal is a row: all that is read of it later is there, and of the right type."""
    if (
        not isinstance(row, dict)
        or "index" not in row
        or row.get("status") not in list(NEEDED)
        or not row.keys() >= set(NEEDED[row["status"]])
    ):
        return False
    others = ("parameters", "seconds")  # not read
    is_of_kind = all(type(value) is KINDS.get(name, str) for name, value in row.items() if name not in others)
    counts = [row[name] for name in ("index", "n_steps", "n_atoms") if name in row]
    numbers = [number for name in ("means", "errors") for number in row.get(name, {}).values()] if is_of_kind else []
    return (
        is_of_kind and all(0 <= count < COUNTS for count in counts) and all(type(number) is float for number in numbers)
    )


def columns_of(parameters: list[dict[str, Value]]) -> dict[str, list[Value]]:
    """The parameters of all members by name."""
    return {name: [one[name] for one in parameters] for name in parameters[0]}


def entropy_of(seed: int | None, before: Asked | None) -> int:
    """The entropy: the seed if given, else that of the folder, else a random one.
    Raises ValueError for a seed below 0 or from 2¹²⁸ on."""
    if seed is not None:
        return checked_count("seed", seed, 0, ENTROPIES)
    return before.seed if before is not None else secrets.randbits(128)


def name_of(function: Callable | None) -> str:
    """A function as module and name; empty for None. A script is the module as which others would import it."""
    if function is None:
        return ""
    while isinstance(function, functools.partial):
        function = function.func
    named: Any = function if hasattr(function, "__qualname__") else type(function)
    script = getattr(sys.modules["__main__"], "__file__", None)
    module = Path(script).stem if named.__module__ == "__main__" and script else named.__module__
    return f"{module}.{named.__qualname__}"


def is_done(row: Row | None, steps: int, has_run: bool) -> bool:
    """Whether a member is done: it has made all steps, or with a function run, that function has returned."""
    return row is not None and row["status"] == DONE and (has_run or row["n_steps"] >= steps)
