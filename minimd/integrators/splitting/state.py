"""What a splitting moves, and what acts on it besides the forces."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.fixed_point import Steps
from minimd.constraints.graph import Bodies
from minimd.constraints.solver import ConstraintSolver
from minimd.integrators.method import Array
from minimd.integrators.splitting.flows import drift, drift_on_grid, kick, kick_on_grid
from minimd.integrators.splitting.substeps import Drift, Substeps, mechanical
from minimd.neighbors.buffers import HALF_A_PAGE, Buffers
from minimd.structure.grid import Grid
from minimd.structure.observables import kinetic_energy, momentum

__all__ = ["Bath", "Contact", "Cycle", "OpenEnd", "State", "Surroundings"]


@dataclass
class State:
    """What a splitting moves, in place.

    positions, velocities, forces : (N, 3) [length], [length/time], [energy/length].
    inverse_masses : (N,) [1/mass], zero for atoms that are held fixed.
    forces_are_current : whether forces belong to positions; whoever moves positions sets it to False.
    unit : in fixed-point arithmetic, the time over which impulses are (or will be) computed [time].
    """

    positions: Array
    velocities: Array
    forces: Array
    inverse_masses: Array
    forces_are_current: bool = False
    unit: float = 1.0
    _memory: Buffers = field(default_factory=Buffers, repr=False)

    def room(self, n: int) -> Array:
        """Flat memory for n numbers, velocities beside those of the state: of a March, or, between two blocks of steps,
        of an open end."""
        return self._memory.array("velocities", np.float64, n, in_page=HALF_A_PAGE, spare=1.0)

    def has_forces_over(self, unit: float) -> bool:
        """Whether the forces of the next kick are already computed.  unit : the kick lasts a whole multiple of it;
        see Splitting.units [time]."""
        return self.forces_are_current

    def kick(self, duration: float, _unit: float) -> None:
        """Velocities += duration · forces / m.  unit : of the duration, see Splitting.units [time]."""
        kick(self.velocities, self.forces, self.inverse_masses, duration)

    def drift(self, duration: float, _unit: float) -> None:
        """Positions += duration · velocities.  unit : likewise."""
        drift(self.positions, self.velocities, duration)

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
    grid : Grid.  bodies : groups of atoms that constraints tie together, or None.
    """

    impulses: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    grid: Grid = Grid(1.0, 1.0, 1.0)  # noqa: RUF009 - frozen
    bodies: Bodies | None = None

    def has_forces_over(self, unit: float) -> bool:
        """See State."""
        self.forces_are_current &= unit == self.unit
        self.unit = unit
        return self.forces_are_current

    def kick(self, duration: float, unit: float) -> None:
        """See State.  Raises RangeError if a momentum leaves its range."""
        if kick_on_grid(
            self.velocities, self.impulses, self.inverse_masses, round(duration / unit), steps_of(self.grid, (unit,))
        ):
            self.grid.check_momenta(self.velocities, self.inverse_masses)

    def drift(self, duration: float, unit: float) -> None:
        """See State.  Raises RangeError if a position leaves its range."""
        drift_on_grid(
            self.positions,
            self.velocities,
            self.inverse_masses,
            unit,
            round(duration / unit),
            steps_of(self.grid, (unit,)),
        )
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


def steps_of(grid: Grid, units: ArrayLike) -> Steps:
    """Steps for a kernel.  units : the time over which the impulses of each kick are computed [time]."""
    return Steps(np.asarray(units) / grid.momentum, grid.length, grid.momentum, grid.energy, 0.0)


@dataclass
class Bath:
    """What a thermostat needs to know about its system, and the energy it has given to the system.

    k_B : [energy/temperature].  n_dof : degrees of freedom that share the kinetic energy.
    conserves_momentum : whether the total momentum is constant;
        the motion of the center of mass is then not a thermal degree of freedom.
    step, contact : steps since the start, and contacts since the step began; both select the noise.
    energy : given to the system since the start, the reservoir energy [energy].
    """

    k_B: float = 1.0
    n_dof: int = 0
    conserves_momentum: bool = False
    step: int = 0
    contact: int = 0
    energy: float = 0.0


