"""Structures, and the bonds, angles and dihedrals in them, from files that ASE or MDAnalysis reads; masses of chemical elements."""

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import ase.io
import numpy as np
from ase import Atoms
from ase.data import atomic_masses, atomic_numbers
from ase.io.formats import UnknownFileTypeError, ioformats
from numpy.typing import ArrayLike, NDArray

from minimd.structure.bond_graph import GROUPS
from minimd.structure.cell import Cell
from minimd.structure.console import outside_minimd
from minimd.structure.joined import Joined, joined_in
from minimd.structure.quiet import quiet
from minimd.structure.system import System
from minimd.structure.units import ASE, LJ, UnitSystem

LAMMPS = "lammps-data"
SUFFIXES = {".data": LAMMPS, ".lmp": LAMMPS, ".mol2": "MOL2", ".gsd": "GSD", ".txyz": "TXYZ"}  # formats that ASE does not know by them
XYZ = (".xyz", ".extxyz")
NAMES_BONDS = ("PDB", "ENT")  # formats of which ASE reads the atoms, and MDAnalysis the bonds
STATE_MASSES = ("DATA", "GSD")  # formats of MDAnalysis with masses of their own, in units of their own
MASS_OF_ELEMENT = 1e-3  # relative: 12.0 and 16.0 are carbon and oxygen, 14.027 is no nitrogen but CH₂
NOTHING: dict[str, Any] = dict.fromkeys(GROUPS)  # joins atoms
NEAR = 2e-3  # Å, between the same positions read by ASE and by MDAnalysis


def system_from_file(
    file: str | Path,
    cell: ArrayLike | None = None,
    pbc: ArrayLike | None = None,
    *,
    format: str | None = None,
    units: UnitSystem | None = None,
    bonds: ArrayLike | str | Path | None = "file",
) -> System:
    """The last structure in a file of any format that ASE or MDAnalysis reads, with its bonds, angles, dihedrals and impropers.

    Parameters
    ----------
    cell, pbc : instead of those of the file, as for System; with another cell the directions in which it is given are periodic.
    format : ASE's name of the format ("lammps-data"), or one of MDAnalysis ("GRO"); the suffix and the content tell it if not given.
    units : minimd.units.ASE, if not given; or minimd.units.LJ, whose numbers are taken as they stand. Masses are then those of the file where
        it states them (LAMMPS data, GSD; files of ASE with masses, as minimd writes them), else 1; velocities likewise. Files that minimd has
        written as .h5md state their units: these are taken, and no others.
    bonds : "file" for those that the file names, with its angles and dihedrals; another file, such as a PSF, that names them; pairs;
        or None for none, with a warning if the file names some.

    Species of LAMMPS data are its types, unless its masses are those of as many chemical elements, to 0.1 %, and units are ASE's.

    Raises
    ------
    ValueError : if a file does not exist, or cannot be read; whatever readers raise becomes one sentence. And as System does.
    """
    path = Path(file)
    form = format or SUFFIXES.get(path.suffix.lower())
    with _read_as(path, "a structure", form):
        source = _source(path, form, units or ASE)
        system = _system(source, units or ASE, form)
    if isinstance(source, System) and units not in (None, source.units):
        raise ValueError(f"file {str(path)!r} states units = {source.units.name!r}; it cannot be read with units = {units and units.name!r}")
    if cell is not None or pbc is not None:
        placed = Cell.of(system.cell.vectors if cell is None else cell, pbc)
        if isinstance(source, Atoms):  # lengths of constraints are then measured in this cell
            source.cell[:], source.pbc = placed.vectors, placed.pbc
            system = _system(source, units or ASE, form)
        else:
            system.cell = placed
    if bonds is not None and not isinstance(bonds, str | Path):
        return changed(system, **NOTHING | {"bonds": bonds})
    if bonds is None:
        with suppress(ValueError):  # nobody has asked for them
            _tell_unused(path, _joined_in(path, form, source, system))
        return changed(system, **NOTHING)
    found = _joined_in(path, form, source, system) if bonds == "file" else _joined_beside(path.parent / bonds, len(system))
    for name, n_types in found.n_types.items():
        groups = {"bonds": "pairs", "angles": "triples"}.get(name, "quadruples")
        one = f"{'an' if name[0] in 'ai' else 'a'} {name[:-1]} potential"
        words = f"the {name} of {str(path)!r} are of {n_types} types, which {one} does not tell apart; give it {groups}, or arrays"
        warnings.warn(words, stacklevel=outside_minimd())
    return changed(system, **found.groups)


def changed(system: System, **changes: Any) -> System:
    """A copy of a system with other arguments."""
    names = ("masses", "velocities", "cell", "species", *GROUPS, "units", "constraints")
    return System(system.positions, **{name: changes[name] if name in changes else getattr(system, name) for name in names})


def _source(path: Path, form: str | None, units: UnitSystem) -> Any:
    """ASE's atoms; a universe where the format is one of MDAnalysis. Of LAMMPS data, which do not name their units, numbers as they stand for LJ."""
    if form is not None and form not in ioformats:
        return _universe(path, form)
    if form is None and path.suffix.lower() == ".h5md":
        from minimd.files.h5md_reader import read_file

        return read_file(path).system
    options: dict[str, Any] = {"units": "ASE" if units is LJ else "metal"} if form == LAMMPS else {}
    read = ase.io.read(path, format=form, **options)
    atoms = read if isinstance(read, Atoms) else read[-1]
    if form == LAMMPS:
        _add_impropers(path, atoms)
    if "id" in atoms.arrays:
        atoms.arrays["id"] = np.arange(1, len(atoms) + 1)  # nobody has cut or sorted them, whatever their numbers are
    return atoms


