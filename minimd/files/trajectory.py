"""Trajectory files: the writer for each suffix, and a context that closes all files whatever happens."""

import errno
import os
import struct
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from minimd.engine.engine import Engine
from minimd.engine.record import Frame
from minimd.files.claim import Claim, locked
from minimd.observers.accumulator import Accumulator
from minimd.structure.checks import shown


class Writer(Protocol):
    """A file that takes frames."""

    claim: Claim

    def write(self, frame: Frame) -> None:
        """Append one frame."""

    def checkpoint(self) -> None:
        """Bring all frames taken so far to the disk; an H5MD file also keeps the present state as its restart."""

    def close(self) -> None:
        """Finish the file, which then is valid with any number of frames."""


FORMATS = {  # suffix: module and class of its writer, imported when needed, and the options that it takes besides claim and engine
    ".h5md": ("minimd.files.h5md_writer", "H5MDWriter", ("store_forces", "every", "observers", "n_frames", "bring_others")),
    **dict.fromkeys((".xtc", ".dcd", ".trr", ".ncdf", ".nc"), ("minimd.files.mdanalysis_writer", "MDAnalysisWriter", ())),
    **dict.fromkeys((".xyz", ".extxyz", ".traj"), ("minimd.files.ase_writer", "ASEWriter", ("store_forces",))),
}
MARK = struct.Struct("<QQ128s")  # of a file: inode, size, first bytes, in which some formats count frames; its name follows


@contextmanager
def open_trajectories(
    paths: str | Path | Sequence[str | Path],
    engine: Engine,
    *,
    store_forces: bool,
    overwrite: bool,
    append: bool = False,
    every: int = 1,
    n_steps: int | None = None,
    observers: Sequence[Accumulator] = (),
) -> Iterator[list[Writer]]:
    """Writers for several files: all are checked before the first is opened, and closed at the end; if one cannot be opened, none is left behind.

    every : steps between two frames.  n_steps : of the run, None if it is not known.
    observers : .h5md files hold their state and results; with append, those that have not looked yet go on from their state in the file.
    Raises ValueError for a suffix without a writer, a file that is named twice, is not a regular file, or cannot be appended to.
    FileExistsError for a file that exists, unless overwrite.  FileNotFoundError, PermissionError for a folder that does not exist or cannot
    be written.  OSError if another run writes the file.
    """
    several = named_files("trajectory", paths)
    _check_are_different(several)
    files = [_appendable(path) if append else checked_output(path, overwrite) for path in several]
    options: dict[str, Any] = {"store_forces": store_forces, "every": every, "observers": observers}
    options["n_frames"] = None if n_steps is None else n_steps // every + 2
    with ExitStack() as closing:
        writers: list[Writer] = []
        options["bring_others"] = partial(_brought_to_disk, writers)
        for file in sorted(files, key=lambda file: file.suffix.lower() == ".h5md"):  # last: it tells how far the others are
            writers.append(_continued(file, engine, options) if append else _new(file, engine, options, overwrite))
            closing.callback(writers[-1].close)
        try:
            yield writers
        except KeyboardInterrupt as stopped:  # also by other signals; see console.Terminated
            stopped.__dict__["kept"] = tuple(files)
            raise


def _new(file: Path, engine: Engine, options: dict[str, Any], overwrite: bool) -> Writer:
    module, name, takes = FORMATS[file.suffix.lower()]
    try:
        claim = Claim(file, overwrite=overwrite)
    except OSError as error:
        raise type(error)(f"output {str(file)!r} cannot be written: {error.strerror}") from None
    try:
        writer: Writer = getattr(import_module(module), name)(claim, engine, **{option: options[option] for option in takes})
    except BaseException:
        claim.release()
        raise
    return writer


