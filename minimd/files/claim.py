"""A claim on an output file: one file, one run.

A claim holds a lock, so that no other run writes the file, neither in another process nor in this one, under any name
or link. A new file is written under a temporary name, and gets the name that was asked for when its first frame is on
the disk: a file that it replaces is kept until then, and a run that does not get the claim changes nothing. Temporary
names are those of new files, and never followed as links: whoever can write to the folder could have put links there.
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

IN_USE = (
    "another run is writing it, or a program has it open; if a universe in this process reads it, close that "
    "first: universe.trajectory.close()"
)
# and no waiting for what is a pipe
NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
UNLOCKABLE = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # of file systems without locks


class Claim:
    """A file that only this run writes.

    path : as the user gave it; links are followed.  is_new : begin a new file.  overwrite : a new file may replace
        one that exists.
    place : where to write: the path, or the temporary name of a new file.  descriptor : of the file, locked.
    replaced : descriptor of the file that will be replaced, locked; −1 if there is none.

    Raises FileExistsError if a new file would replace one and may not.  OSError if another run writes the file,
    or it is not a regular file.
    """

    def __init__(self, path: str | Path, is_new: bool = True, overwrite: bool = False) -> None:
        self.name, self.path = str(path), Path(os.path.realpath(path))
        self.replaced, self._is_new = -1, is_new
        self.place = self.path.with_name(f"{self.path.name}.begun") if is_new else self.path
        if is_new and Path(path).is_symlink() and not self.path.exists():
            raise OSError(errno.ENOENT, "it is a link to a file that does not exist; remove it, or choose another name")
        if is_new and self.path.exists() and not overwrite:
            raise FileExistsError(errno.EEXIST, "it exists; choose another name, or pass overwrite=True")
        self.descriptor = new_file(self.place) if is_new else locked(self.place)
        try:
            if is_new and self.path.exists():
                self.replaced = locked(self.path)
        except OSError:
            self.release()
            raise

    def appear(self) -> None:
        """Give a new file its name, unless it has it already.
        Raises FileExistsError if another file took the name meanwhile."""
        if not self._is_new:
            return
        os.fsync(self.descriptor)
        if self.replaced >= 0:
            os.replace(self.place, self.path)
        else:
            try:
                os.link(self.place, self.path)  # unlike a rename, it fails if the name is taken
            except FileExistsError:
                taken = "another run has made it meanwhile; choose another name"
                raise FileExistsError(errno.EEXIST, taken) from None
            except OSError:  # a file system without links
                if self.path.exists():
                    raise
                os.rename(self.place, self.path)
            else:
                self.place.unlink()
        self.place, self._is_new = self.path, False
        with suppress(OSError):  # not every system can write a folder to the disk, and with it new names of files
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        self._release_replaced()

    def sync(self) -> None:
        """Bring the file to the disk.  Raises OSError with its name."""
        try:
            os.fsync(self.descriptor)
        except OSError as error:
            words = f"trajectory {self.name!r} could not be brought to the disk: {error.strerror}"
            raise OSError(error.errno, words) from None

    @property
    def stream(self) -> Path:
        """A name under which a library may open the claimed file for writing:
        it leads there whatever its other names lead to by now."""
        own = Path(f"/dev/fd/{self.descriptor}")
        return own if own.exists() else self.place

    def check(self) -> None:
        """Raise OSError if the file was removed or replaced by another program."""
        try:
            is_there = os.path.samestat(os.lstat(self.place), os.fstat(self.descriptor))
        except FileNotFoundError:
            raise OSError(errno.ENOENT, "it was removed while the run was writing it") from None
        if not is_there:
            raise OSError(errno.EEXIST, "it was replaced while the run was writing it")

    def release(self) -> None:
        """Release the lock. A new file that has not got its name is removed."""
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
    """A descriptor of a regular file, locked: no other run can lock the file while it is open.

    Raises OSError if another run holds the lock, or it is not a regular file; a link is none.
    """
    return _locked(regular(path, os.O_RDWR | (os.O_CREAT if create else 0)), path)


def new_file(path: Path) -> int:
    """A descriptor of a new and empty regular file, locked.

    A link in its place is removed, and so is a file that a killed run has left.

    Raises OSError as locked, and if another run is faster.
    """
    with suppress(FileNotFoundError):
        if path.is_symlink():
            path.unlink()
        else:
            left = locked(path)
            try:
                path.unlink()  # while it is locked, so that nobody else takes it for left
            finally:
                os.close(left)
    try:
        return _locked(os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | NO_LINK, 0o666), path)
    except FileExistsError:
        raise OSError(errno.EBUSY, IN_USE) from None


def write_whole(file: Path, content: str | bytes) -> None:
    """Write a file under another name, then rename it: nobody sees it half written, and a link is replaced,
    not followed.

    Raises OSError with a message.
    """
    part = file.with_name(f"{file.name}.part")
    try:
        if file.exists() and not file.is_file():
            raise OSError(errno.EINVAL, "it is not a regular file")
        with open(new_file(part), "wb") as whole:
            try:
                whole.write(content.encode() if isinstance(content, str) else content)
                whole.flush()
                os.fsync(whole.fileno())
                os.replace(part, file)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
    except OSError as error:
        raise OSError(f"{str(file)!r} cannot be written: {error.strerror}") from None


def regular(path: str | Path, flags: int) -> int:
    """A descriptor of a regular file, also for open(path, opener=regular).

    Raises OSError if it is anything else: a link is not followed, and a pipe is not waited for.
    """
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.lstat(path).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return os.open(path, flags | NO_LINK, 0o666)


def _locked(descriptor: int, path: Path) -> int:
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not os.path.samestat(os.fstat(descriptor), os.lstat(path)):
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
    """Whether a process holds the lock of a file; True also where this cannot be found out.
    Raises OSError if the file cannot be opened."""
    descriptor = os.open(path, os.O_RDONLY | NO_LINK)
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return fcntl is None
    except OSError:
        return True
    finally:
        os.close(descriptor)
