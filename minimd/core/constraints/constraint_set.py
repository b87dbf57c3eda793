"""The constraints of a simulation (fixed lengths and fixed atoms), and the degrees of freedom that they leave."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from minimd.core.console.quiet import warn
from minimd.core.constraints.groups import bodies_of
from minimd.core.constraints.solver import ConstraintSolver, check_atoms
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell, images_of_length, nearest_images
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.constraints import Constraint, DistanceConstraints, FixedAtoms
from minimd.core.structure.observables import (
    center,
    degrees_of_freedom,
    kinetic_energy,
    leaves_out_center,
    temperature,
    thermal_energy,
)
from minimd.core.structure.system import System, check_resolution

# largest deviation of images from lattice vectors, and of lengths that is still a tolerance
WHOLE = 1e-6
# degrees of freedom of an atom: fewer are rounding, of an atom that constraints hold in its place
NO_SHARE = 1e-9
# relative violation above which one is warned of a projection: files of single precision have more
WORTH_A_WARNING = 1e-8


class ConstraintSet:
    """The constraints of one simulation.

    Attributes
    ----------
    inverse_masses : (N,) [1/mass], zero for fixed atoms and for sites.
    bonds : ConstraintSolver, or None.
    n_constraints, n_fixed : int.
    kept : the same constraints, with the lengths that are kept; at most one of each kind.
    """

    def __init__(
        self, system: System, constraints: Constraint | Sequence[Constraint], threads: int = 1
    ) -> None:
        all_kinds = list(constraints) if isinstance(constraints, list | tuple) else [constraints]
        is_site = system.masses == 0.0
        self._n_sites = int(is_site.sum())
        self._dimensions = system.dimensions
        self.inverse_masses = _inverse(system.masses)

        distances = []

        for constraint in all_kinds:
            named = getattr(constraint, "pairs", getattr(constraint, "atoms", ()))
            held_sites = np.intersect1d(named, np.flatnonzero(is_site))
            if held_sites.size:
                raise ValueError(
                    "constraints must not name massless sites, which follow their parents; "
                    f"{constraint!r} names atom {held_sites[0]}"
                )
            if isinstance(constraint, FixedAtoms):
                constraint.check_size(len(system))
                self.inverse_masses[constraint.atoms] = 0.0
            else:
                kinds = "DistanceConstraints or FixedAtoms"
                distances.append(
                    checked_kind("constraints", constraint, DistanceConstraints, kinds)
                )

        if len(distances) > 1:
            raise ValueError(
                f"constraints must hold all pairs in one DistanceConstraints; {len(distances)} are given"
            )

        self._threads = threads
        # the cell for which the images of bonds were found
        self._cell = system.cell
        is_fixed = (self.inverse_masses == 0.0) & ~is_site
        self.n_fixed = int(is_fixed.sum())
        self.kept: tuple[Any, ...] = (FixedAtoms(is_fixed),) if self.n_fixed else ()
        self.bonds = None
        self.n_constraints = 0

        for rigid in distances:
            pairs = rigid.pairs
            lengths = rigid.lengths
            check_atoms(pairs, len(system))
            if lengths is None:
                images = nearest_images(system.positions, system.cell, pairs)
            else:
                images = images_of_length(system.positions, system.cell, pairs, lengths)

            bonds = ConstraintSolver(rigid, system.positions, self.inverse_masses, images, threads)
            check_resolution(system, float(bonds.lengths.min()), "the shortest rigid length")
            self.bonds = bonds
            self.n_constraints = bonds.n_constraints
            kept = DistanceConstraints(bonds.pairs, bonds.lengths, rigid.tolerance, rigid.solver)
            self.kept += (kept,)

    def degrees_of_freedom(self, conserves_momentum: bool) -> int:
        """Degrees of freedom of the atoms that move, see observables. Raises ValueError if none is left."""
        n_atoms = len(self.inverse_masses) - self.n_fixed - self._n_sites
        is_free = conserves_momentum and not self.n_fixed
        return degrees_of_freedom(n_atoms, self.n_constraints, is_free, self._dimensions)

    def shares(self, positions: Array, conserves_momentum: bool) -> Array:
        """Degrees of freedom of each atom, (N,); their sum is degrees_of_freedom.

            g_i = tr P_ii − d m_i/M,   P = 1 − M⁻¹ Gᵀ (G M⁻¹ Gᵀ)⁻¹ G

        P is the projection onto the constraints, G their gradients; the last term counts if leaves_out_center. Then
        ⟨m_i v_i²⟩ = g_i k_B T. Atoms of different bodies are projected together.
        positions : (N, 3).
        """
        n_atoms = len(self.inverse_masses)
        left = np.arange(n_atoms)
        shares = np.zeros(n_atoms)
        body = left
        if self.bonds is not None:
            body = bodies_of(self.bonds.pairs, self.inverse_masses).label

        while left.size:
            _, first = np.unique(body[left], return_index=True)
            atoms = left[first]

            for axis in range(self._dimensions):
                velocities = np.zeros((n_atoms, 3))
                velocities[atoms, axis] = 1.0
                self.project(velocities, positions)
                shares[atoms] += velocities[atoms, axis]

            left = np.delete(left, first)

        shares[shares < NO_SHARE] = 0.0
        if leaves_out_center(n_atoms, conserves_momentum and not self.n_fixed):
            masses = _inverse(self.inverse_masses)
            shares -= self._dimensions * masses / masses.sum()
        return shares

    def temperature(self, velocities: Array, system: System, conserves_momentum: bool) -> float:
        """Kinetic temperature of the atoms of a system with these velocities, (N, 3); 0 at rest."""
        moving = np.where(self.inverse_masses[:, None] > 0.0, velocities, 0.0)
        drift = center(moving, system.masses, conserves_momentum and not self.n_fixed)
        thermal = thermal_energy(kinetic_energy(moving, system.masses), drift, system.masses)
        if not thermal:
            return thermal
        n_dof = self.degrees_of_freedom(conserves_momentum)
        return temperature(thermal, n_dof, system.units.k_B)

    def fit(self, system: System) -> None:
        """Choose images of bonds with the right lengths, after atoms moved by lattice vectors or the cell changed."""
        if self.bonds is None:
            return
        off = self.bonds.violation(system.positions) > self.bonds.tolerance
        if not system.cell.same_as(self._cell):
            off[:] = True
            self._cell = system.cell
        if not off.any():
            return

        offsets = self.bonds.offsets.copy()
        pairs = self.bonds.pairs[off]
        lengths = self.bonds.lengths[off]
        offsets[off] = images_of_length(system.positions, system.cell, pairs, lengths)
        if not np.array_equal(offsets, self.bonds.offsets):
            iterations = self.bonds.iterations
            self.bonds = ConstraintSolver(
                self.kept[-1], system.positions, self.inverse_masses, offsets, self._threads
            )
            self.bonds.iterations = iterations

    def follow(self, before: Cell, cell: Cell) -> None:
        """Change the images of bonds after the cell was strained: they become the same multiples of its new vectors."""
        if self.bonds is not None:
            self.bonds.follow(before, cell)
        self._cell = cell

    def restore(self, system: System, offsets: Array, tolerance: float) -> None:
        """Take over images of bonds, (K, 3) [length], and the tolerance of another set with the same constraints.
        Raises ValueError for images that are no lattice vectors, or a tolerance far above that of the constraints."""
        cells = offsets @ system.cell.inverse
        deviation = np.abs(cells - np.rint(cells) * system.cell.pbc).max()
        if max(deviation, tolerance) > max(WHOLE, self.kept[-1].tolerance):
            raise ValueError(
                f"images of rigid bonds must be lattice vectors, and lengths be kept to {WHOLE:g}"
            )
        self.bonds = ConstraintSolver(
            self.kept[-1],
            system.positions,
            self.inverse_masses,
            offsets,
            self._threads,
            tolerance,
        )
        self._cell = system.cell

    def with_equal_masses(self, system: System) -> "ConstraintSet":
        """The same constraints and lengths on atoms of mass 1: projections are then the shortest moves."""
        light = System(
            system.positions,
            masses=1.0,
            cell=system.cell,
            units=system.units,
            sites=system.sites,
        )
        return ConstraintSet(light, self.kept, self._threads)

    def project(self, velocities: Array, positions: Array) -> None:
        """Project velocities in place onto those that the constraints allow.  Both arrays are (N, 3)."""
        velocities[self.inverse_masses == 0.0] = 0.0
        if self.bonds is not None:
            self.bonds.project_velocities(velocities, positions)

    def begin(self, system: System) -> None:
        """Project positions and velocities that violate a constraint; a warning says by how much."""
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
        if max(off, turned) > WORTH_A_WARNING:
            warn(
                "the initial state was projected onto the constraints: relative errors were "
                f"{0.5 * off:.1e} in the lengths and {turned:.1e} in the velocities along bonds"
            )


def _inverse(masses: Array) -> Array:
    """1/m, (N,); 0 where m is 0."""
    return np.divide(1.0, masses, out=np.zeros(len(masses)), where=masses > 0.0)
