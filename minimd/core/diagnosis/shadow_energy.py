"""The shadow energy: what a Verlet step conserves instead of the energy, to the next order.

A symplectic step of length Δt is the exact flow of a Hamiltonian close to H. For velocity Verlet (kick, drift, kick),
and for leapfrog at the end of a run, where its velocities are at the time of its positions,

    H̃ = H + Δt² [ 1/12 v·(∇²U) v − 1/24 F·M⁻¹F ] + O(Δt⁴)

and for position Verlet (drift, kick, drift), where both halves have changed places,

    H̃ = H + Δt² [ −1/24 v·(∇²U) v + 1/12 F·M⁻¹F ] + O(Δt⁴)

where v·(∇²U) v is the second derivative of U(r + v s, t + s) by s: if forces depend on time, it is one more coordinate,
whose velocity is 1, and what is conserved is H̃ minus their work.

Along the path H itself oscillates by O(Δt²), H̃ only by O(Δt⁴): a drift that remains is seen 1/Δt² times as clearly.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), IX.3; R. D. Engle, R. D. Skeel, M. Drees, J.
Comput. Phys. 206, 432 (2005).
"""

from typing import Protocol, runtime_checkable

import numpy as np

from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Observable, register
from minimd.core.integrators.rows import PositionVerlet, VelocityVerlet
from minimd.core.integrators.substeps import Substeps
from minimd.core.structure.checks import checked_kind


@runtime_checkable
class HasEngine(Protocol):
    """A Simulation."""

    engine: Engine


NUDGE = 0.05  # d, of a step, for which atoms go on with their velocities to see the forces change
COEFFICIENTS: dict[Substeps, tuple[float, float]] = {  # of v·(∇²U) v and of F·M⁻¹F
    VelocityVerlet.sequence(): (1.0 / 12.0, -1.0 / 24.0),
    PositionVerlet.sequence(): (-1.0 / 24.0, 1.0 / 12.0),
}


def shadow_energy(simulation: HasEngine) -> float:
    """H̃ of the present state [energy], which is conserved to Δt⁴; if forces depend on time, H̃ − Simulation.work is.

    It costs three evaluations of the forces; the state stays as it is.

    Raises ValueError for a method other than velocity Verlet, leapfrog and position Verlet, a bath, and rigid bonds."""
    engine = checked_kind("simulation", simulation, HasEngine, "a Simulation").engine
    check_has_shadow(engine)
    engine.enter()
    engine.evaluate()
    return engine.potential_energy + engine.kinetic_energy + correction(engine)


def correction(engine: Engine) -> float:
    """H̃ − H [energy], with the forces current.
    v·(∇²U) v [energy/time²] is the difference of dU/ds = ∂U/∂t − F·v at s = 0, d and 2d, right to d². Its times are not
    before the present one, at which a spring may begin to move."""
    of_motion, of_forces = COEFFICIENTS[engine.method.sequence()]
    inverse_masses = engine.constraint_set.inverse_masses
    squares = float(np.einsum("ij,ij,i->", engine.forces, engine.forces, inverse_masses))
    duration = NUDGE * engine.method.timestep
    change = -3.0 * engine.forces
    of_power = -3.0 * engine.surroundings.powers[1]
    for weight, later in ((4.0, duration), (-1.0, 2.0 * duration)):
        with engine.coasted(later) as forces:
            change += weight * forces
            of_power += weight * engine.interactions.powers[1]
    power_of_forces = float(np.einsum("ij,ij->", engine.velocities, change))
    v_hessian_v = (of_power - power_of_forces) / (2.0 * duration)
    return engine.method.timestep**2 * (of_motion * v_hessian_v + of_forces * squares)


def check_has_shadow(engine: Engine) -> None:
    """Raise ValueError where the shadow energy is not known, as shadow_energy says."""
    method = engine.method
    none = "there is no shadow energy"
    with_bath = "which exchanges energy with the system"
    if method.is_thermostat:
        raise ValueError(f"{none} with a thermostat, {with_bath}; the method is {method.name}")
    if engine.barostat is not None:
        raise ValueError(f"{none} with a barostat, {with_bath}")
    if method.sequence() not in COEFFICIENTS:
        known = "velocity-verlet, leapfrog and position-verlet"
        raise ValueError(f"{none} of {method.name}, only of {known}")
    if engine.constraint_set.bonds is not None:
        raise ValueError(f"{none} with rigid bonds; leave out the bonds or the observable")


register(
    Observable(
        "shadow_energy",
        "energy",
        lambda look: look.total_energy + correction(look.engine),
        demand=check_has_shadow,
    )
)
