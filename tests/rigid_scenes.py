"""Bond graphs of every shape, for tests of constraints: positions (N, 3), pairs (K, 2), masses (N,)."""

from itertools import combinations

import ase.io
import numpy as np
import scenes
from ase import Atoms
from references import scene_text

import minimd as md

VERLET = md.VelocityVerlet(0.002)
PAIRS = np.arange(64).reshape(-1, 2)  # of the dumbbells
SQUARE = np.array([[0.0, 0, 0], [1.5, 0, 0], [1.5, 1.5, 0], [0, 1.5, 0]])
RIGID_RING = scene_text("ring")


def dumbbells(constraints=None, method=VERLET):
    """A simulation of those of scenes.py, by default with its lengths kept."""
    scene = scenes.dumbbells()
    return scene._replace(constraints=scene.constraints if constraints is None else constraints).simulation(method)


def chain(n_atoms):
    k = np.arange(n_atoms)
    return np.column_stack([0.5 * np.cos(1.1 * k), 0.5 * np.sin(1.1 * k), 0.6 * k]), np.column_stack([k[:-1], k[1:]])


def ring(n_atoms):
    k = np.arange(n_atoms)
    angle = 2.0 * np.pi * k / n_atoms
    return np.column_stack([np.cos(angle), np.sin(angle), 0.2 * (-1.0) ** k]), np.column_stack([k, (k + 1) % n_atoms])


def sheet(side):
    index = np.arange(side * side).reshape(side, side)
    down, across = np.stack([index[:-1], index[1:]], axis=-1), np.stack([index[:, :-1], index[:, 1:]], axis=-1)
    x, y = np.divmod(index.ravel(), side)
    pairs = np.concatenate([down.reshape(-1, 2), across.reshape(-1, 2)])
    return np.column_stack([x, y, 0.05 * np.sin(x * y)]).astype(float), pairs


def cube():
    """Twelve edges and a diagonal on each face: rigid, and no constraint too many."""
    corners = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    edges = [(i, j) for i, j in combinations(range(8), 2) if np.abs(corners[i] - corners[j]).sum() == 1.0]
    return corners, np.array([*edges, (0, 3), (0, 5), (0, 6), (7, 1), (7, 2), (7, 4)])


def water(n_molecules, spread=3.0):
    molecule = np.array([[0.0, 0.0, 0.0], [0.8, 0.6, 0.0], [-0.8, 0.6, 0.0]])
    centers = spread * np.random.default_rng(3).normal(size=(n_molecules, 1, 3))
    pairs = np.array([[0, 1], [0, 2], [1, 2]]) + 3 * np.arange(n_molecules)[:, None, None]
    return (centers + molecule).reshape(-1, 3), pairs.reshape(-1, 2)


def diatomics(n_molecules, spread=3.0):
    rng = np.random.default_rng(4)
    arms = rng.normal(size=(n_molecules, 3))
    ends = np.stack([np.zeros_like(arms), arms / np.linalg.norm(arms, axis=1)[:, None]], axis=1)
    places = spread * rng.normal(size=(n_molecules, 1, 3)) + ends
    return places.reshape(-1, 3), np.arange(2 * n_molecules).reshape(-1, 2)


def rod():
    """Like CO₂, if its arms were unequal."""
    return np.outer([0.0, 1.16, 2.5], np.array([1.0, 2.0, -0.5]) / np.sqrt(5.25)), np.array([[2, 0], [0, 1], [1, 2]])


GRAPHS = {"diatomics": diatomics(5), "water": water(3), "triangle of three masses": water(1), "chain": chain(100)}
GRAPHS |= {"ring": ring(6), "cube": cube(), "rod": rod(), "sheet": sheet(20)}
MASSES = {name: np.random.default_rng(1).uniform(1.0, 3.0, len(graph[0])) for name, graph in GRAPHS.items()}
MASSES |= {"water": [16.0, 1.0, 1.0] * 3, "triangle of three masses": [16.0, 1.0, 2.0], "rod": [16.0, 12.0, 16.0]}
SCENES = {name: (*graph, np.array(MASSES[name])) for name, graph in GRAPHS.items()}


def described(constraints):
    """Constraints as plain values, to be compared: what is fixed, and what is kept."""
    fixed = [one.atoms.tolist() for one in constraints if isinstance(one, md.FixedAtoms)]
    kept = [one for one in constraints if isinstance(one, md.DistanceConstraints)]
    return fixed, [(one.pairs.tolist(), one.lengths.tolist(), one.tolerance, one.solver) for one in kept]


def ring_in(folder, *constraints):
    """The path of this scene; its structure, four carbon atoms, lies in files that keep constraints."""
    atoms = Atoms("C4", SQUARE, constraint=list(constraints))
    ase.io.write(folder / "ring.xyz", atoms, format="extxyz")
    ase.io.write(folder / "ring.traj", atoms)
    return folder / "scene.toml"
