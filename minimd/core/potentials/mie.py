"""Mie potentials: wells like that of Lennard-Jones, with exponents of their own."""

from collections.abc import Mapping, Sequence
from typing import Any

from minimd.core.console.words import shown
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import LammpsStyle, declared
from minimd.core.potentials.laws import MieLaw
from minimd.core.potentials.pair import (
    A_RULE,
    CUTOFF,
    OTHERS,
    TRUNCATION,
    Cutoff,
    Label,
    MixingName,
    Nonbonded,
    PairPotential,
    Parameters,
    Rule,
)
from minimd.core.potentials.truncation import TruncationName
from minimd.core.structure.checks import checked_number

WELLS = "one number, or a mapping from species to (ε, σ, n, m) and no other"


class Mie(Nonbonded):
    """Mie potential u(r) = C ε [(σ/r)ⁿ − (σ/r)ᵐ], C = n/(n − m) (n/m)^(m/(n − m)), whose well is ε deep.

    n = 12, m = 6 is Lennard-Jones; n = 14, m = 7 is Halgren's, n = 50, m = 49 nearly that of hard spheres. The named
    mixing rules are for species with the same exponents; for others, mixing is a function of two tuples (ε, σ, n, m),
    or pairs has their numbers. LAMMPS' `pair_style mie/cut`.
    """

    lammps = LammpsStyle("mie/cut")
    epsilon: float | Mapping[Label, tuple[float, float, float, float]] = declared(
        kind.given, "depth of the well", "energy", of=WELLS
    )
    sigma: float | None = declared(
        kind.given, "where u = 0", "length", of="one number", default=None
    )
    n: float | None = declared(kind.given, "exponent of repulsion", of="one number", default=None)
    m: float | None = declared(
        kind.given, "exponent of attraction, below n", of="one number", default=None
    )
    cutoff: Cutoff | None = CUTOFF
    truncation: TruncationName = TRUNCATION
    mixing: MixingName | Rule | None = declared(
        kind.given, OTHERS, of=A_RULE, default="lorentz-berthelot", kw_only=True
    )

    def as_law(self) -> tuple[Any, Any, Any]:
        """See Nonbonded."""
        is_by_species = isinstance(self.epsilon, Mapping)
        others = self.sigma, self.n, self.m
        if others.count(None) != (len(others) if is_by_species else 0):
            raise ValueError(
                "give Mie either epsilon, sigma, n and m, or one mapping from species to (epsilon, sigma, n, m)"
            )
        return MieLaw(), self.epsilon if is_by_species else (self.epsilon, *others), self.pairs

    def mixed(self, first: Parameters, second: Parameters) -> Parameters:
        """See Nonbonded."""
        if not isinstance(self.mixing, str):
            return super().mixed(first, second)
        if first[2:] != second[2:]:
            raise ValueError(
                f"mixing {self.mixing!r} is for Mie potentials with the same n and m; these are {first[2:]} and "
                f"{second[2:]}: give pairs={{...}}, or a function"
            )
        return (*super().mixed(first, second), *first[2:])

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        if not isinstance(numbers, Sequence) or len(numbers) != 4:
            raise ValueError(
                f"Mie parameters are (epsilon, sigma, n, m); those of {of!r} are {shown(numbers)}"
            )
        whose = "" if of is None else f" of {of!r}"
        epsilon = checked_number(f"epsilon{whose}", numbers[0], "finite and not negative")
        sigma = checked_number(f"sigma{whose}", numbers[1], "positive and finite")
        n = checked_number(f"n{whose}", numbers[2], "positive and finite")
        m = checked_number(f"m{whose}", numbers[3], "positive and finite")
        if not n > m:
            raise ValueError(f"n{whose} must be larger than m; n = {n:g}, m = {m:g}")
        return epsilon, sigma, n, m


PairPotential.register(Mie)
