"""OpenMM's systems as systems and potentials of minimd: the one door for force fields, which OpenMM reads.

Units are converted from OpenMM's nm, kJ/mol and e to minimd.units.ASE.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.quiet import warn
from minimd.core.console.words import listed, shown
from minimd.core.potentials.bonded import (
    BondPotential,
    DihedralMap,
    HarmonicAngle,
    HarmonicBond,
    HarmonicImproper,
    PeriodicDihedral,
    RyckaertBellemans,
)
from minimd.core.potentials.coulomb import NO_REST, ChargedLaw, Coulomb, CoulombLaw
from minimd.core.potentials.laws import LennardJonesLaw
from minimd.core.potentials.pair import UNSCALED, LennardJones
from minimd.core.potentials.prolates import LEAST_ACCURATE, MOST_ACCURATE
from minimd.core.potentials.term import OwnPotential
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import LARGEST
from minimd.core.structure.constraints import Constraint, DistanceConstraints, FixedAtoms
from minimd.core.structure.sites import Sites
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE, KJ_PER_MOL_PER_EV

if TYPE_CHECKING:
    import openmm
    import openmm.app

# Å, eV
NM = 10.0
KJ = 1.0 / KJ_PER_MOL_PER_EV
# laws of harmonic impropers, as of _kind: α is k/2, or k after 0.5
IMPROPERS = (
    "α*(theta-β)^2",
    "α*min((abs(theta-β)),2*pi-(abs(theta-β)))^2",
    "α*((theta-β)-floor((theta-β)/(2*pi)+0.5)*(2*pi))^2",
    "α*((step(-(theta-β+pi))*2*pi+theta+step(theta-β-pi)*(-2*pi))-β)^2",
)


def _improper(factor: float, law: str, atoms: Any, k: Array, angle: Array) -> HarmonicImproper:
    """Warns if the law jumps at φ = π, which minimd's does not.
    factor : of k, in minimd's law ½ k φ²."""
    if "pi" not in law and angle.any():
        warn(
            "OpenMM's k*(theta-theta0)^2 jumps at theta = pi, where theta0 is not 0; in minimd theta - theta0 is taken "
            "between -pi and pi: beyond that its energies differ from those of OpenMM"
        )
    return HarmonicImproper(factor * KJ * k, np.angle(np.exp(1j * angle)), atoms)


def _well(a: Array, c: Array) -> tuple[Array, Array]:
    """ε and σ of A/r¹² − C/r⁶; 0 where both are 0.
    Raises ValueError where only one is."""
    for pair in np.column_stack([a, c])[np.sign(a) != np.sign(c)].tolist():
        raise ValueError(
            f"A, C in a law A/r^12 - C/r^6 of OpenMM must be of one sign or both 0; A, C = {pair}: minimd has "
            "no law of one of them alone"
        )
    return c * c / (4.0 * a + (a == 0.0)), (a / (c + (c == 0.0))) ** (1.0 / 6.0)


def _in_ase_units(epsilon: Array, sigma: Array) -> tuple[Array, Array]:
    """ε [eV] and σ [Å]; ghosts are of one kind, whatever their σ."""
    is_well = (epsilon != 0.0) & (sigma != 0.0)
    return KJ * epsilon * is_well, np.where(is_well, NM * sigma, 1.0)


# by force or law: what OpenMM calls its terms, and the potential of their atoms and parameters
BONDED: dict[str, tuple[str, Any]] = {
    "HarmonicBondForce": (
        "Bond",
        lambda at, length, k: HarmonicBond(KJ / NM**2 * k, NM * length, at),
    ),
    "HarmonicAngleForce": ("Angle", lambda at, angle, k: HarmonicAngle(KJ * k, angle, at)),
    "PeriodicTorsionForce": (
        "Torsion",
        lambda at, n, phase, k: PeriodicDihedral(KJ * k, n, phase, at),
    ),
    "RBTorsionForce": (
        "Torsion",
        lambda at, *c: RyckaertBellemans([KJ * power for power in c], at),
    ),
    "-α/r^6+β/r^12": (
        "Bond",
        lambda at, c, a: BondPotential(LennardJonesLaw(), _in_ase_units(*_well(a, c)), at),
    ),
    "4*α*((β/r)^12-(β/r)^6)": (
        "Bond",
        lambda at, *well: BondPotential(LennardJonesLaw(), _in_ase_units(*well), at),
    ),
}
for _law in IMPROPERS:
    BONDED[_law] = ("Torsion", partial(_improper, 2.0, _law))
    BONDED[f"0.5*{_law}"] = ("Torsion", partial(_improper, 1.0, _law))
