"""Laws on bonds, angles, dihedrals and impropers: groups of two, three or four atoms, given or those of the system; and
maps of two dihedrals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.words import shown
from minimd.core.potentials import declared as kind, laws
from minimd.core.potentials.declared import (
    NOT_NEGATIVE,
    POSITIVE,
    WHOLE,
    Declared,
    LammpsStyle,
    declared,
)
from minimd.core.potentials.law import check_law_of_angles, check_user_law, checked_law, on_vectors
from minimd.core.potentials.links import Bend, FixedPairs, LinkedTerm, Torsion, TwoTorsions
from minimd.core.potentials.splines import periodic_cubics
from minimd.core.potentials.term import NoTerm, Term, no_bonds
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import GROUPS, checked_groups, checked_pairs
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.system import System

STRETCH = "u = −k longest² ln(1 − (r/longest)²)/2, plus the repulsion"
REPULSION = "ε of the repulsion, a Lennard-Jones law cut at its minimum; 0 for none"
# of the length of the first bond: where a user's law of bonds is tried
TRIED_AT = (0.9, 0.97, 1.06)
ARGUMENTS = {2: "pairs", 3: "triples", 4: "quadruples"}
PAIRS = declared(kind.groups, of=2, default=None)
QUADRUPLES = declared(kind.groups, of=4, default=None)


class Bonded(Declared):
    """Base class.
    acts_on : the groups of a System on which it acts if none are given.
    law : law type.
    term : makes the term of groups (G, n), from the columns of their numbers."""

    acts_on: ClassVar[str]
    law: ClassVar[Any]
    term: ClassVar[Callable[..., Term]]

    def groups_in(self, system: System) -> Indices:
        """(G, n) int, those on which it acts in a system.
        Raises ValueError if they name atoms that do not exist."""
        size = GROUPS[self.acts_on]
        name = ARGUMENTS[size]
        groups: Indices | None = getattr(self, name)
        if groups is None:
            groups = getattr(system, self.acts_on)
        if size == 2:
            return checked_pairs(name, groups, len(system))
        return checked_groups(name, groups, size, len(system))

    def bind(self, system: System) -> Term:
        """The term of these groups in a system.
        Raises ValueError if they name a missing atom, or an array of parameters has another length than their list."""
        groups = self.groups_in(system)
        columns = self.columns(self.acts_on, len(groups))
        if len(groups):
            self.check_law(system, groups[0], tuple(float(column[0]) for column in columns))
            return self.term(groups, columns)
        is_of_system = getattr(self, ARGUMENTS[GROUPS[self.acts_on]]) is None
        return NoTerm(no_bonds(repr(self), self.acts_on) if is_of_system else "")

    def check_law(self, system: System, group: Indices, numbers: tuple[float, ...]) -> None:
        """Compare a user's law with its slope, for the first group.
        Raises ValueError if it is wrong."""


class Bond(Bonded):
    """Base class of laws u(r) along bonds, whatever their length; each runs to the nearest image of its partner."""

    acts_on = "bonds"

    def term(self, groups: Indices, columns: tuple[Array, ...]) -> Term:
        """See Bonded."""
        return FixedPairs(groups, self.law, (np.full(len(groups), np.inf), *columns))


class BondPotential(Bond):
    """A law u(r) along bonds, whatever their length. Each bond runs to the nearest image of its partner."""

    law: Callable | tuple = declared(kind.own_law, "law(r2, *parameters), as for PairPotential")  # type: ignore[misc]
    parameters: Sequence[ArrayLike] = declared(kind.own_parameters, default=())
    pairs: ArrayLike | None = PAIRS

    def check_law(self, system: System, group: Indices, numbers: tuple[float, ...]) -> None:
        """See Bonded."""
        r = float(np.linalg.norm(nearest_vectors(system.positions, system.cell, group[None])))
        if r > 0.0:
            check_user_law(checked_law(self.law), numbers, [x * r for x in TRIED_AT])


class HarmonicBond(Bond):
    """Harmonic bond u(r) = ½ k (r − r₀)²."""

    law = laws.HarmonicLaw()
    lammps = LammpsStyle("harmonic", lambda k, length: (0.5 * k, length))
    k: ArrayLike = declared(kind.each, "u = k (r − length)²/2", "stiffness", NOT_NEGATIVE)
    length: ArrayLike = declared(kind.each, "rest length", "length", NOT_NEGATIVE)
    pairs: ArrayLike | None = PAIRS


class MorseBond(Bond):
    """Morse bond u(r) = D (1 − exp[−a (r − r₀)])², which breaks when it is pulled; its stiffness at rest is 2 a² D."""

    law = laws.MorseLaw()
    lammps = LammpsStyle("morse")
    depth: ArrayLike = declared(
        kind.each, "u = depth (1 − exp(−a (r − length)))²", "energy", NOT_NEGATIVE
    )
    a: ArrayLike = declared(kind.each, "inverse width", "inverse length", POSITIVE)
    length: ArrayLike = declared(kind.each, "rest length", "length", NOT_NEGATIVE)
    pairs: ArrayLike | None = PAIRS


class QuarticBond(Bond):
    """Quartic bond u(r) = k₂ (r − r₀)² + k₃ (r − r₀)³ + k₄ (r − r₀)⁴, of CFF, PCFF and COMPASS, without a factor ½.

    LAMMPS' `bond_style class2`. With k₃ < 0 and k₄ = 0 the energy of a long bond has no lower bound.
    """

    law = laws.QuarticLaw()
    lammps = LammpsStyle("class2", lambda k2, k3, k4, length: (length, k2, k3, k4))
    k2: ArrayLike = declared(kind.each, "u = k2 (r − length)² + …", "stiffness", NOT_NEGATIVE)
    k3: ArrayLike = declared(kind.each, "… + k3 (r − length)³ + …", "cubic stiffness")
    k4: ArrayLike = declared(kind.each, "… + k4 (r − length)⁴", "quartic stiffness", NOT_NEGATIVE)
    length: ArrayLike = declared(kind.each, "rest length", "length", POSITIVE)
    pairs: ArrayLike | None = PAIRS


class FENEBond(Bond):
    """Finitely extensible bond of Kremer and Grest: −½ k R² ln(1 − (r/R)²), and a repulsion of its two beads,
    Lennard-Jones cut at its minimum.

    Exclude bonded pairs from the potential between all beads with bonded_scale=(0, 1, 1), as LAMMPS' `special_bonds
    fene` does. The energy of a bond of length R or more is not finite: the run ends with NonFiniteError.
    """

    law = laws.FENELaw()
    lammps = LammpsStyle("fene")
    k: ArrayLike = declared(kind.each, STRETCH, "stiffness", NOT_NEGATIVE)
    longest: ArrayLike = declared(kind.each, "length that a bond cannot reach", "length", POSITIVE)
    epsilon: ArrayLike = declared(kind.each, REPULSION, "energy", NOT_NEGATIVE, default=1.0)
    sigma: ArrayLike = declared(kind.each, "σ of the repulsion", "length", POSITIVE, default=1.0)
    pairs: ArrayLike | None = PAIRS


class HarmonicAngle(Bonded):
    """Harmonic angle u(θ) = ½ k (θ − θ₀)² at the middle atom of each triple.

    Where θ is exactly 0 or π, the force has no direction; it is then zero.
    """

    acts_on = "angles"
    lammps = LammpsStyle("harmonic", lambda k, angle: (0.5 * k, np.degrees(angle)))
    k: ArrayLike = declared(kind.each, "u = k (θ − angle)²/2", "angular stiffness", NOT_NEGATIVE)
    angle: ArrayLike = declared(kind.each, "rest angle", "angle", kind.ANGLE)
    triples: ArrayLike | None = declared(kind.groups, "the middle one second", of=3, default=None)

    def term(self, groups: Indices, columns: tuple[Array, ...]) -> Term:
        """See Bonded."""
        k, angle = columns
        return LinkedTerm(groups, Bend(), (), (k, np.sin(angle), np.cos(angle)))


class Dihedral(Bonded):
    """Base class of laws u(φ) of the dihedral angle of atoms i, j, k, l, about the axis from j to k."""

    acts_on = "dihedrals"

    def term(self, groups: Indices, columns: tuple[Array, ...]) -> Term:
        """See Bonded."""
        return LinkedTerm(groups, Torsion(), on_vectors(self.law, len(columns)), columns)


class DihedralPotential(Dihedral):
    """A law u(φ) of the dihedral angles of quadruples of atoms i, j, k, l, about the axis from j to k.

    law(phi, *parameters) of the angle [rad], −π < φ ≤ π, zero for cis and ±π for trans, returns u [energy] and u′(φ)
    [energy/rad]; it is plain Python of numbers, or already compiled by numba.njit. Each bond of the chain i, j, k, l
    runs to the nearest image of its partner.
    """

    law: Callable | tuple = declared(kind.own_law, "law(phi, *parameters)")  # type: ignore[misc]
    parameters: Sequence[ArrayLike] = declared(kind.own_parameters, default=())
    quadruples: ArrayLike | None = QUADRUPLES

    def check_law(self, system: System, group: Indices, numbers: tuple[float, ...]) -> None:
        """See Bonded."""
        check_law_of_angles(checked_law(self.law), numbers)


class PeriodicDihedral(Dihedral):
    """Periodic torsion u(φ) = k [1 + cos(nφ − φ₀)], as in CHARMM and AMBER.

    A quadruple that is given several times has a sum of terms.
    LAMMPS' `dihedral_style harmonic`, K [1 + d cos(nφ)], is k = K with the phase 0 for d = 1 and π for d = −1.
    """

    law = laws.PeriodicLaw()
    lammps = LammpsStyle("fourier", lambda k, n, phase: (1, k, n, np.degrees(phase)))
    k: ArrayLike = declared(kind.each, "u = k (1 + cos(n φ − phase))", "energy")
    n: ArrayLike = declared(kind.each, "number of minima in a turn", "", kind.WHOLE)
    phase: ArrayLike = declared(kind.each, "phase of u, see k", "angle", kind.PHASE, default=0.0)
    quadruples: ArrayLike | None = QUADRUPLES


class RyckaertBellemans(Dihedral):
    """Ryckaert-Bellemans torsion u(φ) = Σ cₙ cosⁿ(φ − π), n = 0 … 5.

    LAMMPS' `dihedral_style nharmonic` has powers of cos φ: A₁ = c₀, A₂ = −c₁, A₃ = c₂, A₄ = −c₃ …
    """

    law = laws.RyckaertBellemansLaw()
    lammps = LammpsStyle("nharmonic", lambda c0, c1, c2, c3, c4, c5: (6, c0, -c1, c2, -c3, c4, -c5))
    coefficients: Sequence[ArrayLike] = declared(
        kind.coefficients, "c₀ to c₅ of u = Σ cₙ cosⁿ(φ − 180°)", "energy"
    )
    quadruples: ArrayLike | None = QUADRUPLES

    def numbers(self) -> dict[str, Array]:
        """See Declared."""
        return {f"c{n}": np.asarray(c) for n, c in enumerate(self.coefficients)}


class OPLSDihedral(Dihedral):
    """OPLS torsion u(φ) = ½ [k₁ (1 + cos φ) + k₂ (1 − cos 2φ) + k₃ (1 + cos 3φ) + k₄ (1 − cos 4φ)].

    LAMMPS' `dihedral_style opls`. It is computed as the polynomial of Ryckaert and Bellemans that equals it.

    W. L. Jorgensen, D. S. Maxwell, J. Tirado-Rives, J. Am. Chem. Soc. 118, 11225 (1996).
    """

    law = RyckaertBellemans.law
    lammps = RyckaertBellemans.lammps
    k1: ArrayLike = declared(kind.each, "u = k1 (1 + cos φ)/2 + …", "energy")
    k2: ArrayLike = declared(kind.each, "… + k2 (1 − cos 2φ)/2 + …", "energy")
    k3: ArrayLike = declared(kind.each, "… + k3 (1 + cos 3φ)/2 + …", "energy")
    k4: ArrayLike = declared(kind.each, "… + k4 (1 − cos 4φ)/2", "energy", default=0.0)
    quadruples: ArrayLike | None = QUADRUPLES

    def __post_init__(self) -> None:
        super().__post_init__()
        shapes = [array.shape for array in super().numbers().values()]
        if len({*shapes} - {()}) > 1:
            raise ValueError(f"k1 to k4 must have the same length; their shapes are {shapes}")

    def numbers(self) -> dict[str, Array]:
        """See Declared."""
        k1, k2, k3, k4 = super().numbers().values()
        return {
            "c0": k2 + 0.5 * (k1 + k3),
            "c1": 0.5 * (3.0 * k3 - k1),
            "c2": 4.0 * k4 - k2,
            "c3": -2.0 * k3,
            "c4": -4.0 * k4,
            "c5": np.zeros(()),
        }


class HarmonicImproper(Dihedral):
    """Harmonic improper u(φ) = ½ k (φ − φ₀)², φ − φ₀ taken between −π and π.

    φ is the dihedral angle of the four atoms in the order in which they are given, with its sign: φ₀ = 0 keeps them in
    a plane, another φ₀ keeps the chirality of a center.
    LAMMPS' `improper_style harmonic` takes the same angle without its sign, and K = k/2.
    """

    acts_on = "impropers"
    law = laws.HarmonicTorsionLaw()
    k: ArrayLike = declared(kind.each, "u = k (φ − angle)²/2", "angular stiffness", NOT_NEGATIVE)
    angle: ArrayLike = declared(
        kind.each, "rest angle, with its sign", "angle", kind.SIGNED_ANGLE, default=0.0
    )
    quadruples: ArrayLike | None = QUADRUPLES


class DihedralMap(Declared):
    """A map u(φ, ψ) of two dihedral angles of neighbors, as CMAP in CHARMM and in Amber's ff19SB.

        u(φ, ψ) = Σ cₖₗ sᵏ tˡ,   k, l = 0 … 3,   s, t : the parts of a step 2π/n that are behind φ and ψ

    Point [i, j] of n × n is u(2π i/n, 2π j/n). Between them u is the bicubic spline that is periodic in both angles, as
    in OpenMM; its forces have no jump. LAMMPS' `fix cmap` is another interpolation.

    A. D. MacKerell Jr., M. Feig, C. L. Brooks III, J. Comput. Chem. 25, 1400 (2004).
    """

    energies: ArrayLike = declared(kind.maps, "u of one map, or of each", "energy")
    phi: ArrayLike = declared(kind.quadruples, "atoms of the first angles")
    psi: ArrayLike = declared(kind.quadruples, "atoms of the second angles, as many")
    which: ArrayLike = declared(
        kind.each, "number of the map of each pair of angles, from 0 on", "", WHOLE, default=0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        given: Any = self
        if len(given.phi) != len(given.psi):
            raise ValueError(
                "phi and psi must have as many quadruples as each other; they have "
                f"{len(given.phi)} and {len(given.psi)}"
            )
        if given.which.max(initial=0) >= len(given.energies):
            raise ValueError(
                f"which must be less than the number of maps, {len(given.energies)}; "
                f"which = {shown(given.which.tolist())}"
            )

    def bind(self, system: System) -> Term:
        """The term of these angles in a system.
        Raises ValueError if they name a missing atom, or which has another length."""
        angles = [
            checked_groups(name, getattr(self, name), 4, len(system)) for name in ("phi", "psi")
        ]
        columns = self.columns("pairs of angles", len(angles[0]))
        if not len(angles[0]):
            return NoTerm()
        # (k, l, M, j, i), of powers and steps
        coefficients = periodic_cubics(periodic_cubics(np.asarray(self.energies)).swapaxes(-1, -2))
        law = laws.DihedralMapLaw(np.ascontiguousarray(coefficients.transpose(2, 4, 3, 0, 1)))
        return LinkedTerm(np.hstack(angles), TwoTorsions(), law, columns)
