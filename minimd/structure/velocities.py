"""Initial velocities: Maxwell-Boltzmann distributed, with total momentum zero and exactly the given temperature."""

import numpy as np

from minimd.structure.checks import checked_count, checked_number
from minimd.structure.observables import Array, center, degrees_of_freedom, kinetic_energy, temperature, thermal_energy

SEEDS = 2**128


def maxwell_boltzmann(masses: Array, target: float, k_B: float = 1.0, seed: int | None = None) -> Array:
    """Normally distributed velocities, (N, 3), with total momentum zero and kinetic temperature exactly the target.

    Each component has variance k_B T/m before the mean motion is removed and the rest rescaled.
    masses : (N,).  target : T ≥ 0 [temperature].  seed : of numpy's PCG64; None for a new draw each time.

    Raises ValueError if the target is negative or not finite, or the seed is not a whole number.
    """
    target = checked_number("temperature", target, "finite and not negative")
    draw = np.random.default_rng(None if seed is None else checked_count("seed", seed, 0, SEEDS)).standard_normal(
        (len(masses), 3)
    )
    velocities = draw * np.sqrt(k_B * target / masses)[:, None]
    velocities -= center(velocities, masses)
    n_dof = degrees_of_freedom(len(masses))
    return rescaled(velocities, masses, target, k_B, n_dof, np.zeros(3)) if target > 0.0 else velocities


def rescaled(velocities: Array, masses: Array, target: float, k_B: float, n_dof: int, drift: Array) -> Array:
    """V + √(T_target/T) (v − V): kinetic temperature exactly the target, (N, 3).  drift : V; scaled, too, if only
    rounding. Raises ValueError if the target is negative or not finite, or nothing moves, except all atoms alike."""
    target = checked_number("temperature", target, "finite and not negative")
    kinetic = kinetic_energy(velocities, masses)
    thermal = thermal_energy(kinetic, drift, masses)
    if thermal == 0.0:
        raise ValueError(
            "velocities are all zero or all the same and cannot be rescaled; draw them with set_temperature"
        )
    factor = np.sqrt(target / temperature(thermal, n_dof, k_B))
    return velocities * factor if thermal == kinetic else drift + (velocities - drift) * factor
