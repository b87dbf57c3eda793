"""Hints before the first step: what can be run, and is hardly what was meant."""

from collections.abc import Iterator
from math import sqrt

import numpy as np

from minimd.diagnosis.hessian import unstable_bond
from minimd.engine.engine import Engine
from minimd.integrators.splitting.linear_stability import accurate_step
from minimd.neighbors.queries import closest_pair
from minimd.potentials.laws import LennardJonesLaw
from minimd.potentials.pair import PairPotential

OSCILLATION = 1.0 / 80.0  # of the energy of a mode: 20 velocity Verlet steps a period, as advise_timestep recommends
CROWDED = 3.0  # times stiffer than a pair at rest is the stiffest mode of a liquid: 2.5 at the triple point, 3 in the melt
TOO_LONG = 2.0  # of the recommended step


def hints(engine: Engine) -> Iterator[str]:
    """Sentences about time step and lengths; none if there is nothing to say. The forces must be current."""
    if hint := unstable_bond(engine) or _long_timestep(engine):
        yield hint
    yield from _no_pair_in_reach(engine)


def _long_timestep(engine: Engine) -> str | None:
    """That collisions of Lennard-Jones atoms are faster than the method can follow.

    ω = √(u″/μ) of a pair at rest, u″ = 72 ε / (2^(1/3) σ²), times CROWDED.
    """
    system, method = engine.system, engine.method
    lightest = np.array([system.masses[system.species_index == k].min() for k in range(len(system.species_names))])
    fastest = 0.0
    for potential in engine.interactions.potentials:
        if isinstance(potential, PairPotential) and isinstance(potential.plain_law, LennardJonesLaw):
            table = potential.table(system.species_names)
            inverse = 1.0 / (lightest if len(table) > 1 else lightest.min(keepdims=True))
            squares = 72.0 * table[..., -2] / (2.0 ** (1.0 / 3.0) * table[..., -1] ** 2) * (inverse[:, None] + inverse[None, :])
            fastest = max(fastest, CROWDED * sqrt(squares.max()))
    if not fastest * abs(method.timestep) > TOO_LONG * OSCILLATION**0.5:
        return None  # for any method
    recommended = accurate_step(method.sequence(), OSCILLATION) / fastest
    if abs(method.timestep) <= TOO_LONG * recommended:
        return None
    shown = system.units.shown
    return (
        f"timestep {shown(abs(method.timestep))} is long for Lennard-Jones atoms as light as these: in a liquid {method.name} "
        f"conserves the energy well up to {shown(recommended)}; see advise_timestep, and the unit of the time step"
    )


def _no_pair_in_reach(engine: Engine) -> Iterator[str]:
    """That no pair interacts, as where lengths of the potential and of the positions have different units."""
    system, potentials = engine.system, engine.interactions.potentials
    cutoffs = [one.cutoff for one in potentials if isinstance(one, PairPotential) and np.isfinite(one.cutoff)]
    if not cutoffs or len(system) < 2 or engine.interactions.potential_energy != 0.0 or engine.forces.any():
        return
    closest = closest_pair(system)
    if closest is not None and closest.distance > max(cutoffs):
        unit = system.units.length
        yield (
            f"no two atoms are within the cutoff, {max(cutoffs):g} {unit}: the closest, {closest.first} and {closest.second}, are "
            f"{closest.distance:.3g} {unit} apart; are the lengths of the potential in {unit}?"
        )