SIZES = {"Bond": 2, "Angle": 3, "Torsion": 4}  # atoms of a term
# wells: ε and σ of the parameters of particles; laws of their own mix geometrically
WELLS: Mapping[str, Any] = {
    "NonbondedForce": lambda charge, sigma, epsilon: (epsilon, sigma),
    "4*(sqrt(α1*α2))*(((sqrt(β1*β2))/r)^12-((sqrt(β1*β2))/r)^6)": lambda *well: well,
    "α1*α2/r^12-β1*β2/r^6": lambda a, c: _well(a * a, c * c),
}
# the same by tables of A and C, or √A and C, of pairs of types: A and C of their entries
TABLES: Mapping[str, Any] = {
    "acoef(α1,α2)/r^12-bcoef(α1,α2)/r^6": lambda a, c: (a, c),
    "((acoef(α1,α2))/(r^6))^2-(bcoef(α1,α2))/(r^6)": lambda root, c: (root * root, c),
}
# relative difference between wells of a table and mixed ones that rounding can explain
MIXED = 1e-9
# virtual sites: weights of their particles, which are 1 with that of the first, and of the normal [1/nm]
SITES: Mapping[str, Any] = {
    "TwoParticleAverageSite": lambda site: (site.getWeight(1), 0.0, 0.0),
    "ThreeParticleAverageSite": lambda site: (site.getWeight(1), site.getWeight(2), 0.0),
    "OutOfPlaneSite": lambda site: (
        site.getWeight12(),
        site.getWeight13(),
        site.getWeightCross(),
    ),
}
KNOWN = (*BONDED, "CMAPTorsionForce", *WELLS, *TABLES, "CMMotionRemover")
# what OpenMM calls the terms of a force, and those of custom ones that may be taken
TERMS = ("Particles", "Bonds", "Angles", "Torsions", "Donors", "Multipoles", "TorsionTorsions")
CUSTOM = {
    "CustomTorsionForce": "Torsion",
    "CustomBondForce": "Bond",
    "CustomNonbondedForce": "Particle",
}

TWICE = (
    "from_openmm takes the wells of one force; the system has a NonbondedForce with wells, or a CustomNonbondedForce, "
    "beside another: take one of them for all atoms"
)


