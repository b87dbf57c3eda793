"""Steps as a program: the row of a method, with the forces, constraints and bath of a scene, as operations.

A row is cut where positions have moved and a kick needs new forces, F. Velocity Verlet, n steps:

    kick ½ · drift      F · kick ½ · kick ½ · drift   (n − 1 times)      F · kick ½
    head                the rest of a step, and the head of the next     the rest of the last step

Kicks and drifts that follow each other are one pass over memory, but not one kick: nothing of a step depends on
whether another one follows.
"""

from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import (
    BREATHE,
    GO_ON,
    JUMP,
    Operation,
    Program,
    in_python,
    n_chunks_of,
    operation,
)
from minimd.core.compiled.threads import ThreadPool, thread_pool
from minimd.core.console.words import shown
from minimd.core.integrators.flows import DRIFT, KICK, Moving, move_atoms
from minimd.core.integrators.state import GridState, State, Surroundings
from minimd.core.integrators.substeps import (
    BondedKick,
    Drift,
    Kick,
    Substep,
    Substeps,
    Thermalize,
    merged,
)
from minimd.core.structure.arrays import Indices
from minimd.core.structure.errors import RangeError
from minimd.core.structure.grid import TOO_LARGE

MADE, TO_MAKE, FIRST, UNTIL_BREATH, BREATH = range(5)  # places in a count
ATOM_STEPS = 8_000_000  # in a breath, about a second
DIGITS_OF_PHASE = 12  # so that coefficients that add up to one are one


class Moment(NamedTuple):
    """A moment of a program.
    counts : see Counting.
    begun : how many steps have begun before the present one: counts[MADE] + begun.
    phase : time since the beginning of that step, in time steps; only drifts advance it.
    contact : number of contacts with a bath in that step before."""

    counts: Indices
    begun: int = 0
    phase: float = 0.0
    contact: int = 0

    @property
    def step(self) -> int:
        """The number of the present step."""
        return int(self.counts[FIRST] + self.counts[MADE]) + self.begun

    @property
    def time(self) -> float:
        """The same with the time since its beginning, in time steps."""
        return self.step + round(self.phase, DIGITS_OF_PHASE)

    def after(self, event: "Event") -> "Moment":
        """The moment after an event."""
        if isinstance(event, Beginning):
            return Moment(self.counts, self.begun + 1)
        if isinstance(event, Drift):
            return self._replace(phase=self.phase + event.coefficient)
        return self._replace(contact=self.contact + isinstance(event, Thermalize))


class Row(Protocol):
    """A method: its substeps, and the time over which they act; see Splitting."""

    @property
    def stride(self) -> float:
        """[time]."""

    substeps: ClassVar[Any]
    drifts: int

    def contact(
        self, state: State, duration: float, around: Surroundings, moment: Moment
    ) -> Iterable[Operation]:
        """The operations of a contact with a bath."""


class ForceSource(NamedTuple):
    """Where forces come from.

    operations : those that evaluate them, with the energy or without, over a unit of time [time], at a moment.
    version : of the memory that they work on.
    pool : the threads.
    running : context for the run of a program with such operations.
    power : ∂U/∂t of the last evaluation, see Surroundings.powers, if forces depend on time.
    taken : called after a run, with whether the last evaluation had the energy, and its unit [time].
    bonded : has forces of bonded terms alone, see Forces.bonded_operations and bonded_pushes."""

    operations: Callable[[bool, float, Moment], Iterable[Operation]]
    version: Callable[[], Any] = lambda: 0
    pool: Callable[[], ThreadPool] = lambda: thread_pool(1)
    running: Callable[[Program], AbstractContextManager] = lambda _program: nullcontext()
    power: Callable[[], tuple[float, float]] | None = None
    taken: Callable[[bool, float], None] = lambda _with_energy, _unit: None
    bonded: Any = None


class Force(NamedTuple):
    """New forces.
    unit : of the kicks that follow, see unit_of.
    with_energy : and the energy."""

    unit: float
    with_energy: bool = False


