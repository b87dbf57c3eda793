"""Claims on output files, which appear whole or not at all, and files that change in commits.

A claim holds a lock, so that no other run writes the file, neither in another process nor in this one, under any name
or link. A new file is written under a temporary name, and gets the name that was asked for when its first frame is on
the disk: a file that it replaces is kept until then, and a run that does not get the claim changes nothing. On Windows,
which has no such locks and renames no open file, a new file has its name from the beginning.

HDF5 updates its tables in place, one after the other; a process that dies in between leaves a file that cannot be
opened. Into a JournaledFile it writes in memory, and a commit, on the disk as a whole or not at all, writes

    1  beyond the present end of the file, where nobody reads yet: the new bytes, and behind them a journal of those
       that will replace others, with a checksum of both
    2  the bytes of the journal, at their places
    3  the end of the file, which cuts the journal off

A file that ends with a complete journal is repaired by doing 2 and 3 again, however often. An incomplete one is no
journal: the file is as it was, because HDF5 does not read what is behind its end. The journal is in the file itself: it
is not lost when the file is moved or copied, and has no name, which a power failure could take away.
J. Gray, A. Reuter, Transaction Processing (1993), chapter 9.
"""

import ctypes
import errno
import io
import os
import signal
import struct
import sys
import zlib
from contextlib import suppress
from pathlib import Path

from minimd.core.console.whole_file import HAS_LOCKS, locked, new_file, temporary

PR_SET_PDEATHSIG = 1  # of linux/prctl.h
MAGIC = b"minimd journal 2\n"
PIECE = struct.Struct("<qq")  # place in the file, number of bytes; they follow
# size of the file before and after the commit, bytes of the pieces, CRC-32, MAGIC
END = struct.Struct("<qqqI17s")
BLOCK = 2**20  # bytes that are read at once for a checksum

Pieces = list[tuple[int, bytes]]  # place in the file, and the new bytes


class Claim:
    """A file that only this run writes.

    path : as the user gave it; links are followed.
    is_new : begin a new file; false as soon as it has its name.
    overwrite : a new file may replace one that exists.
    place : where to write: the path, or the temporary name of a new file.
    descriptor : of the file, locked.

    Raises FileExistsError if a new file would replace one and may not.  BlockingIOError if another run writes it,
    OSError if it is not a regular file.
    """

    def __init__(self, path: str | Path, is_new: bool = True, overwrite: bool = False) -> None:
        self.name = str(path)
        self.path = Path(os.path.realpath(path))
        self.is_new = is_new
        self.place = self.path
        self._replaced = -1
        is_there = self.path.exists()
        if is_new and Path(path).is_symlink() and not is_there:
            raise OSError(
                errno.ENOENT,
                "it is a link to a file that does not exist; remove it, or choose another name",
            )

        if is_new and is_there and not overwrite:
            raise FileExistsError(
                errno.EEXIST, "it exists; choose another name, or delete it with overwrite=True"
            )

        if is_new and HAS_LOCKS:
            self.place = temporary(self.path)
        self.descriptor = new_file(self.place) if is_new else locked(self.place)
        try:
            if is_new and HAS_LOCKS and self.path.exists():
                self._replaced = locked(self.path)
        except OSError:
            self.release()
            raise

    def appear(self, is_on_disk: bool = False) -> None:
        """Give a new file its name, unless it has it already.
        is_on_disk : after fsync, which then is not repeated.
        Raises FileExistsError if another file has taken it."""
        if not self.is_new:
            return
        if not is_on_disk:
            os.fsync(self.descriptor)
        try:
            if self._replaced >= 0:
                os.replace(self.place, self.path)
            elif HAS_LOCKS:
                os.link(self.place, self.path)  # unlike a rename, it fails if the name is taken
                self.place.unlink()
        except FileExistsError:
            raise FileExistsError(
                errno.EEXIST, "another run has taken this name; choose another name"
            ) from None
        except OSError:  # a file system without links
            if self._replaced >= 0 or self.path.exists():
                raise
            os.rename(self.place, self.path)

        self.place = self.path
        self.is_new = False

        # not every system can write a folder to the disk, and with it new names of files
        with suppress(OSError):
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

        self._unlock("_replaced")

    @property
    def stream(self) -> Path:
        """A name under which a library may open the claimed file for writing, whatever its other names lead to."""
        own = Path(f"/dev/fd/{self.descriptor}")
        return own if own.exists() else self.place

    def check(self) -> None:
        """Raise OSError if the file was removed or replaced by another program."""
        try:
            is_same = os.path.samestat(os.lstat(self.place), os.fstat(self.descriptor))
        except FileNotFoundError:
            raise OSError(errno.ENOENT, "it was removed while the run was writing it") from None
        if not is_same:
            raise OSError(errno.EEXIST, "it was replaced while the run was writing it")

    def release(self) -> None:
        """Release the lock. A new file that has not got its name is removed."""
        has_no_frame = self.is_new and self.descriptor >= 0
        if not HAS_LOCKS:
            self._unlock("descriptor")
        if has_no_frame:
            with suppress(OSError):
                self.place.unlink()
        self._unlock("descriptor")
        self._unlock("_replaced")

    def _unlock(self, which: str) -> None:
        descriptor = getattr(self, which)
        if descriptor >= 0:
            os.close(descriptor)
        setattr(self, which, -1)


