"""Distance constraints on any bond graph: sorted by shape, each shape with the solver that suits it.

bonds that share no atom, three atoms in a line, triangles such as water    closed_forms
everything else: Newton within an envelope                                  networks
solver="shake": sweeps, for all but the lines                               networks
"""

from collections import namedtuple
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import sum_in_any_order
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.machine import EPS
from minimd.core.compiled.program import GO_ON, Operation, Program, n_chunks_of, operation, share_of
from minimd.core.compiled.threads import thread_pool
from minimd.core.constraints.closed_forms import drift_some
from minimd.core.constraints.groups import CONSTRAINTS_IN_A_CHUNK, groups_of
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell
from minimd.core.structure.constraints import DistanceConstraints
from minimd.core.structure.errors import ConstraintError

ROUNDINGS = 20.0  # rounding errors of the largest coordinate: no length can be kept more accurately


class Free(ByAddress, namedtuple("Free", "positions velocities atoms duration n_chunks")):
    """The drift of atoms without constraints.
    positions, velocities : (N, 3).
    atoms : (F,).
    duration : [time]."""


@called_kernel
def drift_free(free, chunk):
    """positions += duration · velocities, of some of the atoms."""
    positions, velocities, atoms, duration, n_chunks = free
    first, last = share_of(chunk, n_chunks, atoms.size)
    drift_some(positions, velocities, atoms[first:last], duration)
    return GO_ON


