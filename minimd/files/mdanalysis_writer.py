"""Trajectories written by MDAnalysis: .xtc .dcd .trr .ncdf .nc."""

import ctypes
import os
import warnings
from contextlib import suppress
from errno import ENOSPC
from shutil import disk_usage
from typing import Any

import MDAnalysis

from minimd.console.quiet import outside_minimd, quiet
from minimd.engine.engine import Engine
from minimd.engine.record import Frame
from minimd.files.claim import Claim
from minimd.files.turned_cell import cell_dimensions, turn_of

FORMATS = {".nc": "NCDF"}  # suffixes that are not the name of their format
XTC_DECIMALS = 4  # of a nanometer, one more than usual, because σ = 1 of reduced units is written as 0.1 nm
ROOM = 2**18  # bytes that must be free besides those of a frame, for the buffers of C libraries


class MDAnalysisWriter:
    """Frames to .xtc, .dcd, .trr or .ncdf (.nc) through MDAnalysis: float32, positions unwrapped,
    Å and ps or reduced numbers.

    A cell in an orientation that MDAnalysis does not hold is turned, with positions and velocities: see Turn.

    TRR and NCDF hold velocities; DCD and XTC, whose positions are rounded to 0.001 Å, do not. A DCD file states the
    time between frames at its beginning; therefore it is begun when the second frame comes,
    or at the end of a run with one frame.

    claim : on the file, which gets its name with its first frame.

    Raises OSError if the file cannot be written.
    """

    def __init__(self, claim: Claim, engine: Engine) -> None:
        system, file = engine.system, claim.path
        self.claim, self._format = claim, FORMATS.get(file.suffix.lower(), file.suffix[1:].upper())
        self._angstrom, self._picosecond = system.units.to_angstrom, system.units.to_picosecond
        self._timestep = engine.method.timestep * self._picosecond
        self._cell = system.cell
        self._waiting: list[Frame] = []
        self._writer: Any = None
        with quiet():  # MDAnalysis warns of attributes that are missing on purpose
            self._universe = MDAnalysis.Universe.empty(len(system), trajectory=True, velocities=True)
        self._turn = turn_of(system.cell, self._angstrom)
        if self._turn is not None:
            back = "; write an .h5md file too: it holds them unturned"
            warnings.warn(self._turn.in_words(f"trajectory {claim.name!r}", back), stacklevel=outside_minimd())

    def write(self, frame: Frame) -> None:
        """Append one frame."""
        self._waiting.append(frame._replace(positions=frame.positions.copy(), velocities=frame.velocities.copy()))
        if self._format != "DCD" or self._writer is not None or len(self._waiting) > 1:
            self._write_waiting()

    def checkpoint(self) -> None:
        """Bring all frames taken so far to the disk, except a first one in a DCD file."""
        self.claim.sync()

    def close(self) -> None:
        """Finish the file; do nothing if it has failed."""
        try:
            self._write_waiting()
            self._shut()
        finally:
            self.claim.release()

    def _write_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            try:
                if disk_usage(self.claim.place.parent).free < frame.positions.nbytes + ROOM:
                    raise OSError(ENOSPC, "no room on the disk")  # not every format notices that writing failed
                with quiet():
                    self._writer = self._writer or self._opened(waiting)
                    self._place(frame)
                    self._writer.write(self._universe)
                if os.name == "posix":
                    ctypes.CDLL(None).fflush(None)  # MDAnalysis keeps buffers; a killed run leaves whole frames
                self.claim.check()
                self.claim.appear()
            except (OSError, RuntimeError) as error:
                with suppress(OSError, RuntimeError):
                    self._shut()
                words = f"trajectory {self.claim.name!r} could not take the frame of step {frame.step}"
                raise OSError(f"{words}: {getattr(error, 'strerror', None) or error}") from error

    def _shut(self) -> None:
        writer, self._writer = self._writer, None
        if writer:
            writer.close()

    def _opened(self, waiting: list[Frame]) -> Any:
        steps = waiting[1].step - waiting[0].step if len(waiting) > 1 else 1  # between frames
        spacing = {"nsavc": steps, "dt": steps * self._timestep, "istart": waiting[0].step}
        options: dict[str, Any] = {"XTC": {"precision": XTC_DECIMALS}, "NCDF": {"velocities": True}, "DCD": spacing}
        its, n_atoms = options.get(self._format, {}), len(self._universe.atoms)
        return MDAnalysis.Writer(str(self.claim.stream), n_atoms=n_atoms, format=self._format, **its)

    def _place(self, frame: Frame) -> None:
        ts = self._universe.trajectory.ts
        ts.positions = frame.positions * self._angstrom
        ts.velocities = frame.velocities * (self._angstrom / self._picosecond)
        cell = frame.cell or self._cell
        if self._turn is None:
            ts.dimensions = cell_dimensions(cell, self._angstrom)
        else:
            ts.data["cell"] = cell.vectors
            self._turn(ts)
        ts.time, ts.data["step"] = frame.time * self._picosecond, frame.step
