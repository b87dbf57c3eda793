"""Cells as MDAnalysis holds them, by lengths and angles only; how the frames of a run are turned to fit them, and
written by MDAnalysis: .xtc .dcd .trr .ncdf .nc.

MDAnalysis places a along x and b in the xy plane. A cell in another orientation is rotated there, and all vectors of
its atoms with it. A left-handed cell would need a reflection; but −a, −b, −c span the same lattice,
have the same lengths and angles, and are right-handed.
"""

import ctypes
import os
from contextlib import suppress
from errno import ENOSPC, EOVERFLOW
from shutil import disk_usage
from typing import Any

import MDAnalysis
import numpy as np
from MDAnalysis.lib.mdamath import triclinic_box
from numpy.typing import NDArray

from minimd.core.console.quiet import quiet, warn
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import Frame
from minimd.core.files.claim import Claim
from minimd.core.files.h5md_schema import has_edges
from minimd.core.files.trajectory import Writer
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import COMBINED, Cell
from minimd.core.structure.vectors import handedness, upright

ROTATION = "rotation"  # the name in Timestep.data
SEEN = 1e-7  # a smaller rotation is lost in the rounding of float32
FARTHEST = 1.0 + 1e-9  # in lattice vectors: MDAnalysis misses nearest images that are farther away
# of writers, by format; decimals of a nanometer, one more than usual, because σ = 1 of reduced units is 0.1 nm
OPTIONS: dict[str, dict[str, Any]] = {"XTC": {"precision": 4}, "NCDF": {"velocities": True}}
# Å: whole numbers of 0.001 Å, and their differences, have 32 bits
LARGEST_XTC = 0.001 * (2**31 - 2**9)
ROOM = 2**18  # bytes that must be free besides those of a frame, for the buffers of C libraries


class Turn:
    """The rotation that turns frames of a run so that their cell is oriented as MDAnalysis expects;
    a transformation for its trajectories.

        u = MDAnalysis.Universe("melt.psf", "run.h5md", transformations=Turn(system.cell))

    positions, velocities and forces r become r @ R; ts.data["rotation"] is R, and r @ R.T turns back. Other entries of
    ts.data, such as momenta, are not changed. If the cell changes, in a run with a barostat,
    the cell of a frame is ts.data["cell"], and R is that of the frame.

    cell : of the run; its vectors must be independent.
    to_angstrom : factor for its lengths.

    Attributes
    ----------
    combination : (3, 3) int; the lattice vectors in MDAnalysis are combination @ vectors @ R. It is the unit matrix, or
        minus that for a left-handed cell; for a cell so skewed that MDAnalysis would miss nearest images,
        it gives the vectors of the reduced lattice.
    """

    def __init__(self, cell: Cell, to_angstrom: float = 1.0) -> None:
        if not has_edges(cell):
            raise ValueError(
                "only a cell with three independent vectors, periodic in some direction, can be turned; "
                f"cell = {cell!r}"
            )
        self._vectors = cell.vectors
        self._to_angstrom = to_angstrom
        self._is_reduced = finds_all_images(cell)
        basis = np.eye(3, dtype=np.int64) if self._is_reduced else cell.reduction
        self.combination = basis * int(handedness(basis @ cell.vectors))

    @property
    def is_needed(self) -> bool:
        """False if MDAnalysis takes the cell as it is."""
        turned = float(np.abs(self.of(self._vectors)[0] - np.eye(3)).max())
        return turned > SEEN or not np.array_equal(self.combination, np.eye(3))

    def of(self, vectors: Array) -> tuple[Array, NDArray[np.float32]]:
        """R (3, 3), and the lengths and angles in MDAnalysis [Å, °],
        for a frame with these lattice vectors [length]."""
        rotation, triangle = upright(self.combination @ vectors)
        return rotation, triclinic_box(*(triangle * self._to_angstrom))

    def __call__(self, ts: Any) -> Any:
        """Turn a Timestep of MDAnalysis in place, and return it."""
        rotation, ts.dimensions = self.of(ts.data.get("cell", self._vectors))
        for name in ("positions", "velocities", "forces"):
            if getattr(ts, f"has_{name}"):
                setattr(ts, name, getattr(ts, name) @ rotation)
        ts.data[ROTATION] = rotation
        return ts

    def in_words(self, what: str, way_back: str) -> str:
        """A sentence on what is done to the positions and cell of what; way_back : where R is found."""
        rotation, _ = self.of(self._vectors)
        rows = np.array2string(rotation, separator=", ", precision=6, suppress_small=True)
        rows = rows.replace("\n", "")
        reason = ""
        if not self._is_reduced:
            reason = (
                "; the cell is so skewed that MDAnalysis would miss nearest images, and is replaced by its shortest "
                "vectors"
            )
        elif self.combination[0, 0] < 0:
            reason = "; the cell is left-handed, and is given as -a, -b, -c, which repeat the same lattice"
        return (
            f"{what} is turned, because MDAnalysis holds a cell as lengths and angles, with a along x and b in the xy "
            f"plane: positions, velocities and forces are r @ R, R = {rows}, and r @ R.T turns back{way_back}{reason}"
        )


