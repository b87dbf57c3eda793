"""ASE's atoms as systems, and systems as ASE's atoms."""

from __future__ import annotations

from typing import Any

import numpy as np
from ase import Atoms
from ase.data import atomic_numbers
from ase.stress import full_3x3_to_voigt_6_stress
from numpy.typing import ArrayLike, NDArray

from minimd.structure.ase_constraints import ases_constraints_of, constraints_of, fixes_center
from minimd.structure.bond_graph import GROUPS
from minimd.structure.cell import Cell
from minimd.structure.console import warn_of_charges
from minimd.structure.joined import joined_in, texts
from minimd.structure.observables import center, momentum
from minimd.structure.observables import stress as kinetic_stress
from minimd.structure.units import ASE

LABELS = "species_labels"  # the array of an ase.Atoms for species that are not chemical elements
NAMES = "species_names"  # in the info of atoms from a .traj, which keeps no such array: the names of species; tags are indices into them


def system_arguments(atoms: Atoms, bonds: ArrayLike | None = None, constraints: bool = True, **others: ArrayLike | None) -> dict[str, Any]:
    """Arguments for System, in ASE's units, from an ase.Atoms: positions, velocities, masses, cell, periodicity and constraints.

    Species are the chemical symbols, or the labels that atoms_from_system or label_by_tags stored in the atoms.

    bonds, others : bonds, angles, dihedrals and impropers, as for System; without bonds, what the arrays of the atoms name: see joined_in.
    constraints : True to take those of the atoms; False if the caller handles them.

    Raises TypeError for anything but an ase.Atoms.  ValueError for constraints that minimd does not know, and as joined_in.
    Warns of charges, which are not used.
    """
    if not isinstance(atoms, Atoms):
        raise TypeError(f"a minimd System or an ase.Atoms is expected; got {type(atoms).__name__}")
    warn_of_charges(atoms.get_initial_charges())
    found = joined_in(atoms) if bonds is None else None
    velocities, masses = atoms.get_velocities(), atoms.get_masses()
    if constraints and fixes_center(atoms):
        velocities -= momentum(velocities, masses) / masses.sum()
    return {
        "positions": atoms.positions,
        "masses": masses,
        "velocities": velocities,
        "cell": cell_of(atoms),
        "species": _labels(atoms),
        **(found.groups if found is not None else {"bonds": bonds}),
        **{name: given for name, given in others.items() if given is not None},
        "units": ASE,
        "constraints": constraints_of(atoms) if constraints else (),
    }


def atoms_from_system(system: Any) -> Atoms:
    """ASE's atoms with the positions (not wrapped), momenta, masses, cell, periodicity, constraints, bonds, angles and dihedrals of a system.

    Species that are chemical symbols become elements. All others become 'X', ASE's symbol for no element, and all labels
    are kept in the array "species_labels", where system_arguments finds them again. Numbers are not converted: for a system
    in reduced units they are not in Å and eV. Bonds, angles, dihedrals and impropers become arrays with these names, as ASE's reader of LAMMPS
    data makes them. The array "id" shows system_arguments that no atoms were cut out or sorted; it gives the groups back in the order of their
    first atoms.
    """
    symbols = [label if label in atomic_numbers else "X" for label in system.species.tolist()]
    momenta = system.velocities * system.masses[:, None]
    atoms = Atoms(symbols, system.positions, momenta=momenta, masses=system.masses, cell=system.cell.vectors, pbc=system.cell.pbc)
    if not set(system.species_names) <= set(atomic_numbers):
        atoms.set_array(LABELS, system.species)
    if named := texts(system.groups(), len(atoms)):
        atoms.arrays.update(named, id=np.arange(1, len(atoms) + 1))
    atoms.set_constraint(ases_constraints_of(system))
    return atoms


def label_by_tags(atoms: Atoms, system: Any) -> None:
    """Store species that are not elements where a .traj keeps them: their names in info, and the index of each atom's species in its tag."""
    if LABELS in atoms.arrays:
        atoms.info[NAMES] = list(system.species_names)
        atoms.set_tags(system.species_index)


def _labels(atoms: Atoms) -> Any:
    """The species of each atom: its label, or else its chemical symbol; an atom with a symbol other than X needs no label."""
    names = atoms.info.get(NAMES)
    if LABELS in atoms.arrays or names is None:
        return atoms.arrays.get(LABELS, atoms.get_chemical_symbols())
    symbols, tags = atoms.get_chemical_symbols(), atoms.get_tags().tolist()
    return [names[tag] if symbol == "X" and 0 <= tag < len(names) else symbol for symbol, tag in zip(symbols, tags, strict=True)]


def cell_of(atoms: Atoms) -> Cell:
    """The cell and periodicity of atoms."""
    return Cell.of(atoms.cell.array, atoms.pbc)


def same_labels(one: Atoms, other: Atoms) -> bool:
    """True if species that are not elements have the same labels."""
    return np.array_equal(one.arrays.get(LABELS, ()), other.arrays.get(LABELS, ()))


def same_scene(one: Atoms, other: Atoms) -> bool:
    """True if only positions, momenta and cell can differ."""
    arrays = [(one.numbers, other.numbers), (one.get_masses(), other.get_masses()), (one.pbc, other.pbc)]
    arrays += [(one.arrays.get(name, ()), other.arrays.get(name, ())) for name in GROUPS]
    return all(np.array_equal(a, b) for a, b in arrays) and same_labels(one, other) and one.calc is other.calc


def calculators_stress(stress: NDArray[np.float64], atoms: Atoms, conserves_momentum: bool) -> NDArray[np.float64]:
    """What ASE calls the stress, (6,) as xx yy zz yz xz xy [eV/Å³]: without the kinetic part, which get_stress(include_ideal_gas=True) adds.

    stress : (3, 3), of an engine with the atoms in their present motion.  conserves_momentum : of that engine.
    """
    velocities, masses = atoms.get_velocities(), atoms.get_masses()
    velocities -= center(velocities, masses, conserves_momentum)
    moving = kinetic_stress(velocities, masses, np.zeros((3, 3)), volume_of(atoms))
    return full_3x3_to_voigt_6_stress(stress - moving)


def volume_of(atoms: Atoms) -> float:
    """Volume of the parallelepiped, periodic or not [Å³]; 0 if there is none."""
    return float(atoms.get_volume()) if atoms.cell.rank == 3 else 0.0
