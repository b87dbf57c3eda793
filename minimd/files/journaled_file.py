"""A file that changes in commits: each commit is on the disk as a whole or not at all,
whenever the process is killed or the power fails.

HDF5 updates its tables in place, one after the other; a process that dies in between leaves a file that cannot be
opened. Here HDF5 writes into memory, and a commit writes this to the disk:

    1  beyond the present end of the file, where nobody reads yet: the new bytes, and behind them a journal of those
       that will replace others, with a checksum of both
    2  the bytes of the journal, at their places
    3  the end of the file, which cuts the journal off

A file that ends with a complete journal is repaired by doing 2 and 3 again, however often. An incomplete one is no
journal: the file is as it was, because HDF5 does not read what is behind its end. The journal is in the file itself: it
is not lost when the file is moved or copied, and has no name, which a power failure could take away.
J. Gray, A. Reuter, Transaction Processing (1993), chapter 9.
"""

import errno
import os
import struct
import zlib
from contextlib import suppress
from pathlib import Path

from minimd.files.claim import Claim, locked

MAGIC = b"minimd journal 2\n"
PIECE = struct.Struct("<qq")  # place in the file, number of bytes; they follow
BLOCK = 2**20  # bytes that are read at once for a checksum
END = struct.Struct("<qqqI17s")  # size of the file before and after the commit, bytes of the pieces, CRC-32, MAGIC

Pieces = list[tuple[int, bytes]]  # place in the file, and the new bytes


class JournaledFile:
    """A file object for h5py on a claimed file.  size : of the file after the next commit [B]."""

    def __init__(self, claim: Claim) -> None:
        self._claim = claim
        _finish(claim.descriptor)
        self._committed = self.size = os.fstat(claim.descriptor).st_size
        self._tail, self._n_tail = bytearray(), 0  # beyond the committed end: the first bytes of memory that is reused
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
            old = read_at(self._claim.descriptor, min(end, self._committed) - start, start)
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

        Raises OSError if there is no room, or the file was removed, replaced or shortened during the run;
        it is then as it was.
        """
        descriptor = self._claim.descriptor
        self._claim.check()
        if (n_bytes := os.fstat(descriptor).st_size) < self._committed:
            raise OSError(errno.EIO, f"it was cut to {n_bytes} of {self._committed} bytes while the run was writing it")
        is_changed = bool(self._pieces) or self.size < self._committed
        tail = memoryview(self._tail)[: self._n_tail]
        rest = bytes(max(0, self.size - self._committed - self._n_tail))  # of the file, which HDF5 has not written
        try:
            if is_changed:
                rest += _journal(self._committed, self.size, self._pieces, zlib.crc32(rest, zlib.crc32(tail)))
            _write_all(descriptor, tail, self._committed)
            _write_all(descriptor, rest, self._committed + self._n_tail)
            os.fsync(descriptor)
        except OSError:
            with suppress(OSError):
                os.ftruncate(descriptor, self._committed)
            raise
        finally:
            tail.release()
        if is_changed:
            _apply(descriptor, self.size, self._pieces)
        if self._claim.place != self._claim.path:
            self._claim.appear()
        self._committed, self._n_tail, self._pieces = self.size, 0, []

    def close(self) -> None:
        """Release the file, as it was at the last commit. A new file without a commit is removed."""
        self._claim.release()


def repair(path: str | Path) -> bool:
    """Finish the last commit of a file, if it was interrupted; True if the file was changed.

    Raises OSError if a run is writing the file, or this process is not allowed to.
    """
    with open(path, "rb") as file:
        if _read_journal(file.fileno()) is None:
            return False
    try:
        descriptor = locked(Path(os.path.realpath(path)))
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        why = f"its last commit was interrupted, and cannot be finished here ({error.strerror})"
        raise OSError(error.errno, f"{why}; copy it to a folder of your own, and make the copy writable") from None
    try:
        return _finish(descriptor)
    finally:
        os.close(descriptor)


def _finish(descriptor: int) -> bool:
    """Carry out a complete journal at the end of a file; True if there was one."""
    if (found := _read_journal(descriptor)) is None:
        return False
    _apply(descriptor, *found)
    return True


def _journal(before: int, size: int, pieces: Pieces, checksum: int) -> bytes:
    """The journal of a commit.

    before, size : of the file before and after it.  checksum : of the new bytes before it.
    """
    body = b"".join([PIECE.pack(place, len(data)) + data for place, data in pieces])
    end = END.pack(before, size, len(body), 0, MAGIC)
    return body + END.pack(before, size, len(body), zlib.crc32(end, zlib.crc32(body, checksum)), MAGIC)


def _read_journal(file: int) -> tuple[int, Pieces] | None:
    """Size and pieces in the journal at the end of a file; None if there is none, or it is incomplete."""
    end = os.fstat(file).st_size - END.size
    if end < 0:
        return None
    before, size, n_bytes, checksum, magic = END.unpack(read_at(file, END.size, end))
    first = end - n_bytes
    if magic != MAGIC or not 0 <= before <= first <= end or not 0 <= size <= first:
        return None
    found = 0
    for place in range(before, end, BLOCK):
        found = zlib.crc32(read_at(file, min(BLOCK, end - place), place), found)
    if zlib.crc32(END.pack(before, size, n_bytes, 0, MAGIC), found) != checksum:
        return None
    text, pieces, start = read_at(file, n_bytes, first), [], 0
    while start < n_bytes:
        place, n = PIECE.unpack_from(text, start) if n_bytes - start >= PIECE.size else (-1, 0)
        start += PIECE.size + n
        if n < 0 or start > n_bytes or not 0 <= place <= before - n:  # nothing that a commit has written
            return None
        pieces.append((place, text[start - n : start]))
    return size, pieces


def _lay_over(content: bytearray, first: int, pieces: Pieces) -> None:
    """Put the pieces into content, the bytes of a file from the place first on."""
    for place, piece in pieces:
        low, high = max(place, first), min(place + len(piece), first + len(content))
        if low < high:
            content[low - first : high - first] = piece[low - place : high - place]


def _apply(descriptor: int, size: int, pieces: Pieces) -> None:
    for place, data in pieces:
        _write_all(descriptor, data, place)
    os.fsync(descriptor)
    os.ftruncate(descriptor, size)  # if power fails before the disk has it, the pieces are written again


def _write_all(descriptor: int, data: bytes | memoryview, place: int) -> None:
    done = 0
    with memoryview(data) as view:
        while done < len(view):
            if hasattr(os, "pwrite"):
                done += os.pwrite(descriptor, view[done:], place + done)
            else:  # Windows
                os.lseek(descriptor, place + done, os.SEEK_SET)
                done += os.write(descriptor, view[done:])


def read_at(descriptor: int, n_bytes: int, place: int) -> bytes:
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
