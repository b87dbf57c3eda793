"""Bond graphs of every shape, for tests of constraints: positions (N, 3), pairs (K, 2), masses (N,)."""

from itertools import combinations

import numpy as np

import minimd as md


def masses_for(n_atoms, seed=1):
    return np.random.default_rng(seed).uniform(1.0, 3.0, n_atoms)


def chain(n_atoms):
    k = np.arange(n_atoms)
    return np.column_stack([0.5 * np.cos(1.1 * k), 0.5 * np.sin(1.1 * k), 0.6 * k]), np.column_stack([k[:-1], k[1:]])


def ring(n_atoms):
    angle = 2.0 * np.pi * np.arange(n_atoms) / n_atoms
    pairs = np.column_stack([np.arange(n_atoms), (np.arange(n_atoms) + 1) % n_atoms])
    return np.column_stack([np.cos(angle), np.sin(angle), 0.2 * (-1.0) ** np.arange(n_atoms)]), pairs


def sheet(side):
    index = np.arange(side * side).reshape(side, side)
    pairs = [
        *zip(index[:-1].flat, index[1:].flat, strict=True),
        *zip(index[:, :-1].flat, index[:, 1:].flat, strict=True),
    ]
    x, y = np.divmod(np.arange(side * side), side)
    return np.column_stack([x, y, 0.05 * np.sin(x * y)]).astype(float), np.array(pairs)


def cube():
    """Twelve edges and a diagonal on each face: rigid, and no constraint too many."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
    edges = [pair for pair in combinations(range(8), 2) if np.abs(corners[pair[0]] - corners[pair[1]]).sum() == 1.0]
    return corners, np.array([*edges, (0, 3), (0, 5), (0, 6), (7, 1), (7, 2), (7, 4)])


def water(n_molecules, spread=3.0):
    molecule = np.array([[0.0, 0.0, 0.0], [0.8, 0.6, 0.0], [-0.8, 0.6, 0.0]])
    centers = spread * np.random.default_rng(3).normal(size=(n_molecules, 1, 3))
    return (centers + molecule).reshape(-1, 3), np.concatenate(
        [np.array([[0, 1], [0, 2], [1, 2]]) + 3 * m for m in range(n_molecules)]
    )


def diatomics(n_molecules, spread=3.0):
    rng = np.random.default_rng(4)
    arms = rng.normal(size=(n_molecules, 3))
    ends = np.stack([np.zeros_like(arms), arms / np.linalg.norm(arms, axis=1)[:, None]], axis=1)
    return (spread * rng.normal(size=(n_molecules, 1, 3)) + ends).reshape(-1, 3), np.arange(2 * n_molecules).reshape(
        -1, 2
    )


def rod():
    """Like CO₂, if its arms were unequal."""
    direction = np.array([1.0, 2.0, -0.5]) / np.sqrt(5.25)
    return np.outer([0.0, 1.16, 2.5], direction), np.array([[2, 0], [0, 1], [1, 2]])


SCENES = {
    "diatomics": (*diatomics(5), masses_for(10)),
    "water": (*water(3), np.tile([16.0, 1.0, 1.0], 3)),
    "triangle of three masses": (*water(1), np.array([16.0, 1.0, 2.0])),
    "chain": (*chain(100), masses_for(100)),
    "ring": (*ring(6), masses_for(6)),
    "cube": (*cube(), masses_for(8)),
    "rod": (*rod(), np.array([16.0, 12.0, 16.0])),
    "sheet": (*sheet(20), masses_for(400)),
}


def described(constraints):
    """Constraints as plain values, to be compared."""
    fixed = [one.atoms.tolist() for one in constraints if isinstance(one, md.FixedAtoms)]
    lengths = [
        (one.pairs.tolist(), one.lengths.tolist(), one.tolerance, one.solver)
        for one in constraints
        if isinstance(one, md.DistanceConstraints)
    ]
    return fixed, lengths
