"""Scenes for the tests of fixed-point arithmetic: one mixture, so that few kernels are compiled."""

import numpy as np

import minimd as md

CELLS = 3
GRID = md.Grid(2.0**-42, 2.0**-44, 2.0**-42)
KINDS = {"A": (1.0, 1.0), "B": (0.5, 0.9)}
LAW = md.LennardJones(KINDS, cutoff=1.8, truncation="switched", bonded_scale=(0.0, 0.5, 1.0))
BOND, ANGLE = md.HarmonicBond(k=300.0, length=1.1), md.HarmonicAngle(k=20.0, angle=1.05)


def mixture(pbc=True, with_bonds=True, temperature=0.9):
    """108 atoms of two species and masses in a triclinic cell, on the points of GRID; some in bent groups of three."""
    random = np.random.default_rng(5)
    sites, edges = md.lattice.crystal("fcc", (CELLS,) * 3, (4.0 / 0.8) ** (1.0 / 3.0))
    cell = on_grid(edges[0] * np.array([[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.1, -0.2, 1.0]]))
    n, k = len(sites), np.arange(len(sites))
    masses, first = np.where(k % 3, 1.0, 2.5), np.arange(0, n // 2, 8)[:, None]
    triples = first + np.arange(3)
    bonds = {"bonds": triples[:, [0, 1, 1, 2]].reshape(-1, 2), "angles": triples} if with_bonds else {}
    velocities, species = random.normal(size=(n, 3)) * np.sqrt(temperature / masses)[:, None], np.where(k % 3, "A", "B")
    given = {"cell": cell, "pbc": pbc, "species": species, "masses": masses, "velocities": velocities}
    return md.System(on_grid(sites / edges @ cell), **given, **bonds)


def on_grid(lengths):
    return np.rint(lengths / GRID.length) * GRID.length


def simulated(system, method=None, potentials=None, **options):
    bonded = [BOND, ANGLE] if len(system.bonds) else []
    options = {"precision": "fixed-point", "grid": GRID, "threads": 1, **options}
    return md.Simulation(system, potentials or [LAW, *bonded], method or md.VelocityVerlet(0.004), **options)


def plain(method=None, **options):
    return simulated(mixture(with_bonds=False), method, **options)


def bits(simulation):
    return simulation.positions.tobytes(), simulation.velocities.tobytes()


def total_momentum(simulation):
    momenta = simulation.system.masses[:, None] * simulation.velocities / simulation.engine.interactions.grid.momentum
    return [sum(map(int, column)) for column in np.rint(momenta).T]
