"""How far a member is: a note beside its file while it is made, for `minimd scan --status`.

A thread writes the note every two seconds, so that short members have none. The note is locked as long as its process lives: a note without a
lock was left behind by a process that was killed.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from minimd.ensemble.member import Member
from minimd.files.claim import is_locked, locked
from minimd.simulation.simulation import Simulation

SECONDS_BETWEEN_NOTES = 2.0
SUFFIX = ".running"
LENGTH = 60  # of a note, which is written in one piece


class Note:
    """What a member is doing.  simulation : that makes it.  first : the step at which its run begins; None before."""

    def __init__(self, member: Member) -> None:
        self._place, self._steps, self._descriptor = note_of(member.file), member.steps, -1
        self.simulation: Simulation | None = None
        self.first: int | None = None

    def write(self) -> None:
        """Write it down.  Raises OSError."""
        if self._descriptor < 0:
            self._descriptor = locked(self._place, create=True)
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        os.write(self._descriptor, f"{self}\n".rjust(LENGTH).encode())

    def remove(self) -> None:
        """Leave nothing behind, nor what a process that was killed has left.  Raises OSError."""
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
            with suppress(OSError):  # a note is a courtesy
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
    """What the member with this file is doing now; empty if no process makes it, or it has begun a moment ago."""
    place = note_of(file)
    try:
        return place.read_text(encoding="utf-8").strip() if is_locked(place) else ""
    except OSError:
        return ""
