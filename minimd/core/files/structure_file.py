"""The door for structure files: what comes in is what the file states, whoever reads it.

    reader        formats
    minimd        LAMMPS data; .h5md of minimd and of GROMACS
    MDAnalysis    PDB, GRO, MOL2, ... : see OF_MDANALYSIS
    ASE           all others

Each gives the arguments of a System, and what its file states about names, elements and masses: see structure.elements.
"""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, NamedTuple

import ase.io
import numpy as np
from ase import Atoms
from ase.calculators.lammps import convert
from ase.data import atomic_masses, chemical_symbols
from ase.io.dlp4 import DLP_V_ASE
from ase.io.formats import UnknownFileTypeError, filetype, ioformats
from numpy.typing import ArrayLike

from minimd.core.console.quiet import quiet, warn
from minimd.core.console.whole_file import text_of
from minimd.core.console.words import listed
from minimd.core.files.gromacs_h5md import gromacs_structure
from minimd.core.files.h5md_reader import GROMACS, layout_of, looked_at, read_file
from minimd.core.files.lammps_data import read_lammps_data
from minimd.core.structure.arrays import Array
from minimd.core.structure.ase_atoms import LABELS, TYPES, stated_of, system_arguments
from minimd.core.structure.bond_graph import GROUPS, Joined, joined_in
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_choice, checked_path
from minimd.core.structure.elements import (
    Stated,
    atomic_mass,
    guessed_element,
    identified,
    is_element,
    species_of,
)
from minimd.core.structure.lammps_units import PER_PICOSECOND, UNITS_OF_LAMMPS
from minimd.core.structure.system import System, arguments_of
from minimd.core.structure.units import ASE, LJ, UnitSystem

LAMMPS = "lammps-data"
DUMP = "lammps-dump-text"
SUFFIXES = {".data": LAMMPS, ".lmp": LAMMPS, ".lammpstrj": DUMP, ".dump": DUMP}
PACKED = (".gz", ".bz2")
MDANALYSIS = "PDB GRO MOL2 GSD TXYZ PQR PDBQT CRD DMS MMTF MMCIF"
# suffixes of formats that MDAnalysis reads, and its names for them
OF_MDANALYSIS = {f".{name.lower()}": name for name in MDANALYSIS.split()}
OF_MDANALYSIS |= {".ent": "PDB", ".arc": "TXYZ"}
INSTEAD = {
    "proteindatabank": "PDB",
    "gromacs": "GRO",
    "ENT": "PDB",
    "DATA": LAMMPS,
    "CONFIG": "dlp4",
}
# groups of several types: the potential that does not distinguish them, and what it takes
OF_TYPES = {
    "bonds": ("a bond potential", "pairs"),
    "angles": ("an angle potential", "triples"),
    "dihedrals": ("a dihedral potential", "quadruples"),
    "impropers": ("an improper potential", "quadruples"),
}
TOPOLOGIES = (".top", ".itp", ".psf", ".prmtop", ".parm7", ".tpr")
GROMACS_TOPOLOGY = re.compile(r"^\s*(\[ *\w+ *\]|#include\b)", re.MULTILINE)
DL_POLY = ("dlp4", "dlp-history")
XYZ = (".xyz", ".extxyz")
XYZ_OF_ASE = ("xyz", "extxyz", "simple-xyz")
# relative: 12.0 and 16.0 are carbon and oxygen, but 14.027 is CH₂, not nitrogen
MASS_OF_ELEMENT = 1e-3
SAME_MASS = 0.1  # u, largest difference of the masses of one atom in two files
ATOMS = ("ATOM  ", "HETATM")  # records of a PDB file
DECIMALS = 5  # of the box in a GRO file
PDB_LINE = 54  # columns up to the end of z


class Structure(NamedTuple):
    """What a file holds.
    arguments : of System.
    stated : of names, elements and masses.
    n_types : of bonds and so on, see Joined."""

    arguments: dict[str, Any]
    stated: Stated
    n_types: dict[str, int] = {}  # noqa: RUF012 - never changed


