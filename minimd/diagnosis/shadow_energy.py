"""The shadow energy: what a Verlet step conserves instead of the energy, to the next order.

A symplectic step of length Δt is the exact flow of a Hamiltonian close by. For velocity Verlet (kick, drift, kick), and so for
leapfrog looked at where its velocities meet its positions,

    H̃ = H + Δt² [ 1/12 v·(∇²U) v − 1/24 F·M⁻¹F ] + O(Δt⁴)

and for position Verlet (drift, kick, drift), where both halves have changed places,

    H̃ = H + Δt² [ −1/24 v·(∇²U) v + 1/12 F·M⁻¹F ] + O(Δt⁴)

H itself oscillates by Δt² along the path, H̃ by Δt⁴: what is left of a drift can be seen 1/Δt² times as clearly.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), IX.3; R. D. Engle, R. D. Skeel, M. Drees, J. Comput. Phys. 206, 432 (2005).
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from minimd.integrators.splitting.substeps import Substeps
from minimd.integrators.splitting.verlet import PositionVerlet, VelocityVerlet

if TYPE_CHECKING:
    from minimd.diagnosis.run_guard import Dynamics
    from minimd.simulation.simulation import Simulation

NUDGE = 0.05  # of a step by which atoms are moved along their velocities to see the forces change
COEFFICIENTS: dict[Substeps, tuple[float, float]] = {  # of v·(∇²U) v and of F·M⁻¹F
    VelocityVerlet.sequence(): (1.0 / 12.0, -1.0 / 24.0),
    PositionVerlet.sequence(): (-1.0 / 24.0, 1.0 / 12.0),
}


def shadow_energy(simulation: "Simulation") -> float:
    """H̃ of the present state [energy], conserved to Δt⁴. It costs three evaluations of the forces; the state stays as it is.

    Raises
    ------
    ValueError : for a method other than velocity Verlet, leapfrog and position Verlet, for a thermostat, and for rigid bonds.
    """
    bend = motion_curvature(simulation)
    return simulation.frame().observables["total_energy"] + correction(simulation, bend)


def motion_curvature(simulation: "Dynamics") -> float:
    """v·(∇²U) v [energy/time²], by a central difference of the forces along v.

    Raises
    ------
    ValueError : as shadow_energy.
    """
    check_has_shadow(simulation)
    duration = NUDGE * abs(simulation.method.timestep)
    ahead, behind = (simulation.forces_displaced(sign * duration * simulation.velocities) for sign in (1.0, -1.0))
    return -float(np.einsum("ij,ij->", simulation.velocities, ahead - behind)) / (2.0 * duration)


def correction(simulation: "Dynamics", bend: float) -> float:
    """H̃ − H [energy], from v·(∇²U) v and the forces of the last evaluation."""
    of_motion, of_forces = COEFFICIENTS[simulation.method.sequence()]
    squares = float(np.einsum("ij,ij,i->", simulation.forces, simulation.forces, simulation.inverse_masses))
    return simulation.method.timestep**2 * (of_motion * bend + of_forces * squares)


def check_extras(simulation: "Dynamics", names: Sequence[str]) -> None:
    """Raise ValueError unless these are names of observables that the simulation has beside the usual ones."""
    if isinstance(names, str) or not set(names) <= {"shadow_energy"}:
        raise ValueError(f"extra_observables must be ('shadow_energy',) or empty; they are {names!r}")
    if names:
        check_has_shadow(simulation)


def check_has_shadow(simulation: "Dynamics") -> None:
    """Raise ValueError where the shadow energy is not known, as shadow_energy says."""
    method = simulation.method
    if method.is_thermostat:
        raise ValueError(f"there is no shadow energy with a thermostat, which takes energy and gives it; the method is {method.name}")
    if method.sequence() not in COEFFICIENTS:
        raise ValueError(f"the shadow energy is known of velocity-verlet, leapfrog and position-verlet; the method is {method.name}")
    if simulation.rigid_bonds is not None:
        raise ValueError("the shadow energy is known without rigid bonds only; leave the constraints out, or do not ask for it")
