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

from minimd.core.structure.arrays import Indices
from minimd.core.structure.checks import check_rows, checked_indices

MAX_BONDS_APART = 3
# of a System, and how many atoms each has
GROUPS = {"bonds": 2, "angles": 3, "dihedrals": 4, "impropers": 4}


def pairs_by_bonds_apart(bonds: Indices) -> list[Indices]:
    """Pairs i < j whose shortest path along the bonds has one, two and three bonds: three (P, 2) int arrays, each
    sorted by (i, j). Rings and cages are no exception: the shortest path decides.
    bonds : (B, 2) int."""
    # of bonded atoms alone: most scenes have none
    neighbors: defaultdict[int, set[int]] = defaultdict(set)
    for i, j in bonds.tolist():
        neighbors[i].add(j)
        neighbors[j].add(i)
    apart: list[list[tuple[int, int]]] = [[] for _ in range(MAX_BONDS_APART)]
    for i in np.unique(bonds).tolist():
        seen = {i}
        shell = {i}
        for pairs in apart:
            shell = {k for j in shell for k in neighbors[j]} - seen
            seen |= shell
            pairs.extend((i, j) for j in sorted(shell) if j > i)
    return [np.array(pairs, np.int64).reshape(-1, 2) for pairs in apart]


def connected(pairs: Indices, n_atoms: int) -> Indices:
    """(N,) the number, from 0 on, of the molecule of each atom: pairs (P, 2) connect the atoms of one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    bonded = coo_array((np.ones(len(pairs)), pairs.T), shape=(n_atoms, n_atoms))
    return np.asarray(connected_components(bonded, directed=False)[1], np.int64)


def checked_pairs(name: str, pairs: ArrayLike | None, n_atoms: int | None = None) -> Indices:
    """Pairs of atoms as a (P, 2) int array, (0, 2) if there are none.
    n_atoms : None for any number of atoms.
    Raises ValueError as checked_groups, or if a pair is given twice, in either order."""
    array = checked_groups(name, pairs, 2, n_atoms)
    ordered = np.sort(array, axis=1)
    _, first, counts = np.unique(ordered, axis=0, return_index=True, return_counts=True)
    repeated = first[counts > 1]
    if repeated.size:
        row = repeated.min()
        times = counts[first == row][0]
        raise ValueError(
            f"{name} must name each pair once; {name}[{row}] = {array[row].tolist()} is given {times} times"
        )
    return array


def among(pairs: Indices, others: Indices) -> NDArray[np.bool_]:
    """Which of the pairs, (B,) bool, are among others, in either order."""
    n_atoms = 1 + max(pairs.max(initial=0), others.max(initial=0))
    numbers = [each.min(axis=1) * n_atoms + each.max(axis=1) for each in (pairs, others)]
    return np.isin(*numbers)


def checked_groups(
    name: str, groups: ArrayLike | None, size: int, n_atoms: int | None = None
) -> Indices:
    """Groups of size different atoms as a (G, size) int array; None for none of them; see checked_pairs.
    Raises ValueError if the shape is wrong, an atom does not exist, or an atom appears twice in a group."""
    expected = f"an (n, {size}) array of atom indices"
    array = checked_indices(name, () if groups is None else groups, expected)
    if array.size == 0:
        return np.zeros((0, size), np.int64)
    if array.ndim != 2 or array.shape[1] != size:
        raise ValueError(f"{name} must be {expected}; its shape is {array.shape}")
    known = "from 0 on"
    exist = (array >= 0).all(axis=1)
    if n_atoms is not None:
        known = f"0 to {n_atoms - 1}"
        exist &= (array < n_atoms).all(axis=1)
    check_rows(name, f"groups of atoms {known}", exist, array)
    differ = (np.diff(np.sort(array, axis=1), axis=1) > 0).all(axis=1)
    check_rows(name, "groups of different atoms", differ, array)
    return array


# indices, and the type
FORMS = {
    name: re.compile("-".join([r"(\d+)"] * (size - 1)) + r"(?:\((\w+)\))?")
    for name, size in GROUPS.items()
}
# in the group, of the atom whose text names it
PLACE = {"bonds": 0, "angles": 1, "dihedrals": 0, "impropers": 0}
NONE = ("_", "")
INSTEAD = "give the bonds as bonds=[[0, 1], ...], or bonds=() for none"


class Joined(NamedTuple):
    """groups : bonds (B, 2), angles (A, 3), the middle atom second, dihedrals (D, 4), impropers (I, 4), int, by these
    names.
    n_types : how many types of each there are, by these names; left out where all are of one type."""

    groups: dict[str, Indices]
    n_types: dict[str, int] = {}  # noqa: RUF012 - never changed

    def __bool__(self) -> bool:
        return any(map(len, self.groups.values()))

    def __str__(self) -> str:
        counts = [f"{len(rows)} {name}" for name, rows in self.groups.items() if len(rows)]
        *others, last = counts or ["no bonds"]
        return f"{', '.join(others)} and {last}" if others else last


def joined_in(atoms: Any) -> Joined:
    """The groups in the arrays "bonds", "angles", "dihedrals" and "impropers" of an ase.Atoms; empty if it has no such
    arrays. Raises ValueError for text in another form, or if the atoms are not those that were read: the array "id"
    then does not count from 1 to N."""
    n = len(atoms)
    arrays = atoms.arrays
    ids = arrays.get("id", ())
    is_whole = len(ids) == 0 or np.array_equal(ids, np.arange(1, n + 1))
    if not is_whole and any(name in arrays for name in GROUPS):
        raise ValueError(
            "the bonds of these atoms cannot be trusted: their array 'id' does not count from 1 to N, so atoms may "
            f"have been cut out, repeated or sorted since they were read; {INSTEAD}"
        )

    joined: dict[str, Indices] = {}
    n_types: dict[str, int] = {}

    for name, size in GROUPS.items():
        rows = []
        kinds = set()

        for i, text in enumerate(map(str, arrays.get(name, ()))):
            entries = () if text in NONE else text.split(",")
            for entry in entries:
                match = FORMS[name].fullmatch(entry.strip())
                *numbers, kind = match.groups() if match else (n, None)
                row = [int(number) for number in numbers]
                if max(row) >= n:
                    raise ValueError(
                        f"the array {name!r} of these atoms has {text!r} for atom {i}; it must be written as "
                        "ase.io.read writes it for format='lammps-data', with indices of atoms from 0 to "
                        f"{n - 1}: {INSTEAD}"
                    )

                row.insert(PLACE[name], i)
                rows.append(row)
                kinds.add(kind)

        joined[name] = np.array(rows, np.int64).reshape(-1, size)
        kinds.discard(None)
        if len(kinds) > 1:
            n_types[name] = len(kinds)

    return Joined(joined, n_types)


def texts(groups: Mapping[str, Indices], n_atoms: int) -> dict[str, NDArray[np.str_]]:
    """The arrays "bonds", "angles", "dihedrals" and "impropers" for an ase.Atoms, without empty ones; all of type 1.
    groups : (G, n) int, by these names."""
    arrays = {}
    for name, members in groups.items():
        if not len(members):
            continue
        entries: list[list[str]] = [[] for _ in range(n_atoms)]
        for row in members.tolist():
            i = row.pop(PLACE[name])
            entries[i].append("-".join(map(str, row)) + "(1)")
        arrays[name] = np.array([",".join(each) or NONE[0] for each in entries])
    return arrays