def system_from_file(
    file: str | Path,
    cell: ArrayLike | None = None,
    pbc: ArrayLike | None = None,
    *,
    format: str | None = None,
    units: UnitSystem | None = None,
    bonds: ArrayLike | str | Path | None = "file",
    masses: Any = None,
    elements: Any = None,
    atom_style: str | None = None,
    lammps_units: str | None = None,
) -> System:
    """The last structure in a file of any format that ASE or MDAnalysis reads, with its bonds, angles, dihedrals and
    impropers.

    What the file states is taken; what is guessed is told by a warning; what is neither is refused. Masses are those
    that the file states, else those of the elements that it states, else those of elements guessed from the names of
    atoms and residues: see docs/formats.md.

    Parameters
    ----------
    cell, pbc : in place of those of the file, as for System; if only cell is given, the directions with a vector are
        periodic.
    format : ASE's name of the format ("lammps-data"), or MDAnalysis' name ("GRO"); if not given,
        suffix and content decide.
    units : minimd.units.ASE if not given, or minimd.units.LJ, for which the numbers in the file are taken unchanged;
        masses that the file does not state are then 1, and velocities without masses 0. Files that state their units,
        .h5md of minimd and LAMMPS data, are read in no others.
    bonds : "file" for the bonds, angles and dihedrals in the file; the name of another file that holds them, such as a
        PSF, with the same atoms in the same order, and with masses and charges, which are taken if it states them;
        pairs of atoms; or None for no bonds, with a warning if the file has some.
    masses, elements : of atoms whose file does not state them, or in place of them: [u], or [mass] in reduced units,
        and chemical symbols; one for each atom, or by names of atoms or types, as in {"W": 72.0}.
    atom_style : of LAMMPS data that does not name it ("full", "bond").
    lammps_units : of LAMMPS files that do not state theirs: "real", "metal", "lj" and so on.

    Species of LAMMPS data are its types, unless units are ASE's and the masses are those of as many chemical elements,
    to 0.1 %.

    The file is read in a child process, whose memory and time are limited by the size of the file.

    Raises
    ------
    ValueError : if a file does not exist or cannot be read, with the reader's reason in one sentence; if it states
        neither masses nor elements, and names do not tell them; if it states no units and velocities depend on them;
        and as System.
    """
    path = checked_path("file", file)
    if lammps_units is not None:
        checked_choice("lammps_units", lammps_units, UNITS_OF_LAMMPS)
    form = _form(path, format)
    takes_bonds = isinstance(bonds, str) and bonds == "file"
    door = Door(path, form, units, masses, elements, atom_style, lammps_units, takes_bonds)

    def read() -> System:
        beside = None
        if isinstance(bonds, str | Path) and not takes_bonds:
            beside = _beside(path.parent / bonds, door)
        with _read_as(path, "a structure", format):
            structure = door.structure(cell, pbc, beside)
        arguments = structure.arguments
        n_types = structure.n_types
        if beside is not None:
            _check_same_atoms(path, structure, beside)
            n_types = beside.n_types
            arguments |= {name: beside.arguments[name] for name in GROUPS}
            if not np.any(arguments["charges"]):
                arguments["charges"] = beside.arguments["charges"]
        elif not takes_bonds:
            own = Joined({name: arguments[name] for name in GROUPS})
            if bonds is None and own:
                warn(
                    f'{door.source} has {own}, which are not used; use them with bonds = "file", in a scene under '
                    "[structure], or leave them out with bonds = []"
                )

            n_types = {}
            arguments |= dict.fromkeys(GROUPS) | {"bonds": bonds}

        for name, n in n_types.items():
            potential, groups = OF_TYPES[name]
            warn(
                f"the {name} of {str(path)!r} are of {n} types, which {potential} does not distinguish; give it "
                f"{groups} of one type, or arrays of parameters"
            )

        return System(**arguments)

    try:
        return looked_at(path, read)
    except OSError as error:  # of the reader
        raise ValueError(str(error)) from None


