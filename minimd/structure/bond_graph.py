"""The bond graph: which atoms are one, two or three bonds apart."""

import numpy as np
from numpy.typing import NDArray

MAX_BONDS_APART = 3


def pairs_by_bonds_apart(bonds: NDArray[np.int64], n_atoms: int) -> list[NDArray[np.int64]]:
    """Pairs i < j whose shortest path along the bonds has one, two and three bonds.

    bonds : (B, 2) int.  Returns three (P, 2) int arrays, each sorted by (i, j). Rings and cages are no exception: the
    shortest path decides.
    """
    neighbors: list[set[int]] = [set() for _ in range(n_atoms)]
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
