"""Starts of simulations: perfect crystals of one kind of atom, with cubic unit cells or in a plane, melts of chains,
and molecules at random."""

from collections.abc import Sequence
from math import cbrt, prod, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import GROUPS
from minimd.core.structure.checks import (
    MOST_ATOMS,
    checked_choice,
    checked_count,
    checked_indices,
    checked_number,
    checked_sizes,
)
from minimd.core.structure.constraints import DistanceConstraints, lengths_of
from minimd.core.structure.observables import SEEDS
from minimd.core.structure.system import System

__all__ = ["BASES", "chains", "constant_from_density", "crystal", "packing"]
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
# of a packing: fewest places tried at once, and how many times in a row none may be free
TRIED = 200
MOST_FAILURES = 500
ROOMY = 10.0  # places tried at once, at most, in a cube of the distance


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


def packing(
    molecules: Sequence[tuple[System, int]], edges: ArrayLike, distance: float, seed: int = 1
) -> System:
    """Copies of molecules at random places in a periodic cell, turned at random: a System at rest, in the order given.

        mixture = md.lattice.packing([(nitrogen, 200), (argon, 50)], edges=28.0, distance=2.5)

    A molecule stays where all atoms of others are at least distance away, and else is tried elsewhere. Where a liquid
    is too dense for that, take larger edges and compress, or a smaller distance and call sim.minimize(). Copies have
    masses, species, charges, bonds, angles, dihedrals, impropers and constraints of their molecule, but not its
    velocities, cell and topology. They are not mirrored, and not wrapped into the cell.

    Parameters
    ----------
    molecules : of each kind a System, whole, as it lies in space, and the number of its copies, at least 1.
    edges : of the cell, one number or three [length].
    distance : between atoms of different molecules, also through the faces of the cell [length].
    seed : int ≥ 0, below 2¹²⁸.

    Raises
    ------
    ValueError : for numbers out of range, too many atoms, molecules in a plane, of several unit systems, with fixed
        atoms or with massless sites, edges that are shorter than a molecule, and if the molecules do not fit.
    """
    if not isinstance(molecules, list | tuple):
        raise TypeError(
            f"molecules must be a list of a System and the number of its copies; got {shown(molecules)}"
        )
    for k, pair in enumerate(molecules):
        _check_copied(f"molecules[{k}]", pair, molecules[0])
    n_atoms = sum(n * len(molecule) for molecule, n in molecules)
    if not 0 < n_atoms <= MOST_ATOMS:
        raise ValueError(f"molecules must make 1 to {MOST_ATOMS} atoms; they make {n_atoms}")
    edges = checked_sizes("edges", edges, 3, "direction")
    distance = checked_number("distance", distance, "positive and finite")
    rng = np.random.default_rng(checked_count("seed", seed, 0, SEEDS))

    places = [np.zeros((0, 3))] * len(molecules)
    for k in sorted(range(len(molecules)), key=lambda k: -len(molecules[k][0])):  # large ones first
        molecule, n = molecules[k]
        shape = molecule.positions - molecule.positions.mean(axis=0)
        needed = 2.0 * np.linalg.norm(shape, axis=1).max() + distance
        where = f"edges = {shown(edges.tolist())}, distance = {distance:g}"
        if needed > edges.min():
            raise ValueError(f"edges must be at least {needed:.6g} for molecules[{k}]; {where}")
        places[k] = _placed(shape, n, edges, distance, np.concatenate(places), rng)
        n_placed = len(places[k]) // len(molecule)
        if n_placed < n:
            raise ValueError(
                f"molecules do not fit: {n_placed} of {n} copies of molecules[{k}] found a place; {where}: take larger "
                "edges and compress, or a smaller distance and minimize"
            )
    return _copies(
        [molecule for molecule, n in molecules for _ in range(n)], np.concatenate(places), edges
    )


