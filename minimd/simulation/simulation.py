"""Simulation: a system, its forces and a method; runs steps and lets observers look between them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from minimd.diagnosis.crash_report import left_at, place_of
from minimd.diagnosis.faults import RUNAWAY
from minimd.diagnosis.report import Cost, Report, conservation_report
from minimd.diagnosis.reversibility import Reversibility, probe
from minimd.diagnosis.run_guard import Dynamics
from minimd.diagnosis.shadow_energy import check_extras, correction, motion_curvature
from minimd.diagnosis.static_checks import safety_lines
from minimd.engine.frames import observe
from minimd.engine.record import Frame, Record
from minimd.files.trajectory import Writer, open_trajectories
from minimd.forces.forces import Potential
from minimd.forces.options import Options
from minimd.integrators.splitting.splitting import Splitting
from minimd.minimization.minimization import FORCE_TOLERANCE, MAX_STEP_LENGTH, MAX_STEPS, Minimization, minimized
from minimd.structure.console import Progress, stop_on_interrupt
from minimd.structure.constraints import Constraint
from minimd.structure.system import System

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
    constraints : DistanceConstraints, FixedAtoms, or both, instead of those of the system; () for none.
    threads, precision, skin : see Options.

    Attributes
    ----------
    system : System, the state.  step : int, steps made so far.  time : [time].  record : Record of the last run.
    extra_observables : names of more that is to be observed, ("shadow_energy",): see minimd.shadow_energy.
    reversibility : Reversibility that was probed last.

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
        self.extra_observables: Sequence[str] = ()
        self.reversibility: Reversibility | None = None
        self._is_running = False

    def equilibrate(
        self, n_steps: int, temperature: float, every: int = 10, progress: bool | None = None, crash_report: str | Path | None = None
    ) -> None:
        """Run n_steps and rescale the velocities to a temperature after every few of them; step and time start at 0 again.

        The noise of a thermostat is that of steps before the start, other ones for each equilibration of this simulation.
        crash_report : a file to leave if it fails, as that of run.

        Raises
        ------
        NonFiniteError, KeyboardInterrupt : as run does.  ValueError : for counts or a temperature out of range.
        """
        _check_counts(n_steps, every)
        with self._running():
            self._equilibrated += n_steps
            self.noise_shift = -self._equilibrated - self.step
            try:
                with self._uncounted(), left_at(place_of(crash_report or False, ()), self, False):
                    self._equilibrate(n_steps, temperature, every, progress)
            finally:
                self.noise_shift = 0
        self.step, self.time, self._state.heat = 0, 0.0, 0.0

    def _equilibrate(self, n_steps: int, temperature: float, every: int, progress: bool | None) -> None:
        self._first = None
        with Progress(n_steps, "equilibrating", progress) as bar, stop_on_interrupt(self._state):
            self._check_start()
            most = RUNAWAY * (self._energy_in_motion() + self.n_dof * self.system.units.k_B * temperature)
            for done in range(every, n_steps + every, every):
                self._advance(min(every, n_steps - done + every), look=False)
                self._check_heat(most)
                self.rescale_temperature(temperature)
                self._moments = []  # a replay does not rescale
                bar.advance_to(min(done, n_steps))

    def minimize(
        self,
        *,
        force_tolerance: float = FORCE_TOLERANCE,
        max_steps: int = MAX_STEPS,
        max_step_length: float = MAX_STEP_LENGTH,
        progress: bool | None = None,
    ) -> Minimization:
        """Move the atoms to a minimum of the potential energy nearby; step and time do not change. See minimd.minimize.

        Raises
        ------
        NonFiniteError, ConstraintError, ValueError, KeyboardInterrupt : as minimize; sim.system then holds the state reached.
        """
        self._state.forces_are_current = False
        with self._uncounted():
            return minimized(self._forces, self._rigidity, force_tolerance, max_steps, max_step_length, progress)

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
        crash_report: str | Path | bool = True,
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
        crash_report : where to leave a file if the run blows up: beside the first trajectory if there is one (True), at a path, or nowhere (False).
            The file holds the last good state and what minimd.replay needs; where one stands that may not be replaced, it gets a number.

        Raises
        ------
        NonFiniteError, ConstraintError : if the run blows up. The message names step, atoms and pair, the likely cause, and the file of
            the crash report; sim.system holds the last good state.
        KeyboardInterrupt : after Ctrl-C, with the state of the last whole step, all files valid.
        FileExistsError, ValueError, OSError : for outputs that cannot be written, before the first step where possible.
        """
        _check_counts(n_steps, every)
        check_extras(self, self.extra_observables)
        with self._running():
            return self._run(n_steps, every, (trajectory, store_forces, overwrite), observers, progress, crash_report)

    def _run(
        self,
        n_steps: int,
        every: int,
        files: tuple[str | Path | Sequence[str | Path], bool, bool],
        observers: Sequence[Observer],
        progress: bool | None,
        crash_report: str | Path | bool,
    ) -> Record:
        trajectory, store_forces, overwrite = files
        with left_at(place_of(crash_report, trajectory), self, overwrite):
            self._check_start()
        self.record = Record(self.system.units, len(self.system))
        self._run_seconds, self._run_steps, self._first = 0.0, 0, None
        self._forces.reset_counts()
        if self._state.constraints is not None:
            self._state.constraints.iterations = 0
        start, end = self.step, self.step + n_steps
        with (
            left_at(place_of(crash_report, trajectory), self, overwrite),  # behind the closing of all files
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
                    self._check_energy(self._frame().observables)
        return self.record

    def probe_reversibility(self, n_steps: int) -> Reversibility:
        """Make n_steps, turn all velocities round, make as many again, and say how far from the start that ends; the state is restored.

        Three times n_steps are made: how far rounding would lead astray is measured too. Later reports repeat the answer.

        Raises
        ------
        ValueError : with a thermostat, whose noise cannot be undone, or for a number of steps below 1.
        NonFiniteError, ConstraintError : as run.
        """
        _check_count("n_steps", n_steps, 1)
        if self.method.is_thermostat:
            raise ValueError(f"{self.method.name} is a thermostat: its noise cannot be undone, so that no run of it is reversible")
        before = self.moment
        with self._uncounted():
            self._check_start()
            try:
                with stop_on_interrupt(self._state):
                    self.reversibility = probe(self, int(n_steps))
            finally:
                self.go_to(before)
        return self.reversibility

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

    def report(self) -> Report:
        """How well the last run conserved what it should, and how fast it was.

        Raises
        ------
        ValueError : if nothing has run yet.
        """
        if self.record is None:
            raise ValueError("there is nothing to report yet; call run first")
        self._fit_images()
        forces, bonds = self._forces, self._state.constraints
        cost = Cost(
            n_steps=self._run_steps,
            seconds=self._run_seconds,
            list_builds=forces.n_builds,
            n_evaluations=forces.n_evaluations,
            pair_search=forces.pair_search,
            skipped=forces.skipped(),
            constraints=f"{bonds.summary}; at most {bonds.iterations} iterations in a drift" if bonds else "",
        )
        is_free = self.conserves_momentum
        angular = is_free and not self.system.cell.is_periodic
        return conservation_report(self.record, linear=is_free, angular=angular, cost=cost, lines=safety_lines(self))

    def frame(self) -> Frame:
        """The state as it is now, with its observables; the forces are evaluated."""
        self._state.forces_are_current = False
        self._fit_images()
        return self._frame()

    def _frame(self) -> Frame:
        bend = motion_curvature(self) if "shadow_energy" in self.extra_observables else None
        self._look()
        forces, virial = self._forces, self._forces.virial
        bonds = self._state.constraints
        if bonds is not None:
            virial = virial + bonds.virial(self.positions, self.velocities, forces.forces)
        frame = observe(self, virial, forces.potential_energy, bonds)
        if bend is not None:
            frame.observables["shadow_energy"] = frame.observables["total_energy"] + correction(self, bend)
        return frame

    def _observe(self, record: Record, writers: Sequence[Writer], observers: Sequence[Observer]) -> None:
        frame = self._frame()
        self._check_energy(frame.observables)
        record.append(frame)
        for writer in writers:
            writer.write(frame)
        if observers:
            before = self._fingerprint()
            for observer in observers:
                observer(self)
                self._state.forces_are_current = False  # it may have moved atoms
            self._first = self._first if self._fingerprint() == before else None  # its heat, its work on the cell: no fault of the method
            self._rigidity.begin(self.system)
            self._state.constraints = self._rigidity.bonds


def _check_counts(n_steps: int, every: int) -> None:
    _check_count("n_steps", n_steps, 0)
    _check_count("every", every, 1)


def _check_count(name: str, value: int, least: int) -> None:
    if not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}; {name} = {value!r}")
