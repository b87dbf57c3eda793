"""Potentials of minimd as a calculator of ASE."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator as ASECalculator, all_changes
from ase.stress import full_3x3_to_voigt_6_stress
from numpy.typing import ArrayLike

from minimd.core.diagnosis.contacts import why_not_finite
from minimd.core.forces.forces import ForceResult, Forces, Potential
from minimd.core.forces.options import Options, Precision
from minimd.core.potentials.term import PER_ATOM, TOTALS
from minimd.core.structure.ase_atoms import (
    cell_of,
    same_labels,
    same_scene,
    system_arguments,
    volume_of,
)
from minimd.core.structure.errors import NonFiniteError
from minimd.core.structure.system import System


class Calculator(ASECalculator):
    """A calculator for ase.Atoms: energy, forces and stress from potentials of minimd, in Å and eV.

    The stress is −W/V, tension positive, in the order xx yy zz yz xz xy, without the ideal-gas part; it exists for
    every cell with three lattice vectors. The property "stresses" is the share of each atom. The list of neighbors is
    kept while atoms move. ASE itself applies the constraints of the atoms. Copies and pickles contain the potentials,
    but not the list.

    Parameters
    ----------
    potentials : one potential or several.
    bonds : (B, 2) int, pairs of bonded atoms.
    threads, precision, skin : see Options; the skin in Å.

    Raises
    ------
    TypeError, ValueError : in the first calculation, as System and Forces.
    NonFiniteError : if a force or an energy is not finite, as for two atoms at the same place;
        it names them and the law.
    """

    atoms: Any  # ase.Atoms, from the first calculation on
    implemented_properties = "energy free_energy energies forces stress stresses".split()  # noqa: SIM905

    def __init__(
        self,
        potentials: Potential | Sequence[Potential],
        bonds: ArrayLike | None = None,
        skin: float | None = None,
        *,
        threads: int | None = None,
        precision: Precision = "double",
    ) -> None:
        """See the class. ASE's arguments restart, label, directory and atoms do not exist."""
        super().__init__()
        self._plan: tuple[Atoms, Forces] | None = None
        self.potentials = potentials
        self.bonds = bonds
        self.options = Options(threads, precision, skin)

    def __repr__(self) -> str:
        return f"Calculator({self._potentials!r})"

    @property
    def potentials(self) -> Potential | Sequence[Potential]:
        """One potential or several; setting others drops results and lists."""
        return self._potentials

    @potentials.setter
    def potentials(self, potentials: Potential | Sequence[Potential]) -> None:
        self._potentials = potentials
        several = potentials if isinstance(potentials, list | tuple) else [potentials]
        self.parameters["potentials"] = [*map(repr, several)]  # for databases
        self._plan = None
        self.reset()

    @property
    def own_potentials(self) -> Potential | Sequence[Potential] | None:
        """For minimd, which asks in place of this calculator; None if it has bonds of its own."""
        return self._potentials if self.bonds is None else None

    @property
    def n_builds(self) -> int:
        """How often a pair list was built since the atoms or potentials were last replaced by others."""
        return self._plan[1].n_builds if self._plan else 0

    def calculate(
        self,
        atoms: Atoms | None = None,
        properties: Sequence[str] = ("energy",),
        system_changes: Sequence[str] = all_changes,
    ) -> None:
        """Fill results. The atoms themselves decide whether the list is kept, because system_changes includes neither
        masses nor failed calls."""
        super().calculate(atoms, list(properties), list(system_changes))
        per_atom = bool({"energies", "stresses"} & set(properties))
        forces = self._forces_at(self.atoms)
        sums = forces.compute(PER_ATOM if per_atom else TOTALS)
        if not (np.isfinite(sums.potential_energy) and np.isfinite(sums.forces).all()):
            reason = why_not_finite(forces.system, forces.potentials)
            raise NonFiniteError(f"forces or energies are not finite: {reason}")
        self.results = _results(self.atoms, sums)
        if per_atom:
            self.results["energies"] = sums.energies
            volume = volume_of(self.atoms)
            if volume:
                self.results["stresses"] = -sums.virials / volume

    def check_state(self, atoms: Atoms, tol: float = 1e-15) -> list[str]:
        """ASE's list of changes; a changed label counts as a changed atomic number."""
        changes = super().check_state(atoms, tol)
        if self.atoms is not None and not same_labels(self.atoms, atoms):
            changes.append("numbers")
        return changes

    def adopt(self, atoms: Atoms, sums: ForceResult) -> None:
        """Take over energy, forces and stress of these atoms, computed elsewhere with the same potentials."""
        self.atoms = atoms.copy()
        self.results = _results(atoms, sums)

    def _forces_at(self, atoms: Atoms) -> Forces:
        """The Forces on these atoms: those of the last call and their list, if only positions or cell have changed."""
        if self._plan and same_scene(self._plan[0], atoms):
            forces = self._plan[1]
            forces.system.positions[:] = atoms.positions
            forces.system.cell = cell_of(atoms)
            return forces
        system = System(**system_arguments(atoms, self.bonds, constraints=False))
        forces = Forces(system, self.potentials, self.options)
        forces.warn_of_potentials()
        self._plan = (atoms, forces)
        return forces

    def _get_name(self) -> str:
        return "minimd"

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_plan": None}


def _results(atoms: Atoms, sums: ForceResult) -> dict[str, Any]:
    """Energy, forces and, if there is a volume, stress."""
    energy = sums.potential_energy
    volume = volume_of(atoms)
    results = {"energy": energy, "free_energy": energy, "forces": sums.forces.copy()}
    if volume:
        results["stress"] = -full_3x3_to_voigt_6_stress(sums.virial) / volume
    return results
