"""Small scenes that are handed to LAMMPS: name to simulation."""

from math import exp, sqrt

import numpy as np
from references import fourmol, liquid, load
from test_reference_lammps import SCALE, coefficients, harmonic_angles, harmonic_bonds

import minimd as md

CUTOFF = 2.5
TIMESTEP = 0.002
LJ = md.LennardJones(1.0, 1.0, CUTOFF)
SKEWED = np.array([[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [-0.2, 0.4, 1.0]])


def fluid(n_cells=3, **changes):
    """A disordered fluid of 4 n³ atoms, and what its System gets beside."""
    start = liquid(n_cells, jitter=0.03)
    given = {"velocities": start.velocities, "cell": start.cell.vectors} | changes
    return md.System(given.pop("positions", start.positions), **given)


def sheared(matrix, **changes):
    """The fluid in another cell: positions and lattice vectors times a matrix."""
    start = liquid(3, jitter=0.03)
    return fluid(positions=start.positions @ matrix, cell=start.cell.vectors @ matrix, **changes)


def rotation():
    """A proper rotation about no axis of the cell."""
    q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def mixture():
    """Labels of two species, four of five atoms A."""
    return np.where(np.arange(108) % 5 == 0, "B", "A")


def kob_andersen():
    own = {"A": (1.0, 1.0), "B": (0.5, 0.88)}
    cutoffs = {("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}
    potential = md.LennardJones(own, cutoff=cutoffs, pairs={("A", "B"): (1.5, 0.8)})
    return md.Simulation(fluid(species=mixture()), potential, md.VelocityVerlet(TIMESTEP))


def truncated(truncation):
    return md.Simulation(fluid(), md.LennardJones(1.0, 1.0, CUTOFF, truncation), md.VelocityVerlet(TIMESTEP))


def buckingham(r2, a, rho, c):
    r = sqrt(r2)
    repulsion = a * exp(-r / rho)
    return repulsion - c / r2**3, repulsion / (rho * r) - 6.0 * c / r2**4


def morse(r2, depth, alpha, r0):
    r = np.sqrt(r2)
    x = np.exp(-alpha * (r - r0))
    return depth * (x * x - 2.0 * x), 2.0 * depth * alpha * (x * x - x) / r


def weeks_chandler_andersen(r2, epsilon):
    if r2 > 2.0 ** (1.0 / 3.0):
        return 0.0, 0.0
    s6 = 1.0 / r2**3
    return 4.0 * epsilon * s6 * (s6 - 1.0) + epsilon, 24.0 * epsilon * s6 * (2.0 * s6 - 1.0) / r2


def own_law():
    potential = md.PairPotential(buckingham, (3e5, 0.08, 2.0), CUTOFF, "force-shifted")
    return md.Simulation(fluid(), potential, md.VelocityVerlet(TIMESTEP))


def own_law_of_species():
    potential = md.PairPotential(
        morse, {"A": (1.0, 5.0, 1.1), "B": (0.7, 4.0, 1.0)}, CUTOFF, pairs={("A", "B"): (1.2, 5.0, 1.0)}
    )
    return md.Simulation(fluid(species=mixture()), potential, md.VelocityVerlet(TIMESTEP))


def own_law_with_a_decision():
    potential = md.PairPotential(weeks_chandler_andersen, (1.0,), 1.5, "truncated")
    return md.Simulation(fluid(), potential, md.VelocityVerlet(TIMESTEP))


def groups(size):
    """(G, size): atoms of neighboring numbers, which are neighbors in a fresh crystal."""
    return np.arange(108 - 108 % size).reshape(-1, size)


def chain_system():
    chains = groups(4)
    bonds = np.concatenate([chains[:, k : k + 2] for k in range(3)])
    return fluid(
        bonds=bonds,
        angles=np.concatenate([chains[:, k : k + 3] for k in range(2)]),
        masses=np.where(np.arange(108) % 4 == 0, 2.0, 1.0),
    )


def chains():
    potentials = [
        md.LennardJones(1.0, 1.0, CUTOFF, bonded_scale=(0.0, 0.5, 0.8)),
        md.HarmonicBond(100.0, np.linspace(1.0, 1.3, 81)),
        md.HarmonicAngle(20.0, 1.9),
    ]
    return md.Simulation(chain_system(), potentials, md.VelocityVerlet(TIMESTEP))


def torsions():
    """Chains of four with every bond and dihedral that LAMMPS has too."""
    system, chains = chain_system(), groups(4)
    potentials = [
        md.LennardJones(1.0, 1.0, CUTOFF, bonded_scale=(0.0, 1.0, 1.0)),
        md.FENEBond(30.0, 1.9, 1.0, 0.9, system.bonds[:27]),
        md.MorseBond(20.0, 2.0, 1.1, system.bonds[27:]),
        md.PeriodicDihedral(1.5, 3, 0.4, chains[:13]),
        md.RyckaertBellemans((1.3, 1.4, -1.6, -0.4, 3.1, -3.4), chains[13:20]),
        md.OPLSDihedral(1.0, 2.0, 3.0, 0.5, chains[20:]),
    ]
    return md.Simulation(system, potentials, md.VelocityVerlet(TIMESTEP))


def two_laws_with_scales_of_their_own():
    potentials = [
        md.LennardJones(1.0, 1.0, CUTOFF, bonded_scale=(0.0, 1.0, 1.0)),
        md.LennardJones(0.5, 0.9, 2.0, bonded_scale=(1.0, 0.5, 1.0)),
        md.PairPotential(buckingham, (3e4, 0.08, 0.0), 2.0, bonded_scale=(0.0, 0.0, 1.0)),
        md.BondPotential(morse, (10.0, 3.0, 1.1)),
    ]
    return md.Simulation(chain_system(), potentials, md.VelocityVerlet(TIMESTEP))


def molecules(atoms, pairs, lengths, masses=None, species=None, scale=(0.0, 0.0, 1.0), bonds=None):
    """Copies of a rigid molecule, (A, 3), each turned and shifted, in a cell of 27."""
    rng, positions = np.random.default_rng(5), []
    for place in np.ndindex(3, 3, 3):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        positions.append(2.3 * np.array(place) + np.asarray(atoms) @ q + 0.1)
    size = len(atoms)
    pairs = np.asarray(pairs)
    all_pairs = np.concatenate([pairs + size * k for k in range(27)])
    bonds = all_pairs if bonds is None else np.concatenate([np.asarray(bonds) + size * k for k in range(27)])
    system = md.System(
        np.concatenate(positions),
        cell=6.9,
        bonds=bonds,
        masses=np.tile(masses or [1.0] * size, 27),
        species=species and species * 27,
    )
    laws = md.LennardJones({"X": (1.0, 1.0), "H": (0.0, 1.0)}, cutoff=CUTOFF, bonded_scale=scale)
    simulation = md.Simulation(
        system, laws, md.VelocityVerlet(TIMESTEP), md.DistanceConstraints(all_pairs, np.tile(lengths, 27))
    )
    simulation.set_temperature(1.0, seed=2)
    return simulation


def dumbbells():
    return molecules([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]], [[0, 1]], [0.8])


def bent():
    """Molecules of four atoms, three bonds at the middle one."""
    arms = 0.7 * np.eye(3)
    return molecules([[0.0, 0.0, 0.0], *arms], [[0, 1], [0, 2], [0, 3]], [0.7, 0.7, 0.7], masses=[3.0, 1.0, 1.0, 2.0])


def water():
    """The shape of SPC/E: Lennard-Jones on the oxygens, no charges."""
    angle = np.radians(109.47)
    atoms = 0.32 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [np.cos(angle), np.sin(angle), 0.0]])
    across = float(np.linalg.norm(atoms[2] - atoms[1]))
    pairs = [[0, 1], [0, 2], [1, 2]]
    return molecules(
        atoms, pairs, [0.32, 0.32, across], masses=[16.0, 1.0, 1.0], species=["X", "H", "H"], scale=(1.0, 1.0, 1.0)
    )


