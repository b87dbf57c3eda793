"""Dynamics: makes steps, and finds out what went wrong when one fails."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import compile_clock
from minimd.diagnosis.causes import Moment
from minimd.diagnosis.crash_report import Acting, Failure, examine
from minimd.diagnosis.faults import (
    RUNAWAY,
    broken_constraint,
    failure_sentence,
    fault_at_start,
    fault_of,
    largest_acceleration,
    runaway,
    unstable_bond,
)
from minimd.diagnosis.hessian import stiffest_bond
from minimd.engine.engine import Motion
from minimd.forces.forces import Potential
from minimd.forces.options import Options
from minimd.integrators.splitting.splitting import Splitting
from minimd.potentials.term import PER_ATOM
from minimd.structure import observables
from minimd.structure.console import outside_minimd
from minimd.structure.constraints import Constraint
from minimd.structure.errors import ConstraintError, NonFiniteError
from minimd.structure.system import System

if TYPE_CHECKING:
    import ase

MOMENTS_APART, LEAST_REPLAY = 40, 20  # steps between two moments that are kept, and, where there were as many, from one to a failure


class Dynamics(Motion):
    """A motion that goes on, step by step; see Simulation for the parameters."""

    def __init__(
        self,
        system: "System | ase.Atoms",
        potentials: Potential | Sequence[Potential],
        method: Splitting,
        constraints: Constraint | Sequence[Constraint] | None,
        options: Options,
    ) -> None:
        super().__init__(system, potentials, method, constraints, options)
        self._run_seconds, self._run_steps = 0.0, 0
        self._checked_timestep = 0.0  # none yet
        self._first: dict[str, Any] | None = None  # observables at the first look of a run
        self._reason: ArithmeticError | None = None  # why the last attempt failed
        self._before: Moment | None = None  # the last steps that were made together
        self._moments: list[Moment] = []  # two to go back to, of which one is new
        self._first_step = 0  # of the present run
        self.failed_from: Moment | None = None  # where a replay of the last failure begins

    def make_steps(self, n_steps: int) -> None:
        """Make steps that nobody looks at.  Raises NonFiniteError, ConstraintError, KeyboardInterrupt."""
        self._advance(n_steps, look=False)

    def _advance(self, n_steps: int, look: bool) -> None:
        """Make up to n_steps steps, fewer after Ctrl-C; if they fail, go back and find out at which and why."""
        before = self._saved()
        self._before = Moment(self.step, self.time, *before)
        self._keep(self._before)
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

    @contextmanager
    def _uncounted(self) -> Iterator[None]:
        """What is computed inside is no part of the last run, of which the report tells."""
        counted = self._run_seconds, self._run_steps, self._forces.counts
        try:
            yield
        finally:
            self._run_seconds, self._run_steps, self._forces.counts = counted

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

    def _keep(self, moment: Moment) -> None:
        """Remember the present moment, if the last one is some steps old."""
        if not self._moments or moment.step - self._moments[-1].step >= MOMENTS_APART:
            self._moments = [*self._moments[-1:], moment]

    def _replay(self, before: tuple[NDArray, NDArray, float], n_steps: int) -> NoReturn:
        """Repeat a failed run of steps one by one, up to the last good state; raise the error of the next."""
        self._restore(before)
        for _ in range(n_steps):
            good = self._saved()
            made = self._attempt(1, look=True)
            fault = self._runaway() if made else self._fault() or "the forces are not finite"
            if fault:
                at = self.positions.copy()
                self._restore(good)
                raise self._failure(fault, self.step + 1, at)
            self._count(1)
        raise self._failure("a run of steps failed that succeeded one by one", self.step)

    def _count(self, done: int) -> None:
        self.step += done
        self._run_steps += done
        self.time += done * self.method.timestep

    def _check_start(self) -> None:
        """Look at the state anew, and raise NonFiniteError if the first step would throw atoms across the scene."""
        self._moments, self._first_step, self._reason, self._before = [], self.step, None, None
        self._state.forces_are_current = False
        self._share_energy()
        self._rigidity.begin(self.system)
        self._state.constraints = self._rigidity.bonds
        self._warn_of_timestep()
        self._forces.fit_skin(observables.largest_speed(self.velocities) * abs(self.method.timestep))
        self._look()
        acceleration = largest_acceleration(self.forces, self._rigidity.inverse_masses)
        fault = fault_at_start(self.system, acceleration, self._forces.potential_energy, self.method.timestep, self._forces.longest_stride)
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

    def _check_energy(self, seen: dict[str, Any]) -> None:
        """Raise NonFiniteError if the energy seen is not finite or has run away, back in the state before the last steps."""
        if not np.isfinite(seen["total_energy"]):
            raise self._failure("the potential energy is not finite", self.step)
        if self._first is None:
            self._first = seen
        self._fail_if(self._runaway())

    def _check_heat(self, most: float) -> None:
        """Raise NonFiniteError, likewise, if the kinetic energy is larger than this."""
        kinetic = observables.kinetic_energy(self.velocities, self.system.masses)
        self._fail_if(f"the kinetic energy has gone to {kinetic:.3g} {self.system.units.energy}" if kinetic > most else None)

    def _fail_if(self, fault: str | None) -> None:
        if fault:
            step, at = self.step, self.positions.copy()
            if self._before is not None:
                self.go_to(self._before)
            raise self._failure(fault, step, at)

    def _energy_in_motion(self) -> float:
        """K + |U| [energy]."""
        return observables.kinetic_energy(self.velocities, self.system.masses) + abs(self._forces.potential_energy)

    def _is_hot(self) -> bool:
        """Whether the kinetic energy alone, which costs nothing, makes a look at the energies worthwhile."""
        kinetic, first = observables.kinetic_energy(self.velocities, self.system.masses), self._first
        return first is not None and kinetic > RUNAWAY * (first["kinetic_energy"] + abs(first["potential_energy"]))

    def _fingerprint(self) -> tuple[Any, ...]:
        """Numbers that change when somebody moves atoms, changes velocities or the cell."""
        masses = self.system.masses
        sums = observables.momentum(self.positions, masses), observables.momentum(self.velocities, masses)
        return observables.kinetic_energy(self.velocities, masses), *np.concatenate(sums).tolist(), id(self.system.cell)

    def _runaway(self) -> str | None:
        """Whether the energies of the present state, which were just evaluated, have run away from those of the first look."""
        kinetic, potential = observables.kinetic_energy(self.velocities, self.system.masses), self._forces.potential_energy
        now = {"kinetic_energy": kinetic, "potential_energy": potential, "total_energy": kinetic + potential}
        if self.method.is_thermostat:
            now["conserved_energy"] = kinetic + potential - self._state.heat
        return runaway(self.system, self.method.timestep, self._first, now) if self._first else None

    def _failure(self, fault: str, step: int, at: NDArray[np.float64] | None = None) -> NonFiniteError | ConstraintError:
        """The error for a run that failed in a step, with its crash report; the system is in the last good state.  at : (N, 3), of the failure."""
        reason, here = self._reason, (step, self.method.timestep, self.step)
        error: NonFiniteError | ConstraintError = NonFiniteError(failure_sentence(self.system, fault, *here))
        if isinstance(reason, ConstraintError):
            error, fault = ConstraintError(broken_constraint(self.system, reason, *here)), str(reason)
        moments = self._moments or [self.moment]
        start = next((moment for moment in reversed(moments) if self.step - moment.step >= LEAST_REPLAY), moments[0])
        self.failed_from = start
        failure = Failure(fault, step, self.step, getattr(reason, "atoms", None), at, start, is_first=start.step == self._first_step)
        with suppress(Exception):  # whatever terms of the user's own raise: what is broken must not hide that it is
            self._forces.compute(PER_ATOM)
            acting = Acting(self._forces.potentials, self.forces, self._forces.energies, self._rigidity.inverse_masses)
            error.crash_report = examine(self.system, acting, self.method, failure)
            error.args = (f"{error}. Likely cause: {error.crash_report.cause}",)
        return error
