"""What a splitting moves, and what acts on it besides the forces."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.constraints.groups import Bodies
from minimd.core.constraints.solver import ConstraintSolver
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.grid import Grid, steps_of
from minimd.core.structure.observables import kinetic_energy, momentum

__all__ = ["Bath", "State", "Surroundings"]


@dataclass
class State:
    """What a splitting moves, in place.

    positions, velocities, forces : (N, 3) [length], [length/time], [energy/length].
    inverse_masses : (N,) [1/mass], zero for atoms that are held fixed.
    forces_are_current : whether forces belong to positions; whoever moves positions sets it to False.
    unit : in fixed-point arithmetic, the time over which impulses are (or will be) computed [time]."""

    positions: Array
    velocities: Array
    forces: Array
    inverse_masses: Array
    forces_are_current: bool = False
    unit: float = 1.0

    @property
    def pushes(self) -> NDArray[Any]:
        """What kicks are made with: the forces; on a grid impulses."""
        return self.forces

    @property
    def steps(self) -> Any:
        """Steps of a grid; () without one."""
        return ()

    def check_range(self) -> None:
        """Raise RangeError if a momentum or a position is beyond the range of a grid, if there is one."""

    def settle(self) -> None:
        """Round velocities that a bath has changed to the grid, in place, if there is one."""

    @contextmanager
    def held(self) -> Iterator[None]:
        """Context in which constraints change positions and velocities; at its end both are rounded to the grid,
        if there is one."""
        yield

    def kinetic_energy(self) -> float:
        """K [energy] of the atoms that move."""
        return kinetic_energy(self.velocities, self.masses)

    def momentum(self) -> Array:
        """Σ m v [mass length/time], (3,), of the atoms that move."""
        return momentum(self.velocities, self.masses)

    @cached_property
    def masses(self) -> Array:
        """(N,) [mass] of the atoms that move, zero for those that are held fixed."""
        moving = self.inverse_masses > 0.0
        return np.divide(1.0, self.inverse_masses, out=np.zeros(moving.shape), where=moving)


@dataclass
class GridState(State):
    """A state in fixed-point arithmetic.
    impulses : (N, 3) int64 in steps of momentum: forces times the unit of time.
    grid : Grid.
    bodies : groups of atoms that constraints tie together, or None."""

    impulses: Indices = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    grid: Grid = Grid(1.0, 1.0, 1.0)  # noqa: RUF009 - frozen
    bodies: Bodies | None = None

    @property
    def pushes(self) -> NDArray[Any]:
        """See State."""
        return self.impulses

    @property
    def steps(self) -> Any:
        """See State."""
        return steps_of(self.grid, (self.unit,))

    def check_range(self) -> None:
        """See State."""
        self.grid.check_momenta(self.velocities, self.inverse_masses)
        self.grid.check_positions(self.positions)

    @contextmanager
    def held(self) -> Iterator[None]:
        """See State. The momentum of each body (atoms tied together by constraints) stays the same, to the last bit."""
        before = self.grid.momenta(self.velocities, self.inverse_masses)
        yield
        momenta = self.grid.momenta(self.velocities, self.inverse_masses)
        if self.bodies is not None:
            label, last, is_free = self.bodies
            for c in range(3):
                excess = np.bincount(label, momenta[:, c] - before[:, c])
                momenta[last[is_free], c] -= excess[is_free]
        self.velocities[:] = self.grid.velocities(momenta, self.inverse_masses)
        self.grid.take_positions(self.positions)

    def settle(self) -> None:
        """See State."""
        self.grid.take_velocities(self.velocities, self.inverse_masses)

    def kinetic_energy(self) -> float:
        """See State."""
        return kinetic_energy(self.velocities, self.masses, self.grid.energy)

    def momentum(self) -> Array:
        """See State."""
        return momentum(self.velocities, self.masses, self.grid.momentum)


class Place:
    """A number that is an element of an array, which kernels read.
    array : its name.
    kind : of the number."""

    def __init__(self, array: str, index: int, kind: type) -> None:
        self._array = array
        self._index = index
        self._kind = kind

    def __get__(self, instance: Any, _owner: type) -> Any:
        return self if instance is None else self._kind(getattr(instance, self._array)[self._index])

    def __set__(self, instance: Any, value: float) -> None:
        getattr(instance, self._array)[self._index] = value


class Bath:
    """What a thermostat needs to know about its system, and the energy it has given to the system.

    k_B : [energy/temperature].
    dimensions : in which atoms move.
    n_dof : degrees of freedom that share the kinetic energy.
    conserves_momentum : of all atoms; then the motion of the center of mass is not a thermal degree of freedom.
    step, contact : the number of the step, negative in an equilibration, and of the contact within it; both select
        the noise.
    energy : given to the system since the start, the reservoir energy [energy].
    heat, thermal : (1,) energy, and (2,) int, n_dof and conserves_momentum, for kernels."""

    n_dof = Place("thermal", 0, int)
    conserves_momentum = Place("thermal", 1, bool)
    energy = Place("heat", 0, float)

    def __init__(
        self,
        k_B: float = 1.0,
        n_dof: int = 0,
        conserves_momentum: bool = False,
        step: int = 0,
        dimensions: int = 3,
    ) -> None:
        self.k_B = k_B
        self.dimensions = dimensions
        self.step = step
        self.contact = 0
        self.heat = np.zeros(1)
        self.thermal = np.array([n_dof, conserves_momentum], dtype=np.int64)


@dataclass
class Surroundings:
    """What acts on a state besides the forces.

    constraints : solver for the lengths that drifts keep, or None.
    bath : of a thermostat, or None.
    stop_requested : set it to True to end a run of steps after the present one.
    powers : ∂U/∂t with the forces of the next kick [energy/time], just before their time and just after.
    work : its integral, Σ duration · power over all kicks [energy], those that begin a step with the second power, all
        others with the first; of a step back in time the other way round. Time is treated as a coordinate with momentum
        −work, and this larger system is split: total energy minus work is conserved as well as an energy is."""

    constraints: ConstraintSolver | None = None
    bath: Bath | None = None
    stop_requested: bool = False
    powers: tuple[float, float] = (0.0, 0.0)
    work: float = 0.0

    def drift(self, state: State, duration: float) -> None:
        """Positions += duration · velocities, with constrained lengths kept and all numbers on their grid."""
        if self.constraints is not None:
            with state.held():
                self.constraints.drift(state.positions, state.velocities, duration)

    def project(self, state: State) -> None:
        """Project velocities in place, so that they change no constrained length."""
        if self.constraints is not None:
            with state.held():
                self.constraints.project_velocities(state.velocities, state.positions)
