"""Rigid water of three or four sites and ions in it, by the name of its model: box, charges, laws, constraints."""

from collections.abc import Mapping
from math import ceil, cos, radians, sin
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.quiet import warn
from minimd.core.console.words import listed, shown
from minimd.core.neighbors.queries import neighbor_list
from minimd.core.potentials.coulomb import Coulomb
from minimd.core.potentials.pair import LennardJones
from minimd.core.potentials.term import OwnPotential
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import checked_choice, checked_count, checked_kind, checked_number
from minimd.core.structure.constraints import DistanceConstraints, FixedAtoms
from minimd.core.structure.lattice import BASES, crystal
from minimd.core.structure.sites import Sites
from minimd.core.structure.system import MOST_ATOMS, System, changed
from minimd.core.structure.units import ASE, GRAM_PER_CM3, KJ_PER_MOL_PER_EV

MASSES = (15.9994, 1.008, 1.008)  # u
KCAL = 4.184  # kJ
OH = 1.3  # Å: hydrogens of other molecules are farther away, in hydrogen bonds 1.6 Å and more
CUTOFF, OF_BOX = 9.0, 0.45  # default cutoff [Å], and the most of the edge of the box that it takes
SWITCH_FROM = 0.9  # of the cutoff
RigidWater = tuple[System, list[OwnPotential], DistanceConstraints]


class Model(NamedTuple):
    """length : of O-H [Å].
    angle : H-O-H [degrees].
    charge : of H [e].
    epsilon, sigma : of O [kJ/mol], [Å].
    offset : of M from O, towards the middle of the two H [Å]: a massless site with the charge of O; 0 without it."""

    length: float
    angle: float
    charge: float
    epsilon: float
    sigma: float
    offset: float = 0.0


ModelName = Literal["SPC/E", "TIP3P", "OPC3", "TIP4P", "TIP4P-Ew", "TIP4P/2005", "OPC"]
MODELS = {
    # H. J. C. Berendsen, J. R. Grigera, T. P. Straatsma, J. Phys. Chem. 91, 6269 (1987): u = (B/r)¹² − (A/r)⁶ with
    # A = 3.7122 Å (kJ/mol)^(1/6), B = 3.428 Å (kJ/mol)^(1/12), from which σ = B²/A, ε = ¼ (A/B)¹²
    "SPC/E": Model(
        1.0,
        109.47,
        0.4238,
        0.25 * (3.7122 / 3.428) ** 12,
        3.428**2 / 3.7122,
    ),
    # W. L. Jorgensen et al., J. Chem. Phys. 79, 926 (1983): u = A/r¹² − C/r⁶ with A = 582 000 kcal Å¹²/mol,
    # C = 595 kcal Å⁶/mol, from which σ⁶ = A/C, ε = C²/(4 A)
    "TIP3P": Model(
        0.9572, 104.52, 0.417, KCAL * 595.0**2 / (4.0 * 582e3), (582e3 / 595.0) ** (1.0 / 6.0)
    ),
    # S. Izadi, A. V. Onufriev, J. Chem. Phys. 145, 074501 (2016)
    "OPC3": Model(0.97888, 109.47, 0.447585, 0.68369, 3.17427),
    # as TIP3P, with A = 600 000, C = 610
    "TIP4P": Model(
        0.9572, 104.52, 0.52, KCAL * 610.0**2 / (4.0 * 600e3), (600e3 / 610.0) ** (1.0 / 6.0), 0.15
    ),
    # H. W. Horn et al., J. Chem. Phys. 120, 9665 (2004)
    "TIP4P-Ew": Model(0.9572, 104.52, 0.52422, KCAL * 0.16275, 3.16435, 0.125),
    # J. L. F. Abascal, C. Vega, J. Chem. Phys. 123, 234505 (2005): ε = 93.2 K
    "TIP4P/2005": Model(0.9572, 104.52, 0.5564, 93.2 * ASE.k_B * KJ_PER_MOL_PER_EV, 3.1589, 0.1546),
    # S. Izadi, R. Anandakrishnan, A. V. Onufriev, J. Phys. Chem. Lett. 5, 3863 (2014)
    "OPC": Model(0.8724, 103.6, 0.6791, 0.89036, 3.16655, 0.1594),
}


class Ion(NamedTuple):
    """mass : [u].
    charge : [e].
    of_models : by the model of water, half the distance of the minimum of u between two ions [Å], and ε [kcal/mol]."""

    mass: float
    charge: float
    of_models: dict[str, tuple[float, float]]


