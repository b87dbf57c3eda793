"""The scenes of the benchmark: fluids, droplet and slab, chains, rigid molecules, in reduced units; water, in Å and eV.

Each is a function of a number n in SCENES: it has 4 n³ atoms, or nearly as many. All but water are rows of PLANS.
"""

import warnings
from collections.abc import Callable
from functools import partial
from itertools import combinations_with_replacement
from math import cbrt, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial import cKDTree

import minimd as md
from minimd.core.console.quiet import quiet
from minimd.core.forces.forces import Potential
from minimd.core.potentials.embedded_files import EmbeddedTables
from minimd.core.potentials.pair import Nonbonded
from minimd.core.potentials.truncation import TruncationName
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.lattice import constant_from_density, crystal
from minimd.core.structure.observables import maxwell_boltzmann

MELT = "melt"
SEED = 87287
TIMESTEP = 0.005  # τ
CUTOFF = 2.5  # σ of the pair
# u(r_c) [ε] of Lennard-Jones, which a shifted potential subtracts
SHIFT = 4.0 * (CUTOFF**-12 - CUTOFF**-6)
WCA_CUTOFF = 2.0 ** (1.0 / 6.0)  # σ, the minimum of Lennard-Jones
SKIN_LAMMPS = 0.3  # σ, as in LAMMPS' benchmark
# k_B T per √atom: twice the standard deviation between total energies of two independent liquids
SCATTER = 5.0
EQUILIBRATION = 500  # steps: 2.5 τ, in which a crystal at these temperatures melts

# of LAMMPS' benchmark
MELT_DENSITY = 0.8442
MELT_TEMPERATURE = 1.44
# of droplet and slab
LIQUID_DENSITY = 0.8
LIQUID_TEMPERATURE = 0.75
WIDER = 4.0  # the cell of droplet and slab, in diameters of the droplet and thicknesses of the slab
BEADS = 100  # in a chain
BOND_CONSTANT = 400.0
BOND_LENGTH = 1.0
# 1/τ, τ, of LAMMPS' benchmark
FRICTION = 0.1
CHAIN_TIMESTEP = 0.012
DUMBBELL_LENGTH = 0.6
TRIANGLE_ANGLE = np.radians(75.0)  # between its sides of 1 σ

# Units of decane are 46 K, 3.95 Å and the mass of CH2.
DECANE_DENSITY = 0.19  # molecules per σ³: 0.73 g/cm³
CARBONS = 10
METHYL_MASS = 15.035 / 14.027
DECANE_BOND = 1.54 / 3.95
DECANE_ANGLE = np.radians(114.0)

# largest errors of the forces of charges, of their rms, by scene; cutoffs [Å] that each engine tries
WATER = {"water": 2.5e-4, "water-fine": 1e-5}
COPPER = "copper"
WATER_CUTOFFS = (7.0, 8.0, 9.0, 10.0, 12.0)
COULOMB_KJ_NM = 138.9354576  # k_e [kJ nm/(mol e²)], in OpenMM and GROMACS
EXACT = 1e-9  # accuracy of the sum with which errors are found


class BenchScene(NamedTuple):
    """A system with its potentials, and how its steps are made.
    text : a description in one line.
    constraints : lengths held fixed.
    method : with its time step and bath.
    error : the largest of the forces of charges, of their rms; 0 without charges.
    accuracy : asked for with charges.
    """

    name: str
    text: str
    system: md.System
    potentials: tuple[Potential, ...]
    temperature: float
    constraints: tuple[md.DistanceConstraints, ...] = ()
    method: md.integrators.Splitting = md.VelocityVerlet(TIMESTEP)
    barostat: md.StochasticCellRescaling | None = None
    error: float = 0.0
    accuracy: float = 1e-3

    @property
    def edges(self) -> Array:
        """(3,) of the cell, which is rectangular [σ]."""
        return np.diag(self.system.cell.vectors)

    @property
    def law(self) -> Nonbonded:
        """The potential of its pairs."""
        return next(law for law in self.potentials if isinstance(law, Nonbonded))

    @property
    def scatter(self) -> float:
        """How far apart energies of engines may be after few steps because random numbers differ [k_B T per atom]."""
        return SCATTER / sqrt(len(self.system)) if self.method.is_thermostat else 0.0

    def cut(self, cutoff: float, accuracy: float) -> "BenchScene":
        """Water with both laws cut at a distance [Å], and charges summed to an accuracy."""
        wells: Any = self.law.parameters
        scale = self.law.bonded_scale
        law = md.LennardJones(wells, None, cutoff, "truncated", bonded_scale=scale)
        return self._replace(potentials=(law, md.Coulomb(cutoff, accuracy)), accuracy=accuracy)


