"""Hints before the first step, about input that can be run but is hardly what was meant."""

from collections.abc import Iterator

import numpy as np

from minimd.diagnosis.hessian import unstable_bond
from minimd.diagnosis.timestep import OSCILLATION, collision_frequency, strange_depth
from minimd.engine.engine import Engine
from minimd.integrators.splitting.order_conditions import accurate_step
from minimd.neighbors.queries import closest_pair
from minimd.potentials.pair import PairPotential
from minimd.structure.observables import absolute_momentum
from minimd.structure.units import ASE, BAR

QUICK = 0.1  # of the relaxation time of a barostat, between two strains: fluctuations are then wrong by up to a tenth
CRUSHING = 0.5  # eV/Å³: 80 GPa, far more than a Lennard-Jones solid is good for
TOO_SHORT = 1e-6  # times 1/ω of a collision
MEANT = 1e-30  # likewise: a step below this is no error of the unit, somebody wants atoms that stand still
MOVING = 1e-6  # of Σ|mv|: a smaller total momentum is rounding, of files with six digits or in single precision
TOO_LONG = 3.3  # times the recommended step: six steps in a period of that mode


def hints(engine: Engine) -> Iterator[str]:
    """Sentences about energies, time step and lengths; none if there is nothing to say. The forces must be current."""
    if depth := strange_depth(engine.system, engine.interactions.potentials):
        yield depth
    elif hint := too_long_a_step(engine):
        yield f"{hint}; see advise_timestep, and check the unit of the time step"
    elif hint := _short_timestep(engine):
        yield hint
    yield from _no_pair_in_reach(engine)
    yield from _barostat(engine)
    yield from _moving_center(engine)


def too_long_a_step(engine: Engine) -> str | None:
    """A clause if the time step is longer than a harmonic bond allows, or far longer than suits Lennard-Jones atoms,
    else None; of ε if so."""
    return (
        strange_depth(engine.system, engine.interactions.potentials) or unstable_bond(engine) or _long_timestep(engine)
    )


def _barostat(engine: Engine) -> Iterator[str]:
    """Hints if a barostat acts too seldom for its relaxation time, or if its pressure, in eV/Å³,
    is a number in bar or so."""
    barostat, units, shown = engine.barostat, engine.system.units, engine.system.units.shown
    if barostat is None:
        return
    if barostat.every * engine.method.timestep > QUICK * barostat.relaxation_time:
        yield (
            f"the barostat acts every {barostat.every} steps, {shown(barostat.every * engine.method.timestep)}, which "
            "is too long for its "
            f"relaxation_time {shown(barostat.relaxation_time)}: the volume fluctuates too much; take a "
            f"relaxation_time of at least {1.0 / QUICK:g} such intervals, or a smaller every"
        )
    if units == ASE and abs(barostat.pressure) > CRUSHING:
        meant = f"if {barostat.pressure:g} bar is meant, give {barostat.pressure:g} * md.units.BAR"
        yield (
            f"pressure {barostat.pressure:g} {units.pressure} is {barostat.pressure / BAR:.2g} bar; {meant}, and the "
            "compressibility per BAR"
        )


def _moving_center(engine: Engine) -> Iterator[str]:
    """A hint if the center of mass moves, and its motion is no degree of freedom."""
    system, units, speed = engine.system, engine.system.units, float(np.linalg.norm(engine.drift))
    if speed * system.masses.sum() > MOVING * absolute_momentum(system.velocities, system.masses):
        yield (
            f"the center of mass moves at {speed / units.to_picosecond:.3g} {units.length}/{units.shown_time}: "
            "temperature, pressure, diffusion and viscosity are relative to it; sim.velocities -= sim.drift stops it"
        )


def _short_timestep(engine: Engine) -> str | None:
    """A hint if Lennard-Jones atoms would hardly move in a year of steps."""
    system, timestep = engine.system, abs(engine.method.timestep)
    held = engine.constraint_set.bonds.pairs if engine.constraint_set.bonds else system.bonds[:0]
    share = timestep * collision_frequency(system, engine.interactions.potentials, held, at_rest=True)
    if not MEANT < share < TOO_SHORT:
        return None
    meant = ", such as 5 * md.units.fs" if system.units == ASE else ""
    return (
        f"timestep {system.units.shown(timestep)} is {share:.0e} of the time in which Lennard-Jones atoms collide: "
        f"check its unit{meant}"
    )


def _long_timestep(engine: Engine) -> str | None:
    """A hint if collisions of Lennard-Jones atoms are faster than the method can follow: for atoms of a liquid;
    the step told is for their heat."""
    system, method, potentials = engine.system, engine.method, engine.interactions.potentials
    held = engine.constraint_set.bonds.pairs if engine.constraint_set.bonds else system.bonds[:0]
    fastest = collision_frequency(system, potentials, held, at_rest=True)
    if not fastest * abs(method.timestep) > TOO_LONG * OSCILLATION**0.5:
        return None  # spares usual steps the search for what the method can do
    step = accurate_step(method.sequence(), OSCILLATION)
    if abs(method.timestep) <= TOO_LONG * step / fastest:
        return None
    recommended = step / collision_frequency(system, potentials, held)
    shown = system.units.shown
    return (
        f"timestep {shown(abs(method.timestep))} is long for Lennard-Jones atoms as light as these: in a liquid "
        f"{method.name} conserves the energy well up to {shown(recommended)}"
    )


def _no_pair_in_reach(engine: Engine) -> Iterator[str]:
    """A hint if no pair interacts, as when lengths of the potential and of the positions have different units."""
    system, potentials = engine.system, engine.interactions.potentials
    cutoffs = [one.cutoff for one in potentials if isinstance(one, PairPotential) and np.isfinite(one.cutoff)]
    if not cutoffs or engine.interactions.potential_energy != 0.0 or engine.forces.any():
        return
    closest = closest_pair(system)
    if closest is not None and closest.distance > max(cutoffs):
        unit = system.units.length
        yield (
            f"no two atoms are within the cutoff, {max(cutoffs):g} {unit}: the closest, {closest.first} and "
            f"{closest.second}, are {closest.distance:.3g} {unit} apart; are the lengths of the potential in {unit}?"
        )
