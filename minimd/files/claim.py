"""A claim on an output file: one file, one run.

Who has the claim holds a lock, so that no other run writes the file: neither in another process nor in this one, under whatever name or link. A
new file grows under a name of its own, and appears under the one that was asked for when its first frame is in it: what it replaces is kept until
then, and who loses touches nothing.
"""

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

IN_USE = "another run is writing it, or a program has it open; a universe of it in this one must be closed first, universe.trajectory.close()"
UNLOCKABLE = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # of file systems without locks


class Claim:
    """A file that this run alone writes.

    path : links are followed.  is_new : begin a new file.  overwrite : it may replace one that exists.
    place : where to write: the path, or the name that a new file has until it appears.  descriptor : of the file, locked.
    replaced : descriptor of the file that will be replaced, locked; −1 if there is none.

    Raises FileExistsError if a new file exists and may not be replaced.  OSError if another run writes the file, or it is no regular file.
    """

    def __init__(self, path: str | Path, is_new: bool = True, overwrite: bool = False) -> None:
        self.name, self.path = str(path), Path(os.path.realpath(path))
        self.replaced, self._is_new = -1, is_new
        self.place = self.path.with_name(f"{self.path.name}.begun") if is_new else self.path
        if is_new and self.path.exists() and not overwrite:
            raise FileExistsError(errno.EEXIST, "it exists; choose another name, or pass overwrite=True")
        self.descriptor = _begun(self.place) if is_new else locked(self.place)
        try:
            if is_new and self.path.exists():
                self.replaced = locked(self.path)
        except OSError:
            self.release()
            raise

    def appear(self) -> None:
        """A new file gets its name, if it has not got it yet.  Raises FileExistsError if another file has it meanwhile, and may not be replaced."""
        if not self._is_new:
            return
        if self.replaced >= 0:
            os.replace(self.place, self.path)
        else:
            _rename(self.place, self.path)
        self.place, self._is_new = self.path, False
        _sync_folder(self.path.parent)
        self._release_replaced()

    def check(self) -> None:
        """Raise OSError if the file was removed or replaced by somebody else."""
        try:
            is_there = _is_same(os.stat(self.place), os.fstat(self.descriptor))
        except FileNotFoundError:
            raise OSError(errno.ENOENT, "it was removed while the run was writing it") from None
        if not is_there:
            raise OSError(errno.EEXIST, "it was replaced while the run was writing it")

    def release(self) -> None:
        """Give the file free. A new one that has not appeared leaves nothing."""
        if self.descriptor < 0:
            return
        if self._is_new:
            with suppress(OSError):
                self.place.unlink()
        os.close(self.descriptor)
        self.descriptor = -1
        self._release_replaced()

    def _release_replaced(self) -> None:
        if self.replaced >= 0:
            os.close(self.replaced)
            self.replaced = -1


def locked(path: Path, create: bool = False) -> int:
    """A descriptor of a regular file, which no other run can get while it is open.

    Raises OSError if another run has it, or it is no regular file.
    """
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file")
    descriptor = os.open(path, os.O_RDWR | (os.O_CREAT if create else 0) | getattr(os, "O_BINARY", 0), 0o666)
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not _is_same(os.fstat(descriptor), os.stat(path)):
            raise BlockingIOError
    except (BlockingIOError, FileNotFoundError):
        os.close(descriptor)
        raise OSError(errno.EBUSY, IN_USE) from None
    except OSError as error:
        if error.errno not in UNLOCKABLE:
            os.close(descriptor)
            raise
    return descriptor


def is_locked(path: Path) -> bool:
    """Whether a process has the lock of a file; true also where nobody can know.  Raises OSError for a file that cannot be opened."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    else:
        return fcntl is None
    finally:
        os.close(descriptor)


def _begun(place: Path) -> int:
    """The descriptor of an empty file, locked. What a killed run left under this name is nobody's, unless it has another name: that file is whole."""
    descriptor = locked(place, create=True)
    if os.fstat(descriptor).st_nlink > 1:
        os.close(descriptor)
        place.unlink()
        descriptor = locked(place, create=True)
    os.ftruncate(descriptor, 0)
    return descriptor


def _rename(old: Path, new: Path) -> None:
    """Rename a file.  Raises FileExistsError if the new name is taken."""
    try:
        os.link(old, new)  # unlike a rename it fails if the name is taken
    except FileExistsError:
        raise FileExistsError(errno.EEXIST, "another run has made it meanwhile; choose another name") from None
    except OSError:  # a file system without links
        if new.exists():
            raise
        os.rename(old, new)
    else:
        old.unlink()


def _is_same(one: os.stat_result, other: os.stat_result) -> bool:
    return (one.st_dev, one.st_ino) == (other.st_dev, other.st_ino)


def _sync_folder(folder: Path) -> None:
    """A new name is on the disk when its folder is. Not every system can do this."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