def _add_impropers(path: Path, atoms: Atoms) -> None:
    """The impropers of LAMMPS data, which ASE does not read, beside its dihedrals, which it does: see structure.joined."""
    from MDAnalysis.topology.LAMMPSParser import DATAParser

    with quiet(), DATAParser(str(path)) as parser:
        rows = np.array([line.split()[1:6] for line in parser.grab_datafile()[1].get("Impropers", ())], dtype=np.int64).reshape(-1, 5)
    if len(rows):
        place = {number: k for k, number in enumerate(atoms.arrays["id"].tolist())}
        words: list[list[str]] = [[] for _ in place]
        for kind, *members in rows.tolist():
            first, *others = (place[one] for one in members)
            words[first].append(f"{'-'.join(map(str, others))}({kind})")
        atoms.arrays["impropers"] = np.array([",".join(each) or "_" for each in words])


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
    is_lammps = form == LAMMPS
    system = System.from_ase(source) if isinstance(source, Atoms) else System.from_mdanalysis(source, units=units)
    types = [str(kind) for kind in source.arrays["type"].tolist()] if is_lammps else system.species
    if units is LJ:
        states_masses = is_lammps or str(form).upper() in STATE_MASSES or (isinstance(source, Atoms) and source.has("masses"))
        own: dict[str, Any] = {} if states_masses else {"masses": None, "velocities": None}
        return changed(system, units=LJ, species=types, **own)
    return changed(system, species=types) if is_lammps and not _are_elements(system, types) else system


def _are_elements(system: System, types: Iterable[str]) -> bool:
    """Whether the types of LAMMPS data are as many chemical elements, with the masses of these: a group of atoms taken as one has another."""
    symbols = set(system.species_names)
    if "X" in symbols or len(symbols) < len(set(types)):
        return False
    standard = np.array([atomic_mass(str(symbol)) for symbol in system.species])
    return bool((np.abs(system.masses - standard) <= MASS_OF_ELEMENT * standard).all())


def _joined_in(path: Path, form: str | None, source: Any, system: System) -> Joined:
    """The bonds in the file that was read; system : was made from it.

    Raises ValueError if they cannot be read, or MDAnalysis reads the atoms in another order than ASE.
    """
    if not isinstance(source, Atoms):
        return Joined(system.groups())
    name = {"proteindatabank": "PDB"}.get(form or "", form or path.suffix[1:]).upper()
    with _read_as(path, "bonds", form):
        if name not in NAMES_BONDS:
            return joined_in(source)
        made = _universe(path, name)
        positions, found = np.asarray(made.atoms.positions, dtype=np.float64), _joined_of(made)
    if positions.shape != source.positions.shape or np.abs(positions - source.positions).max() > NEAR:
        raise ValueError(f"file {str(path)!r} is read in another order by MDAnalysis than by ASE; list its bonds as pairs")
    return found


def _joined_beside(path: Path, n_atoms: int) -> Joined:
    """The bonds in another file than that of the atoms.  Raises ValueError if it cannot be read, or has another number of atoms."""
    with _read_as(path, "bonds", None):
        if SUFFIXES.get(path.suffix.lower()) == LAMMPS:
            atoms = _source(path, LAMMPS, LJ)
            n_there, found = len(atoms), joined_in(atoms)
        else:
            made = _universe(path, None, topology_only=True)
            n_there, found = len(made.atoms), _joined_of(made)
    if n_there != n_atoms:
        raise ValueError(f"file {str(path)!r} names bonds of {n_there} atoms; the structure has {n_atoms}")
    return found


def _joined_of(universe: Any) -> Joined:
    def indices(name: str, size: int) -> NDArray[np.int64]:
        groups = getattr(universe, name, None)  # a universe has no attribute of what its file does not name
        return np.asarray([] if groups is None else groups.indices, dtype=np.int64).reshape(-1, size)

    return Joined({name: indices(name, size) for name, size in GROUPS.items()})


def _tell_unused(path: Path, found: Joined) -> None:
    if found:
        warnings.warn(
            f'file {str(path)!r} names {found}, which are not used; take them with bonds = "file", in a scene under [structure], '
            "or leave them out with bonds = []",
            stacklevel=outside_minimd(),
        )


@contextmanager
def _read_as(path: Path, what: str, form: str | None) -> Iterator[None]:
    """Turn whatever a reader raises into a sentence."""
    if not path.is_file():
        raise ValueError(f"file {str(path)!r} does not exist")
    try:
        yield
    except Exception as error:
        if form is None and isinstance(error, StopIteration | UnknownFileTypeError):
            reason = "its suffix and content tell no format; name it as format, such as 'lammps-data'"
        elif isinstance(error, KeyError) and str(path.suffix).lower() in XYZ and (label := error.args[0]) not in atomic_numbers:
            reason = (
                f"{label!r} is no chemical symbol, which ASE expects in this format; name the atoms X, and give their species to System or in the "
                "scene under [structure], or write LAMMPS data, whose types may be anything"
            )
        else:
            reason = f"{type(error).__name__}: {' '.join(str(error).split()) or 'the reader gives no reason'}"
        raise ValueError(f"file {str(path)!r} cannot be read as {what}: {reason}") from None


def atomic_mass(element: str) -> float:
    """Mass of a chemical element [u].

    Raises
    ------
    ValueError : if it is no chemical symbol.
    """
    if element not in atomic_numbers:
        raise ValueError(f"element must be a chemical symbol, such as 'Ar'; element = {element!r}")
    return float(atomic_masses[atomic_numbers[element]])
