"""Reading minimd's H5MD files with ase.io.read, which finds this module by an entry point; see minimd_plugin.py.

ase.io.write does not write them: a file of minimd holds a run that can go on, and atoms alone are not a run.
"""

from collections.abc import Iterator
from typing import Any

import h5py
from ase import Atoms
from ase.calculators.singlepoint import SinglePointCalculator

from minimd.files.h5md_reader import H5MDContents, opened, read_file
from minimd.files.h5md_schema import STEPS, TRAJECTORY
from minimd.structure.ase_atoms import atoms_from_system, calculators_stress


def read_minimd_h5md(filename: str, index: int | slice = -1) -> Iterator[Atoms]:
    """Frames of a minimd file, to the last bit: positions (not wrapped), momenta, masses, cell, constraints, bonds,
    and energy.

    Forces are included if the run stored them; they are converted from kJ/mol, and right to rounding. The stress is
    included if the run observed it. Bonds, angles, dihedrals and impropers are arrays with these names, as made by
    ASE's reader of LAMMPS data; step and time are in info. Numbers in reduced units are not converted to Å and eV.

    index : of the frames, as for ase.io.read.

    Raises FileNotFoundError, OSError, ValueError as minimd.files.h5md_reader.read_file.
    """
    contents = read_file(filename)
    template = atoms_from_system(contents.system)
    numbers = range(contents.n_frames)
    chosen = numbers[index] if isinstance(index, slice) else [numbers[index]]
    with opened(filename) as h5:
        for number in chosen:
            yield _frame(h5, number, template, contents)


def _frame(h5: h5py.File, number: int, template: Atoms, contents: H5MDContents) -> Atoms:
    atoms, group, units = template.copy(), h5[TRAJECTORY], contents.system.units
    atoms.positions[:] = group["position/value"][number] / units.to_angstrom
    if "cell" in h5["observables"]:
        atoms.cell[:] = h5["observables/cell/value"][number]
    velocities = group["velocity/value"][number] * (units.to_picosecond / units.to_angstrom)
    atoms.set_momenta(velocities * atoms.get_masses()[:, None], apply_constraint=False)
    atoms.info.update(step=int(h5[STEPS][number]), time=float(h5["minimd/time"][number]))
    results: dict[str, Any] = {"energy": float(h5["observables/potential_energy/value"][number])}
    if "force" in group:
        results["forces"] = group["force/value"][number] * (units.to_angstrom / units.to_kj_per_mol)
    if "stress" in h5["observables"]:
        stress = h5["observables/stress/value"][number]
        results["stress"] = calculators_stress(stress, atoms, contents.conserves_momentum)
    atoms.calc = SinglePointCalculator(atoms, **results)
    return atoms