class Plan(NamedTuple):
    """A scene before it has atoms.
    build : makes them from n, without velocities.
    rigid : lengths held fixed."""

    text: str
    build: Callable[[int], md.System]
    potentials: tuple[Potential, ...]
    temperature: float = MELT_TEMPERATURE
    method: md.integrators.Splitting = md.VelocityVerlet(TIMESTEP)
    barostat: md.StochasticCellRescaling | None = None
    rigid: Callable[[md.System], md.DistanceConstraints] | None = None


def _atoms(positions: Array, cell: Array | float, **more: Any) -> md.System:
    return md.System(positions, cell=cell, **{"species": ["A"] * len(positions)} | more)


def _lattice(n: int, density: float, kind: str = "fcc") -> tuple[Array, Array]:
    return crystal(kind, [n] * 3, constant_from_density(kind, density))


def _fluid(density: float, n: int) -> md.System:
    """4 n³ atoms on the fcc lattice."""
    return _atoms(*_lattice(n, density))


def _droplet(n: int) -> md.System:
    """The 4 n³ atoms of a crystal that are nearest to its center, in the middle of a large cubic cell."""
    positions, edges = _lattice(2 * n, LIQUID_DENSITY)
    distances = np.linalg.norm(positions - 0.5 * edges, axis=1)
    inside = np.sort(np.argsort(distances, kind="stable")[: 4 * n**3])
    cell = np.full(3, WIDER * 2.0 * distances[inside].max())
    return _atoms(positions[inside] - 0.5 * edges + 0.5 * cell, cell)


def _slab(n: int) -> md.System:
    """4 n³ atoms on the fcc lattice, below and above them vacuum."""
    positions, edges = _lattice(n, LIQUID_DENSITY)
    cell = edges * (1.0, 1.0, WIDER)
    return _atoms(positions - 0.5 * edges + 0.5 * cell, cell)


def _mixture(n: int) -> md.System:
    """4 n³ atoms on the fcc lattice, of two species distributed at random, a fifth of them B."""
    positions, edges = _lattice(n, 1.2)
    n_atoms = len(positions)
    shuffled = np.random.default_rng(SEED).permutation(n_atoms)
    species = np.full(n_atoms, "A")
    species[shuffled[: round(0.2 * n_atoms)]] = "B"
    return _atoms(positions, edges, species=species)


def _beads(density: float, n: int) -> md.System:
    """Nearly 4 n³ beads in chains of 100, along a path that winds through a simple cubic lattice."""
    width = round(cbrt(4 * n**3))  # lattice sites along an edge
    n_sites = width**3
    n_beads = n_sites // BEADS * BEADS
    if n_beads == 0:
        raise ValueError(
            f"a scene of chains needs at least {BEADS} sites, for one chain of {BEADS} beads; it has {n_sites}"
        )
    edge = cbrt(n_beads / density)
    # a winding path: each site is the nearest neighbor of the one before
    z, y, x = np.indices((width,) * 3).reshape(3, -1)
    row = z * width + y
    x = np.where(row % 2 == 0, x, width - 1 - x)
    y = np.where(z % 2 == 0, y, width - 1 - y)
    path = np.column_stack([x, y, z])[:n_beads]
    chains = np.arange(n_beads).reshape(-1, BEADS)
    return _atoms(path * (edge / width), edge, bonds=_runs(chains, 2))


