"""Simulation: a system, its forces and a method; runs steps and lets observers look between them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from minimd import observables
from minimd.compiling import compile_clock
from minimd.errors import NonFiniteError
from minimd.faults import autopsy, fault_at_start, fault_of
from minimd.forces import Forces, Potential
from minimd.integrators.splitting import Splitting, State
from minimd.interrupt import stop_on_interrupt
from minimd.options import Options
from minimd.potentials.pair_loop import FORCES, TOTALS
from minimd.progress import Progress
from minimd.record import Frame, Record
from minimd.report import Cost, Report, conservation_report
from minimd.system import System
from minimd.trajectory import Writer, open_trajectories
from minimd.velocities import maxwell_boltzmann, rescaled

if TYPE_CHECKING:
    import ase

STEPS_BETWEEN_CHECKS = 100  # at most; a failure is then replayed to find its step
Observer = Callable[["Simulation"], None]


class Simulation:
    """Molecular dynamics of one system.

    Parameters
    ----------
    system : System, or ase.Atoms. The simulation works on a copy; sim.system is always the current state.
    potentials : one potential or several.
    method : a splitting with its time step, such as VelocityVerlet(0.005).
    threads, precision, skin : see Options.

    Attributes
    ----------
    system : System, the state.  step : int, steps made so far.  time : [time].  record : Record of the last run.

    Raises
    ------
    TypeError, ValueError : for arguments of another kind, and as Forces does.
    """

    def __init__(
        self,
        system: "System | ase.Atoms",
        potentials: Potential | Sequence[Potential],
        method: Splitting,
        *,
        threads: int | None = None,
        precision: Literal["double", "mixed"] = "double",
        skin: float | None = None,
    ) -> None:
        if not isinstance(method, Splitting):
            raise TypeError(f"method must be an integrator with its time step, such as VelocityVerlet(0.005); got {method!r}")
        self.system = system.copy() if isinstance(system, System) else System.from_ase(system)
        self.method = method
        self.step = 0
        self.time = 0.0
        self.record: Record | None = None
        self._run_seconds, self._run_steps = 0.0, 0
        self._forces = Forces(self.system, potentials, Options(threads, precision, skin))
        self._state = State(self.system.positions, self.system.velocities, self._forces.forces, 1.0 / self.system.masses)

    def __repr__(self) -> str:
        return f"Simulation({self.system!r}, {self.method!r}, step {self.step})"

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
        """Draw Maxwell-Boltzmann velocities: kinetic temperature exactly this one, total momentum zero (of several atoms).

        Raises
        ------
        ValueError : if the temperature is negative or not finite.
        """
        self.velocities[:] = maxwell_boltzmann(self.system.masses, temperature, self.system.units.k_B, seed)

    def rescale_temperature(self, temperature: float) -> None:
        """Multiply all velocities so that the kinetic temperature is exactly this one.

        Raises
        ------
        ValueError : if the temperature is negative or not finite, or nothing moves.
        """
        self.velocities[:] = rescaled(self.velocities, self.system.masses, temperature, self.system.units.k_B)

    def equilibrate(self, n_steps: int, temperature: float, every: int = 10, progress: bool | None = None) -> None:
        """Run n_steps and rescale the velocities to a temperature after every few of them; step and time start at 0 again.

        Raises
        ------
        NonFiniteError, KeyboardInterrupt : as run does.  ValueError : for counts or a temperature out of range.
        """
        _check_counts(n_steps, every)
        self._check_start()
        with Progress(n_steps, "equilibrating", progress) as bar, stop_on_interrupt(self._state):
            for done in range(every, n_steps + every, every):
                self._advance(min(every, n_steps - done + every), look=False)
                self.rescale_temperature(temperature)
                bar.advance_to(min(done, n_steps))
        self.step, self.time = 0, 0.0

    def run(
        self,
        n_steps: int,
        *,
        every: int = 100,
        trajectory: str | Path | Sequence[str | Path] = (),
        store_forces: bool = False,
        overwrite: bool = False,
        observers: Sequence[Observer] = (),
        progress: bool | None = None,
    ) -> Record:
        """Make n_steps steps and observe the first state and every few steps after it.

        Parameters
        ----------
        every : steps between observations, for record, trajectory and observers alike.
        trajectory : a file or several, of the format that the suffix names: see minimd.trajectory.
        store_forces : write forces into formats that can hold them.
        overwrite : replace files that exist.
        observers : functions called with this simulation at each observation.
        progress : show a progress bar; if not given, on a terminal only.

        Raises
        ------
        NonFiniteError : if the run blows up. The message names step, atoms and pair; sim.system holds the last good state.
        KeyboardInterrupt : after Ctrl-C, with the state of the last whole step, all files valid.
        FileExistsError, ValueError, OSError : for outputs that cannot be written, before the first step where possible.
        """
        _check_counts(n_steps, every)
        self._check_start()
        self.record = Record(self.system.units, len(self.system))
        self._run_seconds, self._run_steps = 0.0, 0
        self._forces.reset_counts()
        start, end = self.step, self.step + n_steps
        with (
            stop_on_interrupt(self._state),
            open_trajectories(trajectory, self, store_forces=store_forces, overwrite=overwrite) as writers,
            Progress(n_steps, "running", progress) as bar,
        ):
            self._observe(self.record, writers, observers)
            while self.step < end:
                next_look = self.step + every - (self.step - start) % every
                n_steps_now = min(STEPS_BETWEEN_CHECKS, next_look - self.step, end - self.step)
                self._advance(n_steps_now, look=self.step + n_steps_now == next_look)
                bar.advance_to(self.step - start)
                if self.step == next_look:
                    self._observe(self.record, writers, observers)
        return self.record

    def report(self) -> Report:
        """How well the last run conserved what it should, and how fast it was.

        Raises
        ------
        ValueError : if nothing has run yet.
        """
        if self.record is None:
            raise ValueError("there is nothing to report yet; call run first")
        cost = Cost(
            self._run_steps, self._run_seconds, self._forces.n_builds, self._forces.n_evaluations, self._forces.pair_search, self._forces.skipped()
        )
        return conservation_report(self.record, angular=not self.system.cell.is_periodic, cost=cost)

    def frame(self) -> Frame:
        """The state as it is now, with its observables; the forces are evaluated."""
        self._state.forces_are_current = False
        return self._frame()

    def _frame(self) -> Frame:
        self._look()
        system, forces = self.system, self._forces
        motion = (system.positions, system.velocities, system.masses)
        potential, kinetic = forces.potential_energy, observables.kinetic_energy(*motion[1:])
        values = {
            "potential_energy": potential,
            "kinetic_energy": kinetic,
            "total_energy": potential + kinetic,
            "temperature": observables.temperature(*motion[1:], system.units.k_B),
            "momentum": observables.momentum(*motion[1:]),
            "angular_momentum": observables.angular_momentum(*motion),
            "absolute_momentum": observables.absolute_momentum(*motion[1:]),
            "absolute_angular_momentum": observables.absolute_angular_momentum(*motion),
        }
        if system.volume is not None:
            values["pressure"] = observables.pressure(kinetic, forces.virial, system.volume)
        return Frame(self.step, self.time, self.positions, self.velocities, self.forces, values)

    def _observe(self, record: Record, writers: Sequence[Writer], observers: Sequence[Observer]) -> None:
        frame = self._frame()
        if not np.isfinite(frame.observables["total_energy"]):
            raise NonFiniteError(self._autopsy("the potential energy is not finite", self.step))
        record.append(frame)
        for writer in writers:
            writer.write(frame)
        for observer in observers:
            observer(self)
            self._state.forces_are_current = False  # it may have moved atoms

    def _look(self) -> None:
        """Make sure that forces, energy and virial are those of the present positions."""
        if not (self._state.forces_are_current and self._forces.has_energy):
            self._compute_forces(self._state, True)
            self._state.forces_are_current = True

    def _compute_forces(self, _state: State, look: bool) -> None:
        self._forces.compute(TOTALS if look else FORCES)

    def _advance(self, n_steps: int, look: bool) -> None:
        """Make up to n_steps steps, fewer after Ctrl-C; if they fail, go back and find out at which and why."""
        before = self.positions.copy(), self.velocities.copy()
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
        try:
            done = self.method.advance(self._state, self._compute_forces, n_steps, look)
        except NonFiniteError:
            return None
        return done if self._fault() is None else None

    def _replay(self, before: tuple[NDArray, NDArray], n_steps: int) -> NoReturn:
        """Repeat a failed run of steps one by one, up to the last good state; raise NonFiniteError about the next."""
        self._restore(before)
        for _ in range(n_steps):
            good = self.positions.copy(), self.velocities.copy()
            if self._attempt(1, look=False) is None:
                fault = self._fault() or "the forces are not finite"
                self._restore(good)
                raise NonFiniteError(self._autopsy(fault, self.step + 1))
            self._count(1)
        raise NonFiniteError(self._autopsy("a run of steps failed that succeeded one by one", self.step))

    def _restore(self, state: tuple[NDArray, NDArray]) -> None:
        self.positions[:], self.velocities[:] = state
        self._state.forces_are_current = False

    def _count(self, done: int) -> None:
        self.step += done
        self._run_steps += done
        self.time += done * self.method.timestep

    def _check_start(self) -> None:
        """Look at the state anew, and raise NonFiniteError if the first step would throw atoms across the scene."""
        self._state.forces_are_current = False
        self._forces.fit_skin(observables.largest_speed(self.velocities) * abs(self.method.timestep))
        self._look()
        fault = fault_at_start(self.system, self.forces, self._forces.potential_energy, self.method.timestep, self._forces.longest_stride)
        if fault:
            raise NonFiniteError(self._autopsy(fault, self.step))

    def _fault(self) -> str | None:
        return fault_of(self.system, self.method.timestep, self._forces.longest_stride)

    def _autopsy(self, fault: str, step: int) -> str:
        return autopsy(self.system, fault, step, self.method.timestep, self.step)


def _check_counts(n_steps: int, every: int) -> None:
    for name, value, least in (("n_steps", n_steps, 0), ("every", every, 1)):
        if not isinstance(value, (int, np.integer)) or value < least:
            raise ValueError(f"{name} must be a whole number, at least {least}; {name} = {value!r}")
