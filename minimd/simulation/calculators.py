"""Calculators of ASE where potentials are expected."""

from collections.abc import Sequence
from typing import Any

from minimd.potentials.term import Potential

__all__ = ["interpret_calculator"]


def interpret_calculator(candidate: Any) -> Sequence[Potential] | None:
    """The potentials of a calculator of ASE; None for anything else.

    ASE is imported only if the object may be a calculator.
    """
    if not hasattr(candidate, "get_potential_energy"):
        return None
    from minimd.ase.foreign import potentials_of_calculator

    return potentials_of_calculator(candidate)
