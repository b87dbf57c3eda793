"""LAMMPS data files of systems, with all digits of all numbers."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from minimd.core.console.quiet import warn
from minimd.core.console.whole_file import write_whole
from minimd.core.console.words import listed
from minimd.core.structure.checks import checked_flag, checked_path
from minimd.core.structure.constraints import molecules_of
from minimd.core.structure.lammps_box import Box, Columns
from minimd.core.structure.units import ASE

ROOM = 10.0  # [length], between the atoms and bounds in open directions
SUFFIXES = (".data", ".lmp")
LABEL = re.compile(r"[^\W\d]\w*[+-]*", re.ASCII)  # names of species that LAMMPS takes as they are


def write_lammps_data(file: Any, system: Any, overwrite: bool = False) -> None:
    """Write a system, see System.write."""
    path = checked_path("file", file)
    checked_flag("overwrite", overwrite)
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"file must be LAMMPS data, .data or .lmp; file = {str(path)!r}: "
            "minimd.mdanalysis.universe(simulation).atoms.write(file) writes .gro, .pdb and others with residues, "
            "ase.io.write(file, system.to_ase()) formats of ASE, Simulation.run(trajectory=) those of runs, as .h5md"
        )

    if system.sites is not None:
        raise ValueError(
            f"LAMMPS data hold atoms with masses; system.sites = {system.sites!r}: write other formats, by "
            "ase.io.write(file, system.to_ase())"
        )
    cell = system.cell
    box = Box(cell, system.positions, np.where(cell.pbc[:, None], cell.vectors, cell.lattice))
    box.make_room(ROOM)
    of_atom = np.column_stack([system.species_index, system.masses])
    kinds, types = np.unique(of_atom, axis=0, return_inverse=True)
    names = [str(system.species_names[int(k)]) for k in kinds[:, 0]]
    labels = type_labels(names)
    units = "lj"
    charges = system.charges * system.units.coulomb**0.5  # k_e = 1 in LAMMPS' units lj
    velocities = box.turned(system.velocities)
    if not system.units.is_reduced:
        units = "metal"
        charges = system.charges
        velocities /= ASE.to_picosecond

    numbers = [molecules_of(system) + 1, types.reshape(-1) + 1]
    sections: dict[str, Columns] = {}
    if not labels[0].isdecimal():
        sections["Atom Type Labels"] = [np.array(labels)]
    sections["Masses"] = [kinds[:, 1], np.array([f"# {name}" for name in names])]
    sections["Atoms # full"] = [*numbers, charges, box.positions, box.images]
    sections["Velocities"] = [velocities]
    for name, groups in system.groups().items():
        sections[name.capitalize()] = [np.ones(len(groups), np.int64), groups + 1]
    boundary = " ".join("f" if is_open else "p" for is_open in box.open)
    title = f"LAMMPS data file of minimd, units = {units}, boundary {boundary}"
    write_whole(path, "".join(box.data_file(title, sections)), overwrite)
    if not np.array_equal(box.turn, np.eye(3)):
        warn(
            f"positions and velocities in {str(path)!r} are turned, because a lies along x and b in the xy plane in "
            f"LAMMPS: those of the system are r @ R, R = {box.turn.T.tolist()}"
        )

    if labels != names:
        warn(
            f"species {listed(names)} are {listed(labels)} in {str(path)!r}: one type for each species and mass, with "
            "letters that LAMMPS allows"
        )


def type_labels(names: Sequence[str]) -> list[str]:
    """Labels of types that LAMMPS allows, all different, as near to the names as possible. Names
    1, 2, ... are the numbers of types."""
    if names == [str(k) for k in range(1, 1 + len(names))]:
        return list(names)
    labels: list[str] = []
    for k, name in enumerate(names, start=1):
        label = name if LABEL.fullmatch(name) else "type"
        labels.append(f"{label}-{k}" if label in labels else label)
    return labels