def _form(path: Path, format: str | None) -> str | None:
    """The format: LAMMPS, ASE's or MDAnalysis' name, ".h5md", or None if only the content can tell."""
    name = path.name.lower()
    for packed in PACKED:
        name = name.removesuffix(packed)
    suffix = Path(name).suffix
    form = format or SUFFIXES.get(suffix) or OF_MDANALYSIS.get(suffix)
    if form is None and suffix == ".h5md":
        form = suffix
    if form is not None and form not in (*ioformats, ".h5md"):
        form = form.upper()
    return INSTEAD.get(form or "", form)


class Door(NamedTuple):
    """One file and how it is to be read; see system_from_file.
    form : see _form.
    takes_bonds : whether it matters if bonds cannot be read."""

    path: Path
    form: str | None
    units: UnitSystem | None
    masses: Any
    elements: Any
    atom_style: str | None
    lammps_units: str | None
    takes_bonds: bool

    @property
    def source(self) -> str:
        """The file, in words."""
        return f"file {str(self.path)!r}"

    def structure(self, cell: Any, pbc: Any, beside: Structure | None = None) -> Structure:
        """What the file holds, in a cell that replaces its own before that is judged.
        beside : a second file, whose masses are taken."""
        masses = self.masses
        if masses is None and beside is not None:
            masses = beside.stated
        form = self.form or self._form_of_content()
        of_lammps = self.atom_style or self.lammps_units
        if of_lammps and form not in (LAMMPS, DUMP):
            raise ValueError(f"{self.source} is no LAMMPS file; leave {of_lammps!r} out")
        if form == ".h5md" and layout_of(self.path) is GROMACS:
            structure = self._of_gromacs(masses)
        elif form == ".h5md":
            structure = self._of_minimd(masses)
        elif form == LAMMPS:
            structure = self._of_lammps(masses)
        elif form in ioformats:
            return self._of_ase(form, masses, cell, pbc)
        else:
            structure = self._of_mdanalysis(form, masses)

        if cell is not None or pbc is not None:
            own = structure.arguments["cell"]
            if cell is None:
                cell = own.vectors if isinstance(own, Cell) else own
            structure.arguments.update(cell=cell, pbc=pbc)

        return structure

    def _form_of_content(self) -> str:
        """The format that ASE finds, or mmCIF.
        Raises UnknownFileTypeError."""
        if ".cif" in self.path.name.lower() and "_atom_site." in text_of(self.path):
            return "MMCIF"
        form = filetype(str(self.path))
        form = INSTEAD.get(form, form)
        if form not in ioformats and form not in INSTEAD.values():
            raise UnknownFileTypeError
        return form

    def _of_minimd(self, masses: Any) -> Structure:
        system = read_file(self.path).system
        self._check_units(system.units)
        labels = system.species.tolist()
        names = [str(label) for label in labels]
        of_sites = system.masses == 0.0
        stated = Stated(self.source, names, system.positions, None, system.masses + of_sites)
        weights, symbols = identified(
            stated, masses, self.elements, is_reduced=system.units.is_reduced
        )
        weights[of_sites] = 0.0
        arguments = arguments_of(system)
        arguments |= {"masses": weights, "species": species_of(symbols, labels)}
        return Structure(arguments, stated)

    def _of_gromacs(self, masses: Any) -> Structure:
        self._check_units(ASE)
        arguments, stated = gromacs_structure(self.path, self.source)
        weights, symbols = identified(stated, masses, self.elements)
        species = species_of(symbols, stated.names)
        arguments = dict.fromkeys(GROUPS) | arguments | {"masses": weights, "species": species}
        return Structure(arguments, stated)

    def _check_units(self, stated: UnitSystem) -> None:
        """Raise ValueError if other units were asked for than those of the file."""
        if self.units is not None and self.units.name != stated.name:
            raise ValueError(
                f"{self.source} states units = {stated.name!r}; it cannot be read with units = "
                f"{self.units.name!r}"
            )

    def _of_lammps(self, masses: Any) -> Structure:
        data = read_lammps_data(self.path, self.atom_style)
        has_velocities = data.velocities is not None and bool(data.velocities.any())
        name, units = self._lammps_units(data.units, has_velocities)
        if data.skipped:
            warn(
                f"{self.source} has sections that LAMMPS does not have, which are skipped: {listed(data.skipped)}"
            )

        def converted(values: Any, quantity: str) -> Any:
            if values is None or units.is_reduced:
                return values
            if name not in PER_PICOSECOND:
                return convert(values, quantity, name, "ASE")
            if quantity == "velocity":
                return values * (ASE.to_picosecond * PER_PICOSECOND[name])
            return values

        positions = converted(data.positions, "distance")
        stated = Stated(self.source, data.types, positions, None, converted(data.masses, "mass"))
        weights, symbols = identified(stated, masses, self.elements, is_reduced=units.is_reduced)
        species = data.types
        if self.elements is not None:
            species = species_of(symbols, data.types)
        elif units is not LJ:
            species = _elements_of(data.types, weights)

        arguments = {
            "positions": positions,
            "masses": weights,
            "charges": converted(data.charges, "charge"),
            "velocities": converted(data.velocities, "velocity"),
            "cell": converted(data.cell, "distance"),
            "pbc": data.pbc,
            "species": species,
            **data.groups,
            "units": units,
        }
        return Structure(arguments, stated, data.n_types)

    def _lammps_units(self, stated: str | None, has_velocities: bool) -> tuple[str, UnitSystem]:
        """LAMMPS' name of the units of a file, and minimd's units for it.
        Raises ValueError if they are not known."""
        if stated and self.lammps_units and stated != self.lammps_units:
            raise ValueError(
                f"{self.source} states units = {stated}; lammps_units = {self.lammps_units!r}"
            )

        name = stated or self.lammps_units
        if (
            name is None
            and self.units is not None
            and (self.units.is_reduced or not has_velocities)
        ):
            name = "lj" if self.units.is_reduced else "metal"
        if name is None:
            raise ValueError(
                f"{self.source} does not state its units; give lammps_units='real', 'metal' or 'lj', in a scene "
                "lammps_units under [structure], or units=minimd.units.LJ"
            )

        units = LJ if name == "lj" else ASE
        if self.units is not None and self.units != units:
            raise ValueError(
                f"{self.source} is in LAMMPS' units {name}; it cannot be read with units = {self.units.name!r}, but "
                f"with {units.name!r}"
            )

        return name, units

    def _of_mdanalysis(self, form: str, masses: Any) -> Structure:
        from minimd.core.structure.mdanalysis_atoms import (
            stated_of as stated_of_group,
            universe_arguments,
        )

        universe = universe_of_file(self.path, form)
        atoms = universe.atoms
        _check_alternatives(atoms, self.source)
        units = self.units or ASE
        groups = dict.fromkeys(GROUPS)
        arguments = universe_arguments(
            atoms, units, groups, None, self.source, masses, self.elements
        )
        return Structure(arguments, stated_of_group(atoms, self.source, arguments["positions"]))

    def _of_ase(self, form: str, masses: Any, cell: Any, pbc: Any) -> Structure:
        units = self.units or ASE
        if form == "gromos":
            raise ValueError(
                "this format keeps no elements, and ASE takes the first letters of names; write it as .gro"
            )

        options: dict[str, Any] = {}
        if form == DUMP:
            name, units, columns, weights = self._dump()
            options["units"] = "ASE" if units.is_reduced else name
        frames = ase.io.read(str(self.path), format=form, do_not_split_by_at_sign=True, **options)
        atoms = frames if isinstance(frames, Atoms) else frames[-1]
        if not len(atoms):
            raise ValueError("a structure must have atoms; this file has none")
        if form in XYZ_OF_ASE:
            _check_labels(text_of(self.path), len(atoms), self.source)
        if form in DL_POLY:  # ASE takes the velocities, in Å/ps, for atomic units
            symbols = atoms.get_chemical_symbols()
            names = map("".join, zip(symbols, atoms.arrays["dlp4_labels"], strict=True))
            to_own = 1.0 if units.is_reduced else ASE.to_picosecond
            _relabel(atoms, [*names], to_own / DLP_V_ASE)
        elif form == DUMP:
            kinds = atoms.arrays.pop("type", atoms.numbers)
            atoms.set_array(TYPES, kinds)
            if "element" not in columns:
                if weights is not None and not units.is_reduced and name not in PER_PICOSECOND:
                    weights = convert(weights, "mass", name, "ASE")
                _relabel(atoms, kinds.astype(str).tolist(), 1.0, weights)

        if cell is not None or pbc is not None:
            placed = Cell.of(atoms.cell.array if cell is None else cell, pbc)
            atoms.cell[:] = placed.vectors
            atoms.pbc = placed.pbc

        # these are all atoms of the file in its order, whatever ids they have there
        if "id" in atoms.arrays:
            atoms.arrays["id"] = np.arange(1, len(atoms) + 1)
        joined = Joined(dict.fromkeys(GROUPS, np.zeros((0, 2), np.int64)))
        with nullcontext() if self.takes_bonds else suppress(ValueError):
            joined = joined_in(atoms)
        stated = stated_of(atoms, self.source)
        arguments = system_arguments(
            atoms, (), stated=stated, masses=masses, elements=self.elements, units=units
        )
        return Structure(arguments | joined.groups, stated, joined.n_types)

    def _dump(self) -> tuple[str, UnitSystem, list[str], Array | None]:
        """Units of a dump, the names of its columns, and its masses in the order of ids, which ASE does not read."""
        lines = text_of(self.path).splitlines()
        units_at = [k for k, line in enumerate(lines) if line.startswith("ITEM: UNITS")]
        atoms_at = [k for k, line in enumerate(lines) if line.startswith("ITEM: ATOMS")]
        stated = lines[units_at[0] + 1].strip() if units_at else None
        columns = lines[atoms_at[-1]].split()[2:]
        weights = None
        if "mass" in columns:
            rows = [line.split() for line in lines[atoms_at[-1] + 1 :] if line.strip()]
            weights = np.array([float(row[columns.index("mass")]) for row in rows])
            if "id" in columns:
                weights = weights[np.argsort([int(row[columns.index("id")]) for row in rows])]
        name, units = self._lammps_units(stated, "vx" in columns)
        return name, units, columns, weights


