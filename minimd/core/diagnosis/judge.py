"""One judge of a scene: hints before a run, faults during it, and energies that have run away."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from minimd.core.diagnosis.evidence import Evidence
from minimd.core.diagnosis.rules import Verdicts, before, during, long_steps
from minimd.core.engine.engine import Engine
from minimd.core.structure.observables import largest_component

# growth of the energies: an unstable mode passes it within a few hundred steps, a stable run never does
RUNAWAY = 1e4
GROWTH = 2.0  # the same in a run that is known to have run away: states beyond it are not good
HALF = 0.5  # of the energies: if energy is exchanged and not created, the sum changes by much less


def hints(engine: Engine) -> Iterator[str]:
    """Sentences about energies, time step and lengths; none if there is nothing to say. The forces must be current."""
    return map(str, before(Evidence(engine)))


def too_long_a_step(engine: Engine) -> str | None:
    """A clause if the time step is beyond or close to the limit of the harmonic bonds and angles, or far longer than
    suits Lennard-Jones atoms; of ε if that is in another unit. None if neither."""
    verdict = next(long_steps(Evidence(engine)), None)
    return None if verdict is None else verdict.cause


def fault_of(engine: Engine, *when: Callable[[Evidence], Verdicts]) -> str | None:
    """What is impossible about positions and velocities; None if they are possible.
    when : at_start to ask for the first step, too."""
    evidence = Evidence(engine)
    faults = (verdict.cause for rules in (*when, during) for verdict in rules(evidence))
    return next(faults, None)


def runaway(
    engine: Engine,
    first: Mapping[str, float],
    growth: float = RUNAWAY,
    since: str = "the run began",
) -> str | None:
    """That energies have grown without bound, as they do beyond the stability limit of a method; None if they have not.

        K + |U| > growth (K₀ + |U₀| + Q + R)   and   |E − E₀| > (K + |U|) / 2,   R = Σ m (ulp(r)/Δt)²

    first : observables of an earlier frame.
    since : when that was, for the sentence.
    E is the total energy minus the reservoir energy and work, Q what a bath gives to atoms at rest, n_dof k_B T, R the
    energy [energy] that the rounding of positions can make in a step."""
    system = engine.system
    kinetic = engine.kinetic_energy
    potential = engine.potential_energy
    with np.errstate(over="ignore"):  # infinite for time steps that nobody needs
        pace = np.spacing(largest_component(system.positions)) / engine.method.stride
        rounding = system.masses.sum() * np.square(pace)
    energy = kinetic + potential - engine.work
    if engine.has_bath:
        name = "conserved energy"
        start = first["conserved_energy"]
        energy -= engine.reservoir_energy
    else:
        name = "total energy"
        start = first["total_energy"] - first.get("work", 0.0)
    earlier = first["kinetic_energy"] + abs(first["potential_energy"])
    now = kinetic + abs(potential)
    if not now > growth * (earlier + rounding):
        return None
    heat = 0.0
    if engine.has_bath:
        heat = engine.n_dof * system.units.k_B * (engine.bath_settings[0] or 0.0)
    if now > growth * (earlier + heat + rounding) and abs(energy - start) > HALF * now:
        change = f"from {start:.3g} to {energy:.3g} {system.units.energy}"
        return f"the {name} has gone {change} since {since}"
    return None
