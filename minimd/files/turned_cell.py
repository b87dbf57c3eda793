"""Cells as MDAnalysis holds them, by lengths and angles alone, and how the frames of a run are turned to fit.

MDAnalysis places a along x and b in the xy plane. A cell that lies otherwise, and all vectors of its atoms with it, are rotated there. A
left-handed cell would need a reflection; but −a, −b, −c span the same lattice, have the same lengths and angles, and are right-handed.
"""

from typing import Any

import numpy as np
from MDAnalysis.lib.mdamath import triclinic_box
from numpy.typing import NDArray

from minimd.files.h5md_schema import has_edges
from minimd.structure.cell import COMBINED, Cell
from minimd.structure.upright import handedness, upright

Array = NDArray[np.float64]
ROTATION = "rotation"  # the name in Timestep.data
SEEN = 1e-7  # a rotation by less is lost in the rounding of float32
FARTHEST = 1.0 + 1e-9  # in parts of a lattice vector: nearest images that lie farther away are missed by MDAnalysis


class Turn:
    """The rotation that brings frames of a run to the place where MDAnalysis expects their cell; a transformation for its trajectories.

        u = MDAnalysis.Universe("melt.psf", "run.h5md", transformations=Turn(system.cell))

    positions, velocities and forces r become r @ R; ts.data["rotation"] is R, and r @ R.T leads back. Other entries of ts.data, such as momenta,
    stay as they are. Where the cell changes, in a run with a barostat, ts.data["cell"] is taken, and R is that of each frame.

    cell : of the run; its vectors must be independent.  to_angstrom : factor for its lengths.

    Attributes
    ----------
    combination : (3, 3) int; the lattice vectors in MDAnalysis are combination @ vectors @ R. It is 1, or −1 of a left-handed cell; of a cell so
        skewed that MDAnalysis would miss nearest images, it gives the reduced lattice.
    """

    def __init__(self, cell: Cell, to_angstrom: float = 1.0) -> None:
        if not has_edges(cell):
            raise ValueError(f"only a cell with three independent vectors, periodic in some direction, can be turned; cell = {cell!r}")
        self._vectors, self._to_angstrom = cell.vectors, to_angstrom
        self._is_reduced = finds_all_images(cell)
        basis = np.eye(3, dtype=np.int64) if self._is_reduced else cell.reduction
        self.combination = basis * int(handedness(basis @ cell.vectors))

    @property
    def is_needed(self) -> bool:
        """False if MDAnalysis takes the cell as it is."""
        return not np.array_equal(self.combination, np.eye(3)) or bool(np.abs(self.of(self._vectors)[0] - np.eye(3)).max() > SEEN)

    def of(self, vectors: Array) -> tuple[Array, NDArray[np.float32]]:
        """R (3, 3), and lengths and angles in MDAnalysis [Å, °], of a frame with these lattice vectors [length]."""
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
        """What is done to positions and cell, in a sentence.  what : they belong to.  way_back : where R can be had."""
        rows = np.array2string(self.of(self._vectors)[0], separator=", ", precision=6, suppress_small=True).replace("\n", "")
        reason = ""
        if not self._is_reduced:
            reason = "; the cell is so skewed that MDAnalysis would miss nearest images, and is replaced by its shortest vectors"
        elif self.combination[0, 0] < 0:
            reason = "; the cell is left-handed, and is given as -a, -b, -c, which repeat the same lattice"
        return (
            f"{what} is turned, because MDAnalysis knows a cell by lengths and angles, with a along x and b in the xy plane: positions, velocities "
            f"and forces are r @ R, R = {rows}, and r @ R.T leads back{way_back}{reason}"
        )


def turn_of(cell: Cell, to_angstrom: float) -> Turn | None:
    """The Turn of a cell, or None if MDAnalysis takes it as it is, or cannot be told of it."""
    turn = Turn(cell, to_angstrom) if has_edges(cell) else None
    return turn if turn is not None and turn.is_needed else None


def as_in_run(ts: Any, vectors: NDArray[Any]) -> Array:
    """Vectors (..., 3) of a frame of a universe, as they are in the run, in float64."""
    return vectors @ ts.data[ROTATION].T if ROTATION in ts.data else np.asarray(vectors, dtype=np.float64)


def cell_dimensions(cell: Cell, to_angstrom: float) -> NDArray[np.float32] | None:
    """Lengths and angles of a cell [Å, °], or None where nothing repeats or three independent vectors are missing."""
    return triclinic_box(*(cell.vectors * to_angstrom)) if has_edges(cell) else None


def finds_all_images(cell: Cell) -> bool:
    """Whether MDAnalysis finds the nearest images in a cell as it is given.

    It brings atoms into the cell, and tries −1, 0 and 1 of each vector. That is enough if no point that is nearer to 0 than to all other points of
    the lattice is farther away than one lattice vector, counted in lattice vectors: a linear program. Reduced vectors always are so short.
    """
    if not cell.pbc.all() or np.array_equal(np.abs(cell.reduction), np.eye(3)):
        return True
    from scipy.optimize import linprog  # takes its time to load

    neighbors = COMBINED[np.any(COMBINED != 0, axis=1)] @ cell.lattice
    halves, parts = 0.5 * (neighbors**2).sum(axis=1), np.linalg.inv(cell.vectors)
    return all(-linprog(-part, neighbors, halves, bounds=(None, None)).fun <= FARTHEST for part in parts.T)
