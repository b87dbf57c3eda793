"""Trajectory files: which writer a suffix means, and that all are closed whatever happens."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Protocol

from minimd.engine.engine import Engine
from minimd.engine.record import Frame
from minimd.structure.checks import shown


class Writer(Protocol):
    """A file that takes frames."""

    def write(self, frame: Frame) -> None:
        """Append one frame."""

    def close(self, completed: bool) -> None:
        """Finish the file; it is valid afterwards, however many frames it got.  completed : whether the run came to its end."""


FORMATS = {  # suffix: module and class of its writer, loaded when needed and called with file, engine and store_forces
    ".h5md": ("minimd.files.h5md_writer", "H5MDWriter"),
    **dict.fromkeys((".xtc", ".dcd", ".trr", ".ncdf", ".nc"), ("minimd.files.mdanalysis_writer", "MDAnalysisWriter")),
    **dict.fromkeys((".xyz", ".extxyz", ".traj"), ("minimd.files.ase_writer", "ASEWriter")),
}


@contextmanager
def open_trajectories(paths: str | Path | Sequence[str | Path], engine: Engine, *, store_forces: bool, overwrite: bool) -> Iterator[list[Writer]]:
    """Writers for some files, all checked before the first is opened, all closed at the end; if one cannot be opened, none is left.

    Raises ValueError for a suffix that no writer knows.  FileExistsError for a file that exists, unless overwrite. FileNotFoundError,
    PermissionError for a folder that does not exist or cannot be written.
    """
    files = [checked_output(path, overwrite) for path in named_files("trajectory", paths)]
    with ExitStack() as closing, ExitStack() as undoing:
        writers: list[Writer] = []
        for file in files:
            if not file.exists():
                undoing.callback(file.unlink, missing_ok=True)
            module, name = FORMATS[file.suffix.lower()]
            writers.append(getattr(import_module(module), name)(file, engine, store_forces))
            closing.push(partial(_close, writers[-1]))
        undoing.pop_all()
        yield writers


def named_files(name: str, paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """The paths of one file or of several.  Raises TypeError for what is no path; name is that of the argument."""
    several = [paths] if isinstance(paths, str | Path) else paths
    if not isinstance(several, list | tuple) or not all(isinstance(path, str | Path) and Path(path).name for path in several):
        raise TypeError(f"{name} must be the path of a file, or a list of paths; {name} = {shown(paths)}")
    return [Path(path) for path in several]


def _close(writer: Writer, failure: type[BaseException] | None, *_: object) -> None:
    """The exit of a context: close a writer, and tell it whether the body came to its end."""
    writer.close(completed=failure is None)


def checked_output(path: str | Path, overwrite: bool, suffixes: Collection[str] = FORMATS) -> Path:
    """The path, if a new file with one of the suffixes can be written there; nothing is left by trying.

    Raises as open_trajectories.
    """
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise ValueError(f"the suffix of a trajectory must be one of {', '.join(suffixes)}; the file is {str(file)!r}")
    if file.exists() and not overwrite:
        raise FileExistsError(f"output {str(file)!r} exists; choose another name, or pass overwrite=True")
    if not file.absolute().parent.is_dir():
        raise FileNotFoundError(f"output folder {str(file.absolute().parent)!r} does not exist; make it first")
    is_new = not file.exists()
    try:
        file.open("ab").close()
        if is_new:
            file.unlink()
    except OSError as error:
        raise PermissionError(f"output {str(file)!r} cannot be written: {error.strerror}") from None
    return file