def water_with_bonds():
    """The same, with bonds along which bonded_scale counts."""
    angle = np.radians(109.47)
    atoms = 0.6 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [np.cos(angle), np.sin(angle), 0.0]])
    across = float(np.linalg.norm(atoms[2] - atoms[1]))
    return molecules(
        atoms, [[0, 1], [0, 2], [1, 2]], [0.6, 0.6, across], masses=[16.0, 1.0, 1.0], bonds=[[0, 1], [0, 2]]
    )


def in_cell(system):
    return md.Simulation(system, LJ, md.VelocityVerlet(TIMESTEP))


def droplet(pbc, matrix=SKEWED):
    """The fluid cut out of its surroundings in open directions."""
    return in_cell(sheared(matrix, pbc=pbc))


def without_cutoff():
    start = liquid(2, jitter=0.03)
    system = md.System(start.positions, velocities=start.velocities)
    return md.Simulation(system, md.LennardJones(1.0, 1.0, truncation="truncated"), md.VelocityVerlet(TIMESTEP))


def with_fixed_atoms():
    system = fluid(masses=np.where(np.arange(108) % 3 == 0, 2.5, 1.0))
    return md.Simulation(system, LJ, md.VelocityVerlet(TIMESTEP), md.FixedAtoms(np.arange(0, 108, 4)))


