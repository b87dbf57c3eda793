"""Periodic images of pairs: the nearest one, and the one at a given distance."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from minimd.structure.cell import Cell, minimum_image_translations
from minimd.structure.constraints import DistanceConstraints

Array = NDArray[np.float64]


def nearest_images(positions: Array, cell: Cell, pairs: NDArray[np.int64]) -> Array:
    """(K, 3) lattice vectors [length] that make r_j − r_i of each pair shortest."""
    translations = np.zeros((len(pairs), 3))
    if cell.is_periodic:
        first, second = np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])
        minimum_image_translations(positions, first, second, cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2, translations)
    return translations


def nearest_vectors(positions: Array, cell: Cell, pairs: NDArray[np.int64]) -> Array:
    """(K, 3) r_j − r_i of each pair, to the nearest image [length]."""
    return positions[pairs[:, 1]] - positions[pairs[:, 0]] + nearest_images(positions, cell, pairs)


def images_of_length(positions: Array, cell: Cell, pairs: NDArray[np.int64], lengths: Array) -> Array:
    """(K, 3) lattice vectors [length] for which |r_j − r_i| of each pair is closest to its length.

    Up to half the cell these are the nearest images.
    """
    translations = nearest_images(positions, cell, pairs)
    for k in np.flatnonzero(lengths**2 >= cell.safe_distance2):
        nearest = positions[pairs[k, 1]] - positions[pairs[k, 0]] + translations[k]
        reach = np.where(cell.pbc, (lengths[k] + np.linalg.norm(nearest)) // cell.heights + 1, 0).astype(int)
        others = np.array(list(product(*(range(-n, n + 1) for n in reach)))) @ cell.lattice
        translations[k] += others[np.argmin(np.abs(np.linalg.norm(nearest + others, axis=1) - lengths[k]))]
    return translations


def lengths_of(positions: Array, cell: Cell, constraints: DistanceConstraints) -> Array:
    """(K,) [length], as given; else the present distances to the nearest image."""
    given = constraints.lengths
    return np.linalg.norm(nearest_vectors(positions, cell, constraints.pairs), axis=1) if given is None else given
