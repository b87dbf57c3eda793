"""What can be measured on a state: energies, temperature, pressure, linear and angular momentum.

Sums are compiled: they need no memory, and no threads of BLAS,
which would spin for a while on the cores that the forces need.
velocities, positions : (N, 3).  masses : (N,).
"""

from math import sqrt
from typing import TypeVar

import numpy as np

from minimd.core.compiled.fixed_point import on_grid, sum_in_any_order
from minimd.core.compiled.kernels import kernel, scalar
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count, checked_number

Numbers = TypeVar("Numbers", float, Array)
# of the kinetic energy: if less than this is relative to the center of mass, it is only rounding
AT_REST = 1e-12


@scalar
def kinetic_energy_of(mass, vx, vy, vz):
    """½ m v² of one atom [energy]."""
    return 0.5 * mass * (vx**2 + vy**2 + vz**2)


@kernel
def kinetic_energy(velocities, masses, step=0.0):
    """K = Σ ½ m v² [energy].
    step : each atom's share is rounded to a multiple of it, so that their order does not
    matter; 0 for no rounding."""
    total = 0.0
    for i in range(velocities.shape[0]):
        total += on_grid(
            kinetic_energy_of(masses[i], velocities[i, 0], velocities[i, 1], velocities[i, 2]), step
        )
    return total


def leaves_out_center(n_atoms: int, conserves_momentum: bool) -> bool:
    """Whether the center of mass is no degree of freedom: where the total momentum is constant, but for a single atom.
    What degrees_of_freedom leaves out, all thermal quantities leave out, from temperature to displacements: see center.
    """
    return conserves_momentum and n_atoms > 1


def degrees_of_freedom(
    n_atoms: int, n_constraints: int = 0, conserves_momentum: bool = True, dimensions: int = 3
) -> int:
    """dN − d − n_constraints if leaves_out_center, else dN − n_constraints, in d dimensions.
    n_atoms : without those held fixed.
    Raises ValueError if none is left."""
    n_moving = n_atoms - leaves_out_center(n_atoms, conserves_momentum)
    n_dof = dimensions * n_moving - n_constraints
    if n_dof <= 0:
        raise ValueError(
            f"no degree of freedom is left for {n_atoms} atoms with {n_constraints} constraints"
        )
    return n_dof


def center(vectors: Array, masses: Array, conserves_momentum: bool = True) -> Array:
    """What to subtract from positions or velocities: Σ m r / Σ m if leaves_out_center, else 0; (3,)."""
    if leaves_out_center(len(masses), conserves_momentum):
        return np.asarray(momentum(vectors, masses) / sum_in_any_order(masses))
    return np.zeros(3)


def thermal_energy(kinetic: float, drift: Array, masses: Array) -> float:
    """½ Σ m (v − V)² = K − ½ V² Σ m [energy]; 0 if what is left of K is only rounding.
    drift : V, center of velocities."""
    left = kinetic - 0.5 * float(sum_in_any_order(masses)) * float((drift * drift).sum())
    return 0.0 if left <= AT_REST * kinetic else left


def temperature(kinetic: Numbers, n_dof: Numbers, k_B: float = 1.0) -> Numbers:
    """Kinetic temperature T = 2K / (n_dof k_B), of numbers or arrays.
    kinetic : see thermal_energy.
    n_dof : see degrees_of_freedom."""
    return 2.0 * kinetic / (n_dof * k_B)


def pressure(kinetic: float, virial: Array, volume: float, dimensions: int = 3) -> float:
    """P = (2K + tr W) / dV [energy/length^d] in d dimensions, with W = Σ f r_ij ⊗ r_ij, (3, 3).
    M. P. Allen, D. J. Tildesley, Computer Simulation of Liquids, 2nd ed. (2017), eq. 2.60-2.61."""
    return (2.0 * kinetic + float(np.trace(virial))) / (dimensions * volume)


def stress(velocities: Array, masses: Array, virial: Array, volume: float) -> Array:
    """σ = −(Σ m v ⊗ v + W) / V [energy/length³], (3, 3), positive under tension; the pressure is −tr σ / 3.
    M. P. Allen, D. J. Tildesley, as for pressure, eq. 2.112, where the sign is that of a pressure."""
    return np.asarray(-(momentum_flux(velocities, masses) + virial) / volume)


@kernel
def momentum(velocities, masses, step=0.0):
    """P = Σ m v [mass length/time], (3,).
    step : as for kinetic_energy; with that of a Grid, the sum is exact."""
    px = py = pz = 0.0
    for i in range(masses.size):
        px += on_grid(masses[i] * velocities[i, 0], step)
        py += on_grid(masses[i] * velocities[i, 1], step)
        pz += on_grid(masses[i] * velocities[i, 2], step)
    return np.array([px, py, pz])


