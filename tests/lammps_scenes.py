"""Small scenes that are handed to LAMMPS: name to simulation. Those of scenes.py, and more."""

from math import exp, sqrt

import numpy as np
import scenes
from references import liquid

import minimd as md

CUTOFF = 2.5
TIMESTEP = 0.002
SKEWED = np.array([[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [-0.2, 0.4, 1.0]])
ROTATION = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
ROTATION *= np.sign(np.linalg.det(ROTATION))  # proper, about no axis of the cell
LEFT_HANDED = np.diag([1.0, 1.0, -1.0]) @ SKEWED
TWO_KINDS = np.where(np.arange(108) % 5 == 0, "B", "A")  # four of five atoms A
KOB_ANDERSEN = {("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}  # cutoffs
KOB_ANDERSEN = md.LennardJones({"A": (1.0, 1.0), "B": (0.5, 0.88)}, cutoff=KOB_ANDERSEN, pairs={("A", "B"): (1.5, 0.8)})
CHAINS = np.arange(108).reshape(-1, 4)  # atoms of neighboring numbers, which are neighbors in a fresh crystal


def scene(system, potentials=scenes.LJ, constraints=(), method=None, **options):
    return md.Simulation(system, potentials, method or md.VelocityVerlet(TIMESTEP), constraints, **options)


def fluid(matrix=None, **changes):
    start, matrix = scenes.argon().system, np.eye(3) if matrix is None else matrix
    given = {"positions": start.positions @ matrix, "velocities": start.velocities, "cell": start.cell.vectors @ matrix}
    return md.System(**given | changes)


def in_a_plane():
    positions, edges = md.lattice.crystal("triangular", (10, 6), 1.15)
    positions += 0.02 * np.random.default_rng(3).normal(size=positions.shape)
    simulation = scene(md.System(positions, cell=edges, planar=True))
    simulation.set_temperature(0.7, seed=2)
    return simulation


def far_away():
    start = fluid()
    images = np.random.default_rng(4).integers(-2000, 2000, (108, 3)).astype(float)
    return fluid(positions=start.positions + images @ start.cell.vectors)


def buckingham(r2, a, rho, c):
    r = sqrt(r2)
    repulsion = a * exp(-r / rho)
    return repulsion - c / r2**3, repulsion / (rho * r) - 6.0 * c / r2**4


def soft(r2, a):
    r = sqrt(r2)
    return (a * (1.0 - r) ** 2, 2.0 * a * (1.0 - r) / r) if r < 1.0 else (0.0, 0.0)


def morse(r2, depth, alpha, r0):
    r = np.sqrt(r2)
    x = np.exp(-alpha * (r - r0))
    return depth * (x * x - 2.0 * x), 2.0 * depth * alpha * (x * x - x) / r


def chain_system():
    bonds = np.concatenate([CHAINS[:, k : k + 2] for k in range(3)])
    angles = np.concatenate([CHAINS[:, k : k + 3] for k in range(2)])
    return fluid(bonds=bonds, angles=angles, masses=np.where(np.arange(108) % 4 == 0, 2.0, 1.0))


def scaled(*scale):
    return md.LennardJones(1.0, 1.0, CUTOFF, bonded_scale=scale)


def chains():
    springs = md.HarmonicBond(100.0, np.linspace(1.0, 1.3, 81)), md.HarmonicAngle(20.0, 1.9)
    return scene(chain_system(), [scaled(0.0, 0.5, 0.8), *springs])


def torsions():
    system, ryckaert = chain_system(), (1.3, 1.4, -1.6, -0.4, 3.1, -3.4)
    bonds = md.FENEBond(30.0, 1.9, 1.0, 0.9, system.bonds[:27]), md.MorseBond(20.0, 2.0, 1.1, system.bonds[27:])
    periodic, opls = md.PeriodicDihedral(1.5, 3, 0.4, CHAINS[:13]), md.OPLSDihedral(1.0, 2.0, 3.0, 0.5, CHAINS[20:])
    dihedrals = periodic, md.RyckaertBellemans(ryckaert, CHAINS[13:20]), opls
    return scene(system, [scaled(0.0, 1.0, 1.0), *bonds, *dihedrals])


def two_laws():
    second = md.LennardJones(0.5, 0.9, 2.0, bonded_scale=(1.0, 0.5, 1.0))
    third = md.PairPotential(buckingham, (3e4, 0.08, 0.0), 2.0, bonded_scale=(0.0, 0.0, 1.0))
    return scene(chain_system(), [scaled(0.0, 1.0, 1.0), second, third, md.BondPotential(morse, (10.0, 3.0, 1.1))])


MIE = md.Mie({"A": (1.0, 1.0, 14, 7), "B": (0.5, 0.88, 12, 6)}, cutoff=CUTOFF, pairs={("A", "B"): (0.8, 0.95, 13, 6)})


def soft_and_quartic():
    force_shifted = md.Mie(0.5, 0.9, 12.65, 6.0, 2.0, "force-shifted", bonded_scale=(0.0, 1.0, 1.0))
    bonds = md.QuarticBond(np.linspace(50.0, 90.0, 81), -120.0, 100.0, 1.1)
    return scene(chain_system(), [md.SoftRepulsion(3.0, 1.3, bonded_scale=(0.0, 1.0, 1.0)), force_shifted, bonds])


def water():
    """That of scenes.py, its lengths equal to the last bit, as fix shake wants them."""
    system, laws, rigid, *_ = scenes.water()
    return scene(system, laws, md.DistanceConstraints(rigid[0].pairs, [0.3, 0.3, 0.48] * 32))


def stars():
    centers, edges = md.lattice.crystal("sc", [3, 3, 3], 2.3)
    turns = np.linalg.qr(np.random.default_rng(5).normal(size=(27, 3, 3)))[0]
    positions = centers[:, None] + 0.7 * np.vstack([np.zeros(3), np.eye(3)]) @ turns
    pairs = np.concatenate([4 * k + np.array([[0, 1], [0, 2], [0, 3]]) for k in range(27)])
    given = {"masses": [3.0, 1.0, 1.0, 2.0] * 27, "species": ["X", "H", "H", "H"] * 27}
    law = md.LennardJones({"X": (1.0, 1.0), "H": (0.0, 1.0)}, cutoff=CUTOFF, bonded_scale=(0.0, 0.5, 1.0))
    system = md.System(positions.reshape(-1, 3), cell=edges, bonds=pairs, **given)
    return warm(system, law, md.DistanceConstraints(pairs, 0.7))


def warm(system, potentials, constraints=(), method=None, temperature=1.0):
    simulation = scene(system, potentials, constraints, method)
    simulation.set_temperature(temperature, seed=1)
    return simulation


def crystal(density, potential):
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], md.lattice.constant_from_density("fcc", density))
    return warm(md.System(positions, cell=edges), potential)


def chains_at_rest():
    """A square chain in each cell of 4 σ, its springs and angles at rest, its atoms farther apart than the cutoff."""
    corners = 1.2 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]])
    positions = (4.0 * np.array(list(np.ndindex(2, 2, 2)))[:, None, :] + corners).reshape(-1, 3)
    first = 4 * np.arange(8)[:, None]
    bonds = np.concatenate([first + pair for pair in ([0, 1], [1, 2], [2, 3])])
    angles = np.concatenate([first + three for three in ([0, 1, 2], [1, 2, 3])])
    springs = md.HarmonicBond(300.0, 1.2), md.HarmonicAngle(20.0, np.pi / 2)
    return warm(md.System(positions, cell=8.0, bonds=bonds, angles=angles), [*springs, WCA])


