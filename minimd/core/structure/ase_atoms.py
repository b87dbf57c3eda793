"""ASE's atoms as systems, and systems as ASE's atoms, with their constraints."""

from typing import Any

import numpy as np
from ase import Atoms
from ase.calculators.singlepoint import SinglePointCalculator
from ase.constraints import FixAtoms, FixBondLengths, FixCom, FixConstraint, FixLinearTriatomic
from ase.data import atomic_numbers
from ase.geometry import find_mic
from ase.stress import full_3x3_to_voigt_6_stress
from ase.units import fs
from numpy.typing import ArrayLike

from minimd.core.console.quiet import warn
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import GROUPS, joined_in, texts
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.constraints import (
    TOLERANCE,
    Constraint,
    DistanceConstraints,
    FixedAtoms,
    lengths_of,
)
from minimd.core.structure.elements import Stated, check_names, identified, species_of
from minimd.core.structure.lammps_units import LAMMPS_UNITS
from minimd.core.structure.observables import center, momentum, stress as kinetic_stress
from minimd.core.structure.units import ASE, UnitSystem

LABELS = "species_labels"  # the array of an ase.Atoms for species that are not chemical elements
# in the info of atoms from a .traj, which keeps no such array: the names of species; tags are indices into them
NAMES = "species_names"
TYPES = (
    "types"  # an array of atoms from LAMMPS and DL_POLY, whose velocities do not depend on masses
)
# names of columns, their unit in words, and what they are divided by
VELOCITIES = {"velo": ("ASE's units", 1.0), "vel": ("Å/fs", fs)}
FULL = 1e-3  # least difference of an occupancy from one
Given = ArrayLike | None
UNDERSTOOD = "FixAtoms, FixBondLengths, FixBondLength, FixLinearTriatomic, FixCom"


def system_arguments(
    atoms: Atoms,
    bonds: Given = None,
    constraints: bool = True,
    stated: Stated | None = None,
    masses: Any = None,
    elements: Any = None,
    units: UnitSystem = ASE,
    **others: Given,
) -> dict[str, Any]:
    """Arguments for System from an ase.Atoms: positions, velocities, masses, cell, periodicity and
    constraints. Charges are the initial charges, or those of a column of a file. Species are
    the chemical symbols, or labels that atoms_from_system or label_by_tags stored in them.

    bonds, others : bonds, angles, dihedrals and impropers, as for System; without bonds,
        what the arrays of the atoms name: see joined_in.
    constraints : True to take those of the atoms; False if the caller handles them.
    stated : what stated_of has told, if it was asked.
    masses, elements : given by the user, see elements.identified.
    units : ASE's; or reduced units, in which numbers are unchanged, and velocities without masses are left out.

    Raises TypeError for anything but an ase.Atoms.  ValueError for constraints that minimd does not know, for sites
    that are occupied in part, for atoms without mass and element (X), and as joined_in.
    """
    checked_kind("atoms", atoms, Atoms, "an ase.Atoms or, as system, a minimd System")
    stated = stated or stated_of(atoms)
    source = stated.source
    has_masses = stated.masses is not None
    _check_occupancy(atoms, source)
    title = LAMMPS_UNITS.search(str(atoms.info.get("comment")))
    if title and title[1] != "metal" and (title[1] != "real" or atoms.has("momenta")):
        warn(
            f"the file of {source} states units = {title[1]}; if these were not given to ase.io.read, its numbers are "
            "wrong: minimd.ase.system_from_file reads them as stated"
        )

    groups = joined_in(atoms).groups if bonds is None else {"bonds": bonds}
    groups = groups | {name: rows for name, rows in others.items() if rows is not None}
    weights, symbols = identified(stated, masses, elements, is_reduced=units.is_reduced)
    # files of the databank have this cell where there is none
    is_dummy = "residuenames" in atoms.arrays and np.array_equal(atoms.cell.array, np.eye(3))
    labels = stated.names if "type" in atoms.arrays and not any(symbols) else _labels(atoms)
    velocities = _velocities(atoms, source, units, has_masses)
    if constraints and fixes_center(atoms):
        velocities -= momentum(velocities, weights) / weights.sum()
    return {
        "positions": atoms.positions,
        "masses": weights,
        "charges": _charges(atoms),
        "velocities": velocities,
        "cell": None if is_dummy else cell_of(atoms),
        "species": labels if symbols == stated.elements else species_of(symbols, labels),
        **groups,
        "units": units,
        "constraints": constraints_of(atoms) if constraints else (),
    }


