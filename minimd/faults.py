"""What can be wrong with a state, said in words: which atoms, how far, which pair is the first suspect."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from minimd.curvature import StiffBond
from minimd.integrators.splitting import Splitting
from minimd.integrators.stability import stability_limit
from minimd.neighbors.closest import closest_pair
from minimd.system import System


def fault_of(system: System, timestep: float, longest_stride: float) -> str | None:
    """What is impossible about positions and velocities; None if they are possible.

    longest_stride : the largest cutoff [length]; an atom that moves farther in one step has passed its neighbors unseen.
    """
    for name in ("positions", "velocities"):
        bad = np.flatnonzero(~np.isfinite(getattr(system, name)).all(axis=1))
        if bad.size:
            return f"{name} of {bad.size} atoms are not finite (atom {bad[0]}{' ...' if bad.size > 1 else ''})"
    strides = _lengths(system.velocities) * abs(timestep)
    if strides.max() > longest_stride:
        atom = int(np.argmax(strides))
        return f"atom {atom} moves {strides[atom]:.3g} {system.units.length} in one step, past every neighbor (cutoff {longest_stride:g})"
    return None


def fault_at_start(
    system: System,
    accelerations: NDArray[np.float64],
    potential_energy: float,
    timestep: float,
    longest_stride: float,
) -> str | None:
    """What would go wrong in the first step: accelerations, (N, 3) [length/time²], that are not finite or throw atoms across the scene."""
    push = _lengths(accelerations) * timestep**2
    if not (np.isfinite(push).all() and np.isfinite(potential_energy)):
        return "forces or energies are not finite"
    if push.max() > longest_stride:
        atom = int(np.argmax(push))
        return f"the force on atom {atom} would move it by {push[atom]:.3g} {system.units.length} in one step"
    return fault_of(system, timestep, longest_stride)


def autopsy(system: System, fault: str, step: int, timestep: float, last_good_step: int) -> str:
    """The fault with its circumstances, one sentence for an error; system is in the last good state."""
    units = system.units
    return (
        f"{fault}, at step {step}; the closest pair before it is {closest_pair(system)}: overlapping atoms, or timestep "
        f"{timestep * units.to_picosecond * units.shown_small_time:g} {units.small_time} too large; "
        f"minimize moves atoms apart, advise_timestep tells how large it may be. "
        f"The system holds the last good state, that of step {last_good_step}"
    )


def broken_constraint(system: System, reason: ArithmeticError, step: int, timestep: float, last_good_step: int) -> str:
    """A constraint that could not be kept, with its circumstances; system is in the last good state."""
    units = system.units
    return (
        f"{reason}, at step {step}; reduce the timestep ({timestep * units.to_picosecond * units.shown_small_time:g} {units.small_time}), "
        f"or look for overlapping atoms: the closest pair is {closest_pair(system)}. "
        f"The system holds the last good state, that of step {last_good_step}"
    )


def unstable_bond(system: System, bond: StiffBond | None, method: Splitting) -> str | None:
    """That a time step is longer than a harmonic bond allows, in a sentence; None if it is not. Other forces may allow still less."""
    if bond is None:
        return None
    limit = stability_limit(method.row()) / sqrt(bond.square)
    if abs(method.timestep) <= limit:
        return None
    units = system.units
    shown = units.to_picosecond * units.shown_small_time
    return (
        f"timestep {abs(method.timestep) * shown:.4g} {units.small_time} is longer than the bond of atoms {bond.i} and {bond.j} allows: "
        f"{method.name} is stable up to {limit * shown:.4g} {units.small_time} on it; see advise_timestep"
    )


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
