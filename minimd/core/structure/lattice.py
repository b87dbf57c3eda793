"""Perfect crystals of one kind of atom with cubic unit cells, from which many simulations start."""

from collections.abc import Sequence
from math import cbrt, prod

import numpy as np

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import MOST_ATOMS, checked_choice, checked_indices, checked_number

__all__ = ["BASES", "constant_from_density", "crystal"]
_FCC = ((0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (0.5, 0.5, 0.0))
# atoms of the cubic unit cell, in units of its edge
BASES = {"sc": _FCC[:1], "bcc": (*_FCC[:1], (0.5, 0.5, 0.5)), "fcc": _FCC}
BASES["diamond"] = _FCC + tuple((x + 0.25, y + 0.25, z + 0.25) for x, y, z in _FCC)


def crystal(lattice: str, repeat: Sequence[int], lattice_constant: float) -> tuple[Array, Array]:
    """Positions (N, 3) and the three edges of the cell (3,) of a block of cubic unit cells, both [length].

    lattice : name in BASES.
    repeat : three numbers of unit cells, each at least 1.
    lattice_constant : edge of the unit cell [length].

    Raises ValueError for an unknown lattice, a repeat that is not three positive whole numbers, too many atoms,
    or an edge that is not positive."""
    basis = BASES[checked_choice("lattice", lattice, BASES)]
    counts = checked_indices("repeat", repeat, "three numbers of unit cells")
    if counts.shape != (3,) or counts.min() < 1:
        raise ValueError(
            f"repeat must be three numbers of unit cells, each at least 1; repeat = {shown(repeat)}"
        )

    n_atoms = len(basis) * prod(counts.tolist())
    lattice_constant = checked_number("lattice_constant", lattice_constant, "positive and finite")
    if n_atoms > MOST_ATOMS:
        raise ValueError(
            f"repeat must make at most {MOST_ATOMS} atoms; repeat = {shown(repeat)} makes {n_atoms:.1e} of them"
        )

    corners = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    positions = (corners.reshape(-1, 1, 3) + np.array(basis)).reshape(-1, 3) * lattice_constant
    return positions, counts.astype(np.float64) * lattice_constant


def constant_from_density(lattice: str, density: float, mass: float = 1.0) -> float:
    """Edge a = (n m/ρ)^(1/3) of a unit cell of n atoms [length].
    density : ρ [mass/length³].
    mass : m of one atom.
    Raises ValueError for an unknown lattice, a density or a mass that is not positive."""
    n_atoms = len(BASES[checked_choice("lattice", lattice, BASES)])
    mass = checked_number("mass", mass, "positive and finite")
    density = checked_number("density", density, "positive and finite")
    return cbrt(n_atoms * mass / density)
