"""The scenes of the benchmark, in reduced Lennard-Jones units: fluids, droplet and slab, chains, rigid molecules.

Each is a function of a number n, and has 4 n³ atoms, or nearly as many.
"""

import warnings
from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations_with_replacement
from math import cbrt, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import minimd as md
from minimd.forces.forces import Potential
from minimd.potentials.pair import Label
from minimd.structure.lattice import constant_from_density, crystal
from minimd.structure.observables import maxwell_boltzmann

MELT = "melt"
SEED = 87287
TIMESTEP = 0.005  # τ
CUTOFF = 2.5  # σ of the pair
SHIFT = 4.0 * (CUTOFF**-12 - CUTOFF**-6)  # u(r_c) [ε] of Lennard-Jones, which a shifted potential subtracts
WCA_CUTOFF = 2.0 ** (1.0 / 6.0)  # σ, the minimum of Lennard-Jones
SKIN_LAMMPS = 0.3  # σ, as in LAMMPS' benchmark
SCATTER = 5.0  # k_B T per √atom: twice the standard deviation between total energies of two independent liquids
EQUILIBRATION = 500  # steps: 2.5 τ, in which a crystal at these temperatures melts

MELT_DENSITY, MELT_TEMPERATURE = 0.8442, 1.44  # of LAMMPS' benchmark
GAS_DENSITY = 0.01
PRESSURE, COMPRESSIBILITY = 5.0, 0.03  # of the melt at constant pressure: about those of the melt itself
THERMOSTAT_TIME, BAROSTAT_TIME = 0.5, 5.0  # τ
LIQUID_DENSITY, LIQUID_TEMPERATURE = 0.8, 0.75  # of droplet and slab
DROPLET_CELL, SLAB_CELL = 4.0, 4.0  # edges of the cell, in diameters of the droplet and thicknesses of the slab

MIXTURE_DENSITY, MIXTURE_TEMPERATURE = 1.2, 1.0
MIXTURE: Mapping[Label, tuple[float, float]] = {"A": (1.0, 1.0), "B": (0.5, 0.88)}  # ε, σ
UNLIKE = (1.5, 0.8)
SMALL_FRACTION = 0.2  # of species B

CHAIN_DENSITY, CHAIN_TEMPERATURE = 0.85, 1.0
BEADS = 100  # in a chain
BOND_CONSTANT, BOND_LENGTH = 400.0, 1.0
FENE_CONSTANT, FENE_LONGEST, FRICTION = 30.0, 1.5, 0.1  # ε/σ², σ, 1/τ, of LAMMPS' benchmark
CHAIN_TIMESTEP = 0.012  # τ, of LAMMPS' benchmark

DECANE_DENSITY, DECANE_TEMPERATURE = 0.19, 6.5  # molecules per σ³: 0.73 g/cm³; 300 K
DECANE: Mapping[Label, tuple[float, float]] = {"CH3": (98 / 46, 3.75 / 3.95), "CH2": (1.0, 1.0)}  # of 46 K and 3.95 Å
CARBONS, METHYL_MASS, DECANE_BOND, DECANE_ANGLE = 10, 15.035 / 14.027, 1.54 / 3.95, np.radians(114.0)
DECANE_SPRING, DECANE_BENDING = 9e4, 62500 / 46  # ε/σ², ε/rad²; TraPPE itself holds its bonds fixed
DECANE_TORSION = (2 * 355.03 / 46, -2 * 68.19 / 46, 2 * 791.32 / 46)  # ε, k₁ to k₃
DECANE_TIMESTEP = 0.0004  # τ, 1 fs

DUMBBELL_DENSITY, DUMBBELL_TEMPERATURE = 0.4, 1.5  # molecules per σ³
DUMBBELL_LENGTH = 0.6

TRIANGLE_DENSITY, TRIANGLE_TEMPERATURE = 0.3187, 1.0  # molecules per σ³: 1.08 g/cm³
TRIANGLE_ANGLE = np.radians(75.0)  # between its sides of 1 σ


