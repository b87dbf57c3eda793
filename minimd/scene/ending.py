"""When a run from a scene ends early: what is kept, and how to go on."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time

from minimd.files.h5md_reader import read_file
from minimd.structure.errors import ConstraintError, NonFiniteError

CLOCK = 1.0  # s, the coarsest time stamps of a file system


@contextmanager
def kept(files: Sequence[Path], end: int) -> Iterator[None]:
    """If a run fails, add to the message which of its files were written and are kept; after Ctrl-C also the command that goes on.

    end : the step at which the run was to end.
    """
    begun = time() - CLOCK
    try:
        yield
    except (KeyboardInterrupt, NonFiniteError, ConstraintError, OSError) as error:
        written = [file for file in files if file.is_file() and file.stat().st_size and file.stat().st_mtime > begun]
        if not written:
            raise
        message = f"{_words(error)}; what was written before is kept in {', '.join(map(str, written))}"
        hint = _how_to_go_on(written, end) if isinstance(error, KeyboardInterrupt) else ""
        failure = type(error)(message + hint)
        failure.__dict__.update(error.__dict__)  # such as the crash report
        raise failure from None


@contextmanager
def nothing_written(where: str = "") -> Iterator[None]:
    """If a preparation is interrupted, add to the message that nothing was written.  where : words about what was interrupted, if needed."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"{_words(error)}{where}; nothing was written") from None


def _how_to_go_on(written: Sequence[Path], end: int) -> str:
    for file in written:
        if file.suffix.lower() == ".h5md":
            with suppress(OSError, ValueError):
                left = end - read_file(file).step
                return f"; resume with: minimd resume {file} --steps {left}" if left > 0 else ""
    return ""


def _words(error: BaseException) -> str:
    """The message of an error, without the number that errors of the operating system have."""
    if isinstance(error, OSError) and error.strerror is not None:
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return str(error) or "interrupted"
