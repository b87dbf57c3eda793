"""Calculators of ASE as potentials of minimd."""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from ase import Atoms
from ase.calculators.calculator import BaseCalculator
from ase.stress import full_3x3_to_voigt_6_stress
from numpy.typing import NDArray

from minimd.ase.calculator import Calculator
from minimd.console.quiet import outside_minimd
from minimd.console.words import shown
from minimd.potentials.term import FORCES, PER_ATOM, OwnPotential, Potential, as_potentials
from minimd.structure.ase_atoms import atoms_from_system, fixes_center, volume_of
from minimd.structure.system import System


class ForcesFromCalculator(OwnPotential):
    """A potential for systems of minimd: forces, energy and virial from any calculator of ASE.

    The energy is the one that is consistent with the forces (free_energy) if the calculator has it. The virial is
    W = −stress · volume; in a system without periodic directions it is W = Σ r ⊗ F, which needs no stress. If the
    calculator gives no stress that is needed, virial and pressure are NaN, and a warning says so. The units of the
    system should be those of the calculator (Å, eV).

    calculator : of ase.calculators, such as EMT().  Raises TypeError for anything else.
    """

    def __init__(self, calculator: BaseCalculator) -> None:
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
        atoms = atoms_from_system(system)
        atoms.set_constraint()  # minimd needs the forces without constraints, which it applies itself
        atoms.calc = self.calculator
        return CalculatorTerm(atoms)


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
            return full_3x3_to_voigt_6_stress((system.positions - system.positions.mean(axis=0)).T @ forces)
        try:
            return -self._atoms.get_stress() * volume_of(self._atoms)
        except NotImplementedError as reason:
            warnings.warn(
                f"{type(self._atoms.calc).__name__} gives no stress ({reason}); virial and pressure are NaN",
                stacklevel=outside_minimd(),
            )
            return np.full(6, np.nan)


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


def calculators_said(calculator: BaseCalculator) -> str:
    """The warning, given once, for steps with a calculator that is not minimd's."""
    name = type(calculator).__name__
    return (
        f"the calculator is {name}, not minimd.ase.Calculator: minimd makes the steps with its forces, only as fast "
        f"as {name} computes them"
    )


def potentials_of_calculator(calculator: Any) -> Sequence[Potential] | None:
    """The potentials of a calculator of ASE: those of a minimd.ase.Calculator without bonds, else ForcesFromCalculator,
    with a warning.

    None for anything that is not a calculator.
    """
    if not is_calculator(calculator):
        return None
    if isinstance(calculator, Calculator) and calculator.bonds is None:
        return as_potentials(calculator.potentials)
    warnings.warn(calculators_said(calculator), stacklevel=outside_minimd())
    return [ForcesFromCalculator(calculator)]


def is_calculator(calculator: Any) -> bool:
    """Whether an object has the methods of a calculator of ASE."""
    return hasattr(calculator, "get_forces") and hasattr(calculator, "get_potential_energy")
