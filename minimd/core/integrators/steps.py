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
from minimd.core.integrators.flows import DRIFT, KICK, Moving, move_atoms
from minimd.core.integrators.state import GridState, State, Surroundings
from minimd.core.integrators.substeps import Drift, Kick, Substep, Substeps, Thermalize, merged
from minimd.core.structure.errors import RangeError
from minimd.core.structure.grid import TOO_LARGE

MADE, TO_MAKE, FIRST, UNTIL_BREATH, BREATH = range(5)  # places in a count
ATOM_STEPS = 8_000_000  # in a breath, about a second
DIGITS_OF_PHASE = 12  # so that coefficients that add up to one are one


class Moment(NamedTuple):
    """A moment of a program.
    counts : see Counting.  begun : how many steps have begun before the present one: counts[MADE] + begun.
    phase : time since the beginning of that step, in time steps; only drifts advance it.
    contact : number of contacts with a bath in that step before."""

    counts: NDArray[np.int64]
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
    """A method: its time step and its substeps; see Splitting."""

    timestep: float
    substeps: ClassVar[Any]

    def contact(
        self, state: State, duration: float, around: Surroundings, moment: Moment
    ) -> Iterable[Operation]:
        """The operations of a contact with a bath."""


class ForceSource(NamedTuple):
    """Where forces come from.

    operations : those that evaluate them, with the energy or without, over a unit of time [time], at a moment.
    version : of the memory that they work on.  pool : the threads.
    running : context for the run of a program with such operations.
    power : ∂U/∂t of the last evaluation [energy/time], if forces depend on time.
    taken : called after a run, with whether the last evaluation had the energy, and its unit [time]."""

    operations: Callable[[bool, float, Moment], Iterable[Operation]]
    version: Callable[[], Any] = lambda: 0
    pool: Callable[[], ThreadPool] = lambda: thread_pool(1)
    running: Callable[[Program], AbstractContextManager] = lambda _program: nullcontext()
    power: Callable[[], float] | None = None
    taken: Callable[[bool, float], None] = lambda _with_energy, _unit: None


class Force(NamedTuple):
    """New forces.  unit : of the kicks that follow, see unit_of.  with_energy : and the energy."""

    unit: float
    with_energy: bool = False


class Projection(NamedTuple):
    """Velocities projected onto the constraints."""


class Beginning(NamedTuple):
    """The beginning of the next step."""


Event = Substep | Force | Projection | Beginning
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


def unit_of(row: Substeps, one: Kick | Drift) -> float:
    """The coefficient over which a kick or a drift is rounded on a grid: that of its kind at an end of the step,
    if it is a whole multiple of it; two half kicks then are one kick."""
    for end in (row[0], row[-1]):
        if type(end) is type(one) and one.coefficient % end.coefficient == 0.0:
            return end.coefficient
    return one.coefficient


def first_unit(method: Row) -> float:
    """Of the first kick of a step [time]."""
    row = merged(method.substeps)
    return (
        unit_of(row, next((one for one in row if isinstance(one, Kick)), Kick(1.0)))
        * method.timestep
    )


