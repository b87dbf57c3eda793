"""Coulomb's law of charged atoms, split for sums over periodic images, see prolates.py; a cheap law without the sum."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from math import inf, sqrt
from typing import Any, Literal

import numpy as np
from numba.extending import overload
from numpy.typing import ArrayLike

from minimd.compiled.kernels import scalar, type_of
from minimd.compiled.simd import fma, select
from minimd.console.words import shown
from minimd.potentials.law import evaluate_law
from minimd.potentials.prolates import LEAST_ACCURATE, MOST_ACCURATE, Numbers, Split, split_for
from minimd.potentials.term import OwnPotential, OwnTerm, PairLaw, checked_factors
from minimd.structure.bond_graph import checked_pairs
from minimd.structure.checks import checked_choice, checked_number
from minimd.structure.system import System

MethodName = Literal["ewald", "reaction-field"]
METHODS = ("ewald", "reaction-field")
NO_REST: Numbers = (0.0, (0.0, 0.0), (0.0, 0.0))  # of a split whose L is zero
NEUTRAL = 1e-9  # net charge, relative to the sum of all sizes: below it is rounding


def polynomial(t, c):
    """Σ c[k] tᵏ of a number or a vector; unrolled by the compiler."""
    total = 0.0
    for one in c[::-1]:
        total = total * t + one
    return total


@overload(polynomial)
def _polynomial(t, c):
    if len(c) == 2:
        return lambda t, c: fma(t, c[1], c[0])
    if len(c) > 5:  # four at once: the compiler, which calls itself, must not go too deep
        return lambda t, c: fma(t, fma(t, fma(t, fma(t, polynomial(t, c[4:]), c[3]), c[2]), c[1]), c[0])
    return lambda t, c: fma(t, polynomial(t, c[1:]), c[0])


@scalar
def coulomb(r2, split, parameters):
    """Coulomb's law without the smooth rest, for r < r_c.

        u(r)     = q (1/r − L(r))
        −u′(r)/r = q (1/r³ + L′(r)/r)

    split : numbers of a Split.  parameters : (q, …), the product of two charges [energy · length].
    """
    scale, values, slopes = split
    t, inverse2 = scale * r2 - 1.0, 1.0 / r2
    inverse = sqrt(inverse2)
    u = inverse - polynomial(t, values)
    return parameters[0] * u, parameters[0] * fma(inverse, inverse2, polynomial(t, slopes))


@scalar
def charged(r2, law, split, parameters):
    """A law with a cutoff of its own, and that of coulomb: one pass over the pairs for both.
    parameters : (q, squared cutoff of the law, *parameters of the law)."""
    u, f = evaluate_law(law, r2, parameters[2:])
    v, g = coulomb(r2, split, parameters)
    is_near = r2 < parameters[1]
    return v + select(is_near, u, 0.0), g + select(is_near, f, 0.0)


@scalar
def special(r2, split, parameters):
    """Coulomb's law times a factor s, for a pair whose L the sum over waves holds: u = q (s/r − L(r)), at any distance.
    parameters : (q, s, r_c²)."""
    scale, values, slopes = split
    q, s, cutoff2 = parameters
    t, inverse2 = scale * r2 - 1.0, 1.0 / r2
    inverse, is_near = sqrt(inverse2), r2 < cutoff2
    inverse3 = inverse * inverse2
    rest = select(is_near, polynomial(t, values), inverse)
    return q * (s * inverse - rest), q * (s * inverse3 + select(is_near, polynomial(t, slopes), -inverse3))


CoulombLaw, SpecialLaw = (
    type_of(formula)(namedtuple(name, "split", module=__name__))
    for name, formula in (("CoulombLaw", coulomb), ("SpecialLaw", special))
)
ChargedLaw = type_of(charged)(namedtuple("ChargedLaw", "law split"))


class Coulomb(OwnPotential):
    """Coulomb energies U = k_e Σ qᵢ qⱼ / r of the charges of a System, with all periodic images.

    In a cell that is periodic in all directions 1/r is split: pairs within the cutoff, and a sum over waves for the
    smooth rest (Ewald's sum with prolate spheroidal wave functions instead of Gaussians: minimd.potentials.prolates).
    Without periodic directions all pairs count, whatever the cutoff. A net charge is balanced by a uniform background.

    Parameters
    ----------
    cutoff : r_c [length], of the pairs; a smaller one gives more waves. None only without periodic directions.
    accuracy : bound of the rms error of forces, divided by the rms force.
    method : "ewald"; or "reaction-field", pairs only, as in a uniform medium beyond the cutoff, an approximation of
        unknown error: u = q (1/r + k r² − c), k = (ε − 1)/((2ε + 1) r_c³), c = 3ε/((2ε + 1) r_c).
    dielectric : ε of the reaction field, 1 or more; infinite for a medium that conducts.
    bonded_scale, exclusions : as for PairPotential.

    Raises
    ------
    ValueError : for a cutoff that is not positive, an accuracy that is not between 1e-13 and 0.05, an unknown method,
        a dielectric constant below 1; at the start for a system without charges, or periodic in some directions only.
    """

    def __init__(
        self,
        cutoff: float | None = None,
        accuracy: float = 1e-5,
        *,
        method: MethodName = "ewald",
        dielectric: float = inf,
        bonded_scale: Sequence[float] = (0.0, 0.0, 1.0),
        exclusions: ArrayLike | None = None,
    ) -> None:
        self.cutoff = inf if cutoff is None else checked_number("cutoff", cutoff, "positive and finite")
        self.accuracy = checked_number("accuracy", accuracy, "positive and finite")
        if not MOST_ACCURATE <= self.accuracy <= LEAST_ACCURATE:
            limits = f"between {MOST_ACCURATE:g}, which rounding allows, and {LEAST_ACCURATE:g}"
            raise ValueError(f"accuracy must be {limits}; accuracy = {shown(accuracy)}")
        self.method = checked_choice("method", method, METHODS)
        self.dielectric = inf if dielectric == inf else checked_number("dielectric", dielectric)
        if self.dielectric < 1.0:
            raise ValueError(f"dielectric must be 1 (vacuum) or more, inf for a conductor; dielectric = {dielectric}")
        self.bonded_scale, self.exclusions = checked_factors(bonded_scale), checked_pairs("exclusions", exclusions)

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        cutoff = None if self.cutoff == inf else self.cutoff
        told = {"cutoff": cutoff, "accuracy": self.accuracy, "method": self.method, "dielectric": self.dielectric}
        left_out = self.exclusions if len(self.exclusions) else None
        return told | {"bonded_scale": self.bonded_scale, "exclusions": left_out}

    def bind(self, system: System) -> CoulombTerm:
        """The term of this potential in a system.  Raises ValueError as the class."""
        if not system.charges.any():
            hint = "System(..., charges=q), or atoms.set_initial_charges(q) of ASE"
            raise ValueError(f"Coulomb needs charges; those of the system are all zero: give them as {hint}")
        pbc, is_sum = system.cell.pbc, self.method == "ewald"
        if is_sum and pbc.any() and not pbc.all():
            hint = 'make all of it periodic, with empty space around, or take method="reaction-field"'
            raise ValueError(f"Coulomb needs a cell that is periodic in all directions or in none; pbc = {pbc}: {hint}")
        if self.cutoff == inf and (pbc.any() or not is_sum):
            raise ValueError(
                "cutoff of Coulomb must be given in a periodic cell and for the reaction field; it is None"
            )
        return CoulombTerm(self, system, split_for(self.cutoff, self.accuracy) if is_sum and pbc.all() else None)


class CoulombTerm(OwnTerm):
    """Charges in a system: a law for the planner to run on a list of neighbors, and perhaps with a sum over waves."""

    def __init__(self, potential: Coulomb, system: System, split: Split | None) -> None:
        self.cutoff = self.shortest_length = inf if split is None and potential.method == "ewald" else potential.cutoff
        numbers = NO_REST if split is None else split.numbers
        if potential.method == "reaction-field":
            part = 1.0 / (2.0 + 1.0 / potential.dielectric)
            k, c = (1.0 - 1.0 / potential.dielectric) * part / self.cutoff, 3.0 * part / self.cutoff
            numbers = (2.0 / self.cutoff**2, (c - 0.5 * k, -0.5 * k), (-2.0 * k / self.cutoff**2, 0.0))
        charges = system.charges * sqrt(system.units.coulomb)
        total, size = float(system.charges.sum()), float(np.abs(system.charges).sum())
        if split is not None and abs(total) > NEUTRAL * size:
            self.warning = f"the net charge of the cell is {total:.6g} e: a uniform background balances it"
        name, table = type(potential).__name__, np.full((1, 1, 1), self.cutoff**2)
        law, left_out = CoulombLaw(numbers), checked_pairs("exclusions", potential.exclusions, len(system))
        self.pair_law = PairLaw(name, law, table, self.cutoff, potential.bonded_scale, charges, split, left_out)


def with_charges(law: PairLaw, charges: PairLaw) -> PairLaw:
    """A law, and that of charges, which reaches as far or farther, as one law."""
    table = np.concatenate([np.full((*law.table.shape[:2], 1), charges.cutoff**2), law.table], axis=-1)
    name = f"{law.name}, {charges.name}"
    return charges._replace(name=name, law=ChargedLaw(law.law, charges.law[0]), table=table)
