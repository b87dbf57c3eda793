"""Energy, forces and virial of a system as it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.quiet import warn
from minimd.core.diagnosis.contacts import OPEN_IT, thin_cell, why_not_finite
from minimd.core.forces.forces import Forces, Potential
from minimd.core.forces.options import Options
from minimd.core.potentials.term import PER_ATOM
from minimd.core.structure.arrays import Array
from minimd.core.structure.errors import NonFiniteError
from minimd.core.structure.observables import longest
from minimd.core.structure.system import System

if TYPE_CHECKING:
    import ase


@dataclass(frozen=True, repr=False)
class Evaluation(Displayed):
    """potential_energy : U [energy].
    forces : (N, 3) [energy/length].
    virial : (3, 3) W = Σ f r_ij ⊗ r_ij [energy].

    energies : (N,) each atom's share of U [energy].
    virials : (N, 6) each atom's share of W, as xx yy zz yz xz xy [energy]. Their sum is W to rounding.

    Atoms have equal shares of energy and virial of their pair, bond, angle or dihedral, and of tail corrections. An
    embedded atom has its own F(ρ), and a charge its own energy in the field of Ewald's waves.
    """

    potential_energy: float
    forces: Array
    virial: Array
    energies: Array
    virials: Array

    def __repr__(self) -> str:
        return f"Evaluation(potential_energy={self.potential_energy:.10g}, forces of {len(self.forces)} atoms)"

    def display_rows(self) -> Rows:
        """See Displayed."""
        atom, force = longest(self.forces)
        virial = [" ".join(f"{x:>14.6g}" for x in row) for row in self.virial]
        energies = (
            f"of single atoms: least {self.energies.min():.6g}, largest {self.energies.max():.6g}"
        )
        energy = f"{self.potential_energy:.10g}"
        largest = f"{force:.4g}, on atom {atom}"
        rows = [("energy", energy), ("", energies), ("largest force", largest)]
        return [*rows, *zip(("virial", "", ""), virial, strict=True)]


def evaluate(system: System | ase.Atoms, potentials: Potential | Sequence[Potential]) -> Evaluation:
    """Potential energy, forces and virial of a System, or of ase.Atoms, as they stand, also the shares of single atoms.

    A warning says if the cell is so thin that atoms are pushed by their own images.

    Raises
    ------
    NonFiniteError : if a force or an energy is not finite, as for two atoms at one place; it names them and the law.
    ValueError, TypeError : as Forces.
    """
    system = system if isinstance(system, System) else System.from_ase(system)
    forces = Forces(system, potentials, Options(skin=0.0))
    if isinstance(potentials, Sequence):  # a single one is a part of the energy
        forces.warn_of_potentials()
    sums = forces.compute(PER_ATOM)
    cause = thin_cell(system, forces.potentials)
    if cause:
        warn(f"{cause}; {OPEN_IT}")
    result = Evaluation(
        sums.potential_energy, sums.forces, sums.virial, sums.energies, sums.virials
    )
    if not (np.isfinite(result.forces).all() and np.isfinite(result.energies).all()):
        raise NonFiniteError(
            f"forces or energies are not finite: {why_not_finite(system, forces.potentials)}"
        )

    return result