def turn_of(cell: Cell, to_angstrom: float) -> Turn | None:
    """The Turn of a cell, or None if MDAnalysis takes the cell as it is, or cannot hold it."""
    if not has_edges(cell):
        return None
    turn = Turn(cell, to_angstrom)
    return turn if turn.is_needed else None


def as_in_run(ts: Any, vectors: NDArray[Any]) -> Array:
    """Vectors (..., 3) of a frame of a universe, turned back to those of the run, in float64."""
    turned = np.asarray(vectors, dtype=np.float64)
    return turned @ ts.data[ROTATION].T if ROTATION in ts.data else turned


def cell_dimensions(cell: Cell, to_angstrom: float) -> NDArray[np.float32] | None:
    """Lengths and angles of a cell [Å, °], or None if no direction is periodic or the
    three vectors are not independent."""
    return triclinic_box(*(cell.vectors * to_angstrom)) if has_edges(cell) else None


def finds_all_images(cell: Cell) -> bool:
    """Whether MDAnalysis finds all nearest images in a cell with its vectors as given.

    MDAnalysis brings atoms into the cell, and tries −1, 0 and 1 times each vector. That is enough if no point of the
    Wigner-Seitz cell, which is nearer to 0 than to any other lattice point, has a fractional coordinate above 1 in
    magnitude: a linear program. Reduced vectors always fulfill this.
    """
    if not cell.pbc.all() or np.array_equal(np.abs(cell.reduction), np.eye(3)):
        return True
    from scipy.optimize import linprog  # takes its time to load

    neighbors = COMBINED[np.any(COMBINED != 0, axis=1)] @ cell.lattice
    halves = 0.5 * (neighbors**2).sum(axis=1)
    parts = np.linalg.inv(cell.vectors)
    return all(
        -linprog(-part, neighbors, halves, bounds=(None, None)).fun <= FARTHEST for part in parts.T
    )


