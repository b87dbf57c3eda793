"""Coulomb's law of charged atoms, split for sums over periodic images, see prolates.py; a cheap law without the sum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY
from math import inf, log, pi, sqrt
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.core.compiled.kernels import scalar
from minimd.core.compiled.simd import fma, select
from minimd.core.compiled.simd.functions import polynomial
from minimd.core.console.words import shown
from minimd.core.potentials.declared import (
    POSITIVE,
    Declared,
    choice,
    declared,
    factors,
    number,
    pairs,
)
from minimd.core.potentials.law import evaluate_law, law_type
from minimd.core.potentials.prolates import LEAST_ACCURATE, MOST_ACCURATE, Numbers, Split, split_for
from minimd.core.potentials.term import OwnTerm, PairLaw
from minimd.core.structure.arrays import Array
from minimd.core.structure.bond_graph import checked_pairs
from minimd.core.structure.system import System

MethodName = Literal["ewald", "waves", "mesh", "reaction-field", "shifted-force"]
SlabName = Literal["none", "x", "y", "z"]
SUMS = {
    "ewald": "pairs and waves, by the quicker of two sums",
    "waves": "wave by wave",
    "mesh": "on a mesh",
}
METHODS = {**SUMS, "reaction-field": "pairs only", "shifted-force": "pairs only"}
LAYERS = 2.0  # of exp(−2π g/a), measured up to 1.2: the error of forces, in parts of their rms
NO_REST: Numbers = (0.0, (0.0, 0.0), (0.0, 0.0))  # of a split whose L is zero


@scalar
def coulomb(r2, split, parameters):
    """Coulomb's law without the smooth rest, for r < r_c.

        u(r)     = q (1/r − L(r))
        −u′(r)/r = q (1/r³ + L′(r)/r)

    split : numbers of a Split.
    parameters : (q, …), the product of two charges [energy · length].
    """
    scale, values, slopes = split
    t = scale * r2 - 1.0
    inverse2 = 1.0 / r2
    inverse = sqrt(inverse2)
    u = inverse - polynomial(t, values)
    return parameters[0] * u, parameters[0] * fma(inverse, inverse2, polynomial(t, slopes))


@scalar
def shifted_force(r2, cutoff, parameters):
    """Coulomb's law less its tangent at the cutoff: u = q (1/r − 2/r_c + r/r_c²).

    S. Toxvaerd, J. C. Dyre, J. Chem. Phys. 134, 081102 (2011).
    parameters : (q, …), as of coulomb.
    """
    inverse2 = 1.0 / r2
    inverse = sqrt(inverse2)
    u = inverse + (r2 * inverse - 2.0 * cutoff) / (cutoff * cutoff)
    return parameters[0] * u, parameters[0] * inverse * (inverse2 - 1.0 / (cutoff * cutoff))


@scalar
def charged(r2, law, charges, parameters):
    """A law with a cutoff of its own, and one of charges: one pass over the pairs for both.
    parameters : (q, squared cutoff of the law, *parameters of the law)."""
    u, f = evaluate_law(law, r2, parameters[2:])
    v, g = evaluate_law(charges, r2, parameters)
    is_near = r2 < parameters[1]
    return v + select(is_near, u, 0.0), g + select(is_near, f, 0.0)


@scalar
def special(r2, split, parameters):
    """Coulomb's law times a factor s, for a pair whose L the sum over waves holds: u = q (s/r − L(r)), at any distance.
    parameters : (q, s, r_c²)."""
    scale, values, slopes = split
    q, s, cutoff2 = parameters
    t = scale * r2 - 1.0
    inverse2 = 1.0 / r2
    inverse = sqrt(inverse2)
    inverse3 = inverse * inverse2
    is_near = r2 < cutoff2
    rest = select(is_near, polynomial(t, values), inverse)
    slope = select(is_near, polynomial(t, slopes), -inverse3)
    return q * (s * inverse - rest), q * (s * inverse3 + slope)


CoulombLaw = law_type("CoulombLaw", coulomb)
SpecialLaw = law_type("SpecialLaw", special)
ShiftedForceLaw = law_type("ShiftedForceLaw", shifted_force)
ChargedLaw = law_type("ChargedLaw", charged)


class Coulomb(Declared):
    """Coulomb energies U = k_e Σ qᵢ qⱼ / r of the charges of a System, with all periodic images.

    In a cell that is periodic in all directions 1/r is split: pairs within the cutoff, and a sum over waves for the
    smooth rest (Ewald's sum with prolate spheroidal wave functions instead of Gaussians: see prolates.py), with a
    conductor around all images (tin-foil boundaries). In a crystal forces cancel, but their errors do not: there the
    accuracy refers to k_e |qᵢ qⱼ|/d², the force between neighbors at the distance d.
    Without periodic directions all pairs count, whatever the cutoff. A net charge is balanced by a uniform background.
    Methods "waves" and "mesh" name the sum over waves, of which "ewald" takes the quicker one. Of pairs only, and of
    unknown error: "reaction-field", as in a uniform medium beyond the cutoff, u = q (1/r + k r² − c),
    k = (ε − 1)/((2ε + 1) r_c³), c = 3ε/((2ε + 1) r_c); "shifted-force", u = q (1/r − 2/r_c + r/r_c²).
    slab="z" is for one layer of charges along the first two lattice vectors, with empty space along the third: its
    images, which would act on it, are taken away, also with a net charge, then without background (see slab_term.py).
    In a cell that is open in one direction the slab is the one across it, and has empty space of its own.
    Refused at the start: a system without charges, or periodic in one direction only.
    """

    cutoff: float | None = declared(
        number,
        "r_c of the pairs; a small r_c needs many waves; required if periodic",
        "length",
        POSITIVE,
        default=None,
    )
    accuracy: float = declared(
        number,
        "bound of the rms error of forces, in parts of their rms or, if larger, of the force between neighbors",
        demand=POSITIVE,
        default=1e-5,
    )
    _: KW_ONLY
    method: MethodName = declared(
        choice,
        "how charges are summed; the last two are approximations",
        of=METHODS,
        default="ewald",
    )
    dielectric: float = declared(
        number, "ε of the reaction field, 1 or more; default: infinite, a conductor", default=inf
    )
    slab: SlabName = declared(
        choice,
        "the lattice vector out of a slab, which lies in empty space; an open direction is one, also if not named",
        of=get_args(SlabName),
        default="none",
    )
    bonded_scale: Sequence[float] = declared(
        factors, "factors for pairs one, two and three bonds apart", default=(0.0, 0.0, 1.0)
    )
    exclusions: ArrayLike | None = declared(
        pairs, "pairs that do not interact, whatever bonded_scale says", default=None
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not MOST_ACCURATE <= self.accuracy <= LEAST_ACCURATE:
            raise ValueError(
                f"accuracy must be between {MOST_ACCURATE:g} and {LEAST_ACCURATE:g} "
                f"(rounding prevents smaller errors); accuracy = {shown(self.accuracy)}"
            )
        if self.dielectric < 1.0:
            raise ValueError(
                "dielectric must be 1 (vacuum) or more, inf for a conductor; "
                f"dielectric = {self.dielectric}"
            )

    def bind(self, system: System) -> CoulombTerm:
        """The term of this potential in a system.
        Raises ValueError as the class."""
        if not system.charges.any():
            raise ValueError(
                "Coulomb needs charges; those of the system are all zero: give them as System(..., charges=q), "
                "atoms.set_initial_charges(q) of ASE, or in a scene file structure.charges"
            )
        pbc = system.cell.pbc
        slab: str = self.slab
        is_sum = self.method in SUMS
        if is_sum and pbc.any() and system.dimensions == 2:
            raise ValueError(
                "Coulomb sums no charges over the images of a plane: take method='shifted-force' or 'reaction-field'"
            )
        if slab == "none" and is_sum and pbc.sum() == 2:
            slab = "xyz"[pbc.argmin()]
        if slab == "none":
            is_possible = not is_sum or pbc.all() or not pbc.any()
        else:
            is_possible = is_sum and np.delete(pbc, "xyz".index(slab)).all()
        if not is_possible:
            raise ValueError(
                f"Coulomb cannot sum charges where pbc = {pbc}, method = {self.method!r}, slab = {self.slab!r}: a slab "
                'is periodic along the two other lattice vectors, such as slab="z" with pbc=(True, True, False); for '
                'anything else take method="shifted-force"'
            )
        if self.cutoff is None and (pbc.any() or not is_sum):
            where = "in a periodic cell" if is_sum else f"with method {self.method!r}"
            raise ValueError(f"cutoff of Coulomb must be given {where}; it is None")
        return CoulombTerm(self, system, slab)


class CoulombTerm(OwnTerm):
    """Charges in a system: a law for the planner to run on a list of neighbors, and perhaps with a sum over waves."""

    pair_law: PairLaw

    def __init__(self, potential: Coulomb, system: System, slab: str) -> None:
        cutoff = potential.cutoff or inf
        split: Split | None = None
        if potential.method == "shifted-force":
            law = ShiftedForceLaw(cutoff)
        elif potential.method == "reaction-field":
            law = CoulombLaw(_reaction_field(cutoff, potential.dielectric))
        elif system.cell.is_periodic:
            split = split_for(cutoff, potential.accuracy)
            law = CoulombLaw(split.numbers)
            net_charge = system.net_charge
            if slab != "none":
                self.warning = _narrow(system, potential)
            elif net_charge != 0.0:
                self.warning = f"the net charge of the cell is {net_charge:.6g} e: a uniform background balances it"
        else:
            cutoff = inf
            law = CoulombLaw(NO_REST)

        self.cutoff = cutoff
        self.shortest_length = cutoff
        self.pair_law = PairLaw(
            type(potential).__name__,
            law,
            np.full((1, 1, 1), cutoff**2),
            cutoff,
            tuple(potential.bonded_scale),
            system.charges * sqrt(system.units.coulomb),
            split,
            potential.method,
            slab,
            checked_pairs("exclusions", potential.exclusions, len(system)),
        )


def spaces(system: System) -> tuple[NDArray, NDArray, NDArray]:
    """Along each lattice vector, in its parts: the inverse of the vectors, (3, 3); where atoms are, sorted, and the
    space above each of them, (N, 3) both."""
    inverse = np.linalg.inv(system.cell.vectors)
    fractions = np.sort(system.positions @ inverse % 1.0, axis=0)
    return inverse, fractions, np.diff(fractions, axis=0, append=fractions[:1] + 1.0)


def empty_space(vectors: Array, axis: int, accuracy: float) -> float:
    """How wide the empty space beside a slab must be, see slab_term.py [length].
    vectors : (3, 3), the one with the number axis is out of the slab."""
    longest = np.linalg.norm(np.delete(vectors, axis, axis=0), axis=1).max()
    return float(longest) / (2.0 * pi) * log(LAYERS / accuracy)


def _narrow(system: System, potential: Coulomb) -> str:
    """The warning that images of a slab act on it by more than the accuracy."""
    if not system.cell.pbc.all():
        return ""
    inverse, _, gaps = spaces(system)
    axis = "xyz".index(potential.slab)
    empty = gaps[:, axis].max() / np.linalg.norm(inverse[:, axis])
    needed = empty_space(system.cell.vectors, axis, potential.accuracy)
    if empty >= needed:
        return ""
    return (
        f"the empty space beside a slab must be {needed:.3g} {system.units.length} wide for an accuracy of "
        f"{potential.accuracy:g}; it is {empty:.3g}: make the cell higher along {potential.slab}"
    )


def _reaction_field(cutoff: float, dielectric: float) -> Numbers:
    """The numbers of the law coulomb with which L(r) = c − k r², see Coulomb."""
    part = 1.0 / (2.0 + 1.0 / dielectric)
    k = (1.0 - 1.0 / dielectric) * part / cutoff
    c = 3.0 * part / cutoff
    return 2.0 / cutoff**2, (c - 0.5 * k, -0.5 * k), (-2.0 * k / cutoff**2, 0.0)


def with_charges(law: PairLaw, charges: PairLaw) -> PairLaw:
    """A law, and that of charges, which reaches as far or farther, as one law."""
    cutoff2 = np.full((*law.table.shape[:2], 1), charges.cutoff**2)
    table = np.concatenate([cutoff2, law.table], axis=-1)
    name = f"{law.name}, {charges.name}"
    return charges._replace(name=name, law=ChargedLaw(law.law, charges.law), table=table)
