"""Scenes for the tests of fixed-point arithmetic: one mixture, so that few kernels are compiled."""

import numpy as np

import minimd as md

CELLS = 3
GRID = md.Grid(2.0**-42, 2.0**-44, 2.0**-42)
LAW = md.LennardJones(
    {"A": (1.0, 1.0), "B": (0.5, 0.9)}, cutoff=1.8, mixing="lorentz-berthelot", bonded_scale=(0.0, 0.5, 1.0)
)
BOND, ANGLE = md.HarmonicBond(k=300.0, length=1.1), md.HarmonicAngle(k=20.0, angle=1.05)


def mixture(pbc=True, with_bonds=True, temperature=0.9):
    """108 atoms of two species and masses in a triclinic cell, on the points of GRID; some in groups of three with two bonds and an angle."""
    random, edge = np.random.default_rng(5), CELLS * (4.0 / 0.8) ** (1.0 / 3.0)
    corners = np.array([(x, y, z) for x in range(CELLS) for y in range(CELLS) for z in range(CELLS)])
    fractional = (
        corners[:, None] + np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]])
    ).reshape(-1, 3) / CELLS
    cell = on_grid(np.array([[edge, 0.0, 0.0], [0.3 * edge, edge, 0.0], [0.1 * edge, -0.2 * edge, edge]]))
    n = len(fractional)
    masses = np.where(np.arange(n) % 3, 1.0, 2.5)
    velocities = random.normal(size=(n, 3)) * np.sqrt(temperature / masses)[:, None]
    first = np.arange(0, n // 2, 8)
    groups = {
        "bonds": np.concatenate([[(k, k + 1), (k + 1, k + 2)] for k in first]),
        "angles": [(k, k + 1, k + 2) for k in first],
    }
    return md.System(
        on_grid(fractional @ cell),
        cell=cell,
        pbc=pbc,
        species=np.where(np.arange(n) % 3, "A", "B"),
        masses=masses,
        velocities=velocities,
        **(groups if with_bonds else {}),
    )


def on_grid(lengths):
    """Lengths as multiples of the step of GRID."""
    return np.rint(lengths / GRID.length) * GRID.length


def simulated(system, method=None, potentials=None, **options):
    """A simulation in fixed-point arithmetic."""
    bonded = [BOND, ANGLE] if len(system.bonds) else []
    options = {"precision": "fixed-point", "grid": GRID, "threads": 1, **options}
    return md.Simulation(system, potentials or [LAW, *bonded], method or md.VelocityVerlet(0.004), **options)


def bits(simulation):
    """All bits of the state."""
    return simulation.positions.tobytes(), simulation.velocities.tobytes()


def total_momentum(simulation):
    """Σ P in whole numbers of steps, as Python counts."""
    momenta = np.rint(
        simulation.system.masses[:, None] * simulation.velocities / simulation.engine.interactions.grid.momentum
    )
    return [sum(map(int, column)) for column in momenta.T]
