"""Files that are written whole or not at all, under a lock that only one run holds.

Temporary names are those of new files, and never followed as links: whoever can write to the folder could have put
links there. No other program gives such names: what lies there was left by a killed run.
"""

import bz2
import errno
import gzip
import os
import stat
from contextlib import ExitStack, suppress
from io import BytesIO
from pathlib import Path
from typing import IO, Any

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]
HAS_LOCKS = fcntl is not None  # where it has not, a file that is open cannot be renamed or removed

IN_USE = (
    "another run is writing it, or a program has it open; if a universe in this process reads it, close that "
    "first: universe.trajectory.close()"
)
# and no waiting for what is a pipe
NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
# of file systems without locks
UNLOCKABLE = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)


def temporary(path: Path) -> Path:
    """The name of a file that is not yet whole; no other program gives such a name."""
    return path.with_name(f"{path.name}.minimd-unfinished")


def locked(path: Path, create: bool = False) -> int:
    """A descriptor of a regular file, locked: no other run can lock the file while it is open.
    Raises OSError if another run holds the lock, or it is not a regular file; a link is none."""
    return _locked(regular(path, os.O_RDWR | (os.O_CREAT if create else 0)), path)


def new_file(path: Path) -> int:
    """A descriptor of a new and empty regular file, locked. A link in its place is removed, and so is a file that a
    killed run has left.
    Raises OSError as locked, and if another run is faster."""
    with suppress(FileNotFoundError), ExitStack() as left:
        if HAS_LOCKS and not path.is_symlink():
            left.callback(os.close, locked(path))
        path.unlink()  # while it is locked, so that nobody else takes it for left
    try:
        return _locked(os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | NO_LINK, 0o666), path)
    except FileExistsError:
        raise BlockingIOError(errno.EAGAIN, IN_USE) from None


def write_whole(file: Path, content: str | bytes, overwrite: bool = True) -> None:
    """Write a file under another name, then rename it: nobody sees it half written, and a link is replaced,
    not followed.
    Raises FileExistsError if it may not replace a file, OSError with a message."""
    part = temporary(file)
    try:
        if file.exists() and not file.is_file():
            raise OSError(errno.EINVAL, "it is not a regular file")
        with open(new_file(part), "wb") as whole:
            try:
                # under the lock: no other run makes it meanwhile
                if not overwrite and file.exists():
                    raise FileExistsError(
                        f"output {str(file)!r} exists; choose another name, or delete it with overwrite=True"
                    )
                whole.write(content.encode() if isinstance(content, str) else content)
                whole.flush()
                os.fsync(whole.fileno())
                _let_go(whole)
                os.replace(part, file)
            except BaseException:
                _let_go(whole)
                part.unlink(missing_ok=True)
                raise
    except FileExistsError:
        raise
    except OSError as error:
        raise OSError(f"{str(file)!r} cannot be written: {error.strerror}") from None


def text_of(path: Path) -> str:
    """The text of a file, which may be compressed (gzip, bzip2).
    Raises OSError if it cannot be read."""
    content = path.read_bytes()
    for magic, unpacked in ((b"\x1f\x8b", gzip.decompress), (b"BZh", bz2.decompress)):
        if content.startswith(magic):
            content = unpacked(content)
    return content.decode("utf-8-sig", "replace").replace("\r\n", "\n")


def rendered(figure: Any, kind: str | None) -> bytes:
    """The contents of the file of a picture.
    figure : of Matplotlib.
    kind : its format, as png or svg."""
    content = BytesIO()
    figure.savefig(content, format=kind)
    return content.getvalue()


def write_picture(figure: Any, picture: Path) -> Path:
    """Write a figure of Matplotlib as write_whole, in the format of the suffix; return the name of the file."""
    write_whole(picture, rendered(figure, picture.suffix[1:] or None))
    return picture


def regular(path: str | Path, flags: int) -> int:
    """A descriptor of a regular file, also for open(path, opener=regular).
    Raises OSError if it is anything else:
    a link is not followed, and a pipe is not waited for."""
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.lstat(path).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return os.open(path, flags | NO_LINK, 0o666)


def _let_go(file: IO[bytes]) -> None:
    """Close a file that shall be renamed or removed, unless its lock is still needed."""
    if not HAS_LOCKS:
        file.close()


def _locked(descriptor: int, path: Path) -> int:
    try:
        if HAS_LOCKS:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not os.path.samestat(os.fstat(descriptor), os.lstat(path)):
            raise BlockingIOError
    except (BlockingIOError, FileNotFoundError):
        os.close(descriptor)
        raise BlockingIOError(errno.EAGAIN, IN_USE) from None
    except OSError as error:
        if error.errno not in UNLOCKABLE:
            os.close(descriptor)
            raise
    return descriptor


def is_locked(path: Path, otherwise: bool = True) -> bool:
    """Whether a process holds the lock of a file.
    otherwise : the answer where this cannot be found out.  Raises OSError if the file cannot be opened."""
    descriptor = os.open(path, os.O_RDONLY | NO_LINK)
    try:
        if HAS_LOCKS:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return otherwise and not HAS_LOCKS
    except OSError as error:
        return otherwise or error.errno not in UNLOCKABLE
    finally:
        os.close(descriptor)
