"""Initial velocities: Maxwell-Boltzmann distributed, with total momentum zero and exactly the given temperature."""

import numpy as np

from minimd.structure.checks import checked_count, checked_number
from minimd.structure.observables import Array, degrees_of_freedom, kinetic_energy, momentum, temperature

SEEDS = 2**128


def maxwell_boltzmann(masses: Array, target: float, k_B: float = 1.0, seed: int | None = None) -> Array:  # noqa: N803
    """Normally distributed velocities, (N, 3), with total momentum zero and kinetic temperature exactly the target.

    Each component has variance k_B T/m before the mean motion is removed and the rest rescaled.
    masses : (N,).  target : T ≥ 0 [temperature].  seed : of numpy's PCG64; None for a new draw each time.

    Raises ValueError if the target is negative or not finite, or the seed is not a whole number.
    """
    target = checked_number("temperature", target, "finite and not negative")
    draw = np.random.default_rng(None if seed is None else checked_count("seed", seed, 0, SEEDS)).standard_normal((len(masses), 3))
    velocities = draw * np.sqrt(k_B * target / masses)[:, None]
    if len(masses) > 1:
        velocities = without_momentum(velocities, masses)
    return rescaled(velocities, masses, target, k_B) if target > 0.0 else velocities


def without_momentum(velocities: Array, masses: Array) -> Array:
    """Velocities relative to the center of mass, (N, 3)."""
    return velocities - momentum(velocities, masses) / masses.sum()


def rescaled(velocities: Array, masses: Array, target: float, k_B: float = 1.0, n_dof: int | None = None) -> Array:  # noqa: N803
    """Velocities times √(T_target/T): kinetic temperature exactly the target, (N, 3).  n_dof : 3N − 3 if not given.

    Raises ValueError if the target is negative or not finite, or nothing moves.
    """
    target = checked_number("temperature", target, "finite and not negative")
    now = temperature(kinetic_energy(velocities, masses), n_dof or degrees_of_freedom(len(masses)), k_B)
    if now == 0.0:
        raise ValueError("velocities are all zero and cannot be rescaled; draw them with set_temperature")
    return velocities * np.sqrt(target / now)