WCA = md.LennardJones(1.0, 1.0, 2.0 ** (1.0 / 6.0))
AT_REST = {
    "WCA crystal": lambda: crystal(0.8442, WCA), "thin gas": lambda: crystal(0.008, scenes.LJ),
    "chains at rest": chains_at_rest,
    "soft spheres": lambda: crystal(0.8442, md.PairPotential(soft, (50.0,), 1.1, "truncated")),
}  # fmt: skip


def with_a_tail():
    start = fluid()
    system = md.System(3.4 * start.positions, masses=39.948, cell=3.4 * start.cell.vectors, units=md.units.ASE)
    potential = md.LennardJones(0.0104, 3.4, 8.5, "truncated", tail_correction=True)
    return warm(system, potential, method=md.Leapfrog(5.0 * md.units.fs), temperature=120.0)


def in_cell(matrix, **open_directions):
    return lambda: scene(fluid(matrix, **open_directions))


def ions(n, spacing, matrix=None, accuracy=1e-5):
    """n³ ions, displaced from a lattice of rock salt, in Å and eV; in a cell if there is a matrix."""
    sites, rng = np.array(list(np.ndindex(n, n, n))), np.random.default_rng(1)
    charges = 1.0 - 2.0 * (sites.sum(axis=1) % 2)
    places, cell, cutoff = spacing * sites + rng.uniform(-0.5, 0.5, sites.shape), None, None
    if matrix is not None:
        places, cell, cutoff = places @ matrix, n * spacing * matrix, 1.8 * spacing
    given = {"charges": charges, "species": np.where(charges > 0.0, "Na", "Cl"), "masses": 30.0, "cell": cell}
    laws = md.LennardJones({"Na": (0.0043, 2.35), "Cl": (0.0043, 4.4)}, cutoff=cutoff), md.Coulomb(cutoff, accuracy)
    return warm(md.System(places, units=md.units.ASE, **given), laws, (), md.VelocityVerlet(md.units.fs), 1200.0)


