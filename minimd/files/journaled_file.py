"""A file that changes in commits: each commit is on the disk as a whole or not at all, whenever the process is killed or the power fails.

HDF5 updates its tables in place, one after the other; a process that dies in between leaves a file that cannot be opened. Here HDF5 writes
into memory, and a commit writes this to the disk:

    1  bytes beyond the present end of the file, which nobody reads yet, are written
    2  bytes that will replace others in the file are written to a journal beside it, with a checksum
    3  these bytes are replaced
    4  the journal is removed

A file with a complete journal is repaired by doing 3 and 4 again. An incomplete journal is removed: the file is as it was. So is a journal of
another file, which the witness in it shows: the checksum of the last bytes of the file as they are after 3.
J. Gray, A. Reuter, Transaction Processing (1993), chapter 9.
"""

import errno
import os
import struct
import zlib
from contextlib import suppress
from pathlib import Path

from minimd.files.claim import Claim, locked, new_file, no_link

MAGIC = b"minimd journal 1\n"
HEAD = struct.Struct("<qqII")  # size of the file after the commit, number of pieces, witness, CRC-32 of these and of all that follows
WITNESS = 64 * 1024  # bytes
PIECE = struct.Struct("<qq")  # place in the file, number of bytes

Pieces = list[tuple[int, bytes]]  # place in the file, and the new bytes


