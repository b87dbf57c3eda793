"""Minimization of the potential energy to a nearby minimum, by FIRE: a descent with inertia that stops whenever the
energy begins to increase.

The rules of FIRE are written beside their lines in Descent._fire. All masses are 1. E. Bitzek et al., Phys. Rev. Lett.
97, 170201 (2006), in the form of J. Guénolé et al., Comput. Mater. Sci. 175, 109584 (2020): half a step back after each
stop, and steps of symplectic Euler.

Three things are added. The unit of time is not known here; therefore Δt is limited by the largest curvature
κ = |ΔF|/|Δr|, which is estimated regularly by a few power iterations. No atom moves farther than a given length in a
step, so that overlaps are resolved however large the forces are. A step that leaves the domain of the energy, as one
that overstretches a FENE bond, is taken back and shortened.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

import numpy as np

from minimd.core.compiled.kernels import kernel
from minimd.core.console.display import Displayed
from minimd.core.console.progress import progress_of
from minimd.core.console.signals import stop_on_signals
from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.diagnosis.contacts import why_not_finite
from minimd.core.forces.forces import Forces, Potential
from minimd.core.neighbors.queries import closest_pair
from minimd.core.potentials.law import is_user_law
from minimd.core.potentials.term import FORCES, TOTALS, OwnPotential
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.checks import checked_count, checked_number
from minimd.core.structure.constraints import Constraint
from minimd.core.structure.errors import ConstraintError, Interrupted, NonFiniteError, RangeError
from minimd.core.structure.observables import longest
from minimd.core.structure.system import AnySystem, System

# [energy/length], in reduced units and in eV/Å
FORCE_TOLERANCE = 1e-6
MAX_STEPS = 10_000
MAX_STEP_LENGTH = 0.1  # [length], in σ and in Å
# N_delay, f_inc, f_dec, α_start, f_α: Guénolé et al., table 2
DELAY = 20
FASTER = 1.1
SLOWER = 0.5
MIXING = 0.25
LESS_MIXING = 0.99
# √κ Δt at the start, and at most; symplectic Euler is unstable above 2, and κ may be underestimated
FIRST = 0.3
LONGEST = 1.0
PROBE = 1e-3  # of the longest step: displacements for measuring the curvature
# displacements, each along the change of the forces in the one before; steps between two such series; series at first
PROBES = 5
PROBE_EVERY = 50
FIRST_SERIES = 4
SEED = 1  # of the first displacement
FALLING = 0.9  # the largest force must fall by this factor in a step of steepest descent
# of a force: if one is larger, all are scaled down by the same factor, so that their squares are finite
LARGEST = 1e100
# largest numbers of pushes that separate pairs with infinite forces, and of steps taken back, each shorter than before
PUSHES = 100
REFUSALS = 50


@dataclass(frozen=True)
class Minimization(Displayed):
    """The result of a minimization; print it.

    Attributes
    ----------
    system : System, the final state.
    converged : whether largest_force is within the tolerance.
    n_steps : number of steps.
    n_evaluations : number of force evaluations.
    largest_force, largest_force_before : the largest force on an atom, projected onto the constraints [energy/length].
    potential_energy, potential_energy_before : U [energy]; infinity also where it is NaN.
    force_tolerance : as given [energy/length].
    """

    system: System
    converged: bool
    n_steps: int
    n_evaluations: int
    largest_force: float
    largest_force_before: float
    potential_energy: float
    potential_energy_before: float
    force_tolerance: float

    def __str__(self) -> str:
        units = self.system.units
        unit = f"{units.energy}/{units.length}"
        return (
            f"minimization   {'converged' if self.converged else 'not converged'} after {self.n_steps} steps\n"
            f"energy         {self.potential_energy_before:.10g} -> {self.potential_energy:.10g} {units.energy}\n"
            f"largest force  {self.largest_force_before:.3g} -> {self.largest_force:.3g} {unit}, tolerance "
            f"{self.force_tolerance:.3g}"
        )


def minimize(
    system: AnySystem,
    potentials: Potential | Sequence[Potential],
    constraints: Constraint | Sequence[Constraint] | None = None,
    *,
    force_tolerance: float = FORCE_TOLERANCE,
    max_steps: int = MAX_STEPS,
    max_step_length: float = MAX_STEP_LENGTH,
    progress: bool | None = None,
) -> Minimization:
    """Find a minimum of the potential energy near the given state, by FIRE; the given system is not changed.

    No step moves an atom farther than max_step_length, so that atoms that are far too close to each other separate,
    however large their forces are. Atoms at exactly the same place, where the direction of their force is undefined,
    are moved apart, each in a direction of its own that is always the same. A step that leaves the domain of the
    energy, as one that stretches a FENE bond beyond its longest length, is taken back and shortened; a start outside it
    is refused. A start where all forces are zero is not changed, even if it is not a minimum: displace the atoms of a
    crystal a little if its symmetry should break. Constraints are kept, and fixed atoms do not move. Velocities are
    kept, but projected onto the constraints at the end.

    Parameters
    ----------
    system, potentials, constraints : as for Simulation.
    force_tolerance : the search converges when the force on each atom is at most this [energy/length]. If the force
        jumps at the cutoff (truncation "shifted" or "truncated"), there may be no place where all forces vanish,
        and the search ends after max_steps.
    max_steps : maximum number of steps; see converged of the result.
    max_step_length : largest displacement of an atom in a step [length].
    progress : as for Simulation.run.

    Raises
    ------
    NonFiniteError : for an energy or forces that are not finite although no atoms are close;
        it names the law and its atoms.
    ConstraintError : if constraints cannot be kept.
    TypeError, ValueError : as Simulation.
    KeyboardInterrupt : after Ctrl-C; its attribute result is the Minimization so far.

    E. Bitzek et al., Phys. Rev. Lett. 97, 170201 (2006); J. Guénolé et al., Comput. Mater. Sci. 175, 109584 (2020).
    """
    system = system.copy() if isinstance(system, System) else System.from_ase(system)
    forces = Forces(system, potentials)
    forces.warn_of_potentials()
    return minimized(
        forces,
        ConstraintSet(system, system.constraints if constraints is None else constraints),
        force_tolerance,
        max_steps,
        max_step_length,
        progress,
    )


def minimized(
    forces: Forces,
    constraint_set: ConstraintSet,
    force_tolerance: float,
    max_steps: int,
    max_step_length: float,
    progress: bool | None,
) -> Minimization:
    """Minimize the system of some forces in place; see minimize."""
    tolerance = checked_number("force_tolerance", force_tolerance, "positive and finite")
    max_step_length = checked_number("max_step_length", max_step_length, "positive and finite")
    max_steps = checked_count("max_steps", max_steps, 0)
    system = forces.system
    evaluated = forces.n_evaluations
    energy_before = _potential_energy(forces)
    constraint_set.fit(system)
    descent = Descent(
        forces, constraint_set.with_equal_masses(system), max_step_length, tolerance, max_steps
    )
    with progress_of(max_steps, "minimizing", progress) as tell, stop_on_signals(descent):
        largest_before = descent.run(tell)
        constraint_set.project(system.velocities, system.positions)
        result = Minimization(
            system,
            descent.largest_force <= tolerance,
            descent.n_steps,
            forces.n_evaluations - evaluated + 1,
            descent.largest_force,
            largest_before,
            _potential_energy(forces),
            energy_before,
            tolerance,
        )
        if descent.stop_requested and not result.converged:
            raise Interrupted(f"stopped after step {result.n_steps} of the minimization", result)
    return result


def _potential_energy(forces: Forces) -> float:
    with np.errstate(all="ignore"):
        energy = forces.compute(TOTALS).potential_energy
    return energy if isfinite(energy) else inf


@kernel
def overlap(first, second):
    """Σ a·b of two (N, 3) arrays."""
    total = 0.0
    for i in range(first.shape[0]):
        x = first[i, 0] * second[i, 0]
        y = first[i, 1] * second[i, 1]
        z = first[i, 2] * second[i, 2]
        total += x + y + z
    return total


@kernel
def steer(velocities, forces, timestep, mixing, most):
    """v ← v + Δt F, v ← (1 − α) v + α |v| F/|F|; then all v are scaled by one factor so that Δt |v_i| ≤ most.

    v, F : (N, 3).
    """
    v2 = 0.0
    f2 = 0.0
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


class Descent:
    """A descent, made in place on the positions of the system of some forces.

    n_steps : made so far.
    largest_force : the largest force on an atom, projected onto the constraints [energy/length].
    stop_requested : set it to True to end after the present step.
    """

    def __init__(
        self,
        forces: Forces,
        constraint_set: ConstraintSet,
        longest_step: float,
        tolerance: float,
        max_steps: int,
    ) -> None:
        self._interactions = forces
        self._constraint_set = constraint_set
        self._longest = longest_step
        self._tolerance = tolerance
        self._max_steps = max_steps
        self._curvature = 0.0
        self._system = forces.system
        self._positions = forces.system.positions
        self._forces = np.zeros_like(self._positions)
        self._velocities = np.zeros_like(self._positions)
        self._probe = self._drawn_probe()
        # minimd's own laws have no finite force where they have no energy
        are_own = all(
            isinstance(potential, OwnPotential) and not is_user_law(getattr(potential, "law", ()))
            for potential in forces.potentials
        )
        self._detail = FORCES if are_own else TOTALS
        self.n_steps = 0
        self.largest_force = np.inf
        self.stop_requested = False

    def run(self, tell: Callable[[int], Any]) -> float:
        """Correct the constrained lengths, and descend until no force exceeds the tolerance, or for max_steps steps.

        Return the largest force at the start, infinite if atoms had to be pushed apart first.
        tell : called with the number of steps made.

        Raises NonFiniteError if energy or forces are not finite for another reason than overlaps.  ConstraintError if
        the lengths cannot be corrected, or if no step keeps them.
        """
        bonds = self._constraint_set.bonds
        n_pushes = 0
        if bonds is not None and bonds.violation(self._positions).max() > bonds.tolerance:
            bonds.project_positions(self._positions)
        while not self._evaluate():
            n_pushes += 1
            self._push_apart(n_pushes)
        before = np.inf if n_pushes else self.largest_force
        self._steepest(tell)
        if self._goes_on():
            self._fire(tell)
        return before

    def _goes_on(self) -> bool:
        return (
            self.largest_force > self._tolerance
            and self.n_steps < self._max_steps
            and not self.stop_requested
        )

    def _steepest(self, tell: Callable[[int], Any]) -> None:
        """Steepest descent, as long as the largest force decreases; its atom moves by the longest step."""
        while self._goes_on():
            before = self._positions.copy()
            forces = self._forces.copy()
            largest = self.largest_force
            if self._moved(self._forces * (self._longest / largest), 1.0) and self._evaluate():
                self.n_steps += 1
                tell(self.n_steps)
                if self.largest_force < FALLING * largest:
                    continue
            self._positions[:] = before
            self._forces[:] = forces
            self.largest_force = largest
            return

    def _fire(self, tell: Callable[[int], Any]) -> None:
        """FIRE, with the rules beside their lines; a step that constraints refuse, or that leaves the domain of the
        energy, is taken back."""
        for _ in range(FIRST_SERIES):
            self._try_curvature()
        timestep = FIRST / np.sqrt(self._curvature)
        mixing = MIXING
        downhill = 0
        refused = 0
        while self._goes_on():
            before = self._positions.copy()
            if overlap(self._forces, self._velocities) > 0.0:  # P = F·v > 0
                downhill += 1
                if downhill > DELAY:
                    # Δt ← 1.1 Δt, α ← 0.99 α
                    timestep *= FASTER
                    mixing *= LESS_MIXING
            elif self._velocities.any():  # P ≤ 0
                self._moved(self._velocities.copy(), -0.5 * timestep)  # r ← r − ½ Δt v
                # Δt ← ½ Δt, α ← ¼
                timestep *= SLOWER
                mixing = MIXING
                downhill = 0
                self._velocities[:] = 0.0  # v ← 0
            timestep = min(timestep, LONGEST / np.sqrt(self._curvature))
            # v ← v + Δt F, v ← (1 − α) v + α |v| F/|F|
            steer(self._velocities, self._forces, timestep, mixing, self._longest)
            has_moved = self._moved(self._velocities, timestep)  # r ← r + Δt v
            if has_moved and self._evaluate():
                self.n_steps += 1
                refused = 0
                tell(self.n_steps)
                if self.n_steps % PROBE_EVERY == 0:
                    self._try_curvature()
                continue
            timestep *= SLOWER
            mixing = MIXING
            downhill = 0
            refused += 1
            self._positions[:] = before
            self._velocities[:] = 0.0
            if refused > REFUSALS:
                step = f"{timestep**2 * self.largest_force:.2g} {self._system.units.length}"
                if has_moved:
                    raise NonFiniteError(
                        f"the minimization found no step that leads to a finite energy, down to one of {step}"
                    )
                raise ConstraintError(
                    f"the minimization found no step that keeps the constraints, down to one of {step}"
                )

    def _drawn_probe(self) -> Array:
        drawn = np.random.default_rng(SEED).standard_normal(self._positions.shape)
        return self._system.cell.projected(drawn)

    def _try_curvature(self) -> None:
        """Estimate κ by power iterations, which continue the last series; a lower bound keeps the first step within
        the longest."""
        before = self._positions.copy()
        forces = self._forces.copy()
        largest = self.largest_force
        shown = 0.0
        for _ in range(PROBES):
            self._constraint_set.project(self._probe, before)
            if not self._probe.any():  # no curvature at all
                self._probe = self._drawn_probe()
                break
            steps = self._probe * (PROBE * self._longest / longest(self._probe)[1])
            self._positions[:] = before + steps
            if not self._evaluate():
                shown = self._curvature
                break
            self._probe = forces - self._forces
            shown = np.sqrt(overlap(self._probe, self._probe) / overlap(steps, steps))
        self._positions[:] = before
        self._forces[:] = forces
        self.largest_force = largest
        self._curvature = max(shown, largest / self._longest)

    def _moved(self, velocities: Array, duration: float) -> bool:
        """Move all atoms, and change velocities as constraints require; False, without any motion, if constraints
        cannot be kept."""
        before = self._positions.copy()
        bonds = self._constraint_set.bonds
        try:
            if bonds is None:
                self._positions += duration * velocities
            else:
                bonds.drift(self._positions, velocities, duration)
                bonds.project_velocities(velocities, self._positions)
        except ConstraintError:
            self._positions[:] = before
            return False
        return True

    def _evaluate(self) -> bool:
        """Compute the forces, projected onto constraints and scaled to finite squares, and the largest; False, with
        the forces of before, if energy or forces are not finite."""
        try:
            sums = self._interactions.compute(self._detail)
        except RangeError:
            return False
        largest = max(sums.forces.max(), -sums.forces.min())
        energy = sums.potential_energy if sums.has_energy else 0.0
        if not np.isfinite([largest, energy]).all():
            return False
        self._forces[:] = sums.forces * min(1.0, LARGEST / max(largest, 1.0))
        self._constraint_set.project(self._forces, self._positions)
        self.largest_force = longest(self._forces)[1]
        return True

    def _push_apart(self, n_pushes: int) -> None:
        """Move the two atoms of the closest pair, whose forces are infinite, apart along their connection, each by half
        the longest step.

        If they are at the same place, all atoms that share a place with another take directions of their own, which are
        always the same; the one that moves farthest moves by half the longest step.
        """
        pair = closest_pair(self._system)
        positions = self._positions
        cell = self._system.cell
        is_hopeless = n_pushes > PUSHES or not np.isfinite(positions).all()
        if pair is None or pair.distance > self._longest or is_hopeless:
            raise NonFiniteError(self._reason())
        arm = nearest_vectors(positions, cell, np.array([pair[:2]]))[0]
        velocities = np.zeros_like(positions)
        if arm.any():
            arm /= np.abs(arm).max()  # squares of tiny numbers may be zero
            velocities[[pair.first, pair.second]] = -arm, arm
        else:
            _, place, n_there = np.unique(
                cell.wrapped(positions), axis=0, return_inverse=True, return_counts=True
            )
            shared = np.union1d(pair[:2], np.flatnonzero(n_there[place.ravel()] > 1))
            velocities[shared] = self._probe[shared]
        velocities /= longest(velocities)[1]
        self._constraint_set.project(velocities, positions)
        if not velocities.any() or not self._moved(velocities, 0.5 * self._longest):
            raise NonFiniteError(f"{self._reason()}, and constraints hold them there")

    def _reason(self) -> str:
        cause = why_not_finite(self._system, self._interactions.potentials)
        return f"energy or forces are not finite: {cause}"
