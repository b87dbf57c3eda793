"""Perfect crystals of one kind of atom, in a cubic cell: where many simulations start."""

from collections.abc import Sequence
from math import cbrt, isfinite

import numpy as np
from numpy.typing import NDArray

_FCC = ((0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (0.5, 0.5, 0.0))
BASES = {  # atoms of the cubic unit cell, in units of its edge
    "sc": ((0.0, 0.0, 0.0),),
    "bcc": ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5)),
    "fcc": _FCC,
    "diamond": _FCC + tuple((x + 0.25, y + 0.25, z + 0.25) for x, y, z in _FCC),
}


def crystal(lattice: str, repeat: Sequence[int], lattice_constant: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions (N, 3) and the three edges of the cell (3,) of a block of cubic unit cells, both [length].

    lattice : name in BASES.
    repeat : three numbers of unit cells, each at least 1.
    lattice_constant : edge of the unit cell [length].

    Raises ValueError for an unknown lattice, numbers of cells that are not three positive ones, an edge that is not positive.
    """
    if lattice not in BASES:
        raise ValueError(f"lattice must be one of {', '.join(map(repr, BASES))}; lattice = {lattice!r}")
    if len(repeat) != 3 or min(repeat) < 1:
        raise ValueError(f"repeat must be three numbers of unit cells, each at least 1; repeat = {list(repeat)}")
    if not (isfinite(lattice_constant) and lattice_constant > 0.0):
        raise ValueError(f"lattice_constant must be positive and finite; lattice_constant = {lattice_constant}")
    corners = np.stack(np.meshgrid(*map(np.arange, repeat), indexing="ij"), axis=-1).reshape(-1, 1, 3)
    positions = (corners + np.array(BASES[lattice])).reshape(-1, 3) * lattice_constant
    return positions, np.array(repeat, dtype=np.float64) * lattice_constant


def constant_from_density(lattice: str, density: float, mass: float = 1.0) -> float:
    """Edge a = (n m/ρ)^(1/3) of a unit cell of n atoms [length].  density : ρ [mass/length³].  mass : m of one atom."""
    return cbrt(len(BASES[lattice]) * mass / density)
