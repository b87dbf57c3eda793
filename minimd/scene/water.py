"""Rigid water of three charges, by the name of its model: box, charges, laws, constraints."""

from math import ceil, cos, radians, sin
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.quiet import warn
from minimd.core.neighbors.queries import neighbor_list
from minimd.core.potentials.coulomb import Coulomb
from minimd.core.potentials.pair import LennardJones
from minimd.core.potentials.term import OwnPotential
from minimd.core.structure.checks import checked_choice, checked_count, checked_kind, checked_number
from minimd.core.structure.constraints import DistanceConstraints, FixedAtoms
from minimd.core.structure.lattice import BASES, crystal
from minimd.core.structure.system import System, changed
from minimd.core.structure.units import ASE, GRAM_PER_CM3, KJ_PER_MOL_PER_EV

MASSES = (15.9994, 1.008, 1.008)  # u
OH = 1.3  # Å: hydrogens of other molecules are farther away, in hydrogen bonds 1.6 Å and more
CUTOFF, OF_BOX = 9.0, 0.45  # default cutoff [Å], and the most of the edge of the box that it takes
SWITCH_FROM = 0.9  # of the cutoff
RigidWater = tuple[System, list[OwnPotential], DistanceConstraints]


class Model(NamedTuple):
    """length : of O-H [Å].
    angle : H-O-H [degrees].
    charge : of H [e].
    epsilon, sigma : of O [kJ/mol], [Å]."""

    length: float
    angle: float
    charge: float
    epsilon: float
    sigma: float


ModelName = Literal["SPC/E", "TIP3P", "OPC3"]
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
        0.9572, 104.52, 0.417, 4.184 * 595.0**2 / (4.0 * 582e3), (582e3 / 595.0) ** (1.0 / 6.0)
    ),
    # S. Izadi, A. V. Onufriev, J. Chem. Phys. 145, 074501 (2016)
    "OPC3": Model(0.97888, 109.47, 0.447585, 0.68369, 3.17427),
}