@kernel
def momentum_flux(velocities, masses):
    """Σ m v ⊗ v [energy], (3, 3)."""
    xx = yy = zz = yz = xz = xy = 0.0
    for i in range(masses.size):
        x, y, z = velocities[i, 0], velocities[i, 1], velocities[i, 2]
        xx, yy, zz = xx + masses[i] * x * x, yy + masses[i] * y * y, zz + masses[i] * z * z
        yz, xz, xy = yz + masses[i] * y * z, xz + masses[i] * x * z, xy + masses[i] * x * y
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@kernel
def pressure_tensor(velocities, masses, virial, volume):
    """P = (Σ m v ⊗ v + W) / V [energy/length³], (3, 3)."""
    return (momentum_flux(velocities, masses) + virial) / volume


@kernel
def absolute_momentum(velocities, masses):
    """Σ |m v| [mass length/time]: the scale with which a change of the total momentum is compared."""
    total = 0.0
    for i in range(masses.size):
        total += masses[i] * sqrt(
            velocities[i, 0] ** 2 + velocities[i, 1] ** 2 + velocities[i, 2] ** 2
        )
    return total


@kernel
def longest(vectors):
    """Index and length of the longest of (N, 3) vectors.
    If vectors are not finite: index of the first of them, and infinity."""
    where = 0
    longest2 = -1.0
    for i in range(vectors.shape[0]):
        length2 = vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2
        if not length2 < np.inf:
            return i, np.inf
        if length2 > longest2:
            where = i
            longest2 = length2
    return where, sqrt(longest2)


def largest_component(vectors: Array) -> float:
    """The largest |x| of all numbers in an array, of any shape; NaN if one of them is."""
    return float(np.maximum(vectors.max(), -vectors.min()))


@kernel
def angular_momentum(positions, velocities, masses):
    """L = Σ m r × v about the origin [mass length²/time], (3,); constant only if nothing is periodic."""
    lx = ly = lz = 0.0
    for i in range(masses.size):
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        vx, vy, vz = velocities[i, 0], velocities[i, 1], velocities[i, 2]
        lx += masses[i] * (y * vz - z * vy)
        ly += masses[i] * (z * vx - x * vz)
        lz += masses[i] * (x * vy - y * vx)
    return np.array([lx, ly, lz])


def absolute_angular_momentum(positions: Array, velocities: Array, masses: Array) -> float:
    """Σ m |r − r_cm| |v| [mass length²/time]: the scale with which a change of the angular momentum is compared."""
    center = momentum(positions, masses) / masses.sum()  # r_cm = Σ m r / Σ m: the same sum
    return _absolute_moments(positions, velocities, masses, center)


@kernel
def _absolute_moments(positions, velocities, masses, center):
    total = 0.0
    for i in range(masses.size):
        x = positions[i, 0] - center[0]
        y = positions[i, 1] - center[1]
        z = positions[i, 2] - center[2]
        speed2 = velocities[i, 0] ** 2 + velocities[i, 1] ** 2 + velocities[i, 2] ** 2
        total += masses[i] * sqrt((x**2 + y**2 + z**2) * speed2)
    return total


SEEDS = 2**128


def maxwell_boltzmann(
    masses: Array, target: float, k_B: float = 1.0, seed: int | None = None, dimensions: int = 3
) -> Array:
    """Normally distributed velocities, (N, 3), with total momentum zero and kinetic temperature exactly the target.

    Each component has variance k_B T/m before the mean motion is removed and the rest rescaled.
    masses : (N,); atoms of mass 0 stay at rest.
    target : T ≥ 0 [temperature].
    seed : of numpy's PCG64; None for a new draw each time.
    Raises ValueError if the target is negative or not finite, or the seed is not a whole number."""
    target = checked_number("temperature", target, "finite and not negative")
    generator = np.random.default_rng(
        None if seed is None else checked_count("seed", seed, 0, SEEDS)
    )
    has_mass = masses > 0.0
    squares = np.divide(k_B * target, masses, out=np.zeros(len(masses)), where=has_mass)
    velocities = np.zeros((len(masses), 3))
    drawn = generator.standard_normal((len(masses), dimensions))
    velocities[:, :dimensions] = drawn * np.sqrt(squares)[:, None]
    velocities -= center(velocities, masses) * has_mass[:, None]
    n_dof = degrees_of_freedom(int(has_mass.sum()), dimensions=dimensions)
    return (
        rescaled(velocities, masses, target, k_B, n_dof, np.zeros(3))
        if target > 0.0
        else velocities
    )


def rescaled(
    velocities: Array, masses: Array, target: float, k_B: float, n_dof: int, drift: Array
) -> Array:
    """V + √(T_target/T) (v − V): kinetic temperature exactly the target, (N, 3).
    drift : V; scaled, too, if only rounding. Raises ValueError if the target is negative or not finite, or nothing
        moves, except all atoms alike."""
    target = checked_number("temperature", target, "finite and not negative")
    kinetic = kinetic_energy(velocities, masses)
    thermal = thermal_energy(kinetic, drift, masses)
    if thermal == 0.0:
        raise ValueError(
            "velocities are all zero or all alike and cannot be rescaled; draw them with set_temperature"
        )
    factor = np.sqrt(target / temperature(thermal, n_dof, k_B))
    return velocities * factor if thermal == kinetic else drift + (velocities - drift) * factor