def _runs(molecules: Indices, size: int) -> Indices:
    """All runs of neighboring atoms in chains, (K, size).
    molecules : (M, L), the atoms of each."""
    return sliding_window_view(molecules, size, axis=1).reshape(-1, size)


def _decane(n: int) -> md.System:
    """About 4 n³ united atoms in all-trans molecules side by side."""
    rise = DECANE_BOND * np.sin(0.5 * DECANE_ANGLE)
    amplitude = DECANE_BOND * np.cos(0.5 * DECANE_ANGLE)
    height = CARBONS * rise + 0.6  # σ, of a layer of molecules
    layers = max(2, round(cbrt(4 * n**3 / CARBONS / DECANE_DENSITY) / height))
    rows = round(sqrt(4 * n**3 / CARBONS / layers))
    apart = 1.0 / sqrt(DECANE_DENSITY * height)
    spacing = np.array([apart, apart, height])
    counts = (rows, rows, layers)
    corners = np.indices(counts).reshape(3, -1).T * spacing
    carbon = np.arange(CARBONS)
    molecule = np.column_stack([amplitude * (carbon % 2), 0.0 * carbon, rise * carbon])
    positions = (corners[:, None] + molecule).reshape(-1, 3)
    atoms = np.arange(len(positions)).reshape(-1, CARBONS)
    is_end = np.tile(np.isin(carbon, (0, CARBONS - 1)), len(atoms))
    return _atoms(
        positions,
        spacing * counts,
        bonds=_runs(atoms, 2),
        angles=_runs(atoms, 3),
        dihedrals=_runs(atoms, 4),
        masses=np.where(is_end, METHYL_MASS, 1.0),
        species=np.where(is_end, "CH3", "CH2"),
    )


def _dumbbells(n: int) -> md.System:
    """2 n³ dumbbells of two atoms at a fixed distance, their centers on the bcc lattice, in random directions."""
    centers, edges = _lattice(n, 0.4, "bcc")
    arms = np.random.default_rng(SEED).normal(size=centers.shape)
    arms *= 0.5 * DUMBBELL_LENGTH / np.linalg.norm(arms, axis=1)[:, None]
    positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
    pairs = np.arange(len(positions)).reshape(-1, 2)
    return _atoms(positions, edges, bonds=pairs)


def _triangles(n: int) -> md.System:
    """About 4 n³ / 3 triangles, all turned alike, on the fcc lattice; bonds are the two equal sides."""
    centers, edges = _lattice(round(cbrt(n**3 / 3)), 0.3187)  # molecules per σ³: 1.08 g/cm³
    side = np.sin(0.5 * TRIANGLE_ANGLE) * np.eye(3)[1]
    along = np.cos(0.5 * TRIANGLE_ANGLE) * np.sqrt([0.5, 0.0, 0.5])
    triangle = np.stack([np.zeros(3), along + side, along - side])
    positions = (centers[:, None] + triangle).reshape(-1, 3)
    sites = np.arange(len(positions)).reshape(-1, 3)
    sides = sites[:, [0, 1, 0, 2]].reshape(-1, 2)
    return _atoms(positions, edges, bonds=sides)


def _rigid_triangles(system: md.System) -> md.DistanceConstraints:
    third = system.bonds[:, 1].reshape(-1, 2)
    pairs = np.concatenate([system.bonds, third])
    base = 2.0 * np.sin(0.5 * TRIANGLE_ANGLE)
    lengths = np.repeat([1.0, base], [len(system.bonds), len(third)])
    return md.DistanceConstraints(pairs, lengths)


