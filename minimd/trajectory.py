"""Trajectory files: which writer a suffix means, and that all are closed whatever happens.

.h5md                          minimd.h5md: float64, observables, restart
.xtc .dcd .trr .ncdf           MDAnalysis' writers
.xyz .extxyz .traj             ASE's writers
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from minimd.record import Frame

if TYPE_CHECKING:
    from minimd.simulation import Simulation

MDANALYSIS_SUFFIXES = (".xtc", ".dcd", ".trr", ".ncdf")
ASE_SUFFIXES = (".xyz", ".extxyz", ".traj")


class Writer(Protocol):
    """A file that takes frames."""

    def write(self, frame: Frame) -> None:
        """Append one frame."""

    def close(self) -> None:
        """Finish the file; it is valid afterwards, however many frames it got."""


@contextmanager
def open_trajectories(
    paths: str | Path | Sequence[str | Path], simulation: "Simulation", *, store_forces: bool, overwrite: bool
) -> Iterator[list[Writer]]:
    """Writers for some files, all checked before the first is opened, all closed at the end.

    Raises
    ------
    ValueError : for a suffix that no writer knows.  FileExistsError : for a file that exists, unless overwrite.
    FileNotFoundError, PermissionError : for a folder that does not exist or cannot be written.
    """
    several = [paths] if isinstance(paths, (str, Path)) else list(paths)
    files = [checked_output(path, overwrite) for path in several]
    with ExitStack() as stack:
        writers = [_opened(file, simulation, store_forces) for file in files]
        for writer in writers:
            stack.callback(writer.close)
        yield writers


def checked_output(path: str | Path, overwrite: bool) -> Path:
    """The path, if a new file can be written there."""
    file = Path(path)
    known = (".h5md", *MDANALYSIS_SUFFIXES, *ASE_SUFFIXES)
    if file.suffix.lower() not in known:
        raise ValueError(f"the suffix of a trajectory must be one of {', '.join(known)}; the file is {str(file)!r}")
    if file.exists() and not overwrite:
        raise FileExistsError(f"output {str(file)!r} exists; choose another name, or say overwrite")
    if not file.absolute().parent.is_dir():
        raise FileNotFoundError(f"output folder {str(file.absolute().parent)!r} does not exist; make it first")
    try:
        file.open("ab").close()
    except OSError as error:
        raise PermissionError(f"output {str(file)!r} cannot be written: {error.strerror}") from None
    return file


def _opened(file: Path, simulation: "Simulation", store_forces: bool) -> Writer:
    suffix = file.suffix.lower()
    if suffix in MDANALYSIS_SUFFIXES:
        from minimd.mdanalysis import MDAnalysisWriter

        return MDAnalysisWriter(file, simulation)
    if suffix in ASE_SUFFIXES:
        from minimd.ase import ASEWriter

        return ASEWriter(file, simulation, store_forces)
    from minimd.h5md import H5MDWriter

    return H5MDWriter(file, simulation, store_forces)
