"""Bonds, angles and dihedrals in an ase.Atoms: one text for each atom,
as ASE's reader of LAMMPS data files stores them.

The array "bonds" has "j(type)" for atom i, "angles" has "i-k(type)" for the middle atom j, "dihedrals" has
"j-k-l(type)" for the first atom i, and so has "impropers", which ASE does not read. Several entries are joined by
commas; "_" means none. The indices are those of the atoms as they were read.
ASE copies the text unchanged when atoms are cut out, repeated or sorted.
"""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.structure.bond_graph import GROUPS

Indices = NDArray[np.int64]
FORMS = {name: re.compile("-".join([r"(\d+)"] * (size - 1)) + r"(?:\(\w+\))?") for name, size in GROUPS.items()}
PLACE = {"bonds": 0, "angles": 1, "dihedrals": 0, "impropers": 0}  # in the group, of the atom whose text names it
NONE = ("_", "")


class Joined(NamedTuple):
    """groups : bonds (B, 2), angles (A, 3), the middle atom second, dihedrals (D, 4) and impropers (I, 4),
    by these names; int, all of them.

    n_types : how many types of each there are, by these names; left out where all are of one type.
    """

    groups: dict[str, Indices]
    n_types: dict[str, int] = {}  # noqa: RUF012 - never changed

    def __bool__(self) -> bool:
        return any(map(len, self.groups.values()))

    def __str__(self) -> str:
        names = [f"{len(groups)} {name}" for name, groups in self.groups.items() if len(groups)]
        return " and ".join([*([", ".join(names[:-1])] if names[:-1] else []), *names[-1:]]) or "no bonds"


def joined_in(atoms: Any) -> Joined:
    """The groups in the arrays "bonds", "angles", "dihedrals" and "impropers" of an ase.Atoms;
    empty if it has no such arrays.

    Raises ValueError for text in another form, or if the atoms are not those that were read:
    the array "id" then does not count from 1 to N.
    """
    if not any(name in atoms.arrays for name in GROUPS):
        return Joined({name: np.zeros((0, size), np.int64) for name, size in GROUPS.items()})
    ids = atoms.arrays.get("id")
    if ids is not None and not np.array_equal(ids, np.arange(1, len(atoms) + 1)):
        raise ValueError(
            "the bonds of these atoms cannot be trusted: their array 'id' does not count from 1 to N, so atoms may "
            "have been cut out, repeated or "
            "sorted since they were read; give the bonds as bonds=[[0, 1], ...], or bonds=() for none"
        )
    found: dict[str, Indices] = {}
    n_types: dict[str, int] = {}
    for name, size in GROUPS.items():
        place = PLACE[name]
        rows = [(*others[:place], i, *others[place:]) for i, others in _entries(atoms, name, FORMS[name])]
        found[name] = np.array(rows, np.int64).reshape(-1, size)
        kinds = {kind for text in atoms.arrays.get(name, ()) for kind in re.findall(r"\((\w+)\)", str(text))}
        n_types |= {name: len(kinds)} if len(kinds) > 1 else {}
    return Joined(found, n_types)


def _entries(atoms: Any, name: str, form: re.Pattern[str]) -> list[tuple[int, tuple[int, ...]]]:
    """Each atom with the indices in its text, once for each entry."""
    found = []
    for i, text in enumerate(atoms.arrays.get(name, ())):
        for entry in () if str(text) in NONE else str(text).split(","):
            match = form.fullmatch(entry.strip())
            if match is None or max(indices := tuple(map(int, match.groups()))) >= len(atoms):
                raise ValueError(
                    f"the array {name!r} of these atoms must name atoms 0 to {len(atoms) - 1} as ASE's reader of "
                    f"LAMMPS data does; for atom {i} "
                    f"it has {str(text)!r}: give the bonds as bonds=[[0, 1], ...], or bonds=() for none"
                )
            found.append((i, indices))
    return found


def texts(groups: Mapping[str, Indices], n_atoms: int) -> dict[str, NDArray[np.str_]]:
    """The arrays "bonds", "angles", "dihedrals" and "impropers" for an ase.Atoms, without empty ones; all of type 1.
    groups : (G, n) int, by these names."""
    found = {}
    for name, members in groups.items():
        words: list[list[str]] = [[] for _ in range(n_atoms)]
        for row in members.tolist():
            atom = row.pop(PLACE[name])
            words[atom].append("-".join(map(str, row)) + "(1)")
        if len(members):
            found[name] = np.array([",".join(each) or NONE[0] for each in words])
    return found