class ConstraintSolver:
    """Solves the distance constraints of one system.

    Parameters
    ----------
    constraints : DistanceConstraints.
    positions : (N, 3) [length].
    inverse_masses : (N,) [1/mass], zero for atoms that are held fixed.
    offsets : (K, 3) [length], added to r_j − r_i: lattice translations of bonds across a periodic boundary.
    threads : maximum number of threads; results have the same bits for any number.
    tolerance : of relative violations; if not given, that of the constraints, or the larger rounding of positions.

    Attributes
    ----------
    n_constraints : number of degrees of freedom removed.
    lengths : (K,) [length], in the order of constraints.pairs.
    accuracy : error of the lengths with solver="shake" [length]; 0 for the other solvers, whose error is rounding.

    Raises
    ------
    ValueError : for atoms that do not exist, a pair of two fixed atoms, a length of zero, or dependent constraints.
    """

    def __init__(
        self,
        constraints: DistanceConstraints,
        positions: Array,
        inverse_masses: Array,
        offsets: Array | None = None,
        threads: int = 1,
        tolerance: float | None = None,
    ) -> None:
        self.pairs = constraints.pairs
        self.inverse_masses = inverse_masses
        self._calls = DirectCalls()
        self.offsets = np.zeros((len(self.pairs), 3)) if offsets is None else offsets
        check_atoms(self.pairs, len(positions))

        is_stuck = (inverse_masses[self.pairs] == 0.0).all(axis=1)
        if is_stuck.any():
            k = np.argmax(is_stuck)
            i, j = self.pairs[k]
            raise ValueError(
                f"constraint {k} (atoms {i}-{j}) connects two atoms that are held fixed; leave it out"
            )

        lengths = constraints.lengths
        if lengths is None:
            lengths = np.linalg.norm(self.bonds(positions), axis=1)
        if not (lengths > 0.0).all():
            k = np.argmin(lengths > 0.0)
            i, j = self.pairs[k]
            raise ValueError(
                f"constraint {k} has length 0: atoms {i} and {j} are at the same place; give lengths"
            )

        self.lengths = lengths
        self.threads = max(1, min(threads, len(self.pairs) // CONSTRAINTS_IN_A_CHUNK))
        rounding = ROUNDINGS * EPS * float(np.abs(positions).max()) / float(lengths.min())
        self.tolerance = max(constraints.tolerance, rounding) if tolerance is None else tolerance
        is_swept = constraints.solver == "shake"
        self.accuracy = self.tolerance * float(lengths.max()) if is_swept else 0.0

        self.groups = groups_of(self, positions, constraints.solver)
        self.free_atoms = np.setdiff1d(np.arange(len(positions)), self.pairs)
        self.n_constraints = sum(group.n_constraints for group in self.groups)

    def __repr__(self) -> str:
        return f"ConstraintSolver({len(self.lengths)} lengths: {self.summary}; kept to {self.tolerance:.1g})"

    @property
    def summary(self) -> str:
        """The constraints, for a report."""
        return ", ".join(f"{len(group.order)} in {group.shape}" for group in self.groups)

    def follow(self, before: Cell, cell: Cell) -> None:
        """Change offsets, in place, to the same multiples of the vectors of another cell."""
        before.follow(cell, self.offsets)
        for group in self.groups:
            for offsets in group.offsets():
                before.follow(cell, offsets)

    @property
    def iterations(self) -> int:
        """The largest number of any drift so far; it can be set to zero."""
        return max((int(group.most.max()) for group in self.groups), default=0)

    @iterations.setter
    def iterations(self, iterations: int) -> None:
        for group in self.groups:
            group.most[:] = iterations

    def drifts(self, positions: Array, velocities: Array, duration: float) -> Iterator[Operation]:
        """positions += duration · velocities, (N, 3) both, projected along the old gradients; velocities fit then.
        Raises ConstraintError if a length cannot be kept; positions and velocities are then undefined."""
        if self.free_atoms.size:
            n_chunks = n_chunks_of(self.free_atoms.size)
            free = Free(positions, velocities, self.free_atoms, float(duration), n_chunks)
            yield operation(self._calls, drift_free, free, n_chunks)
        for group in self.groups:
            drift = group.drift(positions, velocities, duration)
            yield self._kept(drift, group, positions, velocities, duration)

    def projections(self, positions: Array, velocities: Array) -> Iterator[Operation]:
        """Project velocities in place so that r_ij · v_ij = 0 for all constraints.  Both arrays are (N, 3)."""
        for group in self.groups:
            project = group.project(positions, velocities, np.zeros(len(group.order)))
            yield self._kept(project, group, positions, velocities, 0.0)

    def drift(self, positions: Array, velocities: Array, duration: float) -> None:
        """The operations drifts, at once."""
        self._run(self.drifts(positions, velocities, duration))

    def project_velocities(self, velocities: Array, positions: Array) -> None:
        """The operations projections, at once."""
        self._run(self.projections(positions, velocities))

    def _run(self, operations: Iterable[Operation]) -> None:
        Program(lambda: operations, lambda: 0, thread_pool(self.threads)).run()

    def project_positions(self, positions: Array) -> None:
        """Move positions (N, 3) along their present bonds, with mass weights, until all lengths are kept."""
        at_rest = np.zeros_like(positions)
        for _ in range(10):
            self.drift(positions, at_rest, 1.0)
            at_rest[:] = 0.0
            if self.violation(positions).max(initial=0.0) <= self.tolerance:
                return
        self._fail(int(np.argmax(self.violation(positions))), positions, at_rest, 1.0)

    def multipliers(
        self, positions: Array, velocities: Array, accelerations: Array
    ) -> list[tuple[Indices, Array]]:
        """Constraints of each group, and their λ [energy/length²]: the force on j is λ r_ij. Projects accelerations."""
        turning = self._differences(velocities)
        targets = -np.einsum("ij,ij->i", turning, turning)
        multipliers = []
        for group in self.groups:
            project = group.project(positions, accelerations, targets[group.order])
            self._run([self._kept(project, group, positions, accelerations, 0.0)])
            multipliers.append((group.order, group.multipliers.copy()))
        return multipliers

    def virial(self, positions: Array, velocities: Array, forces: Array) -> Array:
        """W = Σ λ r_ij ⊗ r_ij of the constraint forces, (3, 3) [energy]. forces : (N, 3), all others."""
        _, arms, pulls = self.lines(positions, velocities, forces)
        return sum_in_any_order(np.einsum("ki,kj->kij", pulls, arms))

    def lines(
        self, positions: Array, velocities: Array, forces: Array
    ) -> tuple[Array, Array, Array]:
        """r_i, r_ij [length], and the constraint force on atom j, λ r_ij [energy/length], each (K, 3)."""
        accelerations = forces * self.inverse_masses[:, None]
        arms = self.bonds(positions)
        pulls = np.empty_like(arms)
        for order, multipliers in self.multipliers(positions, velocities, accelerations):
            pulls[order] = multipliers[:, None] * arms[order]
        return positions[self.pairs[:, 0]], arms, pulls

    def bonds(self, positions: Array) -> Array:
        """r_ij, (K, 3) [length]."""
        return self._differences(positions) + self.offsets

    def _differences(self, vectors: Array) -> Array:
        return vectors[self.pairs[:, 1]] - vectors[self.pairs[:, 0]]

    def violation(self, positions: Array) -> Array:
        """|r² − d²|/d², (K,)."""
        bonds = self.bonds(positions)
        return np.abs(np.einsum("ij,ij->i", bonds, bonds) - self.lengths**2) / self.lengths**2

    def velocity_violation(self, positions: Array, velocities: Array) -> Array:
        """|r · (v_j − v_i)|/(d v), (K,), v the speed of the faster end; zero where nothing moves."""
        turning = self._differences(velocities)
        speeds = np.linalg.norm(velocities, axis=1)[self.pairs].max(axis=1)
        along = np.abs(np.einsum("ij,ij->i", self.bonds(positions), turning))
        return along / (self.lengths * np.where(speeds > 0.0, speeds, 1.0))

    def _kept(
        self, solving: Operation, group: Any, positions: Array, velocities: Array, duration: float
    ) -> Operation:
        """An operation on a group that fails for the first constraint that cannot be kept."""

        def fail(_answer: int) -> None:
            constraint = group.order[group.failed(duration != 0.0)]
            self._fail(constraint, positions, velocities, duration)

        return solving._replace(python=fail)

    def _fail(self, constraint: int, positions: Array, velocities: Array, duration: float) -> None:
        """Raise ConstraintError with the larger violation: closed forms fail before they move atoms, others after."""
        i, j = self.pairs[constraint].tolist()
        moved = positions + duration * velocities
        off = max(self.violation(positions)[constraint], self.violation(moved)[constraint])
        step = f"drift of {duration:g}" if duration else "projection of velocities"
        error = ConstraintError(
            f"constraint {constraint} (atoms {i}-{j}) cannot be kept in a {step}: "
            f"the relative error of r² is {off:.1e}"
        )
        error.atoms = i, j
        raise error


def check_atoms(pairs: Indices, n_atoms: int) -> None:
    """Raise ValueError if constraints (K, 2) name atoms that do not exist."""
    if pairs.max(initial=-1) >= n_atoms:
        raise ValueError(
            f"constraints must name atoms 0 to {n_atoms - 1}; they name atom {pairs.max()}"
        )
