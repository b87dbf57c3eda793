"""What is told when a run from a scene ends early: which files are kept, and how to go on."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time

from minimd.files.h5md_reader import read_file
from minimd.scene.document import Scene, h5md_files
from minimd.structure.console import Terminated
from minimd.structure.errors import ConstraintError, NonFiniteError, sentence

CLOCK = 1.0  # s, the coarsest time stamps of a file system


@contextmanager
def kept(scene: Scene, files: Sequence[Path] = (), end: int = 0, where: str = "") -> Iterator[None]:
    """If a run fails, add to the message which files are kept and, if it was interrupted, how to go on.

    files : of the run; none for a preparation.  end : the step at which the run was to end, for the command that goes on.
    where : words on what was interrupted, such as " of the equilibration".
    """
    begun = time() - CLOCK
    try:
        yield
    except (KeyboardInterrupt, Terminated, NonFiniteError, ConstraintError, OSError) as error:
        written = [file for file in files if file.is_file() and file.stat().st_size and file.stat().st_mtime > begun]
        interrupted = isinstance(error, (KeyboardInterrupt, Terminated))
        if not written and not interrupted:
            raise
        ending = f"; what was written before is kept in {', '.join(map(str, written))}" if written else f"{where}; nothing was written"
        if isinstance(error, Terminated):
            error.words += ending + _how_to_go_on(written, end)
            raise
        failure = type(error)(sentence(error) + ending + (_how_to_go_on(written, end) if interrupted else ""))
        failure.__dict__.update(error.__dict__)  # such as the crash report
        raise failure from None


def _how_to_go_on(written: Sequence[Path], end: int) -> str:
    for file in h5md_files(written):
        with suppress(OSError, ValueError):
            left = end - read_file(file).step
            return f"; resume with: minimd resume {file} --steps {left}" if left > 0 else ""
    return ""
