"""The progress of a member: a note beside its file, kept while the member runs, for `minimd scan --status`.

A thread writes the note every two seconds; members that take less time have none. The process holds a lock on the note
as long as it lives: a note without a lock was left behind by a process that was killed.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from minimd.ensemble.member import Member
from minimd.files.claim import is_locked, new_file, regular
from minimd.simulation.simulation import Simulation

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
