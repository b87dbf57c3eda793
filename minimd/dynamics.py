"""Dynamics: a system, its forces, its constraints and a method; makes steps, and finds out what went wrong when one fails."""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from minimd import observables
from minimd.autopsy import Acting, Failure, examine
from minimd.causes import Moment
from minimd.compiling import compile_clock
from minimd.curvature import stiffest_bond
from minimd.errors import ConstraintError, NonFiniteError
from minimd.faults import autopsy, broken_constraint, fault_at_start, fault_of, unstable_bond
from minimd.forces import Forces, Potential
from minimd.integrators.splitting import Splitting, State
from minimd.options import Options
from minimd.potentials.pair_loop import FORCES, TOTALS
from minimd.rigidity import Constraint, Rigidity
from minimd.stacklevel import outside_minimd
from minimd.system import System
from minimd.velocities import maxwell_boltzmann, rescaled

if TYPE_CHECKING:
    import ase


MOMENTS_APART, LEAST_REPLAY = 40, 20  # steps between two moments that are kept, and, where there were as many, from one to a failure


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
        self._method = _checked(method)
        self.system = system.copy() if isinstance(system, System) else System.from_ase(system)
        self.step = 0
        self.time = 0.0
        self._run_seconds, self._run_steps = 0.0, 0
        self._forces = Forces(self.system, potentials, options)
        self._rigidity = Rigidity(self.system, self.system.constraints if constraints is None else constraints, options.most_threads)
        self.system.constraints = self._rigidity.kept
        self._state = State(self.system.positions, self.system.velocities, self._forces.forces, self._rigidity.inverse_masses)
        self._state.constraints = self._rigidity.bonds
        self._state.k_B = self.system.units.k_B
        self._share_energy()
        self.noise_shift, self._equilibrated = 0, 0  # noise of step n is that of n + shift; steps of equilibrations so far
        self._checked_timestep = 0.0  # none yet
        self._reason: ArithmeticError | None = None  # why the last attempt failed
        self._moments: list[Moment] = []  # two to go back to, of which one is new
        self._first_step = 0  # of the present run
        self.failed_from: Moment | None = None  # where a replay of the last failure begins

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.system!r}, {self.method!r}, step {self.step})"

    @property
    def method(self) -> Splitting:
        """The integrator with its time step; another one takes over from the next run on.

        Raises, when it is set
        ----------------------
        TypeError : for anything but a splitting with its time step.  ValueError : if it leaves no degree of freedom.
        """
        return self._method

    @method.setter
    def method(self, method: Splitting) -> None:
        self._rigidity.degrees_of_freedom(_checked(method).conserves_momentum)
        self._method = method
        self._share_energy()

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
        """What is held fixed, with the lengths that are kept; also those of system."""
        return self._rigidity.kept

    @property
    def potentials(self) -> tuple[Potential, ...]:
        """What acts on the atoms."""
        return self._forces.potentials

    @property
    def options(self) -> Options:
        """Threads, precision and skin, as they were asked for."""
        return self._forces.options

    @property
    def moment(self) -> Moment:
        """A copy of the present state, for go_to."""
        return Moment(self.step, self.time, *self._saved())

    def go_to(self, moment: Moment) -> None:
        """Go back to a state."""
        self.step, self.time = moment.step, moment.time
        self._restore(moment[2:])

    @property
    def rigid_lengths(self) -> NDArray[np.float64] | None:
        """(K,) [length], of the pairs that are held rigid; None without."""
        return None if self._rigidity.bonds is None else self._rigidity.bonds.lengths

    @property
    def rigid_tolerance(self) -> float:
        """By how much sweeps leave rigid bonds off [length]; 0 of the other solvers, which go to rounding, and without."""
        bonds, swept = self._rigidity.bonds, any(getattr(one, "solver", "") == "shake" for one in self.constraints)
        return float(bonds.tolerance * bonds.lengths.max()) if bonds is not None and swept else 0.0

    @property
    def rigid_velocity_violation(self) -> float | None:
        """The largest velocity along a rigid bond, of the speed of its atoms; None without."""
        bonds = self._rigidity.bonds
        return None if bonds is None else float(bonds.velocity_violation(self.positions, self.velocities).max())

    @property
    def skins(self) -> list[float]:
        """Of all lists that have one [length]."""
        return self._forces.skins

    @property
    def inverse_masses(self) -> NDArray[np.float64]:
        """(N,) [1/mass], zero of atoms that are held fixed."""
        return self._rigidity.inverse_masses

    def forces_displaced(self, displacements: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces, (N, 3) [energy/length], with all atoms moved by (N, 3) [length]; they are put back."""
        here = self.positions.copy()
        self.positions[:] += displacements
        try:
            return self._forces.compute(FORCES).copy()
        finally:
            self.positions[:] = here
            self._state.forces_are_current = False

    def make_steps(self, n_steps: int) -> None:
        """Make steps that nobody looks at.  Raises NonFiniteError, ConstraintError, KeyboardInterrupt."""
        self._advance(n_steps, look=False)

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

    def _share_energy(self) -> None:
        """Tell the state which motions share the kinetic energy; a single atom keeps its three."""
        self._state.n_dof = self.n_dof
        self._state.conserves_momentum = self.conserves_momentum and len(self.system) > 1

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
        self._keep(before)
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
        self._state.step = self.step + self.noise_shift
        try:
            done = self.method.advance(self._state, self._compute_forces, n_steps, look)
        except (NonFiniteError, ConstraintError) as reason:
            self._reason = reason
            return None
        self._reason = None
        return done if self._fault() is None else None

    def _keep(self, state: tuple[NDArray, NDArray, float]) -> None:
        """Remember the present moment, if the last one is some steps old."""
        if not self._moments or self.step - self._moments[-1].step >= MOMENTS_APART:
            self._moments = [*self._moments[-1:], Moment(self.step, self.time, *state)]

    def _replay(self, before: tuple[NDArray, NDArray, float], n_steps: int) -> NoReturn:
        """Repeat a failed run of steps one by one, up to the last good state; raise the error of the next."""
        self._restore(before)
        for _ in range(n_steps):
            good = self._saved()
            if self._attempt(1, look=False) is None:
                fault, at = self._fault() or "the forces are not finite", self.positions.copy()
                self._restore(good)
                raise self._failure(fault, self.step + 1, at)
            self._count(1)
        raise self._failure("a run of steps failed that succeeded one by one", self.step)

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
        self._moments, self._first_step, self._reason = [], self.step, None
        self._state.forces_are_current = False
        self._share_energy()
        self._rigidity.begin(self.system, self._state)
        self._warn_of_timestep()
        self._forces.fit_skin(observables.largest_speed(self.velocities) * abs(self.method.timestep))
        self._look()
        accelerations = self.forces * self._rigidity.inverse_masses[:, None]
        fault = fault_at_start(self.system, accelerations, self._forces.potential_energy, self.method.timestep, self._forces.longest_stride)
        if fault:
            raise self._failure(fault, self.step)

    def _warn_of_timestep(self) -> None:
        """Say, once for each time step, that it is longer than the stiffest harmonic bond allows."""
        if self._checked_timestep == self.method.timestep:
            return
        self._checked_timestep = self.method.timestep
        warning = unstable_bond(self.system, stiffest_bond(self.system, self._forces.potentials, self._rigidity), self.method)
        if warning:
            warnings.warn(warning, stacklevel=outside_minimd())

    def _fault(self) -> str | None:
        return fault_of(self.system, self.method.timestep, self._forces.longest_stride)

    def _failure(self, fault: str, step: int, at: NDArray[np.float64] | None = None) -> NonFiniteError | ConstraintError:
        """The error for a run that failed in a step, with its autopsy; the system is in the last good state.  at : (N, 3), that of the failure."""
        reason, here = self._reason, (step, self.method.timestep, self.step)
        error: NonFiniteError | ConstraintError = NonFiniteError(autopsy(self.system, fault, *here))
        if isinstance(reason, ConstraintError):
            error, fault = ConstraintError(broken_constraint(self.system, reason, *here)), str(reason)
        moments = self._moments or [self.moment]
        start = next((moment for moment in reversed(moments) if self.step - moment.step >= LEAST_REPLAY), moments[0])
        self.failed_from = start
        failure = Failure(fault, step, self.step, getattr(reason, "atoms", None), at, start, is_first=start.step == self._first_step)
        with suppress(ArithmeticError, ValueError, LookupError, TypeError):  # what is broken must not hide that it is
            self._look()
            acting = Acting(self._forces.potentials, self.forces, self._forces.energies, self._rigidity.inverse_masses)
            error.autopsy = examine(self.system, acting, self.method, failure)
            error.args = (f"{error}. Likely cause: {error.autopsy.cause}",)
        return error


def _checked(method: Splitting) -> Splitting:
    if not isinstance(method, Splitting):
        raise TypeError(f"method must be an integrator with its time step, such as VelocityVerlet(0.005); got {method!r}")
    return method
