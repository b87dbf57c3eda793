"""Slow obvious twins of the fast code, and loaders of reference data."""

import itertools
import json
import tomllib
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

import minimd as md

DATA = Path(__file__).parent / "data"


def load(name):
    text = (DATA / name).read_text(encoding="utf-8")
    return tomllib.loads(text) if name.endswith(".toml") else json.loads(text)


def brute_force_pairs(positions, cell, pbc, cutoff):
    """All (i, j, S) with |r_j − r_i + S · cell| < cutoff, both directions, by trying every image that could matter."""
    pbc, cell = np.asarray(pbc, dtype=bool), np.asarray(cell, dtype=float)
    reciprocal = np.zeros((3, 3))
    if pbc.any():
        reciprocal[:, pbc] = np.linalg.pinv(cell[pbc])
    home = np.floor(positions @ reciprocal).astype(int)
    wrapped = positions - home @ cell
    vectors = wrapped[None, :, :] - wrapped[:, None, :]
    reach = np.where(pbc, np.ceil(cutoff * np.linalg.norm(reciprocal, axis=0)) + 1, 0).astype(int)
    found = set()
    for shift in itertools.product(*(range(-r, r + 1) for r in reach)):
        for i, j in np.argwhere(np.linalg.norm(vectors + np.array(shift) @ cell, axis=-1) < cutoff):
            if i != j or shift != (0, 0, 0):
                found.add((int(i), int(j), *(int(s) for s in shift - home[j] + home[i])))
    return found


def processes(n_series, length, decay, rng):
    """(length, n_series) of unit variance and correlation decayⁿ."""
    noise = np.sqrt(1.0 - decay**2) * rng.normal(size=(length + 8 * int(1.0 / (1.0 - decay)), n_series))
    return lfilter([1.0], [1.0, -decay], noise, axis=0)[-length:]


def liquid(n_cells=4, density=0.8442, temperature=1.44, seed=1, jitter=0.05):
    """A disordered fcc lattice in reduced units with thermal velocities."""
    a = (4.0 / density) ** (1.0 / 3.0)
    corners = np.array(list(itertools.product(range(n_cells), repeat=3)), dtype=float)
    basis = np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]])
    positions = a * (corners[:, None, :] + basis).reshape(-1, 3)
    rng = np.random.default_rng(seed)
    system = md.System(positions + jitter * rng.standard_normal(positions.shape), cell=a * n_cells)
    return warm(system, temperature, seed=seed)


def warm(system, temperature, constraints=(), seed=1):
    """The system with thermal velocities, its momentum zero."""
    simulation = md.Simulation(system, md.LennardJones(1.0, 1.0, 0.1), md.VelocityVerlet(0.001), constraints, threads=1)
    simulation.set_temperature(temperature, seed=seed)
    return simulation.system


def melt():
    """The 4000-atom melt with LAMMPS' own starting velocities."""
    start = np.load(DATA / "lammps_lj" / "melt4000_start.npz")
    return md.System(start["x"], velocities=start["v"], cell=start["box"])


def fourmol(masses=None):
    """The 29-atom system: LAMMPS' types as species, bonds from the table; (System, table)."""
    table = load("lammps_fourmol/system.json")
    if masses is None:
        masses = np.array(table["masses_by_type"])[np.array(table["type"]) - 1]
    cell, bonds = np.array(table["box_hi"]) - np.array(table["box_lo"]), np.array(table["bonds"])[:, 1:] - 1
    given = {"velocities": table["v"], "masses": masses, "species": table["type"]}
    return md.System(table["x"], cell=cell, bonds=bonds, **given), table


def scene_text(name):
    return (DATA / "scenes" / f"{name}.toml").read_text(encoding="utf-8")


def melt_scene(n_cells, steps, more=""):
    """The text of a scene file: a small Lennard-Jones melt, and lines to add to its [dynamics] and behind."""
    text = scene_text("melt").replace("[4, 4, 4]", str([n_cells] * 3))
    return text.replace("steps = 20", f"steps = {steps}") + more


def pressures_in_layers(run):
    """Each pair cut at the planes between layers, along z."""
    n, edges = 100, run.edges
    sums = np.zeros((2, n))
    planes = np.arange(-n, 2 * n + 1) * edges[2] / n

    def force(r):
        return 24.0 * (2.0 * r**-13.0 - r**-7.0)

    first, second = np.triu_indices(len(run.species), 1)
    for positions, velocities in zip(run.positions, run.thermal, strict=True):
        squares = run.masses[:, None] * velocities**2
        places = np.floor(positions[:, 2] / edges[2] * n).astype(int) % n
        np.add.at(sums[0], places, squares[:, 2])
        np.add.at(sums[1], places, 0.5 * squares[:, :2].sum(axis=1))
        r = positions[second] - positions[first]
        r -= edges * np.rint(r / edges)
        is_near = np.linalg.norm(r, axis=1) < 1.8
        r, begin = r[is_near], positions[first[is_near], 2:] % edges[2]
        ends = np.sort(np.hstack([begin, begin + r[:, 2:]]), axis=1)
        shares = np.diff(np.clip(planes, ends[:, :1], ends[:, 1:]), axis=1) / np.diff(ends, axis=1)
        distances = np.linalg.norm(r, axis=1)
        forces = force(distances) - force(1.8)
        squares = np.array([r[:, 2] ** 2, 0.5 * (r[:, :2] ** 2).sum(axis=1)])
        sums += (forces / distances * squares @ shares).reshape(2, 3, n).sum(axis=1)
    normal, tangential = sums / (len(run.positions) * edges.prod() / n)
    return {"normal": normal, "tangential": tangential}
