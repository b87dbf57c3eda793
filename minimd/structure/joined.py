"""Bonds and angles as ASE's atoms carry them: text beside each atom, as ASE's reader of LAMMPS data files leaves it.

In the array "bonds" stands "j(type)" beside atom i, in "angles" "i-k(type)" beside the middle atom j; several are joined by commas, none is "_".
The indices are those of the atoms as they were read. ASE copies the text unchanged when atoms are cut out, repeated or sorted.
"""

import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]
BOND, ANGLE = re.compile(r"(\d+)(?:\(\w+\))?"), re.compile(r"(\d+)-(\d+)(?:\(\w+\))?")
NONE = ("_", "")


class Joined(NamedTuple):
    """bonds : (B, 2) int, pairs of atoms.  angles : (A, 3) int, the middle atom second.  n_types : of bonds, 1 if they are not told apart."""

    bonds: Indices
    angles: Indices
    n_types: int = 1

    def __bool__(self) -> bool:
        return bool(len(self.bonds) or len(self.angles))

    def __str__(self) -> str:
        names = (f"{len(groups)} {name}" for groups, name in ((self.bonds, "bonds"), (self.angles, "angles")) if len(groups))
        return " and ".join(names) or "no bonds"


def joined_in(atoms: Any) -> Joined:
    """What the arrays "bonds" and "angles" of an ase.Atoms name; nothing if there are none.

    Raises ValueError for text that is not of ASE's kind, or if the atoms are not those that were read: the array "id" then does not count 1 to N.
    """
    if "bonds" not in atoms.arrays and "angles" not in atoms.arrays:
        return Joined(np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64))
    ids = atoms.arrays.get("id")
    if ids is not None and not np.array_equal(ids, np.arange(1, len(atoms) + 1)):
        raise ValueError(
            "the bonds of these atoms cannot be trusted: ids of atoms do not count from 1 to N, so that atoms may have been cut out, repeated or "
            "sorted since they were read; give the bonds as bonds=[[0, 1], ...], or bonds=() for none"
        )
    bonds = [(i, *found) for i, found in _entries(atoms, "bonds", BOND)]
    angles = [(first, i, last) for i, (first, last) in _entries(atoms, "angles", ANGLE)]
    kinds = {kind for text in atoms.arrays.get("bonds", ()) for kind in re.findall(r"\((\w+)\)", str(text))}
    return Joined(np.array(bonds, np.int64).reshape(-1, 2), np.array(angles, np.int64).reshape(-1, 3), max(1, len(kinds)))


def _entries(atoms: Any, name: str, form: re.Pattern[str]) -> list[tuple[int, tuple[int, ...]]]:
    """Each atom with the indices that stand beside it, once for each entry."""
    found = []
    for i, text in enumerate(atoms.arrays.get(name, ())):
        for entry in () if str(text) in NONE else str(text).split(","):
            match = form.fullmatch(entry.strip())
            if match is None or max(indices := tuple(map(int, match.groups()))) >= len(atoms):
                raise ValueError(
                    f"the array {name!r} of these atoms must name atoms 0 to {len(atoms) - 1} as ASE's reader of LAMMPS data does; beside atom {i} "
                    f"stands {str(text)!r}: give the bonds as bonds=[[0, 1], ...], or bonds=() for none"
                )
            found.append((i, indices))
    return found


def texts(bonds: Indices, angles: Indices, n_atoms: int) -> dict[str, NDArray[np.str_]]:
    """The arrays "bonds" and "angles" of ASE's atoms, of those that there are; all of type 1."""
    beside = {"bonds": [(i, f"{j}(1)") for i, j in bonds.tolist()], "angles": [(j, f"{i}-{k}(1)") for i, j, k in angles.tolist()]}
    found = {}
    for name, entries in beside.items():
        words: list[list[str]] = [[] for _ in range(n_atoms)]
        for atom, text in entries:
            words[atom].append(text)
        if entries:
            found[name] = np.array([",".join(each) or NONE[0] for each in words])
    return found
