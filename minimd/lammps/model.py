"""A scene translated for LAMMPS: types, bonds, angles, dihedrals, pair styles from the laws, rigid bonds for fix shake.

Errors tell all that LAMMPS does not have. fix shake holds one to three bonds of a middle atom, or a triangle with two
equal sides, such as water.
"""

from collections.abc import Callable
from functools import cache, partial
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.words import shown
from minimd.core.diagnosis.evaluation import evaluate
from minimd.core.engine.engine import Engine
from minimd.core.potentials.bonded import Bonded
from minimd.core.potentials.coulomb import Coulomb
from minimd.core.potentials.embedded import EmbeddedAtom
from minimd.core.potentials.embedded_files import EmbeddedTables
from minimd.core.potentials.laws import LennardJonesLaw
from minimd.core.potentials.pair import UNSCALED, Nonbonded
from minimd.core.potentials.truncation import ForceShifted, Shifted
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import among, connected
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.constraints import DistanceConstraints
from minimd.core.structure.lammps_box import Box
from minimd.lammps.expression import energy_expression
from minimd.lammps.verification import TOLERANCE

EQUAL = 1e-12  # largest relative difference of sides of a triangle that count as equal
FLAT = 1e-6  # a triangle is a line if 1 − third side / sum of the two others is below this
MOST_BONDS = 3  # of a middle atom
CAN = "fix shake of LAMMPS holds one to three bonds of a middle atom, or triangles with two equal sides"


def rigid_groups(
    constraints: DistanceConstraints, n_atoms: int
) -> tuple[Indices, Array, Indices, Array]:
    """The bonds (B, 2) with lengths (B,) [length], and the angles (A, 3), the middle atom second, with openings (A,)
    [rad], that keep these lengths.
    Raises ValueError for molecules that LAMMPS cannot hold."""
    pairs = constraints.pairs
    lengths = np.asarray(constraints.lengths)
    molecule = connected(pairs, n_atoms)
    of_pair = molecule[pairs[:, 0]]
    n_members = np.bincount(molecule)
    n_bonds = np.bincount(of_pair, minlength=len(n_members))
    degree = np.zeros_like(n_bonds)
    np.maximum.at(degree, molecule, np.bincount(pairs.ravel(), minlength=n_atoms))
    is_star = (n_bonds == n_members - 1) & (degree == n_bonds) & (n_bonds <= MOST_BONDS)
    is_triangle = (n_bonds == 3) & (n_members == 3)
    wrong = np.flatnonzero(~(is_star | is_triangle | (n_members == 1)))
    if wrong.size:
        atoms = np.flatnonzero(molecule == wrong[0])
        raise ValueError(
            f"{CAN}; the rigid molecule of atom {atoms[0]} has {len(atoms)} atoms and {n_bonds[wrong[0]]} lengths: "
            "run this scene with minimd"
        )

    in_triangle = is_triangle[of_pair]
    sides = np.flatnonzero(in_triangle)
    triangles = sides[np.argsort(of_pair[sides], kind="stable")].reshape(-1, 3)
    first, second, angles, openings = _opened(pairs, lengths, triangles)
    chosen = np.concatenate([np.flatnonzero(~in_triangle), first, second])
    return pairs[chosen], lengths[chosen], angles, openings


def _opened(
    pairs: Indices, lengths: Array, triangles: Indices
) -> tuple[Indices, Indices, Indices, Array]:
    """Two equal sides of each triangle, the atoms of the angle between them, and the angle.
    triangles : (A, 3) indices of pairs."""
    sides = lengths[triangles]
    longest = sides.max(axis=1, keepdims=True, initial=1.0)
    differences = np.abs(sides - np.roll(sides, -1, axis=1)) / longest

    for k in np.flatnonzero(differences.min(axis=1) > EQUAL):
        raise ValueError(
            f"{CAN}; the triangle of atom {pairs[triangles[k, 0], 0]} has no equal sides: run this scene with minimd"
        )

    # the first of two equal sides; the second follows it, cyclically
    equal = np.argmin(differences, axis=1)
    rows = np.arange(len(triangles))
    first, second, third = (triangles[rows, (equal + k) % 3] for k in range(3))
    if (lengths[third] > (1.0 - FLAT) * (lengths[first] + lengths[second])).any():
        raise ValueError(f"{CAN}, but not three atoms in a line: run this scene with minimd")
    ends = pairs[first]
    others = pairs[second]
    # of the two ends of the first side
    is_shared = (ends[:, :, None] == others[:, None, :]).any(axis=2)
    middle = ends[is_shared]
    angles = np.column_stack([ends[~is_shared], middle, others[others != middle[:, None]]])
    return first, second, angles, 2.0 * np.arcsin(0.5 * lengths[third] / lengths[first])