class Contact(NamedTuple):
    """The Ornstein-Uhlenbeck process of a bath, v ← kept · v + spread √(1/m) ξ, and then a drift.

    kept : dimensionless.  spread : [√energy].  duration : of the drift [time].  bath : Bath, which counts the energy.
    noise : function of n and N that returns ξ of n steps, beginning with bath.step, (n, N, 3).
    """

    kept: float
    spread: float
    duration: float
    bath: Bath
    noise: Callable[[int, int], Array]


class Cycle(NamedTuple):
    """What is repeated in a run of steps: kicks and drifts in turn, with the forces evaluated before each kick.

    durations : (P, 2, 2); for each of P pairs of kick and drift: duration and unit of each [time]; see Splitting.units.
    contact : the contact with a bath that follows each drift, or None.
    """

    durations: Array
    contact: Contact | None = None


class OpenEnd(NamedTuple):
    """A state before the end of a block of steps: before the last half kick or drift,
    and before velocities were projected.

    velocities : (N, 3), in the room of the state, or, at the end of a block that changes them no more,
        those of the state itself.
    positions : (N, 3), a copy, or None if they are those of the state.
    drifts_next : whether the next block moves the atoms before it needs forces;
        it then never needs the forces at the present positions.
    work : see Surroundings [energy].
    """

    velocities: Array
    positions: Array | None
    drifts_next: bool
    work: float = 0.0

    def copy(self) -> "OpenEnd":
        """One that stays as it is when atoms move on."""
        return self._replace(velocities=self.velocities.copy())


@dataclass
class Surroundings:
    """What acts on a state besides the forces.

    constraints : solver for the lengths that drifts keep, or None.  bath : of a thermostat, or None.
    stop_requested : set it to True to end a run of steps after the present one.
    keeps_open_end : whether a block continues from the open end of the previous one;
        code that changes the state in between sets open_end to None.
    phase : time since the beginning of the step, in time steps; only drifts advance it.
    power : ∂U/∂t with the forces of the next kick [energy/time].  work : its integral,
        Σ duration · power over all kicks [energy]. Time is treated
    as a coordinate with momentum −work, and this larger system is split:
    total energy minus work is conserved as well as an energy is.
    """

    constraints: ConstraintSolver | None = None
    bath: Bath | None = None
    stop_requested: bool = False
    keeps_open_end: bool = False
    open_end: OpenEnd | None = None
    phase: float = 0.0
    power: float = 0.0
    work: float = 0.0

    def leave_open(self, state: State, end: Substeps, cycle: Substeps) -> None:
        """Keep the open end of a block.  end : the substeps that end it.  cycle : the substeps of the next step,
        if the run continues."""
        if not self.keeps_open_end:
            return
        velocities = state.velocities
        if end or self.constraints is not None:
            velocities = state.room(velocities.size).reshape(velocities.shape)
            velocities[:] = state.velocities
        positions = state.positions.copy() if any(isinstance(substep, Drift) for substep in end) else None
        self.open_end = OpenEnd(
            velocities, positions, drifts_next=isinstance(mechanical(cycle)[0], Drift), work=self.work
        )

    def take_up(self, state: State) -> bool:
        """Go back to the open end of the previous block; False if there is none."""
        if self.open_end is None:
            return False
        velocities, positions, _, self.work = self.open_end
        state.velocities[:] = velocities
        if positions is not None:
            state.positions[:], state.forces_are_current = positions, False
        self.open_end = None
        return True

    def count(self, n_steps: int) -> None:
        """Count n_steps more steps for the bath: its next contact is the first of its step."""
        if self.bath is not None:
            self.bath.step, self.bath.contact = self.bath.step + n_steps, 0

    def drift(self, state: State, duration: float, unit: float) -> None:
        """Positions += duration · velocities, with constrained lengths kept.  unit : see State.drift."""
        if self.constraints is None:
            state.drift(duration, unit)
            return
        with state.held():
            self.constraints.drift(state.positions, state.velocities, duration)

    def project(self, state: State) -> None:
        """Project velocities in place, so that they change no constrained length."""
        if self.constraints is not None:
            with state.held():
                self.constraints.project_velocities(state.velocities, state.positions)
