"""Periodic images of pairs: the nearest one, and the one at a given distance."""

import numpy as np
from numpy.typing import NDArray

from minimd.structure.cell import Cell, minimum_image_translations
from minimd.structure.constraints import DistanceConstraints

Array = NDArray[np.float64]

MOST_IMAGES = 2**16  # images among which one length is searched for: 40 cells in each of three directions


def nearest_images(positions: Array, cell: Cell, pairs: NDArray[np.int64]) -> Array:
    """(K, 3) lattice vectors [length] that make r_j − r_i of each pair shortest."""
    translations = np.zeros((len(pairs), 3))
    if cell.is_periodic:
        first, second = np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])
        minimum_image_translations(
            positions, first, second, cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2, translations
        )
    return translations


def nearest_vectors(positions: Array, cell: Cell, pairs: NDArray[np.int64]) -> Array:
    """(K, 3) r_j − r_i of each pair, to the nearest image [length]."""
    return positions[pairs[:, 1]] - positions[pairs[:, 0]] + nearest_images(positions, cell, pairs)


def images_of_length(positions: Array, cell: Cell, pairs: NDArray[np.int64], lengths: Array) -> Array:
    """(K, 3) lattice vectors [length] for which |r_j − r_i| of each pair is closest to its length. Up to half the cell
    these are the nearest images. Raises ValueError for a length that reaches over more than MOST_IMAGES."""
    translations = nearest_images(positions, cell, pairs)
    for k in np.flatnonzero(lengths**2 >= cell.safe_distance2):
        nearest = positions[pairs[k, 1]] - positions[pairs[k, 0]] + translations[k]
        reach = np.where(cell.pbc, (lengths[k] + np.linalg.norm(nearest)) // cell.heights + 1, 0)
        n_images = np.prod(2.0 * reach + 1.0)
        if n_images > MOST_IMAGES:
            reached = f"{n_images:.1e} in a cell {cell.heights[cell.pbc].min():.3g} high"
            given = f"that of constraint {k} is {lengths[k]:g} and reaches over {reached}"
            raise ValueError(f"lengths must reach over at most {MOST_IMAGES} images of the cell; {given}: reduce it")
        steps = np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij")
        others = np.stack(steps, axis=-1).reshape(-1, 3) @ cell.lattice
        translations[k] += others[np.argmin(np.abs(np.linalg.norm(nearest + others, axis=1) - lengths[k]))]
    return translations


def lengths_of(positions: Array, cell: Cell, constraints: DistanceConstraints) -> Array:
    """(K,) [length], as given; else the present distances to the nearest image."""
    given = constraints.lengths
    return np.linalg.norm(nearest_vectors(positions, cell, constraints.pairs), axis=1) if given is None else given
