"""Dynamics: a system, its forces, its constraints and a method; makes steps, and finds out what went wrong when one fails."""

from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from minimd import observables
from minimd.compiling import compile_clock
from minimd.errors import ConstraintError, NonFiniteError
from minimd.faults import autopsy, broken_constraint, fault_at_start, fault_of, runaway
from minimd.forces import Forces, Potential
from minimd.integrators.splitting import Splitting, State
from minimd.options import Options
from minimd.potentials.pair_loop import FORCES, TOTALS
from minimd.rigidity import Constraint, Rigidity
from minimd.system import System
from minimd.velocities import maxwell_boltzmann, rescaled

if TYPE_CHECKING:
    import ase


class Dynamics:
    """One system on its way; see Simulation for the parameters."""

    def __init__(
        self,
        system: "System | ase.Atoms",
        potentials: Potential | Sequence[Potential],
        method: Splitting,
        constraints: Constraint | Sequence[Constraint] | None,
        options: Options,
    ) -> None:
        if not isinstance(method, Splitting):
            raise TypeError(f"method must be an integrator with its time step, such as VelocityVerlet(0.005); got {method!r}")
        self._system = system.copy() if isinstance(system, System) else System.from_ase(system)
        self.method = method
        self.step = 0
        self.time = 0.0
        self._run_seconds, self._run_steps = 0.0, 0
        self._forces = Forces(self.system, potentials, options)
        self._rigidity = Rigidity(self.system, self.system.constraints if constraints is None else constraints, options.most_threads)
        self._state = State(self.system.positions, self.system.velocities, self._forces.forces, self._rigidity.inverse_masses)
        self._state.constraints = self._rigidity.bonds
        self._state.k_B, self._state.n_dof = self.system.units.k_B, self.n_dof
        self._noise_shift = 0
        self._first: dict[str, Any] | None = None  # observables at the first look of a run
        self._reason: ArithmeticError | None = None  # why the last attempt failed

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.system!r}, {self.method!r}, step {self.step})"

    @property
    def system(self) -> System:
        """The state; its arrays can be changed, not replaced by those of another system."""
        return self._system

    @property
    def n_dof(self) -> int:
        """Degrees of freedom that share the kinetic energy."""
        return self._rigidity.degrees_of_freedom(self.method.conserves_momentum)

    @property
    def heat(self) -> float:
        """What a thermostat has put in since the start [energy]; set it when a run is resumed."""
        return self._state.heat

    @heat.setter
    def heat(self, heat: float) -> None:
        self._state.heat = heat

    @property
    def conserves_momentum(self) -> bool:
        """Whether the total momentum is a constant: nothing is fixed, and no bath acts on atoms one by one."""
        return self.method.conserves_momentum and not self._rigidity.n_fixed

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """What is held fixed."""
        return self._rigidity.given

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) [length], never wrapped."""
        return self.system.positions

    @property
    def velocities(self) -> NDArray[np.float64]:
        """(N, 3) [length/time]."""
        return self.system.velocities

    @property
    def forces(self) -> NDArray[np.float64]:
        """(N, 3) [energy/length], of the last evaluation."""
        return self._forces.forces

    def set_temperature(self, temperature: float, seed: int | None = None) -> None:
        """Draw Maxwell-Boltzmann velocities: kinetic temperature exactly this one, total momentum zero (of several free atoms).

        Raises
        ------
        ValueError : if the temperature is negative or not finite.
        """
        self.velocities[:] = maxwell_boltzmann(self.system.masses, temperature, self.system.units.k_B, seed)
        self._rigidity.fit(self.system)
        self._rigidity.project(self.velocities, self.positions)
        if temperature > 0.0:
            self.rescale_temperature(temperature)

    def rescale_temperature(self, temperature: float) -> None:
        """Multiply all velocities so that the kinetic temperature is exactly this one.

        Raises
        ------
        ValueError : if the temperature is negative or not finite, or nothing moves.
        """
        self.velocities[:] = rescaled(self.velocities, self.system.masses, temperature, self.system.units.k_B, self.n_dof)

    def _look(self) -> None:
        """Make sure that forces, energy and virial are those of the present positions."""
        if not (self._state.forces_are_current and self._forces.has_energy):
            self._compute_forces(self._state, True)
            self._state.forces_are_current = True

    def _compute_forces(self, _state: State, look: bool) -> None:
        self._forces.compute(TOTALS if look else FORCES)

    def _advance(self, n_steps: int, look: bool) -> None:
        """Make up to n_steps steps, fewer after Ctrl-C; if they fail, go back and find out at which and why."""
        before = self._saved()
        started, compiled = perf_counter(), compile_clock.seconds
        try:
            done = self._attempt(n_steps, look)
        except ValueError:  # the scene no longer fits the list it needs
            self._restore(before)
            raise
        self._run_seconds += perf_counter() - started - (compile_clock.seconds - compiled)
        if done is None:
            self._replay(before, n_steps)
        self._count(done)
        if self._state.stop_requested:
            raise KeyboardInterrupt(f"stopped after step {self.step}")

    def _attempt(self, n_steps: int, look: bool) -> int | None:
        """Steps made, or None if the state after them is no longer a possible one."""
        self._state.step = self.step + self._noise_shift
        try:
            done = self.method.advance(self._state, self._compute_forces, n_steps, look)
        except (NonFiniteError, ConstraintError) as reason:
            self._reason = reason
            return None
        self._reason = None
        return done if self._fault() is None else None

    def _replay(self, before: tuple[NDArray, NDArray, float], n_steps: int) -> NoReturn:
        """Repeat a failed run of steps one by one, up to the last good state; raise the error of the next."""
        self._restore(before)
        for _ in range(n_steps):
            good = self._saved()
            made = self._attempt(1, look=True)
            fault = self._runaway() if made else self._fault() or "the forces are not finite"
            if fault:
                self._restore(good)
                if not made and isinstance(self._reason, ConstraintError):
                    raise ConstraintError(broken_constraint(self.system, self._reason, self.step + 1, self.method.timestep, self.step))
                raise NonFiniteError(self._autopsy(fault, self.step + 1))
            self._count(1)
        raise NonFiniteError(self._autopsy("a run of steps failed that succeeded one by one", self.step))

    def _saved(self) -> tuple[NDArray, NDArray, float]:
        return self.positions.copy(), self.velocities.copy(), self._state.heat

    def _restore(self, state: tuple[NDArray, NDArray, float]) -> None:
        self.positions[:], self.velocities[:], self._state.heat = state
        self._state.forces_are_current = False

    def _count(self, done: int) -> None:
        self.step += done
        self._run_steps += done
        self.time += done * self.method.timestep

    def _check_start(self) -> None:
        """Look at the state anew, and raise NonFiniteError if the first step would throw atoms across the scene."""
        self._state.forces_are_current = False
        self._state.n_dof = self.n_dof
        self._rigidity.begin(self.system, self._state)
        self._forces.fit_skin(observables.largest_speed(self.velocities) * abs(self.method.timestep))
        self._look()
        fault = fault_at_start(self.system, self.forces, self._forces.potential_energy, self.method.timestep, self._forces.longest_stride)
        if fault:
            raise NonFiniteError(self._autopsy(fault, self.step))

    def _fault(self) -> str | None:
        return fault_of(self.system, self.method.timestep, self._forces.longest_stride)

    def _runaway(self) -> str | None:
        """Whether the energies of the present state, which were just evaluated, have run away from those of the first look."""
        kinetic, potential = observables.kinetic_energy(self.velocities, self.system.masses), self._forces.potential_energy
        now = {"kinetic_energy": kinetic, "potential_energy": potential, "total_energy": kinetic + potential}
        if self.method.is_thermostat:
            now["conserved_energy"] = kinetic + potential - self._state.heat
        return runaway(self.system, self.method.timestep, self._first, now) if self._first else None

    def _autopsy(self, fault: str, step: int) -> str:
        return autopsy(self.system, fault, step, self.method.timestep, self.step)