class BenchScene(NamedTuple):
    """A system with its potentials, and how its steps are made.

    text : a description in one line.  constraints : lengths held fixed.  method : with its time step and bath.
    """

    name: str
    text: str
    system: md.System
    potentials: tuple[Potential, ...]
    temperature: float
    constraints: tuple[md.DistanceConstraints, ...] = ()
    method: md.integrators.Splitting = md.VelocityVerlet(TIMESTEP)
    barostat: md.StochasticCellRescaling | None = None

    @property
    def edges(self) -> NDArray[np.float64]:
        """(3,) of the cell, which is rectangular [σ]."""
        return np.diag(self.system.cell.vectors)

    @property
    def law(self) -> md.PairPotential:
        """The potential of its pairs."""
        return next(one for one in self.potentials if isinstance(one, md.PairPotential))

    @property
    def scatter(self) -> float:
        """How far apart energies of engines may be after few steps because their random numbers differ [ε per atom]."""
        return SCATTER * self.temperature / sqrt(len(self.system)) if self.method.is_thermostat else 0.0


def _fluid(name: str, words: str, law: md.PairPotential, density: float, n: int) -> BenchScene:
    """4 n³ atoms on the fcc lattice, with the velocities of the melt.  words : begin its description."""
    positions, edges = crystal("fcc", [n] * 3, constant_from_density("fcc", density))
    system = _warm(md.System(positions, cell=edges, species=["A"] * len(positions)), MELT_TEMPERATURE)
    text = f"{words}: fcc at ρ* {density:g}, T* 1.44, r_c {law.cutoff:.3g} σ, {law.truncation}, Δt* 0.005, NVE"
    return BenchScene(name, text, system, (law,), MELT_TEMPERATURE)


def melt(n: int) -> BenchScene:
    """4 n³ atoms on the fcc lattice, with velocities at which it melts: LAMMPS' benchmark."""
    return _fluid(MELT, "Lennard-Jones melt", md.LennardJones(1.0, 1.0, CUTOFF, "truncated"), MELT_DENSITY, n)


def melt_npt(n: int) -> BenchScene:
    """The melt at constant temperature and pressure."""
    text = f"Lennard-Jones melt at constant pressure: T* 1.44, P* {PRESSURE:g}, r_c 2.5 σ, truncated, Δt* 0.005, NPT"
    bath = md.StochasticVelocityRescaling(TIMESTEP, MELT_TEMPERATURE, THERMOSTAT_TIME, SEED)
    barostat = md.StochasticCellRescaling(PRESSURE, COMPRESSIBILITY, BAROSTAT_TIME, SEED)
    return melt(n)._replace(name="npt", text=text, method=bath, barostat=barostat)


def droplet(n: int) -> BenchScene:
    """The 4 n³ atoms of a crystal that are nearest to its center, in the middle of a large cubic cell."""
    positions, edges = crystal("fcc", [2 * n] * 3, constant_from_density("fcc", LIQUID_DENSITY))
    distances = np.linalg.norm(positions - 0.5 * edges, axis=1)
    inside = np.sort(np.argsort(distances, kind="stable")[: 4 * n**3])
    cell = DROPLET_CELL * 2.0 * float(distances[inside].max())
    text = "Droplet in vacuum: T* 0.75, in a cell of 4 times its diameter, r_c 2.5 σ, shifted, Δt* 0.005, NVE"
    return _liquid("droplet", text, positions[inside] - 0.5 * edges, np.full(3, cell))


def slab(n: int) -> BenchScene:
    """4 n³ atoms on the fcc lattice, below and above them vacuum."""
    positions, edges = crystal("fcc", [n] * 3, constant_from_density("fcc", LIQUID_DENSITY))
    text = "Slab between vacuum: T* 0.75, in a cell of 4 times its thickness, r_c 2.5 σ, shifted, Δt* 0.005, NVE"
    return _liquid("slab", text, positions - 0.5 * edges, edges * (1.0, 1.0, SLAB_CELL))


def _liquid(name: str, text: str, positions: NDArray[np.float64], edges: NDArray[np.float64]) -> BenchScene:
    """Atoms about the center of a cell.  positions : (N, 3) relative to it.  edges : (3,) [σ]."""
    system = md.System(positions + 0.5 * edges, cell=edges, species=["A"] * len(positions))
    law = md.LennardJones(1.0, 1.0, CUTOFF)
    return BenchScene(name, text, _warm(system, LIQUID_TEMPERATURE), (law,), LIQUID_TEMPERATURE)


