"""The scenes of the benchmark, in reduced Lennard-Jones units: a melt, a mixture, chains of beads, rigid dumbbells.

Each is a function of a number n, and has 4 n³ atoms, or nearly as many.
"""

from collections.abc import Callable, Mapping
from itertools import combinations_with_replacement
from math import cbrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import minimd as md
from minimd.forces.forces import Potential
from minimd.potentials.pair import Label, PairPotential
from minimd.structure.lattice import constant_from_density, crystal
from minimd.structure.velocities import maxwell_boltzmann

MELT = "melt"
SEED = 87287
TIMESTEP = 0.005  # τ
CUTOFF = 2.5  # σ of the pair
CUTOFFS: Mapping[tuple[Label, Label], float] = {("A", "A"): CUTOFF}
SHIFT = 4.0 * (CUTOFF**-12 - CUTOFF**-6)  # u(r_c) [ε] of Lennard-Jones, which a shifted potential subtracts
EQUILIBRATION = 500  # steps: 2.5 τ, in which a crystal at these temperatures melts

MELT_DENSITY, MELT_TEMPERATURE = 0.8442, 1.44  # of LAMMPS' benchmark

MIXTURE_DENSITY, MIXTURE_TEMPERATURE = 1.2, 1.0
MIXTURE: Mapping[Label, tuple[float, float]] = {"A": (1.0, 1.0), "B": (0.5, 0.88)}  # ε, σ
UNLIKE = (1.5, 0.8)
SMALL_FRACTION = 0.2  # of species B

CHAIN_DENSITY, CHAIN_TEMPERATURE = 0.85, 1.0
BEADS = 100  # in a chain
BOND_CONSTANT, BOND_LENGTH = 400.0, 1.0

DUMBBELL_DENSITY, DUMBBELL_TEMPERATURE = 0.4, 1.5  # molecules per σ³
DUMBBELL_LENGTH = 0.6


class BenchScene(NamedTuple):
    """A system with its potentials; bonded neighbors have no pair force.

    cutoffs : r_c for each pair of species [σ].  text : a description in one line.  constraints : lengths held fixed.
    bond_constant, bond_length : of its bonds [ε/σ²], [σ].  is_shifted : whether u(r_c) = 0. Peers use these numbers,
        not the potentials.
    """

    name: str
    text: str
    system: md.System
    potentials: tuple[Potential, ...]
    cutoffs: Mapping[tuple[Label, Label], float]
    temperature: float
    constraints: tuple[md.DistanceConstraints, ...] = ()
    bond_constant: float = 0.0
    bond_length: float = 0.0
    is_shifted: bool = False

    @property
    def edges(self) -> NDArray[np.float64]:
        """(3,) of the cell, which is rectangular [σ]."""
        return np.diag(self.system.cell.vectors)


def melt(n: int) -> BenchScene:
    """4 n³ atoms on the fcc lattice, with velocities at which it melts: LAMMPS' benchmark."""
    positions, edges = crystal("fcc", [n] * 3, constant_from_density("fcc", MELT_DENSITY))
    text = "Lennard-Jones melt: fcc at ρ* 0.8442, T* 1.44, r_c 2.5 σ, truncated, Δt* 0.005, NVE"
    system = _warm(md.System(positions, cell=edges, species=["A"] * len(positions)), MELT_TEMPERATURE)
    return BenchScene(
        "melt", text, system, (md.LennardJones(1.0, 1.0, CUTOFF, "truncated"),), CUTOFFS, MELT_TEMPERATURE
    )


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
    return BenchScene("kob-andersen", text, system, (law,), cutoffs, MIXTURE_TEMPERATURE)


