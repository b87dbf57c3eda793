"""Starts of simulations: perfect crystals of one kind of atom, with cubic unit cells or in a plane, and melts of
chains."""

from collections.abc import Sequence
from math import cbrt, prod, sqrt

import numpy as np

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import (
    MOST_ATOMS,
    checked_choice,
    checked_count,
    checked_indices,
    checked_number,
)
from minimd.core.structure.observables import SEEDS

__all__ = ["BASES", "chains", "constant_from_density", "crystal"]
_FCC = ((0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (0.5, 0.5, 0.0))
# atoms of the unit cell, in units of its edges
BASES: dict[str, tuple[tuple[float, ...], ...]] = {
    "sc": _FCC[:1],
    "bcc": (*_FCC[:1], (0.5, 0.5, 0.5)),
    "fcc": _FCC,
}
BASES["diamond"] = _FCC + tuple((x + 0.25, y + 0.25, z + 0.25) for x, y, z in _FCC)

BASES |= {"square": ((0.0, 0.0),), "triangular": ((0.0, 0.0), (0.5, 0.5))}
# edges of unit cells that are not cubes, in units of the first
EDGES = {"square": (1.0, 1.0), "triangular": (1.0, sqrt(3.0))}
CUBE = (1.0, 1.0, 1.0)


def crystal(lattice: str, repeat: Sequence[int], lattice_constant: float) -> tuple[Array, Array]:
    """Positions (N, 3) and the three edges of the cell (3,) of a block of cubic unit cells, both [length]; (N, 2) and
    (2,) of the lattices of a plane, "square" and "triangular", whose unit cell is a rectangle of two atoms.

    lattice : name in BASES.
    repeat : numbers of unit cells along each edge, each at least 1.
    lattice_constant : edge of the unit cell, of a triangular lattice the distance of neighbors [length].

    Raises ValueError for an unknown lattice, a repeat of other than positive whole numbers, too many atoms, or an edge
    that is not positive."""
    basis = BASES[checked_choice("lattice", lattice, BASES)]
    shape = np.array(EDGES.get(lattice, CUBE))
    expected = f"{'three' if len(shape) == 3 else 'two'} numbers of unit cells"
    counts = checked_indices("repeat", repeat, expected)
    if counts.shape != shape.shape or counts.min() < 1:
        raise ValueError(f"repeat must be {expected}, each at least 1; repeat = {shown(repeat)}")

    n_atoms = len(basis) * prod(counts.tolist())
    lattice_constant = checked_number("lattice_constant", lattice_constant, "positive and finite")
    if n_atoms > MOST_ATOMS:
        raise ValueError(
            f"repeat must make at most {MOST_ATOMS} atoms; repeat = {shown(repeat)} makes {n_atoms:.1e} of them"
        )

    corners = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    n = len(shape)
    edges = shape * lattice_constant
    positions = (corners.reshape(-1, 1, n) + np.array(basis)).reshape(-1, n) * edges
    return positions, counts * edges


def constant_from_density(lattice: str, density: float, mass: float = 1.0) -> float:
    """Edge a = (n m/ρ)^(1/3) of a cubic unit cell of n atoms, or (n m/ρb)^(1/2) of one of a plane, with edges a and ba
    [length].
    density : ρ [mass/length³], of a plane [mass/length²].
    mass : m of one atom.
    Raises ValueError for an unknown lattice, a density or a mass that is not positive."""
    n_atoms = len(BASES[checked_choice("lattice", lattice, BASES)])
    mass = checked_number("mass", mass, "positive and finite")
    density = checked_number("density", density, "positive and finite")
    shape = EDGES.get(lattice, CUBE)
    volume = n_atoms * mass / density / prod(shape)
    return cbrt(volume) if len(shape) == 3 else sqrt(volume)


def chains(
    n: int, beads: int, density: float, bond_length: float = 0.97, seed: int = 1
) -> tuple[Array, Array, Indices]:
    """Positions (n · beads, 3) and the three edges of a cubic cell (3,) of a melt of linear chains, both [length], and
    their bonds (B, 2): the beads of a chain follow each other.

    Each chain is a random walk that never turns back: a bead is at least bond_length away from the one before the last,
    as the cosine between two bonds is drawn evenly from −½ to 1. So

        ⟨R²⟩ = b² N [(1 + c)/(1 − c) − 2c (1 − c^N)/(N (1 − c)²)],  c = 1/4, of N bonds of length b.

    Chains overlap: call sim.minimize() first, and equilibrate. Positions are not wrapped into the cell.

    n, beads : number of chains, and of beads in each, at least 1.
    density : of beads [1/length³].
    bond_length : b [length].
    seed : int ≥ 0 of the walks, below 2¹²⁸.

    Raises ValueError for numbers out of range, and too many atoms."""
    n = checked_count("n", n)
    beads = checked_count("beads", beads)
    density = checked_number("density", density, "positive and finite")
    bond_length = checked_number("bond_length", bond_length, "positive and finite")
    rng = np.random.default_rng(checked_count("seed", seed, 0, SEEDS))
    if n * beads > MOST_ATOMS:
        raise ValueError(f"n and beads must make at most {MOST_ATOMS} atoms; they make {n * beads}")

    edge = cbrt(n * beads / density)
    steps = np.empty((n, beads, 3))
    steps[:, 0] = rng.uniform(0.0, edge, (n, 3))
    direction = _directions(rng, n)
    for k in range(1, beads):
        steps[:, k] = bond_length * direction
        cosine = rng.uniform(-0.5, 1.0, (n, 1))
        across = np.cross(direction, _directions(rng, n))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        direction = cosine * direction + np.sqrt(1.0 - cosine**2) * across
    first = np.arange(n * beads).reshape(n, beads)[:, :-1].ravel()
    bonds = np.column_stack([first, first + 1])
    return steps.cumsum(axis=1).reshape(-1, 3), np.full(3, edge), bonds


def _directions(rng: np.random.Generator, n: int) -> Array:
    """(n, 3) unit vectors, evenly distributed."""
    vectors = rng.standard_normal((n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