class BondedForce(NamedTuple):
    """New forces of bonded terms alone.
    unit : see Force."""

    unit: float


class Projection(NamedTuple):
    """Velocities projected onto the constraints."""


class Beginning(NamedTuple):
    """The beginning of the next step."""


Event = Substep | Force | BondedForce | Projection | Beginning
Events = tuple[Event, ...]


class StepCounting(ByAddress, namedtuple("StepCounting", "counts")):
    """counts : (5,) int, steps MADE and TO_MAKE, the number of the FIRST; those UNTIL_BREATH, and in each BREATH."""


@called_kernel
def count_step(counting, _chunk):
    """One more step has come to its last forces; JUMP if it is the last one.  BREATHE when it is time to,
    before the step is counted."""
    counts = counting.counts
    if counts[UNTIL_BREATH] == 0:
        counts[UNTIL_BREATH] = counts[BREATH]
        return BREATHE
    counts[UNTIL_BREATH] -= 1
    counts[MADE] += 1
    return JUMP if counts[MADE] >= counts[TO_MAKE] else GO_ON


def unit_of(row: Substeps, flow: Kick | Drift) -> float:
    """The coefficient over which a kick or a drift is rounded on a grid: that of its kind at an end of the step,
    if it is a whole multiple of it; two half kicks then are one kick."""
    for end in (row[0], row[-1]):
        if type(end) is type(flow) and flow.coefficient % end.coefficient == 0.0:
            return end.coefficient
    return flow.coefficient


def first_unit(method: Row) -> float:
    """Of the first kick of a step [time].
    Errors : see merged_row."""
    row = merged_row(method)
    kicks = [substep for substep in row if isinstance(substep, Kick)]
    return unit_of(row, kicks[0] if kicks else Kick(1.0)) * method.stride


def merged_row(method: Row) -> Substeps:
    """The substeps of a method, neighbors of one kind merged.
    Raises TypeError, ValueError for anything but Kick, Drift and Thermalize, and if none has a duration."""
    row = merged(method.substeps)
    if not row:
        raise ValueError(
            f"{type(method).__name__} must have at least one substep with a duration; "
            f"substeps = {shown(method.substeps)}"
        )
    return row


def _first_place(kind: Any, events: Events) -> int:
    """Of the first event of a kind; the number of all events if there is none."""
    return next((k for k, event in enumerate(events) if isinstance(event, kind)), len(events))


