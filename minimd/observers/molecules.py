"""Molecules of a run: which atoms bonds join, and where these lie if no molecule is cut by the cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.words import shown
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.constraints import joined_pairs, molecules_of
from minimd.core.structure.system import System
from minimd.observers.accumulator import Array

CLOSED = 1e-6  # of a molecule that is not infinite: largest distance, in heights of the cell


class Molecules:
    """The molecules of a system: what bonds and lengths held fixed join; they are made whole bond by bond.

    label : (N,) int, the molecule of each atom, from 0 on.
    pairs : (B, 2) int, joined atoms.

    Raises ValueError for a molecule that is joined to its own image: it has no shape and no dipole.
    """

    def __init__(self, system: System) -> None:
        self.label = molecules_of(system)
        self.pairs = joined_pairs(system)
        self._levels = self._tree()
        whole = self.whole(system)
        bonds = nearest_vectors(system.positions, system.cell, self.pairs)
        gaps = np.abs(whole[self.pairs[:, 1]] - whole[self.pairs[:, 0]] - bonds).max(axis=1)
        is_open = gaps > CLOSED * system.cell.heights.min()
        if is_open.any():
            atoms = self.pairs[is_open.argmax()]
            raise ValueError(
                "molecules must be finite; bonds join one to its own image in the next cell, as that of atoms "
                f"{shown(atoms.tolist())}"
            )

    def _tree(self) -> list[NDArray[np.int64]]:
        """Pairs by their number of bonds from the first atom of the molecule, that nearer to it first."""
        both_ways = np.concatenate([self.pairs, self.pairs[:, ::-1]])
        is_reached = np.zeros(len(self.label), dtype=bool)
        is_reached[np.unique(self.label, return_index=True)[1]] = True
        levels = []

        while not is_reached.all():
            next_ones = both_ways[is_reached[both_ways[:, 0]] & ~is_reached[both_ways[:, 1]]]
            level = next_ones[np.unique(next_ones[:, 1], return_index=True)[1]]
            is_reached[level[:, 1]] = True
            levels.append(level)

        return levels

    def whole(self, system: System) -> Array:
        """(N, 3) positions, with each molecule whole around its first atom [length]."""
        positions = system.positions.copy()
        for pairs in self._levels:
            vectors = nearest_vectors(system.positions, system.cell, pairs)
            positions[pairs[:, 1]] = positions[pairs[:, 0]] + vectors
        return positions
