"""Trajectory files: the writer for each suffix, and a context that closes all files whatever happens."""

import errno
import os
import struct
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from minimd.core.console.quiet import warn
from minimd.core.console.whole_file import locked
from minimd.core.engine.engine import Engine
from minimd.core.engine.observer import StoredObserver
from minimd.core.engine.record import Frame
from minimd.core.files.claim import Claim, read_at
from minimd.core.structure.checks import checked_flag, checked_path

Paths = str | Path | Sequence[str | Path] | None


class Writer(Protocol):
    """A file that takes frames."""

    claim: Claim

    def write(self, frame: Frame) -> None:
        """Append one frame."""

    def checkpoint(self) -> None:
        """Bring all frames taken so far to the disk; an H5MD file also keeps the present state as its restart."""
        try:
            os.fsync(self.claim.descriptor)
        except OSError as error:
            raise OSError(
                error.errno,
                f"trajectory {self.claim.name!r} could not be brought to the disk: {error.strerror}",
            ) from None

    def close(self) -> None:
        """Finish the file, which then is valid with any number of frames."""


FOR_H5MD = ("store_forces", "every", "observers", "n_frames", "bring_others")
H5MD = ("minimd.core.files.h5md_writer", "H5MDWriter", FOR_H5MD)
MDANALYSIS = ("minimd.core.files.turned_cell", "MDAnalysisWriter", ("every",))
ASE = ("minimd.core.files.ase_writer", "ASEWriter", ("store_forces",))
# suffix: module and class of its writer, imported when needed, and the options that it takes besides claim and engine
FORMATS: dict[str, tuple[str, str, tuple[str, ...]]] = {
    ".h5md": H5MD,
    **dict.fromkeys((".xtc", ".dcd", ".trr", ".ncdf", ".nc"), MDANALYSIS),
    **dict.fromkeys((".xyz", ".extxyz", ".traj"), ASE),
}
N_FIRST = 128
N_LAST = 256
MARK = struct.Struct(f"<QQQ{N_FIRST}s{N_LAST}s")
"""Of a file beside an H5MD file: inode of the H5MD file; inode and size of the file, its first and its last bytes.
Its name follows."""
COUNTERS = 16  # of the first bytes a format changes when a frame is added: it counts frames there
# bytes of a place in the index of a .traj file, which may be at its end: zero until a frame is added
SLOT = 8


@contextmanager
def open_trajectories(
    paths: Paths,
    engine: Engine,
    *,
    store_forces: bool,
    overwrite: bool,
    append: bool = False,
    every: int = 1,
    n_steps: int | None = None,
    observers: Sequence[StoredObserver] = (),
) -> Iterator[list[Writer]]:
    """Writers for several files: all are checked before the first is opened, and closed at the end;
    if one cannot be opened, none is left behind.

    every : steps between two frames.
    n_steps : of the run, None if it is not known.
    observers : .h5md files hold their state and results; with append, those that have not looked yet go on from their
        state in the file.
    Raises ValueError for a suffix without a writer, a file that is named twice, is not a regular file, or cannot be
    appended to. FileExistsError for a file that exists, unless overwrite.  FileNotFoundError, PermissionError for a
    folder that does not exist or cannot be written.  OSError if another run writes the file.
    """
    files = named_files("trajectory", paths)
    known: dict[str, Path] = {}

    for path in files:
        place = os.path.realpath(path)
        if place in known:
            raise ValueError(
                f"each trajectory must be a file of its own; {str(known[place])!r} and {str(path)!r} are the same "
                "file: name it once"
            )

        known[place] = path

    for path in files:
        if not append:
            checked_output(path, overwrite)
        elif not _is_h5md(path):
            raise ValueError(
                "only .h5md files can be appended to, because they hold the state from which a run goes on; "
                f"the file is {str(path)!r}"
            )

    writers: list[Writer] = []
    options = {
        "store_forces": store_forces,
        "every": every,
        "observers": observers,
        "n_frames": None if n_steps is None else n_steps // every + 2,
        "bring_others": partial(_brought_to_disk, writers),
    }

    with ExitStack() as closing:
        for file in sorted(files, key=_is_h5md):  # last: it tells how far the others are
            if append:
                from minimd.core.files.h5md_writer import H5MDWriter

                writer: Writer = H5MDWriter.append_to(file, engine, store_forces, every, observers)
            else:
                writer = _new_writer(file, engine, options, overwrite)

            writers.append(writer)
            closing.callback(writer.close)
            if append:
                _cut_others_back(writer)
        try:
            yield writers
        except KeyboardInterrupt as stopped:  # also by other signals; see console.Terminated
            stopped.__dict__["kept"] = tuple(files)
            raise