# I. S. Joung, T. E. Cheatham, J. Phys. Chem. B 112, 9020 (2008), with Lorentz-Berthelot rules
IONS = {
    "Li": Ion(
        6.94,
        1.0,
        {"SPC/E": (0.791, 0.3367344), "TIP3P": (1.025, 0.0279896), "TIP4P-Ew": (0.808, 0.1039884)},
    ),
    "Na": Ion(
        22.98977,
        1.0,
        {"SPC/E": (1.212, 0.3526418), "TIP3P": (1.369, 0.0874393), "TIP4P-Ew": (1.226, 0.1684375)},
    ),
    "K": Ion(
        39.0983,
        1.0,
        {"SPC/E": (1.593, 0.4297054), "TIP3P": (1.705, 0.1936829), "TIP4P-Ew": (1.59, 0.2794651)},
    ),
    "Rb": Ion(
        85.4678,
        1.0,
        {"SPC/E": (1.737, 0.4451036), "TIP3P": (1.813, 0.3278219), "TIP4P-Ew": (1.709, 0.4331494)},
    ),
    "Cs": Ion(
        132.90545,
        1.0,
        {"SPC/E": (2.021, 0.0898565), "TIP3P": (1.976, 0.4065394), "TIP4P-Ew": (1.888, 0.3944318)},
    ),
    "F": Ion(
        18.9984,
        -1.0,
        {"SPC/E": (2.257, 0.0074005), "TIP3P": (2.303, 0.0033640), "TIP4P-Ew": (2.538, 0.0015752)},
    ),
    "Cl": Ion(
        35.45,
        -1.0,
        {"SPC/E": (2.711, 0.0127850), "TIP3P": (2.513, 0.0355910), "TIP4P-Ew": (2.76, 0.0116615)},
    ),
    "Br": Ion(
        79.904,
        -1.0,
        {"SPC/E": (2.751, 0.0269586), "TIP3P": (2.608, 0.0586554), "TIP4P-Ew": (2.768, 0.0303773)},
    ),
    "I": Ion(
        126.90447,
        -1.0,
        {"SPC/E": (2.919, 0.0427845), "TIP3P": (2.860, 0.0536816), "TIP4P-Ew": (2.952, 0.0417082)},
    ),
}


