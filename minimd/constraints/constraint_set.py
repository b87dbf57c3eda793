"""The constraints of a simulation, lengths and fixed atoms, and the degrees of freedom that they leave."""

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from minimd.constraints.solver import ConstraintSolver
from minimd.structure.console import outside_minimd
from minimd.structure.constraints import Constraint, DistanceConstraints, FixedAtoms
from minimd.structure.images import images_of_length, nearest_images
from minimd.structure.observables import degrees_of_freedom
from minimd.structure.system import System

TOLD = 1e-8  # relative violations of a start above which its projection is told by a warning; files of single precision have more


class ConstraintSet:
    """The constraints of one simulation.

    Attributes
    ----------
    inverse_masses : (N,) [1/mass], zero for fixed atoms.  bonds : ConstraintSolver, or None.  n_constraints, n_fixed : int.
    kept : the same constraints, with the lengths that are kept; at most one of each kind.
    """

    def __init__(self, system: System, constraints: Constraint | Sequence[Constraint], threads: int = 1) -> None:
        given = list(constraints) if isinstance(constraints, Sequence) else [constraints]
        for constraint in given:
            if not isinstance(constraint, (DistanceConstraints, FixedAtoms)):
                raise TypeError(f"constraints must be DistanceConstraints or FixedAtoms; got {constraint!r}")
        distances = [constraint for constraint in given if isinstance(constraint, DistanceConstraints)]
        if len(distances) > 1:
            raise ValueError("all pairs must be given in one DistanceConstraints: those that share atoms are solved together")
        self._threads, self._cell = threads, system.cell  # the cell for which the images of bonds were found
        self.inverse_masses = self._masses(system, [constraint for constraint in given if isinstance(constraint, FixedAtoms)])
        self.n_fixed = int((self.inverse_masses == 0.0).sum())
        self._distances = distances[0] if distances else None
        self.bonds = self._solver(system)
        self.n_constraints = self.bonds.n_constraints if self.bonds else 0
        self.kept = self._kept()

    def _kept(self) -> tuple[Constraint, ...]:
        kept: list[Constraint] = [FixedAtoms(self.inverse_masses == 0.0)] if self.n_fixed else []
        if self.bonds is not None and self._distances is not None:
            kept.append(DistanceConstraints(self.bonds.pairs, self.bonds.lengths, self._distances.tolerance, self._distances.solver))
        return tuple(kept)

    @staticmethod
    def _masses(system: System, fixed: list[FixedAtoms]) -> NDArray[np.float64]:
        inverse_masses = 1.0 / system.masses
        for constraint in fixed:
            constraint.check_size(len(system))
            inverse_masses[constraint.atoms] = 0.0
        return inverse_masses

    def _solver(self, system: System) -> ConstraintSolver | None:
        if self._distances is None:
            return None
        if self._distances.pairs.max() >= len(system):
            raise ValueError(f"constraints must name atoms 0 to {len(system) - 1}; they name atom {self._distances.pairs.max()}")
        pairs, lengths = self._distances.pairs, self._distances.lengths
        images = (
            nearest_images(system.positions, system.cell, pairs)
            if lengths is None
            else images_of_length(system.positions, system.cell, pairs, lengths)
        )
        return ConstraintSolver(self._distances, system.positions, self.inverse_masses, images, self._threads)

    def degrees_of_freedom(self, conserves_momentum: bool) -> int:
        """Degrees of freedom of the atoms that move, see observables. Raises ValueError if none is left."""
        n_atoms = len(self.inverse_masses) - self.n_fixed
        return degrees_of_freedom(n_atoms, self.n_constraints, conserves_momentum and not self.n_fixed)

    def fit(self, system: System) -> None:
        """Choose for each bond the image that has its length again, after atoms were moved by lattice vectors or the cell was changed."""
        if self.bonds is None or self._distances is None:
            return
        off = self.bonds.violation(system.positions) > self.bonds.tolerance
        if not system.cell.same_as(self._cell):
            off[:], self._cell = True, system.cell
        if not off.any():
            return
        offsets = self.bonds.offsets.copy()
        offsets[off] = images_of_length(system.positions, system.cell, self.bonds.pairs[off], self.bonds.lengths[off])
        if not np.array_equal(offsets, self.bonds.offsets):
            known = DistanceConstraints(self.bonds.pairs, self.bonds.lengths, self._distances.tolerance, self._distances.solver)
            iterations = self.bonds.iterations
            self.bonds = ConstraintSolver(known, system.positions, self.inverse_masses, offsets, self._threads)
            self.bonds.iterations = iterations

    def with_equal_masses(self, system: System) -> "ConstraintSet":
        """The same constraints and lengths on atoms of mass 1: projections are then the shortest moves."""
        light = System(system.positions, masses=1.0, cell=system.cell, units=system.units)
        return ConstraintSet(light, self.kept, self._threads)

    def project(self, velocities: NDArray[np.float64], positions: NDArray[np.float64]) -> None:
        """Velocities projected onto those that the constraints allow, in place. (N, 3) both."""
        velocities[self.inverse_masses == 0.0] = 0.0
        if self.bonds is not None:
            self.bonds.project_velocities(velocities, positions)

    def begin(self, system: System) -> None:
        """Project positions and velocities that violate a constraint, with a warning that tells by how much."""
        self.fit(system)
        system.velocities[self.inverse_masses == 0.0] = 0.0
        if self.bonds is None:
            return
        off = float(self.bonds.violation(system.positions).max())
        if off > self.bonds.tolerance:
            self.bonds.project_positions(system.positions)
        turned = float(self.bonds.velocity_violation(system.positions, system.velocities).max())
        if turned > self.bonds.tolerance:
            self.bonds.project_velocities(system.velocities, system.positions)
        if max(off, turned) > TOLD:
            warnings.warn(
                f"the start was projected onto the constraints: lengths were off by {0.5 * off:.1e} of themselves, "
                f"velocities along bonds by {turned:.1e} of the speed",
                stacklevel=outside_minimd(),
            )
