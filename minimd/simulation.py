"""Simulation: a system, its forces and a method; runs steps and lets observers look between them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from minimd.dynamics import Dynamics
from minimd.errors import NonFiniteError
from minimd.faults import RUNAWAY
from minimd.forces import Potential
from minimd.frames import observe
from minimd.integrators.splitting import Splitting
from minimd.interrupt import stop_on_interrupt
from minimd.observables import kinetic_energy
from minimd.options import Options
from minimd.progress import Progress
from minimd.record import Frame, Record
from minimd.report import Cost, Report, conservation_report
from minimd.rigidity import Constraint
from minimd.system import System
from minimd.trajectory import Writer, open_trajectories

if TYPE_CHECKING:
    import ase

STEPS_BETWEEN_CHECKS = 100  # at most; a failure is then replayed to find its step
Observer = Callable[["Simulation"], None]


class Simulation(Dynamics):
    """Molecular dynamics of one system.

    Parameters
    ----------
    system : System, or ase.Atoms. The simulation works on a copy; sim.system is always the current state.
    potentials : one potential or several.
    method : a splitting with its time step, such as VelocityVerlet(0.005).
    constraints : DistanceConstraints, FixedAtoms, or both; those of the system if not given.
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
        constraints: Constraint | Sequence[Constraint] | None = None,
        *,
        threads: int | None = None,
        precision: Literal["double", "mixed"] = "double",
        skin: float | None = None,
    ) -> None:
        super().__init__(system, potentials, method, constraints, Options(threads, precision, skin))
        self.record: Record | None = None
        self._is_running = False
        self._looked_at = self._saved(), self.step, self.time, self.system.cell

    def equilibrate(self, n_steps: int, temperature: float, every: int = 10, progress: bool | None = None) -> None:
        """Run n_steps and rescale the velocities to a temperature after every few of them; step and time start at 0 again.

        Raises
        ------
        NonFiniteError, KeyboardInterrupt : as run does.  ValueError : for counts or a temperature out of range.
        """
        _check_counts(n_steps, every)
        with self._running():
            self._equilibrate(n_steps, temperature, every, progress)

    def _equilibrate(self, n_steps: int, temperature: float, every: int, progress: bool | None) -> None:
        self._first = None
        self._noise_shift = -n_steps - self.step  # noise of its own, for a thermostat: that of steps before the start
        self._check_start()
        most = RUNAWAY * (self._kinetic_energy() + abs(self._forces.potential_energy) + self.n_dof * self.system.units.k_B * temperature)
        with Progress(n_steps, "equilibrating", progress) as bar, stop_on_interrupt(self._state):
            for done in range(every, n_steps + every, every):
                before, step, time = self._saved(), self.step, self.time
                self._advance(min(every, n_steps - done + every), look=False)
                if self._kinetic_energy() > most:
                    fault, failed = f"the kinetic energy has gone to {self._kinetic_energy():.3g} {self.system.units.energy}", self.step
                    self._restore(before)
                    self.step, self.time = step, time
                    raise NonFiniteError(self._autopsy(fault, failed))
                self.rescale_temperature(temperature)
                bar.advance_to(min(done, n_steps))
        self.step, self.time, self._state.heat, self._noise_shift = 0, 0.0, 0.0, 0

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
        NonFiniteError, ConstraintError : if the run blows up. The message names step, atoms and pair; sim.system holds the last good state.
        KeyboardInterrupt : after Ctrl-C, with the state of the last whole step, all files valid.
        FileExistsError, ValueError, OSError : for outputs that cannot be written, before the first step where possible.
        """
        _check_counts(n_steps, every)
        with self._running():
            return self._run(n_steps, every, trajectory, store_forces, overwrite, observers, progress)

    def _run(
        self,
        n_steps: int,
        every: int,
        trajectory: str | Path | Sequence[str | Path],
        store_forces: bool,
        overwrite: bool,
        observers: Sequence[Observer],
        progress: bool | None,
    ) -> Record:
        self._check_start()
        self._noise_shift = 0
        self.record = Record(self.system.units, len(self.system))
        self._run_seconds, self._run_steps, self._first = 0.0, 0, None
        self._forces.reset_counts()
        if self._state.constraints is not None:
            self._state.constraints.iterations = 0
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
                self._advance(n_steps_now, look=self.step + n_steps_now in (next_look, end))
                bar.advance_to(self.step - start)
                if self.step == next_look:
                    self._observe(self.record, writers, observers)
                elif self.step == end or self._is_hot():
                    self._check_energy(self._frame())
                else:
                    self._looked_at = self._saved(), self.step, self.time, self.system.cell
        return self.record

    @contextmanager
    def _running(self) -> Iterator[None]:
        """Refuse a run inside a run."""
        if self._is_running:
            raise RuntimeError("this simulation is running: an observer can look and change things, but not run or equilibrate")
        self._is_running = True
        try:
            yield
        finally:
            self._is_running = False

    def _kinetic_energy(self) -> float:
        return kinetic_energy(self.velocities, self.system.masses)

    def report(self) -> Report:
        """How well the last run conserved what it should, and how fast it was.

        Raises
        ------
        ValueError : if nothing has run yet.
        """
        if self.record is None:
            raise ValueError("there is nothing to report yet; call run first")
        forces, bonds = self._forces, self._state.constraints
        cost = Cost(
            n_steps=self._run_steps,
            seconds=self._run_seconds,
            list_builds=forces.n_builds,
            n_evaluations=forces.n_evaluations,
            pair_search=forces.pair_search,
            skipped=forces.skipped(),
            constraints=f"{bonds.words}; at most {bonds.iterations} iterations in a drift" if bonds else "",
        )
        is_free = self.conserves_momentum
        return conservation_report(self.record, linear=is_free, angular=is_free and not self.system.cell.is_periodic, cost=cost)

    def frame(self) -> Frame:
        """The state as it is now, with its observables; the forces are evaluated."""
        self._state.forces_are_current = False
        return self._frame()

    def _frame(self) -> Frame:
        self._look()
        forces, virial = self._forces, self._forces.virial
        bonds = self._state.constraints
        if bonds is not None:
            virial = virial + bonds.virial(self.positions, self.velocities, forces.forces)
        return observe(self, virial, forces.potential_energy, bonds)

    def _observe(self, record: Record, writers: Sequence[Writer], observers: Sequence[Observer]) -> None:
        frame = self._frame()
        self._check_energy(frame)
        record.append(frame)
        for writer in writers:
            writer.write(frame)
        for observer in observers:
            observer(self)
            self._state.forces_are_current = False  # it may have moved atoms
        if observers:
            self._first = self._first if self._is_as_looked_at() else None
            self._rigidity.begin(self.system, self._state)

    def _check_energy(self, frame: Frame) -> None:
        """Raise NonFiniteError if the energy is not finite or runs away, back in the state of the last look."""
        if not np.isfinite(frame.observables["total_energy"]):
            raise NonFiniteError(self._autopsy("the potential energy is not finite", self.step))
        if self._first is None:
            self._first = frame.observables
        fault = self._runaway()
        if fault:
            self._restore(self._looked_at[0])
            self.step, self.time, _ = self._looked_at[1:]
            raise NonFiniteError(self._autopsy(fault, frame.step))
        self._looked_at = self._saved(), self.step, self.time, self.system.cell

    def _is_hot(self) -> bool:
        """Whether the kinetic energy alone, which costs nothing, makes a look at the energies worthwhile."""
        first = self._first
        return first is not None and self._kinetic_energy() > RUNAWAY * (first["kinetic_energy"] + abs(first["potential_energy"]))

    def _is_as_looked_at(self) -> bool:
        """Whether observers have only looked: their heat, and their work on the cell, are no fault of the method."""
        (positions, velocities, _), *_, cell = self._looked_at
        return np.array_equal(self.positions, positions) and np.array_equal(self.velocities, velocities) and self.system.cell is cell


def _check_counts(n_steps: int, every: int) -> None:
    for name, value, least in (("n_steps", n_steps, 0), ("every", every, 1)):
        if not isinstance(value, (int, np.integer)) or value < least:
            raise ValueError(f"{name} must be a whole number, at least {least}; {name} = {value!r}")
