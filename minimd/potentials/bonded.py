"""Bonds: laws between fixed pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.potentials.law import checked_law
from minimd.potentials.laws import HarmonicLaw
from minimd.potentials.pair_loop import FixedPairs
from minimd.potentials.term import NoTerm, OwnPotential, Term, no_bonds
from minimd.structure.bond_graph import checked_pairs
from minimd.structure.checks import checked_numbers, shown
from minimd.structure.system import System


class BondPotential(OwnPotential):
    """A law u(r) along bonds, whatever their length.

    Parameters
    ----------
    law : function law(r2, *parameters) as for PairPotential.
    parameters : one entry for each parameter of the law: a number for all bonds, or an array with one number for each.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Each bond runs to the nearest image of its partner. Raises ValueError for parameters that are not finite numbers, or pairs that are none;
    TypeError for a law that is not a function, or parameters without their tuple.
    """

    def __init__(self, law: Callable | tuple, parameters: tuple[ArrayLike, ...] = (), pairs: ArrayLike | None = None) -> None:
        self.law = checked_law(law)
        self.pairs = None if pairs is None else checked_pairs("pairs", pairs)
        if not isinstance(parameters, Sequence):
            raise TypeError(f"parameters of bonds must be a tuple with one entry for each parameter of the law; parameters = {shown(parameters)}")
        self.parameters = tuple(checked_numbers("bond parameters", parameter, "one number, or one for each bond") for parameter in parameters)
        for parameter in self.parameters:
            if not np.isfinite(parameter).all():
                raise ValueError(f"bond parameters must be finite; they are {parameter.tolist()}")

    def law_arguments(self) -> dict[str, Any]:
        """The arguments that are those of the law, by name, to be shown."""
        return {"law": type(self.law).python, "parameters": self.parameters}

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return self.law_arguments() | {"pairs": self.pairs}

    def bind(self, system: System) -> Term:
        """The term of these bonds in a system.

        Raises
        ------
        ValueError : as table, or if pairs name missing atoms.
        """
        pairs = system.bonds if self.pairs is None else checked_pairs("pairs", self.pairs, len(system))
        table = self.table(len(pairs))
        if len(pairs):
            return FixedPairs(system, pairs, self.law, table)
        return NoTerm(no_bonds(repr(self)) if self.pairs is None else "")

    def table(self, n_bonds: int) -> NDArray[np.float64]:
        """Numbers of each bond: (B, 1 + P), the squared cutoff (infinite) first.

        Raises
        ------
        ValueError : if an array of parameters has another length than the list of bonds.
        """
        for parameter in self.parameters:
            if parameter.shape not in ((), (n_bonds,)):
                raise ValueError(f"a bond parameter must be one number or {n_bonds}, one for each bond; its shape is {parameter.shape}")
        return np.stack([np.broadcast_to(column, n_bonds) for column in (np.array(np.inf), *self.parameters)], axis=-1)


class HarmonicBond(BondPotential):
    """Harmonic bond u(r) = ½ k (r − r₀)².

    Parameters
    ----------
    k : stiffness [energy/length²], one number or one for each bond.
    length : r₀ [length], one number or one for each bond.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Raises
    ------
    ValueError : if k is negative, or a length is, or one of them is not finite.
    """

    def __init__(self, k: ArrayLike, length: ArrayLike, pairs: ArrayLike | None = None) -> None:
        super().__init__(HarmonicLaw(), (k, length), pairs)
        for name, values in zip(("k", "length"), self.parameters, strict=True):
            if np.any(values < 0.0):
                raise ValueError(f"{name} of a harmonic bond must not be negative; {name} = {values.tolist()}")

    def law_arguments(self) -> dict[str, Any]:
        """See BondPotential."""
        return dict(zip(("k", "length"), self.parameters, strict=True))