def from_openmm(
    openmm_system: openmm.System, topology: openmm.app.Topology, positions: ArrayLike
) -> tuple[System, list[OwnPotential], tuple[Constraint, ...]]:
    """System, potentials and constraints, in minimd.units.ASE, from a system of OpenMM: any force field that it reads.

        made = openmm.app.ForceField("amber14-all.xml", "amber14/tip3p.xml").createSystem(pdb.topology, …)
        system, potentials, constraints = md.from_openmm(made, pdb.topology, pdb.positions)
        sim = md.Simulation(system, potentials, md.VelocityVerlet(2.0 * md.units.fs), constraints)

    Taken: harmonic bonds and angles, periodic and Ryckaert-Bellemans torsions, CMAP, NonbondedForce, masses, box
    vectors, constraints. Of custom forces: harmonic impropers; beside a NonbondedForce without wells, those that mix
    geometrically, as OPLS has them, and tables of wells of pairs of types, as CHARMM with NBFIX; wells of bonds, as
    CHARMM, and bonds C, A of GROMACS, by the expressions that readers of OpenMM write; see IMPROPERS, BONDED, WELLS and
    TABLES. CMMotionRemover is left out, because minimd's forces conserve momentum, and so are
    forces without terms. Virtual sites of two or three particles and out of their plane are Sites. Any other particle
    of mass 0 is one of FixedAtoms, with the mass of its element. Species are the elements, X without one, numbered
    where they have several Lennard-Jones parameters; bonds and names are those of the topology.

    The exceptions of NonbondedForce become exclusions of LennardJones and Coulomb, and, if they have parameters, a
    BondPotential. The law of charges is summed to ewaldErrorTolerance, whatever Ewald parameters or PME grid are given.
    Energies differ from those of OpenMM: its constant k_e, 138.9354576 kJ nm/(mol e²), is larger by 9e-10 of it; its
    dispersion correction is a mean over N (N + 1)/2 pairs, not over N²/2. Terms of minimd act on nearest
    images; those of OpenMM do if they use periodic boundary conditions, or if molecules are whole.

    Warns of impropers k*(theta-theta0)^2 with theta0 other than 0, which have a jump in OpenMM.

    Parameters
    ----------
    openmm_system : openmm.System.
    topology : openmm.app.Topology.
    positions : (N, 3) of OpenMM, with a unit, or in nm.

    Raises
    ------
    TypeError : for anything but a system of OpenMM.
    ValueError : for other forces (other custom ones, with their expressions, baths, barostats), other virtual
        sites, LJPME, parameter offsets and CMAP of several sizes, by name; for a particle without mass and element; for
        another number of atoms; as System and potentials.
    """
    if not hasattr(openmm_system, "getForces"):
        raise TypeError(
            f"openmm_system must be an openmm.System; openmm_system = {shown(openmm_system)}"
        )
    forces = [force for force in openmm_system.getForces() if _has_terms(force)]
    places = np.array(_plain(positions), float)
    n = openmm_system.getNumParticles()
    atoms = [*topology.atoms()]
    if not n == len(atoms) == len(places):
        raise ValueError(
            f"OpenMM's system, topology and positions must have the same number of atoms; they have {n}, "
            f"{len(atoms)} and {len(places)}"
        )
    masses = [_plain(openmm_system.getParticleMass(k)) for k in range(n)]
    _check(openmm_system, forces, atoms, masses)
    fixed = _fixed(openmm_system, masses)
    for k in fixed:  # held by OpenMM
        masses[k] = _plain(atoms[k].element.mass)

    charges = np.zeros(n)
    numbers = np.zeros((n, 3))
    potentials = [potential for force in forces for potential in _bonded(force)]
    wells = nonbonded = table = None

    for force in forces:
        kind, order = _kind(force)
        if kind in (*WELLS, *TABLES):
            parameters = _rows(force, "Particle").T[order]
            of_atoms, of_types = _wells(force, kind, parameters)
            if of_atoms[:, 0].any() or of_types is not None:
                if wells is not None:
                    raise ValueError(TWICE)
                wells = force
                numbers = of_atoms
                table = of_types
            if kind == "NonbondedForce":
                nonbonded = force
                charges = parameters[0]

    names = [*map(_names, atoms)]
    kinds = [*map(tuple, numbers.tolist())]
    species = _labels([(row[1] or "X", kind) for row, kind in zip(names, kinds, strict=True)])
    system = System(
        NM * places,
        masses=masses,
        charges=charges,
        cell=_cell(openmm_system),
        species=species,
        bonds=sorted({tuple(sorted((a.index, b.index))) for a, b in topology.bonds()}),
        units=ASE,
        constraints=_constraints(openmm_system, fixed),
        topology=np.array(names),
        sites=_sites(openmm_system),
    )
    if wells is not None:
        potentials.append(_lennard_jones(wells, dict(zip(species, kinds, strict=True)), table))
    if nonbonded is not None:
        potentials += _charged(nonbonded, charges)
    return system, potentials, system.constraints


def _cell(openmm_system: openmm.System) -> Array | None:
    """Its box vectors [Å], if it is periodic."""
    if not openmm_system.usesPeriodicBoundaryConditions():
        return None
    vectors = openmm_system.getDefaultPeriodicBoxVectors()
    return NM * np.array([_plain(vector) for vector in vectors], float)


def _fixed(openmm_system: openmm.System, masses: list[float]) -> list[int]:
    """Its particles of mass 0 that are no virtual sites."""
    massless = np.flatnonzero(np.equal(masses, 0.0)).tolist()
    return [k for k in massless if not openmm_system.isVirtualSite(k)]