class JournaledFile:
    """A file object for h5py on a claimed file.  size : of the file after the next commit [B]."""

    def __init__(self, claim: Claim) -> None:
        self._claim, self._journal = claim, journal_of(claim.path)
        existing = claim.descriptor if claim.place == claim.path else claim.replaced
        if existing >= 0:
            _finish(self._journal, existing)
        self._committed = self.size = os.fstat(claim.descriptor).st_size
        self._tail, self._n_tail = bytearray(), 0  # bytes beyond the committed end: the first ones in memory that is reused
        self._pieces: Pieces = []  # replacements of committed bytes, in order
        self._at = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to a place; returns it."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self.size}[whence]
        return self._at

    def tell(self) -> int:
        """The present place."""
        return self._at

    def read(self, n_bytes: int) -> bytes:
        """Up to n_bytes bytes from the present place on."""
        found = bytearray(n_bytes)
        return bytes(found[: self.readinto(memoryview(found))])

    def readinto(self, buffer: memoryview) -> int:
        """Fill a buffer from the present place on; returns the number of bytes read."""
        view = memoryview(buffer).cast("B")
        start, end = self._at, max(self._at, min(self._at + len(view), self.size))
        found = bytearray(end - start)
        if start < self._committed:
            old = _read_at(self._claim.descriptor, min(end, self._committed) - start, start)
            found[: len(old)] = old
        if end > self._committed:
            first = max(start, self._committed)
            new = self._tail[first - self._committed : min(end - self._committed, self._n_tail)]
            found[first - start : first - start + len(new)] = new
        _lay_over(found, start, self._pieces)
        view[: len(found)] = found
        self._at = end
        return len(found)

    def write(self, data: bytes) -> int:
        """Write bytes at the present place, in memory; returns their number."""
        with memoryview(data).cast("B") as view:
            cut = max(0, min(len(view), self._committed - self._at))
            if cut:
                self._pieces.append((self._at, bytes(view[:cut])))
            if cut < len(view):
                first = self._at + cut - self._committed
                last = first + len(view) - cut
                if last > len(self._tail):
                    self._tail.extend(bytes(last - len(self._tail)))
                if first > self._n_tail:
                    self._tail[self._n_tail : first] = bytes(first - self._n_tail)
                self._tail[first:last] = view[cut:]
                self._n_tail = max(self._n_tail, last)
            self._at += len(view)
            self.size = max(self.size, self._at)
            return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the end of the file to size, or to the present place if it is None; returns the new size."""
        self.size = self._at if size is None else size
        self._n_tail = min(self._n_tail, max(0, self.size - self._committed))
        return self.size

    def flush(self) -> None:
        """Do nothing: bytes that HDF5 flushes wait for commit."""

    def commit(self) -> None:
        """Write to the disk what was written since the last commit, all of it or nothing.

        Raises OSError if there is no room, or the file was removed, replaced or shortened during the run; it is then as it was.
        """
        descriptor = self._claim.descriptor
        self._check()
        is_changed = bool(self._pieces) or self.size < self._committed
        try:
            with memoryview(self._tail) as tail:
                _write_all(descriptor, tail[: self._n_tail], self._committed)
            os.fsync(descriptor)
            if is_changed:
                _write_journal(self._journal, descriptor, self.size, self._pieces)
        except OSError:
            with suppress(OSError):
                self._journal.unlink(missing_ok=True)
            with suppress(OSError):
                os.ftruncate(descriptor, self._committed)
            raise
        if is_changed:
            _apply(descriptor, self.size, self._pieces)
            self._journal.unlink()
        if self._claim.place != self._claim.path:
            self._journal.unlink(missing_ok=True)  # of the file that is replaced
            self._claim.appear()
        self._committed, self._n_tail, self._pieces = self.size, 0, []

    def close(self) -> None:
        """Release the file, as it was at the last commit. A new file without a commit is removed."""
        self._claim.release()

    def _check(self) -> None:
        self._claim.check()
        n_bytes = os.fstat(self._claim.descriptor).st_size
        if n_bytes < self._committed:
            raise OSError(errno.EIO, f"it was cut to {n_bytes} of {self._committed} bytes while the run was writing it")


def journal_of(path: Path) -> Path:
    """The name of the journal of a file."""
    return path.with_name(f"{path.name}.journal")


def repair(path: str | Path) -> bool:
    """Finish the last commit of a file, if it was interrupted; True if the file was changed.

    Raises OSError if a run is writing the file, or this process is not allowed to.
    """
    place = Path(os.path.realpath(path))
    if not journal_of(place).exists() or not place.exists():
        return False
    try:
        descriptor = locked(place)
        try:
            return _finish(journal_of(place), descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        left = f"its last commit was interrupted, and must be finished from {journal_of(place).name!r} beside it"
        raise OSError(error.errno, f"{left}, which is not allowed here ({error.strerror}); copy both files to a folder of your own") from None


def _finish(journal: Path, descriptor: int) -> bool:
    """Carry out a journal if it is complete, and remove it; True if the file was changed. A link in its place is only removed."""
    try:
        if journal.is_symlink():
            journal.unlink()
        found = _read_journal(journal, descriptor)
    except FileNotFoundError:
        return False
    if found is not None:
        _apply(descriptor, *found)
    journal.unlink()
    return found is not None


def _write_journal(path: Path, file: int, size: int, pieces: Pieces) -> None:
    head = size, len(pieces), _witness(file, size, pieces)
    body = b"".join([PIECE.pack(place, len(data)) + data for place, data in pieces])
    descriptor = new_file(path)
    try:
        _write_all(descriptor, MAGIC + HEAD.pack(*head, _checksum(head, body)) + body, 0)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _read_journal(path: Path, file: int) -> tuple[int, Pieces] | None:
    """Size and pieces in a journal; None if it is incomplete, or of another file."""
    with open(path, "rb", opener=no_link) as journal:
        text, start = journal.read(), len(MAGIC) + HEAD.size
    if len(text) < start or not text.startswith(MAGIC):
        return None
    *head, checksum = HEAD.unpack_from(text, len(MAGIC))
    if _checksum(tuple(head), text[start:]) != checksum:
        return None
    size, n_pieces, witness = head
    pieces = []
    while start + PIECE.size <= len(text):
        place, n_bytes = PIECE.unpack_from(text, start)
        start += PIECE.size + max(0, n_bytes)
        pieces.append((place, text[start - n_bytes : start]))
    is_whole = start == len(text) and len(pieces) == n_pieces and min([size, *(place for place, _ in pieces)]) >= 0
    return (size, pieces) if is_whole and _witness(file, size, pieces) == witness else None


def _checksum(head: tuple[int, ...], body: bytes) -> int:
    return zlib.crc32(body, zlib.crc32(HEAD.pack(*head, 0)))


def _witness(file: int, size: int, pieces: Pieces) -> int:
    """CRC-32 of the last bytes of a file with the pieces in it; the same before, while and after the pieces are written."""
    first = max(0, size - WITNESS)
    content = bytearray(_read_at(file, size - first, first).ljust(size - first, b"\0"))
    _lay_over(content, first, pieces)
    return zlib.crc32(content)


def _lay_over(content: bytearray, first: int, pieces: Pieces) -> None:
    """Put the pieces into content, the bytes of a file from the place first on."""
    for place, piece in pieces:
        low, high = max(place, first), min(place + len(piece), first + len(content))
        if low < high:
            content[low - first : high - first] = piece[low - place : high - place]


def _apply(descriptor: int, size: int, pieces: Pieces) -> None:
    for place, data in pieces:
        _write_all(descriptor, data, place)
    os.ftruncate(descriptor, size)
    os.fsync(descriptor)


def _write_all(descriptor: int, data: bytes | memoryview, place: int) -> None:
    done = 0
    with memoryview(data) as view:
        while done < len(view):
            done += _write_at(descriptor, view[done:], place + done)


def _read_at(descriptor: int, n_bytes: int, place: int) -> bytes:
    """Up to n_bytes bytes from a place on; a single call to the system reads at most 2 GB."""
    found = []
    while n_bytes > 0 and (part := _read_some(descriptor, n_bytes, place)):
        found.append(part)
        n_bytes, place = n_bytes - len(part), place + len(part)
    return b"".join(found)


def _read_some(descriptor: int, n_bytes: int, place: int) -> bytes:
    if hasattr(os, "pread"):
        return os.pread(descriptor, n_bytes, place)
    os.lseek(descriptor, place, os.SEEK_SET)  # Windows has no pread
    return os.read(descriptor, n_bytes)


def _write_at(descriptor: int, data: memoryview, place: int) -> int:
    if hasattr(os, "pwrite"):
        return os.pwrite(descriptor, data, place)
    os.lseek(descriptor, place, os.SEEK_SET)
    return os.write(descriptor, data)
