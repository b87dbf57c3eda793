"""The two flows of a splitting, kick and drift: for numbers, for SIMD vectors, and for all atoms;
in float64 and in fixed-point arithmetic."""

import numpy as np

from minimd.compiled.fixed_point import MAGIC, MOST, as_float
from minimd.compiled.kernels import kernel, scalar
from minimd.compiled.simd import fma, select


@scalar
def kicked(velocity, force, inverse_mass, duration):
    """v + duration · F/m, for numbers or SIMD vectors."""
    return velocity + duration * inverse_mass * force


@scalar
def drifted(position, velocity, duration):
    """r + duration · v, for numbers or SIMD vectors."""
    return position + duration * velocity


@scalar
def mixed(velocity, noise, kept, scale):
    """kept · v + scale · ξ, the Ornstein-Uhlenbeck process, with scale = √(k_B T (1 − kept²)/m)."""
    return kept * velocity + scale * noise


@kernel
def kick(velocities, forces, inverse_masses, duration):
    """velocities += duration · forces / m.  (N, 3) [length/time], (N, 3) [energy/length], (N,) [1/mass], [time]."""
    for i in range(velocities.shape[0]):
        velocities[i, 0] = kicked(velocities[i, 0], forces[i, 0], inverse_masses[i], duration)
        velocities[i, 1] = kicked(velocities[i, 1], forces[i, 1], inverse_masses[i], duration)
        velocities[i, 2] = kicked(velocities[i, 2], forces[i, 2], inverse_masses[i], duration)


@kernel
def drift(positions, velocities, duration):
    """positions += duration · velocities.  (N, 3) [length], (N, 3) [length/time], [time]."""
    for i in range(positions.shape[0]):
        positions[i, 0] = drifted(positions[i, 0], velocities[i, 0], duration)
        positions[i, 1] = drifted(positions[i, 1], velocities[i, 1], duration)
        positions[i, 2] = drifted(positions[i, 2], velocities[i, 2], duration)


@scalar
def momentum_in_steps(velocity, inverse_mass, steps):
    """Momentum of an atom in steps: exactly the one from which its velocity was made, if it was.

    For numbers. Zero for a fixed atom.
    """
    return np.rint(velocity / (steps.momentum * inverse_mass)) if inverse_mass > 0.0 else 0.0


@scalar
def velocity_of(momentum, inverse_mass, steps):
    """v = p/m of a momentum in steps [length/time]."""
    return momentum * (steps.momentum * inverse_mass)


@scalar
def kicked_on_grid(momentum, impulse, inverse_mass, times):
    """p + times · impulse, in steps: exact.  momentum : float64 whole number.  impulse : int64."""
    return momentum + times * select(inverse_mass > 0.0, as_float(impulse), 0.0)


@scalar
def drifted_on_grid(position, momentum, inverse_mass, unit, times, steps):
    """r + times · (unit · p/m), with the displacement in brackets rounded to a multiple of steps.length;
    −p gives the opposite displacement."""
    rounder = MAGIC * steps.length
    return position + times * (fma(momentum, steps.momentum * unit * inverse_mass, rounder) - rounder)


@kernel
def kick_on_grid(velocities, impulses, inverse_masses, times, steps):
    """Momenta += times · impulses.  (N, 3) [length/time], (N, 3) int64 in steps, (N,) [1/mass].
    Returns whether a momentum left its range."""
    is_out = False
    for i in range(velocities.shape[0]):
        for c in range(3):
            momentum = momentum_in_steps(velocities[i, c], inverse_masses[i], steps)
            momentum = kicked_on_grid(momentum, impulses[i, c], inverse_masses[i], times)
            velocities[i, c] = velocity_of(momentum, inverse_masses[i], steps)
            is_out |= not abs(momentum) <= MOST
    return is_out


@kernel
def drift_on_grid(positions, velocities, inverse_masses, unit, times, steps):
    """positions += times · (unit · velocities), with the brackets rounded to steps.  (N, 3) [length], (N, 3)
    [length/time], (N,), [time]."""
    for i in range(positions.shape[0]):
        for c in range(3):
            momentum = momentum_in_steps(velocities[i, c], inverse_masses[i], steps)
            positions[i, c] = drifted_on_grid(positions[i, c], momentum, inverse_masses[i], unit, times, steps)
