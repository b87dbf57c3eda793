"""A scene translated for LAMMPS: types, bonds, angles and dihedrals, pair styles from the laws;
errors for all that LAMMPS does not have."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.engine.engine import Engine
from minimd.lammps.box import Box
from minimd.lammps.expression import energy_expression
from minimd.lammps.rigid import Rigid
from minimd.lammps.types import AtomTypes, Groups
from minimd.potentials import BondPotential, DihedralPotential, HarmonicAngle, PairPotential
from minimd.potentials.laws import FENELaw, HarmonicLaw, LennardJonesLaw, MorseLaw
from minimd.potentials.pair import UNSCALED
from minimd.potentials.torsion_laws import PeriodicLaw, RyckaertBellemansLaw
from minimd.potentials.truncation import ForceShifted, Shifted
from minimd.structure.bond_graph import among
from minimd.structure.cell import Cell
from minimd.structure.checks import shown
from minimd.structure.constraints import DistanceConstraints
from minimd.structure.images import nearest_vectors

FAR = 100.0  # extents of the scene: the cutoff of a law without one
SKIN = 0.12  # of the smallest cutoff, or longest bond
REACH = 2.0  # in longest bonds: the distance up to which LAMMPS finds partners of an atom on other processes
SPECIAL = (
    0.5  # a factor, neither 0 nor 1, for which LAMMPS keeps the pairs and marks them, if styles have different factors
)
LJ_STYLES = {
    LennardJonesLaw: "lj/cut",
    Shifted: "lj/cut",
    ForceShifted: "lj/smooth/linear",
}  # the styles of LAMMPS with the same truncation

BOND_STYLES = {MorseLaw: "morse", FENELaw: "fene"}  # the styles with the same parameters as minimd's law


class PairStyle(NamedTuple):
    """name : of the style.  cutoff : the largest [length].  shift : whether LAMMPS subtracts u(r_c).  scale :
    bonded_scale.

    coefficients : for each pair of types, the types as LAMMPS writes them, and the parameters.
    """

    name: str
    cutoff: float
    shift: bool
    scale: tuple[float, ...]
    coefficients: list[tuple[str, str]]


class Model:
    """A scene translated for LAMMPS.

    Attributes
    ----------
    box : Box.  types : AtomTypes.  bonds, angles, dihedrals : Groups.  rigid_bonds, rigid_angles :
        the types that fix shake holds.
    pair_styles : list of PairStyle.  cutoff, skin : [length], of lists.  reach : [length],
        of the communication between processes.
    search : how lists are built.

    Raises
    ------
    ValueError : for anything that LAMMPS cannot do as minimd does.
    """

    def __init__(self, engine: Engine) -> None:
        system = engine.system
        self.box, self.types = Box(system), AtomTypes.of(engine)
        self.bonds, self.angles, self.dihedrals = Groups(2), Groups(3), Groups(4)
        self.rigid_bonds, self.rigid_angles = range(0), range(0)
        self._extent = float(np.ptp(system.positions, axis=0).max(initial=1.0))
        self.pair_styles: list[PairStyle] = []
        self.smallest_cutoff, self.search = np.inf, "bin"
        for one in engine.constraints:
            if isinstance(one, DistanceConstraints):
                self._hold(one, self.types.is_fixed[self.types.of_atom])
        for potential in engine.interactions.potentials:
            self._take(potential, engine)
        if any(style.scale != UNSCALED for style in self.pair_styles):
            self._complete_graph(system.bonds)
        bonded = _longest(system.positions, system.cell, list(self.joined.values()))
        self.cutoff = max((style.cutoff for style in self.pair_styles), default=bonded)
        self.skin = SKIN * (self.smallest_cutoff if self.smallest_cutoff < np.inf else bonded)
        self.reach = max(self.cutoff + self.skin, REACH * bonded + self.skin)
        self.box.make_room(self.reach)

    @property
    def joined(self) -> dict[str, Groups]:
        """Bonds, angles and dihedrals, by LAMMPS' word for one of them."""
        return {"bond": self.bonds, "angle": self.angles, "dihedral": self.dihedrals}

    @property
    def atom_style(self) -> str:
        """LAMMPS' style of atoms: atomic, or with bonds and angles, or also with dihedrals."""
        if len(self.dihedrals.atoms):
            return "molecular"
        return "angle" if len(self.bonds.atoms) + len(self.angles.atoms) else "atomic"

    def _take(self, potential: Any, engine: Engine) -> None:
        system = engine.system
        if isinstance(potential, PairPotential):
            self.pair_styles.append(self._pair_style(potential, system.species_names))
            self.smallest_cutoff = min(self.smallest_cutoff, potential.shortest_length)
            self.search = "nsq" if potential.cutoff == np.inf else self.search
        elif isinstance(potential, BondPotential):
            pairs = system.bonds if potential.pairs is None else potential.pairs
            rows, of_each = np.unique(
                potential.table(len(pairs)), axis=0, return_inverse=True
            )  # the first column is an infinite cutoff
            self.bonds.add(pairs, of_each.reshape(-1), [_bond_coefficients(potential.law, row[1:]) for row in rows])
        elif isinstance(potential, HarmonicAngle):
            triples = system.angles if potential.triples is None else potential.triples
            each = np.column_stack([np.broadcast_to(values, len(triples)) for values in (potential.k, potential.angle)])
            rows, of_each = np.unique(each, axis=0, return_inverse=True)
            self.angles.add(
                triples,
                of_each.reshape(-1),
                [("harmonic", f"{0.5 * k:.17g} {np.degrees(angle):.17g}") for k, angle in rows],
            )
        elif isinstance(potential, DihedralPotential):
            quadruples = potential.quadruples_in(system)
            rows, of_each = np.unique(np.column_stack(potential.columns(len(quadruples))), axis=0, return_inverse=True)
            self.dihedrals.add(
                quadruples, of_each.reshape(-1), [_dihedral_coefficients(potential, row.tolist()) for row in rows]
            )
        else:
            known = "pair potentials, bonds, harmonic angles and dihedrals"
            raise ValueError(
                f"LAMMPS can be given {known} of minimd; {shown(potential)} is none of them: run this scene with minimd"
            )

    def _pair_style(self, potential: PairPotential, species_names: tuple) -> PairStyle:
        """The style of a pair potential: a Lennard-Jones style of LAMMPS if there is one,
        else its law as an expression for Lepton."""
        table = potential.table(species_names)
        is_own = isinstance(potential.plain_law, LennardJonesLaw) and type(potential.law) in LJ_STYLES
        name = LJ_STYLES[type(potential.law)] if is_own else "lepton"
        texts: dict[tuple[float, ...], str] = {}
        coefficients = []
        for first, second, row in self._rows(table):
            key = tuple(row.tolist())
            if key not in texts:
                cutoff = self._finite(key[0] ** 0.5)
                numbers = (
                    f"{key[-2]:.17g} {key[-1]:.17g}" if is_own else f'"{energy_expression(potential.law, key[1:])}"'
                )
                texts[key] = f"{numbers} {cutoff:.17g}"
            coefficients.append((f"{first} {second}", texts[key]))
        cutoff = self._finite(float(np.sqrt(table[:, :, 0].max())))
        return PairStyle(
            name, cutoff, is_own and isinstance(potential.law, Shifted), potential.bonded_scale, coefficients
        )

    def _rows(self, table: NDArray[np.float64]) -> list[tuple[str, str, NDArray[np.float64]]]:
        """Pairs of types, and the parameters of their law."""
        if len(table) == 1:
            return [("*", "*", table[0, 0])]
        species = self.types.species
        return [
            (str(i + 1), str(j + 1), table[species[i], species[j]])
            for i in range(len(species))
            for j in range(i, len(species))
        ]

    def _finite(self, cutoff: float) -> float:
        return cutoff if cutoff < np.inf else FAR * self._extent

    def _hold(self, constraints: DistanceConstraints, is_fixed: NDArray[np.bool_]) -> None:
        """Add bonds and angles without force, for fix shake."""
        if is_fixed[constraints.pairs].any():
            pair = constraints.pairs[np.argmax(is_fixed[constraints.pairs].any(axis=1))].tolist()
            raise ValueError(
                f"LAMMPS cannot hold the distance of a fixed atom from another, such as that of atoms {pair}: run this "
                "scene with minimd"
            )
        rigid = Rigid.of(constraints, len(is_fixed))
        lengths, of_each = np.unique(rigid.lengths, return_inverse=True)
        self.rigid_bonds = self.bonds.add(
            rigid.bonds, of_each, [("harmonic", f"0 {length:.17g}") for length in lengths]
        )
        kinds, of_each = np.unique(rigid.openings, return_inverse=True)
        self.rigid_angles = self.angles.add(
            rigid.angles, of_each, [("harmonic", f"0 {np.degrees(angle):.17g}") for angle in kinds]
        )

    def _complete_graph(self, bonds: NDArray[np.int64]) -> None:
        """Add the bonds without a law: LAMMPS counts bonded_scale along all bonds that it knows.
        Raises ValueError if it knows others."""
        known = self.bonds.atoms
        if len(known) and not among(known, bonds).all():
            pair = known[np.argmin(among(known, bonds))].tolist()
            raise ValueError(
                "minimd counts bonded_scale along the bonds of the system, LAMMPS also along held lengths and others; "
                f"atoms {pair} are not bonded"
            )
        missing = bonds[~among(bonds, known)] if len(known) else bonds
        if len(missing):
            self.bonds.add(missing, np.zeros(len(missing), dtype=np.int64), [("harmonic", "0 1")])

    def special_bonds(self) -> tuple[float, ...]:
        """Factors for pairs one, two and three bonds apart, common to all styles, or SPECIAL if styles differ."""
        scales = {style.scale for style in self.pair_styles} or {UNSCALED}
        return tuple(one[0] if len(set(one)) == 1 else SPECIAL for one in zip(*scales, strict=True))

    def pair_commands(self) -> list[str]:
        """Styles and coefficients of pairs as commands."""
        if not self.pair_styles:
            return [f"pair_style zero {self.cutoff:.17g}", "pair_coeff * *"]
        several, names = len(self.pair_styles) > 1, [style.name for style in self.pair_styles]
        words = [f"{style.name} {style.cutoff:.17g}" for style in self.pair_styles]
        lines = [f"pair_style {'hybrid/overlay ' if several else ''}{' '.join(words)}"]
        for k, style in enumerate(self.pair_styles):
            place = f" {names[: k + 1].count(style.name)}" if names.count(style.name) > 1 else ""
            label = f"{style.name}{place} " if several else ""
            lines += [f"pair_coeff {types} {label}{numbers}" for types, numbers in style.coefficients]
            lines += [f"pair_modify {f'pair {label}' if several else ''}shift yes"] if style.shift else []
            if style.scale != self.special_bonds():
                lines.append(
                    f"pair_modify pair {label}special lj/coul {' '.join(f'{factor:.17g}' for factor in style.scale)}"
                )
        return lines