# of a type of bonds, angles or dihedrals: the style of LAMMPS, and its numbers
Style = tuple[str, str]
MOST_TYPES = 500  # of atoms: LAMMPS' tables grow with their square
KINDS = (
    "pair potentials and charges (ewald, no slab) without exclusions, bonds, harmonic angles and "
    "dihedrals"
)
FAR = 100.0  # extents of the scene: the cutoff of a law without one
SKIN = 0.12  # of the smallest cutoff, or longest bond
# in longest bonds: the distance up to which LAMMPS finds partners of an atom on other processes
REACH = 2.0
# a factor, neither 0 nor 1, with which LAMMPS keeps the pairs and marks them, if those of styles differ
SPECIAL = 0.5
# of charges: the finest accuracy of LAMMPS; step 0 may differ by so many times that asked for, since both have errors;
# bits of a table of erfc, from the cutoff / NEAR on: nearer, LAMMPS has a polynomial with errors of 1e-7
FINEST = 1e-7
MARGIN = 10.0
TABLE = 16
NEAR = 16.0
METALS = "metals.eam"  # the file of tables
OF_FILES = ("eam/alloy", "eam/fs")
LJ_FORCE_SHIFTED = "lj/smooth/linear"
LEADING = {Shifted: 1, ForceShifted: 3}  # by truncation: numbers before those of the law


class AtomTypes(NamedTuple):
    """One type for each combination of species, mass, and whether an atom is held fixed.
    of_atom : (N,) type of each atom, from 0 on.
    species : (T,) index of the species of a type.
    masses : (T,) [mass].
        is_fixed : (T,) bool."""

    of_atom: Indices
    species: Indices
    masses: Array
    is_fixed: NDArray[np.bool_]

    @classmethod
    def of(cls, engine: Engine) -> "AtomTypes":
        """The types of atoms of an engine.
        Raises ValueError for more than MOST_TYPES, and for massless sites."""
        system = engine.system
        if system.sites is not None:
            raise ValueError(
                f"LAMMPS moves atoms with masses; this scene has {system.sites!r} without: run it with minimd"
            )
        fixed = engine.constraint_set.inverse_masses == 0.0
        atoms = np.column_stack([system.species_index, system.masses, fixed])
        rows, of_atom = np.unique(atoms, axis=0, return_inverse=True)
        if len(rows) > MOST_TYPES:
            raise ValueError(
                "LAMMPS distinguishes atoms by types, one for each species and mass; this scene needs "
                f"{len(rows)}, but at most {MOST_TYPES} are allowed"
            )
        species, masses, is_fixed = rows.T
        return cls(of_atom.reshape(-1), species.astype(np.int64), masses, is_fixed != 0.0)


