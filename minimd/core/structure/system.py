"""The state of a scene: checked once, here, and trusted everywhere afterwards."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.core.compiled.machine import EPS
from minimd.core.console.display import Displayed, Rows
from minimd.core.console.words import listed, shown
from minimd.core.structure import units as unit_systems
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import GROUPS, checked_groups, checked_pairs
from minimd.core.structure.cell import IN_PLANE, NAMES_OF_VOLUME, Cell
from minimd.core.structure.checks import (
    LARGEST,
    MOST_ATOMS,
    check_rows,
    checked_kind,
    checked_numbers,
    checked_sizes,
)
from minimd.core.structure.constraints import Constraint
from minimd.core.structure.observables import largest_component
from minimd.core.structure.sites import Sites, place_in
from minimd.core.structure.units import UnitSystem

if TYPE_CHECKING:
    import ase
    import MDAnalysis

AnySystem: TypeAlias = "System | ase.Atoms"
FIXED = ("masses", "charges", *GROUPS, "units", "topology", "sites")
READ_ONLY = (*FIXED, "species_names", "species_index")
ROW = re.compile(r"([ -~]*\n){3}-?[0-9]{1,9}\n[ -~]*")  # of topology
MOST_BINS = 2**20  # along a lattice vector: their numbers are int64
RESOLVED = 1e-6  # of a length: the largest rounding error of separations that is allowed
NEUTRAL = 1e-9  # net charge, relative to the sum of all sizes: below it is rounding


class System(Displayed):
    """N atoms: positions, velocities, masses, species, cell, bonds, angles, dihedrals and impropers.

    Parameters
    ----------
    positions : (N, 3) [length]. Never wrapped into the cell, here or later.
    planar : True for atoms that lie and move in the plane z = 0; positions and velocities may then be (N, 2). Two of
        three directions are degrees of freedom, and for a volume stands an area, see Cell.
    masses : (N,) or one number [mass]; 1 in reduced units if not given.
    charges : (N,) [e], or one for each species by its label; zero if not given. Coulomb makes forces of them.
    velocities : (N, 3) [length/time]; zero if not given.
    cell : one length, three lengths, or (3, 3) rows = lattice vectors [length]; None for no cell.
    pbc : one bool or three; by default True where a lattice vector is given.
    species : N labels (str or int), or one str for all atoms, as "Ar"; all alike if not given.
    bonds : (B, 2) int, pairs of bonded atoms.
    angles : (A, 3) int, triples of atoms with an angle at the second one.
    dihedrals, impropers : (D, 4), (I, 4) int, quadruples of atoms with an angle between
        the planes through the first and the last three.
    units : minimd.units.LJ (reduced, default) or minimd.units.ASE (eV, Å, u).
    constraints : DistanceConstraints and FixedAtoms that a Simulation keeps unless it is given others.
    topology : (N, 5) str in ASCII, for programs that select atoms by names: the atom's name, its element or "", the
        name and the number of its residue, and its chain; atoms of a residue follow each other. (0, 5) if not known.
    sites : Sites, which of the atoms are massless and follow others; None for none. Their positions are those that
        follow, whatever is given; their masses must be 0, or one number be given for all atoms.

    Attributes
    ----------
    The same names hold the checked arrays, in float64 and in the order in which the atoms were given. Positions and
    velocities may be changed in place, cell may be replaced, the others are read-only. species_names is the tuple of
    distinct labels, species_index (N,) the index of each atom's label in it.

    Raises
    ------
    ValueError : if a shape does not fit, a number is masked, complex, a bool or not finite, a mass is not positive, a
        bond, an angle or a dihedral names a missing atom, one atom twice or one pair twice, or a periodic direction has
        no lattice vector, or a text of topology is not printable. TypeError : for units or constraints of another kind.
    """

    # of pickles of earlier versions
    topology: NDArray[np.str_] = np.zeros((0, 5), str)
    sites: Sites | None = None

    def __init__(
        self,
        positions: ArrayLike,
        *,
        masses: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
        cell: ArrayLike | Cell | None = None,
        pbc: ArrayLike | None = None,
        species: str | Sequence[str] | Sequence[int] | NDArray | None = None,
        bonds: ArrayLike | None = None,
        angles: ArrayLike | None = None,
        dihedrals: ArrayLike | None = None,
        impropers: ArrayLike | None = None,
        units: UnitSystem = unit_systems.LJ,
        constraints: Sequence[Constraint] = (),
        charges: ArrayLike | Mapping[Any, float] | None = None,
        topology: ArrayLike | None = None,
        sites: Sites | None = None,
        planar: bool = False,
    ) -> None:
        checked_kind("units", units, UnitSystem, "minimd.units.LJ or minimd.units.ASE")
        is_list = isinstance(constraints, list | tuple)
        if not (is_list and all(isinstance(each, Constraint) for each in constraints)):
            raise TypeError(
                "constraints of a System must be a list of DistanceConstraints and FixedAtoms; got "
                f"{shown(constraints)}"
            )

        if masses is None and not units.is_reduced:
            raise ValueError(
                f"masses are missing: give one number or one per atom; {units.name} units have no default"
            )

        if isinstance(cell, Cell) and (pbc is not None or planar):
            raise ValueError(
                "pbc and planar are part of the Cell given: Cell.of(vectors, pbc, planar); give them to System only "
                "together with lattice vectors"
            )

        self.constraints = tuple(constraints)
        self.cell = cell if isinstance(cell, Cell) else Cell.of(cell, pbc, planar)
        self.units = units if self.dimensions == 3 else units.in_plane
        self.positions = self._checked("positions", positions)
        n_atoms = len(self.positions)
        self.sites = checked_kind("sites", sites, Sites | None, "Sites")
        self.masses = _checked_masses(1.0 if masses is None else masses, n_atoms, sites)
        self.velocities = np.zeros((n_atoms, 3))
        if velocities is not None:
            self.velocities[:] = self._checked("velocities", velocities)
        place_in(self.positions, self.cell, sites)
        self.species_names, self.species_index = _checked_species(species, n_atoms)
        self.charges = _checked_charges(charges, self.species_names, self.species_index)
        self.bonds = checked_pairs("bonds", bonds, n_atoms)
        self.angles = checked_groups("angles", angles, 3, n_atoms)
        self.dihedrals = checked_groups("dihedrals", dihedrals, 4, n_atoms)
        self.impropers = checked_groups("impropers", impropers, 4, n_atoms)
        if topology is not None:
            self.topology = _checked_topology(topology, n_atoms)
        self.__setstate__({})

    def __setstate__(self, state: dict[str, Any]) -> None:
        """What may not be changed is read-only, in a copy too, where NumPy forgets it."""
        self.__dict__.update(state)
        for name in ("masses", "charges", "species_index", *GROUPS, "topology"):
            getattr(self, name).setflags(write=False)

    def __setattr__(self, name: str, value: Any) -> None:
        """New positions and velocities are copied into the existing arrays, which a running simulation uses.
        Raises AttributeError for a read-only attribute.  TypeError for a cell that is no Cell."""
        if name in ("positions", "velocities") and name in self.__dict__:
            self.__dict__[name][:] = self._checked(name, value)
        elif name in READ_ONLY and name in self.__dict__:
            raise AttributeError(f"{name} of a System cannot be changed; make a new System")
        else:
            if name == "cell":
                checked_kind("cell", value, Cell, "a Cell, such as Cell.of(10.0)")
                if value.dimensions != self.__dict__.get("cell", value).dimensions:
                    raise ValueError(
                        f"a system of {self.dimensions} dimensions needs a cell of as many; got {value!r}"
                    )
            super().__setattr__(name, value)

    def _checked(self, name: str, values: ArrayLike) -> Array:
        """Positions or velocities."""
        n_atoms = len(self) if "positions" in self.__dict__ else None
        return _checked_vectors(name, values, n_atoms, self.dimensions)

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def n_atoms(self) -> int:
        """N, as len(system)."""
        return len(self)

    def __repr__(self) -> str:
        names = ", ".join(map(str, self.species_names))
        counts = {name: len(rows) for name, rows in self.groups().items()}
        joined = ", ".join(f"{n} {name}" for name, n in counts.items() if n or name == "bonds")
        periodic = self.cell.pbc.tolist()
        return f"System({len(self)} atoms of {names}; {joined}; periodic {periodic}; {self.units.name} units)"

    @property
    def composition(self) -> str:
        """How many atoms there are of each species, in words."""
        counts = zip(np.bincount(self.species_index), self.species_names, strict=True)
        return ", ".join(f"{n} {name}" for n, name in counts)

    def groups(self) -> dict[str, Indices]:
        """Bonds, angles, dihedrals and impropers, by these names."""
        return {name: getattr(self, name) for name in GROUPS}

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        length = units.length
        table = {"atoms": f"{len(self)}: {self.composition}"}
        for name, text in self.cell.display_rows():
            table[name] = text.replace(")", f") {length}")
        if self.volume is not None:
            table[NAMES_OF_VOLUME[self.dimensions]] += f" {units.volume}"
            density = self.masses.sum() / self.volume
            mass = "mass" if units.is_reduced else "u"
            of_mass = f"{density:.6g} {mass}/{units.volume}"
            if units is unit_systems.ASE:
                of_mass = f"{density / unit_systems.GRAM_PER_CM3:.6g} g/cm³"
            table["density"] = f"{len(self) / self.volume:.6g} atoms/{units.volume}, {of_mass}"

        if self.charges.any():
            largest = np.abs(self.charges).max()
            table["charges"] = (
                f"net charge {self.net_charge:.6g} e, at most {largest:.6g} e on an atom"
            )

        for name, groups in self.groups().items():
            if len(groups):
                table[name] = str(len(groups))
        if self.sites is not None:
            table["sites"] = repr(self.sites)
        if self.constraints:
            table["constraints"] = ", ".join(map(repr, self.constraints))
        table["units"] = f"{units.name}: {length}, {units.energy}, {units.time}"
        return [*table.items()]

    @property
    def species(self) -> NDArray:
        """Label of each atom, (N,)."""
        return np.array(self.species_names)[self.species_index]

    @property
    def dimensions(self) -> int:
        """3, or 2 of a plane."""
        return self.cell.dimensions

    @property
    def volume(self) -> float | None:
        """Volume of the cell [length³], of a plane its area [length²]; None unless all its directions are periodic."""
        return self.cell.volume

    @property
    def net_charge(self) -> float:
        """The sum of all charges [e]; 0 if it is rounding."""
        net = float(self.charges.sum())
        return net if abs(net) > NEUTRAL * float(np.abs(self.charges).sum()) else 0.0

    def check_plane(self) -> None:
        """Raise ValueError for atoms that do not lie and move in z = 0."""
        for name in ("positions", "velocities"):
            check_in_plane(name, getattr(self, name))

    def copy(self) -> System:
        """An independent copy."""
        return changed(self)

    def in_plane(self) -> System:
        """A copy in two dimensions, as with planar=True.
        Raises ValueError for atoms that do not lie and move in z = 0, and lattice vectors that point out of it."""
        cell = self.cell
        flat = Cell.of(cell.vectors, cell.pbc & IN_PLANE, planar=True)
        return changed(self, cell=flat)

    @classmethod
    def from_ase(
        cls,
        atoms: ase.Atoms,
        bonds: ArrayLike | None = None,
        angles: ArrayLike | None = None,
        dihedrals: ArrayLike | None = None,
        impropers: ArrayLike | None = None,
    ) -> System:
        """A system in ASE's units from an ase.Atoms: see minimd.core.structure.ase_atoms.system_arguments.
        bonds, angles, dihedrals, impropers : as for System. If bonds is not given, those that ASE read from a file:
            atoms.arrays["bonds"] and so on; bonds=() for none of them.
        FixCom sets the total momentum to zero and is then forgotten. To have a Simulation refuse to move the center of
        mass, give it the atoms themselves."""
        from minimd.core.structure.ase_atoms import system_arguments

        groups: dict[str, Any] = {"angles": angles, "dihedrals": dihedrals, "impropers": impropers}
        return cls(**system_arguments(atoms, bonds, **groups))

    @classmethod
    def from_mdanalysis(
        cls,
        universe: MDAnalysis.Universe | MDAnalysis.AtomGroup,
        *,
        units: UnitSystem = unit_systems.ASE,
        bonds: ArrayLike | None = None,
        angles: ArrayLike | None = None,
        dihedrals: ArrayLike | None = None,
        impropers: ArrayLike | None = None,
        pbc: ArrayLike | None = None,
    ) -> System:
        """A system from the present frame of an MDAnalysis universe, or of a group of its atoms: all that System takes,
        except constraints. MDAnalysis holds positions, velocities and cell in float32, the cell as lengths and angles.
        Species are its types, or else elements. Masses that MDAnalysis has guessed are guessed anew, by the names of
        atoms and residues, which a warning tells: see minimd.core.structure.elements. Topology is that of its
        residues, if it has any, and if all texts are ASCII.

        Parameters
        ----------
        units : minimd.units.ASE, to which Å, Å/ps and u are converted; or minimd.units.LJ, for numbers taken unchanged.
        bonds, angles, dihedrals, impropers : as for System; those of the universe if not given, () for none.
        pbc : as for System.

        Raises
        ------
        TypeError : for anything but a universe or a group.
        ValueError : as System; for atoms whose mass is neither stated nor told by their names, or 0; for velocities
            of LAMMPS data that does not state its units.
        """
        from minimd.core.structure.mdanalysis_atoms import universe_arguments

        groups = {"bonds": bonds, "angles": angles, "dihedrals": dihedrals, "impropers": impropers}
        return cls(**universe_arguments(universe, units, groups, pbc))

    def to_ase(self) -> ase.Atoms:
        """An ase.Atoms with the same positions, momenta, masses, charges, cell, species, bonds and constraints:
        see minimd.ase.atoms_from_system."""
        from minimd.core.structure.ase_atoms import atoms_from_system

        return atoms_from_system(self)

    def write(self, file: str | Path, overwrite: bool = False) -> None:
        """Write a LAMMPS data file, .data or .lmp, of atom style full: positions in their images, velocities, masses,
        charges, species as labels of types, molecules (what bonds and fixed lengths connect), bonds, angles, dihedrals
        and impropers of one type each; not constraints. Units are metal (Å, ps, u, e) for ASE's, else lj, with charges
        q √k_e. The title states units and boundary.

        Raises
        ------
        ValueError : for another suffix.
        FileExistsError : if the file exists, unless overwrite=True.
        """
        from minimd.core.structure.lammps_file import write_lammps_data

        write_lammps_data(file, self, overwrite)


def changed(system: System, **changes: Any) -> System:
    """A copy of a system with other arguments."""
    return System(**arguments_of(system) | changes)


def arguments_of(system: System) -> dict[str, Any]:
    """The arguments of a system, by their names."""
    names = ("positions", "velocities", "cell", "species", "constraints", *FIXED)
    return {name: getattr(system, name) for name in names}


def _checked_vectors(
    name: str, values: ArrayLike, n_atoms: int | None = None, dimensions: int = 3
) -> Array:
    """A fresh contiguous (N, 3) float64 array, or a sentence about what is wrong with it."""
    array = checked_numbers(name, values, "an (N, 3) array of numbers")
    if dimensions == 2 and array.ndim == 2 and array.shape[1] == 2:
        array = np.pad(array, ((0, 0), (0, 1)))
    if dimensions == 2 and array.ndim == 2 and array.shape[1] == 3:
        check_in_plane(name, array)
    if array.ndim != 2 or array.shape[1] != 3 or not 0 < array.shape[0] <= MOST_ATOMS:
        plane = ": two columns need planar=True" if array.ndim == 2 and array.shape[1] == 2 else ""
        raise ValueError(
            f"{name} must be an (N, 3) array with N > 0, at most {MOST_ATOMS}; its shape is {array.shape}{plane}"
        )
    if n_atoms is not None and len(array) != n_atoms:
        raise ValueError(
            f"{name} must have one row for each of the {n_atoms} atoms; it has {len(array)}"
        )
    check_rows(name, "finite", np.isfinite(array).all(axis=1), array)
    largest = largest_component(array)
    if largest > LARGEST:
        raise ValueError(
            f"{name} must be below {LARGEST:g}; the largest is {largest:g}: take other units"
        )
    return array


def check_in_plane(name: str, vectors: Array) -> None:
    """Raise ValueError for a vector of atoms of a plane, (N, 3), that points out of it."""
    z = vectors[:, 2]
    if z.any():
        atom = int(np.argmax(np.abs(z)))
        raise ValueError(
            f"atoms of a plane lie and move in z = 0; z of {name} of atom {atom} is {z[atom]:.3g}"
        )


def _checked_masses(masses: ArrayLike, n_atoms: int, sites: Sites | None) -> Array:
    if sites is None:
        return checked_sizes("masses", masses, n_atoms, "atom")
    largest = max(sites.atoms.max(initial=-1), sites.parents.max(initial=-1))
    if largest >= n_atoms:
        raise ValueError(
            f"sites and their parents must be among atoms 0 to {n_atoms - 1}; they name atom {largest}"
        )
    numbers = checked_numbers("masses", masses, "one number, or one for each atom")
    if numbers.shape == (n_atoms,):
        of_sites = numbers[sites.atoms]
        check_rows("masses of sites", "0", of_sites == 0.0, of_sites)
        numbers[sites.atoms] = 1.0
    sizes = checked_sizes("masses", numbers, n_atoms, "atom")
    sizes[sites.atoms] = 0.0
    return sizes


def _checked_charges(charges: Any, species_names: tuple, species_index: Indices) -> Array:
    n_atoms = len(species_index)
    if charges is None:
        return np.zeros(n_atoms)
    if isinstance(charges, Mapping):
        if set(charges) != set(species_names):
            raise ValueError(
                f"charges must have a number for each species, {listed(species_names)}; they have one for "
                f"{listed(charges)}"
            )

        of_species = [charges[name] for name in species_names]
        numbers = checked_numbers("charges", of_species, "one number for each species")
        charges = numbers[species_index]

    checked = checked_numbers("charges", charges, "one number for each atom")
    if checked.shape != (n_atoms,):
        raise ValueError(
            f"charges must be {n_atoms} numbers, one for each atom; their shape is {checked.shape}"
        )

    check_rows("charges", f"finite and below {LARGEST:g}", np.abs(checked) <= LARGEST, checked)
    return checked


def _checked_topology(topology: Any, n_atoms: int) -> NDArray[np.str_]:
    is_text = isinstance(topology, np.ndarray) and topology.dtype.kind == "U"
    if not is_text or topology.shape not in [(n_atoms, 5), (0, 5)]:
        raise ValueError(
            f"topology must be an ({n_atoms}, 5) array of str; topology = {shown(topology)}"
        )
    is_right = np.array([ROW.fullmatch("\n".join(row)) for row in topology.tolist()], bool)
    check_rows("topology", "rows of texts in ASCII, the fourth a whole number", is_right, topology)
    return topology.copy()


def _checked_species(species: Any, n_atoms: int) -> tuple[tuple, Indices]:
    expected = f"species must be {n_atoms} labels, one for each atom, or one str for all"
    alike = np.zeros(n_atoms, np.int64)  # pages of zeros that nobody writes to need no memory
    if species is None:
        return ("X",), alike
    if np.ma.is_masked(species):
        raise ValueError("species must be labels; some are masked: fill them")
    if isinstance(species, str):
        species = [species] * n_atoms
    try:
        labels = species if isinstance(species, np.ndarray) else np.asarray(species, object)
    except ValueError as error:
        raise ValueError(f"{expected}: {error}") from None

    if labels.shape != (n_atoms,):
        raise ValueError(f"{expected}; their shape is {labels.shape}")
    labels = labels.tolist()
    are_texts = all(isinstance(label, str) for label in labels)
    are_numbers = all(
        isinstance(label, int | np.integer) and not isinstance(label, bool) for label in labels
    )
    if not (are_texts or are_numbers):
        raise ValueError(
            f"species must be all strings or all whole numbers; they are {shown(labels[:3])} ..."
        )

    names, index = np.unique(labels, return_inverse=True)
    species_names = tuple(names.tolist())

    for name in species_names:
        if not str(name).isprintable():
            raise ValueError(
                f"species must be labels of printable characters; one is {shown(name)}"
            )

    return species_names, alike if len(names) == 1 else index.astype(np.int64)


def check_resolution(system: System, length: float, name: str) -> None:
    """Raise ValueError if separations of atoms have rounding errors of more than RESOLVED of a length.  name :
    of the length, in words."""
    farthest = largest_component(system.positions)
    error = EPS * farthest
    if error > RESOLVED * length:
        raise ValueError(
            f"positions must be below {RESOLVED * length / EPS:.1e} in this scene; the largest is {farthest:.1e}, "
            f"where rounding moves atoms by {error:.1g}, more than a millionth of {name}, {length:.3g}: shift them "
            "towards the origin"
        )


def local_density(positions: Array, cell: Cell, width: float) -> float:
    """The density around an atom, in the mean over all atoms, at least N/V [1/length³].

        ρ = Σ n (n − 1) / (N V_b)   over bins of volume V_b with n atoms: −1, because no atom is its own neighbor

    positions : (N, 3) [length].
    width : of a bin, or somewhat less than that of it [length].
    Open directions count as far as there are atoms, or with the width if that is more."""
    s = np.einsum("ij,jk->ik", positions, cell.inverse)  # not @: see observables
    s -= np.where(cell.pbc, np.floor(s), s.min(axis=0))
    extent = np.where(cell.pbc, 1.0, np.maximum(width / cell.heights, s.max(axis=0)))
    counts = np.clip(np.floor(extent * cell.heights / width), 1, MOST_BINS).astype(np.int64)
    i, j, k = np.minimum((s / extent * counts).astype(np.int64), counts - 1).T
    n = np.unique((i * counts[1] + j) * counts[2] + k, return_counts=True)[1]
    around = float((n * (n - 1)).sum()) / len(s) * float(counts.prod())
    return max(len(s), around) / float(abs(np.linalg.det(cell.lattice)) * extent.prod())