def _sites(openmm_system: openmm.System) -> Sites | None:
    """Its virtual sites; one of two particles has the first of them as a third, of weight 0."""
    atoms = [*filter(openmm_system.isVirtualSite, range(openmm_system.getNumParticles()))]
    if not atoms:
        return None
    sites = [*map(openmm_system.getVirtualSite, atoms)]
    parents = [[site.getParticle(k % site.getNumParticles()) for k in range(3)] for site in sites]
    rows = [SITES[type(site).__name__](site) for site in sites]

    second, third, normal = np.array(rows).T
    weights = np.column_stack([1.0 - second - third, second, third])
    return Sites(atoms, parents, weights, normal / NM)


def _constraints(openmm_system: openmm.System, fixed: list[int]) -> list[Constraint]:
    """Its lengths, except for those between fixed atoms; and the fixed atoms."""
    held = _rows(openmm_system, "Constraint")
    held = held[~np.isin(held[:, :2], fixed).all(axis=1)]
    constraints: list[Constraint] = []

    if len(held):
        constraints.append(DistanceConstraints(held[:, :2].astype(int), NM * held[:, 2]))
    if fixed:
        constraints.append(FixedAtoms(fixed))
    return constraints


def _has_terms(force: openmm.Force) -> bool:
    """Whether a force acts on any atom; true for those whose terms OpenMM does not count, as barostats."""
    return 0 not in [getattr(force, f"getNum{name}", object)() for name in TERMS]


def _kind(force: Any) -> tuple[str, Any]:
    """The class of a force; of a custom one, if minimd may have it, its law. And which of its parameters are α, β …

    A law is its energy without blanks, with definitions in their places, in parentheses, and with parameters called α,
    β … in the order in which they appear.
    """
    kind = type(force).__name__
    name = f"Per{CUSTOM.get(kind)}Parameter"
    n_parameters = getattr(force, f"getNum{name}s", int)()
    parameters = [getattr(force, f"get{name}Name")(k) for k in range(n_parameters)]
    if not parameters or getattr(force, "getNumInteractionGroups", int)():
        return kind, slice(None)
    law, _, definitions = re.sub(r"\s|\.0\b", "", force.getEnergyFunction()).partition(";")
    for symbol, value in re.findall(r"(\w+)=([^;\\]+)", definitions):
        law = re.sub(rf"\b{symbol}\b", f"({value})", law)
    law = re.sub(r"\(3\.14159\d*\)|3\.14159\d*", "pi", law)
    letters: dict[str, str] = {}

    def letter(symbol: re.Match) -> str:
        return letters.setdefault(symbol[0], chr(ord("α") + len(letters)))

    symbols = rf"\b({'|'.join(map(re.escape, parameters))})(?=[12]?\b)"
    law = re.sub(symbols, letter, law)
    return law, [parameters.index(symbol) for symbol in letters]


def _check(
    openmm_system: openmm.System, forces: list[Any], atoms: list[Any], masses: list[float]
) -> None:
    """Raise ValueError for what minimd does not have, in words."""
    strange = []
    baths = []

    for k, atom in enumerate(atoms):
        if openmm_system.isVirtualSite(k):
            site = type(openmm_system.getVirtualSite(k)).__name__
            if site not in SITES:
                strange = [f"virtual sites of the kind {site}, such as particle {k}"]
        elif not (atom.element or masses[k]):
            strange = [f"particles of mass 0 that have no element, such as particle {k}"]

    for force in forces:
        kind, _ = _kind(force)
        name = type(force).__name__
        if name.endswith("stat"):
            baths.append(name)
        elif kind not in KNOWN:
            strange.append(name)
            if hasattr(force, "getEnergyFunction"):
                strange.append(f"its energy {force.getEnergyFunction()}")
        elif kind == "CMAPTorsionForce":
            if len({force.getMapParameters(k)[0] for k in range(force.getNumMaps())}) > 1:
                strange.append("CMAP of several sizes")
        elif kind == "NonbondedForce":
            if force.getNonbondedMethod() == force.LJPME:
                strange.append("the method LJPME")
            if force.getNumParticleParameterOffsets() or force.getNumExceptionParameterOffsets():
                strange.append("parameter offsets of NonbondedForce")
            if not force.getIncludeDirectSpace():
                strange.append("NonbondedForce without its direct space")

    if [type(force).__name__ for force in forces].count("NonbondedForce") > 1:
        strange.append("a second NonbondedForce")
    if strange:
        strange = [f"{listed(strange)}: take other forces, or OpenMM itself"]
    if baths:
        strange.append(f"{listed(baths)}: give a method or barostat of minimd to md.Simulation")
    if strange:
        raise ValueError(
            f"from_openmm takes {listed(filter(str.isalpha, KNOWN))}, and {listed(CUSTOM)} by the expressions of OPLS, "
            f"CHARMM and GROMACS; it does not take {'; nor '.join(strange)}"
        )