class Groups:
    """Bonds, angles or dihedrals, with their types.
    size : atoms in a group.
    coefficients : style and numbers of types.
    atoms : (G, size).
    types : (G,), from 0 on.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.coefficients = list[Style]()
        self.atoms = np.zeros((0, size), np.int64)
        self.types = np.zeros(0, np.int64)

    def add(
        self, atoms: Indices, parameters: Array, written: Callable[[list[float]], Style]
    ) -> range:
        """Add groups, with a new type for each of the different rows of parameters, and return the new types.
        atoms : (G, size).
        parameters : (G, P).
        written : called with P numbers, gives the coefficients of a type."""
        first = len(self.coefficients)
        rows, of_each = np.unique(parameters, axis=0, return_inverse=True)
        self.atoms = np.concatenate([self.atoms, atoms.reshape(-1, self.size)])
        self.types = np.concatenate([self.types, of_each.reshape(-1) + first])
        self.coefficients += map(written, rows.tolist())
        return range(first, len(self.coefficients))

    def commands(self, word: str) -> list[str]:
        """Styles and coefficients as commands.
        word : bond, angle or dihedral."""
        styles = dict(self.coefficients)
        if not styles:
            return []
        is_hybrid = len(styles) > 1
        hybrid = "hybrid " if is_hybrid else ""
        lines = [f"{word}_style {hybrid}{' '.join(styles)}"]
        for k, (style, numbers) in enumerate(self.coefficients, start=1):
            label = f"{style.split()[0]} " if is_hybrid else ""
            lines.append(f"{word}_coeff {k} {label}{numbers}")
        return lines


class PairStyle(NamedTuple):
    """name : of the style.
    cutoff : the largest [length].
    shift : whether LAMMPS subtracts u(r_c).
    scale : bonded_scale.
    coefficients : for each pair of types, the types as LAMMPS writes them, and the parameters.
    """

    name: str
    cutoff: float
    shift: bool
    scale: tuple[float, ...]
    coefficients: list[tuple[str, str]]

    @property
    def words(self) -> str:
        """The style with its cutoff, if that is not in its file."""
        return self.name if self.name in OF_FILES else f"{self.name} {words(self.cutoff)}"


class Model:
    """A scene translated for LAMMPS.

    Attributes
    ----------
    box : Box.
    types : AtomTypes.
    joined : Groups by LAMMPS' word for one.
    bonds, angles : two of them.
    rigid_bonds, rigid_angles : the types that fix shake holds.
    charges : (N,) [√(energy · length)].
    kspace : commands for their sum over waves.
    tolerance : of step 0.
    pair_styles : list of PairStyle.
    cutoff, skin : [length], of lists.
    search : how these are built.
    reach : [length], of the communication between processes.

    Raises
    ------
    ValueError : for anything that LAMMPS cannot do as minimd does.
    """

    def __init__(self, engine: Engine) -> None:
        system = engine.system
        self.box = Box(system.cell, system.positions)
        self.types = AtomTypes.of(engine)
        self.joined = {"bond": Groups(2), "angle": Groups(3), "dihedral": Groups(4)}
        self.bonds, self.angles, _ = self.joined.values()
        self.rigid_bonds = range(0)
        self.rigid_angles = range(0)
        self._farthest = FAR * np.ptp(system.positions, axis=0).max(initial=1.0)
        self.charges = system.charges * system.units.coulomb**0.5
        self.kspace = list[str]()
        self.tables: EmbeddedTables | None = None
        self.tolerance = TOLERANCE
        self.pair_styles = list[PairStyle]()
        self.smallest_cutoff = np.inf
        for constraint in engine.constraints:
            if isinstance(constraint, DistanceConstraints):
                self._hold(constraint)
        for potential in engine.interactions.potentials:
            self._take(potential, engine)
        if any(style.scale != UNSCALED for style in self.pair_styles):
            self._complete_graph(system.bonds)
        pairs = []
        for groups in self.joined.values():
            pairs += [groups.atoms[:, k : k + 2] for k in range(groups.size - 1)]
        vectors = nearest_vectors(system.positions, system.cell, np.concatenate(pairs))
        # the longest present bond, in angles and dihedrals too; 1 if there is none
        bonded = np.linalg.norm(vectors, axis=1).max(initial=0.0) or 1.0
        self.cutoff = max((style.cutoff for style in self.pair_styles), default=bonded)
        self.skin = SKIN * (self.smallest_cutoff if self.smallest_cutoff < np.inf else bonded)
        self.search = "nsq" if self.cutoff == self._farthest else "bin"
        self.reach = max(self.cutoff + self.skin, REACH * bonded + self.skin)
        self.box.make_room(self.reach)

    def _take(self, potential: Any, engine: Engine) -> None:
        system = engine.system
        exclusions = getattr(potential, "exclusions", None)
        if exclusions is not None and len(exclusions):
            raise _outside(potential, KINDS)
        if isinstance(potential, EmbeddedAtom):
            self.pair_styles.append(self._embedded(potential, system.species_names))
        elif isinstance(potential, Nonbonded):
            self.pair_styles.append(self._pair_style(potential, system.species_names))
        if isinstance(potential, Nonbonded):
            self.smallest_cutoff = min(self.smallest_cutoff, potential.shortest_length)
        elif isinstance(potential, Coulomb) and potential.method == "ewald":
            self.pair_styles.append(self._charged(potential, engine))
        elif isinstance(potential, Bonded) and potential.acts_on != "impropers":
            name = potential.acts_on
            atoms = potential.groups_in(system)
            parameters = np.column_stack(potential.columns(name, len(atoms)))
            self.joined[name[:-1]].add(atoms, parameters, partial(_coefficients, potential))
        else:
            raise _outside(potential, KINDS)

    def _pair_style(self, potential: Nonbonded, species_names: tuple) -> PairStyle:
        """The style of a pair potential: that of LAMMPS if there is one, else its law, written for Lepton."""
        law = potential.law
        table = potential.table(species_names)
        species = self.types.species
        cutoffs = table[:, :, 0]
        cutoffs[:] = np.where(cutoffs < np.inf, np.sqrt(cutoffs), self._farthest)
        own = potential.lammps
        if own and isinstance(law, ForceShifted) and isinstance(law.law, LennardJonesLaw):
            own = own._replace(name=LJ_FORCE_SHIFTED)
        elif not isinstance(law, Shifted | type(potential.plain_law)):
            own = None
        first = 1 + LEADING.get(type(law), 0)

        @cache
        def numbers(*row: float) -> str:
            if own is not None:
                return words(*own.numbers(*row[first:]), row[0])
            return f'"{energy_expression(law, row[1:])}" {words(row[0])}'

        coefficients = []
        if len(table) == 1:
            coefficients.append(("* *", numbers(*table[0, 0].tolist())))
        else:
            for i, j in combinations_with_replacement(range(len(species)), 2):
                row = table[species[i], species[j]]
                coefficients.append((f"{i + 1} {j + 1}", numbers(*row.tolist())))

        name = own.name if own else "lepton"
        is_shifted = own is not None and isinstance(law, Shifted)
        return PairStyle(
            name, cutoffs.max(), is_shifted, tuple(potential.bonded_scale), coefficients
        )

    def _embedded(self, potential: EmbeddedAtom, species_names: tuple) -> PairStyle:
        """The style of tables of embedded atoms, which are written to a file.
        Raises ValueError for functions, which LAMMPS would read from a table."""
        tables = potential.given
        if not isinstance(tables, EmbeddedTables):
            raise ValueError(
                f"LAMMPS takes embedded atoms from files only; {potential!r} is made of functions: run this scene with "
                "minimd"
            )
        if self.tables is not None:
            raise ValueError("LAMMPS takes one file of embedded atoms; the scene has two of them")
        self.tables = tables
        elements = " ".join(str(species_names[k]) for k in self.types.species)
        style = "eam/alloy" if tables.is_same_for_all else "eam/fs"
        return PairStyle(style, tables.cutoff, False, UNSCALED, [("* *", f"{METALS} {elements}")])

    def _charged(self, potential: Coulomb, engine: Engine) -> PairStyle:
        """The style of charges, and in a periodic cell their sum over waves.
        LAMMPS' accuracy is the rms error of forces [energy/length], minimd's is relative to the rms force; in a
        crystal, where forces vanish, to the energy of an atom over the cutoff."""
        term = potential.bind(engine.system)
        common = (False, tuple(potential.bonded_scale), [("* *", "")])
        if term.cutoff == np.inf:
            return PairStyle("coul/cut", self._farthest, *common)
        if term.pair_law.slab != "none":
            raise _outside(potential, KINDS)
        obstacle = term.warning
        if potential.accuracy < FINEST:
            obstacle = (
                obstacle or f"accuracy must be at least {FINEST:g}, and is {potential.accuracy:g}"
            )

        if obstacle:
            raise ValueError(
                f"LAMMPS cannot sum these charges as minimd does: {obstacle}; run this scene with minimd"
            )

        present = evaluate(engine.system, potential)
        rms = np.sqrt((present.forces**2).sum(axis=1).mean())
        least = np.abs(present.energies).mean() / term.cutoff
        self.kspace = [
            f"kspace_style pppm {words(potential.accuracy * max(rms, least))}",
            f"pair_modify table {TABLE} tabinner {words(term.cutoff / NEAR)}",
        ]
        self.tolerance = MARGIN * potential.accuracy
        self.smallest_cutoff = min(self.smallest_cutoff, term.cutoff)
        return PairStyle("coul/long", term.cutoff, *common)

    def _hold(self, constraints: DistanceConstraints) -> None:
        """Add bonds and angles without force, for fix shake."""
        is_fixed = self.types.is_fixed[self.types.of_atom]
        pairs = constraints.pairs
        for pair in pairs[is_fixed[pairs].any(axis=1)].tolist():
            raise ValueError(
                "LAMMPS cannot hold the distance of a fixed atom from another, such as that of atoms "
                f"{pair}: run this scene with minimd"
            )
        bonds, lengths, angles, openings = rigid_groups(constraints, len(is_fixed))
        forceless = lambda row: ("harmonic", words(0.0, *row))  # noqa: E731
        self.rigid_bonds = self.bonds.add(bonds, lengths[:, None], forceless)
        self.rigid_angles = self.angles.add(angles, np.degrees(openings)[:, None], forceless)

    def _complete_graph(self, bonds: Indices) -> None:
        """Add bonds without a law: LAMMPS counts bonded_scale along all it knows.  ValueError if it knows others."""
        known = self.bonds.atoms
        for pair in known[~among(known, bonds)].tolist():
            raise ValueError(
                "LAMMPS counts bonded_scale also along rigid lengths and bonds given as pairs; minimd "
                f"does not, and atoms {pair} have no bond in the system: add this bond to it"
            )
        missing = bonds[~among(bonds, known)]
        self.bonds.add(missing, np.zeros((len(missing), 1)), lambda _: ("harmonic", "0 1"))

    def special_bonds(self) -> tuple[float, ...]:
        """Factors for pairs one, two and three bonds apart, common to all styles, or SPECIAL if styles differ."""
        scales = {style.scale for style in self.pair_styles} or {UNSCALED}
        each = zip(*scales, strict=True)
        return tuple(factors[0] if len({*factors}) == 1 else SPECIAL for factors in each)

    def commands(self) -> list[str]:
        """Styles and coefficients of pairs, bonds, angles and dihedrals as commands."""
        linked = [line for word, groups in self.joined.items() for line in groups.commands(word)]
        if not self.pair_styles:
            return [f"pair_style zero {self.cutoff:.17g}", "pair_coeff * *", *linked]
        is_hybrid = len(self.pair_styles) > 1
        hybrid = "hybrid/overlay " if is_hybrid else ""
        names = [style.name for style in self.pair_styles]
        styles = " ".join(style.words for style in self.pair_styles)
        lines = [f"pair_style {hybrid}{styles}"]

        for k, style in enumerate(self.pair_styles):
            label = of_pair = ""
            if is_hybrid:
                number = names[: k + 1].count(style.name)
                label = (
                    f"{style.name} {number} " if names.count(style.name) > 1 else f"{style.name} "
                )
                of_pair = f"pair {label}"

            for types, numbers in style.coefficients:
                lines.append(f"pair_coeff {types} {label}{numbers}")
            if style.shift:
                lines.append(f"pair_modify {of_pair}shift yes")
            if style.scale != self.special_bonds():
                lines.append(f"pair_modify pair {label}special lj/coul {words(*style.scale)}")

        return lines + self.kspace + linked


def words(*numbers: float) -> str:
    """Numbers with all their digits, as LAMMPS reads them."""
    return " ".join(f"{number:.17g}" for number in numbers)


def _coefficients(potential: Bonded, row: list[float]) -> Style:
    """Style and numbers of a bond, an angle or a dihedral.
    Raises ValueError for a law that LAMMPS does not have."""
    if potential.lammps is not None:
        return potential.lammps.name, words(*potential.lammps.numbers(*row))
    if potential.acts_on == "bonds":
        return "lepton no_offset", f'0 "{energy_expression(potential.law, tuple(row))}"'
    raise _outside(potential, "periodic, OPLS and Ryckaert-Bellemans dihedrals")


def _outside(potential: Any, known: str) -> ValueError:
    return ValueError(
        f"LAMMPS can be given {known} of minimd; {shown(potential)} is none of them: run this scene with minimd"
    )