def end_with(parent: int, number: int = signal.SIGKILL) -> None:
    """On Linux, let this process get the signal when its parent dies: the locks of the parent would live on in it."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(number))
        if os.getppid() != parent:
            os._exit(1)


class JournaledFile(io.RawIOBase):
    """A file object for h5py on a claimed file.
    size : of the file after the next commit [B]."""

    def __init__(self, claim: Claim) -> None:
        self._claim = claim
        _finish(claim.descriptor)
        self._committed = self.size = os.fstat(claim.descriptor).st_size
        # beyond the committed end: the first bytes of memory that is reused
        self._tail = bytearray()
        self._n_tail = 0
        self._pieces: Pieces = []  # replacements of committed bytes, in order
        self._at = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to a place; returns it."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self.size}[whence]
        return self._at

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Fill a buffer from the present place on; returns the number of bytes read."""
        view = memoryview(buffer).cast("B")
        start = self._at
        end = max(self._at, min(self._at + len(view), self.size))
        content = bytearray(end - start)
        old = read_at(self._claim.descriptor, min(end, self._committed) - start, start)
        tail = memoryview(self._tail)[: self._n_tail]
        for place, piece in ((start, old), (self._committed, tail), *self._pieces):
            low = max(place, start)
            high = min(place + len(piece), end)
            if low < high:
                content[low - start : high - start] = piece[low - place : high - place]
        view[: len(content)] = content
        self._at = end
        return len(content)

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Write bytes at the present place, in memory; returns their number."""
        with memoryview(data).cast("B") as view:
            cut = max(0, min(len(view), self._committed - self._at))
            if cut:
                self._pieces.append((self._at, bytes(view[:cut])))
            if cut < len(view):
                first = self._at + cut - self._committed
                last = first + len(view) - cut
                self._tail.extend(bytes(max(0, last - len(self._tail))))
                self._tail[self._n_tail : first] = bytes(max(0, first - self._n_tail))
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

    def commit(self) -> None:
        """Write to the disk what was written since the last commit, all of it or nothing; a new file gets its name.

        Raises OSError if there is no room, or the file was removed, replaced or shortened during the run;
        it is then as it was.
        """
        descriptor = self._claim.descriptor
        before = self._committed
        pieces = self._pieces
        self._claim.check()
        n_bytes = os.fstat(descriptor).st_size
        if n_bytes < before:
            raise OSError(
                errno.EIO, f"it was cut to {n_bytes} of {before} bytes while the run was writing it"
            )

        is_changed = bool(pieces) or self.size < before

        with memoryview(self._tail)[: self._n_tail] as tail:
            # of the file, which HDF5 has not written
            rest = bytes(max(0, self.size - before - self._n_tail))
            try:
                if is_changed:
                    body = b"".join([PIECE.pack(place, len(data)) + data for place, data in pieces])
                    checksum = zlib.crc32(body, zlib.crc32(rest, zlib.crc32(tail)))
                    rest += body + _end(before, self.size, len(body), checksum)

                _write_all(descriptor, tail, before)
                _write_all(descriptor, rest, before + self._n_tail)
                os.fsync(descriptor)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(descriptor, before)
                raise

        if is_changed:
            _apply(descriptor, self.size, pieces)
        self._claim.appear(is_on_disk=True)
        self._committed = self.size
        self._n_tail = 0
        self._pieces = []


def repair(path: str | Path) -> None:
    """Finish the last commit of a file, if it was interrupted.
    Raises OSError if a run is writing the file, or this process is not allowed to."""
    with open(path, "rb") as file:
        if _read_journal(file.fileno()) is None:
            return
    try:
        descriptor = locked(Path(os.path.realpath(path)))
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        raise OSError(
            error.errno,
            f"the last write to it was interrupted, and cannot be finished here ({error.strerror}); "
            "copy it to a folder of your own, and make the copy writable",
        ) from None
    with open(descriptor, "rb"):
        _finish(descriptor)


def _finish(descriptor: int) -> None:
    """Carry out a complete journal at the end of a file, if there is one."""
    journal = _read_journal(descriptor)
    if journal is not None:
        _apply(descriptor, *journal)


def _end(before: int, size: int, n_bytes: int, checksum: int) -> bytes:
    """The end of a journal.
    checksum : of the bytes from before on up to it."""
    head = END.pack(before, size, n_bytes, 0, MAGIC)
    return END.pack(before, size, n_bytes, zlib.crc32(head, checksum), MAGIC)


def _read_journal(file: int) -> tuple[int, Pieces] | None:
    """Size and pieces in the journal at the end of a file; None if there is none, or it is incomplete."""
    end = os.fstat(file).st_size - END.size
    if end < 0:
        return None
    head = read_at(file, END.size, end)
    before, size, n_bytes, _, magic = END.unpack(head)
    first = end - n_bytes
    if magic != MAGIC or not 0 <= before <= first <= end or not 0 <= size <= first:
        return None
    checksum = 0
    for place in range(before, end, BLOCK):
        checksum = zlib.crc32(read_at(file, min(BLOCK, end - place), place), checksum)
    if _end(before, size, n_bytes, checksum) != head:
        return None
    text = read_at(file, n_bytes, first)
    pieces = []
    start = 0

    while start < n_bytes:
        place, n = PIECE.unpack_from(text, start) if n_bytes - start >= PIECE.size else (-1, 0)
        start += PIECE.size + n
        # nothing that a commit has written
        if n < 0 or start > n_bytes or not 0 <= place <= before - n:
            return None
        pieces.append((place, text[start - n : start]))

    return size, pieces


def _apply(descriptor: int, size: int, pieces: Pieces) -> None:
    for place, data in pieces:
        _write_all(descriptor, data, place)
    os.fsync(descriptor)
    # if power fails before the disk has it, the pieces are written again
    os.ftruncate(descriptor, size)


def _write_all(descriptor: int, data: bytes | memoryview, place: int) -> None:
    with memoryview(data) as view:
        done = 0
        while done < len(view):
            if hasattr(os, "pwrite"):
                done += os.pwrite(descriptor, view[done:], place + done)
            else:  # Windows
                os.lseek(descriptor, place + done, os.SEEK_SET)
                done += os.write(descriptor, view[done:])


def read_at(descriptor: int, n_bytes: int, place: int) -> bytes:
    """Up to n_bytes bytes from a place on; a single call to the system reads at most 2 GB."""
    content = b""
    while len(content) < n_bytes:
        if hasattr(os, "pread"):
            part = os.pread(descriptor, n_bytes - len(content), place + len(content))
        else:  # Windows
            os.lseek(descriptor, place + len(content), os.SEEK_SET)
            part = os.read(descriptor, n_bytes - len(content))
        if not part:
            break
        content += part
    return content