def _bonded(force: Any) -> Iterator[OwnPotential]:
    """The potential of a bonded force, if it is one."""
    kind, order = _kind(force)

    if kind == "CMAPTorsionForce":
        yield _dihedral_map(force)

    if kind in BONDED:
        name, potential = BONDED[kind]
        rows = _rows(force, name)
        size = SIZES[name]
        yield potential(rows[:, :size].astype(int), *rows[:, size:].T[order])


def _dihedral_map(force: openmm.CMAPTorsionForce) -> DihedralMap:
    """Its maps, of one size; those of OpenMM run along the first angle."""
    maps = [force.getMapParameters(k) for k in range(force.getNumMaps())]
    size = maps[0][0]

    energies = np.reshape([_plain(energy) for _, energy in maps], (-1, size, size))

    rows = _rows(force, "Torsion").astype(int)
    return DihedralMap(KJ * energies.swapaxes(1, 2), rows[:, 1:5], rows[:, 5:], rows[:, 0])


def _wells(force: Any, kind: str, parameters: Array) -> tuple[Array, Array | None]:
    """ε [eV], σ [Å] and type of each particle, (N, 3); and ε and σ of pairs of types, (2, T, T), if a force has tables.
    Types that are alike become the first of them.

    kind : one of WELLS and TABLES.
    parameters : (P, N).
    """
    if kind in WELLS:
        wells = _in_ase_units(*WELLS[kind](*parameters))
        return np.column_stack([*wells, np.zeros(len(wells[0]))]), None

    functions = {
        force.getTabulatedFunctionName(k): force.getTabulatedFunction(k).getFunctionParameters()
        for k in range(force.getNumTabulatedFunctions())
    }

    n_types = functions["acoef"][0]
    coefficients = [np.array(functions[name][2]) for name in ("acoef", "bcoef")]
    wells = _in_ase_units(*_well(*TABLES[kind](*coefficients)))

    present, places = np.unique(parameters[0].astype(int), return_inverse=True)
    table = np.reshape(wells, (2, n_types, n_types))[:, present][:, :, present]
    _, first, alike = np.unique(np.hstack([*table]), True, True, axis=0)
    types = first[alike][places]
    return np.column_stack([*table[:, types, types], types]), table


