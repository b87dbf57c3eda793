"""Groups of atoms by index: bonded pairs, and which atoms are one, two or three bonds apart."""

from collections import defaultdict

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
