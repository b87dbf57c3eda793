"""Forces on the atoms of ASE that a method of minimd moves, from their own calculator."""

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from minimd.potentials.term import CalculatorTerm
from minimd.structure.ase_atoms import fixes_center
from minimd.structure.system import System


class ForcesOnAtoms:
    """A potential for one ase.Atoms: forces and energy from its calculator,
    which is called with these atoms and all their arrays.

    Their positions follow those of the system. The virial is NaN, because the stress is not needed here.
    """

    def __init__(self, atoms: Atoms) -> None:
        self._atoms = atoms

    def __repr__(self) -> str:
        return f"ForcesOnAtoms({type(self._atoms.calc).__name__})"

    def bind(self, system: System) -> "WithoutVirial":
        """The term that gets the forces on the atoms from the calculator."""
        return WithoutVirial(self._atoms)


class WithoutVirial(CalculatorTerm):
    """Forces and energy only.

    If the atoms have FixCom, the force on their center of mass is removed, in proportion to the masses.
    """

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """See CalculatorTerm."""
        super().add(system, detail, forces, energies, virials)
        if fixes_center(self._atoms):
            forces -= system.masses[:, None] / system.masses.sum() * forces.sum(axis=0)

    def _virial(self, system: System, forces: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.full(6, np.nan)
