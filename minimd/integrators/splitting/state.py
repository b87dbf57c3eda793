"""What a splitting moves, and what acts on it beside the forces."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bath", "State", "Surroundings"]

Array = NDArray[np.float64]


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
    """What a thermostat knows of the system it is in contact with, and what it has given to it.

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


class Constraints(Protocol):
    """Lengths that are kept; see minimd.constraints.ConstraintSolver."""

    def drift(self, positions: Array, velocities: Array, duration: float) -> None:
        """A drift that keeps the lengths, (N, 3) both, in place."""

    def project_velocities(self, velocities: Array, positions: Array) -> None:
        """Take from velocities, in place, what would change a length. (N, 3) both."""


@dataclass
class Surroundings:
    """What acts on a state beside the forces.

    constraints : lengths that drifts keep, or None.  bath : of a thermostat, or None.
    stop_requested : set it to True to end a run of steps after the present one.
    """

    constraints: Constraints | None = None
    bath: Bath | None = None
    stop_requested: bool = False

    def project(self, state: State) -> None:
        """Take from the velocities what would change a length."""
        if self.constraints is not None:
            self.constraints.project_velocities(state.velocities, state.positions)