def _check_copied(name: str, pair: Any, first: Any) -> None:
    """Raise TypeError or ValueError unless this is a molecule that can be copied beside the first one, and a number."""
    if not (isinstance(pair, tuple | list) and len(pair) == 2 and isinstance(pair[0], System)):
        raise TypeError(f"{name} must be a System and the number of its copies; got {shown(pair)}")
    molecule, n = pair
    checked_count(f"{name}[1]", n)
    units = first[0].units
    if molecule.units != units:
        raise ValueError(
            f"{name} must be in units {units.name!r}; it is in {molecule.units.name!r}"
        )
    is_free = all(isinstance(held, DistanceConstraints) for held in molecule.constraints)
    if molecule.dimensions == 2 or molecule.sites is not None or not is_free:
        raise ValueError(
            f"{name} must lie in space, without massless sites and fixed atoms; it is {molecule!r}, with sites = "
            f"{molecule.sites!r} and constraints = {shown(molecule.constraints)}"
        )


def _placed(
    shape: Array, n: int, edges: Array, distance: float, others: Array, rng: np.random.Generator
) -> Array:
    """(K m, 3) positions of copies of a molecule (m, 3); K is n, or less if no more place is found.
    others : (M, 3), atoms that are there."""
    from scipy.spatial import cKDTree  # slow to load
    from scipy.spatial.transform import Rotation

    m = len(shape)
    atoms = others
    n_left = n
    failures = 0
    while n_left and failures < MOST_FAILURES:
        room = ROOMY * edges.prod() / distance**3
        n_tried = max(TRIED, int(min(n_left, room)))
        turns = Rotation.from_quat(rng.standard_normal((n_tried, 4))).as_matrix()
        tried = rng.uniform(0.0, edges, (n_tried, 1, 3)) + shape @ turns
        tree = cKDTree(_inside(atoms, edges), boxsize=edges)
        nearest, _ = tree.query(_inside(tried, edges), distance_upper_bound=distance)
        tried = tried[np.isinf(nearest).all(axis=1)]
        # of two that are too close, the one tried first stays
        tree = cKDTree(_inside(tried.reshape(-1, 3), edges), boxsize=edges)
        pairs = np.unique(tree.query_pairs(distance, output_type="ndarray") // m, axis=0)
        stays = np.ones(len(tried), dtype=bool)
        for first, second in pairs[pairs[:, 0] < pairs[:, 1]]:
            if stays[first]:
                stays[second] = False
        new = tried[stays][:n_left]
        atoms = np.concatenate([atoms, new.reshape(-1, 3)])
        n_left -= len(new)
        failures = 0 if len(new) else failures + 1
    return atoms[len(others) :]


def _inside(positions: Array, edges: Array) -> Array:
    """Positions in the cell, each coordinate from 0 to below its edge."""
    wrapped = positions % edges
    return np.where(wrapped < edges, wrapped, 0.0)


def _copies(molecules: list[System], positions: Array, edges: Array) -> System:
    """The system of molecules whose atoms stand at positions (N, 3)."""
    starts = np.cumsum([0, *map(len, molecules)])[:-1]
    numbered = [*zip(molecules, starts, strict=True)]
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(molecule, name) for molecule in molecules])
        for name in ("masses", "charges", "species")
    }
    for name in GROUPS:
        rows[name] = np.concatenate(
            [getattr(molecule, name) + start for molecule, start in numbered]
        )
    rigid = [
        (held, held.pairs + start, lengths_of(molecule.positions, molecule.cell, held))
        for molecule, start in numbered
        for held in molecule.constraints
        if isinstance(held, DistanceConstraints)
    ]
    constraints = []
    if rigid:
        each, pairs, lengths = zip(*rigid, strict=True)
        held = DistanceConstraints(
            np.concatenate(pairs), np.concatenate(lengths), each[0].tolerance, each[0].solver
        )
        constraints.append(held)
    return System(positions, cell=edges, units=molecules[0].units, constraints=constraints, **rows)