def stated_of(atoms: Atoms, source: str = "this ase.Atoms") -> Stated:
    """What atoms state. Types of LAMMPS and X are no elements; names of atoms, which ASE keeps from PDB and GRO files,
    must agree with the elements that it has made of them.

    source : in words, for messages.
    Raises ValueError if they do not agree."""
    arrays = atoms.arrays
    symbols = [symbol if symbol != "X" else "" for symbol in atoms.get_chemical_symbols()]
    masses = atoms.get_masses() if atoms.has("masses") else arrays.get("mass")
    names = [str(label) for label in arrays.get("atomtypes", _labels(atoms))]
    if masses is None and "type" in arrays and np.array_equal(arrays["type"], atoms.numbers):
        symbols = [""] * len(atoms)
        names = [str(kind) for kind in arrays["type"].tolist()]
    residues = residue_of = None
    if "residuenames" in arrays:
        residues = [str(label) for label in arrays["residuenames"]]
    if "residuenumbers" in arrays:
        residue_of = np.unique(arrays["residuenumbers"], return_inverse=True)[1]
    stated = Stated(source, names, atoms.positions, symbols, masses, residues, residue_of)
    if masses is None and "atomtypes" in arrays and residues is not None:
        check_names(stated)
    return stated


def _check_occupancy(atoms: Atoms, source: str) -> None:
    """Raise ValueError for sites of a CIF file that are occupied in part, or by several elements."""
    sites = atoms.info.get("occupancy")
    if not isinstance(sites, dict):
        return
    for k, kind in enumerate(atoms.arrays.get("spacegroup_kinds", range(len(atoms)))):
        shares = sites.get(str(kind), {})
        numbers = [
            share for share in shares.values() if not isinstance(share, str)
        ]  # not "." or "?"
        if len(shares) > 1 or any(abs(share - 1.0) > FULL for share in numbers):
            occupancy = ", ".join(f"{share} of {element}" for element, share in shares.items())
            raise ValueError(
                f"the site of atom {k} of {source} has an occupancy of {occupancy}: a list of such sites is no "
                "structure; choose atoms for them, with whole occupancies, or delete atoms.info['occupancy'] if you "
                "have done so"
            )


def _charges(atoms: Atoms) -> Array:
    """Initial charges [e], or those of a column of an extended XYZ file, which ASE keeps as results."""
    charges = atoms.get_initial_charges()
    if isinstance(atoms.calc, SinglePointCalculator) and not atoms.has("initial_charges"):
        charges = atoms.calc.results.get("charges", charges)
    return np.asarray(charges)


def _velocities(atoms: Atoms, source: str, units: UnitSystem, has_masses: bool) -> Array:
    """Velocities of momenta, or of a column of an extended XYZ file: velo in ASE's units, as its specification says,
    vel in Å/fs, as GPUMD writes it, which is told; in reduced units unchanged, and zero if they depend on masses that
    nobody states."""
    name = next((name for name in VELOCITIES if name in atoms.arrays), "")
    if not name or atoms.has("momenta"):
        is_known = not units.is_reduced or has_masses or TYPES in atoms.arrays
        return np.asarray(atoms.get_velocities() * is_known)
    column = np.array(atoms.arrays[name], float)
    if units is not ASE:
        return column
    unit, factor = VELOCITIES[name]
    warn(
        f"the column {name!r} of {source} is taken for velocities in {unit}; the file does not state their unit"
    )
    return column / factor


def atoms_from_system(system: Any) -> Atoms:
    """ASE's atoms with the positions (not wrapped), momenta, masses, cell, periodicity, constraints, bonds,
    angles and dihedrals of a system; its charges as initial charges, unless all are zero.

    Species that are chemical symbols become elements. All others become 'X', ASE's symbol for no element, and all
    labels are kept in the array "species_labels", where system_arguments finds them again. Numbers are not converted:
    for a system in reduced units they are not in Å and eV. Bonds, angles, dihedrals and impropers become arrays with
    these names, as ASE's reader of LAMMPS data makes them. The array "id" shows system_arguments that no atoms were cut
    out or sorted; it gives the groups back in the order of their first atoms."""
    symbols = [label if label in atomic_numbers else "X" for label in system.species.tolist()]
    masses = system.masses
    cell = system.cell
    momenta = system.velocities * masses[:, None]
    atoms = Atoms(
        symbols, system.positions, momenta=momenta, masses=masses, cell=cell.vectors, pbc=cell.pbc
    )
    if system.charges.any():
        atoms.set_initial_charges(system.charges)
    if not set(system.species_names) <= set(atomic_numbers):
        atoms.set_array(LABELS, system.species)
    joined = texts(system.groups(), len(atoms))
    if joined:
        atoms.arrays.update(joined, id=np.arange(1, len(atoms) + 1))
    constraints: list[FixConstraint] = []

    for constraint in system.constraints:
        if isinstance(constraint, FixedAtoms):
            constraints.append(FixAtoms(indices=constraint.atoms))
        else:
            pairs = constraint.pairs.copy()
            lengths = lengths_of(system.positions, cell, constraint).copy()
            constraints.append(FixBondLengths(pairs, constraint.tolerance, lengths))

    atoms.set_constraint(constraints)
    return atoms


def label_by_tags(atoms: Atoms, system: Any) -> None:
    """Store species that are not elements where a .traj keeps them: names in info, their indices in tags."""
    if LABELS in atoms.arrays:
        atoms.info[NAMES] = list(system.species_names)
        atoms.set_tags(system.species_index)


