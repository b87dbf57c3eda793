"""Bonds: laws between fixed pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.console.words import shown
from minimd.potentials.law import checked_law
from minimd.potentials.laws import FENELaw, HarmonicLaw, MorseLaw
from minimd.potentials.links import FixedPairs
from minimd.potentials.term import NoTerm, OwnPotential, Term, no_bonds
from minimd.structure.bond_graph import checked_pairs
from minimd.structure.checks import checked_numbers
from minimd.structure.system import System


class BondPotential(OwnPotential):
    """A law u(r) along bonds, whatever their length.

    Parameters
    ----------
    law : function law(r2, *parameters) as for PairPotential.
    parameters : one entry for each parameter of the law: a number for all bonds, or an array with one number for each.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Each bond runs to the nearest image of its partner. Raises ValueError for parameters that are not finite numbers, or
    invalid pairs; TypeError for a law that is not a function, or parameters that are not a tuple.
    """

    def __init__(
        self, law: Callable | tuple, parameters: tuple[ArrayLike, ...] = (), pairs: ArrayLike | None = None
    ) -> None:
        self.law = checked_law(law)
        self.pairs = None if pairs is None else checked_pairs("pairs", pairs)
        if not isinstance(parameters, Sequence):
            wanted = "a tuple with one entry for each parameter of the law"
            raise TypeError(f"parameters of bonds must be {wanted}; parameters = {shown(parameters)}")
        wanted = "one number, or one for each bond"
        self.parameters = tuple(checked_numbers("bond parameters", one, wanted) for one in parameters)
        for parameter in self.parameters:
            if not np.isfinite(parameter).all():
                raise ValueError(f"bond parameters must be finite; they are {parameter.tolist()}")

    def law_arguments(self) -> dict[str, Any]:
        """The arguments that belong to the law, by name, for display."""
        return {"law": type(self.law).python, "parameters": self.parameters}

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return self.law_arguments() | {"pairs": self.pairs}

    def bind(self, system: System) -> Term:
        """The term of these bonds in a system.

        Raises
        ------
        ValueError : as table and pairs_in.
        """
        pairs = self.pairs_in(system)
        table = self.table(len(pairs))
        if len(pairs):
            return FixedPairs(pairs, self.law, table)
        return NoTerm(no_bonds(repr(self)) if self.pairs is None else "")

    def pairs_in(self, system: System) -> NDArray[np.int64]:
        """(B, 2), the pairs on which it acts.  Raises ValueError for atoms that do not exist."""
        return system.bonds if self.pairs is None else checked_pairs("pairs", self.pairs, len(system))

    def table(self, n_bonds: int) -> NDArray[np.float64]:
        """Numbers of each bond: (B, 1 + P), the squared cutoff (infinite) first.

        Raises
        ------
        ValueError : if an array of parameters has another length than the list of bonds.
        """
        for parameter in self.parameters:
            if parameter.shape not in ((), (n_bonds,)):
                wanted = f"one number or {n_bonds}, one for each bond"
                raise ValueError(f"a bond parameter must be {wanted}; its shape is {parameter.shape}")
        return np.stack([np.broadcast_to(column, n_bonds) for column in (np.array(np.inf), *self.parameters)], axis=-1)


class OwnBond(BondPotential):
    """Base class of bonds with one of minimd's laws.  names : of its parameters."""

    names: ClassVar[tuple[str, ...]]

    def law_arguments(self) -> dict[str, Any]:
        """See BondPotential."""
        return dict(zip(self.names, self.parameters, strict=True))

    def _check(self, what: str, negative: tuple[str, ...] = (), not_positive: tuple[str, ...] = ()) -> None:
        """Raise ValueError if a parameter is negative, or not positive.  negative, not_positive : those to test."""
        for name, values in self.law_arguments().items():
            if name in negative and np.any(values < 0.0):
                raise ValueError(f"{name} of {what} must not be negative; {name} = {values.tolist()}")
            if name in not_positive and np.any(values <= 0.0):
                raise ValueError(f"{name} of {what} must be positive; {name} = {values.tolist()}")


class HarmonicBond(OwnBond):
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

    names = ("k", "length")

    def __init__(self, k: ArrayLike, length: ArrayLike, pairs: ArrayLike | None = None) -> None:
        super().__init__(HarmonicLaw(), (k, length), pairs)
        self._check("a harmonic bond", negative=("k", "length"))


class MorseBond(OwnBond):
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

    names = ("depth", "a", "length")

    def __init__(self, depth: ArrayLike, a: ArrayLike, length: ArrayLike, pairs: ArrayLike | None = None) -> None:
        super().__init__(MorseLaw(), (depth, a, length), pairs)
        self._check("a Morse bond", negative=("depth", "length"), not_positive=("a",))


class FENEBond(OwnBond):
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

    names = ("k", "longest", "epsilon", "sigma")

    def __init__(
        self,
        k: ArrayLike,
        longest: ArrayLike,
        epsilon: ArrayLike = 1.0,
        sigma: ArrayLike = 1.0,
        pairs: ArrayLike | None = None,
    ) -> None:
        super().__init__(FENELaw(), (k, longest, epsilon, sigma), pairs)
        self._check("a FENE bond", negative=("k", "epsilon"), not_positive=("longest", "sigma"))