class Steps:
    """The steps of a method on a state.
    around : Surroundings.
    forces : where they come from.
    Raises ValueError for arrays that kernels cannot write; TypeError, ValueError for substeps, see merged_row."""

    def __init__(
        self, method: Row, state: State, around: Surroundings, forces: ForceSource
    ) -> None:
        arrays = (state.positions, state.velocities, state.pushes)
        if not all(array.flags.carray for array in arrays):
            raise ValueError(
                "positions, velocities and forces of a State must be contiguous arrays that can be written"
            )
        self._method = method
        self._state = state
        self._around = around
        self._forces = forces
        self.counts = np.zeros(5, dtype=np.int64)
        self._calls = DirectCalls()
        self._counting = StepCounting(self.counts)
        self._row = merged_row(method)
        if forces.bonded is None and any(isinstance(part, BondedKick) for part in self._row):
            raise TypeError(f"{type(method).__name__} needs a Simulation, which knows bonds")
        self._first_unit = first_unit(method)
        self._head, self._rest = self._cut()
        moves = [event for event in self._rest if isinstance(event, Force | Drift)]
        self._last = moves[-1] if moves else None
        self._programs: dict[tuple[bool, bool], Program] = {}

    def advance(self, n_steps: int, with_energy: bool = False, first: int = 0) -> int:
        """Make n_steps steps, or fewer (at least one) if a stop is requested; return how many were made.
        with_energy : evaluate the energy with the last forces, if they are those of the last positions.
        first : number of the first of them."""
        if n_steps <= 0:
            return 0
        state = self._state
        last = self._last
        unit = self._first_unit
        # impulses over another time are none for these kicks
        if isinstance(state, GridState) and state.unit != unit:
            state.forces_are_current = False
            state.unit = unit
        self.counts[MADE] = 0
        self.counts[TO_MAKE] = 1 if self._around.stop_requested else n_steps
        self.counts[FIRST] = first
        has_kick = _first_place(Kick, self._head) < len(self._head)
        needs_forces = has_kick and not state.forces_are_current
        with_energy &= isinstance(last, Force)
        program = self._program(needs_forces, with_energy)
        state.forces_are_current = False
        with self._forces.running(program):
            program.run()
        if isinstance(last, Force):
            self._forces.taken(with_energy, last.unit * self._method.stride)
            state.forces_are_current = True
        return int(self.counts[MADE])

    def prepare(self) -> None:
        """Compile what steps need."""
        program = self._program(False, False)
        if program.is_outdated:
            with self._forces.running(program):
                pass

    @property
    def n_evaluations(self) -> int:
        """Of each step, in a run of them."""
        return sum(isinstance(event, Force) for event in self._rest)

    def _cut(self) -> tuple[Events, Events]:
        """The events of a step in a run of them: those before its first evaluation of forces, and all from there on."""
        row: list[Event] = list(self._method.substeps)
        if self._around.constraints is not None and not isinstance(row[-1], Thermalize):
            row.append(Projection())
        current: dict[type, float] = {}  # units of the forces that are those of the positions
        events = list[Event]()
        for _ in range(2):  # the second time the first kick may have the forces of the step before
            events.clear()
            current.pop(BondedKick, None)  # those of the step before are not stored in a restart
            for event in row:
                kind = type(event)
                if isinstance(event, Kick):
                    unit = unit_of(self._row, event)
                    is_other = current.get(kind) != unit and isinstance(self._state, GridState)
                    if kind not in current or is_other:
                        events.append(BondedForce(unit) if kind is BondedKick else Force(unit))
                    current[kind] = unit
                elif isinstance(event, Drift):
                    current.clear()
                events.append(event)
        n = _first_place(Force, tuple(events))
        return tuple(events[:n]), tuple(events[n:])

    def _program(self, needs_forces: bool, with_energy: bool) -> Program:
        """See _operations."""
        key = needs_forces, with_energy
        if key not in self._programs:
            forces = self._forces
            make = partial(self._operations, *key)
            self._programs[key] = Program(make, forces.version, forces.pool())
        return self._programs[key]

    def _operations(self, needs_forces: bool, with_energy: bool) -> Iterator[Operation]:
        """Head, loop, and the rest of the last step.
        needs_forces : whether the first kick needs new forces.
        with_energy : whether the last forces come with the energy."""
        start = Moment(self.counts)
        in_rest = Moment(self.counts, -1)
        rest = self._rest
        head = self._head
        for event in head:
            in_rest = in_rest.after(event)
        again = list(self._made_of((*rest, Beginning(), *head), in_rest))
        is_slow = any(
            each.code == 0 for each in again
        )  # there may be much time in a call of Python
        n_atoms = max(1, len(self._state.positions))
        self.counts[UNTIL_BREATH:] = 1 if is_slow else max(1, ATOM_STEPS // n_atoms)
        if needs_forces:
            k = _first_place(Kick, head)
            unit = unit_of(self._row, head[k])  # type: ignore[arg-type]
            head = (*head[:k], Force(unit), *head[k:])
        yield from self._made_of(head, start)
        yield operation(
            self._calls, count_step, self._counting, otherwise=1 + len(again), python=self._breathe
        )
        yield from again[:-1]
        yield again[-1]._replace(then=-len(again))
        if with_energy:
            k = len(rest) - 1 - _first_place(Force, rest[::-1])
            unit = rest[k].unit  # type: ignore[union-attr]
            rest = (*rest[:k], Force(unit, True), *rest[k + 1 :])
        yield from self._made_of(rest, in_rest)

    def _breathe(self, _answer: int) -> None:
        """Python looks whether to go on."""
        if self._around.stop_requested:
            self.counts[TO_MAKE] = self.counts[MADE] + 1

    def _made_of(self, events: Events, moment: Moment) -> Iterator[Operation]:
        """The operations of events, from a moment on; kicks and drifts in a row are one of them."""
        around = self._around
        forces = self._forces
        stride = self._method.stride
        flows: list[tuple[float, float, float]] = []
        pushes = self._state.pushes
        for event in events:
            if isinstance(event, Kick) or (isinstance(event, Drift) and around.constraints is None):
                kind = KICK if isinstance(event, Kick) else DRIFT
                wanted = pushes
                if isinstance(event, BondedKick):
                    wanted = forces.bonded.bonded_pushes
                elif isinstance(event, Kick):
                    wanted = self._state.pushes
                if flows and wanted is not pushes:
                    yield self._passed(flows, pushes)
                    flows = []
                pushes = wanted
                unit = unit_of(self._row, event) * stride
                flows.append((kind, event.coefficient * stride, unit))
            elif flows and not isinstance(event, Beginning):
                yield self._passed(flows, pushes)
                flows = []
            match event:
                case Force(unit, with_energy):
                    yield from forces.operations(with_energy, unit * stride, moment)
                    if forces.power is not None:
                        yield in_python(self._note_power)
                case BondedForce(unit):
                    yield from forces.bonded.bonded_operations(unit * stride)
                case BondedKick():
                    pass
                case Kick(coefficient) if forces.power is not None:
                    is_after = (moment.phase == 0.0) == (stride > 0.0)
                    yield in_python(partial(self._work, coefficient * stride, is_after))
                case Drift(coefficient) if around.constraints is not None:
                    n = self._method.drifts
                    for _ in range(n):
                        yield from self._constrained(coefficient * stride / n)
                case Projection():
                    yield from projected(self._state, around)
                case Thermalize(coefficient):
                    yield from self._contact(coefficient * stride, moment)
            moment = moment.after(event)
        if flows:
            yield self._passed(flows, pushes)

    def _constrained(self, duration: float) -> Iterable[Operation]:
        """A drift that keeps constrained lengths."""
        state = self._state
        around = self._around
        if isinstance(state, GridState):
            return [in_python(partial(around.drift, state, duration))]
        return around.constraints.drifts(state.positions, state.velocities, duration)  # type: ignore[union-attr]

    def _contact(self, duration: float, moment: Moment) -> list[Operation]:
        """A contact with the bath of the method."""
        method = self._method
        operations = list(method.contact(self._state, duration, self._around, moment) or ())
        if not operations:
            raise TypeError(
                f"{type(method).__name__}.contact must yield at least one operation, see Splitting.contact; it yields "
                "none, so that its bath would do nothing"
            )
        return operations

    def _passed(self, flows: list[tuple[float, float, float]], pushes: NDArray[Any]) -> Operation:
        """Kicks and drifts in one pass over memory."""
        state = self._state
        n_chunks = n_chunks_of(len(state.positions))
        moving = Moving(
            state.positions.reshape(-1),
            state.velocities.reshape(-1),
            pushes.reshape(-1),
            state.inverse_masses,
            np.array(flows),
            state.steps,
            n_chunks,
            int((state.inverse_masses == state.inverse_masses[0]).all()),
        )
        return operation(self._calls, move_atoms, moving, n_chunks, python=self._check_range)

    def _check_range(self, _answer: int) -> None:
        self._state.check_range()
        raise RangeError(TOO_LARGE)  # it has come back

    def _note_power(self) -> None:
        if self._forces.power is not None:
            self._around.powers = self._forces.power()

    def _work(self, duration: float, is_after: bool) -> None:
        self._around.work += duration * self._around.powers[is_after]


def projected(state: State, around: Surroundings) -> Iterator[Operation]:
    """Velocities projected, so that they change no constrained length."""
    if isinstance(state, GridState):
        yield in_python(partial(around.project, state))
    elif around.constraints is not None:
        yield from around.constraints.projections(state.positions, state.velocities)
