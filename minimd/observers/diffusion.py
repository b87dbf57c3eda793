"""Self-diffusion: the slope of a mean-square displacement, and the correction for the size of a periodic cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from minimd.structure.cell import Cell

Array = NDArray[np.float64]
XI = 2.837297  # ξ of a cubic cell
CUBIC = 1e-9  # largest relative deviation of the squares and products of lattice vectors from those of a cube


def is_cubic(cell: Cell) -> bool:
    """Whether a cell is a cube that is periodic in all directions."""
    square = cell.vectors @ cell.vectors.T
    return bool(cell.pbc.all() and np.abs(square - np.eye(3) * square[0, 0]).max() < CUBIC * square[0, 0])


def slope(times: Array, squares: Array) -> Array:
    """Slopes of straight lines through mean squares (..., T) at times (T,), each point weighted by 1/t,
    because its error grows as t."""
    weights = 1.0 / times
    weights = weights**2 / (weights**2).sum()
    t = times - weights @ times
    found: Array = (squares * (weights * t)).sum(axis=-1) / (weights * t * t).sum()
    return found


def finite_size_correction(thermal_energy: float, viscosity: float, edge: float) -> float:
    """The correction that is added to D in a cubic periodic cell to get D of an infinite system [length²/time].

        D∞ = D + ξ k_B T / (6π η L),   ξ = 2.837297

    thermal_energy : k_B T [energy].  viscosity : η [energy time/length³].  edge : L [length].
    I.-C. Yeh, G. Hummer, J. Phys. Chem. B 108, 15873 (2004); B. Dünweg, K. Kremer, J. Chem. Phys. 99, 6983 (1993).
    """
    return XI * thermal_energy / (6.0 * np.pi * viscosity * edge)