def chains(n: int) -> BenchScene:
    """Nearly 4 n³ beads in chains of 100, along a path that winds through a simple cubic lattice.

    After the bead-spring model of K. Kremer, G. S. Grest, J. Chem. Phys. 92, 5057 (1990), with harmonic springs.
    """
    width = round(cbrt(4 * n**3))  # lattice sites along an edge
    n_beads = width**3 // BEADS * BEADS
    if n_beads == 0:
        raise ValueError(
            f"a scene of chains needs at least {BEADS} sites, for one chain of {BEADS} beads; it has {width**3}"
        )
    edge = cbrt(n_beads / CHAIN_DENSITY)
    first = np.arange(n_beads - 1)
    first = first[(first + 1) % BEADS != 0]
    z, y, x = np.unravel_index(
        np.arange(width**3), (width,) * 3
    )  # a winding path: each site is the nearest neighbor of the one before
    y, row = np.where(z % 2 == 0, y, width - 1 - y), np.arange(width**3) // width
    path = np.column_stack([np.where(row % 2 == 0, x, width - 1 - x), y, z]).astype(np.float64)
    positions, bonds = path[:n_beads] * (edge / width), np.column_stack([first, first + 1])
    system = md.System(positions, cell=edge, species=["A"] * n_beads, bonds=bonds)
    law = md.LennardJones(1.0, 1.0, CUTOFF, bonded_scale=(0.0, 1.0, 1.0))
    text = (
        "Chains of 100 beads: harmonic bonds (k* 400, length 1 σ), bonded neighbors excluded, ρ* 0.85, T* 1.0, r_c "
        "2.5 σ, shifted, Δt* 0.005, NVE"
    )
    potentials = (law, md.HarmonicBond(BOND_CONSTANT, BOND_LENGTH))
    return BenchScene(
        "chains",
        text,
        _warm(system, CHAIN_TEMPERATURE),
        potentials,
        CUTOFFS,
        CHAIN_TEMPERATURE,
        (),
        BOND_CONSTANT,
        BOND_LENGTH,
        True,
    )


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
    return BenchScene(
        "dumbbells",
        text,
        _warm(system, DUMBBELL_TEMPERATURE),
        (law,),
        CUTOFFS,
        DUMBBELL_TEMPERATURE,
        (rigid,),
        0.0,
        DUMBBELL_LENGTH,
    )


SCENES: dict[str, Callable[[int], BenchScene]] = {
    "melt": melt,
    "kob-andersen": kob_andersen,
    "chains": chains,
    "dumbbells": dumbbells,
}


def equilibrated(scene: BenchScene) -> BenchScene:
    """The scene after a short run at its temperature."""
    simulation = md.Simulation(scene.system, scene.potentials, md.VelocityVerlet(TIMESTEP), scene.constraints)
    simulation.equilibrate(EQUILIBRATION, scene.temperature, progress=False)
    return scene._replace(system=simulation.system)


def pairs_in_range(scene: BenchScene, positions: NDArray[np.float64]) -> int:
    """Number of pairs of atoms within their cutoff on which the pair potential acts:
    without bonded pairs if it excludes them.

    positions : (N, 3) [σ], of the atoms of the scene at any time. The cell must be wider than twice the cutoff,
        or open.
    """
    box = None
    if scene.system.cell.is_periodic:
        box, positions = scene.edges, positions % scene.edges
        positions[positions >= scene.edges] = 0.0  # rounding of small negative numbers
    species = scene.system.species
    trees = {name: cKDTree(positions[species == name], boxsize=box) for name in scene.system.species_names}
    count = 0
    for a, b in combinations_with_replacement(trees, 2):
        both_ways = trees[a].count_neighbors(trees[b], scene.cutoffs[(a, b) if (a, b) in scene.cutoffs else (b, a)])
        count += (both_ways - trees[a].n) // 2 if a == b else both_ways
    excludes = any(isinstance(law, PairPotential) and law.bonded_scale[0] == 0.0 for law in scene.potentials)
    return int(count) - excludes * len(scene.system.bonds)


def _warm(system: md.System, temperature: float) -> md.System:
    """The same system, with velocities drawn at a temperature."""
    system.velocities[:] = maxwell_boltzmann(system.masses, temperature, system.units.k_B, SEED)
    return system
