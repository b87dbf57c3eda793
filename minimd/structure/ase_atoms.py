"""ASE's atoms as systems, and systems as ASE's atoms."""

from pathlib import Path

import ase.io
import numpy as np
from ase import Atoms
from ase.data import atomic_masses, atomic_numbers
from numpy.typing import ArrayLike

from minimd.structure import units
from minimd.structure.ase_constraints import ases_constraints_of, constraints_of, fixes_center
from minimd.structure.cell import Cell
from minimd.structure.system import System
from minimd.structure.velocities import without_momentum

LABELS = "species_labels"  # the array of an ase.Atoms that holds species which are no chemical elements


def system_from_atoms(atoms: Atoms, bonds: ArrayLike | None = None) -> System:
    """A system in ASE's units: positions, velocities, masses, cell, periodicity and constraints of the atoms.

    Parameters
    ----------
    atoms : ase.Atoms. Species are the chemical symbols, or the labels that atoms_from_system left there.
    bonds : (B, 2) int, pairs of bonded atoms; ASE's atoms carry none.

    Raises
    ------
    TypeError : for something that is no ase.Atoms.  ValueError : for constraints that minimd does not know, and as System does.
    """
    if not isinstance(atoms, Atoms):
        raise TypeError(f"a minimd System or an ase.Atoms is expected; got {type(atoms).__name__}")
    system = unchecked_system(atoms, bonds)
    system.constraints = constraints_of(atoms)
    if fixes_center(atoms):
        system.velocities[:] = without_momentum(system.velocities, system.masses)
    return system


def system_from_file(file: Path, cell: ArrayLike | None = None, pbc: ArrayLike | None = None) -> System:
    """The last structure in a file of any format that ASE reads, in ASE's units.

    cell, pbc : instead of those of the file, as for System; with another cell the directions in which it is given are periodic.

    Raises
    ------
    ValueError : if the file does not exist, or ASE cannot read it; whatever its readers raise becomes one sentence. And as System does.
    """
    if not file.is_file():
        raise ValueError(f"file {str(file)!r} does not exist")
    try:
        read = ase.io.read(file)
        atoms = read if isinstance(read, Atoms) else read[-1]
        system = system_from_atoms(atoms)
    except Exception as error:
        reason = " ".join(str(error).split()) or "ASE gives no reason"
        raise ValueError(f"file {str(file)!r} cannot be read as a structure: {type(error).__name__}: {reason}") from None
    if cell is None and pbc is None:
        return system
    placed = Cell.of(system.cell.vectors if cell is None else cell, pbc)
    atoms.cell[:], atoms.pbc = placed.vectors, placed.pbc
    return system_from_atoms(atoms)  # with lengths of constraints that are measured in this cell


def atomic_mass(element: str) -> float:
    """Mass of a chemical element [u].

    Raises
    ------
    ValueError : if it is no chemical symbol.
    """
    if element not in atomic_numbers:
        raise ValueError(f"element must be a chemical symbol, such as 'Ar'; element = {element!r}")
    return float(atomic_masses[atomic_numbers[element]])


def atoms_from_system(system: System) -> Atoms:
    """ASE's atoms with the positions (not wrapped), momenta, masses, cell, periodicity and constraints of a system; bonds are lost.

    Species that are chemical symbols become elements. All others become 'X', ASE's symbol for no element, and all labels
    are kept in the array "species_labels", where system_from_atoms finds them again. Numbers cross unchanged: for a system
    in reduced units they are no Å and eV.
    """
    symbols = [label if label in atomic_numbers else "X" for label in system.species.tolist()]
    momenta = system.velocities * system.masses[:, None]
    atoms = Atoms(symbols, system.positions, momenta=momenta, masses=system.masses, cell=system.cell.vectors, pbc=system.cell.pbc)
    if not set(system.species_names) <= set(atomic_numbers):
        atoms.set_array(LABELS, system.species)
    atoms.set_constraint(ases_constraints_of(system))
    return atoms


def unchecked_system(atoms: Atoms, bonds: ArrayLike | None) -> System:
    """A system of atoms whose constraints are somebody else's business."""
    species = atoms.arrays.get(LABELS, atoms.get_chemical_symbols())
    velocities = atoms.get_velocities()
    return System(
        atoms.positions, masses=atoms.get_masses(), velocities=velocities, cell=cell_of(atoms), species=species, bonds=bonds, units=units.ASE
    )


def cell_of(atoms: Atoms) -> Cell:
    """The cell and periodicity of atoms."""
    return Cell.of(atoms.cell.array, atoms.pbc)


def same_labels(one: Atoms, other: Atoms) -> bool:
    """True if species that are no elements carry the same labels."""
    return np.array_equal(one.arrays.get(LABELS, ()), other.arrays.get(LABELS, ()))


def same_scene(one: Atoms, other: Atoms) -> bool:
    """True if only positions, momenta and cell can differ."""
    arrays = ((one.numbers, other.numbers), (one.get_masses(), other.get_masses()), (one.pbc, other.pbc))
    return all(np.array_equal(a, b) for a, b in arrays) and same_labels(one, other) and one.calc is other.calc


def volume_of(atoms: Atoms) -> float:
    """Volume of the parallelepiped, periodic or not [Å³]; 0 if there is none."""
    return float(atoms.get_volume()) if atoms.cell.rank == 3 else 0.0