def kob_andersen(n: int) -> BenchScene:
    """4 n³ atoms on the fcc lattice, of two species distributed at random.

    W. Kob, H. C. Andersen, Phys. Rev. E 51, 4626 (1995).
    """
    positions, edges = crystal("fcc", [n] * 3, constant_from_density("fcc", MIXTURE_DENSITY))
    species = np.full(len(positions), "A")
    species[np.random.default_rng(SEED).permutation(len(positions))[: round(SMALL_FRACTION * len(positions))]] = "B"
    sigmas = {("A", "A"): MIXTURE["A"][1], ("A", "B"): UNLIKE[1], ("B", "B"): MIXTURE["B"][1]}
    cutoffs: dict[tuple[Label, Label], float] = {pair: CUTOFF * sigma for pair, sigma in sigmas.items()}
    law = md.LennardJones(MIXTURE, cutoff=cutoffs, pairs={("A", "B"): UNLIKE})
    text = "Kob-Andersen mixture: 80 % A and 20 % B, ρ* 1.2, T* 1.0, r_c 2.5 σ of each pair, shifted, Δt* 0.005, NVE"
    system = _warm(md.System(positions, cell=edges, species=species), MIXTURE_TEMPERATURE)
    return BenchScene("kob-andersen", text, system, (law,), MIXTURE_TEMPERATURE)


def chains(n: int) -> BenchScene:
    """Chains with harmonic springs, after the bead-spring model of K. Kremer, G. S. Grest, J. Chem. Phys. 92, 5057
    (1990)."""
    law = md.LennardJones(1.0, 1.0, CUTOFF, bonded_scale=(0.0, 1.0, 1.0))
    text = (
        "Chains of 100 beads: harmonic bonds (k* 400, length 1 σ), bonded neighbors excluded, ρ* 0.85, T* 1.0, r_c "
        "2.5 σ, shifted, Δt* 0.005, NVE"
    )
    potentials = (law, md.HarmonicBond(BOND_CONSTANT, BOND_LENGTH))
    return BenchScene("chains", text, _beads(n, CHAIN_DENSITY), potentials, CHAIN_TEMPERATURE)


def fene_chains(n: int) -> BenchScene:
    """LAMMPS' benchmark `chain`: the bead-spring model itself, in a bath."""
    law = md.LennardJones(1.0, 1.0, WCA_CUTOFF, bonded_scale=(0.0, 1.0, 1.0))
    text = (
        "LAMMPS' benchmark chain: 100 beads, FENE bonds (k* 30, R 1.5 σ), WCA, bonded neighbors excluded, ρ* 0.8442, "
        "T* 1.0, friction 0.1/τ, Δt* 0.012, Langevin"
    )
    bath = md.LangevinBAOAB(CHAIN_TIMESTEP, CHAIN_TEMPERATURE, FRICTION, SEED)
    system, bonds = _beads(n, MELT_DENSITY), md.FENEBond(FENE_CONSTANT, FENE_LONGEST)
    return BenchScene("chain", text, system, (law, bonds), CHAIN_TEMPERATURE, method=bath)


def _beads(n: int, density: float) -> md.System:
    """Nearly 4 n³ beads in chains of 100, along a path that winds through a simple cubic lattice."""
    width = round(cbrt(4 * n**3))  # lattice sites along an edge
    n_beads = width**3 // BEADS * BEADS
    if n_beads == 0:
        raise ValueError(
            f"a scene of chains needs at least {BEADS} sites, for one chain of {BEADS} beads; it has {width**3}"
        )
    edge = cbrt(n_beads / density)
    first = np.arange(n_beads - 1)
    first = first[(first + 1) % BEADS != 0]
    # a winding path: each site is the nearest neighbor of the one before
    z, y, x = np.unravel_index(np.arange(width**3), (width,) * 3)
    y, row = np.where(z % 2 == 0, y, width - 1 - y), np.arange(width**3) // width
    path = np.column_stack([np.where(row % 2 == 0, x, width - 1 - x), y, z]).astype(np.float64)
    positions, bonds = path[:n_beads] * (edge / width), np.column_stack([first, first + 1])
    return _warm(md.System(positions, cell=edge, species=["A"] * n_beads, bonds=bonds), CHAIN_TEMPERATURE)