def argon():
    """In eV, Å, u, with a tail."""
    start = liquid(3, jitter=0.03)
    system = md.System(3.4 * start.positions, masses=39.948, cell=3.4 * start.cell.vectors, units=md.units.ASE)
    potential = md.LennardJones(0.0104, 3.4, 8.5, "truncated", tail_correction=True)
    simulation = md.Simulation(system, potential, md.Leapfrog(5.0 * md.units.fs))
    simulation.set_temperature(120.0, seed=1)
    return simulation


def far_away():
    start = liquid(3, jitter=0.03)
    images = np.random.default_rng(4).integers(-2000, 2000, (108, 3)).astype(float)
    return in_cell(fluid(positions=start.positions + images @ start.cell.vectors))


def sheet():
    """Four atoms in a plane, two directions periodic."""
    positions = [[0.0, 0.0, 0.0], [1.1, 0.0, 0.0], [0.3, 1.0, 0.0], [2.0, 2.0, 0.0]]
    return in_cell(md.System(positions, cell=[[10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 0.0]]))


def in_mixed_precision():
    return md.Simulation(fluid(), LJ, md.VelocityVerlet(TIMESTEP), precision="mixed")


def only_bonds():
    return md.Simulation(chain_system(), [md.HarmonicBond(100.0, 1.1)], md.VelocityVerlet(TIMESTEP))


def springs_at_rest():
    """All forces are rounding."""
    system = md.System(
        [[0.1, 0.2, 0.3], [0.7, 0.8, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.5]], cell=SKEWED * 9.0, bonds=[[0, 1], [2, 3]]
    )
    lengths = [np.sqrt(0.36 + 0.36 + 0.49), 1.5]
    return md.Simulation(system, md.HarmonicBond(300.0, lengths), md.VelocityVerlet(TIMESTEP))


def at_rest(positions, potentials, **given):
    """Thermal atoms without potential energy at the start."""
    simulation = md.Simulation(md.System(positions, **given), potentials, md.VelocityVerlet(TIMESTEP))
    simulation.set_temperature(1.0, seed=1)
    return simulation


def soft(r2, a):
    r = sqrt(r2)
    return (a * (1.0 - r) ** 2, 2.0 * a * (1.0 - r) / r) if r < 1.0 else (0.0, 0.0)


