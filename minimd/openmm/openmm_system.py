"""OpenMM's systems as systems and potentials of minimd: the one door for force fields, which OpenMM reads.

Units are converted from OpenMM's nm, kJ/mol and e to minimd.units.ASE.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.words import listed, shown
from minimd.core.potentials.bonded import (
    BondPotential,
    HarmonicAngle,
    HarmonicBond,
    PeriodicDihedral,
    RyckaertBellemans,
)
from minimd.core.potentials.coulomb import NO_REST, ChargedLaw, Coulomb, CoulombLaw
from minimd.core.potentials.laws import LennardJonesLaw
from minimd.core.potentials.pair import UNSCALED, LennardJones
from minimd.core.potentials.prolates import LEAST_ACCURATE, MOST_ACCURATE
from minimd.core.potentials.term import OwnPotential
from minimd.core.structure.checks import LARGEST
from minimd.core.structure.constraints import Constraint, DistanceConstraints
from minimd.core.structure.observables import Array
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE, KJ_PER_MOL_PER_EV

if TYPE_CHECKING:
    import openmm
    import openmm.app

# Å, eV
NM = 10.0
KJ = 1.0 / KJ_PER_MOL_PER_EV
# for each force: what OpenMM calls one of its terms, how many atoms it has, and the potential of their parameters
BONDED: Mapping[str, tuple[str, int, Callable[..., OwnPotential]]] = {
    "HarmonicBondForce": ("Bond", 2, lambda at, length, k: HarmonicBond(KJ / NM**2 * k, NM * length, at)),
    "HarmonicAngleForce": ("Angle", 3, lambda at, angle, k: HarmonicAngle(KJ * k, angle, at)),
    "PeriodicTorsionForce": ("Torsion", 4, lambda at, n, phase, k: PeriodicDihedral(KJ * k, n, phase, at)),
    "RBTorsionForce": ("Torsion", 4, lambda at, *c: RyckaertBellemans([KJ * one for one in c], at)),
}
KNOWN = (*BONDED, "NonbondedForce", "CMMotionRemover")


def from_openmm(
    openmm_system: openmm.System, topology: openmm.app.Topology, positions: ArrayLike
) -> tuple[System, list[OwnPotential], tuple[Constraint, ...]]:
    """System, potentials and constraints, in minimd.units.ASE, from a system of OpenMM: any force field that it reads.

        made = openmm.app.ForceField("amber14-all.xml", "amber14/tip3p.xml").createSystem(pdb.topology, …)
        system, potentials, constraints = md.from_openmm(made, pdb.topology, pdb.positions)
        sim = md.Simulation(system, potentials, md.VelocityVerlet(2.0 * md.units.fs), constraints)

    Taken: harmonic bonds and angles, periodic and Ryckaert-Bellemans torsions, NonbondedForce, masses, box vectors,
    constraints; CMMotionRemover is left out, because minimd's forces conserve momentum. Species are the elements,
    numbered where they have several Lennard-Jones parameters; bonds are those of the topology.

    The exceptions of NonbondedForce become exclusions of LennardJones and Coulomb, and, if they have parameters, a
    BondPotential. The law of charges is summed to ewaldErrorTolerance, whatever Ewald parameters or PME grid are given.
    Energies differ from those of OpenMM: its constant k_e, 138.9354576 kJ nm/(mol e²), is larger by 9e-10 of it; its
    dispersion correction is a mean over N (N + 1)/2 pairs, not over N²/2. Terms of minimd act on nearest
    images; those of OpenMM do if they use periodic boundary conditions, or if molecules are whole.

    Parameters
    ----------
    openmm_system : openmm.System.  topology : openmm.app.Topology.
    positions : (N, 3) of OpenMM, with a unit, or in nm.

    Raises
    ------
    TypeError : for anything but a system of OpenMM.  ValueError : for other forces (custom ones, baths, barostats),
        virtual sites, LJPME and parameter offsets, by name; for another number of atoms; as System and potentials.
    """
    if not hasattr(openmm_system, "getForces"):
        raise TypeError(f"openmm_system must be an openmm.System; openmm_system = {shown(openmm_system)}")
    forces = openmm_system.getForces()
    places = np.array(_plain(positions), dtype=np.float64)
    n = openmm_system.getNumParticles()
    elements = [one.element for one in topology.atoms()]
    if not n == len(elements) == len(places):
        raise ValueError(
            f"OpenMM's system, topology and positions must have the same number of atoms; they have {n}, "
            f"{len(elements)} and {len(places)}"
        )
    if strange := _strange(openmm_system, forces):
        raise ValueError(
            f"from_openmm takes {listed(KNOWN)}; it does not take {listed(strange)}: baths and barostats are given "
            "to md.Simulation; other forces need OpenMM itself, or another force field"
        )
    nonbonded = next((one for one in forces if type(one).__name__ == "NonbondedForce"), None)
    charges, sigma, epsilon = np.zeros((3, n)) if nonbonded is None else _rows(nonbonded, "Particle", 3).T
    # ghosts of one kind, whatever their σ
    sigma = np.where(epsilon > 0.0, NM * sigma, 1.0)
    epsilon = KJ * epsilon
    species = _labels([one.symbol if one else "X" for one in elements], np.column_stack([epsilon, sigma]))
    held = _rows(openmm_system, "Constraint", 3)
    system = System(
        NM * places,
        masses=[_plain(openmm_system.getParticleMass(k)) for k in range(n)],
        charges=charges,
        cell=NM * np.array([_plain(row) for row in openmm_system.getDefaultPeriodicBoxVectors()])
        if openmm_system.usesPeriodicBoundaryConditions()
        else None,
        species=species,
        bonds=np.unique(np.sort([(a.index, b.index) for a, b in topology.bonds()] or np.zeros((0, 2), int)), axis=0),
        units=ASE,
        constraints=[DistanceConstraints(held[:, :2].astype(int), NM * held[:, 2])] if len(held) else [],
    )
    potentials: list[OwnPotential] = []
    for one in forces:
        name, size, potential = BONDED.get(type(one).__name__, ("", 0, None))
        if potential is not None and len(rows := _rows(one, name, size)):
            potentials.append(potential(rows[:, :size].astype(int), *rows[:, size:].T))
    if nonbonded is not None:
        kinds = {one: (well, size) for one, well, size in zip(species, epsilon.tolist(), sigma.tolist(), strict=True)}
        potentials += _nonbonded(nonbonded, kinds, bool(charges.any()))
    return system, potentials, system.constraints


def _strange(openmm_system: openmm.System, forces: list[openmm.Force]) -> list[str]:
    """What of a system minimd does not have, in words."""
    names = [type(one).__name__ for one in forces]
    found = [name for name in names if name not in KNOWN]
    if names.count("NonbondedForce") > 1:
        found.append("a second NonbondedForce")
    sites = [k for k in range(openmm_system.getNumParticles()) if openmm_system.isVirtualSite(k)]
    if sites:
        found.append(f"virtual sites, such as particle {sites[0]}")
    for one in (one for one, name in zip(forces, names, strict=True) if name == "NonbondedForce"):
        if one.getNonbondedMethod() == one.LJPME:
            found.append("the method LJPME")
        if one.getNumParticleParameterOffsets() or one.getNumExceptionParameterOffsets():
            found.append("parameter offsets of NonbondedForce")
        if not one.getIncludeDirectSpace():
            found.append("NonbondedForce without its direct space")
    return found


def _nonbonded(
    force: openmm.NonbondedForce, kinds: Mapping[Any, tuple[float, float]], charged: bool
) -> list[OwnPotential]:
    """Its potentials.  kinds : (ε, σ) of each species.  charged : whether any atom is."""
    potentials: list[OwnPotential] = []
    method = force.getNonbondedMethod()
    cutoff = None if method == force.NoCutoff else NM * _plain(force.getCutoffDistance())
    rows = _rows(force, "Exception", 5)
    pairs = rows[:, :2].astype(int)
    product, sigma, epsilon = rows[:, 2:].T
    if any(epsilon > 0.0 for epsilon, _ in kinds.values()):
        has_tail = force.usesPeriodicBoundaryConditions() and force.getUseDispersionCorrection()
        options: Any = {"tail_correction": has_tail, "exclusions": pairs, "truncation": "truncated"}
        if cutoff is not None and force.getUseSwitchingFunction():
            options |= {"truncation": "switched", "switch_start": NM * _plain(force.getSwitchingDistance())}
        potentials.append(LennardJones(kinds, None, cutoff, **options))
    if charged:
        is_sum = method in (force.NoCutoff, force.Ewald, force.PME)
        accuracy = min(max(force.getEwaldErrorTolerance(), MOST_ACCURATE), LEAST_ACCURATE)
        options = {} if is_sum else {"method": "reaction-field", "dielectric": force.getReactionFieldDielectric()}
        potentials.append(Coulomb(cutoff, accuracy, bonded_scale=UNSCALED, exclusions=pairs, **options))
    is_well = (epsilon > 0.0) & (sigma > 0.0)
    sigma = np.where(is_well, NM * sigma, 1.0)
    numbers = ASE.coulomb * product, np.full_like(product, LARGEST), KJ * epsilon * is_well, sigma
    if (acts := is_well | (product != 0.0)).any():
        # without a cutoff
        potentials.append(
            BondPotential(
                ChargedLaw(LennardJonesLaw(), CoulombLaw(NO_REST)), [one[acts] for one in numbers], pairs[acts]
            )
        )
    return potentials


def _labels(elements: list[str], parameters: Array) -> list[str]:
    """Species: the elements, and where one has several rows of parameters (N, 2), their numbers, from 1 on."""
    kinds: dict[str, dict[tuple[float, ...], int]] = {}
    of_each = [(name, tuple(row)) for name, row in zip(elements, parameters.tolist(), strict=True)]
    for name, row in of_each:
        kinds.setdefault(name, {}).setdefault(row, len(kinds.get(name, ())) + 1)
    return [f"{name}{kinds[name][row]}" if len(kinds[name]) > 1 else name for name, row in of_each]


def _rows(owner: Any, name: str, width: int) -> Array:
    """All parameters that a system or a force of OpenMM has of its terms, by their name, (n, …) in nm, kJ/mol, e."""
    parameters = getattr(owner, f"get{name}Parameters")
    rows = [[_plain(one) for one in parameters(k)] for k in range(getattr(owner, f"getNum{name}s")())]
    return np.array(rows, dtype=np.float64).reshape(len(rows), -1 if rows else width)


def _plain(quantity: Any) -> Any:
    """The value of a quantity of OpenMM in nm, kJ/mol, e, u and rad; what has no unit is taken as it is."""
    from openmm.unit import is_quantity, md_unit_system

    return quantity.value_in_unit_system(md_unit_system) if is_quantity(quantity) else quantity