def lennard_jones(
    cutoff: float = CUTOFF,
    truncation: TruncationName = "shifted",
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> md.LennardJones:
    """The law of most scenes, with factors for pairs one, two and three bonds apart."""
    return md.LennardJones(1.0, 1.0, cutoff, truncation, bonded_scale=scale)


UNBONDED = (0.0, 1.0, 1.0)
SHIFTED = lennard_jones()
TRUNCATED = lennard_jones(CUTOFF, "truncated")
KOB_ANDERSEN = md.LennardJones(
    {"A": (1.0, 1.0), "B": (0.5, 0.88)},
    pairs={("A", "B"): (1.5, 0.8)},
    cutoff={
        ("A", "A"): CUTOFF,
        ("A", "B"): CUTOFF * 0.8,
        ("B", "B"): CUTOFF * 0.88,
    },
)
DECANE = (
    md.LennardJones(
        {"CH3": (98 / 46, 3.75 / 3.95), "CH2": (1.0, 1.0)},
        cutoff=CUTOFF,
        bonded_scale=(0.0, 0.0, 0.0),
    ),
    md.HarmonicBond(9e4, DECANE_BOND),  # TraPPE itself holds its bonds fixed
    md.HarmonicAngle(62500 / 46, DECANE_ANGLE),
    md.OPLSDihedral(2 * 355.03 / 46, -2 * 68.19 / 46, 2 * 791.32 / 46),
)
PLANS = {
    # LAMMPS' benchmark
    MELT: Plan(
        "Lennard-Jones melt: fcc at ρ* 0.8442, T* 1.44, r_c 2.5 σ, truncated, Δt* 0.005, NVE",
        partial(_fluid, MELT_DENSITY),
        (TRUNCATED,),
    ),
    "cutoff-4": Plan(
        "Long cutoff: fcc at ρ* 0.8442, T* 1.44, r_c 4 σ, shifted, Δt* 0.005, NVE",
        partial(_fluid, MELT_DENSITY),
        (lennard_jones(4.0),),
    ),
    "wca": Plan(
        "WCA fluid: fcc at ρ* 0.8442, T* 1.44, r_c 1.12 σ, shifted, Δt* 0.005, NVE",
        partial(_fluid, MELT_DENSITY),
        (lennard_jones(WCA_CUTOFF),),
    ),
    # W. Kob, H. C. Andersen, Phys. Rev. E 51, 4626 (1995)
    "kob-andersen": Plan(
        "Kob-Andersen mixture: 80 % A and 20 % B, ρ* 1.2, T* 1.0, r_c 2.5 σ of each pair, shifted, Δt* 0.005, NVE",
        _mixture,
        (KOB_ANDERSEN,),
        1.0,
    ),
    "gas": Plan(
        "Gas: fcc at ρ* 0.01, T* 1.44, r_c 2.5 σ, shifted, Δt* 0.005, NVE",
        partial(_fluid, 0.01),
        (SHIFTED,),
    ),
    "droplet": Plan(
        "Droplet in vacuum: T* 0.75, in a cell of 4 times its diameter, r_c 2.5 σ, shifted, Δt* 0.005, NVE",
        _droplet,
        (SHIFTED,),
        LIQUID_TEMPERATURE,
    ),
    "slab": Plan(
        "Slab between vacuum: T* 0.75, in a cell of 4 times its thickness, r_c 2.5 σ, shifted, Δt* 0.005, NVE",
        _slab,
        (SHIFTED,),
        LIQUID_TEMPERATURE,
    ),
    # pressure and compressibility are about those of the melt itself
    "npt": Plan(
        "Lennard-Jones melt at constant pressure: T* 1.44, P* 5, r_c 2.5 σ, truncated, Δt* 0.005, NPT",
        partial(_fluid, MELT_DENSITY),
        (TRUNCATED,),
        method=md.StochasticVelocityRescaling(TIMESTEP, MELT_TEMPERATURE, 0.5, SEED),
        barostat=md.StochasticCellRescaling(5.0, 0.03, 5.0, SEED),
    ),
    # after the bead-spring model of K. Kremer, G. S. Grest, J. Chem. Phys. 92, 5057 (1990)
    "chains": Plan(
        "Chains of 100 beads: harmonic bonds (k* 400, length 1 σ), bonded neighbors excluded, ρ* 0.85, T* 1.0, r_c "
        "2.5 σ, shifted, Δt* 0.005, NVE",
        partial(_beads, 0.85),
        (lennard_jones(scale=UNBONDED), md.HarmonicBond(BOND_CONSTANT, BOND_LENGTH)),
        1.0,
    ),
    # that model itself
    "chain": Plan(
        "LAMMPS' benchmark chain: 100 beads, FENE bonds (k* 30, R 1.5 σ), WCA, bonded neighbors excluded, ρ* 0.8442, "
        "T* 1.0, friction 0.1/τ, Δt* 0.012, Langevin",
        partial(_beads, MELT_DENSITY),
        (lennard_jones(WCA_CUTOFF, scale=UNBONDED), md.FENEBond(30.0, 1.5)),
        1.0,
        md.LangevinBAOAB(CHAIN_TIMESTEP, 1.0, FRICTION, SEED),
    ),
    # TraPPE, at 300 K and with a time step of 1 fs: M. G. Martin, J. I. Siepmann, J. Phys. Chem. B 102, 2569 (1998)
    "decane": Plan(
        "Decane of united atoms: TraPPE with harmonic bonds (k* 90 000), angles and torsions, 0.19 molecules per σ³, "
        "T* 6.5, r_c 2.5 σ, shifted, Δt* 0.0004, NVE",
        _decane,
        DECANE,
        6.5,
        md.VelocityVerlet(0.0004),
    ),
    "dumbbells": Plan(
        "Rigid dumbbells: two atoms 0.6 σ apart, 0.4 molecules per σ³, T* 1.5, r_c 2.5 σ, truncated, Δt* 0.005, NVE",
        _dumbbells,
        (lennard_jones(CUTOFF, "truncated", UNBONDED),),
        1.5,
        rigid=lambda system: md.DistanceConstraints(system.bonds, DUMBBELL_LENGTH),
    ),
    # ortho-terphenyl: L. J. Lewis, G. Wahnström, Phys. Rev. E 50, 3865 (1994)
    "triangles": Plan(
        "Rigid triangles, as water without charges: three alike sites, sides of 1 σ at 75°, 0.3187 molecules per σ³, "
        "T* 1.0, r_c 2.5 σ, shifted, friction 0.1/τ, Δt* 0.005, Langevin",
        _triangles,
        (lennard_jones(scale=(0.0, 0.0, 1.0)),),
        1.0,
        md.LangevinBAOAB(TIMESTEP, 1.0, FRICTION, SEED),
        rigid=_rigid_triangles,
    ),
}


def _planned(name: str, n: int) -> BenchScene:
    """The scene of a plan, with velocities drawn at its temperature."""
    text, build, potentials, heat, method, barostat, rigid = PLANS[name]
    system = build(n)
    system.velocities[:] = maxwell_boltzmann(system.masses, heat, system.units.k_B, SEED)
    constraints = () if rigid is None else (rigid(system),)
    return BenchScene(name, text, system, potentials, heat, constraints, method, barostat)


def _water(name: str, n: int) -> BenchScene:
    """n³ molecules on the simple cubic lattice, turned at random."""
    with quiet():  # a shorter cutoff in a small box is meant
        system, potentials, rigid = md.water("SPC/E", n**3)
    error = WATER[name]
    text = (
        f"Rigid SPC/E water: 298 K, measured errors of the forces of charges of at most {error:g} of their rms, "
        "both laws cut at the one of 7, 8, 9, 10 and 12 Å with which an engine is fastest, Δt 2 fs, NVE"
    )
    method = md.VelocityVerlet(2.0 * md.units.fs)
    laws = tuple(potentials)
    scene = BenchScene(
        name,
        text,
        system,
        laws,
        298.0,
        (rigid,),
        method,
        error=error,
    )
    return scene.cut(scene.law.cutoff, error)


def copper_tables() -> EmbeddedTables:
    """Tables of copper with 500 points and the cutoff of the file in LAMMPS' benchmark in.eam: the law of F. Cleri and
    V. Rosato (1993), switched off from 4.5 Å on."""
    cutoff = 4.95
    r = 0.01 * np.arange(500)
    rho = 0.1 * np.arange(500)
    x = np.clip((cutoff - r) / 0.45, 0.0, 1.0)
    switch = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    density = 1.224**2 * np.exp(-4.556 * (r / 2.556 - 1.0)) * switch
    pair = 0.171 * np.exp(-10.96 * (r / 2.556 - 1.0)) * switch
    functions = -np.sqrt(rho)[None], density[None, None], (r * pair)[None, None]
    return EmbeddedTables("copper", ("Cu",), np.array([63.546]), 0.1, 0.01, cutoff, *functions)


def _copper(n: int) -> BenchScene:
    """4 n³ atoms on the fcc lattice, as in LAMMPS' benchmark in.eam."""
    heat = 1600.0
    positions, edges = _lattice(n, 4.0 / 3.615**3)
    species = ["Cu"] * len(positions)
    mass = float(copper_tables().masses[0])
    system = md.System(positions, cell=edges, species=species, masses=mass, units=md.units.ASE)
    system.velocities[:] = maxwell_boltzmann(system.masses, heat, system.units.k_B, SEED)
    text = "Copper, embedded atoms from tables of 500 points: fcc, 1600 K, r_c 4.95 Å, Δt 5 fs, NVE"
    method = md.VelocityVerlet(5.0 * md.units.fs)
    return BenchScene(
        COPPER, text, system, (md.EmbeddedAtom.of_tables(copper_tables()),), heat, (), method
    )


SCENES: dict[str, Callable[[int], BenchScene]] = {}
SCENES |= {name: partial(_planned, name) for name in PLANS}
SCENES[COPPER] = _copper
SCENES |= {name: partial(_water, name) for name in WATER}
melt = SCENES[MELT]


def equilibrated(scene: BenchScene) -> BenchScene:
    """The scene after a short run at its temperature and volume."""
    method = md.VelocityVerlet(scene.method.timestep)
    with warnings.catch_warnings():
        # on a lattice no pair may be in range, and rigid bonds have random velocities
        warnings.simplefilter("ignore")
        simulation = md.Simulation(scene.system, scene.potentials, method, scene.constraints)
        simulation.equilibrate(EQUILIBRATION, scene.temperature, progress=False)
    return scene._replace(system=simulation.system)


def pairs_in_range(scene: BenchScene, positions: Array) -> int:
    """Number of pairs of atoms within their cutoff on which the pair potential acts: without bonded pairs if it
    excludes them. Pairs two and three bonds apart are counted.
    positions : (N, 3) [σ], of the atoms of the scene at any time. The cell must be wider than twice the cutoff,
        or open."""
    box = None
    places = positions
    if scene.system.cell.is_periodic:
        box = scene.edges
        places = positions % box
        places[places >= box] = 0.0  # by rounding

    names = scene.system.species_names
    trees = [cKDTree(places[scene.system.species == name], boxsize=box) for name in names]
    cutoffs = np.sqrt(scene.law.table(names)[:, :, 0])
    cutoffs = np.broadcast_to(cutoffs, (len(names), len(names)))
    count = 0
    for a, b in combinations_with_replacement(range(len(names)), 2):
        both_ways = trees[a].count_neighbors(trees[b], cutoffs[a, b])
        count += (both_ways - trees[a].n) // 2 if a == b else both_ways
    if scene.law.bonded_scale[0] == 0.0:
        count -= len(scene.system.bonds)
    return int(count)