def _topology_format(path: Path) -> str | None:
    """MDAnalysis' name of the format of a topology of GROMACS, whose suffix .top is Amber's, too; else None."""
    is_of_gromacs = path.suffix.lower() == ".top" and GROMACS_TOPOLOGY.search(text_of(path))
    return "ITP" if is_of_gromacs else None


def universe_of_file(path: Path, form: str | None, topology_format: str | None = None) -> Any:
    """A universe of MDAnalysis; of a format that is named, the last frame in the file's own units.
    Raises ValueError for a file that was cut."""
    import MDAnalysis

    source: Any = str(path)
    named: dict[str, Any] = {"topology_format": topology_format}
    if form:
        named = {"topology_format": form.upper(), "format": form.upper(), "convert_units": False}
    if form in LAST_FRAMES:
        text = LAST_FRAMES[form](text_of(path))
        source = MDAnalysis.lib.util.NamedStream(io.StringIO(text), f"last.{form.lower()}")
    with quiet():
        universe = MDAnalysis.Universe(source, **named)
        if form:
            universe.trajectory[-1]
    return universe


def _last_of_gro(text: str) -> str:
    """The last frame of a GRO file; MDAnalysis reads the first."""
    lines = text.splitlines()
    first = 0
    while True:
        n = int(lines[first + 1].split()[0])
        end = first + n + 3
        if n < 0 or end > len(lines):
            raise ValueError(
                f"line {first + 2} announces {n} atoms and a box; the file has {len(lines)} lines: it was cut"
            )
        if not any(map(str.strip, lines[end:])):
            break
        first = end
    decimals = [len(number.partition(".")[2]) for number in lines[end - 1].split()]
    if not text.endswith("\n") and decimals[-1] < decimals[0] == DECIMALS:
        raise ValueError(f"the file ends within its box, {lines[end - 1].strip()!r}: it was cut")
    return "\n".join([*lines[first:end], ""])


