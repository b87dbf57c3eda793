"""What can be wrong with the state of an engine: numbers that no step could make,
and energies that no stable step makes."""

from collections.abc import Mapping

import numpy as np

from minimd.engine.engine import Engine
from minimd.structure.checks import LARGEST
from minimd.structure.observables import largest_component, longest

RUNAWAY = 1e4  # growth of the energies: an unstable mode passes it within a few hundred steps, a stable run never does
GROWTH = 2.0  # the same in a run that is known to have run away: states beyond it are not good
HALF = 0.5  # of the energies: if energy is exchanged and not created, the sum changes by much less


def fault_of(engine: Engine) -> str | None:
    """What is impossible about positions and velocities; None if they are possible.

    An atom that moves farther than the largest cutoff in one step has passed its neighbors unseen.
    """
    system = engine.system
    for name, array in (("positions", system.positions), ("velocities", system.velocities)):
        if not longest(array)[1] <= LARGEST:
            bad = np.flatnonzero(~(np.abs(array) <= LARGEST).all(axis=1))
            if bad.size:
                return (
                    f"{name} of {bad.size} atoms are not finite, or beyond {LARGEST:g} (atom "
                    f"{bad[0]}{' ...' if bad.size > 1 else ''})"
                )
    atom, speed = longest(system.velocities)
    distance, cutoff = speed * abs(engine.method.timestep), engine.interactions.largest_cutoff
    if distance > cutoff:
        return (
            f"atom {atom} moves {distance:.3g} {system.units.length} in one step, past every neighbor (cutoff "
            f"{cutoff:g})"
        )
    return None


def fault_at_start(engine: Engine) -> str | None:
    """What would go wrong in the first step: accelerations that are not finite or throw atoms across the scene;
    None if nothing would."""
    sizes = np.sqrt(np.einsum("ij,ij->i", engine.forces, engine.forces))
    accelerations = np.einsum(
        "i,i->i", engine.constraint_set.inverse_masses, sizes
    )  # |F|/m, without a warning of an overflow
    atom = int(np.argmax(accelerations))
    distance = float(accelerations[atom]) * engine.method.timestep**2
    if not (np.isfinite(distance) and np.isfinite(engine.interactions.potential_energy)):
        return "forces or energies are not finite"
    if distance > engine.interactions.largest_cutoff:
        return f"the force on atom {atom} would move it by {distance:.3g} {engine.system.units.length} in one step"
    return fault_of(engine)


def runaway(
    engine: Engine, first: Mapping[str, float], growth: float = RUNAWAY, since: str = "the run began"
) -> str | None:
    """That energies have grown without bound, as they do beyond the stability limit of a method; None if they have not.

        K + |U| > growth (K₀ + |U₀| + R)   and   |E − E₀| > (K + |U|) / 2,   R = Σ m (ulp(r)/Δt)²

    first : observables of an earlier frame.  since : when that was, for the sentence.
        E is the total energy minus the reservoir energy and
    work, R the energy [energy] that the rounding of positions can make in a step.
    """
    system, kinetic, potential = engine.system, engine.kinetic_energy, engine.interactions.potential_energy
    with np.errstate(over="ignore"):  # infinite for time steps that nobody needs
        rounding = system.masses.sum() * np.square(
            np.spacing(largest_component(system.positions)) / engine.method.timestep
        )
    name = "conserved_energy" if engine.has_bath else "total_energy"
    energy = kinetic + potential - engine.work - (engine.reservoir_energy if engine.has_bath else 0.0)
    start = first[name] - (0.0 if engine.has_bath else first.get("work", 0.0))
    before, now = first["kinetic_energy"] + abs(first["potential_energy"]), kinetic + abs(potential)
    if now > growth * (before + rounding) and abs(energy - start) > HALF * now:
        return (
            f"the {name.replace('_', ' ')} has gone from {start:.3g} to {energy:.3g} {system.units.energy} since "
            f"{since}"
        )
    return None
