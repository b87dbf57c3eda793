"""What a splitting moves, and what acts on it beside the forces."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from minimd.constraints.solver import ConstraintSolver
from minimd.integrators.method import Array
from minimd.integrators.splitting.substeps import Drift, Substeps, mechanical

__all__ = ["Bath", "OpenEnd", "State", "Surroundings"]


@dataclass
class State:
    """What a splitting moves, in place.

    positions, velocities, forces : (N, 3) [length], [length/time], [energy/length].
    inverse_masses : (N,) [1/mass], zero for atoms that are held fixed.
    forces_are_current : whether forces belong to positions; whoever moves positions sets it to False.
    """

    positions: Array
    velocities: Array
    forces: Array
    inverse_masses: Array
    forces_are_current: bool = False

    @cached_property
    def masses(self) -> Array:
        """(N,) [mass] of the atoms that move, zero for those that are held fixed."""
        moving = self.inverse_masses > 0.0
        return np.divide(1.0, self.inverse_masses, out=np.zeros(moving.shape), where=moving)


@dataclass
class Bath:
    """What a thermostat needs to know of its system, and the energy that it has given to it.

    k_B : [energy/temperature].  n_dof : degrees of freedom that share the kinetic energy.
    conserves_momentum : whether the total momentum is a constant; the motion of the center of mass is then no degree of freedom.
    step, contact : steps since the start, and contacts since the step began; both choose the noise.
    energy : given to the system since the start, the reservoir energy [energy].
    """

    k_B: float = 1.0  # noqa: N815 - the symbol of the constant
    n_dof: int = 0
    conserves_momentum: bool = False
    step: int = 0
    contact: int = 0
    energy: float = 0.0


class OpenEnd(NamedTuple):
    """A state before the end of a block of steps: before the last half kick or drift, and before velocities were projected.

    velocities : (N, 3), a copy.  positions : likewise, or None if they are those of the state.
    drifts_next : whether the next block moves the atoms before it needs forces; those at the positions of the state are not on its way.
    """

    velocities: Array
    positions: Array | None
    drifts_next: bool


@dataclass
class Surroundings:
    """What acts on a state beside the forces.

    constraints : solver of the lengths that drifts keep, or None.  bath : of a thermostat, or None.
    stop_requested : set it to True to end a run of steps after the present one.
    keeps_open_end : whether a block goes on from the open end of the one before; who changes the state in between sets open_end to None.
    """

    constraints: ConstraintSolver | None = None
    bath: Bath | None = None
    stop_requested: bool = False
    keeps_open_end: bool = False
    open_end: OpenEnd | None = None

    def leave_open(self, state: State, end: Substeps, cycle: Substeps) -> None:
        """Keep the open end of a block.  end : the substeps that end it.  cycle : those of the next step, if it goes on."""
        if not self.keeps_open_end:
            return
        velocities = state.velocities.copy() if end or self.constraints is not None else state.velocities
        positions = state.positions.copy() if any(isinstance(substep, Drift) for substep in end) else None
        self.open_end = OpenEnd(velocities, positions, drifts_next=isinstance(mechanical(cycle)[0], Drift))

    def take_up(self, state: State) -> bool:
        """Go back to the open end of the block before; False if there is none."""
        if self.open_end is None:
            return False
        velocities, positions, _ = self.open_end
        state.velocities[:] = velocities
        if positions is not None:
            state.positions[:], state.forces_are_current = positions, False
        self.open_end = None
        return True

    def project(self, state: State) -> None:
        """Velocities projected so that they change no length that is kept, in place."""
        if self.constraints is not None:
            self.constraints.project_velocities(state.velocities, state.positions)