def _lennard_jones(force: Any, kinds: Mapping[Any, Any], table: Array | None) -> LennardJones:
    """The wells of a NonbondedForce, or of a CustomNonbondedForce.
    kinds : (ε, σ, type) of each species.
    table : ε and σ of pairs of types; those that mixing does not give become pairs."""
    own = {name: kind[:2] for name, kind in kinds.items()}
    mixing: Any = "lorentz-berthelot"
    pairs = {}

    if table is not None:
        names = [*kinds]
        types = [int(kind[2]) for kind in kinds.values()]
        given = np.moveaxis(table, 0, 2)[types][:, types]
        mixed = LennardJones(own, truncation="truncated").table(names)[:, :, 1:]
        differ = ~np.isclose(given, mixed, MIXED, 0.0).all(axis=2)
        differ &= np.logical_or(given, mixed)[..., 0]  # without ε, σ means nothing

        for i, j in np.argwhere(np.triu(differ)):
            pairs[names[i], names[j]] = tuple(given[i, j].tolist())

    truncation: Any = "truncated"
    switch_start = None
    if type(force).__name__ == "CustomNonbondedForce":
        mixing = "geometric" if table is None else mixing
        has_tail = force.getUseLongRangeCorrection()
        excluded = _rows(force, "Exclusion", "Particles")
    else:
        has_tail = force.getUseDispersionCorrection()
        excluded = _rows(force, "Exception")

    cutoff = _cutoff(force)

    if cutoff is not None and force.getUseSwitchingFunction():
        truncation = "switched"
        switch_start = NM * _plain(force.getSwitchingDistance())

    return LennardJones(
        own,
        None,
        cutoff,
        truncation,
        mixing=mixing,
        pairs=pairs,
        switch_start=switch_start,
        tail_correction=has_tail and force.usesPeriodicBoundaryConditions(),
        exclusions=excluded[:, :2].astype(int),
    )


def _cutoff(force: Any) -> float | None:
    if force.getNonbondedMethod() == force.NoCutoff:
        return None
    return float(NM * _plain(force.getCutoffDistance()))


def _charged(force: openmm.NonbondedForce, charges: Array) -> list[OwnPotential]:
    """The potentials of its charges and exceptions."""
    potentials: list[OwnPotential] = []
    rows = _rows(force, "Exception")
    pairs = rows[:, :2].astype(int)

    if charges.any():
        accuracy = min(max(force.getEwaldErrorTolerance(), MOST_ACCURATE), LEAST_ACCURATE)
        options: Any = {}
        if force.getNonbondedMethod() not in (force.NoCutoff, force.Ewald, force.PME):
            options["method"] = "reaction-field"
            options["dielectric"] = force.getReactionFieldDielectric()
        potentials.append(
            Coulomb(_cutoff(force), accuracy, bonded_scale=UNSCALED, exclusions=pairs, **options)
        )

    product = ASE.coulomb * rows[:, 2]
    no_cutoff = np.full(len(rows), LARGEST)
    numbers = np.array([product, no_cutoff, *_in_ase_units(rows[:, 4], rows[:, 3])])
    acts = numbers[[0, 2]].any(axis=0)

    if acts.any():
        law = ChargedLaw(LennardJonesLaw(), CoulombLaw(NO_REST))
        potentials.append(BondPotential(law, (*numbers[:, acts],), pairs[acts]))
    return potentials


def _names(atom: Any) -> list[str]:
    """Its row in the topology of a System. A residue whose label is no number has that of its place."""
    residue = atom.residue
    symbol = atom.element.symbol if atom.element else ""
    number = residue.id if residue.id.lstrip("-").isdecimal() else str(residue.index + 1)
    return [atom.name, symbol, residue.name, number, residue.chain.id]


def _labels(atoms: list[tuple[str, Any]]) -> list[str]:
    """Species of atoms (symbol, well): the symbols, and where one has several wells, their numbers, from 1 on."""
    numbers: dict[str, dict[Any, int]] = {}

    for symbol, well in atoms:
        wells = numbers.setdefault(symbol, {})
        wells.setdefault(well, len(wells) + 1)

    return [
        f"{symbol}{numbers[symbol][well]}" if len(numbers[symbol]) > 1 else symbol
        for symbol, well in atoms
    ]


def _rows(owner: Any, name: str, what: str = "Parameters") -> Array:
    """All parameters that a system or a force of OpenMM has of its terms, by their name, (n, …) in nm, kJ/mol, e."""
    n = getattr(owner, f"getNum{name}s")()
    parameters = getattr(owner, f"get{name}{what}")
    rows = [np.hstack([*map(_plain, parameters(k))]) for k in range(n)]
    return np.array(rows, float) if rows else np.zeros((0, 5))


def _plain(quantity: Any) -> Any:
    """The value of a quantity of OpenMM in nm, kJ/mol, e, u and rad; what has no unit is taken as it is."""
    from openmm.unit import is_quantity, md_unit_system

    return quantity.value_in_unit_system(md_unit_system) if is_quantity(quantity) else quantity
