"""Twelve scenes whose fixed-point runs have one hash each, on every processor and for atoms numbered in any way."""

import hashlib
import sys

import numpy as np
from charged_scenes import salt
from fixed_point_scenes import ANGLE, BOND, LAW, mixture

import minimd as md

STEPS = 100
FINE = 2.0**20  # starts are multiples of 1/FINE, so that they do not depend on the functions that made them
FIELDS = ("positions", "velocities", "masses", "charges", "species")
GROUPS = ("bonds", "angles", "dihedrals")
SERIES = ("potential_energy", "total_energy", "temperature", "pressure")
CORE = md.LennardJones(0.1, 0.85, 2.6, "force-shifted", bonded_scale=(0.0, 0.0, 0.5))
SCALED = (0.0, 0.0, 0.5)
WATER_BONDS = [md.HarmonicBond(40.0, 1.0), md.HarmonicAngle(4.0, 1.9106)]


def melt():
    sites, edges = md.lattice.crystal("fcc", (3, 3, 3), 1.68)
    return md.System(sites, cell=edges), [md.LennardJones(1.0, 1.0, 2.2)], ()


def molecules():
    return mixture(), [LAW, BOND, ANGLE], ()


def chains(open_end=False):
    """Four chains of 16 charged beads, bent to and fro through the cell; with an open end, between two walls."""
    k = np.arange(16)
    beads = np.column_stack([np.abs(k % 8 - 3.5) - 0.5, k // 4, 0.4 * (k % 2)])
    sites = np.concatenate([beads + np.array([0.0, 0.0, chain]) for chain in range(4)]) * 1.1
    starts = 16 * np.arange(4)[:, None, None]
    groups = (k[: 17 - n, None] + np.arange(n) for n in (2, 3, 4))
    links = {name: (starts + group).reshape(-1, group.shape[1]) for name, group in zip(GROUPS, groups, strict=True)}
    given = {"cell": np.diag([5.5, 5.5, 5.5]), "pbc": (True, True, not open_end)}
    return md.System(sites, charges=np.tile([0.4, -0.4, 0.0, 0.0], 16), **links, **given)


def polymer():
    bonded = [md.HarmonicBond(200.0, 1.1), md.HarmonicAngle(5.0, 1.9), md.PeriodicDihedral(0.5, 3, 0.4)]
    return chains(), [CORE, md.Coulomb(2.7, 1e-5, bonded_scale=SCALED), *bonded], ()


def slab():
    walls = [md.Wall([0.0, 0.0, z], [0.0, 0.0, n]) for z, n in ((-2.0, 1.0), (7.0, -1.0))]
    charges = md.Coulomb(2.7, method="shifted-force", bonded_scale=SCALED)
    return chains(open_end=True), [CORE, charges, md.HarmonicBond(200.0, 1.1), *walls], ()


def rigid_chains():
    system = chains()
    return system, [CORE, md.Coulomb(2.7, 1e-4, bonded_scale=SCALED)], md.DistanceConstraints(system.bonds)


def rigid_water():
    return md.water("SPC/E", 27, cutoff=4.2)


def flexible_water():
    """Of the same molecules, whose angles are made of their bonds."""
    system, potentials, _ = md.water("SPC/E", 27, cutoff=4.2)
    angles = system.bonds.reshape(-1, 4)[:, [1, 0, 3]]
    parts = {of: getattr(system, of) for of in (*FIELDS, "bonds", "cell", "units")}
    return md.System(angles=angles, **parts), [*potentials, *WATER_BONDS], ()


def of_salt(charges=None, cell=None, fixed=False):
    constraints = md.FixedAtoms([0, 7, 40]) if fixed else ()
    return salt(2, cell, charges=charges), [CORE, md.Coulomb(1.9, 1e-4)], constraints


def bathed_in_a_dielectric():
    return salt(2), [CORE, md.Coulomb(1.9, method="reaction-field", dielectric=78.3)], ()


SCENES = {
    "melt": melt,
    "mixture of molecules, triclinic": molecules,
    "polymer": polymer,
    "slab between walls": slab,
    "rigid chains": rigid_chains,
    "rigid water": rigid_water,
    "flexible water": flexible_water,
    "salt": of_salt,
    "salt, triclinic": lambda: of_salt(cell=[[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.1, -0.2, 1.0]]),
    "salt, fixed atoms": lambda: of_salt(fixed=True),
    "net charge": lambda: of_salt(charges=lambda places: (-1.0) ** places.sum(axis=1) + 0.1),
    "reaction field": bathed_in_a_dielectric,
}


class Run:
    """A fixed-point run of a scene.  order : the number of each atom of the scene.  moves : (N, 3), from its place
    [length]."""

    def __init__(self, name, order=None, moves=0.0, n_steps=STEPS, **options):
        system, potentials, constraints = SCENES[name]()
        self.order, self.moves = np.arange(len(system)) if order is None else order, moves
        system.positions[:] = np.rint(system.positions * FINE) / FINE + moves
        if not system.velocities.any():
            speeds = np.random.default_rng(3).normal(scale=0.05, size=system.positions.shape)
            system.velocities[:] = np.rint(speeds / np.sqrt(system.masses)[:, None] * FINE) / FINE
        numbered, constraints = renumbered(system, self.order), on_atoms(constraints, self.order)
        method = md.VelocityVerlet(0.001 if system.units is md.units.LJ else md.units.fs)
        options = {"precision": "fixed-point", "threads": 1, **options}
        self.simulation = md.Simulation(numbered, potentials, method, constraints, **options)
        self.record = self.simulation.run(n_steps, every=n_steps // 2, progress=False)

    @property
    def hash(self):
        """Two digests: of positions and velocities, in the order of the scene; of energies and pressures."""
        motion = (self.simulation.positions[self.order] - self.moves, self.simulation.velocities[self.order])
        series = [getattr(self.record, name, np.zeros(0)) for name in SERIES]  # no pressure in an open cell
        return f"{digest_of(motion)} {digest_of(series)}"


def digest_of(arrays):
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()[:16]


def renumbered(system, order):
    place = np.argsort(order)
    parts = {of: getattr(system, of)[place] for of in FIELDS} | {of: order[getattr(system, of)] for of in GROUPS}
    return md.System(cell=system.cell, units=system.units, **parts)


def on_atoms(constraints, order):
    if isinstance(constraints, md.DistanceConstraints):
        return md.DistanceConstraints(order[constraints.pairs], constraints.lengths)
    return md.FixedAtoms(order[constraints.atoms]) if constraints else ()


def moves_of(name, grid):
    """Each atom by lattice vectors, and all together where nothing stands still."""
    system, random = SCENES[name]()[0], np.random.default_rng(2)
    steps = np.where(system.cell.pbc, random.integers(-2, 3, (len(system), 3)), 0)
    vectors = np.rint(system.cell.vectors / grid.length) * grid.length
    return steps @ vectors + np.where(system.cell.pbc, np.array([12345, -99, 7_777]) / FINE, 0.0)


if __name__ == "__main__":
    n_steps, *names = sys.argv[1:] or [STEPS]
    for scene in names or SCENES:
        print(f"{Run(scene, n_steps=int(n_steps)).hash}  {scene}", flush=True)
