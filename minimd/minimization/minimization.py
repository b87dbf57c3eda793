"""Minimization of the potential energy to a nearby minimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from minimd.console.display import Displayed
from minimd.console.progress import progress_of
from minimd.console.signals import stop_on_signals
from minimd.constraints.constraint_set import ConstraintSet
from minimd.forces.forces import Forces, Potential
from minimd.minimization.fire import FIRE
from minimd.potentials.term import TOTALS
from minimd.structure.checks import checked_count, checked_number
from minimd.structure.constraints import Constraint
from minimd.structure.errors import Interrupted
from minimd.structure.system import AnySystem, System

FORCE_TOLERANCE = 1e-6  # [energy/length], in reduced units and in eV/Å
MAX_STEPS = 10_000
MAX_STEP_LENGTH = 0.1  # [length], in σ and in Å


@dataclass(frozen=True)
class Minimization(Displayed):
    """The result of a minimization; print it.

    Attributes
    ----------
    system : System, the final state.  converged : whether largest_force is within the tolerance.
    n_steps : number of steps.  n_evaluations : number of force evaluations.
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
    ConstraintError : if constraints cannot be kept.  TypeError, ValueError : as Simulation.
    KeyboardInterrupt : after Ctrl-C; its attribute result is the Minimization so far.

    E. Bitzek et al., Phys. Rev. Lett. 97, 170201 (2006); J. Guénolé et al., Comput. Mater. Sci. 175, 109584 (2020).
    """
    system = system.copy() if isinstance(system, System) else System.from_ase(system)
    constraint_set = ConstraintSet(system, system.constraints if constraints is None else constraints)
    forces = Forces(system, potentials)
    return minimized(forces, constraint_set, force_tolerance, max_steps, max_step_length, progress)


def minimized(
    forces: Forces,
    constraint_set: ConstraintSet,
    force_tolerance: float,
    max_steps: int,
    max_step_length: float,
    progress: bool | None,
) -> Minimization:
    """Minimize the system of some forces in place; see minimize."""
    force_tolerance = checked_number("force_tolerance", force_tolerance, "positive and finite")
    max_step_length, max_steps = (
        checked_number("max_step_length", max_step_length, "positive and finite"),
        checked_count("max_steps", max_steps, 0),
    )
    system, evaluated, energy_before = forces.system, forces.n_evaluations, _potential_energy(forces)
    constraint_set.fit(system)
    descent = FIRE(forces, constraint_set.with_equal_masses(system), max_step_length)
    with progress_of(max_steps, "minimizing", progress) as tell, stop_on_signals(descent):
        largest_before = descent.begin()
        descent.run(force_tolerance, max_steps, tell)
        constraint_set.project(system.velocities, system.positions)
        result = Minimization(
            system=system,
            converged=descent.largest_force <= force_tolerance,
            n_steps=descent.n_steps,
            n_evaluations=forces.n_evaluations - evaluated + 1,
            largest_force=descent.largest_force,
            largest_force_before=largest_before,
            potential_energy=_potential_energy(forces),
            potential_energy_before=energy_before,
            force_tolerance=force_tolerance,
        )
        if descent.stop_requested and not result.converged:
            raise Interrupted(f"stopped after step {result.n_steps} of the minimization", result)
    return result


def _potential_energy(forces: Forces) -> float:
    with np.errstate(all="ignore"):
        forces.compute(TOTALS)
        energy = forces.potential_energy
    return energy if isfinite(energy) else inf