def _last_of_pdb(text: str) -> str:
    """The last model of a PDB file, with its cell and bonds; models may differ in their atoms."""
    lines = text.splitlines(keepends=True)
    for number, line in enumerate(lines, start=1):
        if line.startswith(ATOMS) and len(line.rstrip("\n")) < PDB_LINE:
            raise ValueError(
                f"line {number} ends within the position of its atom: the file was cut"
            )
    if not any(line.startswith(ATOMS) for line in lines):
        raise ValueError("it has no line ATOM or HETATM")
    models = [k for k, line in enumerate(lines) if line.startswith("MODEL ")]
    if len(models) < 2:
        return text
    others = [line for line in lines[: models[-1]] if line.startswith("CRYST1")][-1:]
    return "".join(others + lines[models[-1] :])


LAST_FRAMES = {"GRO": _last_of_gro, "PDB": _last_of_pdb}


def _check_labels(text: str, n: int, source: str) -> None:
    """Raise ValueError for labels of an XYZ file in capitals that may be elements or names, as CA; warns of columns
    that are not read."""
    rows = [line.split() for line in text.splitlines() if line.strip()][-n:]
    if "Properties" not in text and max(map(len, rows)) > 4:
        warn(
            f"{source} has columns behind x, y and z, which say nothing about what they are: they are not read"
        )
    for label in sorted({row[0] for row in rows}):
        may_be_element = len(label) == 2 and label.isupper() and is_element(label.capitalize())
        if may_be_element and not guessed_element(label):
            raise ValueError(
                f"the label {label!r} of {source} may be the element {label.capitalize()} or the name of an atom; "
                "write chemical symbols, as 'Ca' or 'C'"
            )


