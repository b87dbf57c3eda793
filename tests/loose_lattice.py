"""Atoms of two species on a loose lattice, in the units of ASE, for tests of files."""

import numpy as np

import minimd as md

PER_PICOSECOND = 98.22694788464064  # of the time unit of ASE
TURNED_CELL = np.array([[0.3, 9.0, 0.5], [1.0, 3.5, 8.0], [8.5, -2.0, 1.0]])  # left-handed, along no axis


def system(cell=(9.0, 10.0, 11.0), pbc=None, units=md.units.ASE, n_atoms=24):
    """Atoms of two species on a loose lattice, bonded in pairs, moving."""
    rng = np.random.default_rng(2)
    sites = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)[:n_atoms]
    return md.System(
        sites * 3.1 + rng.normal(0.0, 0.05, (n_atoms, 3)),
        masses=np.where(np.arange(n_atoms) % 2, 39.948, 83.798),
        velocities=rng.normal(0.0, 0.02, (n_atoms, 3)),
        cell=cell,
        pbc=pbc,
        species=np.where(np.arange(n_atoms) % 2, "Ar", "Kr"),
        bonds=np.arange(n_atoms).reshape(-1, 2),
        units=units,
    )


def simulation(of=None):
    return md.Simulation(
        of or system(), md.LennardJones(0.0104, 3.4, 4.4, truncation="shifted"), md.VelocityVerlet(0.4)
    )
