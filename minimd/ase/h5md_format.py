"""Reading minimd's H5MD files with ase.io.read, which finds this module by an entry point; see minimd_plugin.py.

ase.io.write does not write them: a file of minimd holds a run that can go on, and atoms alone are not a run.
"""

from collections.abc import Iterator

from ase import Atoms

from minimd.core.files.ase_writer import atoms_of_frame
from minimd.core.files.h5md_reader import frames_of, read_file
from minimd.core.structure.ase_atoms import atoms_from_system


def read_minimd_h5md(filename: str, index: int | slice = -1) -> Iterator[Atoms]:
    """Frames of a minimd file: positions (not wrapped), momenta, masses, charges, cell, constraints, bonds, energy.

    Positions and energy are those of the run to the last bit; velocities and forces are converted from Å/ps and kJ/mol,
    and right to rounding. Forces are included if the run stored them, the stress if the run observed it. Bonds, angles,
    dihedrals and impropers are arrays with these names, as made by ASE's reader of LAMMPS data; step and time are in
    info. Numbers in reduced units are not converted to Å and eV.

    index : of the frames, as for ase.io.read.

    Raises FileNotFoundError, OSError, ValueError as minimd.core.files.h5md_reader.read_file.
    """
    contents = read_file(filename)
    template = atoms_from_system(contents.system)
    numbers = range(contents.n_frames)
    chosen = numbers[index] if isinstance(index, slice) else [numbers[index]]
    for frame in frames_of(filename, chosen, contents.system.units, ("potential_energy", "stress")):
        yield atoms_of_frame(template, frame, frame.forces, contents.conserves_momentum)
