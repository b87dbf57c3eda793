"""Scenes with charges: crystals, a salt, a few ions; and a converged Ewald sum of Gaussians, written without minimd."""

import numpy as np
from scipy.special import erfc

import minimd as md

FCC = np.array([(0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (0.5, 0.5, 0.0)])
# places and charges in a cube of edge 1, formula units, and their energy for k_e = 1: tests/data/README.md
CRYSTALS = {
    "NaCl": ([FCC, FCC + np.array([0.5, 0.0, 0.0])], (1, -1), 4, -3.49512918926637),
    "CsCl": ([[[0.0, 0.0, 0.0]], [[0.5, 0.5, 0.5]]], (1, -1), 1, -2.0353615094526),
    "ZnS": ([FCC, FCC + 0.25], (1, -1), 4, -3.78292610408578),
    "CaF2": ([FCC, FCC + 0.25, FCC + 0.75], (2, -1, -1), 4, -11.6365752270767),
}
OTHER_CRYSTALS = {name: CRYSTALS[name] for name in ("NaCl", "ZnS", "CaF2")} | {
    "ReO3": ([[[0.0, 0.0, 0.0]], 0.5 * np.eye(3)], (3, -1), 1, np.nan),
    "perovskite": ([[[0.0, 0.0, 0.0]], [[0.5, 0.5, 0.5]], FCC[1:]], (2, 4, -2), 1, np.nan),
}
EDGE = 5.64  # Å, of the cube of eight ions
CUTOFF = 2.7
LAWS = [md.LennardJones(0.1, 2.3, CUTOFF, "force-shifted"), md.Coulomb(CUTOFF, 1e-4)]


def crystal(name, repeat=3, shear=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
    """A block of a crystal in a cell, perhaps sheared by whole edges; its number of formula units, and their energy."""
    parts, charges, n, energy = (CRYSTALS | OTHER_CRYSTALS)[name]
    basis, of_basis = np.concatenate(parts), np.repeat(charges, [len(part) for part in parts])
    places = np.array([*np.ndindex(*(repeat,) * 3)])[:, None] + basis
    cell = repeat * np.array(shear, dtype=float)
    return md.System(places.reshape(-1, 3), cell=cell, charges=np.tile(of_basis, repeat**3)), n * repeat**3, energy


def salt(n=3, cell=None, disorder=0.1, seed=0, charges=None):
    """Ions on the places of NaCl, 1 apart, moved at random.  cell : rows, in units of the edge; a cube if not given."""
    places = np.array([*np.ndindex(*(2 * n,) * 3)], dtype=float)
    signs = (-1.0) ** places.sum(axis=1)
    vectors = 2.0 * n * (np.eye(3) if cell is None else np.array(cell))
    moved = places / (2 * n) @ vectors + disorder * np.random.default_rng(seed).normal(size=places.shape)
    given = {"charges": signs if charges is None else charges(places), "species": np.where(signs > 0, "Na", "Cl")}
    return md.System(moved, cell=vectors, **given)


def ewald(positions, charges, lattice, alpha, reach=6.3):
    """Energy and forces of charges and all their images, k_e = 1; a background for a net charge.
    reach : of both sums, in units of 1/α and 2 α: exp(−reach²) is left out."""
    inverse, volume = np.linalg.inv(lattice), abs(np.linalg.det(lattice))
    most = np.ceil(reach / alpha * np.linalg.norm(inverse, axis=0)).astype(int) + 1
    energy, forces, apart = 0.0, np.zeros_like(positions), positions[:, None] - positions[None]
    apart -= np.round(apart @ inverse) @ lattice
    for shift in np.array([*np.ndindex(*(2 * most + 1))]) - most:
        d = apart + shift @ lattice
        r = np.sqrt((d**2).sum(axis=-1))
        near = (r > 0.0) & (r < reach / alpha)
        r = np.where(near, r, 1.0)
        product = np.where(near, charges[:, None] * charges, 0.0)
        energy += 0.5 * (product * erfc(alpha * r) / r).sum()
        slope = (erfc(alpha * r) / r + 2.0 * alpha / np.sqrt(np.pi) * np.exp(-((alpha * r) ** 2))) / r**2
        forces += ((product * slope)[..., None] * d).sum(axis=1)
    most = np.ceil(reach * alpha / np.pi * np.linalg.norm(lattice, axis=1)).astype(int)
    waves = np.array([*np.ndindex(*(2 * most + 1))]) - most
    k = 2.0 * np.pi * waves[(waves != 0).any(axis=1)] @ inverse.T
    k2 = (k**2).sum(axis=1)
    k, k2 = k[k2 < (2.0 * reach * alpha) ** 2], k2[k2 < (2.0 * reach * alpha) ** 2]
    for some in np.array_split(np.arange(len(k)), -(-len(k) // 4000)):
        phases = charges[:, None] * np.exp(1j * positions @ k[some].T)
        weights = 4.0 * np.pi / volume * np.exp(-k2[some] / (4.0 * alpha**2)) / k2[some]
        total = phases.sum(axis=0)
        energy += 0.5 * (weights * np.abs(total) ** 2).sum()
        forces += (weights * (np.conj(total) * phases).imag) @ k[some]
    background = np.pi / (2.0 * volume * alpha**2) * charges.sum() ** 2
    return energy - alpha / np.sqrt(np.pi) * (charges**2).sum() - background, forces


def rms(forces):
    return np.sqrt((forces**2).sum(axis=1).mean())


def ions(net=0.0, **given):
    """Eight ions, not quite in their places, of ±0.7 e and a share of the net charge."""
    of = salt(1, disorder=0.035, seed=7)
    given = {"cell": EDGE, "charges": 0.7 * of.charges + net / 8.0, "species": of.species} | given
    masses = np.where(of.charges > 0.0, 22.99, 35.45)
    return md.System(0.5 * EDGE * of.positions, units=md.units.ASE, masses=masses, **given)


def run_of(system, femtoseconds=1.0):
    """A simulation of ions at 300 K."""
    made = md.Simulation(system, LAWS, md.VelocityVerlet(femtoseconds * md.units.fs))
    made.set_temperature(300.0, seed=2)
    return made
