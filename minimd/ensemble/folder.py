"""The folder of an ensemble: a description of what was asked for, one line for each member that has ended, and a file
for each member.

ensemble.json          seed, steps, every, functions, and the parameters of all members
members.jsonl          a line for each member that has ended, in that order; a later line replaces an earlier one
members.0-50.jsonl     the same, of calls that make only the members 0 to 49
0000-0999/0012.h5md    the run of member 12
table.csv, table.json  the table, written when a call ends
ensemble.lock          locked for a moment by a call that reads or writes what all calls share

A line is appended when a member ends: 10⁵ members need 10⁵ lines, and a process that is killed loses at most the line
that it is writing. A call locks its own journal, which holds its slice of the members: calls with other slices may run
at the same time. If several journals have a line for a member, the one that was written last is valid.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import json
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import sleep, time
from typing import Any, NamedTuple

from minimd.core.console import __version__
from minimd.core.console.whole_file import is_locked, locked, regular, write_whole
from minimd.core.console.words import shown
from minimd.core.files.crash_file import crash_file_place
from minimd.core.structure.checks import COUNTS, checked_count
from minimd.ensemble.member import (
    DONE,
    FAILED,
    NOTE,
    STOPPED,
    Row,
    Value,
    checked_parameters,
    file_of,
)

DESCRIPTION = "ensemble.json"
SHARED = "ensemble.lock"
JOURNAL = re.compile(r"members(?:\.(\d{1,9})-(\d{1,9}))?\.jsonl")
EVERYTHING = range(10**9)  # the members of a journal without numbers
CODE = ", code "  # between the name of a function and the hash of its code
FUNCTIONS = ("build", "prepare", "run")
# and the number of temperatures: what the folder of a ladder has in place of a function run
EXCHANGE = "md.exchange between"
SECONDS_BETWEEN_TRIES = 0.01  # of a lock that others hold for a moment
BYTES_AT_ONCE = 2**20  # of the journal, read in one piece
ENTROPIES = 2**128  # seeds are below it
FOLDER = re.compile(r"\d{4,}-\d{4,}")  # of members
# what a row with this status must have
NEEDED = {DONE: {"index", "n_steps", "means", "errors"}, FAILED: {"index", "message", "traceback"}}


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < COUNTS


def _are_numbers(value: Any) -> bool:
    return type(value) is dict and all(type(number) is float for number in value.values())


def _is_text(value: Any) -> bool:
    return type(value) is str


# of the values of a row that are not texts; parameters and seconds are not read
KINDS: dict[str, Callable[[Any], bool]] = {
    "index": _is_count,
    "n_steps": _is_count,
    "n_atoms": _is_count,
    "means": _are_numbers,
    "errors": _are_numbers,
    "parameters": lambda _: True,
    "seconds": lambda _: True,
    "is_blown_up": lambda value: type(value) is bool,
    "ended": lambda value: type(value) is float,
}


class Asked(NamedTuple):
    """What was asked for.
    seed : entropy of all random numbers.
    parameters : of each member.  build, prepare, run :
    names of functions, with hashes of their code, see name_of."""

    seed: int
    steps: int
    every: int
    parameters: list[dict[str, Value]]
    build: str
    prepare: str
    run: str

    @property
    def is_ladder(self) -> bool:
        """Whether it is of md.exchange."""
        return self.run.startswith(EXCHANGE)

    def is_done(self, row: Row | None) -> bool:
        """Whether a member is done: it has made all steps, or with a function run, that function has returned."""
        if row is None or row["status"] != DONE:
            return False
        return self.run != "" or row["n_steps"] >= self.steps


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until no other call reads or writes what all calls in a folder share."""
    while True:
        try:
            descriptor = locked(folder / SHARED, create=True)
            break
        except BlockingIOError:
            sleep(SECONDS_BETWEEN_TRIES)
    try:
        yield
    finally:
        os.close(descriptor)