def _new_writer(file: Path, engine: Engine, options: dict[str, Any], overwrite: bool) -> Writer:
    module, name, keywords = FORMATS[file.suffix.lower()]
    claim = claimed(file, overwrite)
    try:
        make: Callable[..., Writer] = getattr(import_module(module), name)
        return make(claim, engine, **{keyword: options[keyword] for keyword in keywords})
    except BaseException:
        claim.release()
        raise


def claimed(file: Path, overwrite: bool) -> Claim:
    """A claim on a new file.
    Raises OSError as Claim, with the name of the file."""
    try:
        return Claim(file, overwrite=overwrite)
    except OSError as error:
        raise type(error)(f"output {str(file)!r} cannot be written: {error.strerror}") from None


def _brought_to_disk(writers: list[Writer], claim: Claim) -> list[bytes]:
    """Bring trajectories to the disk that are not H5MD; returns marks of those beside the claimed H5MD file,
    for its restart.

    A kill may leave a part of a frame, which the usual readers refuse; a resumed run cuts off what came after the
    restart.

    Raises OSError for a trajectory that cannot be brought to the disk; it is not tried again.
    """
    marks = []
    own = os.fstat(claim.descriptor).st_ino

    for writer in [writer for writer in writers if not _is_h5md(writer.claim.path)]:
        path = writer.claim.path
        file = writer.claim.descriptor
        try:
            writer.checkpoint()
        except OSError:
            writers.remove(writer)
            raise

        if path.parent == claim.path.parent:
            now = os.fstat(file)
            first = read_at(file, N_FIRST, 0)
            last = read_at(file, *_last_bytes(now.st_size))
            mark = MARK.pack(own, now.st_ino, now.st_size, first, last)
            marks.append(mark + os.fsencode(path.name))

    return marks


def _cut_others_back(writer: Any) -> None:
    """Cut the other trajectories of a continued H5MD file to what they were at its restart; warns of what was cut,
    and what could not be."""
    outcomes = []
    are_of_one_file = len({mark[:SLOT] for mark in writer.marks}) == 1  # not guesses

    for mark in writer.marks if are_of_one_file else ():
        path = writer.claim.path.parent / Path(os.fsdecode(mark[MARK.size :])).name
        try:
            outcome = _cut_back(path, writer.claim.descriptor, *MARK.unpack_from(mark))
        except FileNotFoundError:
            continue
        except (OSError, ValueError, struct.error) as error:
            reason = getattr(error, "strerror", None) or error
            outcome = (
                "is left as it is, and may hold frames later than the state from which the run goes on: "
                f"{reason}"
            )

        if outcome:
            outcomes.append(f"trajectory {str(path)!r} {outcome}")

    for outcome in outcomes:
        warn(outcome)


