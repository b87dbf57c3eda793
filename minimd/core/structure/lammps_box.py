"""The cell in LAMMPS, a along x and b in the xy plane: positions are turned and wrapped for it, and back afterwards."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.structure.arrays import Array
from minimd.core.structure.bond_graph import GROUPS
from minimd.core.structure.cell import Cell
from minimd.core.structure.vectors import handedness, upright

Columns = Sequence[NDArray[Any]]
FORMS = {"i": "%d", "f": "%.17g", "U": "%s"}  # by the letters of NumPy


class Box:
    """The box and the positions of a system in LAMMPS.

    Parameters
    ----------
    cell : Cell.
    positions : (N, 3) [length].
    lattice : (3, 3) [length], rows that span the lattice of the cell, as cell.lattice, which is taken if it is not
        given; the row of an open direction is perpendicular to the others.

    Attributes
    ----------
    turn : (3, 3) rotation; a vector r of minimd is r @ turn in LAMMPS.
    edges : (3, 3) [length], lower triangle; rows are the vectors of the lattice, turned. If the lattice is
        left-handed, all are negated, which gives the same lattice: a reflection would turn dihedral angles around.
    low, high : (3,) bounds along the diagonal [length].
    open : (3,) bool.
    is_plane : whether atoms lie in z = 0, in the middle of a box of height 1.
    positions : (N, 3) [length], turned and wrapped.
    images : (N, 3) int, in cells, from which they were wrapped.
    most_images : LAMMPS counts images with ten bits.

    Periodic directions begin at 0. Atoms are wrapped here and their images are remembered.
    """

    most_images = 1024

    def __init__(self, cell: Cell, positions: Array, lattice: Array | None = None) -> None:
        self._cell = cell
        lattice = cell.lattice if lattice is None else lattice
        hand = handedness(lattice)
        self.turn, self.edges = upright(hand * lattice)
        self.open = ~cell.pbc
        self.is_plane = cell.dimensions == 2
        cells = np.floor(hand * (positions @ np.linalg.inv(lattice)))
        self.images = np.where(self.open, 0.0, cells).astype(np.int64)
        self._shifts = self.images @ (hand * lattice)
        self.positions = self.turned(positions - self._shifts)
        self.low = np.zeros(3)
        self.high = np.diag(self.edges).copy()
        if self.is_plane:
            self.low[2] = -0.5
            self.high[2] = 0.5

    @property
    def boundary(self) -> str:
        """The letters of LAMMPS' command: p for periodic, as the third direction of a plane must be there; m for an
        open boundary that follows the atoms but keeps a smallest extent."""
        letters = ["m" if is_open else "p" for is_open in self.open]
        return " ".join([*letters[:2], "p"] if self.is_plane else letters)

    def make_room(self, length: float) -> None:
        """Set open bounds, which LAMMPS moves, at a distance from the atoms [length]: a box is thicker than cutoffs."""
        for k in np.flatnonzero(self.open[:2] if self.is_plane else self.open):
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
        multiples of most_images cells; those are taken that come closest to the expected positions, (N, 3) [length]."""
        positions = self.back(unwrapped) + self._shifts
        crossed = self.crossed(expected - positions)
        lost = self.most_images * np.rint(crossed / self.most_images)
        return positions + lost @ self._cell.lattice

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

    def data_file(self, title: str, sections: Mapping[str, Columns]) -> Iterator[str]:
        """The lines of a data file: a title, the header, and sections by their name. A line of a section is its number,
        from 1 on, and the entries of its columns, (n,) or (n, k). Those of bonds, angles, ... begin with the types."""
        yield f"{title}\n\n{len(self.positions)} atoms\n{len(sections['Masses'][0])} atom types\n"

        for name in GROUPS:
            types = sections.get(name.capitalize(), [np.zeros(0)])[0]
            if types.size:
                yield f"{types.size} {name}\n{types.max()} {name[:-1]} types\n"

        for k, axis in enumerate("xyz"):
            yield f"{self.low[k]:.17g} {self.high[k]:.17g} {axis}lo {axis}hi\n"
        tilts = self.edges[[1, 2, 2], [0, 0, 1]]
        if tilts.any():
            yield "{:.17g} {:.17g} {:.17g} xy xz yz\n".format(*tilts)

        for name, columns in sections.items():
            table = [entries for column in columns for entries in np.atleast_2d(column.T)]
            forms = [FORMS[entries.dtype.kind] for entries in table]
            line = f"%d {' '.join(forms)}\n"
            if table[0].size:
                yield f"\n{name}\n\n"
            for row in zip(count(1), *table, strict=False):
                yield line % row