def _continued(file: Path, engine: Engine, options: dict[str, Any]) -> Writer:
    from minimd.files.h5md_writer import H5MDWriter

    writer = H5MDWriter.append_to(file, engine, **{name: options[name] for name in ("store_forces", "every", "observers")})
    for mark in writer.marks:
        with suppress(OSError, ValueError, struct.error):  # the trajectory is not there any more, or somebody writes it
            _cut_back(writer.claim.path.parent / Path(os.fsdecode(mark[MARK.size :])).name, *MARK.unpack_from(mark))
    return writer


def _brought_to_disk(writers: Sequence[Writer], folder: Path) -> list[bytes]:
    """Bring trajectories to the disk that are not H5MD; returns, for the restart, marks of those in a folder.

    A kill may leave a part of a frame, which the usual readers refuse; a resumed run cuts off what came after the restart.
    """
    marks = []
    for one in writers:
        path = one.claim.path
        if path.suffix.lower() != ".h5md":
            one.checkpoint()
            if path.parent == folder:
                now = os.fstat(one.claim.descriptor)
                with one.claim.place.open("rb") as file:
                    marks.append(MARK.pack(now.st_ino, now.st_size, file.read(128)) + os.fsencode(path.name))
    return marks


def _cut_back(path: Path, inode: int, size: int, first: bytes) -> None:
    """Cut a trajectory to what it was at a restart, if it is still the file that the run has written."""
    if path.suffix.lower() in set(FORMATS) - {".h5md"} and not path.is_symlink():
        with open(locked(path), "r+b") as file:
            found = os.fstat(file.fileno())
            if found.st_ino == inode and found.st_size >= size:
                file.write(first[:size])
                file.truncate(size)
                if not size:  # it had no frame, and therefore no name
                    path.unlink()


def _appendable(file: Path) -> Path:
    if file.suffix.lower() != ".h5md":
        raise ValueError(f"only .h5md files can be appended to, because they hold the state from which a run goes on; the file is {str(file)!r}")
    return file


def _check_are_different(paths: Sequence[Path]) -> None:
    """Raise ValueError if two paths lead to the same file."""
    seen: dict[str, Path] = {}
    for path in paths:
        if (first := seen.setdefault(os.path.realpath(path), path)) is not path:
            raise ValueError(f"each trajectory must be a file of its own; {str(first)!r} and {str(path)!r} are the same file: name it once")


def named_files(name: str, paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """The paths of one file or several.  name : of the argument, for messages.  Raises TypeError for anything that is not a path."""
    several = [paths] if isinstance(paths, str | Path) else paths
    if not isinstance(several, list | tuple) or not all(isinstance(path, str | Path) and Path(path).name for path in several):
        raise TypeError(f"{name} must be the path of a file, or a list of paths; {name} = {shown(paths)}")
    return [Path(path) for path in several]


def first_h5md(paths: str | Path | Sequence[str | Path]) -> Path | None:
    """The first H5MD file among the trajectories of a run, or None.  Raises TypeError as named_files."""
    return next((file for file in named_files("trajectory", paths) if file.suffix.lower() == ".h5md"), None)


def checked_output(path: str | Path, overwrite: bool, suffixes: Collection[str] = FORMATS) -> Path:
    """The path, if a new file with one of the suffixes can be written there; no file is created.

    Raises as open_trajectories.
    """
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise ValueError(f"the suffix of a trajectory must be one of {', '.join(suffixes)}; the file is {str(file)!r}")
    if file.exists() and not overwrite:
        raise FileExistsError(f"output {str(file)!r} exists; choose another name, or pass overwrite=True")
    if not file.absolute().parent.is_dir():
        raise FileNotFoundError(f"output folder {str(file.absolute().parent)!r} does not exist; make it first")
    if file.exists() and not file.is_file():
        raise ValueError(f"output {str(file)!r} must be a regular file, but it is a folder or a device; choose another name")
    if not os.access(file if file.exists() else file.absolute().parent, os.W_OK):
        raise PermissionError(f"output {str(file)!r} cannot be written: {os.strerror(errno.EACCES)}")
    return file