def water(
    model: ModelName = "SPC/E",
    n: int = 512,
    density: float = 0.997,
    *,
    cutoff: float | None = None,
    accuracy: float = 1e-5,
    seed: int = 0,
) -> RigidWater:
    """Rigid water in a cubic periodic box: the system, its potentials and its constraints, for a Simulation.

        system, potentials, rigid = md.water("SPC/E", 512)
        sim = md.Simulation(system, potentials, md.VelocityVerlet(2.0 * md.units.fs), rigid)

    Molecules stand on a lattice, turned at random: equilibrate before use. Lennard-Jones is switched off over the last
    tenth of the cutoff, with a tail correction of energy and pressure.

    Parameters
    ----------
    model : "SPC/E", "TIP3P" or "OPC3"; the numbers and their sources are in MODELS.
    n : of molecules, each an O and two H, in this order.
    density : [g/cm³].
    cutoff : of Lennard-Jones and charges [Å]; if not given, 9, or 0.45 of the edge of the box if that is less, as for
        fewer than 267 molecules at the density of water; a warning then says so.
    accuracy : see Coulomb.
    seed : of the orientations.

    Raises ValueError for an unknown model, a number of molecules below one, a density or cutoff that is not positive.
    """
    potentials = water_potentials(model, n, density, cutoff, accuracy)
    edge = edge_of(n, density)
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
        repeat = ceil(round((n / n_sites) ** (1.0 / 3.0), 9))
        lattices.append((n_sites * repeat**3, name, repeat))

    n_places, name, repeat = min(lattices, key=lambda lattice: lattice[0])
    places, _ = crystal(name, [repeat] * 3, edge / repeat)
    centers = places[np.arange(n) * n_places // n]
    length, angle, *_ = MODELS[model]
    half = radians(0.5 * angle)
    first = [sin(half), 0.0, cos(half)]
    second = [-sin(half), 0.0, cos(half)]
    shape = length * np.array([[0.0, 0.0, 0.0], first, second])
    random = np.random.default_rng(checked_count("seed", seed, 0))
    turns = np.linalg.qr(random.normal(size=(n, 3, 3)))[0]
    positions = (centers[:, None] + shape @ turns).reshape(-1, 3)
    system = System(
        positions,
        masses=1.0,
        species=["O", "H", "H"] * n,
        cell=edge,
        units=ASE,
    )
    return _rigid(system, model, np.arange(3 * n).reshape(n, 3), potentials)


def water_of(
    system: System, model: ModelName = "SPC/E", cutoff: float = CUTOFF, accuracy: float = 1e-5
) -> RigidWater:
    """Rigid water of atoms O and H that are there, such as those of a file; the answer is as that of water.

    The hydrogens of an oxygen are those within OH of it, in any order and through any image, whatever the bonds. Atoms
    keep their order, velocities, cell, and those that are fixed; masses, charges, bonds and lengths become those of the
    model. As all constraints, the lengths are pulled to theirs when a run begins, and a warning says from how far.

    system : in ASE's units.
    cutoff : of Lennard-Jones and charges [Å].
    model, accuracy : as for water.

    Raises ValueError with the first atom that is of no molecule of an O and two H, such as the fourth site of some
    models; and as water.
    """
    checked_kind("system", system, System, "a System")
    if system.units is not ASE:
        raise ValueError(f"water must be in units 'ASE'; system.units = {system.units.name!r}")
    potentials = water_potentials(model, 1, 1.0, cutoff, accuracy)
    species = system.species
    i, j = neighbor_list("ij", system, OH)
    is_arm = (species[i] == "O") & (species[j] == "H")
    oxygens = i[is_arm]
    hydrogens = j[is_arm]
    n_arms = np.bincount(np.append(oxygens, hydrogens), minlength=len(system))
    odd = np.flatnonzero(n_arms != 1 + (species == "O"))
    if odd.size:
        k = odd[0]
        raise ValueError(
            f"molecules of water must be an O and two H within {OH:g} Å of it, and no fourth site; atom {k}, "
            f"{species[k]}, has {n_arms[k]} partners"
        )

    molecules = np.column_stack([oxygens[::2], hydrogens.reshape(-1, 2)])
    return _rigid(system, model, molecules, potentials)


def _rigid(
    system: System, model: str, molecules: NDArray[np.int64], potentials: list[OwnPotential]
) -> RigidWater:
    """What water returns, from atoms in their places.
    molecules : (n, 3), indices of O, H, H."""
    length, angle, charge, *_ = MODELS[model]
    pairs = molecules[:, [[0, 1], [0, 2], [1, 2]]]
    base = 2.0 * length * sin(radians(0.5 * angle))
    lengths = np.tile([length, length, base], len(molecules))
    held = changed(
        system,
        masses=np.where(system.species == "O", *MASSES[:2]),
        charges={"O": -2.0 * charge, "H": charge},
        bonds=pairs[:, :2].reshape(-1, 2),
        constraints=[held for held in system.constraints if isinstance(held, FixedAtoms)],
    )
    return held, potentials, DistanceConstraints(pairs.reshape(-1, 2), lengths)


DENSEST = 3.0  # g/cm³, more than that of any ice


def edge_of(n: int, density: float) -> float:
    """Edge of the box [Å] of n molecules.
    density : [g/cm³].
    Raises ValueError if it or n is not positive."""
    density = checked_number("density", density, "positive and finite")
    if density > DENSEST:
        raise ValueError(f"density must be at most {DENSEST:g} g/cm³; density = {density:g}")
    return (checked_count("n", n) * sum(MASSES) / (density * GRAM_PER_CM3)) ** (1.0 / 3.0)


def water_potentials(
    model: ModelName, n: int, density: float, cutoff: float | None, accuracy: float
) -> list[OwnPotential]:
    """The potentials of water, without its molecules.  Arguments and errors are those of water."""
    _, _, _, epsilon, sigma = MODELS[checked_choice("model", model, MODELS)]
    longest = min(CUTOFF, OF_BOX * edge_of(n, density))
    cutoff = longest if cutoff is None else checked_number("cutoff", cutoff, "positive and finite")
    excluded = (0.0, 0.0, 1.0)
    wells: Any = {"O": (epsilon / KJ_PER_MOL_PER_EV, sigma), "H": (0.0, 1.0)}
    dispersion = LennardJones(
        wells,
        cutoff=cutoff,
        truncation="switched",
        switch_start=SWITCH_FROM * cutoff,
        bonded_scale=excluded,
        tail_correction=True,
    )
    return [dispersion, Coulomb(cutoff, accuracy, bonded_scale=excluded)]