def decane(n: int) -> BenchScene:
    """About 4 n³ united atoms in all-trans molecules side by side: TraPPE, with springs in place of its fixed bonds.

    M. G. Martin, J. I. Siepmann, J. Phys. Chem. B 102, 2569 (1998).
    """
    rise, amplitude = DECANE_BOND * np.sin(0.5 * DECANE_ANGLE), DECANE_BOND * np.cos(0.5 * DECANE_ANGLE)
    height = CARBONS * rise + 0.6  # σ, of a layer of molecules
    layers = max(2, round(cbrt(4 * n**3 / CARBONS / DECANE_DENSITY) / height))
    rows, apart = round(sqrt(4 * n**3 / CARBONS / layers)), 1.0 / sqrt(DECANE_DENSITY * height)
    corners = np.stack(np.meshgrid(*map(np.arange, (rows, rows, layers)), indexing="ij"), axis=-1).reshape(-1, 1, 3)
    carbon = np.arange(CARBONS)
    molecule = np.column_stack([amplitude * (carbon % 2), 0.0 * carbon, rise * carbon])
    positions = (corners * (apart, apart, height) + molecule).reshape(-1, 3)
    atoms = np.arange(len(positions)).reshape(-1, CARBONS)
    bonds, angles, dihedrals = (
        np.stack([atoms[:, k : CARBONS - size + 1 + k] for k in range(size)], axis=-1).reshape(-1, size)
        for size in (2, 3, 4)
    )
    is_end = np.isin(carbon, (0, CARBONS - 1))
    system = md.System(
        positions,
        masses=np.tile(np.where(is_end, METHYL_MASS, 1.0), len(atoms)),
        cell=np.array([rows * apart, rows * apart, layers * height]),
        species=np.tile(np.where(is_end, "CH3", "CH2"), len(atoms)),
        bonds=bonds,
        angles=angles,
        dihedrals=dihedrals,
    )
    potentials = (
        md.LennardJones(DECANE, cutoff=CUTOFF, bonded_scale=(0.0, 0.0, 0.0)),
        md.HarmonicBond(DECANE_SPRING, DECANE_BOND),
        md.HarmonicAngle(DECANE_BENDING, DECANE_ANGLE),
        md.OPLSDihedral(*DECANE_TORSION),
    )
    text = (
        "Decane of united atoms: TraPPE with harmonic bonds (k* 90 000), angles and torsions, 0.19 molecules per σ³, "
        "T* 6.5, r_c 2.5 σ, shifted, Δt* 0.0004, NVE"
    )
    warm, method = _warm(system, DECANE_TEMPERATURE), md.VelocityVerlet(DECANE_TIMESTEP)
    return BenchScene("decane", text, warm, potentials, DECANE_TEMPERATURE, method=method)


def dumbbells(n: int) -> BenchScene:
    """2 n³ dumbbells of two atoms at a fixed distance, their centers on the bcc lattice, in random directions."""
    centers, edges = crystal("bcc", [n] * 3, constant_from_density("bcc", DUMBBELL_DENSITY))
    rng = np.random.default_rng(SEED)
    arms = rng.normal(size=centers.shape)
    arms *= 0.5 * DUMBBELL_LENGTH / np.linalg.norm(arms, axis=1)[:, None]
    positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
    bonds = np.arange(len(positions)).reshape(-1, 2)
    system = md.System(positions, cell=edges, species=["A"] * len(positions), bonds=bonds)
    law = md.LennardJones(1.0, 1.0, CUTOFF, "truncated", bonded_scale=(0.0, 1.0, 1.0))
    text = "Rigid dumbbells: two atoms 0.6 σ apart, 0.4 molecules per σ³, T* 1.5, r_c 2.5 σ, truncated, Δt* 0.005, NVE"
    rigid = md.DistanceConstraints(bonds, DUMBBELL_LENGTH)
    return BenchScene("dumbbells", text, _warm(system, DUMBBELL_TEMPERATURE), (law,), DUMBBELL_TEMPERATURE, (rigid,))