def _cut_back(
    path: Path, h5md: int, own: int, inode: int, size: int, first: bytes, last: bytes
) -> str:
    """Cut a trajectory to what it was at a restart; returns what was done, in words, empty if it has not grown since.

    h5md : descriptor of the file with the restart.
    own, inode, size, first, last : as in MARK.
    Raises OSError, ValueError unless it is certain that the run has written both files: whoever wrote the .h5md file
    may have meant another file of the user.
    """
    suffix = path.suffix.lower()
    if suffix not in set(FORMATS) - {".h5md"}:
        raise ValueError("its suffix is not that of a trajectory")

    with open(locked(path), "r+b") as file:
        descriptor = file.fileno()
        now = os.fstat(descriptor)
        restart = os.fstat(h5md)
        user = os.geteuid() if hasattr(os, "geteuid") else now.st_uid
        if not now.st_uid == restart.st_uid == user:
            raise ValueError("this trajectory, or the .h5md file, belongs to another user")
        if not (_has_inode(now, inode) and _has_inode(restart, own)) or now.st_size < size:
            raise ValueError("this trajectory, or the .h5md file, is a copy or was changed")
        if now.st_size == size and read_at(descriptor, N_FIRST, 0) == first[:size]:
            return ""
        is_long = size >= N_FIRST + N_LAST
        if not (is_long and _has_grown(descriptor, suffix, now.st_size, size, first, last)):
            raise ValueError(
                "this trajectory was changed, or had too few bytes to tell whether the run has written it"
            )

        file.write(first)
        file.truncate(size)

    return f"was cut to {size} bytes, its size at the step from which the run goes on"


def _has_inode(file: os.stat_result, inode: int) -> bool:
    """Asked by name: the recorder of the tests answers for files that it has made again."""
    return file.st_ino == inode


def _has_grown(file: int, suffix: str, n_bytes: int, size: int, first: bytes, last: bytes) -> bool:
    """Whether a file of n_bytes bytes begins with one of size bytes, whose first and last bytes are known, but for what
    its format changes when frames are added; a power failure may have taken the frames themselves."""
    n_changed = sum(was != now for was, now in zip(first, read_at(file, N_FIRST, 0), strict=True))
    n, begin = _last_bytes(size)
    padding = bytes(-n % SLOT)
    was = np.frombuffer(last[:n] + padding, "<u8")
    now = np.frombuffer(read_at(file, n, begin) + padding, "<u8")
    names_later_frame = (suffix == ".traj") & (was == 0) & (now >= size) & (now < n_bytes + size)
    return n_changed <= COUNTERS and bool(((was == now) | names_later_frame).all())


def _last_bytes(size: int) -> tuple[int, int]:
    """Number and place of the last bytes of a file that a mark holds; none of them is among the first,
    and slots are whole."""
    begin = max(N_FIRST, size - N_LAST)
    begin += -begin % SLOT
    return max(0, size - begin), begin


def _is_h5md(file: Path) -> bool:
    return file.suffix.lower() == ".h5md"


def named_files(name: str, paths: Paths) -> list[Path]:
    """The paths of one file or several, none for None.
    name : of the argument, for messages.
    Raises ValueError for anything that is not a path."""
    several = paths if isinstance(paths, list | tuple) else [paths]
    return [checked_path(name, path) for path in several if paths is not None]


def first_h5md(paths: Paths) -> Path | None:
    """The first H5MD file among the trajectories of a run, or None.
    Raises ValueError as named_files."""
    return next((file for file in named_files("trajectory", paths) if _is_h5md(file)), None)


def checked_output(path: str | Path, overwrite: bool, suffixes: Collection[str] = FORMATS) -> Path:
    """The path, if a new file with one of the suffixes can be written there; no file is created.
    Raises as open_trajectories."""
    file = checked_path("output", path)
    overwrite = checked_flag("overwrite", overwrite)
    if file.suffix.lower() not in suffixes:
        remark = "; docs/formats.md says how other formats are made from an .h5md file"
        raise ValueError(
            f"the suffix of a trajectory must be one of {', '.join(suffixes)}; the file is {str(file)!r}"
            f"{remark * (suffixes is FORMATS)}"
        )

    folder = file.absolute().parent
    is_there = file.exists()
    if is_there and not overwrite:
        raise FileExistsError(
            f"output {str(file)!r} exists; choose another name, or delete it with overwrite=True"
        )

    if not folder.is_dir():
        raise FileNotFoundError(f"output folder {str(folder)!r} does not exist; make it first")
    if is_there and not file.is_file():
        raise ValueError(
            f"output {str(file)!r} must be a regular file, but it is a folder or a device; choose another name"
        )

    if not os.access(file if is_there else folder, os.W_OK):
        raise PermissionError(
            f"output {str(file)!r} cannot be written: {os.strerror(errno.EACCES)}"
        )

    return file
