"""The run guard makes steps in blocks; a block that fails is undone, made again step by step, and explained."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import isfinite
from time import perf_counter
from typing import Any, NoReturn

from minimd.core.compiled.kernels import compile_clock
from minimd.core.console.quiet import warn
from minimd.core.diagnosis.crash_report import examine
from minimd.core.diagnosis.evidence import Evidence, Failure
from minimd.core.diagnosis.judge import GROWTH, RUNAWAY, fault_of, hints, runaway
from minimd.core.diagnosis.rules import at_start, not_finite
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import observe
from minimd.core.engine.record import Frame
from minimd.core.engine.snapshot import Snapshot
from minimd.core.neighbors.queries import closest_pair
from minimd.core.potentials.term import PER_ATOM
from minimd.core.structure.arrays import Array
from minimd.core.structure.errors import ConstraintError, NonFiniteError, RangeError
from minimd.core.structure.observables import longest

# steps between two checks, at most: a check costs two passes over the atoms, repeating a block half a block on average
BLOCK = 100
# atoms times steps of a block of few atoms, and its steps, at most: its checks cost as much as 30 steps
SMALL = 50_000
LONGEST_BLOCK = 500
RUN_BEGAN = "the run began"
FAILED_AS_BLOCK = "some steps failed together, although each of them succeeded alone"
MOST_SNAPSHOTS = 16  # that are kept; at least one is
ROOM = 10**6  # atoms in all snapshots that are kept
SNAPSHOTS_APART = 40  # steps between two snapshots that are kept, at least
# of K + |U|: a potential that gives another energy for the same atoms has been changed
SAME_ENERGY = 1e-3
# steps from the snapshot with which a replay begins to the failure, if there were that many
LEAST_REPLAY = 20


class RunGuard:
    """Makes the steps of an engine, and finds out what went wrong when one fails.
    seconds, n_steps : of the present run, without compilation.
    observing : seconds of its observers.
    failed_from : Snapshot from which the last failure can be replayed.
    bath_settings : of the engine, different ones in the present run, by ramps or by observers."""

    _snapshots: list[Snapshot]  # at least SNAPSHOTS_APART steps apart
    _first: Mapping[str, Any] | None  # observables at the first look of a run
    _seen: tuple[int, float]  # step of the last look, and the total energy then

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.seconds = 0.0
        self.observing = 0.0
        self.n_steps = 0
        self.failed_from: Snapshot | None = None
        self.bath_settings: set[tuple[float | None, float | None]] = set()
        self._first_volume = engine.system.volume
        self._checked_timestep = 0.0  # none yet
        self._checked = 0.0, -1  # and after how many beginnings
        # by which every run is judged: see judge_by
        self._judged_by: tuple[Mapping[str, Any] | None, float] = None, RUNAWAY
        # why the last block failed, if something was raised
        self._reason: NonFiniteError | ConstraintError | None = None
        self._before: Snapshot | None = None  # the start of the last block
        self.forget()

    @property
    def block(self) -> int:
        """Steps between two checks, at most."""
        return max(BLOCK, min(LONGEST_BLOCK, SMALL // len(self.engine.positions)))

    def begin_run(self) -> None:
        """Count from zero: steps, seconds, evaluations, list builds, iterations of constraints."""
        self.seconds = 0.0
        self.observing = 0.0
        self.n_steps = 0
        self.bath_settings = set()
        self._first, self._growth = self._judged_by
        self.engine.interactions.reset_counts()
        if self.engine.constraint_set.bonds is not None:
            self.engine.constraint_set.bonds.iterations = 0

    @contextmanager
    def uncounted(self) -> Iterator[None]:
        """Context for computations that do not count as part of the last run, which the report describes."""
        interactions = self.engine.interactions
        counted = self.seconds, self.n_steps, interactions.counts
        try:
            yield
        finally:
            self.seconds, self.n_steps, interactions.counts = counted

    def judge_by(self, first: Mapping[str, Any] | None, growth: float) -> None:
        """Judge later runs by the energies at the start of another, of which they are a part: see judge.runaway."""
        self._judged_by = first, growth

    @property
    def judgment(self) -> tuple[Mapping[str, Any] | None, float]:
        """The energies and the growth by which the present run is judged, for judge_by."""
        return self._first, self._growth

    def check_start(self, is_same_run: bool = False) -> None:
        """Take the state as it is now; one not changed since the last step continues as if there had been no pause.
        is_same_run : energies and snapshots of earlier steps remain valid, if the energy is still the same.
        Raises NonFiniteError if the first step would throw atoms across the scene, and as Forces.check_resolution."""
        engine = self.engine
        timestep = engine.method.timestep
        self._reason = None
        self._before = None
        if not is_same_run:
            self.forget()
        is_checked = engine.enter() and self._checked == (timestep, engine.beginnings)
        if not is_checked:
            for verdict in not_finite(Evidence(engine)):
                raise NonFiniteError(f"at step {engine.step} {verdict.cause}")
            engine.interactions.check_resolution()
        if not self._checked_timestep:
            engine.interactions.check_forces(engine.time)
        if not engine.begin():
            engine.interactions.fit_skin(longest(engine.velocities)[1] * abs(engine.method.stride))
        engine.evaluate()
        engine.prepare()
        if is_same_run:
            kinetic = engine.kinetic_energy
            potential = engine.potential_energy
            change = abs(kinetic + potential - self._seen[1])
            if not change <= SAME_ENERGY * (kinetic + abs(potential)):
                self.forget()  # nothing has moved since the last look
        if self._checked_timestep != timestep:
            self._checked_timestep = timestep
            for hint in hints(engine):
                warn(hint)
        if not is_checked:
            fault = fault_of(engine, at_start)
            if fault:
                raise self._failure(fault, engine.step)
        self._checked = timestep, engine.beginnings

    def make_steps(self, n_steps: int, with_energy: bool = False) -> None:
        """Make steps, in blocks.
        with_energy : as for advance.
        Raises as advance and observe."""
        try:
            for done in range(0, n_steps, self.block):
                n_left = n_steps - done
                is_last = n_left <= self.block
                self.advance(min(self.block, n_left), with_energy and is_last)
                if self.is_hot():
                    self.observe()
        finally:
            self.engine.leave()

    def advance(self, n_steps: int, with_energy: bool) -> None:
        """Make up to n_steps steps, fewer after Ctrl-C; if they fail, go back and find out which step failed and why.
        with_energy : evaluate the energy with the last forces.
        Raises NonFiniteError, ConstraintError if a step fails; the engine is then in the last good state.
        KeyboardInterrupt after Ctrl-C. ValueError if the scene no longer fits the list it needs."""
        engine = self.engine
        snapshots = self._snapshots
        n_kept = max(1, min(MOST_SNAPSHOTS, ROOM // len(engine.positions)))
        is_due = n_kept == 1 or not snapshots or engine.step - snapshots[-1].step >= SNAPSHOTS_APART
        self._before = None
        if is_due:
            del snapshots[: max(0, len(snapshots) + 1 - n_kept)]  # makes room for the new one
        before = engine.snapshot()
        self._before = before
        if is_due:
            snapshots.append(before)
        started = perf_counter()
        compiled = compile_clock.seconds
        self._reason = None
        try:
            done = engine.advance(n_steps, with_energy)
        except (NonFiniteError, ConstraintError):
            self._replay(before, n_steps, FAILED_AS_BLOCK)
        except BaseException:
            # a list that does not fit, or a second Ctrl-C in the middle of a step
            engine.restore(before)
            raise
        self.seconds += perf_counter() - started - (compile_clock.seconds - compiled)
        if fault_of(engine):
            self._replay(before, n_steps, FAILED_AS_BLOCK)
        self._count(done)
        if engine.surroundings.stop_requested:
            engine.leave()
            raise KeyboardInterrupt(f"stopped after step {engine.step}")

    def _replay(self, before: Snapshot, n_steps: int, otherwise: str) -> NoReturn:
        """Repeat failed steps one by one, up to the last good state; raise the error of the next step.
        otherwise : the fault if none fails."""
        engine = self.engine
        engine.restore(before)
        for _ in range(n_steps):
            good = engine.snapshot()
            try:
                engine.advance(1)
                fault = fault_of(engine)
                if not fault:
                    engine.evaluate()  # a method that ends with a drift has not done so
                    fault = self._fault_of_energy()
            except (NonFiniteError, ConstraintError) as reason:
                self._reason = reason
                fault = fault_of(engine)
                if not fault and isinstance(reason, RangeError):
                    fault = str(reason)
                fault = fault or "the forces are not finite"
            if fault:
                at = engine.positions.copy()
                engine.restore(good, is_whole=True)
                raise self._failure(fault, engine.step + 1, at)
            self._count(1)
        step = engine.step
        engine.restore(before, is_whole=True)
        raise self._failure(otherwise, step)

    def _count(self, done: int) -> None:
        self.engine.count(done)
        self.n_steps += done

    def observe(self) -> Frame:
        """The present state; NonFiniteError if its energy is not finite or has run away: the engine is then back in
        the last good state."""
        frame = observe(self.engine)
        if self._first is None:
            self._first = frame.observables
        self._fail_if(self._fault_of_energy())
        self._seen = frame.step, float(frame.observables["total_energy"])
        return frame

    def _fault_of_energy(self) -> str | None:
        """What is wrong with the energies, which must be current; None if they are good."""
        if not isfinite(self.engine.potential_energy):
            return "the potential energy is not finite"
        if self._first is None:
            return None
        return runaway(self.engine, self._first, self._growth, self._since)

    def check_kinetic_energy(self, most: float) -> None:
        """Raise NonFiniteError if the kinetic energy is larger than most [energy]; the engine is then in the last good
        state of the last block."""
        engine = self.engine
        kinetic = engine.kinetic_energy
        before = self._before
        if not kinetic > most:
            return
        if before is not None:
            end = engine.snapshot()
            engine.restore(before)
            self._first = observe(engine).observables
            self._since = f"step {before.step}"
            self._seen = (before.step, 0.0)
            engine.restore(end)
        unit = engine.system.units.energy
        self._fail_if(f"the kinetic energy has gone to {kinetic:.3g} {unit}")

    def is_hot(self) -> bool:
        """Whether the kinetic energy alone, which costs nothing, is a reason to check all energies."""
        first = self._first
        if first is None:
            return False
        energy = first["kinetic_energy"] + abs(first["potential_energy"])
        return self.engine.kinetic_energy > RUNAWAY * energy

    def forget(self) -> None:
        """Forget energies and snapshots: the state was changed from outside."""
        self._snapshots = []
        self._first_step = self.engine.step  # of the present run
        self._first = None
        # with which energies have run away, and since when
        self._growth = RUNAWAY
        self._since = RUN_BEGAN
        self._seen = (self.engine.step, 0.0)

    def drop_snapshots(self) -> None:
        """Drop the snapshots: velocities were rescaled, and a replay from one would not lead to the present state."""
        self._snapshots = []

    def _fail_if(self, fault: str | None) -> None:
        """If there is a fault, fail at the first bad step, which may be some steps earlier."""
        if not fault:
            return
        engine = self.engine
        end = engine.step
        start = self._before
        if start is None:
            raise self._failure(fault, end, engine.positions.copy())
        # the latest stored state, since the last observation, in which no energy had run away yet
        growth = self._growth
        self._growth = min(GROWTH, growth)
        known = {snapshot.step: snapshot for snapshot in (*self._snapshots, start)}
        for step in sorted(known, reverse=True):
            if not self._seen[0] <= step <= start.step:
                continue
            engine.restore(known[step])
            engine.evaluate()
            if not self._fault_of_energy():
                start = known[step]
                break
        else:
            self._growth = growth
        n_steps = end - start.step
        self.n_steps -= n_steps
        self._replay(start, n_steps, fault)

    def _failure(
        self, fault: str, step: int, at: Array | None = None
    ) -> NonFiniteError | ConstraintError:
        """The error for a run that failed in a step, with its crash report; the engine is in the last good state.
        at : (N, 3), of the failure."""
        engine = self.engine
        snapshots = self._snapshots or [engine.snapshot()]
        early = [known for known in snapshots if engine.step - known.step >= LEAST_REPLAY]
        start = early[-1] if early else snapshots[0]
        self.failed_from = start
        reason = self._reason
        is_out_of_range = isinstance(reason, RangeError)
        kind: type[NonFiniteError | ConstraintError] = NonFiniteError
        if isinstance(reason, ConstraintError | RangeError):
            kind = type(reason)
            fault = str(reason)
        report = None
        why = ""
        try:
            engine.sums = engine.interactions.compute(PER_ATOM)
        except Exception as broken:  # whatever a term of the user's own raises
            why = f"There is no crash report: {type(broken).__name__}: {broken}\n"
        else:
            failure = Failure(
                fault=fault,
                step=step,
                constraint=getattr(reason, "atoms", None),
                at=at,
                start=start,
                is_first=start.step == self._first_step,
                first_volume=self._first_volume,
                is_of_barostat=engine.barostat is not None and is_out_of_range,
            )
            report = examine(engine, failure)
            if not is_out_of_range:
                why = f"Likely cause: {report.cause}; {report.advice}\n"
        pair = closest_pair(engine.system)
        near = ""
        if pair is not None:
            apart = pair.told(engine.system.units.length)
            near = f"; in the last good state the closest pair is {apart}"
        held = f"The system holds the last good state, that of step {engine.step}"
        error = kind(f"{why}At step {step}: {fault}{near}. {held}")
        error.crash_report = report
        return error
