"""The run guard: makes steps in blocks; a block that fails is undone, made again step by step, and its failure explained."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import isfinite
from time import perf_counter
from typing import Any, NoReturn

from minimd.compiled.kernels import compile_clock
from minimd.diagnosis.crash_report import Failure, examine
from minimd.diagnosis.faults import RUNAWAY, fault_at_start, fault_of, runaway
from minimd.diagnosis.first_hints import hints
from minimd.engine.engine import Engine, Snapshot
from minimd.engine.observation import observe
from minimd.engine.record import Frame
from minimd.neighbors.queries import closest_pair
from minimd.potentials.term import PER_ATOM
from minimd.structure.console import outside_minimd
from minimd.structure.errors import ConstraintError, NonFiniteError, RangeError
from minimd.structure.observables import Array, longest

BLOCK = 100  # steps between two checks, at most: a check costs two passes over the atoms, repeating a block half a block on average
SNAPSHOTS_APART = 40  # steps between two snapshots that are kept, at least
LEAST_REPLAY = 20  # steps from the snapshot with which a replay begins to the failure, if there were as many


class RunGuard:
    """Makes the steps of an engine, and finds out what went wrong when one fails.

    seconds, n_steps : of the present run, without compilation.  failed_from : Snapshot from which the last failure can be replayed.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.seconds, self.n_steps = 0.0, 0
        self.failed_from: Snapshot | None = None
        self._checked_timestep = 0.0  # none yet
        self._first: Mapping[str, Any] | None = None  # observables at the first look of a run
        self._reason: NonFiniteError | ConstraintError | None = None  # why the last block failed, if something was raised
        self._before: Snapshot | None = None  # the start of the last block
        self._snapshots: list[Snapshot] = []  # at most two, at least SNAPSHOTS_APART steps apart
        self._first_step = 0  # of the present run

    def begin_run(self) -> None:
        """Count from zero: steps, seconds, evaluations, list builds, iterations of constraints."""
        self.seconds, self.n_steps, self._first = 0.0, 0, None
        self.engine.interactions.reset_counts()
        if self.engine.constraint_set.bonds is not None:
            self.engine.constraint_set.bonds.iterations = 0

    @contextmanager
    def uncounted(self) -> Iterator[None]:
        """What is computed inside is no part of the last run, of which the report tells."""
        interactions = self.engine.interactions
        counted = self.seconds, self.n_steps, interactions.counts
        try:
            yield
        finally:
            self.seconds, self.n_steps, interactions.counts = counted

    def check_start(self) -> None:
        """Take the state as it is now. Raise NonFiniteError if the first step would throw atoms across the scene, and as Forces.check_resolution.

        A state that nobody has changed since the last step goes on as if there had been no pause.
        """
        engine = self.engine
        self._snapshots, self._first_step, self._reason, self._before, self._first = [], engine.step, None, None, None
        engine.interactions.check_resolution()
        goes_on = engine.is_as_left
        if not goes_on:
            engine.begin()
        if not goes_on:
            engine.interactions.fit_skin(longest(engine.velocities)[1] * abs(engine.method.timestep))
        engine.evaluate()
        engine.interactions.prepare()
        if not goes_on:
            engine.leave()
        if self._checked_timestep != engine.method.timestep:
            self._checked_timestep = engine.method.timestep
            for hint in hints(engine):
                warnings.warn(hint, stacklevel=outside_minimd())
        if fault := fault_at_start(engine):
            raise self._failure(fault, engine.step)

    def make_steps(self, n_steps: int, with_energy: bool = False) -> None:
        """Make steps, in blocks.  with_energy : evaluate the energy with the last forces.  Raises as advance."""
        try:
            for done in range(0, n_steps, BLOCK):
                self.advance(min(BLOCK, n_steps - done), with_energy and done + BLOCK >= n_steps)
        finally:
            self.engine.leave()

    def advance(self, n_steps: int, with_energy: bool) -> None:
        """Make up to n_steps steps, fewer after Ctrl-C; if they fail, go back and find out at which and why.

        Raises NonFiniteError, ConstraintError if a step fails; the engine is then in the last good state. KeyboardInterrupt: after Ctrl-C.
        ValueError if the scene no longer fits the list it needs.
        """
        engine = self.engine
        is_due = not self._snapshots or engine.step - self._snapshots[-1].step >= SNAPSHOTS_APART
        self._snapshots, self._before = self._snapshots[-1:] if is_due else self._snapshots, None  # makes room for the new one
        self._before = before = engine.snapshot()
        if is_due:
            self._snapshots.append(before)
        is_whole, engine.is_whole = engine.is_whole, False  # until the steps are counted
        started, compiled, self._reason = perf_counter(), compile_clock.seconds, None
        try:
            done = engine.advance(n_steps, with_energy)
        except (NonFiniteError, ConstraintError):
            self._replay(before, n_steps)
        except BaseException:  # a list that does not fit, or a second Ctrl-C in the middle of a step
            engine.restore(before)
            raise
        self.seconds += perf_counter() - started - (compile_clock.seconds - compiled)
        if fault_of(engine):
            self._replay(before, n_steps)
        self._count(done)
        engine.is_whole = is_whole
        if engine.surroundings.stop_requested:
            engine.leave()
            raise KeyboardInterrupt(f"stopped after step {engine.step}")

    def _replay(self, before: Snapshot, n_steps: int) -> NoReturn:
        """Repeat a failed block step by step, up to the last good state; raise the error of the next step."""
        engine = self.engine
        engine.restore(before)
        for _ in range(n_steps):
            good = engine.snapshot()
            try:
                engine.advance(1)
                fault = fault_of(engine)
                if not fault:
                    engine.evaluate()  # a method that ends with a drift has not
                    fault = runaway(engine, self._first) if self._first is not None else None
            except (NonFiniteError, ConstraintError) as reason:
                words = str(reason) if isinstance(reason, RangeError) else "the forces are not finite"
                self._reason, fault = reason, fault_of(engine) or words
            if fault:
                at = engine.positions.copy()
                engine.restore(good)
                raise self._failure(fault, engine.step + 1, at)
            self._count(1)
        raise self._failure("a block of steps failed that succeeded one by one", engine.step)

    def _count(self, done: int) -> None:
        self.engine.count(done)
        self.n_steps += done

    def observe(self) -> Frame:
        """The present state, checked.

        Raises NonFiniteError if its energy is not finite or has run away; the engine is back in the state before the last block.
        """
        frame = observe(self.engine)
        if self._first is None:
            self._first = frame.observables
        is_finite = isfinite(frame.observables["total_energy"])
        self._fail_if(runaway(self.engine, self._first) if is_finite else "the potential energy is not finite")
        return frame

    def check_kinetic_energy(self, most: float) -> None:
        """Raise NonFiniteError if the kinetic energy is larger than most [energy]; the state is then restored as in observe."""
        kinetic = self.engine.kinetic_energy
        self._fail_if(f"the kinetic energy has gone to {kinetic:.3g} {self.engine.system.units.energy}" if kinetic > most else None)

    def is_hot(self) -> bool:
        """Whether the kinetic energy alone, which costs nothing, makes a look at the energies worthwhile."""
        first = self._first
        return first is not None and self.engine.kinetic_energy > RUNAWAY * (first["kinetic_energy"] + abs(first["potential_energy"]))

    def forget(self) -> None:
        """The state was changed from outside: energies and snapshots from before say nothing about it."""
        self._snapshots, self._first, self._first_step = [], None, self.engine.step

    def drop_snapshots(self) -> None:
        """The velocities were rescaled: a replay from before would not come to the present state."""
        self._snapshots = []

    def _fail_if(self, fault: str | None) -> None:
        if fault:
            step, at = self.engine.step, self.engine.positions.copy()
            if self._before is not None:
                self.engine.restore(self._before)
            raise self._failure(fault, step, at)

    def _failure(self, fault: str, step: int, at: Array | None = None) -> NonFiniteError | ConstraintError:
        """The error for a run that failed in a step, with its crash report; the engine is in the last good state.  at : (N, 3), of the failure."""
        engine, reason = self.engine, self._reason
        engine.is_whole = True  # a good state, worth keeping, though the roundings of a run from it may be others
        snapshots = self._snapshots or [engine.snapshot()]
        self.failed_from = start = next((one for one in reversed(snapshots) if engine.step - one.step >= LEAST_REPLAY), snapshots[0])
        kind, fault = (type(reason), str(reason)) if isinstance(reason, ConstraintError | RangeError) else (NonFiniteError, fault)
        report, why = None, ""
        try:
            engine.interactions.compute(PER_ATOM)
        except Exception as broken:  # whatever a term of the user's own raises
            why = f"There is no crash report: {type(broken).__name__}: {broken}\n"
        else:
            failure = Failure(fault, step, getattr(reason, "atoms", None), at, start, start.step == self._first_step)
            report = examine(engine, failure)
            why = "" if isinstance(reason, RangeError) else f"Likely cause: {report.cause}; {report.advice}\n"
        pair = closest_pair(engine.system)
        near = f"; the closest pair before it is {pair}" if pair else ""
        error = kind(f"{why}At step {step}: {fault}{near}. The system holds the last good state, that of step {engine.step}")
        error.crash_report = report
        return error