def triangles(n: int) -> BenchScene:
    """About 4 n³ / 3 rigid triangles, all turned alike, on the fcc lattice: ortho-terphenyl.

    L. J. Lewis, G. Wahnström, Phys. Rev. E 50, 3865 (1994).
    """
    centers, edges = crystal("fcc", [round(cbrt(n**3 / 3))] * 3, constant_from_density("fcc", TRIANGLE_DENSITY))
    side, along = np.sin(0.5 * TRIANGLE_ANGLE) * np.eye(3)[1], np.cos(0.5 * TRIANGLE_ANGLE) * np.sqrt([0.5, 0.0, 0.5])
    positions = (centers[:, None] + np.stack([np.zeros(3), along + side, along - side])).reshape(-1, 3)
    tips = np.arange(0, len(positions), 3)[:, None, None]
    sides, third = (tips + np.array([[0, 1], [0, 2]])).reshape(-1, 2), (tips + np.array([[1, 2]])).reshape(-1, 2)
    system = md.System(positions, cell=edges, species=["A"] * len(positions), bonds=sides)
    lengths = np.repeat([1.0, 2.0 * np.sin(0.5 * TRIANGLE_ANGLE)], [len(sides), len(third)])
    rigid = md.DistanceConstraints(np.concatenate([sides, third]), lengths)
    law = md.LennardJones(1.0, 1.0, CUTOFF, bonded_scale=(0.0, 0.0, 1.0))
    text = (
        "Rigid triangles, as water without charges: three alike sites, sides of 1 σ at 75°, 0.3187 molecules per σ³, "
        "T* 1.0, r_c 2.5 σ, shifted, friction 0.1/τ, Δt* 0.005, Langevin"
    )
    bath = md.LangevinBAOAB(TIMESTEP, TRIANGLE_TEMPERATURE, FRICTION, SEED)
    warm = _warm(system, TRIANGLE_TEMPERATURE)
    return BenchScene("triangles", text, warm, (law,), TRIANGLE_TEMPERATURE, (rigid,), bath)


SCENES: dict[str, Callable[[int], BenchScene]] = {
    MELT: melt,
    "cutoff-4": partial(_fluid, "cutoff-4", "Long cutoff", md.LennardJones(1.0, 1.0, 4.0), MELT_DENSITY),
    "wca": partial(_fluid, "wca", "WCA fluid", md.LennardJones(1.0, 1.0, WCA_CUTOFF), MELT_DENSITY),
    "kob-andersen": kob_andersen,
    "gas": partial(_fluid, "gas", "Gas", md.LennardJones(1.0, 1.0, CUTOFF), GAS_DENSITY),
    "droplet": droplet,
    "slab": slab,
    "npt": melt_npt,
    "chains": chains,
    "chain": fene_chains,
    "decane": decane,
    "dumbbells": dumbbells,
    "triangles": triangles,
}


def equilibrated(scene: BenchScene) -> BenchScene:
    """The scene after a short run at its temperature and volume."""
    method = md.VelocityVerlet(scene.method.timestep)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on a lattice no pair may be in range, and rigid bonds have random velocities
        simulation = md.Simulation(scene.system, scene.potentials, method, scene.constraints)
        simulation.equilibrate(EQUILIBRATION, scene.temperature, progress=False)
    return scene._replace(system=simulation.system)


def pairs_in_range(scene: BenchScene, positions: NDArray[np.float64]) -> int:
    """Number of pairs of atoms within their cutoff on which the pair potential acts:
    without bonded pairs if it excludes them. Pairs two and three bonds apart are counted.

    positions : (N, 3) [σ], of the atoms of the scene at any time. The cell must be wider than twice the cutoff,
        or open.
    """
    box = None
    if scene.system.cell.is_periodic:
        box, positions = scene.edges, positions % scene.edges
        positions[positions >= scene.edges] = 0.0  # rounding of small negative numbers
    names = scene.system.species_names
    trees = [cKDTree(positions[scene.system.species == name], boxsize=box) for name in names]
    cutoffs = np.sqrt(np.broadcast_to(scene.law.table(names)[:, :, 0], (len(names),) * 2))
    count = 0
    for a, b in combinations_with_replacement(range(len(names)), 2):
        both_ways = trees[a].count_neighbors(trees[b], cutoffs[a, b])
        count += (both_ways - trees[a].n) // 2 if a == b else both_ways
    return int(count) - (scene.law.bonded_scale[0] == 0.0) * len(scene.system.bonds)


def _warm(system: md.System, temperature: float) -> md.System:
    """The same system, with velocities drawn at a temperature."""
    system.velocities[:] = maxwell_boltzmann(system.masses, temperature, system.units.k_B, SEED)
    return system
