"""The soft repulsion that pushes overlapping atoms apart."""

from collections.abc import Mapping
from typing import Any

from minimd.core.console.words import listed
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import LammpsStyle, declared
from minimd.core.potentials.laws import SoftRepulsionLaw
from minimd.core.potentials.pair import (
    FOR_PAIRS,
    Cutoff,
    Label,
    Nonbonded,
    PairPotential,
    Parameters,
)
from minimd.core.potentials.truncation import TRUNCATIONS, TruncationName
from minimd.core.structure.checks import checked_number


class SoftRepulsion(Nonbonded):
    """Soft repulsion u(r) = A [1 + cos(πr/r_c)], which lets atoms pass through each other and pushes them apart.

    It is 2A high at r = 0, where it has no force, and goes to zero at r_c with its force. LAMMPS' `pair_style soft`.
    """

    lammps = LammpsStyle("soft", lambda height, _reach: (height,))
    height: float | Mapping[tuple[Label, Label], float] = declared(
        kind.given, "A, half of u at r = 0", "energy", of=FOR_PAIRS
    )
    cutoff: Cutoff = declared(
        kind.given, "r_c, where energy and force vanish", "length", of=FOR_PAIRS
    )
    truncation: TruncationName = declared(
        kind.choice, of=TRUNCATIONS, init=False, default="truncated"
    )
    mixing: None = declared(kind.given, init=False, default=None)
    pairs: None = declared(kind.given, init=False, default=None)
    switch_start: None = declared(kind.number, init=False, default=None)
    tail_correction: bool = declared(kind.flag, init=False, default=False)

    def as_law(self) -> tuple[Any, Any, Any]:
        """See Nonbonded."""
        if self.cutoff is None:
            raise ValueError("cutoff must be given: the soft repulsion ends there; it is None")
        if not isinstance(self.height, Mapping):
            return SoftRepulsionLaw(), self.height, {}
        return SoftRepulsionLaw(), {}, self.height

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        whose = "" if of is None else f" of {of!r}"
        return (checked_number(f"height{whose}", numbers, "finite and not negative"),)

    def _numbers_of_laws(self, parameters: Parameters, cutoff: float) -> Parameters:
        return (*parameters, cutoff)

    def _parameters_of(self, a: Any, b: Any) -> Parameters:
        if isinstance(self.height, Mapping) and (a, b) not in self._by_pair:
            raise ValueError(
                f"SoftRepulsion has no height for the pair {a!r}, {b!r}; it has {listed(self.height)}"
            )
        return super()._parameters_of(a, b)


PairPotential.register(SoftRepulsion)