def _bond_coefficients(law: tuple, row: NDArray[np.float64]) -> tuple[str, str]:
    """Style and numbers of a bond; LAMMPS' K of harmonic bonds is k/2."""
    if isinstance(law, HarmonicLaw):
        return "harmonic", f"{0.5 * row[0]:.17g} {row[1]:.17g}"
    if type(law) in BOND_STYLES:
        return BOND_STYLES[type(law)], " ".join(f"{number:.17g}" for number in row.tolist())
    return "lepton no_offset", f'0 "{energy_expression(law, tuple(row.tolist()))}"'


def _dihedral_coefficients(potential: DihedralPotential, row: list[float]) -> tuple[str, str]:
    """Style and numbers of a dihedral.  Raises ValueError for a law that LAMMPS does not have."""
    if isinstance(potential.law, PeriodicLaw):
        k, n, phase = row
        return "fourier", f"1 {k:.17g} {n:.0f} {np.degrees(phase):.17g}"
    if isinstance(potential.law, RyckaertBellemansLaw):  # powers of −cos φ in minimd, of cos φ in LAMMPS
        return "nharmonic", " ".join([str(len(row)), *(f"{-c if n % 2 else c:.17g}" for n, c in enumerate(row))])
    known = "periodic, OPLS and Ryckaert-Bellemans dihedrals"
    raise ValueError(
        f"LAMMPS can be given {known} of minimd; {shown(potential)} is none of them: run this scene with minimd"
    )


def _longest(positions: NDArray[np.float64], cell: Cell, joined: list[Groups]) -> float:
    """The longest present bond, in angles and dihedrals too [length]; 1 if there is none."""
    pairs = np.concatenate([groups.atoms[:, k : k + 2] for groups in joined for k in range(groups.size - 1)])
    if not len(pairs):
        return 1.0
    return float(np.linalg.norm(nearest_vectors(positions, cell, pairs), axis=1).max())