def _check_alternatives(atoms: Any, source: str) -> None:
    """Raise ValueError for atoms of which a PDB file has several, at alternate locations."""
    seen: dict[tuple[Any, ...], int] = {}
    labels = getattr(atoms, "altLocs", ())
    if not any(labels):
        return
    for k, label in enumerate(labels):
        key = (atoms.segids[k], int(atoms.resids[k]), str(atoms.names[k]))
        if seen.setdefault(key, k) != k and label != labels[seen[key]]:
            raise ValueError(
                f"atoms {seen[key]} and {k}, {key[-1]!r}, of {source} are alternate locations, "
                f"{str(labels[seen[key]])!r} and {str(label)!r}, of one atom, which has an occupancy in both: keep one "
                "of them in the file"
            )


def _relabel(atoms: Atoms, names: list[str], scale: float, masses: Any = None) -> None:
    """Give atoms, of whose names or types ASE has made elements, the names themselves, velocities times a scale, and
    masses that their file states."""
    velocities = scale * atoms.get_velocities()
    atoms.set_array(LABELS, np.array(names))
    atoms.arrays[TYPES] = atoms.arrays[LABELS]
    atoms.numbers[:] = 0
    if masses is not None:
        atoms.set_masses(masses)
    atoms.set_velocities(velocities)


def _elements_of(types: list[str], masses: Any) -> list[str]:
    """The elements whose masses all atoms have, if there are as many as types; else the types."""
    if not all(label.isdigit() for label in types):
        return types
    different, of_atom = np.unique(masses, return_inverse=True)
    nearest = np.abs(np.subtract.outer(different, atomic_masses[1:])).argmin(axis=1) + 1
    standard = atomic_masses[nearest]
    are_elements = bool((np.abs(different - standard) <= MASS_OF_ELEMENT * standard).all())
    symbols = [chemical_symbols[number] for number in nearest[of_atom]]
    return symbols if are_elements and len(set(symbols)) >= len(set(types)) else types


def _beside(path: Path, door: Door) -> Structure:
    """Bonds, charges and masses in a file other than that of the atoms; masses of LAMMPS data in units real and metal.
    Raises ValueError if it cannot be read."""
    source = f"file {str(path)!r}"

    with _read_as(path, "bonds", None):
        if _form(path, None) == LAMMPS:
            data = read_lammps_data(path, door.atom_style)
            masses = data.masses if (data.units or door.lammps_units) in PER_PICOSECOND else None
            stated = Stated(source, data.types, data.positions, None, masses)
            return Structure({**data.groups, "charges": data.charges}, stated, data.n_types)

        from minimd.core.structure.mdanalysis_atoms import (
            charges_of as charges_of_group,
            stated_of as stated_of_group,
        )

        atoms = universe_of_file(path, None, _topology_format(path)).atoms
        stated = stated_of_group(atoms, source, np.zeros((len(atoms), 3)))
        arguments: dict[str, Any] = {"charges": charges_of_group(atoms)}
        for name, size in GROUPS.items():
            rows = getattr(atoms.universe, name).indices if hasattr(atoms, name) else ()
            arguments[name] = np.array(rows, np.int64).reshape(-1, size)
        return Structure(arguments, stated)