def chains_at_rest():
    """A square chain in each cell of 4 σ, its springs and angles at rest, its atoms farther apart than the cutoff."""
    corners = 1.2 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]])
    positions = (4.0 * np.array(list(np.ndindex(2, 2, 2)))[:, None, :] + corners).reshape(-1, 3)
    first = 4 * np.arange(8)[:, None]
    bonds = np.concatenate([first + pair for pair in ([0, 1], [1, 2], [2, 3])])
    angles = np.concatenate([first + three for three in ([0, 1, 2], [1, 2, 3])])
    laws = [
        md.HarmonicBond(300.0, 1.2),
        md.HarmonicAngle(20.0, np.pi / 2),
        md.LennardJones(1.0, 1.0, 2.0 ** (1.0 / 6.0)),
    ]
    return at_rest(positions, laws, cell=8.0, bonds=bonds, angles=angles)


def crystal(density, potential):
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], md.lattice.constant_from_density("fcc", density))
    return at_rest(positions, potential, cell=edges)


AT_REST = {
    "WCA crystal": lambda: crystal(0.8442, md.LennardJones(1.0, 1.0, 2.0 ** (1.0 / 6.0))),
    "gas": lambda: crystal(0.008, LJ),
    "chains at rest": chains_at_rest,
    "soft spheres": lambda: crystal(0.8442, md.PairPotential(soft, (50.0,), 1.1, "truncated")),
}


def fourmol_scene():
    """LAMMPS' own molecule: everything bonded, a cutoff of more than half the cell."""
    system, table = fourmol()
    reference = load("lammps_fourmol/mol-pair-lj_cut.json")
    own, unlike = coefficients(reference["pair_coeff"])
    bonds, angles = (load(f"lammps_fourmol/{name}-harmonic.json") for name in ("bond", "angle"))
    potentials = [
        md.LennardJones(own, cutoff=8.0, truncation="truncated", pairs=unlike, mixing="geometric", bonded_scale=SCALE),
        harmonic_bonds(table, bonds["bond_coeff"]),
        harmonic_angles(table, angles["angle_coeff"]),
    ]
    return md.Simulation(system, potentials, md.VelocityVerlet(0.002))


SCENES = {
    "melt": lambda: in_cell(fluid()),
    "Kob-Andersen mixture": kob_andersen,
    "truncated": lambda: truncated("truncated"),
    "force-shifted": lambda: truncated("force-shifted"),
    "switched": lambda: truncated("switched"),
    "charmm": lambda: truncated("charmm"),
    "smooth": lambda: truncated("smooth"),
    "own law": own_law,
    "own law of species": own_law_of_species,
    "own law with a decision": own_law_with_a_decision,
    "chains": chains,
    "torsions": torsions,
    "two laws": two_laws_with_scales_of_their_own,
    "dumbbells": dumbbells,
    "bent": bent,
    "water": water,
    "water with bonds": water_with_bonds,
    "triclinic": lambda: droplet(True),
    "turned": lambda: droplet(True, SKEWED @ rotation()),
    "left-handed": lambda: droplet(True, np.diag([1.0, 1.0, -1.0]) @ SKEWED),
    "slab": lambda: droplet([True, True, False]),
    "skewed slab": lambda: droplet([True, False, True], SKEWED @ rotation()),
    "wire": lambda: droplet([False, True, False]),
    "droplet": lambda: droplet(False),
    "small cell": lambda: in_cell(
        md.System(liquid(2, jitter=0.03).positions, velocities=liquid(2).velocities, cell=liquid(2).cell.vectors)
    ),
    "without cutoff": without_cutoff,
    "fixed atoms": with_fixed_atoms,
    "argon": argon,
    "sheet": sheet,
    "far away": far_away,
    "only bonds": only_bonds,
    "springs at rest": springs_at_rest,
    "fourmol": fourmol_scene,
    **AT_REST,
}
