"""Self-diffusion: the slope of a mean-square displacement, and what the size of a periodic cell takes from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from minimd.structure.cell import Cell

Array = NDArray[np.float64]
XI = 2.837297  # ξ of a cubic cell
CUBIC = 1e-9  # of the edges, by which those of a cube may differ


def is_cubic(cell: Cell) -> bool:
    """Whether a cell is a cube that is periodic in all directions."""
    square = cell.vectors @ cell.vectors.T
    return bool(cell.pbc.all() and np.abs(square - np.eye(3) * square[0, 0]).max() < CUBIC * square[0, 0])


def slope(times: Array, squares: Array) -> Array:
    """Slopes of straight lines through mean squares (..., T) at times (T,), each weighted by 1/t: its error grows as t."""
    weights = 1.0 / times
    weights = weights**2 / (weights**2).sum()
    t = times - weights @ times
    found: Array = (squares * (weights * t)).sum(axis=-1) / (weights * t * t).sum()
    return found


def finite_size_correction(thermal_energy: float, viscosity: float, edge: float) -> float:
    """What must be added to D of a cubic periodic cell to have that of an infinite one [length²/time].

        D∞ = D + ξ k_B T / (6π η L),   ξ = 2.837297

    thermal_energy : k_B T [energy].  viscosity : η [energy time/length³].  edge : L [length].
    I.-C. Yeh, G. Hummer, J. Phys. Chem. B 108, 15873 (2004); B. Dünweg, K. Kremer, J. Chem. Phys. 99, 6983 (1993).
    """
    return XI * thermal_energy / (6.0 * np.pi * viscosity * edge)