def _check_same_atoms(path: Path, structure: Structure, beside: Structure) -> None:
    """Raise ValueError unless two files hold the same atoms in the same order, by names and by masses; X is no name."""
    first = structure.stated
    second = beside.stated
    n = len(structure.arguments["positions"])
    if len(second.names) != n:
        raise ValueError(
            f"{second.source} with the bonds has {len(second.names)} atoms; the structure has {n}"
        )

    numbers = [0] * n if first.residue_of is None else first.residue_of.tolist()
    of_residue: dict[int, set[str]] = {}
    for number, name in zip(numbers, first.names, strict=True):
        of_residue.setdefault(number, set()).add(name)

    for k, (name, other) in enumerate(zip(first.names, second.names, strict=True)):
        if name in (other, "X"):
            continue
        if other in of_residue[numbers[k]] or not _may_be_same(first, second, k):
            mass = "" if second.masses is None else f" of {second.masses[k]:g} u"
            raise ValueError(
                f"atom {k} of file {str(path)!r} is {name!r}, but {other!r}{mass} in {second.source}: both files must "
                "have the same atoms in the same order"
            )


def _may_be_same(first: Stated, second: Stated, k: int) -> bool:
    """Whether an atom that two files call differently has one mass, as far as both are known."""
    symbol = first.elements[k] if first.elements else ""
    symbol = symbol or _guess_of(first, k)
    if symbol and symbol == _guess_of(second, k):
        return True  # whatever its mass, which may be repartitioned
    mass = np.nan if first.masses is None else float(first.masses[k])
    if np.isnan(mass) and symbol:
        mass = atomic_mass(symbol)
    other = None if second.masses is None else float(second.masses[k])
    return bool(np.isnan(mass)) or other is None or abs(mass - other) <= SAME_MASS


def _guess_of(stated: Stated, k: int) -> str:
    return guessed_element(stated.names[k], stated.residues[k] if stated.residues else "")


@contextmanager
def _read_as(path: Path, what: str, form: str | None) -> Iterator[None]:
    """Turn any error of a reader into a ValueError with one sentence."""
    source = f"file {str(path)!r}"
    if not path.is_file():
        raise ValueError(f"{source} does not exist")
    try:
        yield
    except Exception as error:
        if isinstance(error, ValueError) and source in str(error) and "\n" not in str(error):
            raise
        reason = " ".join(str(error).split()).rpartition("Error: ")[2]
        is_label = isinstance(error, KeyError) and path.suffix.lower() in XYZ
        is_unknown = isinstance(error, StopIteration | UnknownFileTypeError)
        if form is None and is_unknown and path.suffix.lower() in TOPOLOGIES:
            reason = (
                "it is a topology, without positions: pass it as bonds= beside a file with positions, or read it with "
                "OpenMM (GromacsTopFile, AmberPrmtopFile, CharmmPsfFile) and pass the system to minimd.from_openmm, "
                "with all forces: see docs/forces.md#force-fields"
            )
        elif form is None and is_unknown:
            reason = "its suffix and content do not show its format; pass it, such as format='lammps-data'"
        elif is_label and not is_element(str(error.args[0])):
            reason = (
                f"{error.args[0]!r} is not a chemical symbol, which ASE expects in this format; name the atoms X, and "
                "give masses here and species to System, or both in the scene under [structure], or write LAMMPS data, "
                "whose types may have any name"
            )
        elif isinstance(error, ImportError):
            reason = f"its reader needs another package: {reason}"
        elif not isinstance(error, ValueError | OSError) or not reason:
            reason = f"its reader gives up with {type(error).__name__}: {reason or 'no reason'}; is it in its format?"

        raise ValueError(f"{source} cannot be read as {what}: {reason}") from None
