"""Dihedrals and impropers: a law of the angle between the planes through atoms i, j, k and through atoms j, k, l."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.kernels import scalar
from minimd.console.words import shown
from minimd.potentials.each import Array, checked_each, columns_of
from minimd.potentials.lanewise import on_vectors
from minimd.potentials.law import checked_law, evaluate_law
from minimd.potentials.links import LinkedTerm, arm, link_shape, push
from minimd.potentials.term import NoTerm, OwnPotential, Term, no_bonds
from minimd.potentials.torsion_laws import HarmonicTorsionLaw, PeriodicLaw, RyckaertBellemansLaw
from minimd.structure.bond_graph import checked_groups
from minimd.structure.system import System
from minimd.structure.vectors import combined, cross, dot, times

# the smallest sin² of the angle between two neighboring bonds by which forces are divided: its rounding error
STRAIGHT2 = 1e-16
N_COEFFICIENTS = 6  # of the polynomial of Ryckaert and Bellemans


class DihedralPotential(OwnPotential):
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

    groups: ClassVar[str] = "dihedrals"  # of a System, on which it acts

    def __init__(
        self, law: Callable | tuple, parameters: Sequence[ArrayLike] = (), quadruples: ArrayLike | None = None
    ) -> None:
        if not isinstance(parameters, Sequence) or isinstance(parameters, str):
            wanted = "a tuple with one entry for each parameter of the law"
            raise TypeError(f"parameters must be {wanted}; parameters = {shown(parameters)}")
        self._hold(checked_law(law), {f"parameter {k}": values for k, values in enumerate(parameters)}, quadruples)

    def _hold(
        self, law: tuple, parameters: dict[str, Any], quadruples: ArrayLike | None, not_negative: tuple[str, ...] = ()
    ) -> None:
        self.law, self.parameters = law, checked_each(self.groups, parameters, not_negative)
        self.quadruples = None if quadruples is None else checked_groups("quadruples", quadruples, 4)

    def law_arguments(self) -> dict[str, Any]:
        """The arguments that belong to the law, by name, for display."""
        law: Any = type(self.law)
        return {"law": law.python, "parameters": tuple(self.parameters.values())}

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return self.law_arguments() | {"quadruples": self.quadruples}

    def quadruples_in(self, system: System) -> NDArray[np.int64]:
        """(D, 4) int, those on which it acts in a system.  Raises ValueError if they name atoms that do not exist."""
        if self.quadruples is None:
            own: NDArray[np.int64] = getattr(system, self.groups)
            return own
        return checked_groups("quadruples", self.quadruples, 4, len(system))

    def columns(self, n: int) -> tuple[Array, ...]:
        """The parameters of each of n dihedrals, (n,) each.  Raises ValueError for an array of another length."""
        return columns_of(self.groups, self.parameters, n)

    def bind(self, system: System) -> Term:
        """The term of these dihedrals in a system.

        Raises
        ------
        ValueError : if a quadruple names a missing atom, or an array of parameters has another length than their list.
        """
        quadruples = self.quadruples_in(system)
        columns = self.columns(len(quadruples))
        if len(quadruples):
            i, j, k, l = quadruples.T
            return LinkedTerm(
                ([j, k, k], [i, j, l]), quadruples, Torsion(), on_vectors(self.law, len(columns)), columns
            )
        return NoTerm(no_bonds(repr(self), self.groups) if self.quadruples is None else "")


class PeriodicDihedral(DihedralPotential):
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

    def __init__(self, k: ArrayLike, n: ArrayLike, phase: ArrayLike = 0.0, quadruples: ArrayLike | None = None) -> None:
        self._hold(PeriodicLaw(), {"k": k, "n": n, "phase": phase}, quadruples, not_negative=("n",))
        if (np.rint(self.parameters["n"]) != self.parameters["n"]).any():
            given = shown(self.parameters["n"].tolist())
            raise ValueError(f"n, the number of minima in a turn, must be a whole number; n = {given}")

    def law_arguments(self) -> dict[str, Any]:
        """See DihedralPotential."""
        return dict(self.parameters)


class RyckaertBellemans(DihedralPotential):
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

    def __init__(self, coefficients: Sequence[ArrayLike], quadruples: ArrayLike | None = None) -> None:
        try:
            given = list(coefficients)
        except TypeError:
            told = f"coefficients = {shown(coefficients)}"
            raise TypeError(f"coefficients must be a list, c0 to c5 at most; {told}") from None
        if len(given) > N_COEFFICIENTS:
            raise ValueError(f"coefficients must be at most {N_COEFFICIENTS}, c0 to c5; there are {len(given)}")
        numbers = {f"c{k}": given[k] if k < len(given) else 0.0 for k in range(N_COEFFICIENTS)}
        self._hold(RyckaertBellemansLaw(), numbers, quadruples)

    def law_arguments(self) -> dict[str, Any]:
        """See DihedralPotential."""
        return {"coefficients": tuple(self.parameters.values())}


class OPLSDihedral(DihedralPotential):
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

    def __init__(
        self, k1: ArrayLike, k2: ArrayLike, k3: ArrayLike, k4: ArrayLike = 0.0, quadruples: ArrayLike | None = None
    ) -> None:
        self.barriers = checked_each(self.groups, {"k1": k1, "k2": k2, "k3": k3, "k4": k4})
        one, two, three, four = self.barriers.values()
        shapes = [each.shape for each in self.barriers.values()]
        if len({*shapes} - {()}) > 1:
            raise ValueError(f"k1 to k4 must have the same length; their shapes are {shapes}")
        c = (two + 0.5 * (one + three), 0.5 * (3.0 * three - one), 4.0 * four - two, -2.0 * three, -4.0 * four, 0.0)
        self._hold(RyckaertBellemansLaw(), {f"c{k}": each for k, each in enumerate(c)}, quadruples)

    def law_arguments(self) -> dict[str, Any]:
        """See DihedralPotential."""
        return dict(self.barriers)


class HarmonicImproper(DihedralPotential):
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

    groups = "impropers"

    def __init__(self, k: ArrayLike, angle: ArrayLike = 0.0, quadruples: ArrayLike | None = None) -> None:
        self._hold(HarmonicTorsionLaw(), {"k": k, "angle": angle}, quadruples, not_negative=("k",))
        if (np.abs(self.parameters["angle"]) > pi).any():
            given = shown(self.parameters["angle"].tolist())
            raise ValueError(f"angle must lie between -pi and pi (radians); angle = {given}")

    def law_arguments(self) -> dict[str, Any]:
        """See DihedralPotential."""
        return dict(self.parameters)


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


Torsion = link_shape("Torsion", _turn)