def charged_water(accuracy=1e-5):
    """27 rigid molecules of SPC/E."""
    system, laws, rigid = md.water("SPC/E", 27, cutoff=4.5, accuracy=accuracy)
    return warm(system, laws, rigid, md.VelocityVerlet(md.units.fs), 300.0)


HEAVIER, CUT = np.where(np.arange(108) % 3 == 0, 2.5, 1.0), ("truncated", "shifted", "switched", "charmm", "smooth")
PLANE = [[0.0, 0.0, 0.0], [1.1, 0.0, 0.0], [0.3, 1.0, 0.0], [2.0, 2.0, 0.0]]
SCENES = {
    **{name: lambda make=make: make().simulation() for name, make in scenes.SCENES.items() if name != "two_atoms"},
    **{one: lambda one=one: scene(fluid(), md.LennardJones(1.0, 1.0, CUTOFF, one)) for one in CUT},
    "Kob-Andersen mixture": lambda: scene(fluid(species=TWO_KINDS), KOB_ANDERSEN),
    "own law": lambda: scene(fluid(), md.PairPotential(buckingham, (3e5, 0.08, 2.0), CUTOFF, "force-shifted")),
    "Mie": lambda: scene(fluid(species=TWO_KINDS), MIE),
    "soft and quartic": soft_and_quartic,
    "turned": in_cell(SKEWED @ ROTATION), "left-handed": in_cell(LEFT_HANDED), "tail": with_a_tail,
    "skewed slab": in_cell(SKEWED @ ROTATION, pbc=[True, False, True]),
    "wire": in_cell(SKEWED, pbc=[False, True, False]), "far away": lambda: scene(far_away()), **AT_REST,
    "small cell": lambda: scene(liquid(2), scaled(1.0, 1.0, 1.0)),
    "without cutoff": lambda: scene(scenes.droplet().system, scenes.OPEN),
    "fixed atoms": lambda: scene(fluid(masses=HEAVIER), scenes.LJ, md.FixedAtoms(np.arange(0, 108, 4))),
    "plane": in_a_plane,
    "sheet": lambda: scene(md.System(PLANE, cell=np.diag([10.0, 10.0, 0.0]))),
    "water": water, "chains": chains, "torsions": torsions, "two laws": two_laws, "stars": stars,
}  # fmt: skip
SUMMED = {  # charges with a sum over waves, of accuracy 1e-5
    "salt": lambda: ions(4, 3.0, np.eye(3)), "skewed salt": lambda: ions(4, 3.0, SKEWED @ ROTATION),
    "charged water": charged_water,
}  # fmt: skip
SCENES |= {**SUMMED, "ions": lambda: ions(3, 2.9)}