def _labels(atoms: Atoms) -> Any:
    """The species of each atom: its label, or else its chemical symbol; an atom that is not X needs no label."""
    names = atoms.info.get(NAMES)
    labels = atoms.get_chemical_symbols()
    if LABELS in atoms.arrays or names is None:
        return atoms.arrays.get(LABELS, labels)
    for k, tag in enumerate(atoms.get_tags().tolist()):
        if labels[k] == "X" and 0 <= tag < len(names):
            labels[k] = names[tag]
    return labels


def cell_of(atoms: Atoms) -> Cell:
    """The cell and periodicity of atoms."""
    return Cell.of(atoms.cell.array, atoms.pbc)


def same_labels(one: Atoms, other: Atoms) -> bool:
    """True if species that are not elements have the same labels."""
    return np.array_equal(one.arrays.get(LABELS, ()), other.arrays.get(LABELS, ()))


def same_scene(one: Atoms, other: Atoms) -> bool:
    """True if only positions, momenta and cell can differ."""
    scenes = []
    for atoms in (one, other):
        arrays = [atoms.numbers, atoms.get_masses(), atoms.get_initial_charges(), atoms.pbc]
        arrays += [atoms.arrays.get(name, ()) for name in (LABELS, *GROUPS)]
        scenes.append(arrays)
    return one.calc is other.calc and all(map(np.array_equal, *scenes))


def calculators_stress(stress: Array, atoms: Atoms, conserves_momentum: bool) -> Array:
    """What ASE calls the stress, (6,) as xx yy zz yz xz xy [eV/Å³]: without the kinetic part, which
    get_stress(include_ideal_gas=True) adds.
    stress : (3, 3), of an engine with the atoms in their present motion.
    conserves_momentum : of that engine."""
    velocities = atoms.get_velocities()
    masses = atoms.get_masses()
    velocities -= center(velocities, masses, conserves_momentum)
    moving = kinetic_stress(velocities, masses, np.zeros((3, 3)), volume_of(atoms))
    return full_3x3_to_voigt_6_stress(stress - moving)


def volume_of(atoms: Atoms) -> float:
    """Volume of the parallelepiped, periodic or not [Å³]; 0 if there is none."""
    return float(atoms.get_volume()) if atoms.cell.rank == 3 else 0.0


def constraints_of(atoms: Atoms) -> tuple[Constraint, ...]:
    """The constraints of atoms: lengths, linear molecules and fixed atoms. FixCom is left out: see fixes_center.
    Raises ValueError for a constraint of another kind, by name."""
    n = len(atoms)
    pairs: list[Indices] = []
    lengths: list[Array] = []
    tolerances: list[float] = []
    fixed: list[int] = []

    for constraint in atoms.constraints:
        if isinstance(constraint, FixBondLengths):
            bonds = _counted_from_front(constraint.pairs, n)
            stated = constraint.bondlengths
            pairs.append(bonds)
            lengths.append(
                _distances(atoms, bonds) if stated is None else np.asarray(stated, float)
            )
            tolerances.append(float(constraint.tolerance))
        elif isinstance(constraint, FixLinearTriatomic):
            triples = _counted_from_front(constraint.triples, n)
            first = triples[:, :2]
            second = triples[:, 1:]
            bonds = np.concatenate([first, second])
            distances = _distances(atoms, bonds)
            # the distance of the ends is the sum of both bonds
            pairs += [bonds, triples[:, [0, 2]]]
            lengths += [distances, distances.reshape(2, -1).sum(axis=0)]
        elif isinstance(constraint, FixAtoms):
            fixed.extend(np.arange(n)[constraint.index])
        elif type(constraint) is not FixCom:
            raise ValueError(
                f"atoms.constraints may hold {UNDERSTOOD}; it holds {type(constraint).__name__}: remove it, or use "
                "ASE's dynamics"
            )

    if fixed and fixes_center(atoms):
        raise ValueError(
            "atoms.constraints holds FixCom and FixAtoms: with fixed atoms the center of mass does not stay by itself; "
            "remove FixCom or FixAtoms"
        )

    constraints: list[Constraint] = [FixedAtoms(np.unique(fixed))] if fixed else []
    if pairs:
        tolerance = min(tolerances, default=TOLERANCE)
        distances = np.concatenate(lengths)
        constraints.append(DistanceConstraints(np.concatenate(pairs), distances, tolerance))

    return tuple(constraints)


def fixes_center(atoms: Atoms) -> bool:
    """Whether the center of mass is held. If momentum is conserved, it is enough that it is zero at the start;
    Engine refuses all other cases."""
    return any(isinstance(constraint, FixCom) for constraint in atoms.constraints)


def _distances(atoms: Atoms, pairs: Indices) -> Array:
    """Distances to the nearest image [Å]."""
    vectors = atoms.positions[pairs[:, 1]] - atoms.positions[pairs[:, 0]]
    return find_mic(vectors, atoms.cell, atoms.pbc)[1]


def _counted_from_front(indices: Any, n_atoms: int) -> Indices:
    """Indices of atoms; negative ones count from the last atom, in ASE as in Python."""
    array = np.asarray(indices, np.int64)
    return np.where(array < 0, array + n_atoms, array)
