"""Molecules of a run: which atoms bonds join, and where these lie if no molecule is cut by the cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.constraints import joined_pairs, molecules_of
from minimd.core.structure.system import System

NEUTRAL = 1e-6  # of the largest charge: rounding of charges in files
CLOSED = 1e-6  # of a molecule that is not infinite: largest distance, in heights of the cell


class Molecules:
    """The molecules of a system: what bonds and lengths held fixed join; they are made whole bond by bond.

    label : (N,) int, the molecule of each atom, from 0 on.
    pairs : (B, 2) int, joined atoms.

    Raises ValueError for a molecule that is joined to its own image: it has no shape and no dipole.
    """

    def __init__(self, system: System) -> None:
        self.label = molecules_of(system)
        self.pairs = np.unique(np.sort(joined_pairs(system), axis=1), axis=0)
        self._ways, self._jumps = self._tree()
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

    def _tree(self) -> tuple[Indices, list[Indices]]:
        """Pairs, (P, 2), each the last bond on the way from the first atom of a molecule to another one, and (N,) int,
        atoms on this way that are 1, 2, 4, ... bonds back."""
        both_ways = np.concatenate([self.pairs, self.pairs[:, ::-1]])
        is_reached = np.zeros(len(self.label), dtype=bool)
        is_reached[np.unique(self.label, return_index=True)[1]] = True
        levels = [np.zeros((0, 2), dtype=np.int64)]
        while not is_reached.all():
            next_ones = both_ways[is_reached[both_ways[:, 0]] & ~is_reached[both_ways[:, 1]]]
            level = next_ones[np.unique(next_ones[:, 1], return_index=True)[1]]
            is_reached[level[:, 1]] = True
            levels.append(level)
        ways = np.concatenate(levels)
        back = np.arange(len(self.label))
        back[ways[:, 1]] = ways[:, 0]
        jumps = [back]
        for _ in range((len(levels) - 1).bit_length()):
            jumps.append(jumps[-1][jumps[-1]])
        return ways, jumps

    def whole(self, system: System) -> Array:
        """(N, 3) positions, with each molecule whole around its first atom [length]."""
        ways = np.zeros_like(system.positions)
        ways[self._ways[:, 1]] = nearest_vectors(system.positions, system.cell, self._ways)
        for atoms in self._jumps:  # each doubles the number of bonds that are summed
            ways += ways[atoms]
        return system.positions[self._jumps[-1]] + ways


class MoleculeKind(NamedTuple):
    """Molecules whose atoms have the same species and numbers of bonds, in the same order.

    name : its formula, with a number if there is another kind of the same formula.
    atoms : (M, n) int, of each molecule.
    ends : the places of the two ends of a linear chain among the n atoms; empty for other molecules.
    """

    name: str
    atoms: Indices
    ends: list[int]


def kinds_of(molecules: Molecules, system: System) -> list[MoleculeKind]:
    """The kinds of molecules of two atoms or more, in the order of their first atoms."""
    order = np.argsort(molecules.label, kind="stable")
    degrees = np.bincount(molecules.pairs.ravel(), minlength=len(order))
    found: dict[tuple[bytes, bytes], list[Indices]] = {}
    for atoms in np.split(order, np.cumsum(np.bincount(molecules.label))[:-1]):
        key = system.species_index[atoms].tobytes(), degrees[atoms].tobytes()
        found.setdefault(key, []).append(atoms)

    kinds: list[MoleculeKind] = []
    formulas: list[str] = []
    for members in found.values():
        first = members[0]
        if len(first) == 1:
            continue
        n_bonds = degrees[first]
        is_chain = n_bonds.max() <= 2 and n_bonds.sum() == 2 * len(first) - 2
        species = zip(*np.unique(system.species_index[first], return_counts=True), strict=True)
        parts = [f"{system.species_names[s]}{n if n > 1 else ''}" for s, n in species]
        formula = "".join(parts)
        formulas.append(formula)
        number = formulas.count(formula)
        name = formula if number == 1 else f"{formula}_{number}"
        ends = np.flatnonzero(n_bonds == 1).tolist() if is_chain else []
        kinds.append(MoleculeKind(name, np.array(members), ends))
    return kinds
