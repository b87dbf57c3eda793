"""Simulation: runs an engine, and calls observers between its steps."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any, Literal, Self

import minimd.core.diagnosis.shadow_energy  # noqa: F401 - registers an observable, of runs and of files
from minimd.core.console.display import Displayed, Rows
from minimd.core.console.progress import progress_of
from minimd.core.console.signals import stop_on_signals
from minimd.core.constraints.solver import ConstraintSolver
from minimd.core.diagnosis.judge import RUNAWAY
from minimd.core.diagnosis.report import Report
from minimd.core.diagnosis.reversibility import Reversibility, make_steps_back, probe
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.diagnosis.run_report import report_of
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import check_extras, observe
from minimd.core.engine.observer import PeriodicObserver
from minimd.core.engine.record import Frame, Record
from minimd.core.engine.snapshot import Snapshot
from minimd.core.files.crash_file import crash_file_left, crash_file_place
from minimd.core.files.trajectory import Writer, first_h5md, named_files, open_trajectories
from minimd.core.forces.forces import Potential
from minimd.core.forces.options import Options, Precision
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.integrators.splitting import Splitting
from minimd.core.minimization.minimization import (
    FORCE_TOLERANCE,
    MAX_STEP_LENGTH,
    MAX_STEPS,
    Minimization,
    minimized,
)
from minimd.core.simulation.attached import Attached
from minimd.core.simulation.engine_attribute import Closed, EngineAttribute, MeasuredAttribute
from minimd.core.simulation.goal import UNLIMITED, Goal
from minimd.core.simulation.resuming import last_step, resumed
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count, checked_flag, checked_kind, checked_number
from minimd.core.structure.constraints import Constraint
from minimd.core.structure.grid import Grid
from minimd.core.structure.observables import maxwell_boltzmann, rescaled
from minimd.core.structure.system import AnySystem, System

# for any value of every: no more is lost when the process is killed
SECONDS_BETWEEN_CHECKPOINTS = 5.0
Observer = Callable[["Simulation"], None] | PeriodicObserver


class Simulation(Closed, Displayed):
    """Molecular dynamics of one system.

    Parameters
    ----------
    system : System, or ase.Atoms. The simulation works on a copy; sim.system is always the current state.
    potentials : one potential or several.
    method : a splitting with its time step, such as VelocityVerlet(0.005).
    constraints : DistanceConstraints, FixedAtoms, or both, in place of those of the system; () for none.
    threads : their largest number; all cores of the process if not given. Results are the same, to the last bit,
        for any number.
    precision : "double", or "fixed-point": all sums exact, see docs/fixed-point.md.
    skin : of neighbor lists [length]; the best one if not given.
    grid : Grid of fixed-point arithmetic; chosen from the scene if not given.
    barostat : StochasticCellRescaling, which keeps the pressure; None for a constant cell.

    Attributes
    ----------
    engine : Engine, which holds state, forces, constraints and method.
    guard : RunGuard, which makes its steps.
    record : Record of the last run, None before.
    goal : Goal of the last run, None without.
    reversibility : Reversibility that was probed last, or None.

    Raises
    ------
    TypeError, ValueError : for wrong arguments, and as Forces.
    """

    own = ("engine", "guard", "record", "goal", "reversibility")
    system = EngineAttribute[System](
        "The state; its arrays can be changed, not replaced by those of another system."
    )
    method = EngineAttribute[Splitting](
        "The integrator with its time step; another one takes over with the next step. See Engine.method."
    )
    step = EngineAttribute[int]("Steps made so far; set it when a run is resumed.")
    time = EngineAttribute[float]("[time] since the start; set it when a run is resumed.")
    reservoir_energy = EngineAttribute[float](
        "Given by a thermostat since the start [energy]; set it when a run is resumed."
    )
    work = EngineAttribute[float]("Done since the start by forces that depend on time [energy].")
    extra_observables = EngineAttribute[Sequence[str]](
        'Names of observables besides the usual ones: "shadow_energy" (see minimd.shadow_energy), "stress".',
        check=check_extras,
    )
    positions = EngineAttribute[Array](
        "(N, 3) [length], never wrapped; what is assigned is copied into this array."
    )
    velocities = EngineAttribute[Array]("(N, 3) [length/time]; likewise.")
    forces = EngineAttribute[Array]("(N, 3) [energy/length], of the present state.")
    n_dof = EngineAttribute[int]("Degrees of freedom that share the thermal energy.")
    drift = EngineAttribute[Array](
        "Velocity of the center of mass if n_dof leaves it out, else 0 [length/time].", "drift"
    )
    conserves_momentum = EngineAttribute[bool](
        "Whether the total momentum is a constant; see Engine."
    )
    constraints = EngineAttribute[tuple[Constraint, ...]](
        "What is held fixed, with the lengths that are kept; also those of system."
    )
    rigid_bonds = EngineAttribute[ConstraintSolver | None](
        "Lengths that are held, as they are kept in a run; None without.", "constraint_set.bonds"
    )
    potential_energy = MeasuredAttribute[float]("U [energy].")
    kinetic_energy = MeasuredAttribute[float]("K [energy].")
    total_energy = MeasuredAttribute[float]("U + K [energy].")
    temperature = MeasuredAttribute[float]("Kinetic temperature.")
    pressure = MeasuredAttribute[float]("P [energy/length³]; ValueError without a volume.")
    stress = MeasuredAttribute[Array](
        "σ [energy/length³], (3, 3), kinetic part included, positive under tension: P = −tr σ / 3; ValueError without "
        "a volume."
    )
    potentials = EngineAttribute[tuple[Potential, ...]](
        "What acts on the atoms.", "interactions.potentials"
    )
    barostat = EngineAttribute[StochasticCellRescaling | None](
        "What keeps the pressure, or None.", "barostat"
    )
    options = EngineAttribute[Options](
        "Threads, precision and skin, as they were asked for.", "interactions.options"
    )
    skins = EngineAttribute[list[float]](
        "Of all lists that have one [length].", "interactions.skins"
    )

    def __init__(
        self,
        system: AnySystem,
        potentials: Potential | Sequence[Potential],
        method: Splitting,
        constraints: Constraint | Sequence[Constraint] | None = None,
        *,
        threads: int | None = None,
        precision: Precision = "double",
        skin: float | None = None,
        grid: Grid | None = None,
        barostat: StochasticCellRescaling | None = None,
    ) -> None:
        self._hold(
            Engine(
                system,
                potentials,
                method,
                constraints,
                Options(threads, precision, skin, grid),
                barostat,
            )
        )

    def _hold(self, engine: Engine) -> None:
        self.engine, self.guard, self._is_running = engine, RunGuard(engine), False
        self.record: Record | None = None
        self.goal: Goal | None = None
        self.reversibility: Reversibility | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and copy: nothing is shared, and the copy goes on with the same bits."""
        guard = self.guard
        return _copied, (
            type(self),
            self.engine,
            guard.seconds,
            guard.n_steps,
            self.record,
            self.reversibility,
            self.goal,
        )

    def __repr__(self) -> str:
        return f"Simulation({self.system!r}, {self.method!r}, step {self.step})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        return self.engine.display_rows()

    @classmethod
    def resume(
        cls,
        file: str | Path,
        potentials: Potential | Sequence[Potential] | None = None,
        *,
        method: Splitting | None = None,
        threads: int | None = None,
    ) -> Self:
        """The simulation at the restart of an H5MD file.

        Its next steps are those that the run would have made, to the last bit.

            sim = md.Simulation.resume("run.h5md", potentials)
            sim.run(until_step=100_000, trajectory="run.h5md", append=True)

        Parameters
        ----------
        potentials : those of the run; if not given, those of the scene that is stored in the file.
        method : that of the run, if it is a class of a script; if not given, the one that is stored in the file.
        threads : as above.

        Raises
        ------
        FileNotFoundError, OSError, ValueError : for a file that does not exist, is damaged or not of minimd, or has no
            scene if no potentials are given.
        """
        simulation: Self = resumed(cls, file, potentials, method, threads)
        return simulation

    def run(
        self,
        n_steps: int | None = None,
        *,
        until_step: int | None = None,
        every: int = 100,
        trajectory: str | Path | Sequence[str | Path] | None = None,
        store_forces: bool = False,
        overwrite: bool = False,
        append: bool | Literal["auto"] = False,
        observers: Sequence[Observer] = (),
        progress: bool | None = None,
        crash_report: str | Path | bool = True,
        max_seconds: float | None = None,
        until: Mapping[str, float] | Literal["equilibrated"] | None = None,
        max_steps: int | None = None,
    ) -> Record:
        """Make n_steps steps, or those up to until_step, or as many as until needs; observe the first state, and those
        at multiples of every. Return the Record of these steps only; minimd.read_record(file) has all frames of a file.

        A run of N steps and one of M steps give the same numbers, to the last bit, as one of N + M steps,
        if nothing is changed in between.

        Parameters
        ----------
        every : steps between observations, for record, trajectory, and observers that are functions; those of
            md.observers have an every of their own.
        trajectory : one file or several, None for none; the suffix gives the format, see minimd.core.files.trajectory.
        store_forces : write forces into formats that can hold them.
        overwrite : replace files that exist.
        append : continue the trajectory, an H5MD file whose restart is the state of this simulation; "auto" does so
            if it exists, else begins it.
        observers : functions called with this simulation at each observation; and those of minimd.observers, which have
            their own steps and give results at the end. An H5MD file keeps them for a run that continues it.
        progress : show a progress bar; if not given, on a terminal and in a notebook.
        crash_report : where to leave a file if the run blows up: beside the first trajectory if there is one (True), at
            a path, or nowhere (False). It holds the last good state and what minimd.replay needs;
            an existing file is kept unless overwrite, and the new one numbered.
        max_seconds : of wall time, after which the run ends with a whole step, all files valid, and a sentence on
            standard error; sim.step says how far it came. It can go on with append.
        until : relative errors of means, such as {"pressure": 0.01}, by names of observables of the record, or of
            numbers with an error in results of the observers, such as "diffusion"; or "equilibrated". The run ends as
            soon as all are reached, and sim.goal tells what was. See docs/until.md.
        max_steps : that such a run may make.

        Raises
        ------
        NonFiniteError, ConstraintError : if the run blows up. The message names step, atoms and pair, the likely cause,
            and the file of the crash report; sim.system holds the last good state.
        KeyboardInterrupt : after Ctrl-C, with the state of the last whole step, all files valid.  SystemExit :
            likewise after SIGTERM or SIGHUP.
        FileExistsError, ValueError, OSError : for outputs that cannot be written, before the first step where possible.
        """
        engine = self.engine
        guard = self.guard
        start = engine.step
        every = checked_count("every", every)
        end = last_step(start, n_steps, until_step, until is not None, max_steps)
        if isinstance(append, str) and append == "auto":
            append = any(map(Path.exists, named_files("trajectory", trajectory)))
        append = checked_flag("append", append)
        overwrite = checked_flag("overwrite", overwrite)
        store_forces = checked_flag("store_forces", store_forces)
        attached = Attached(observers, engine)
        check_extras(engine)
        seconds = inf
        if max_seconds is not None:
            seconds = checked_number("max_seconds", max_seconds, "positive and finite")
        goal = None if until is None else Goal(until, attached.accumulators, seconds)
        self.goal = goal
        place = crash_file_place(crash_report, trajectory)
        # the crash file is written after all others are closed
        with self._running(engine.noise_shift), crash_file_left(place, guard, overwrite):
            guard.check_start()
            if goal is not None:
                goal.check(observe(engine).observables)
            with (
                stop_on_signals(engine.surroundings, seconds),
                open_trajectories(
                    trajectory,
                    engine,
                    store_forces=store_forces,
                    overwrite=overwrite,
                    append=append,
                    every=every,
                    n_steps=None if until is not None else end - start,
                    observers=attached.accumulators,
                ) as writers,
                progress_of(
                    end if end < UNLIMITED else None, "running", progress, start=start
                ) as tell,
                attached.broken_off(),
            ):
                system = engine.system
                self.record = Record(
                    system.units, len(system), first_h5md(trajectory), engine.conserves_momentum
                )
                guard.begin_run()
                attached.begin()
                is_written = append and start % every != 0
                self._observe([] if is_written else writers, attached)
                self._make_observed_steps(start, end, every, writers, attached, tell)
                engine.leave()
        return self.record

    def _make_observed_steps(
        self,
        start: int,
        end: int,
        every: int,
        writers: Sequence[Writer],
        attached: Attached,
        tell: Callable[..., None],
    ) -> None:
        """The steps of a run, in blocks that end where somebody looks."""
        engine = self.engine
        guard = self.guard
        checkpoint_due = monotonic() + SECONDS_BETWEEN_CHECKPOINTS
        while engine.step < end:
            step = engine.step
            next_look = step + every - step % every
            n_now = min(guard.block, next_look - step, end - step, attached.steps_to_next())
            step += int(n_now)
            is_last = step == end
            guard.advance(int(n_now), step == next_look or is_last or attached.need_energy(step))
            tell(step)
            if guard.is_hot() or (is_last and end < next_look):
                guard.observe()  # before others look at what may have failed
            guard.observing += attached.look()
            if step == next_look:
                self._observe(writers, attached)
                if self.goal is not None and self.record is not None:
                    tell(step, self.goal.judge(self.record, start, end))
                    if self.goal.is_reached:
                        break
            if monotonic() > checkpoint_due:
                for writer in writers:
                    writer.checkpoint()
                checkpoint_due = monotonic() + SECONDS_BETWEEN_CHECKPOINTS

    def _observe(self, writers: Sequence[Writer], attached: Attached) -> None:
        engine = self.engine
        frame = self.guard.observe()
        if self.record is not None:
            self.record.append(frame)
        for writer in writers:
            writer.write(frame)
        if attached.functions:
            engine.leave()
            cell = engine.system.cell
            positions = engine.positions.copy()
            try:
                for observer in attached.functions:
                    observer(self)
            finally:
                is_unchanged = engine.enter()
            if self.record is not None and ("conserved_energy" in self.record) != engine.has_bath:
                later = f"{engine.method.name} can only take over in a new run"
                raise ValueError(f"a thermostat cannot be switched on or off within a run; {later}")
            if not is_unchanged:
                if engine.system.cell is cell and (positions != engine.positions).any():
                    # as when atoms were wrapped; observers know how a cell moves atoms
                    attached.interrupt()
                self.guard.forget()
                engine.begin()
        if engine.has_bath:
            self.guard.bath_settings.add(engine.bath_settings)

    def make_steps(self, n_steps: int) -> None:
        """Make steps without observations.
        Raises ValueError for a negative count, and as run."""
        n_steps = checked_count("n_steps", n_steps, 0)
        if not self.engine.begin():
            self.guard.forget()
        self.guard.make_steps(n_steps)

    def equilibrate(
        self,
        n_steps: int,
        temperature: float,
        every: int = 10,
        progress: bool | None = None,
        crash_report: str | Path | None = None,
    ) -> None:
        """Run n_steps and rescale the velocities to a temperature every `every` steps; then set step and time to 0.

        The noise of a thermostat is that of steps before the start; it differs between equilibrations.
        crash_report : the crash file to write if it fails, as for run.

        Raises
        ------
        NonFiniteError, KeyboardInterrupt : as run does.
        ValueError : for counts or a temperature out of range.
        """
        engine = self.engine
        guard = self.guard
        n_steps = checked_count("n_steps", n_steps, 0)
        every = checked_count("every", every)
        temperature = checked_number("temperature", temperature, "finite and not negative")
        engine.equilibrated += n_steps
        place = crash_file_place(crash_report, ())
        with (
            self._running(noise_shift=-engine.equilibrated - self.step),
            guard.uncounted(),
            crash_file_left(place, guard, overwrite=False),
            progress_of(n_steps, "equilibrating", progress) as tell,
            stop_on_signals(engine.surroundings),
        ):
            if engine.interactions.depend_on_time:
                engine.time = -n_steps * engine.method.duration  # so that it ends at 0
            guard.check_start()
            thermal = engine.n_dof * self.system.units.k_B * temperature
            most = RUNAWAY * (engine.kinetic_energy + abs(engine.potential_energy) + thermal)
            for done in range(every, n_steps + every, every):
                guard.make_steps(min(every, n_steps - done + every))
                guard.check_kinetic_energy(most)
                self.rescale_temperature(temperature)
                engine.method.adapt()
                guard.drop_snapshots()  # a replay does not rescale
                tell(min(done, n_steps))
        engine.step = 0
        engine.time = 0.0
        engine.reservoir_energy = 0.0
        engine.work = 0.0

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
        NonFiniteError, ConstraintError, ValueError, KeyboardInterrupt : as minimize;
            sim.system then holds the state reached.
        """
        self.engine.changed()
        with self.guard.uncounted():
            scene = self.engine.interactions, self.engine.constraint_set
            return minimized(*scene, force_tolerance, max_steps, max_step_length, progress)

    def probe_reversibility(self, n_steps: int) -> Reversibility:
        """Make n_steps, reverse all velocities, make n_steps again, and measure the distance from the start.

        The state is restored. Another n_steps from the reversal measure the distance that rounding alone explains.
        Later reports include the result.

        Raises
        ------
        ValueError : with a thermostat, whose noise cannot be undone, or for a number of steps below 1.
        NonFiniteError, ConstraintError : as run.
        """
        self.reversibility = probe(self.guard, checked_count("n_steps", n_steps))
        return self.reversibility

    def run_back(self, n_steps: int) -> None:
        """Retrace the last n_steps steps, to the last bit, step and time too: for precision="fixed-point" and a
        symmetric method.

        Raises
        ------
        ValueError : for another precision, a method that is not symmetric, or a negative count.
        RangeError : as run.
        """
        make_steps_back(self.guard, checked_count("n_steps", n_steps, 0))

    @contextmanager
    def _running(self, noise_shift: int) -> Iterator[None]:
        """Context of a run.
        noise_shift : of the engine in it.
        Raises RuntimeError for a run inside a run."""
        if self._is_running:
            may = "an observer may read and change its state, but not run or equilibrate it"
            raise RuntimeError(f"this simulation is running: {may}")
        before = self.engine.noise_shift
        self._is_running = True
        self.engine.noise_shift = noise_shift
        try:
            yield
        finally:
            self._is_running = False
            self.engine.noise_shift = before

    def report(self) -> Report:
        """How well the last call of run conserved what it should, and how fast it was.
        Raises ValueError before it."""
        if self.record is None:
            others = "equilibrate, make_steps, minimize and resume do not observe the simulation"
            raise ValueError(
                f"there is nothing to report; call run first: {others}; for a file: minimd check FILE"
            )
        return report_of(self.guard, self.record, self.reversibility)

    def frame(self) -> Frame:
        """The present state, with its observables; the forces are evaluated."""
        self.engine.enter()
        return observe(self.engine)

    def set_temperature(self, temperature: float, seed: int | None = None) -> None:
        """Draw Maxwell-Boltzmann velocities: kinetic temperature exactly this one, total momentum zero (of several free
        atoms).
        Raises ValueError if the temperature is negative or not finite."""
        system = self.system
        constraint_set = self.engine.constraint_set
        system.velocities[:] = maxwell_boltzmann(
            system.masses, temperature, system.units.k_B, seed, system.dimensions
        )
        self.engine.enter()
        constraint_set.project(system.velocities, system.positions)
        if temperature > 0.0:
            self.rescale_temperature(temperature)

    def rescale_temperature(self, temperature: float) -> None:
        """Multiply all velocities, relative to the drift, so that the kinetic temperature is exactly this one.

        Raises ValueError if the temperature is negative or not finite, or nothing moves.
        """
        v = self.velocities
        k_B = self.system.units.k_B
        v[:] = rescaled(v, self.system.masses, temperature, k_B, self.n_dof, self.drift)

    def snapshot(self) -> Snapshot:
        """A copy of the present state, for restore."""
        return self.engine.snapshot()

    def restore(self, snapshot: Snapshot) -> None:
        """Restore the state of a snapshot.
        Raises TypeError for anything else."""
        self.engine.restore(
            checked_kind("snapshot", snapshot, Snapshot, "what sim.snapshot() has returned")
        )


def _copied(
    kind: type[Simulation], engine: Engine, seconds: float, n_steps: int, *results: Any
) -> Simulation:
    """The simulation that __reduce__ has described.
    results : record, reversibility, goal."""
    simulation = kind.__new__(kind)
    simulation._hold(copy.deepcopy(engine))
    simulation.guard.seconds = seconds
    simulation.guard.n_steps = n_steps
    simulation.record, simulation.reversibility, simulation.goal = copy.deepcopy(results)
    return simulation