class EnsembleFolder:
    """The folder of an ensemble; if it is opened for writing, the journal of its members is locked until it is closed.

    path : of the folder.
    members : those that are made, None for all.
    asked : what the last call asked for, None in a new folder.
    rows : of members that have ended, by index.
    """

    def __init__(self, path: Path, *, writes: bool, members: range | None = None) -> None:
        self.path = path
        self.members = members
        self._lock = -1
        of_slice = "" if members is None else f".{members.start}-{members.stop}"
        self._journal = path / f"members{of_slice}.jsonl"
        try:
            if writes:
                self._claim()
            self.read()
            if self.asked is not None or writes:
                self._folders()
        except BaseException:
            self.close()
            raise

    def _claim(self) -> None:
        """Lock the journal.
        Raises OSError if that is impossible, or another call makes some of the members."""
        self.path.mkdir(parents=True, exist_ok=True)
        try:
            self._lock = locked(self._journal, create=True)
            for file, theirs in self._journals():
                ours = theirs if self.members is None else self.members
                overlap = max(ours.start, theirs.start) < min(ours.stop, theirs.stop)
                if file != self._journal and overlap and is_locked(file, otherwise=False):
                    raise BlockingIOError
        except OSError as error:
            reason = error.strerror or "it is in use"
            advice = "choose another folder"
            if isinstance(error, BlockingIOError):
                advice = f"an ensemble with these members is running there: wait for its end, or {advice}"
            raise OSError(f"folder {str(self.path)!r} cannot be used: {reason}; {advice}") from None

    def read(self) -> None:
        """Read the description, and all journals."""
        self.asked = self._read_description()
        rows: list[Row] = []
        if self.asked is not None:
            for file, _ in self._journals():
                rows += {row["index"]: row for row in self._lines(file)}.values()
        rows.sort(key=lambda row: row.get("ended", 0.0))
        self.rows = {row["index"]: row for row in rows}

    def begin(self, asked: Asked, resume: bool, any_seed: bool = False) -> Asked:
        """Write the description of what is asked for now, and return it; the parameters of further members from earlier
        calls are appended.

        resume : True to go on with the members in the folder, False to remove them.
        any_seed : if there is a seed in the folder, it is taken.
        Raises ValueError if the folder holds another ensemble.
        """
        with alone(self.path):
            self.asked = self._read_description()
            if resume and self.asked is not None:
                if any_seed:
                    asked = asked._replace(seed=self.asked.seed)
                difference = _difference(self.asked, asked)
                if difference:
                    possible = "new members can be appended at the end of the list"
                    if asked.is_ladder:
                        possible = "more steps are possible"
                    raise ValueError(
                        f"folder {str(self.path)!r} holds another ensemble: {difference}; {possible}; for any other "
                        "change choose another folder"
                    )

                further = self.asked.parameters[len(asked.parameters) :]
                asked = asked._replace(parameters=asked.parameters + further)
            else:
                self._forget(resume)

            rows = asked.parameters
            columns = {name: [row[name] for row in rows] for name in rows[0]}
            size = {"parameters": columns, "members": len(rows), "minimd": __version__}
            write_whole(self.path / DESCRIPTION, json.dumps(asked._asdict() | size, indent=1))

        self.asked = asked
        return asked

    def _forget(self, resume: bool) -> None:
        """Remove the members, so that none goes on from a run of another ensemble."""
        for index in range(0 if self.asked is None else len(self.asked.parameters)):
            file = self.file(index)
            crash = crash_file_place(True, file) or file
            for path in (file, crash, file.with_suffix(STOPPED), file.with_suffix(NOTE)):
                path.unlink(missing_ok=True)
        if not resume:  # a new folder may have journals of other slices
            for file, _ in self._journals():
                if file != self._journal:
                    file.unlink()
        self.rows = {}
        os.ftruncate(self._lock, 0)

    def take(self, row: Row) -> None:
        """Append the row of a member that has ended.
        Raises OSError if it cannot be written, such as on a full disk."""
        index = row["index"]
        row = row | {"ended": time()}
        self.rows[index] = row
        try:
            os.lseek(self._lock, 0, os.SEEK_END)
            text = memoryview(f"{json.dumps(row)}\n".encode())
            while text:
                text = text[os.write(self._lock, text) :]
        except OSError as error:
            raise OSError(
                f"{self._journal} cannot store the results of member {index}: {error.strerror}"
            ) from None

    def file(self, index: int) -> Path:
        """The absolute path of the H5MD file of a member: the current folder of a worker may be another one."""
        return self.path.absolute() / file_of(index)

    def files(self) -> set[str]:
        """Names of all files of members, such as 0000-0999/0012.h5md; a thousand files need a single listing of a
        folder."""
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

    def _journals(self) -> list[tuple[Path, range]]:
        """The journals, and the members that each may hold."""
        journals = []
        for name in os.listdir(self.path):
            match = JOURNAL.fullmatch(name)
            if match:
                members = range(int(match[1]), int(match[2])) if match[1] else EVERYTHING
                journals.append((self.path / name, members))
        return sorted(journals, key=str)

    def _folders(self) -> list[os.DirEntry[str]]:
        """The folders of members.
        Raises OSError if one of them is a link: what it leads to may belong to others."""
        folders = [place for place in os.scandir(self.path) if FOLDER.fullmatch(place.name)]
        for place in folders:
            if not place.is_dir(follow_symlinks=False):
                raise OSError(
                    f"{place.path!r} must be a real folder, for members: it is a link or a file; remove it, or choose "
                    "another folder"
                )
        return folders

    def _read_description(self) -> Asked | None:
        file = self.path / DESCRIPTION
        try:
            with open(file, encoding="utf-8", opener=regular) as stream:
                description = json.load(stream)
            n_members = description["members"]
            rows = checked_parameters(description["parameters"] or n_members)
            if n_members != len(rows):
                raise ValueError(
                    f"members = {shown(n_members)}, but each parameter has {len(rows)} values"
                )

            functions = [description[name] for name in FUNCTIONS]
            for name, function in zip(FUNCTIONS, functions, strict=True):
                if not isinstance(function, str):
                    raise ValueError(f"{name} must be a text; {name} = {shown(function)}")
            seed = checked_count("seed", description["seed"], 0, ENTROPIES)
            steps = checked_count("steps", description["steps"], 0)
            every = checked_count("every", description["every"])
            return Asked(seed, steps, every, rows, *functions)
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            reason = f"{type(error).__name__}: {error}"
            raise ValueError(
                f"{file} is not a description of an ensemble ({reason}); choose another folder, or remove the "
                "file: all members are then made anew"
            ) from None

    def _lines(self, file: Path) -> Iterator[Row]:
        """Rows of a journal.

        An incomplete last line comes from a process that was killed; it is removed if the journal is locked here.
        """
        whole = 0
        with open(file, "rb", opener=regular) as journal:
            while piece := journal.readlines(BYTES_AT_ONCE):
                complete = [line for line in piece if line.endswith(b"\n")]
                for row in _rows_in(complete):
                    if not _is_sound(row):
                        raise ValueError(
                            f"{file} is not a journal of members: it has the line {shown(row)}; choose another folder, "
                            "or remove the file: its members are then made anew"
                        )
                    yield row
                whole += sum(map(len, complete))
        if self._lock >= 0 and file == self._journal:
            os.ftruncate(self._lock, whole)


