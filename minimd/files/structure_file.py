"""Structures from files that ASE reads, and masses of chemical elements."""

from pathlib import Path

import ase.io
from ase import Atoms
from ase.data import atomic_masses, atomic_numbers
from numpy.typing import ArrayLike

from minimd.structure.cell import Cell
from minimd.structure.system import System


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
        system = System.from_ase(atoms)
    except Exception as error:
        reason = " ".join(str(error).split()) or "ASE gives no reason"
        raise ValueError(f"file {str(file)!r} cannot be read as a structure: {type(error).__name__}: {reason}") from None
    if cell is None and pbc is None:
        return system
    placed = Cell.of(system.cell.vectors if cell is None else cell, pbc)
    atoms.cell[:], atoms.pbc = placed.vectors, placed.pbc
    return System.from_ase(atoms)  # with lengths of constraints that are measured in this cell


def atomic_mass(element: str) -> float:
    """Mass of a chemical element [u].

    Raises
    ------
    ValueError : if it is no chemical symbol.
    """
    if element not in atomic_numbers:
        raise ValueError(f"element must be a chemical symbol, such as 'Ar'; element = {element!r}")
    return float(atomic_masses[atomic_numbers[element]])
