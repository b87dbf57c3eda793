"""Groups of atoms by index: bonded pairs, and which atoms are one, two or three bonds apart.

The texts in an ase.Atoms that name them are those of ASE's reader of LAMMPS data, one for each atom. The array "bonds"
has "j(type)" for atom i, "angles" has "i-k(type)" for the middle atom j, "dihedrals" has "j-k-l(type)" for the first
atom i, and so has "impropers", which ASE does not read. Several entries are joined by commas; "_" means none. The
indices are those of the atoms as they were read. ASE copies the text unchanged when atoms are cut out, repeated or
sorted.
"""

import re
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.structure.checks import checked_indices

MAX_BONDS_APART = 3
GROUPS = {"bonds": 2, "angles": 3, "dihedrals": 4, "impropers": 4}  # of a System, and how many atoms each has


def pairs_by_bonds_apart(bonds: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Pairs i < j whose shortest path along the bonds has one, two and three bonds.

    bonds : (B, 2) int.  Returns three (P, 2) int arrays, each sorted by (i, j). Rings and cages are no exception: the
    shortest path decides.
    """
    neighbors: defaultdict[int, set[int]] = defaultdict(set)  # of bonded atoms alone: most scenes have none
    for i, j in bonds.tolist():
        neighbors[i].add(j)
        neighbors[j].add(i)
    found: list[list[tuple[int, int]]] = [[] for _ in range(MAX_BONDS_APART)]
    for i in np.unique(bonds).tolist():
        seen, shell = {i}, {i}
        for pairs in found:
            shell = {k for j in shell for k in neighbors[j]} - seen
            seen |= shell
            pairs.extend((i, j) for j in sorted(shell) if j > i)
    return [np.array(pairs, dtype=np.int64).reshape(-1, 2) for pairs in found]


def checked_pairs(name: str, pairs: ArrayLike, n_atoms: int | None = None) -> NDArray[np.int64]:
    """Pairs of atoms as a (P, 2) int array, (0, 2) if there are none.  n_atoms : None for any number of atoms.

    Raises ValueError if the shape is wrong, an atom does not exist or is paired with itself, or a pair is given twice,
    in either order.
    """
    array = checked_groups(name, pairs, 2, n_atoms)
    _, first, counts = np.unique(np.sort(array, axis=1), axis=0, return_index=True, return_counts=True)
    if (counts > 1).any():
        # the one that is given first, as it is given
        row, times = min(zip(first[counts > 1].tolist(), counts[counts > 1].tolist(), strict=True))
        raise ValueError(
            f"{name} must name each pair once; {name}[{row}] = {array[row].tolist()} is given {times} times"
        )
    return array


def among(pairs: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the pairs, (B,) bool, are among others, in either order."""
    n_atoms = 1 + max(pairs.max(initial=0), others.max(initial=0))
    names, known = (each.min(axis=1) * n_atoms + each.max(axis=1) for each in (pairs, others))
    return np.isin(names, known)


def checked_groups(name: str, groups: ArrayLike, size: int, n_atoms: int | None = None) -> NDArray[np.int64]:
    """Groups of size different atoms as a (G, size) int array; see checked_pairs.
    Raises ValueError if the shape is wrong, an atom does not exist, or an atom appears twice in a group."""
    array = checked_indices(name, groups, f"an (n, {size}) array of atom indices")
    if array.size == 0:
        return np.zeros((0, size), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != size:
        raise ValueError(f"{name} must be an (n, {size}) array of atom indices; its shape is {array.shape}")
    ordered = np.sort(array, axis=1)
    missing = (ordered[:, 0] < 0) | (ordered[:, -1] >= (np.inf if n_atoms is None else n_atoms))
    repeated = (np.diff(ordered, axis=1) == 0).any(axis=1)
    for wrong, demand in (
        (missing, f"atoms {'from 0 on' if n_atoms is None else f'0 to {n_atoms - 1}'}"),
        (repeated, "different atoms"),
    ):
        if wrong.any():
            raise ValueError(
                f"{name} must name {demand}; {name}[{np.argmax(wrong)}] = {array[np.argmax(wrong)].tolist()}"
            )
    return array


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