def _difference(before: Asked, asked: Asked) -> str | None:
    """In what an ensemble differs from the one before, in words; None if it is the same. It may have more members and,
    without a function run, more steps."""
    for name in ("seed", "every", *FUNCTIONS, "steps"):
        old = getattr(before, name)
        new = getattr(asked, name)
        goes_on = not asked.run or asked.is_ladder
        may_grow = name == "steps" and goes_on and new > old
        # the code of one of them is not known
        if name in FUNCTIONS and not (CODE in old and CODE in new):
            old = old.partition(CODE)[0] or None
            new = new.partition(CODE)[0] or None
        if old != new and not may_grow:
            return f"{name} = {old} there, {new} here"
    for index, (old, new) in enumerate(zip(before.parameters, asked.parameters, strict=False)):
        if old != new:
            return f"member {index} has the parameters {shown(old)} there, {shown(new)} here"
    return None


def _rows_in(lines: list[bytes]) -> list[Any]:
    """Rows of complete lines of the journal; they share their names if the lines are read in one piece, which halves
    the memory."""
    with suppress(ValueError, RecursionError):
        rows: list[Any] = json.loads(b"[%b]" % b",".join(lines))
        if len(rows) == len(lines):
            return rows
    rows = []
    for line in lines:
        with suppress(ValueError):
            try:
                rows.append(json.loads(line))
            except RecursionError:
                rows.append(line.decode(errors="replace"))  # which is no row
    return rows


def _is_sound(row: Any) -> bool:
    """Whether a line of the journal is a row: all that is read of it later is there, and of the right type."""
    if not isinstance(row, dict):
        return False
    status = row.get("status")
    if status not in list(NEEDED) or not row.keys() >= NEEDED[status]:
        return False
    are_right = all(KINDS.get(name, _is_text)(value) for name, value in row.items())
    return are_right and list(row.get("means", ())) == list(row.get("errors", ()))


def name_of(function: Callable | None) -> str:
    """A function as module and name; empty for None. A script is the module as which others would import it.

    If its code is known, and it is none of minimd, a hash follows: of the code without comments, and of numbers and
    texts that functools.partial gives to it. Functions that it calls are not looked at. The code of a lambda is that of
    all lambdas that begin on its line.
    """
    if function is None:
        return ""
    arguments: list[Any] = []

    while isinstance(function, functools.partial):
        pairs = [*enumerate(function.args), *sorted(function.keywords.items())]
        arguments += [(name, value) for name, value in pairs if isinstance(value, Value)]
        function = function.func

    named: Any = function if hasattr(function, "__qualname__") else type(function)
    module = named.__module__
    script = getattr(sys.modules["__main__"], "__file__", None)
    if module == "__main__" and script:
        module = Path(script).stem
    name = f"{module}.{named.__qualname__}"
    try:
        # inspect.getsource would give its whole statement, or a part of one
        if name.endswith("<lambda>"):
            nodes = ast.walk(ast.parse("".join(inspect.findsource(named)[0])))
            line = named.__code__.co_firstlineno
            lambdas = [n for n in nodes if isinstance(n, ast.Lambda) and n.lineno == line]
            code = "\n".join(map(ast.unparse, lambdas))
        else:
            code = ast.unparse(ast.parse(textwrap.dedent(inspect.getsource(named))))
    except (OSError, TypeError, SyntaxError):
        return name

    digest = hashlib.sha256(f"{code}{arguments or ''}".encode()).hexdigest()[:16]
    return name if name.startswith("minimd.") else f"{name}{CODE}{digest}"