class Steps:
    """The steps of a method on a state.  around : Surroundings.  forces : Evaluation."""

    def __init__(
        self, method: Row, state: State, around: Surroundings, forces: ForceSource
    ) -> None:
        if not all(part.flags.carray for part in (state.positions, state.velocities, state.pushes)):
            raise ValueError(
                "positions, velocities and forces of a State must be contiguous arrays that can be "
                "written"
            )
        self._method = method
        self._state = state
        self._around = around
        self._forces = forces
        self.counts, self._calls = np.zeros(5, dtype=np.int64), DirectCalls()
        self._counting, self._row = StepCounting(self.counts), merged(method.substeps)
        self._first_unit = first_unit(method)
        self._head, self._rest = self._cut()
        self._last = next((one for one in self._rest[::-1] if isinstance(one, Force | Drift)), None)
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
        self.counts[:UNTIL_BREATH] = 0, 1 if self._around.stop_requested else n_steps, first
        needs_forces = not state.forces_are_current and any(
            isinstance(one, Kick) for one in self._head
        )
        with_energy &= isinstance(last, Force)
        program = self._program(needs_forces, with_energy)
        state.forces_are_current = False
        with self._forces.running(program):
            program.run()
        if isinstance(last, Force):
            self._forces.taken(with_energy, last.unit * self._method.timestep)
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
        return sum(isinstance(one, Force) for one in self._rest)

    def _cut(self) -> tuple[Events, Events]:
        """The events of a step in a run of them: those before its first evaluation of forces, and all from there on."""
        row: list[Event] = list(self._method.substeps)
        if self._around.constraints is not None and not isinstance(row[-1], Thermalize):
            row.append(Projection())
        unit = 0.0
        is_current = False
        events = list[Event]()
        for _ in range(2):  # the second time the first kick may have the forces of the step before
            events.clear()
            for one in row:
                if isinstance(one, Kick):
                    own = unit_of(self._row, one)
                    if not is_current or (own != unit and isinstance(self._state, GridState)):
                        events.append(Force(own))
                    unit = own
                    is_current = True
                is_current &= not isinstance(one, Drift)
                events.append(one)
        n = next((k for k, one in enumerate(events) if isinstance(one, Force)), len(events))
        return tuple(events[:n]), tuple(events[n:])

    def _program(self, needs_forces: bool, with_energy: bool) -> Program:
        """See _operations."""
        key = needs_forces, with_energy
        if key not in self._programs:
            self._programs[key] = Program(
                partial(self._operations, *key), self._forces.version, self._forces.pool()
            )
        return self._programs[key]

    def _operations(self, needs_forces: bool, with_energy: bool) -> Iterator[Operation]:
        """Head, loop, and the rest of the last step.  needs_forces : whether the first kick needs new forces.
        with_energy : whether the last forces come with the energy."""
        start = Moment(self.counts)
        in_rest = Moment(self.counts, -1)
        rest = self._rest
        head = self._head
        for one in head:
            in_rest = in_rest.after(one)
        first = next((k for k, one in enumerate(head) if isinstance(one, Kick)), 0)
        new = (Force(unit_of(self._row, head[first])),) if needs_forces else ()  # type: ignore[arg-type]
        again = list(self._made_of((*rest, Beginning(), *head), in_rest))
        is_slow = any(one.code == 0 for one in again)  # there may be much time in a call of Python
        self.counts[UNTIL_BREATH:] = (
            1 if is_slow else max(1, ATOM_STEPS // max(1, len(self._state.positions)))
        )
        yield from self._made_of((*head[:first], *new, *head[first:]), start)
        yield operation(
            self._calls, count_step, self._counting, otherwise=1 + len(again), python=self._breathe
        )
        yield from again[:-1]
        yield again[-1]._replace(then=-len(again))
        if with_energy:
            k = max(k for k, one in enumerate(rest) if one is self._last)
            rest = *rest[:k], self._last._replace(with_energy=True), *rest[k + 1 :]  # type: ignore[union-attr]
        yield from self._made_of(rest, in_rest)

    def _breathe(self, _answer: int) -> None:
        """Python looks whether to go on."""
        if self._around.stop_requested:
            self.counts[TO_MAKE] = self.counts[MADE] + 1

    def _made_of(self, events: Events, moment: Moment) -> Iterator[Operation]:
        """The operations of events, from a moment on; kicks and drifts in a row are one of them."""
        state = self._state
        around = self._around
        forces = self._forces
        timestep = self._method.timestep
        flows: list[tuple[float, float, float]] = []
        for one in events:
            if isinstance(one, Kick) or (isinstance(one, Drift) and around.constraints is None):
                unit = unit_of(self._row, one) * timestep
                flows.append(
                    (KICK if isinstance(one, Kick) else DRIFT, one.coefficient * timestep, unit)
                )
            elif flows and not isinstance(one, Beginning):
                yield self._passed(flows)
                flows = []
            if isinstance(one, Force):
                yield from forces.operations(one.with_energy, one.unit * timestep, moment)
                if forces.power is not None:
                    yield in_python(self._note_power)
            elif isinstance(one, Kick) and forces.power is not None:
                yield in_python(partial(self._work, one.coefficient * timestep))
            elif isinstance(one, Drift) and around.constraints is not None:
                if isinstance(state, GridState):
                    yield in_python(partial(around.drift, state, one.coefficient * timestep))
                else:
                    yield from around.constraints.drifts(
                        state.positions, state.velocities, one.coefficient * timestep
                    )
            elif isinstance(one, Projection):
                yield from projected(state, around)
            elif isinstance(one, Thermalize):
                yield from self._method.contact(state, one.coefficient * timestep, around, moment)
            moment = moment.after(one)
        if flows:
            yield self._passed(flows)

    def _passed(self, flows: list[tuple[float, float, float]]) -> Operation:
        """Kicks and drifts in one pass over memory."""
        state = self._state
        n_chunks = n_chunks_of(len(self._state.positions))
        r, v, f = (part.reshape(-1) for part in (state.positions, state.velocities, state.pushes))
        are_alike = int((state.inverse_masses == state.inverse_masses[0]).all())
        moving = Moving(
            r, v, f, state.inverse_masses, np.array(flows), state.steps, n_chunks, are_alike
        )
        return operation(self._calls, move_atoms, moving, n_chunks, python=self._check_range)

    def _check_range(self, _answer: int) -> None:
        self._state.check_range()
        raise RangeError(TOO_LARGE)  # it has come back

    def _note_power(self) -> None:
        if self._forces.power is not None:
            self._around.power = self._forces.power()

    def _work(self, duration: float) -> None:
        self._around.work += duration * self._around.power


def projected(state: State, around: Surroundings) -> Iterator[Operation]:
    """Velocities projected, so that they change no constrained length."""
    if isinstance(state, GridState):
        yield in_python(partial(around.project, state))
    elif around.constraints is not None:
        yield from around.constraints.projections(state.positions, state.velocities)