def water(
    model: ModelName = "SPC/E",
    n: int = 512,
    density: float = 0.997,
    *,
    ions: Mapping[str, int] | None = None,
    cutoff: float | None = None,
    accuracy: float = 1e-5,
    seed: int = 0,
) -> RigidWater:
    """Rigid water in a cubic periodic box, with ions if wanted: the system, its potentials and its constraints.

        system, potentials, rigid = md.water("SPC/E", 512, ions={"Na": 5, "Cl": 5})
        sim = md.Simulation(system, potentials, md.VelocityVerlet(2.0 * md.units.fs), rigid)

    Molecules stand on a lattice, turned at random, and ions far apart on places of it: equilibrate before use.
    Lennard-Jones is switched off over the last tenth of the cutoff, with a tail correction of energy and pressure.
    Models of four sites have massless ones, M, as the last atoms, in the order of the molecules: see Sites.

    Parameters
    ----------
    model : "SPC/E", "TIP3P", "OPC3", or, of four sites, "TIP4P", "TIP4P-Ew", "TIP4P/2005", "OPC"; the numbers and
        their sources are in MODELS.
    n : of molecules, each an O and two H, in this order; behind them the ions, and then M.
    density : of a box full of water [g/cm³]; in it each ion has the volume of a molecule.
    ions : how many of each, by the names in IONS, which has their parameters in SPC/E, TIP3P and TIP4P-Ew.
    cutoff : of Lennard-Jones and charges [Å]; if not given, 9, or 0.45 of the edge of the box if that is less, as for
        fewer than 267 molecules at the density of water; a warning then says so.
    accuracy : see Coulomb.
    seed : of the orientations, and of the places of ions.

    Raises ValueError for an unknown model, ions without parameters in it, a number of molecules below one, a density
    or cutoff that is not positive.
    """
    n = checked_count("n", n)
    potentials = water_potentials(model, n, density, cutoff, accuracy, ions)
    counts = checked_ions(model, ions)
    dissolved = [name for name in counts for _ in range(counts[name])]
    n_bodies = n + len(dissolved)
    edge = edge_of(n_bodies, density)
    longest = OF_BOX * edge
    if cutoff is None and longest < CUTOFF:
        warn(
            f"the cutoff of water is {longest:.3g} Å, not {CUTOFF:g} Å, because the box is only {edge:.3g} Å wide; "
            "take more molecules, or give cutoff to choose it"
        )

    # the lattice with the fewest empty places, from which some are left out evenly
    lattices = []

    for name in ("sc", "bcc", "fcc"):
        n_sites = len(BASES[name])
        repeat = ceil(round((n_bodies / n_sites) ** (1.0 / 3.0), 9))
        lattices.append((n_sites * repeat**3, name, repeat))

    n_places, name, repeat = min(lattices, key=lambda lattice: lattice[0])
    places, _ = crystal(name, [repeat] * 3, edge / repeat)
    centers = places[np.arange(n_bodies) * n_places // n_bodies]
    length, angle, *_ = MODELS[model]
    half = radians(0.5 * angle)
    first = [sin(half), 0.0, cos(half)]
    second = [-sin(half), 0.0, cos(half)]
    shape = length * np.array([[0.0, 0.0, 0.0], first, second])

    random = np.random.default_rng(checked_count("seed", seed, 0))
    turns = np.linalg.qr(random.normal(size=(n, 3, 3)))[0]

    is_ion = _far_apart(centers, edge, len(dissolved), random)
    molecules = (centers[~is_ion, None] + shape @ turns).reshape(-1, 3)
    system = System(
        np.concatenate([molecules, random.permutation(centers[is_ion])]),
        masses=1.0,
        species=["O", "H", "H"] * n + dissolved,
        cell=edge,
        units=ASE,
    )
    return _rigid(system, model, np.arange(3 * n).reshape(n, 3), potentials)


def checked_ions(model: str, ions: Mapping[str, int] | None) -> dict[str, int]:
    """How many ions of each name.
    Raises ValueError for one that has no parameters with this model, or a number that is not whole."""
    counts: dict[str, int] = {}
    if ions is None:
        return counts
    checked_kind("ions", ions, Mapping, "a mapping from names of ions to their numbers")

    for name, count in ions.items():
        if name not in IONS or model not in IONS[name].of_models:
            models = listed(IONS["Na"].of_models)
            raise ValueError(
                f"ions must be among {listed(IONS)}, with a model of water among {models}; "
                f"model = {model!r}, ions = {shown(ions)}"
            )
        counts[name] = checked_count(f"ions[{name!r}]", count, 0, MOST_ATOMS // 3)

    return counts


def _far_apart(
    places: Array, edge: float, n: int, random: np.random.Generator
) -> NDArray[np.bool_]:
    """Which n of the places (N, 3) in a cube are chosen: the first at random, each further one farthest from these."""
    chosen = np.zeros(len(places), dtype=bool)
    nearest = random.random(len(places)) + 3.0 * edge**2  # squares of distances to the chosen ones

    for _ in range(n):
        k = int(nearest.argmax())
        chosen[k] = True
        apart = places - places[k]
        apart -= edge * np.rint(apart / edge)
        nearest = np.minimum(nearest, (apart**2).sum(axis=1))

    return chosen


def ions_of(system: System) -> dict[str, int]:
    """How many ions of each name there are among the atoms."""
    species = system.species.tolist()
    return {name: species.count(name) for name in IONS if name in species}


def water_of(
    system: System, model: ModelName = "SPC/E", cutoff: float = CUTOFF, accuracy: float = 1e-5
) -> RigidWater:
    """Rigid water of atoms O and H that are there, such as those of a file, and ions; the answer is as that of water.

    The hydrogens of an oxygen are those within OH of it, in any order and through any image, whatever the bonds. Atoms
    of the species Na, Cl and so on (IONS) are ions. Atoms keep their order, velocities, cell, and those that are fixed;
    masses, charges, bonds and lengths become those of the model. M of a model come behind all atoms. As all
    constraints, the lengths are pulled to theirs when a run begins, and a warning says from how far.

    system : in ASE's units.
    cutoff : of Lennard-Jones and charges [Å].
    model, accuracy : as for water.

    Raises ValueError with the first atom that is no ion and of no molecule of an O and two H, as M of a file: leave it
    out; and as water.
    """
    checked_kind("system", system, System, "a System")
    if system.units is not ASE:
        raise ValueError(f"water must be in units 'ASE'; system.units = {system.units.name!r}")
    potentials = water_potentials(model, 1, 1.0, cutoff, accuracy, ions_of(system))
    species = system.species
    i, j = neighbor_list("ij", system, OH)
    is_arm = (species[i] == "O") & (species[j] == "H")
    oxygens = i[is_arm]
    hydrogens = j[is_arm]
    n_arms = np.bincount(np.append(oxygens, hydrogens), minlength=len(system))
    n_wanted = np.where(np.isin(species, [*IONS]), 0, 1 + (species == "O"))
    odd = np.flatnonzero(n_arms != n_wanted)
    if odd.size:
        k = odd[0]
        raise ValueError(
            f"atoms must be ions among {listed(IONS)}, or of molecules of water, an O and two H within {OH:g} Å of "
            f"it, and no fourth site; atom {k}, {species[k]}, has {n_arms[k]} partners"
        )

    molecules = np.column_stack([oxygens[::2], hydrogens.reshape(-1, 2)])
    return _rigid(system, model, molecules, potentials)


def _rigid(
    system: System, model: str, molecules: Indices, potentials: list[OwnPotential]
) -> RigidWater:
    """What water returns, from atoms in their places.
    molecules : (n, 3), indices of O, H, H."""
    length, angle, charge, _, _, offset = MODELS[model]
    negative = "M" if offset else "O"
    charges = {"O": 0.0, "H": charge, negative: -2.0 * charge}
    charges |= {name: ion.charge for name, ion in IONS.items()}
    masses = {"O": MASSES[0], "H": MASSES[1]} | {name: ion.mass for name, ion in IONS.items()}

    pairs = molecules[:, [[0, 1], [0, 2], [1, 2]]]
    base = 2.0 * length * sin(radians(0.5 * angle))
    lengths = np.tile([length, length, base], len(molecules))
    fixed = [FixedAtoms(held.atoms) for held in system.constraints if isinstance(held, FixedAtoms)]
    held = changed(
        system,
        masses=[masses[name] for name in system.species.tolist()],
        bonds=pairs[:, :2].reshape(-1, 2),
        constraints=fixed,
    )
    if offset:
        weight = offset / (2.0 * length * cos(radians(0.5 * angle)))
        held = _with_sites(held, molecules, [1.0 - 2.0 * weight, weight, weight])
    held = changed(held, charges=[charges[name] for name in held.species.tolist()])
    return held, potentials, DistanceConstraints(pairs.reshape(-1, 2), lengths)


def _with_sites(system: System, molecules: Indices, weights: list[float]) -> System:
    """The system with a massless site M behind its atoms for each of the molecules (n, 3)."""
    n_atoms = len(system)
    oxygens = molecules[:, 0]
    atoms = n_atoms + np.arange(len(molecules))
    topology = system.topology
    if len(topology):
        of_sites = topology[oxygens]
        of_sites[:, :2] = "M", ""
        topology = np.concatenate([topology, of_sites])
    return changed(
        system,
        positions=np.concatenate([system.positions, system.positions[oxygens]]),
        velocities=np.concatenate([system.velocities, np.zeros((len(atoms), 3))]),
        masses=np.append(system.masses, np.zeros(len(atoms))),
        species=[*system.species.tolist(), *len(atoms) * ["M"]],
        charges=None,
        bonds=np.concatenate([system.bonds, np.column_stack([oxygens, atoms])]),
        sites=Sites(atoms, molecules, weights),
        topology=topology,
    )


DENSEST = 3.0  # g/cm³, more than that of any ice


def edge_of(n: int, density: float) -> float:
    """Edge of the box [Å] of n molecules.
    density : [g/cm³].
    Raises ValueError if it is not positive."""
    density = checked_number("density", density, "positive and finite")
    if density > DENSEST:
        raise ValueError(f"density must be at most {DENSEST:g} g/cm³; density = {density:g}")
    return (n * sum(MASSES) / (density * GRAM_PER_CM3)) ** (1.0 / 3.0)


def water_potentials(
    model: ModelName,
    n: int,
    density: float,
    cutoff: float | None,
    accuracy: float,
    ions: Mapping[str, int] | None = None,
) -> list[OwnPotential]:
    """The potentials of water, without its molecules.  Arguments and errors are those of water."""
    _, _, _, epsilon, sigma, offset = MODELS[checked_choice("model", model, MODELS)]
    counts = checked_ions(model, ions)

    n_bodies = n + sum(counts.values())
    longest = min(CUTOFF, OF_BOX * edge_of(n_bodies, density))
    cutoff = longest if cutoff is None else checked_number("cutoff", cutoff, "positive and finite")
    excluded = (0.0, 0.0, 1.0)
    wells: Any = {"O": (epsilon / KJ_PER_MOL_PER_EV, sigma), "H": (0.0, 1.0)}
    if offset:
        wells["M"] = wells["H"]

    for name in counts:
        half, depth = IONS[name].of_models[model]
        wells[name] = (depth * KCAL / KJ_PER_MOL_PER_EV, 2.0 ** (5.0 / 6.0) * half)

    dispersion = LennardJones(
        wells,
        cutoff=cutoff,
        truncation="switched",
        switch_start=SWITCH_FROM * cutoff,
        bonded_scale=excluded,
        tail_correction=True,
    )
    return [dispersion, Coulomb(cutoff, accuracy, bonded_scale=excluded)]