class MDAnalysisWriter(Writer):
    """Frames to .xtc, .dcd, .trr or .ncdf (.nc) through MDAnalysis: float32, positions unwrapped,
    Å and ps or reduced numbers.

    A cell in an orientation that MDAnalysis does not hold is turned, with positions and velocities: see Turn.

    TRR and NCDF hold velocities; DCD and XTC, whose positions are rounded to 0.001 Å, do not. A DCD file has one time
    between all frames. Therefore a first frame between two multiples of every is left out, with a warning, if a second
    one comes.

    claim : on the file, which gets its name with its first frame.
    every : steps between frames.

    Raises OSError if the file cannot be written, or positions are beyond LARGEST_XTC in an XTC file.
    """

    def __init__(self, claim: Claim, engine: Engine, every: int = 1) -> None:
        system = engine.system
        suffix = claim.path.suffix[1:].upper()
        self.claim = claim
        self._format = "NCDF" if suffix == "NC" else suffix
        self._every = every
        self._angstrom = system.units.to_angstrom
        self._picosecond = system.units.to_picosecond
        self._timestep = engine.method.duration * self._picosecond
        self._cell = system.cell
        self._waiting: list[Frame] = []
        self._writer: Any = None

        with quiet():  # MDAnalysis warns of attributes that are missing on purpose
            self._universe = MDAnalysis.Universe.empty(
                len(system), trajectory=True, velocities=True
            )

        self._turn = turn_of(system.cell, self._angstrom)
        if self._turn is not None:
            back = "; write an .h5md file too: it holds them unturned"
            warn(self._turn.in_words(f"trajectory {claim.name!r}", back))

    def write(self, frame: Frame) -> None:
        """Append one frame."""
        self._waiting.append(
            frame._replace(positions=frame.positions.copy(), velocities=frame.velocities.copy())
        )
        if self._format != "DCD" or self._writer is not None or len(self._waiting) > 1:
            self._write_waiting()

    def close(self) -> None:
        """Finish the file; do nothing if it has failed."""
        try:
            self._write_waiting()
            self._shut()
        finally:
            self.claim.release()

    def _write_waiting(self) -> None:
        waiting = self._waiting
        self._waiting = []
        if self._format == "DCD" and len(waiting) > 1 and waiting[0].step % self._every:
            step = waiting.pop(0).step
            warn(
                f"trajectory {self.claim.name!r} leaves out the frame of step {step}: its frames are {self._every} "
                "steps apart"
            )

        for frame in waiting:
            try:
                if disk_usage(self.claim.place.parent).free < frame.positions.nbytes + ROOM:
                    # not every format notices that writing failed
                    raise OSError(ENOSPC, "no room on the disk")

                with quiet():
                    if self._writer is None:
                        self._writer = self._opened(frame)
                    self._place(frame)
                    self._check_range()
                    self._writer.write(self._universe)

                if os.name == "posix":
                    # MDAnalysis keeps buffers; a killed run leaves whole frames
                    ctypes.CDLL(None).fflush(None)
                self.claim.check()
                self.claim.appear()
            except (OSError, RuntimeError) as error:
                with suppress(OSError, RuntimeError):
                    self._shut()
                reason = getattr(error, "strerror", None) or error
                raise OSError(
                    f"trajectory {self.claim.name!r} could not take the frame of step {frame.step}: {reason}"
                ) from error

    def _opened(self, frame: Frame) -> Any:
        """MDAnalysis' writer, for a file that begins with a frame."""
        options = OPTIONS.get(self._format, {})
        if self._format == "DCD":
            options = {
                "nsavc": self._every,
                "dt": self._every * self._timestep,
                "istart": frame.step,
            }
        return MDAnalysis.Writer(
            str(self.claim.stream), n_atoms=len(frame.positions), format=self._format, **options
        )

    def _shut(self) -> None:
        writer = self._writer
        self._writer = None
        if writer:
            writer.close()

    def _check_range(self) -> None:
        """Raise OSError if positions do not fit into an XTC file."""
        reach = np.ptp(np.vstack([self._universe.atoms.positions, np.zeros(3)]), axis=0).max()
        if self._format == "XTC" and reach > LARGEST_XTC:
            raise OSError(
                EOVERFLOW,
                f".xtc holds positions, and distances, up to {LARGEST_XTC:.4g} Å; these reach {reach:.4g} Å; "
                "write .trr or .h5md",
            )

    def _place(self, frame: Frame) -> None:
        ts = self._universe.trajectory.ts
        cell = frame.cell or self._cell
        ts.positions = frame.positions * self._angstrom
        ts.velocities = frame.velocities * (self._angstrom / self._picosecond)
        if self._turn is None:
            ts.dimensions = cell_dimensions(cell, self._angstrom)
        else:
            ts.data["cell"] = cell.vectors
            self._turn(ts)
        ts.time = frame.time * self._picosecond
        ts.data["step"] = frame.step
