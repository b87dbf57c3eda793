"""Calculators of ASE where potentials are expected."""

from collections.abc import Sequence
from typing import Any

from minimd.potentials.term import Potential

__all__ = ["interpret_calculator"]


def interpret_calculator(candidate: Any) -> Sequence[Potential] | None:
    """The potentials that stand for a calculator of ASE; None for anything else. Only for something like a calculator is ase loaded."""
    if not hasattr(candidate, "get_potential_energy"):
        return None
    from minimd.ase.foreign import potentials_of_calculator

    return potentials_of_calculator(candidate)
