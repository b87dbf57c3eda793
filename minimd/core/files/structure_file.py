"""Structures, and the bonds, angles and dihedrals in them, from files that ASE or MDAnalysis reads;
masses of chemical elements; trajectories that ASE writes."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import ase.io
import numpy as np
from ase import Atoms
from ase.calculators.singlepoint import SinglePointCalculator
from ase.data import atomic_masses, atomic_numbers
from ase.io.formats import UnknownFileTypeError, ioformats
from ase.io.trajectory import TrajectoryWriter
from numpy.typing import ArrayLike

from minimd.core.console.quiet import quiet, warn
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import Frame
from minimd.core.files.claim import Claim
from minimd.core.files.trajectory import Writer
from minimd.core.structure.ase_atoms import atoms_from_system, calculators_stress, label_by_tags
from minimd.core.structure.bond_graph import GROUPS, Joined, joined_in
from minimd.core.structure.cell import Cell
from minimd.core.structure.system import System, changed
from minimd.core.structure.units import ASE, LJ, UnitSystem

LAMMPS = "lammps-data"
# formats that ASE does not find by suffix
SUFFIXES = {".data": LAMMPS, ".lmp": LAMMPS, ".mol2": "MOL2", ".gsd": "GSD", ".txyz": "TXYZ"}
XYZ = (".xyz", ".extxyz")
NAMES_BONDS = ("PDB", "ENT")  # formats whose atoms are read by ASE, and whose bonds by MDAnalysis
STATE_MASSES = ("DATA", "GSD")  # formats read by MDAnalysis that state masses, in their own units
MASS_OF_ELEMENT = 1e-3  # relative: 12.0 and 16.0 are carbon and oxygen, but 14.027 is CH₂, not nitrogen
NOTHING: dict[str, Any] = dict.fromkeys(GROUPS)  # no bonds, angles, dihedrals, impropers
NEAR = 2e-3  # Å, largest difference of the same position read by ASE and by MDAnalysis


def system_from_file(
    file: str | Path,
    cell: ArrayLike | None = None,
    pbc: ArrayLike | None = None,
    *,
    format: str | None = None,
    units: UnitSystem | None = None,
    bonds: ArrayLike | str | Path | None = "file",
) -> System:
    """The last structure in a file of any format that ASE or MDAnalysis reads, with its bonds, angles,
    dihedrals and impropers.

    Parameters
    ----------
    cell, pbc : in place of those of the file, as for System; if only cell is given,
        the directions with a vector are periodic.
    format : ASE's name of the format ("lammps-data"), or MDAnalysis' name ("GRO"); if not given,
        suffix and content decide.
    units : minimd.units.ASE if not given, or minimd.units.LJ, for which the numbers in the file are taken unchanged.
        With LJ, masses and velocities are those of the file if it states masses (LAMMPS data, GSD; files of ASE with
        masses, as minimd writes them); else masses are 1 and velocities 0. A file .h5md of minimd states its units,
        and is read in no others.
    bonds : "file" for the bonds, angles and dihedrals in the file; the name of another file that holds them, such as a
        PSF, and with them charges, if the file of the atoms has none; pairs of atoms; or None for no bonds, with a
        warning if the file has some.

    Species of LAMMPS data are its types, unless units are ASE's and the masses are those of as many chemical elements,
    to 0.1 %.

    Raises
    ------
    ValueError : if a file does not exist or cannot be read, with the reader's reason in one sentence; and as System.
    """
    path = Path(file)
    form = format or SUFFIXES.get(path.suffix.lower())
    with _read_as(path, "a structure", form):
        source = _source(path, form, units or ASE)
        system = _system(source, units or ASE, form)
    if isinstance(source, System) and units not in (None, source.units):
        states = f"file {str(path)!r} states units = {source.units.name!r}"
        raise ValueError(f"{states}; it cannot be read with units = {units and units.name!r}")
    if cell is not None or pbc is not None:
        placed = Cell.of(system.cell.vectors if cell is None else cell, pbc)
        if isinstance(source, Atoms):  # lengths of constraints are measured in the new cell
            source.cell[:], source.pbc = placed.vectors, placed.pbc
            with quiet():  # its warnings have been given
                system = _system(source, units or ASE, form)
        else:
            system.cell = placed
    if bonds is not None and not isinstance(bonds, str | Path):
        return changed(system, **NOTHING | {"bonds": bonds})
    if bonds is None:
        with suppress(ValueError):  # bonds were not asked for, so that it does not matter if they cannot be read
            if found := _joined_in(path, form, source, system):
                use = 'use them with bonds = "file", in a scene under [structure], or leave them out with bonds = []'
                words = f"file {str(path)!r} has {found}, which are not used; {use}"
                warn(words)
        return changed(system, **NOTHING)
    found = _joined_in(path, form, source, system) if bonds == "file" else _joined_beside(path.parent / bonds, system)
    for name, n_types in found.n_types.items():
        groups = {"bonds": "pairs", "angles": "triples"}.get(name, "quadruples")
        one = f"{'an' if name[0] in 'ai' else 'a'} {name[:-1]} potential"
        words = f"the {name} of {str(path)!r} are of {n_types} types, which {one} does not distinguish; give it"
        warn(f"{words} {groups} of one type, or arrays of parameters")
    return changed(system, **found.groups, charges=system.charges if system.charges.any() else found.charges)


def _source(path: Path, form: str | None, units: UnitSystem) -> Any:
    """The System in an .h5md file, a universe for a format of MDAnalysis, else ASE's atoms.

    With LJ, numbers of LAMMPS data are unchanged. Impropers of LAMMPS data, which ASE does not read, are added in the
    form in which ASE adds dihedrals: see structure.joined.
    """
    if form is not None and form not in ioformats:
        return _universe(path, form)
    if form is None and path.suffix.lower() == ".h5md":
        from minimd.core.files.h5md_reader import read_file

        return read_file(path).system
    options: dict[str, Any] = {"units": "ASE" if units is LJ else "metal"} if form == LAMMPS else {}
    read = ase.io.read(path, format=form, **options)
    atoms = read if isinstance(read, Atoms) else read[-1]
    if form == LAMMPS:
        from MDAnalysis.topology.LAMMPSParser import DATAParser

        with quiet(), DATAParser(str(path)) as parser:
            lines = parser.grab_datafile()[1].get("Impropers", ())
        place = {number: k for k, number in enumerate(atoms.arrays["id"].tolist())}
        words: list[list[str]] = [[] for _ in place]
        for line in lines:
            kind, *members = map(int, line.split()[1:6])
            first, second, third, fourth = (place[one] for one in members)
            words[first].append(f"{second}-{third}-{fourth}({kind})")
        if lines:
            atoms.arrays["impropers"] = np.array([",".join(each) or "_" for each in words])
    if "id" in atoms.arrays:  # these are all atoms of the file in its order, whatever ids they have there
        atoms.arrays["id"] = np.arange(1, len(atoms) + 1)
    return atoms


def _universe(path: Path, form: str | None, topology_only: bool = False) -> Any:
    import MDAnalysis

    with quiet():
        formats = ("topology_format", "format") if form else ()
        made = MDAnalysis.Universe(str(path), **dict.fromkeys(formats, str(form).upper()))
        if not topology_only:
            made.trajectory[-1]
        return made


def _system(source: Any, units: UnitSystem, form: str | None) -> System:
    if isinstance(source, System):
        return source.copy()
    is_ases, is_lammps = isinstance(source, Atoms), form == LAMMPS
    system = System.from_ase(source) if is_ases else System.from_mdanalysis(source, units=units)
    types = [str(kind) for kind in source.arrays["type"].tolist()] if is_lammps else system.species
    if units is LJ:
        states_masses = is_lammps or (is_ases and source.has("masses")) or str(form).upper() in STATE_MASSES
        own: dict[str, Any] = {} if states_masses else {"masses": None, "velocities": None}
        return changed(system, units=LJ, species=types, **own)
    symbols, has_types = set(system.species_names), is_lammps
    if is_lammps and "X" not in symbols and len(symbols) >= len(set(types)):
        # types are elements if all masses are: that of a united atom such as CH₂ differs
        standard = np.array([atomic_mass(str(symbol)) for symbol in system.species])
        has_types = bool((np.abs(system.masses - standard) > MASS_OF_ELEMENT * standard).any())
    return changed(system, species=types) if has_types else system


def _joined_in(path: Path, form: str | None, source: Any, system: System) -> Joined:
    """The bonds in the file that was read.  system : made from it.  Raises ValueError if they cannot be read, or if
    MDAnalysis and ASE read the atoms in different orders."""
    if not isinstance(source, Atoms):
        return Joined(system.groups())
    name = {"proteindatabank": "PDB"}.get(form or "", form or path.suffix[1:]).upper()
    with _read_as(path, "bonds", form):
        if name not in NAMES_BONDS:
            return joined_in(source)
        made = _universe(path, name)
        positions, found = np.asarray(made.atoms.positions, dtype=np.float64), _joined_of(made)
    if positions.shape != source.positions.shape or np.abs(positions - source.positions).max() > NEAR:
        why = f"ASE reads the atoms of file {str(path)!r} in another order than MDAnalysis, which reads the bonds"
        raise ValueError(f"{why}; give the bonds as pairs")
    return found


def _joined_beside(path: Path, system: System) -> Joined:
    """The bonds, and the charges if it has some, in a file other than that of the atoms.  Raises ValueError if it
    cannot be read, or has another number of atoms."""
    with _read_as(path, "bonds", None):
        if SUFFIXES.get(path.suffix.lower()) == LAMMPS:
            atoms = _source(path, LAMMPS, LJ)
            n_there, found = len(atoms), joined_in(atoms)._replace(charges=atoms.get_initial_charges())
        else:
            from minimd.core.structure.mdanalysis_atoms import charges_of

            made = _universe(path, None, topology_only=True)
            n_there, found = len(made.atoms), _joined_of(made)._replace(charges=charges_of(made.atoms))
    if n_there != len(system):
        raise ValueError(f"file {str(path)!r} with the bonds has {n_there} atoms; the structure has {len(system)}")
    return found


def _joined_of(universe: Any) -> Joined:
    """The bonds in a universe; its file may have none."""
    found = {name: getattr(universe, name).indices if hasattr(universe, name) else () for name in GROUPS}
    return Joined({name: np.array(found[name], np.int64).reshape(-1, size) for name, size in GROUPS.items()})


@contextmanager
def _read_as(path: Path, what: str, form: str | None) -> Iterator[None]:
    """Turn any error of a reader into a ValueError with one sentence."""
    if not path.is_file():
        raise ValueError(f"file {str(path)!r} does not exist")
    try:
        yield
    except Exception as error:
        if form is None and isinstance(error, StopIteration | UnknownFileTypeError):
            reason = "its suffix and content do not show its format; pass it, such as format='lammps-data'"
        elif isinstance(error, KeyError) and path.suffix.lower() in XYZ and error.args[0] not in atomic_numbers:
            reason = (
                f"{error.args[0]!r} is not a chemical symbol, which ASE expects in this format; name the atoms X, and "
                "give their species to System or in the scene under [structure], or write LAMMPS data, whose types may "
                "have any name"
            )
        else:
            reason = f"{type(error).__name__}: {' '.join(str(error).split()) or 'the reader gives no reason'}"
        raise ValueError(f"file {str(path)!r} cannot be read as {what}: {reason}") from None


def atomic_mass(element: str) -> float:
    """Mass of a chemical element [u].

    Raises
    ------
    ValueError : if it is not a chemical symbol.
    """
    if element not in atomic_numbers:
        raise ValueError(f"element must be a chemical symbol, such as 'Ar'; element = {element!r}")
    return float(atomic_masses[atomic_numbers[element]])


def atoms_of_frame(template: Atoms, frame: Frame, forces: Any, conserves_momentum: bool) -> Atoms:
    """A copy of ASE's atoms in the state of a frame, with step and time in info, and energy, forces and stress, where
    they are known, as results of a calculator.  conserves_momentum : whether the run did."""
    atoms, seen = template.copy(), frame.observables
    atoms.positions[:] = frame.positions
    if frame.cell is not None:
        atoms.cell[:] = frame.cell.vectors
    atoms.set_momenta(frame.velocities * atoms.get_masses()[:, None], apply_constraint=False)
    atoms.info.update(step=frame.step, time=frame.time)
    stress = calculators_stress(seen["stress"], atoms, conserves_momentum) if "stress" in seen else None
    atoms.calc = SinglePointCalculator(atoms, energy=float(seen["potential_energy"]), forces=forces, stress=stress)
    return atoms


class ASEWriter(Writer):
    """A trajectory written by ASE, in the units of the system: .traj in float64, .xyz and .extxyz as extended XYZ,
    with 8 decimals.

    Each frame holds positions (not wrapped), momenta, masses, charges, cell, constraints (in .traj all, but without
    lengths; else only fixed atoms), bonds and angles as texts (not in .traj), the potential energy as the result of a
    calculator, forces if they are to be stored, the stress if it is observed, and step and time in info. Species that
    are not elements are stored as labels; in .traj, their names are in info, and the tag of each atom is the index of
    its name.

    claim : on the file, which gets its name with its first frame.
    """

    def __init__(self, claim: Claim, engine: Engine, store_forces: bool) -> None:
        self.claim, self._template, self._store_forces = claim, atoms_from_system(engine.system), store_forces
        self._conserves_momentum = engine.conserves_momentum
        is_binary = claim.path.suffix.lower() == ".traj"
        if is_binary:
            label_by_tags(self._template, engine.system)
        self._output = TrajectoryWriter(claim.stream, "w") if is_binary else claim.stream.open("w", encoding="utf-8")

    def write(self, frame: Frame) -> None:
        """Append one frame."""
        forces = frame.forces if self._store_forces else None
        atoms = atoms_of_frame(self._template, frame, forces, self._conserves_momentum)
        if isinstance(self._output, TrajectoryWriter):
            self._output.write(atoms)
        else:
            ase.io.write(self._output, atoms, format="extxyz")
            self._output.flush()  # a killed run leaves whole frames
        self.claim.check()
        self.claim.appear()

    def close(self) -> None:
        """Finish the file."""
        try:
            self._output.close()
        finally:
            self.claim.release()
