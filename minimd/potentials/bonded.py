"""Laws on bonds, angles, dihedrals and impropers: groups of two, three or four atoms, given or those of the system."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.kernels import inlined, scalar
from minimd.compiled.simd import fma, select
from minimd.potentials.declared import (
    ANGLE,
    NOT_NEGATIVE,
    POSITIVE,
    SIGNED_ANGLE,
    WHOLE,
    Array,
    Declared,
    LammpsStyle,
    coefficients,
    declared,
    each,
    groups,
    own_law,
    own_parameters,
)
from minimd.potentials.lanewise import on_vectors
from minimd.potentials.law import evaluate_law
from minimd.potentials.laws import (
    FENELaw,
    HarmonicLaw,
    HarmonicTorsionLaw,
    MorseLaw,
    PeriodicLaw,
    RyckaertBellemansLaw,
)
from minimd.potentials.links import FixedPairs, LinkedTerm, arm, link_shape, push
from minimd.potentials.term import NoTerm, Term, no_bonds
from minimd.structure.bond_graph import GROUPS, checked_groups, checked_pairs
from minimd.structure.system import System
from minimd.structure.vectors import combined, cross, dot, times

ARGUMENTS = {2: "pairs", 3: "triples", 4: "quadruples"}
# the smallest sin² of the angle between two neighboring bonds by which forces are divided: its rounding error
STRAIGHT2 = 1e-16


class Bonded(Declared):
    """Base class.  acts_on : the groups of a System on which it acts if none are given.  law : law type."""

    acts_on: ClassVar[str]
    law: ClassVar[Any]

    def groups_in(self, system: System) -> NDArray[np.int64]:
        """(G, n) int, those on which it acts in a system.  Raises ValueError if they name atoms that do not exist."""
        name = ARGUMENTS[size := GROUPS[self.acts_on]]
        own: NDArray[np.int64] = getattr(system, self.acts_on) if (given := getattr(self, name)) is None else given
        return checked_pairs(name, own, len(system)) if size == 2 else checked_groups(name, own, size, len(system))

    def bind(self, system: System) -> Term:
        """The term of these groups in a system.

        Raises
        ------
        ValueError : if a group names a missing atom, or an array of parameters has another length than their list.
        """
        found = self.groups_in(system)
        columns = self.columns(self.acts_on, len(found))
        if len(found):
            return self.term(found, columns)
        is_told = getattr(self, ARGUMENTS[GROUPS[self.acts_on]]) is None
        return NoTerm(no_bonds(repr(self), self.acts_on) if is_told else "")

    def term(self, found: NDArray[np.int64], columns: tuple[Array, ...]) -> Term:
        """The term of some groups.  columns : the numbers of each."""
        raise NotImplementedError(f"{type(self).__name__} has no term")


class Bond(Bonded):
    """Base class of laws u(r) along bonds, whatever their length; each runs to the nearest image of its partner."""

    acts_on = "bonds"

    def term(self, found: NDArray[np.int64], columns: tuple[Array, ...]) -> Term:
        """See Bonded."""
        return FixedPairs(found, self.law, (np.full(len(found), np.inf), *columns))


class BondPotential(Bond):
    """A law u(r) along bonds, whatever their length.

    Parameters
    ----------
    law : function law(r2, *parameters) as for PairPotential.
    parameters : one entry for each parameter of the law: a number for all bonds, or an array with one number for each.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Each bond runs to the nearest image of its partner. Raises ValueError for parameters that are not finite numbers, or
    invalid pairs; TypeError for a law that is not a function, or parameters that are not a tuple.
    """

    law: Callable | tuple = declared(own_law)  # type: ignore[misc]
    parameters: Sequence[ArrayLike] = declared(own_parameters, default=())
    pairs: ArrayLike | None = declared(groups, of=2, default=None)


class HarmonicBond(Bond):
    """Harmonic bond u(r) = ½ k (r − r₀)².

    Parameters
    ----------
    k : stiffness [energy/length²], one number or one for each bond.
    length : r₀ [length], one number or one for each bond.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Raises
    ------
    ValueError : if k or a length is negative, or one of them is not finite.
    """

    law, lammps = HarmonicLaw(), LammpsStyle("harmonic", lambda k, length: (0.5 * k, length))
    k: ArrayLike = declared(each, "stiffness", NOT_NEGATIVE)
    length: ArrayLike = declared(each, "length", NOT_NEGATIVE)
    pairs: ArrayLike | None = declared(groups, of=2, default=None)


class MorseBond(Bond):
    """Morse bond u(r) = D (1 − exp[−a (r − r₀)])², which breaks when it is pulled.

    Parameters
    ----------
    depth : D [energy].  a : [1/length]; the stiffness at rest is 2 a² D.  length : r₀ [length]. One number each,
        or one for each bond.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Raises
    ------
    ValueError : if depth or length is negative, a is not positive, or one of them is not finite.
    """

    law, lammps = MorseLaw(), LammpsStyle("morse")
    depth: ArrayLike = declared(each, "energy", NOT_NEGATIVE)
    a: ArrayLike = declared(each, "inverse length", POSITIVE)
    length: ArrayLike = declared(each, "length", NOT_NEGATIVE)
    pairs: ArrayLike | None = declared(groups, of=2, default=None)


class FENEBond(Bond):
    """Finitely extensible bond of Kremer and Grest: −½ k R² ln(1 − (r/R)²), and a repulsion of its two beads,
    Lennard-Jones cut at its minimum.

    Exclude bonded pairs from the potential between all beads with bonded_scale=(0, 1, 1), as LAMMPS' `special_bonds
    fene` does. The energy of a bond of length R or more is not finite: the run ends with NonFiniteError.

    Parameters
    ----------
    k : stiffness [energy/length²].  longest : R [length].  epsilon, sigma : of the repulsion [energy], [length];
        epsilon = 0 for none. One number each, or one for each bond.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Raises
    ------
    ValueError : if k or epsilon is negative, a length is not positive, or one of them is not finite.
    """

    law, lammps = FENELaw(), LammpsStyle("fene")
    k: ArrayLike = declared(each, "stiffness", NOT_NEGATIVE)
    longest: ArrayLike = declared(each, "length", POSITIVE)
    epsilon: ArrayLike = declared(each, "energy", NOT_NEGATIVE, default=1.0)
    sigma: ArrayLike = declared(each, "length", POSITIVE, default=1.0)
    pairs: ArrayLike | None = declared(groups, of=2, default=None)


class HarmonicAngle(Bonded):
    """Harmonic angle u(θ) = ½ k (θ − θ₀)² at the middle atom of each triple.

    Where θ is exactly 0 or π, the force has no direction; it is then zero.

    Parameters
    ----------
    k : stiffness [energy/rad²], one number or one for each angle.
    angle : θ₀ [rad], between 0 and π, one number or one for each angle.
    triples : (A, 3) int, atoms i, j, k with j in the middle; system.angles if not given.

    Raises
    ------
    ValueError : if a number is not finite or out of range, or shapes do not fit.
    """

    acts_on, lammps = "angles", LammpsStyle("harmonic", lambda k, angle: (0.5 * k, np.degrees(angle)))
    k: ArrayLike = declared(each, "angular stiffness", NOT_NEGATIVE)
    angle: ArrayLike = declared(each, "angle", ANGLE)
    triples: ArrayLike | None = declared(groups, of=3, default=None)

    def term(self, found: NDArray[np.int64], columns: tuple[Array, ...]) -> Term:
        """See Bonded."""
        k, angle = columns
        return LinkedTerm(found, [(1, 0), (1, 2)], Bend(), (), (k, np.sin(angle), np.cos(angle)))


class Dihedral(Bonded):
    """Base class of laws u(φ) of the dihedral angle of atoms i, j, k, l, about the axis from j to k."""

    acts_on = "dihedrals"

    def term(self, found: NDArray[np.int64], columns: tuple[Array, ...]) -> Term:
        """See Bonded."""
        return LinkedTerm(found, [(1, 0), (2, 1), (2, 3)], Torsion(), on_vectors(self.law, len(columns)), columns)


class DihedralPotential(Dihedral):
    """A law u(φ) of the dihedral angles of quadruples of atoms i, j, k, l, about the axis from j to k.

    Parameters
    ----------
    law : function law(phi, *parameters) of the angle [rad], −π < φ ≤ π, zero for cis and ±π for trans, that returns u
        [energy] and u′(φ) [energy/rad]; plain Python of numbers, or already compiled by numba.njit.
    parameters : one entry for each parameter of the law: a number for all, or an array with one number for each.
    quadruples : (D, 4) int; system.dihedrals if not given.

    Each bond of the chain i, j, k, l runs to the nearest image of its partner. Raises ValueError for parameters that
    are not finite numbers, or invalid quadruples; TypeError for a law that is not a function,
    or parameters that are not a tuple.
    """

    law: Callable | tuple = declared(own_law)  # type: ignore[misc]
    parameters: Sequence[ArrayLike] = declared(own_parameters, default=())
    quadruples: ArrayLike | None = declared(groups, of=4, default=None)


class PeriodicDihedral(Dihedral):
    """Periodic torsion u(φ) = k [1 + cos(nφ − φ₀)], as in CHARMM and AMBER.

    LAMMPS' `dihedral_style harmonic`, K [1 + d cos(nφ)], is k = K with the phase 0 for d = 1 and π for d = −1.

    Parameters
    ----------
    k : half the barrier [energy].  n : minima in a turn, whole numbers from 0 on.  phase : φ₀ [rad]. One number each,
        or one for each dihedral.
    quadruples : (D, 4) int; system.dihedrals if not given. One that is given several times has a sum of terms.

    Raises
    ------
    ValueError : if a number is not finite, n is not whole, or shapes do not fit.
    """

    law, lammps = PeriodicLaw(), LammpsStyle("fourier", lambda k, n, phase: (1, k, n, np.degrees(phase)))
    k: ArrayLike = declared(each, "energy")
    n: ArrayLike = declared(each, "", WHOLE)
    phase: ArrayLike = declared(each, "angle", default=0.0)
    quadruples: ArrayLike | None = declared(groups, of=4, default=None)


class RyckaertBellemans(Dihedral):
    """Ryckaert-Bellemans torsion u(φ) = Σ cₙ cosⁿ(φ − π), n = 0 … 5.

    Parameters
    ----------
    coefficients : c₀ … c₅ [energy], up to six, each one number or one for each dihedral; missing ones are 0.
    quadruples : (D, 4) int; system.dihedrals if not given.

    LAMMPS' `dihedral_style nharmonic` has powers of cos φ: A₁ = c₀, A₂ = −c₁, A₃ = c₂, A₄ = −c₃ …

    Raises
    ------
    ValueError : if a number is not finite, there are more than six, or shapes do not fit.
    """

    law = RyckaertBellemansLaw()
    lammps = LammpsStyle("nharmonic", lambda *c: (len(c), *(-one if n % 2 else one for n, one in enumerate(c))))
    coefficients: Sequence[ArrayLike] = declared(coefficients, "energy")
    quadruples: ArrayLike | None = declared(groups, of=4, default=None)

    def numbers(self) -> dict[str, Array]:
        """See Declared."""
        return {f"c{k}": np.asarray(one) for k, one in enumerate(self.coefficients)}


class OPLSDihedral(Dihedral):
    """OPLS torsion u(φ) = ½ [k₁ (1 + cos φ) + k₂ (1 − cos 2φ) + k₃ (1 + cos 3φ) + k₄ (1 − cos 4φ)].

    LAMMPS' `dihedral_style opls`. It is computed as the polynomial of Ryckaert and Bellemans that equals it.

    Parameters
    ----------
    k1, k2, k3, k4 : [energy], one number each, or one for each dihedral.  quadruples : (D, 4) int;
        system.dihedrals if not given.

    W. L. Jorgensen, D. S. Maxwell, J. Tirado-Rives, J. Am. Chem. Soc. 118, 11225 (1996).

    Raises
    ------
    ValueError : if a number is not finite, or shapes do not fit.
    """

    law, lammps = RyckaertBellemans.law, RyckaertBellemans.lammps
    k1: ArrayLike = declared(each, "energy")
    k2: ArrayLike = declared(each, "energy")
    k3: ArrayLike = declared(each, "energy")
    k4: ArrayLike = declared(each, "energy", default=0.0)
    quadruples: ArrayLike | None = declared(groups, of=4, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        shapes = [np.shape(one) for one in (self.k1, self.k2, self.k3, self.k4)]
        if len({*shapes} - {()}) > 1:
            raise ValueError(f"k1 to k4 must have the same length; their shapes are {shapes}")

    def numbers(self) -> dict[str, Array]:
        """See Declared."""
        one, two, three, four = super().numbers().values()
        c = (two + 0.5 * (one + three), 0.5 * (3.0 * three - one), 4.0 * four - two, -2.0 * three, -4.0 * four, 0.0)
        return {f"c{k}": np.asarray(one) for k, one in enumerate(c)}


class HarmonicImproper(Dihedral):
    """Harmonic improper u(φ) = ½ k (φ − φ₀)², φ − φ₀ taken between −π and π.

    φ is the dihedral angle of the four atoms in the order in which they are given, with its sign: φ₀ = 0 keeps them in
    a plane, another φ₀ keeps the chirality of a center.
    LAMMPS' `improper_style harmonic` takes the same angle without its sign, and K = k/2.

    Parameters
    ----------
    k : stiffness [energy/rad²].  angle : φ₀ [rad], between −π and π. One number each, or one for each improper.
    quadruples : (I, 4) int; system.impropers if not given.

    Raises
    ------
    ValueError : if a number is not finite or out of range, or shapes do not fit.
    """

    acts_on, law = "impropers", HarmonicTorsionLaw()
    k: ArrayLike = declared(each, "angular stiffness", NOT_NEGATIVE)
    angle: ArrayLike = declared(each, "angle", SIGNED_ANGLE, default=0.0)
    quadruples: ArrayLike | None = declared(groups, of=4, default=None)


@inlined
def _minor(a, b, c, d):
    """a b − c d, right to a few roundings even where the products nearly cancel, if fma rounds once (W. Kahan)."""
    x, y = a * b, c * d
    return (x - y) + (fma(a, b, -x) - fma(c, d, -y))


@inlined
def _normal(a, b, lost_a, lost_b):
    """(a + lost_a) × (b + lost_b), to a few roundings however small the angle between them is."""
    n = _minor(a[1], b[2], a[2], b[1]), _minor(a[2], b[0], a[0], b[2]), _minor(a[0], b[1], a[1], b[0])
    return combined(1.0, n, 1.0, combined(1.0, cross(lost_a, b), 1.0, cross(a, lost_b)))


@scalar
def _bend(links, block, _law, numbers):
    """Harmonic angles u = ½ k (θ − θ₀)², with a = r_i − r_j, b = r_k − r_j, n = a × b.

        tan(θ − θ₀) = (|n| cos θ₀ − a·b sin θ₀)/(a·b cos θ₀ + |n| sin θ₀)
        F_i = u′(θ) n × a/(a²|n|),   F_k = u′(θ) b × n/(b²|n|),   all zero if n = 0

    numbers : k [energy/rad²], sin θ₀, cos θ₀. θ near 0 and π, and θ − θ₀ if θ₀ is 0 or π, have all their digits.
    """
    (a, lost_a), (b, lost_b), (k, sine, cosine) = arm(links, 0, block), arm(links, 1, block), numbers
    n = _normal(a, b, lost_a, lost_b)
    size, ab = dot(n, n) ** 0.5, dot(a, b)
    stretch = np.arctan2(size * cosine - ab * sine, ab * cosine + size * sine)
    slope = k * stretch
    s = select(size > 0.0, slope / size, 0.0)
    is_beyond = push(links, 0, block, times(s / dot(a, a), cross(n, a)))
    return 0.5 * slope * stretch, push(links, 1, block, times(s / dot(b, b), cross(b, n))) or is_beyond


@scalar
def _turn(links, block, law, numbers):
    """A law of the dihedral angle, without a division by sin φ.

        F = r_i − r_j,  G = r_j − r_k,  H = r_l − r_k,  A = F × G,  B = H × G
        cos φ = A·B/(|A||B|),   sin φ = (B × A)·G/(|A||B||G|)
        F_i = u′ |G|/A² A,   F_l = −u′ |G|/B² B,   S = u′ (F·G/(A²|G|) A − H·G/(B²|G|) B),
        F_j = −F_i − S,   F_k = −F_l + S

    A. Blondel, M. Karplus, J. Comput. Chem. 17, 1132 (1996), eq. 6, 27.
    """
    (f, _), (g, _), (h, _) = arm(links, 0, block), arm(links, 1, block), arm(links, 2, block)
    a, b = cross(f, g), cross(h, g)
    g2, fg, hg, a2, b2 = dot(g, g), dot(f, g), dot(h, g), dot(a, a), dot(b, b)
    length = g2**0.5
    u, slope = evaluate_law(law, np.arctan2(dot(g, cross(b, a)) / length, dot(a, b)), numbers)
    a2, b2 = max(a2, STRAIGHT2 * g2 * dot(f, f)), max(b2, STRAIGHT2 * g2 * dot(h, h))
    on_i = push(links, 0, block, times(slope * length / a2, a))
    between = push(links, 1, block, combined(-slope * fg / (a2 * length), a, slope * hg / (b2 * length), b))
    return u, push(links, 2, block, times(-slope * length / b2, b)) or on_i or between


Bend, Torsion = link_shape("Bend", _bend), link_shape("Torsion", _turn)
