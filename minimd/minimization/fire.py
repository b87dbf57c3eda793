"""FIRE, the fast inertial relaxation engine: a descent with inertia,
which stops whenever the energy begins to increase.

The rules are written beside their lines in FIRE._descend. All masses are 1. E. Bitzek et al., Phys. Rev. Lett. 97,
170201 (2006), in the form of J. Guénolé et al., Comput. Mater. Sci. 175, 109584 (2020):
half a step back after each stop, and steps of symplectic Euler.

Three things are added. The unit of time is not known here; therefore Δt is limited by the largest curvature
κ = |ΔF|/|Δr|, which is estimated regularly by a few power iterations. No atom moves farther than a given length in a
step, so that overlaps are resolved however large the forces are. A step that leaves the domain of the energy, as one
that overstretches a FENE bond, is taken back and shortened.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from minimd.compiled.kernels import kernel
from minimd.constraints.constraint_set import ConstraintSet
from minimd.forces.contacts import why_not_finite
from minimd.forces.forces import Forces
from minimd.neighbors.queries import closest_pair
from minimd.potentials.law import is_user_law
from minimd.potentials.term import FORCES, TOTALS, OwnPotential
from minimd.structure.cell import nearest_vectors
from minimd.structure.errors import ConstraintError, NonFiniteError, RangeError
from minimd.structure.observables import Array, longest

# N_delay, f_inc, f_dec, α_start, f_α: Guénolé et al., table 2
DELAY, FASTER, SLOWER, MIXING, LESS_MIXING = 20, 1.1, 0.5, 0.25, 0.99
# √κ Δt at the start, and at most; symplectic Euler is unstable above 2, and κ may be underestimated
FIRST, LONGEST = 0.3, 1.0
PROBE = 1e-3  # of the longest step: displacements for measuring the curvature
# displacements, each along the change of the forces in the one before; steps between two such series
PROBES, PROBE_EVERY = 5, 50
FIRST_SERIES = 4  # number of such series at the start
SEED = 1  # of the first displacement
FALLING = 0.9  # the largest force must fall by this factor in a step of steepest descent
# of a force: if one is larger, all are scaled down by the same factor, so that their squares are finite
LARGEST = 1e100
PUSHES = 100  # largest number of pushes that separate pairs with infinite forces
REFUSALS = 50  # largest number of successive steps taken back, each shorter than the one before


@kernel
def largest_component(vectors):
    """max |x|, of (N, 3); infinite if one of them is not finite."""
    largest = 0.0
    for i in range(vectors.shape[0]):
        for c in range(3):
            x = abs(vectors[i, c])
            if not np.isfinite(x):
                return np.inf
            largest = max(largest, x)
    return largest


@kernel
def overlap(first, second):
    """Σ a·b of two (N, 3) arrays."""
    total = 0.0
    for i in range(first.shape[0]):
        total += first[i, 0] * second[i, 0] + first[i, 1] * second[i, 1] + first[i, 2] * second[i, 2]
    return total


@kernel
def steer(velocities, forces, timestep, mixing, most):
    """v ← v + Δt F, v ← (1 − α) v + α |v| F/|F|; then all v are scaled by one factor so that Δt |v_i| ≤ most.

    v, F : (N, 3).
    """
    v2, f2 = 0.0, 0.0
    for i in range(velocities.shape[0]):
        for c in range(3):
            velocities[i, c] += timestep * forces[i, c]
            v2 += velocities[i, c] * velocities[i, c]
            f2 += forces[i, c] * forces[i, c]
    along = mixing * np.sqrt(v2 / f2) if f2 > 0.0 else 0.0
    for i in range(velocities.shape[0]):
        for c in range(3):
            velocities[i, c] = (1.0 - mixing) * velocities[i, c] + along * forces[i, c]
    displacement = timestep * longest(velocities)[1]
    if displacement > most:
        for i in range(velocities.shape[0]):
            for c in range(3):
                velocities[i, c] *= most / displacement


class FIRE:
    """A descent, made in place on the positions of the system of some forces.

    n_steps : made so far.  largest_force : the largest force on an atom,
        projected onto the constraints [energy/length].
    stop_requested : set it to True to end after the present step.
    """

    def __init__(self, forces: Forces, constraint_set: ConstraintSet, max_step_length: float) -> None:
        self._engine, self._constraint_set, self._longest = forces, constraint_set, max_step_length
        self._system, self._positions = forces.system, forces.system.positions
        self._forces, self._velocities = np.zeros_like(self._positions), np.zeros_like(self._positions)
        users = [
            one
            for one in forces.potentials
            if not isinstance(one, OwnPotential) or is_user_law(getattr(one, "law", ()))
        ]
        self._detail = TOTALS if users else FORCES  # minimd's own laws have no finite force where they have no energy
        self._curvature, self._probe = 0.0, np.random.default_rng(SEED).standard_normal(self._positions.shape)
        self._tolerance, self._max_steps = 0.0, 0
        self.n_steps, self.largest_force, self.stop_requested = 0, 0.0, False

    def begin(self) -> float:
        """Correct the constrained lengths and evaluate the forces; return the largest,
        infinite if atoms had to be pushed apart first.

        Raises NonFiniteError if energy or forces are not finite for another reason than overlaps.  ConstraintError if
        the lengths cannot be corrected.
        """
        bonds = self._constraint_set.bonds
        if bonds is not None and bonds.violation(self._positions).max() > bonds.tolerance:
            bonds.project_positions(self._positions)
        n_pushes = 0
        while not self._evaluate():
            n_pushes += 1
            self._push_apart(n_pushes)
        return np.inf if n_pushes else self.largest_force

    def run(self, tolerance: float, max_steps: int, tell: Callable[[int], Any]) -> None:
        """Descend until no force exceeds the tolerance, or for max_steps steps.  tell :
        called with the number of steps made.

        Raises as begin.
        """
        self._max_steps, self._tolerance, self._tell = max_steps, tolerance, tell
        self._steepest()
        self._descend()

    def _goes_on(self) -> bool:
        return self.largest_force > self._tolerance and self.n_steps < self._max_steps and not self.stop_requested

    def _steepest(self) -> None:
        """Steepest descent, as long as the largest force decreases;
        the atom with the largest force moves by the longest step."""
        while self._goes_on():
            before, forces, largest = self._positions.copy(), self._forces.copy(), self.largest_force
            if self._moved(self._forces * (self._longest / largest), 1.0) and self._evaluate():
                self._count()
                if self.largest_force < FALLING * largest:
                    continue
            self._positions[:], self._forces[:], self.largest_force = before, forces, largest
            return

    def _descend(self) -> None:
        """FIRE, with the rules beside their lines; a step that constraints refuse,
        or that leaves the domain of the energy, is taken back."""
        if not self._goes_on():
            return
        for _ in range(FIRST_SERIES):
            self._try_curvature()
        timestep, mixing, downhill, refused = FIRST / np.sqrt(self._curvature), MIXING, 0, 0
        while self._goes_on():
            before = self._positions.copy()
            if overlap(self._forces, self._velocities) > 0.0:  # P = F·v > 0
                downhill += 1
                if downhill > DELAY:
                    timestep, mixing = timestep * FASTER, mixing * LESS_MIXING  # Δt ← 1.1 Δt, α ← 0.99 α
            elif self._velocities.any():  # P ≤ 0
                self._moved(self._velocities.copy(), -0.5 * timestep)  # r ← r − ½ Δt v
                timestep, mixing, downhill = timestep * SLOWER, MIXING, 0  # Δt ← ½ Δt, α ← ¼
                self._velocities[:] = 0.0  # v ← 0
            timestep = min(timestep, LONGEST / np.sqrt(self._curvature))
            # v ← v + Δt F, v ← (1 − α) v + α |v| F/|F|
            steer(self._velocities, self._forces, timestep, mixing, self._longest)
            has_moved = self._moved(self._velocities, timestep)  # r ← r + Δt v
            if has_moved and self._evaluate():
                self._count()
                if self.n_steps % PROBE_EVERY == 0:
                    self._try_curvature()
                refused = 0
                continue
            timestep, mixing, downhill, refused = timestep * SLOWER, MIXING, 0, refused + 1
            self._positions[:], self._velocities[:] = before, 0.0
            if refused > REFUSALS:
                kind, wanted = (
                    (NonFiniteError, "has a finite energy") if has_moved else (ConstraintError, "keeps the constraints")
                )
                length = f"{timestep**2 * self.largest_force:.2g} {self._system.units.length}"
                raise kind(f"the minimization found no step that {wanted}, down to one of {length}")

    def _try_curvature(self) -> None:
        """Estimate κ by power iterations, which continue the last series;
        a lower bound keeps the first step within the longest."""
        before, forces, largest, shown = self._positions.copy(), self._forces.copy(), self.largest_force, 0.0
        for _ in range(PROBES):
            self._constraint_set.project(self._probe, before)
            if not self._probe.any():  # no curvature at all
                self._probe = np.random.default_rng(SEED).standard_normal(before.shape)
                break
            steps = self._probe * (PROBE * self._longest / longest(self._probe)[1])
            self._positions[:] = before + steps
            if not self._evaluate():
                shown = self._curvature
                break
            self._probe = forces - self._forces
            shown = np.sqrt(overlap(self._probe, self._probe) / overlap(steps, steps))
        self._positions[:], self._forces[:], self.largest_force = before, forces, largest
        self._curvature = max(shown, largest / self._longest)

    def _count(self) -> None:
        self.n_steps += 1
        self._tell(self.n_steps)

    def _moved(self, velocities: Array, duration: float) -> bool:
        """Move all atoms, and change velocities as constraints require; False, without any motion,
        if constraints cannot be kept."""
        bonds = self._constraint_set.bonds
        if bonds is None:
            self._positions += duration * velocities
            return True
        before = self._positions.copy()
        try:
            bonds.drift(self._positions, velocities, duration)
            bonds.project_velocities(velocities, self._positions)
            return True
        except ConstraintError:
            self._positions[:] = before
            return False

    def _evaluate(self) -> bool:
        """Compute the forces, projected onto constraints and scaled to finite squares, and the largest.

        False, with the forces of before, if energy or forces are not finite.
        """
        try:
            largest = largest_component(self._engine.compute(self._detail))
        except RangeError:
            return False
        if not np.isfinite(largest) or (self._engine.has_energy and not np.isfinite(self._engine.potential_energy)):
            return False
        self._forces[:] = self._engine.forces * min(1.0, LARGEST / max(largest, 1.0))
        self._constraint_set.project(self._forces, self._positions)
        self.largest_force = longest(self._forces)[1]
        return True

    def _push_apart(self, n_pushes: int) -> None:
        """Move the two atoms of the closest pair, whose forces are infinite, apart along their connection,
        each by half the longest step.

        If they are at the same place, all atoms that share a place with another take directions of their own, which are
        always the same; the one that moves farthest moves by half the longest step.
        """
        pair = closest_pair(self._system)
        if pair is None or pair.distance > self._longest or n_pushes > PUSHES or not np.isfinite(self._positions).all():
            raise NonFiniteError(
                f"energy or forces are not finite: {why_not_finite(self._system, self._engine.potentials)}"
            )
        arm = nearest_vectors(self._positions, self._system.cell, np.array([pair[:2]]))[0]
        both, velocities = [pair.first, pair.second], np.zeros_like(self._positions)
        if arm.any():
            velocities[both] = np.outer((-1.0, 1.0), arm / np.abs(arm).max())  # squares of tiny numbers may be zero
        else:
            _, place, n_there = np.unique(
                self._system.cell.wrapped(self._positions), axis=0, return_inverse=True, return_counts=True
            )
            shared = np.union1d(both, np.flatnonzero(n_there[place.ravel()] > 1))
            velocities[shared] = self._probe[shared]
        velocities /= longest(velocities)[1]
        self._constraint_set.project(velocities, self._positions)
        if not velocities.any() or not self._moved(velocities, 0.5 * self._longest):
            why = why_not_finite(self._system, self._engine.potentials)
            raise NonFiniteError(f"energy or forces are not finite: {why}, and constraints hold them there")
