"""What can be wrong with a state, said in words: which atoms, how far, which pair is the first suspect."""

from collections.abc import Mapping
from math import sqrt

import numpy as np

from minimd.compiled.kernels import kernel
from minimd.diagnosis.hessian import StiffBond
from minimd.integrators.splitting.linear_stability import stability_limit
from minimd.integrators.splitting.splitting import Splitting
from minimd.neighbors.queries import closest_pair
from minimd.structure.observables import longest
from minimd.structure.system import LARGEST, System

RUNAWAY = 1e4  # a growth of the energies that no time step below the limit of stability explains
HALF = 0.5  # of the energies: where they are exchanged, and not made, their sum changes by much less


@kernel
def largest_acceleration(forces, inverse_masses):
    """Index and size of the largest F/m, as longest.  (N, 3) [energy/length], (N,) [1/mass]."""
    where, largest = 0, -1.0
    for i in range(forces.shape[0]):
        size = inverse_masses[i] * sqrt(forces[i, 0] ** 2 + forces[i, 1] ** 2 + forces[i, 2] ** 2)
        if not size < np.inf:
            return i, np.inf
        if size > largest:
            where, largest = i, size
    return where, largest


def fault_of(system: System, timestep: float, longest_stride: float) -> str | None:
    """What is impossible about positions and velocities; None if they are possible.

    longest_stride : the largest cutoff [length]; an atom that moves farther in one step has passed its neighbors unseen.
    """
    for name in ("positions", "velocities"):
        if not longest(getattr(system, name))[1] <= LARGEST:
            bad = np.flatnonzero(~(np.abs(getattr(system, name)) <= LARGEST).all(axis=1))
            if bad.size:
                return f"{name} of {bad.size} atoms are not finite, or beyond {LARGEST:g} (atom {bad[0]}{' ...' if bad.size > 1 else ''})"
    atom, speed = longest(system.velocities)
    stride = speed * abs(timestep)
    if stride > longest_stride:
        return f"atom {atom} moves {stride:.3g} {system.units.length} in one step, past every neighbor (cutoff {longest_stride:g})"
    return None


def fault_at_start(
    system: System,
    acceleration: tuple[int, float],
    potential_energy: float,
    timestep: float,
    longest_stride: float,
) -> str | None:
    """What would go wrong in the first step: accelerations that are not finite or throw atoms across the scene.

    acceleration : the atom with the largest, and its size [length/time²].
    """
    atom, push = acceleration[0], acceleration[1] * timestep**2
    if not (np.isfinite(push) and np.isfinite(potential_energy)):
        return "forces or energies are not finite"
    if push > longest_stride:
        return f"the force on atom {atom} would move it by {push:.3g} {system.units.length} in one step"
    return fault_of(system, timestep, longest_stride)


def runaway(system: System, timestep: float, first: Mapping[str, float], now: Mapping[str, float]) -> str | None:
    """What a method does beyond its limit of stability: energies grow without bound. None if they do not.

        K + |U| > RUNAWAY (K₀ + |U₀| + R)   and   |E − E₀| > (K + |U|) / 2,   R = Σ m (ulp(r)/Δt)²

    first, now : observables of two frames.  E is the total energy, minus what a thermostat has put in; R is the energy [energy] that the
    rounding of positions can make in a step.
    """
    name = "conserved_energy" if "conserved_energy" in now else "total_energy"
    before, after = (frame["kinetic_energy"] + abs(frame["potential_energy"]) for frame in (first, now))
    rounding = float(system.masses.sum()) * (float(np.spacing(np.abs(system.positions).max())) / timestep) ** 2
    if after > RUNAWAY * (before + rounding) and abs(now[name] - first[name]) > HALF * after:
        return f"the {name.replace('_', ' ')} has gone from {first[name]:.3g} to {now[name]:.3g} {system.units.energy} since the run began"
    return None


def failure_sentence(system: System, fault: str, step: int, timestep: float, last_good_step: int) -> str:
    """The fault with its circumstances, one sentence for an error; system is in the last good state."""
    units, pair = system.units, closest_pair(system)
    return (
        f"{fault}, at step {step}; {f'the closest pair before it is {pair}: overlapping atoms, or ' if pair else ''}timestep "
        f"{timestep * units.to_picosecond * units.shown_small_time:g} {units.small_time} too large; "
        f"minimize moves atoms apart, advise_timestep tells how large it may be. "
        f"The system holds the last good state, that of step {last_good_step}"
    )


def broken_constraint(system: System, reason: ArithmeticError, step: int, timestep: float, last_good_step: int) -> str:
    """A constraint that could not be kept, with its circumstances; system is in the last good state."""
    units, pair = system.units, closest_pair(system)
    return (
        f"{reason}, at step {step}; reduce the timestep ({timestep * units.to_picosecond * units.shown_small_time:g} {units.small_time})"
        f"{f', or look for overlapping atoms: the closest pair is {pair}' if pair else ''}. "
        f"The system holds the last good state, that of step {last_good_step}"
    )


def unstable_bond(system: System, bond: StiffBond | None, method: Splitting) -> str | None:
    """That a time step is longer than a harmonic bond allows, in a sentence; None if it is not. Other forces may allow still less."""
    if bond is None:
        return None
    limit = stability_limit(method.sequence()) / sqrt(bond.square)
    if abs(method.timestep) <= limit:
        return None
    units = system.units
    shown = units.to_picosecond * units.shown_small_time
    return (
        f"timestep {abs(method.timestep) * shown:.4g} {units.small_time} is longer than the bond of atoms {bond.i} and {bond.j} allows: "
        f"{method.name} is stable up to {limit * shown:.4g} {units.small_time} on it; see advise_timestep"
    )
