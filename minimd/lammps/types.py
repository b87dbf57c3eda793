"""The types of atoms, bonds, angles and dihedrals, which LAMMPS distinguishes by numbers from 1 on."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.engine.engine import Engine
from minimd.structure.constraints import FixedAtoms

MOST_TYPES = 500  # of atoms: LAMMPS' tables grow with their square
Style = tuple[str, str]  # of a type of groups: the style of LAMMPS, and its numbers


class AtomTypes(NamedTuple):
    """One type for each combination of species, mass, and whether an atom is held fixed.

    of_atom : (N,) type of each atom, from 0 on.  species : (T,) index of the species of a type.  masses : (T,) [mass].
        is_fixed : (T,) bool.
    """

    of_atom: NDArray[np.int64]
    species: NDArray[np.int64]
    masses: NDArray[np.float64]
    is_fixed: NDArray[np.bool_]

    @classmethod
    def of(cls, engine: Engine) -> AtomTypes:
        """The types of atoms of an engine.  Raises ValueError for more than MOST_TYPES."""
        system, fixed = engine.system, np.zeros(len(engine.system), dtype=bool)
        for one in engine.constraints:
            if isinstance(one, FixedAtoms):
                fixed[one.atoms] = True
        keys = np.column_stack([system.species_index, system.masses, fixed])
        rows, of_atom = np.unique(keys, axis=0, return_inverse=True)
        if len(rows) > MOST_TYPES:
            raise ValueError(
                f"LAMMPS distinguishes atoms by types, one for each species and mass; this scene needs {len(rows)}, "
                f"allowed are {MOST_TYPES}"
            )
        return cls(
            of_atom.reshape(-1), rows[:, 0].astype(np.int64), np.ascontiguousarray(rows[:, 1]), rows[:, 2] != 0.0
        )

    def named(self, numbers: NDArray[np.bool_]) -> str:
        """The types for which numbers is true, as text for LAMMPS' commands."""
        return " ".join(str(k + 1) for k in np.flatnonzero(numbers))


class Groups:
    """Bonds, angles or dihedrals, with their types.

    size : atoms in a group.  coefficients : of each type, style and numbers.  atoms : (G, size).  types : (G,)
        from 0 on.
    """

    def __init__(self, size: int) -> None:
        self.size, self.coefficients = size, list[Style]()
        self.atoms, self.types = np.zeros((0, size), dtype=np.int64), np.zeros(0, dtype=np.int64)

    def add(
        self, atoms: NDArray[np.int64], parameters: NDArray[np.float64], written: Callable[[list[float]], Style]
    ) -> range:
        """Add groups, with a new type for each of the different rows of parameters, and return the new types.

        atoms : (G, size).  parameters : (G, P).  written : called with P numbers, gives the coefficients of a type.
        """
        first = len(self.coefficients)
        rows, of_each = np.unique(parameters, axis=0, return_inverse=True)
        self.atoms = np.concatenate([self.atoms, atoms.reshape(-1, self.size)])
        self.types = np.concatenate([self.types, of_each.reshape(-1) + first])
        self.coefficients += map(written, rows.tolist())
        return range(first, len(self.coefficients))

    def commands(self, word: str) -> list[str]:
        """Styles and coefficients as commands.  word : bond, angle or dihedral."""
        styles = list(dict.fromkeys(style for style, _ in self.coefficients))
        if not styles:
            return []
        several = len(styles) > 1
        lines = [f"{word}_style {'hybrid ' if several else ''}{' '.join(styles)}"]
        for k, (style, numbers) in enumerate(self.coefficients, start=1):
            lines.append(f"{word}_coeff {k} {f'{style.split()[0]} ' if several else ''}{numbers}")
        return lines
