"""What may stand where potentials are expected: potentials, several of them, and calculators of ASE."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from minimd.console.quiet import outside_minimd
from minimd.console.words import shown
from minimd.potentials.term import FORCES, PER_ATOM, OwnPotential
from minimd.structure.system import System

if TYPE_CHECKING:
    from ase import Atoms

VOIGT = (0, 1, 2, 1, 0, 0), (0, 1, 2, 2, 2, 1)  # xx yy zz yz xz xy


def as_potentials(given: Any) -> tuple[Any, ...]:
    """One potential or several as a tuple. A calculator of ASE becomes the potentials of a minimd.ase.Calculator, or
    ForcesFromCalculator, with a warning; other objects stay as they are, to be refused by bound."""
    potentials: list[Any] = []
    for one in given if isinstance(given, list | tuple) else (given,):
        if hasattr(one, "bind") or not is_calculator(one):
            potentials.append(one)
        elif (own := getattr(one, "own_potentials", None)) is not None:  # of a minimd.ase.Calculator
            potentials.extend(as_potentials(own))
        else:
            warnings.warn(calculators_said(one), stacklevel=outside_minimd())
            potentials.append(ForcesFromCalculator(one))
    return tuple(potentials)


def is_calculator(calculator: Any) -> bool:
    """Whether an object has the methods of a calculator of ASE."""
    return hasattr(calculator, "get_forces") and hasattr(calculator, "get_potential_energy")


def calculators_said(calculator: Any) -> str:
    """The warning, given once, for steps with a calculator that is not minimd's."""
    name = type(calculator).__name__
    return (
        f"the calculator is {name}, not minimd.ase.Calculator: minimd makes the steps with its forces, only as fast "
        f"as {name} computes them"
    )


class ForcesFromCalculator(OwnPotential):
    """A potential for systems of minimd: forces, energy and virial from any calculator of ASE.

    The energy is the one that is consistent with the forces (free_energy) if the calculator has it. The virial is
    W = −stress · volume; in a system without periodic directions it is W = Σ r ⊗ F, which needs no stress. If the
    calculator gives no stress that is needed, virial and pressure are NaN, and a warning says so. The units of the
    system should be those of the calculator (Å, eV).

    calculator : of ase.calculators, such as EMT().  Raises TypeError for anything else.
    """

    def __init__(self, calculator: Any) -> None:
        if not is_calculator(calculator):
            raise TypeError(
                f"calculator must be a calculator of ASE, such as ase.calculators.emt.EMT(); got {shown(calculator)}"
            )
        self.calculator = calculator

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {"calculator": type(self.calculator)}

    def bind(self, system: System) -> Any:
        """The term that gets the forces on this system from the calculator."""
        from minimd.structure.ase_atoms import atoms_from_system

        atoms = atoms_from_system(system)
        atoms.set_constraint()  # minimd needs the forces without constraints, which it applies itself
        atoms.calc = self.calculator
        return CalculatorTerm(atoms)


class CalculatorTerm:
    """Forces on one system from the calculator of its atoms; see minimd.potentials.Term."""

    is_checked = False  # an evaluation may be dear, and float32 too rough for differences

    def __init__(self, atoms: Atoms) -> None:
        self._atoms = atoms
        self._implemented = getattr(atoms.calc, "implemented_properties", ())

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """Add forces, (N, 3); for TOTALS and PER_ATOM also energies, (N,), and virials, (N, 6).

        Shares are equal; but PER_ATOM takes energies of atoms from a calculator that has them,
        shifted to the right sum.
        """
        self._atoms.positions[:], self._atoms.cell[:] = system.positions, system.cell.vectors
        own = self._atoms.get_forces(apply_constraint=False)
        forces += own
        if detail != FORCES:
            total = self._atoms.get_potential_energy(force_consistent="free_energy" in self._implemented)
            own_shares = detail == PER_ATOM and "energies" in self._implemented
            shares = self._atoms.get_potential_energies() if own_shares else np.zeros(len(self._atoms))
            energies += shares + (total - shares.sum()) / len(shares)
            virials += self._virial(system, own) / len(system)

    def skipped(self) -> Iterable[str]:
        """Nothing: what the calculator leaves out is not known."""
        return ()

    def _virial(self, system: System, forces: NDArray[np.float64]) -> NDArray[np.float64]:
        """W, (6,) as xx yy zz yz xz xy."""
        if not system.cell.is_periodic:
            virial = (system.positions - system.positions.mean(axis=0)).T @ forces
            return 0.5 * (virial + virial.T)[VOIGT]
        try:
            from minimd.structure.ase_atoms import volume_of

            return -self._atoms.get_stress() * volume_of(self._atoms)
        except NotImplementedError as reason:
            warnings.warn(
                f"{type(self._atoms.calc).__name__} gives no stress ({reason}); virial and pressure are NaN",
                stacklevel=outside_minimd(),
            )
            return np.full(6, np.nan)
