"""What is measured whenever somebody looks."""

from typing import TYPE_CHECKING, Any

from minimd.constraints.solver import ConstraintSolver
from minimd.engine.record import Frame
from minimd.structure import observables

if TYPE_CHECKING:
    from minimd.simulation.simulation import Simulation


def observe(simulation: "Simulation", virial: Any, potential_energy: float, bonds: ConstraintSolver | None) -> Frame:
    """The present state with its observables.

    virial : (3, 3) [energy], of forces and constraints.  bonds : lengths that are held fixed.
    """
    system = simulation.system
    motion = (system.positions, system.velocities, system.masses)
    kinetic = observables.kinetic_energy(*motion[1:])
    values = {
        "potential_energy": potential_energy,
        "kinetic_energy": kinetic,
        "total_energy": potential_energy + kinetic,
        "temperature": observables.temperature(*motion[1:], system.units.k_B, simulation.n_dof),
        "momentum": observables.momentum(*motion[1:]),
        "angular_momentum": observables.angular_momentum(*motion),
        "absolute_momentum": observables.absolute_momentum(*motion[1:]),
        "absolute_angular_momentum": observables.absolute_angular_momentum(*motion),
    }
    if system.volume is not None:
        values["pressure"] = observables.pressure(kinetic, virial, system.volume)
    if simulation.method.is_thermostat:
        values["conserved_energy"] = potential_energy + kinetic - simulation.heat
    if bonds is not None:
        values["constraint_violation"] = float(bonds.violation(system.positions).max())
    return Frame(simulation.step, simulation.time, simulation.positions, simulation.velocities, simulation.forces, values, simulation.heat)
