"""The cell in LAMMPS, a along x and b in the xy plane: positions are turned and wrapped for it, and back afterwards."""

import numpy as np

from minimd.core.structure.observables import Array
from minimd.core.structure.system import System
from minimd.core.structure.vectors import handedness, upright

IMAGES = 1024  # LAMMPS counts images with ten bits


class Box:
    """The box and the positions of a system in LAMMPS.

    Attributes
    ----------
    turn : (3, 3) rotation; a vector r of minimd is r @ turn in LAMMPS.
    edges : (3, 3) [length], lower triangle; rows are the vectors of minimd's reduced lattice, turned. If the lattice is
        left-handed, all are negated, which gives the same lattice: a reflection would turn dihedral angles around.
    low, high : (3,) bounds along the diagonal [length].  open : (3,) bool.
    positions : (N, 3) [length], turned and wrapped.

    Periodic directions begin at 0. Atoms are wrapped here and their images are remembered.
    """

    def __init__(self, system: System) -> None:
        self._cell = cell = system.cell
        hand = handedness(cell.lattice)
        self.turn, self.edges = upright(hand * cell.lattice)
        self.open = ~cell.pbc
        images = np.where(self.open, 0.0, np.floor(hand * (system.positions @ cell.inverse)))
        self._shifts = images @ (hand * cell.lattice)
        self.positions = self.turned(system.positions - self._shifts)
        self.low = np.zeros(3)
        self.high = np.diag(self.edges).copy()

    def make_room(self, length: float) -> None:
        """Set open bounds, which LAMMPS moves, at a distance from the atoms [length]: a box is thicker than cutoffs."""
        for k in np.flatnonzero(self.open):
            column = self.positions[:, k]
            self.low[k] = column.min() - length
            self.high[k] = column.max() + length

    def turned(self, vectors: Array) -> Array:
        """Vectors (N, 3) of minimd, turned as in LAMMPS."""
        return vectors @ self.turn

    def back(self, vectors: Array) -> Array:
        """Vectors (N, 3) of LAMMPS, turned back as in minimd."""
        return vectors @ self.turn.T

    def positions_back(self, unwrapped: Array, expected: Array) -> Array:
        """Unwrapped positions of LAMMPS (N, 3) [length], turned back and in the images of minimd. LAMMPS loses
        multiples of IMAGES cells; those are taken that come closest to the expected positions, (N, 3) [length]."""
        positions = self.back(unwrapped) + self._shifts
        return positions + IMAGES * np.rint(self.crossed(expected - positions) / IMAGES) @ self._cell.lattice

    def crossed(self, displacements: Array) -> Array:
        """How many cells displacements (N, 3) [length] are long, along each periodic lattice vector."""
        return np.where(self.open, 0.0, displacements @ self._cell.inverse)

    def tensors_back(self, virials: Array) -> Array:
        """Symmetric tensors of LAMMPS (N, 6), xx yy zz yz xz xy, turned back as in minimd."""
        if np.array_equal(self.turn, np.eye(3)):
            return virials
        full = virials[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
        turned = self.turn @ full @ self.turn.T
        return turned[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]

    def lines(self) -> list[str]:
        """The lines of a data file about the box."""
        bounds = zip(self.low, self.high, "xyz", strict=True)
        lines = [f"{low:.17g} {high:.17g} {axis}lo {axis}hi" for low, high, axis in bounds]
        tilts = self.edges[[1, 2, 2], [0, 0, 1]]
        return lines + ([f"{' '.join(f'{tilt:.17g}' for tilt in tilts)} xy xz yz"] if tilts.any() else [])
