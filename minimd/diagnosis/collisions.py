"""Collisions of Lennard-Jones atoms: their frequency, and a test whether ε was given in another unit."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.potentials.laws import LennardJonesLaw
from minimd.potentials.lennard_jones import curvature_at_minimum
from minimd.potentials.pair import PairPotential
from minimd.structure.observables import center, kinetic_energy, temperature, thermal_energy
from minimd.structure.system import System
from minimd.structure.units import ASE, BOLTZMANN_EV_PER_K, KJ_PER_MOL_PER_EV

CROWDED = 5.0  # ω of the stiffest mode of a liquid, divided by that of a pair at rest; the modes: 4.8 at T* 0.7, ρ* 0.85; 5.8 at 1.44, 0.8442
CROWDED_COLD, CROWDED_HEAT = 15.0, 12.2  # (ω/ω_pair)² = cold + heat T*^(7/6) through these two; u″ ∝ u^(7/6) where a wall r⁻¹² stops an atom
COLDEST = ((CROWDED**2 - CROWDED_COLD) / CROWDED_HEAT) ** (6.0 / 7.0)  # T* below which the floor of CROWDED counts
DEEP, DEEPEST, WIDE = 0.5, 2.0, 2.7  # eV, eV, Å: ε of no atom that is wider than WIDE, and of no atom at all; metals: W 1.07 eV, 2.56 Å
SHALLOW, LIKELY = 5e-4, 0.05  # eV: ε of helium is 9e-4, that of xenon 0.02
READINGS = (  # of an ε in another unit: its name, its size in eV, and the factor in words
    ("K", BOLTZMANN_EV_PER_K, "* md.units.ASE.k_B"),
    ("kJ/mol", 1.0 / KJ_PER_MOL_PER_EV, "/ md.units.KJ_PER_MOL_PER_EV"),
    ("kcal/mol", 4.184 / KJ_PER_MOL_PER_EV, "* 4.184 / md.units.KJ_PER_MOL_PER_EV"),
    ("meV", 1e-3, "/ 1000"),
)


def collision_frequency(system: System, potentials: Sequence[Any], held: NDArray[np.int64], at_rest: bool = False) -> float:
    """ω of Lennard-Jones atoms that collide in a liquid [1/time]; 0 if there are none.

        ω² = u″(r_min)/μ · max(5², 15 + 12.2 T*^(7/6)),   T* = k_B T/ε of the velocities

    This is the largest ω of all pairs of species. An atom bonded to a heavier one moves with it, and does not count.
    held : (C, 2), pairs at a fixed distance.  at_rest : whether the velocities are left out.
    """
    masses, bonds = system.masses, np.concatenate([system.bonds, held])
    carried = bonds[np.arange(len(bonds)), np.argmin(masses[bonds], axis=1)][masses[bonds[:, 0]] != masses[bonds[:, 1]]]
    inverse = 1.0 / masses
    inverse[carried] = 0.0
    fastest = np.zeros(len(system.species_names))
    np.maximum.at(fastest, system.species_index, inverse)
    thermal = 0.0 if at_rest else system.units.k_B * velocity_temperature(system)
    square = 0.0
    for table in _tables(system, potentials):
        each = fastest if len(table) > 1 else fastest.max(keepdims=True)
        epsilon = table[..., -2]
        with np.errstate(over="ignore"):  # in a run that has blown up
            heat = np.divide(thermal, epsilon, out=np.zeros_like(epsilon), where=epsilon > 0.0) ** (7.0 / 6.0)
            both = np.where((each[:, None] > 0.0) & (each > 0.0), each[:, None] + each, 0.0)
            stiffness = curvature_at_minimum(epsilon, table[..., -1]) * both
            square = max(square, float((stiffness * np.maximum(CROWDED**2, CROWDED_COLD + CROWDED_HEAT * heat)).max()))
    return square**0.5


def strange_depth(system: System, potentials: Sequence[Any]) -> str | None:
    """A clause if an ε in eV is larger than that of any atom, as a number in kelvin or kJ/mol would be; else None."""
    if system.units != ASE:
        return None
    for table in _tables(system, potentials):
        epsilon, sigma = table[..., -2], table[..., -1]
        strange = epsilon * ((epsilon > DEEPEST) | ((epsilon > DEEP) & (sigma > WIDE)))
        if (worst := float(strange.max())) > 0.0:
            fits = [one for one in READINGS if SHALLOW <= worst * one[1] <= LIKELY]
            told = [f"in {unit} it would be {worst * size:.3g} eV, epsilon={worst:.6g} {words}" for unit, size, words in fits]
            return (
                f"epsilon = {worst:.6g} eV is far deeper than the well of any such atom (noble gases 0.001 to 0.02 eV, metals up to 1 eV); "
                f"{'; '.join(told) or 'check its unit'}"
            )
    return None


def _tables(system: System, potentials: Sequence[Any]) -> Iterator[NDArray[np.float64]]:
    """The numbers of each Lennard-Jones potential for pairs of species: (S, S, ...), ε and σ last."""
    for potential in potentials:
        if isinstance(potential, PairPotential) and isinstance(potential.plain_law, LennardJonesLaw):
            yield potential.table(system.species_names)


def velocity_temperature(system: System) -> float:
    """T of the velocities relative to the center of mass [temperature], with all 3N degrees of freedom; 0 at rest."""
    velocities, masses = system.velocities, system.masses
    thermal = thermal_energy(kinetic_energy(velocities, masses), center(velocities, masses), masses)
    return temperature(thermal, velocities.size, system.units.k_B)
