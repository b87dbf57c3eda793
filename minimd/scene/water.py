"""Rigid water of three charges, by the name of its model: box, charges, laws, constraints."""

from math import ceil, cos, radians, sin
from typing import Literal, NamedTuple

import numpy as np

from minimd.core.console.quiet import warn
from minimd.core.potentials.coulomb import Coulomb
from minimd.core.potentials.pair import LennardJones
from minimd.core.potentials.term import OwnPotential
from minimd.core.structure.checks import checked_choice, checked_count, checked_number
from minimd.core.structure.constraints import DistanceConstraints
from minimd.core.structure.lattice import BASES, crystal
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE, GRAM_PER_CM3, KJ_PER_MOL_PER_EV

MASSES = (15.9994, 1.008, 1.008)  # u
CUTOFF, OF_BOX = 9.0, 0.45  # default cutoff [Å], and the most of the edge of the box that it takes
SWITCH_FROM = 0.9  # of the cutoff


class Model(NamedTuple):
    """length : of O-H [Å].  angle : H-O-H [degrees].  charge : of H [e].  epsilon, sigma : of O [kJ/mol], [Å]."""

    length: float
    angle: float
    charge: float
    epsilon: float
    sigma: float


ModelName = Literal["SPC/E", "TIP3P", "OPC3"]
MODELS = {
    # H. J. C. Berendsen, J. R. Grigera, T. P. Straatsma, J. Phys. Chem. 91, 6269 (1987): u = (B/r)¹² − (A/r)⁶ with
    # A = 3.7122 Å (kJ/mol)^(1/6), B = 3.428 Å (kJ/mol)^(1/12), from which σ = B²/A, ε = ¼ (A/B)¹²
    "SPC/E": Model(1.0, 109.47, 0.4238, 0.25 * (3.7122 / 3.428) ** 12, 3.428**2 / 3.7122),
    # W. L. Jorgensen et al., J. Chem. Phys. 79, 926 (1983): u = A/r¹² − C/r⁶ with A = 582 000 kcal Å¹²/mol,
    # C = 595 kcal Å⁶/mol, from which σ⁶ = A/C, ε = C²/(4 A)
    "TIP3P": Model(0.9572, 104.52, 0.417, 4.184 * 595.0**2 / (4.0 * 582e3), (582e3 / 595.0) ** (1.0 / 6.0)),
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
) -> tuple[System, list[OwnPotential], DistanceConstraints]:
    """Rigid water in a cubic periodic box: the system, its potentials and its constraints, for a Simulation.

        system, potentials, rigid = md.water("SPC/E", 512)
        sim = md.Simulation(system, potentials, md.VelocityVerlet(2.0 * md.units.fs), rigid)

    Molecules stand on a lattice, turned at random: equilibrate before use. Lennard-Jones is switched off over the last
    tenth of the cutoff, with a tail correction of energy and pressure.

    Parameters
    ----------
    model : "SPC/E", "TIP3P" or "OPC3"; the numbers and their sources are in MODELS.
    n : of molecules, each an O and two H, in this order.  density : [g/cm³].
    cutoff : of Lennard-Jones and charges [Å]; if not given, 9, or 0.45 of the edge of the box if that is less, as for
        fewer than 267 molecules at the density of water; a warning then says so.
    accuracy : see Coulomb.  seed : of the orientations.

    Raises ValueError for an unknown model, a number of molecules below one, a density or cutoff that is not positive.
    """
    potentials, edge = water_potentials(model, n, density, cutoff, accuracy), edge_of(n, density)
    if cutoff is None and (most := OF_BOX * edge) < CUTOFF:
        small = f"the cutoff of water is {most:.3g} Å, not {CUTOFF:g} Å, because the box is only {edge:.3g} Å wide"
        warn(f"{small}; take more molecules, or give cutoff to choose it")
    length, angle, charge, _, _ = MODELS[model]
    # the lattice with the fewest empty places, from which some are left out evenly
    repeats = {name: ceil(round((n / len(BASES[name])) ** (1.0 / 3.0), 9)) for name in ("sc", "bcc", "fcc")}
    name = min(repeats, key=lambda one: len(BASES[one]) * repeats[one] ** 3)
    places, _ = crystal(name, [repeats[name]] * 3, edge / repeats[name])
    centers = places[np.arange(n) * len(places) // n]
    half = radians(0.5 * angle)
    shape = length * np.array([[0.0, 0.0, 0.0], [sin(half), 0.0, cos(half)], [-sin(half), 0.0, cos(half)]])
    turns = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, 3, 3)))[0]
    first = 3 * np.arange(n)[:, None, None]
    system = System(
        (centers[:, None] + shape @ turns).reshape(-1, 3),
        masses=np.tile(MASSES, n),
        charges=np.tile([-2.0 * charge, charge, charge], n),
        species=["O", "H", "H"] * n,
        bonds=(first + [[0, 1], [0, 2]]).reshape(-1, 2),
        cell=edge,
        units=ASE,
    )
    lengths = np.tile([length, length, 2.0 * length * sin(half)], n)
    rigid = DistanceConstraints((first + [[0, 1], [0, 2], [1, 2]]).reshape(-1, 2), lengths)
    return system, potentials, rigid


def edge_of(n: int, density: float) -> float:
    """Edge of the box [Å] of n molecules.  density : [g/cm³].  Raises ValueError if it or n is not positive."""
    density = checked_number("density", density, "positive and finite")
    return (checked_count("n", n) * sum(MASSES) / (density * GRAM_PER_CM3)) ** (1.0 / 3.0)


def water_potentials(
    model: ModelName, n: int, density: float, cutoff: float | None, accuracy: float
) -> list[OwnPotential]:
    """The potentials of water, without its molecules.  Arguments and errors are those of water."""
    _, _, _, epsilon, sigma = MODELS[checked_choice("model", model, MODELS)]
    most, excluded = min(CUTOFF, OF_BOX * edge_of(n, density)), (0.0, 0.0, 1.0)
    cutoff = most if cutoff is None else checked_number("cutoff", cutoff, "positive and finite")
    parameters = {"O": (epsilon / KJ_PER_MOL_PER_EV, sigma), "H": (0.0, 1.0)}
    options = {"switch_start": SWITCH_FROM * cutoff, "bonded_scale": excluded, "tail_correction": True}
    of_oxygen = LennardJones(parameters, None, cutoff, "switched", **options)  # type: ignore[arg-type]
    return [of_oxygen, Coulomb(cutoff, accuracy, bonded_scale=excluded)]
