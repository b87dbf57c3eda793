"""Neighbours for others to use, in ASE's form."""

import numpy as np
from numpy.typing import NDArray

from minimd.neighbors.pair_list import PairList
from minimd.system import System

QUANTITIES = "ijdDS"


def neighbor_list(quantities: str, system: System, cutoff: float) -> tuple[NDArray, ...] | NDArray:
    """Neighbours within a cutoff, each pair in both directions, sorted by the first atom.

    Parameters
    ----------
    quantities : any of the letters of ASE's neighbor_list, in any order:
        i, j : (P,) int, the two atoms;  d : (P,) distance [length];  D : (P, 3) r_j − r_i + S · cell [length];
        S : (P, 3) int, lattice vectors of system.cell to add to r_j.
    cutoff : [length], > 0 and finite.

    Raises
    ------
    ValueError : for an unknown letter or a cutoff that is not positive and finite.
    """
    if not set(quantities) <= set(QUANTITIES):
        raise ValueError(f"quantities must be letters of {QUANTITIES!r}; quantities = {quantities!r}")
    if not (np.isfinite(cutoff) and cutoff > 0.0):
        raise ValueError(f"cutoff must be positive and finite; cutoff = {cutoff}")
    found = _all_directions(system, cutoff)
    answer = tuple(found[quantity] for quantity in quantities)
    return answer if len(answer) > 1 else answer[0]


def _all_directions(system: System, cutoff: float) -> dict[str, NDArray]:
    cell, positions = system.cell, system.positions
    pair_list = PairList(len(system), cutoff, 0.0, np.zeros((0, 2), dtype=np.int64))
    pair_list.update(positions, cell)
    pairs, order = pair_list.pairs, pair_list.order
    first = np.repeat(np.arange(len(system)), np.diff(pairs.start))
    steps = (pair_list.offsets @ cell.inverse)[pairs.second] - (pair_list.offsets @ cell.inverse)[first]
    if cell.is_periodic:
        steps = steps + (pairs.translations @ cell.inverse)[pairs.image]
    shifts = np.rint(steps).astype(np.int64) @ cell.reduction
    i, j = order[first], order[pairs.second]
    i, j, shifts = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([shifts, -shifts])
    by_first = np.lexsort((*shifts.T, j, i))
    i, j, shifts = i[by_first], j[by_first], shifts[by_first]
    vectors = positions[j] - positions[i] + shifts @ cell.vectors
    return {"i": i, "j": j, "d": np.linalg.norm(vectors, axis=1), "D": vectors, "S": shifts}
