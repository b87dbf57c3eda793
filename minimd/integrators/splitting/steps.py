"""Steps as a program: the row of a method, with the forces, constraints and bath of a scene, as operations.

A row is cut where positions have moved and a kick needs new forces, F. Velocity Verlet, n steps:

    kick ½ · drift      F · kick ½ · kick ½ · drift   (n − 1 times)      F · kick ½
    head                the rest of a step, and the head of the next     the rest of the last step

Kicks and drifts that follow each other are one pass over memory, but not one kick: nothing of a step depends on
whether another one follows.
"""

from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import DirectCalls, called_kernel
from minimd.compiled.program import BREATHE, GO_ON, JUMP, Operation, Program, in_python, n_chunks_of, operation
from minimd.compiled.threads import ThreadPool, thread_pool
from minimd.integrators.splitting.flows import DRIFT, KICK, Moving, move_atoms
from minimd.integrators.splitting.state import GridState, State, Surroundings
from minimd.integrators.splitting.substeps import Drift, Kick, Substep, Substeps, Thermalize, merged

if TYPE_CHECKING:
    from minimd.integrators.splitting.splitting import Splitting

MADE, TO_MAKE, FIRST, UNTIL_BREATH, BREATH = range(5)  # places in a count
ATOM_STEPS = 8_000_000  # in a breath, about a second
DIGITS_OF_PHASE = 12  # so that coefficients that add up to one are one


class Moment(NamedTuple):
    """A moment of a program.

    count : see Counting.  begun : how many of its steps have begun before the present one: count[MADE] + begun.
    phase : time since the beginning of that step, in time steps; only drifts advance it.
    contact : number of contacts with a bath in that step before.  unit : of a kick that follows [time].
    """

    count: NDArray[np.int64]
    begun: int
    phase: float
    contact: int
    unit: float

    @property
    def step(self) -> int:
        """The number of the present step."""
        return int(self.count[FIRST] + self.count[MADE]) + self.begun

    @property
    def time(self) -> float:
        """The time since the step count[FIRST], in time steps."""
        return self.step + round(self.phase, DIGITS_OF_PHASE)


class Evaluation(NamedTuple):
    """Where forces come from.

    operations : those that evaluate the forces at a moment, with the energy or without.
    version : of the memory that they work on.  pool : the threads.
    running : context for the run of a program with such operations.  power : ∂U/∂t of the last evaluation [energy/time],
        if forces depend on time.
    taken : called after a run, with whether the last evaluation had the energy, and its unit [time].
    """

    operations: Callable[[bool, Moment], Iterable[Operation]]
    version: Callable[[], Any] = lambda: 0
    pool: Callable[[], ThreadPool] = lambda: thread_pool(1)
    running: Callable[[Program], AbstractContextManager] = lambda _program: nullcontext()
    power: Callable[[], float] | None = None
    taken: Callable[[bool, float], None] = lambda _with_energy, _unit: None


class Force(NamedTuple):
    """New forces, for kicks of one unit, a multiple of the time step."""

    unit: float


class Projection(NamedTuple):
    """Velocities projected onto the constraints."""


Event = Substep | Force | Projection


class Counting(ByAddress, namedtuple("Counting", "count")):
    """count : (5,) int, steps MADE and TO_MAKE, the number of the FIRST; how many more UNTIL_BREATH, each BREATH steps."""


@called_kernel
def count_step(counting, _chunk):
    """Another step is made but for what follows its last forces; JUMP if it is the last one.  BREATHE if it is time to,
    before it is counted."""
    count = counting.count
    if count[UNTIL_BREATH] == 0:
        count[UNTIL_BREATH] = count[BREATH]
        return BREATHE
    count[UNTIL_BREATH] -= 1
    count[MADE] += 1
    return JUMP if count[MADE] >= count[TO_MAKE] else GO_ON


def unit_of(row: Substeps, one: Kick | Drift) -> float:
    """The coefficient over which a kick or a drift is rounded on a grid: that of its kind at an end of the step, if it is
    a whole multiple of it; two half kicks then are one kick."""
    for end in (row[0], row[-1]):
        if type(end) is type(one) and one.coefficient % end.coefficient == 0.0:
            return end.coefficient
    return one.coefficient


def first_unit(method: "Splitting") -> float:
    """Of the first kick of a step [time]."""
    row = merged(method.substeps)
    return unit_of(row, next((one for one in row if isinstance(one, Kick)), Kick(1.0))) * method.timestep


class Steps:
    """The steps of a method on a state.

    around : Surroundings.  forces : Evaluation.
    """

    def __init__(self, method: "Splitting", state: State, around: Surroundings, forces: Evaluation) -> None:
        self._method, self._state, self._around, self._forces = method, state, around, forces
        self.count = np.zeros(5, dtype=np.int64)
        self._counting, self._calls = Counting(self.count), DirectCalls()
        self._head, self._rest = self._events()
        self._programs: dict[tuple[bool, bool], Program] = {}

    def advance(self, n_steps: int, with_energy: bool = False, first: int | None = None) -> int:
        """Make n_steps steps, or fewer (at least one) if a stop is requested; return how many were made.

        with_energy : evaluate the energy with the last forces, if they are those of the last positions.
        first : number of the first of them; if not given, that of the bath.
        """
        state, around, count = self._state, self._around, self.count
        if n_steps <= 0:
            return 0
        bath = around.bath
        count[:FIRST] = 0, n_steps
        count[FIRST] = (bath.step if bath else 0) if first is None else first
        needs_forces = not state.forces_are_current and any(isinstance(one, Kick) for one in self._head)
        with_energy &= self._ends_with_forces
        program = self._program(needs_forces, with_energy)
        state.forces_are_current = False
        if around.stop_requested:
            count[TO_MAKE] = 1
        with self._forces.running(program):
            program.run()
        last = [one for one in self._rest if isinstance(one, Force)][-1:]
        for one in last:
            self._forces.taken(with_energy, one.unit * self._method.timestep)
        state.forces_are_current = self._ends_with_forces
        return int(count[MADE])

    def prepare(self) -> None:
        """Compile what steps need."""
        with self._forces.running(self._program(False, False)):
            pass

    def _program(self, *key: bool) -> Program:
        """key : arguments of _operations."""
        if key not in self._programs:
            make = lambda: self._operations(*key)  # noqa: E731
            self._programs[key] = Program(make, self._forces.version, self._forces.pool())
        return self._programs[key]

    @property
    def _ends_with_forces(self) -> bool:
        """Whether the last forces of a step are those of its last positions."""
        decisive = [one for one in self._rest if isinstance(one, Force | Drift)]
        return bool(decisive) and isinstance(decisive[-1], Force)

    @property
    def n_evaluations(self) -> int:
        """Of each step, in a run of them."""
        return sum(isinstance(one, Force) for one in (*self._head, *self._rest))

    def _events(self) -> tuple[Sequence[Event], Sequence[Event]]:
        """The substeps of a step before its first evaluation of forces, and all from there on, as they are in a run."""
        substeps: list[Event] = list(merged(self._method.substeps))
        if self._around.constraints is not None and not isinstance(substeps[-1], Thermalize):
            substeps.append(Projection())
        unit, is_current, events = 0.0, False, list[Event]()
        for turn in range(2):  # the second time forces may be those of the step before
            events = []
            for one in substeps:
                if isinstance(one, Kick):
                    own = self._unit_of(one)
                    if not is_current or (own != unit and isinstance(self._state, GridState)):
                        events.append(Force(own))
                    unit, is_current = own, True
                is_current &= not isinstance(one, Drift)
                events.append(one)
        first = next((k for k, one in enumerate(events) if isinstance(one, Force)), len(events))
        return tuple(events[:first]), tuple(events[first:])

    def _unit_of(self, one: Kick | Drift) -> float:
        return unit_of(merged(self._method.substeps), one)

    def _operations(self, needs_forces: bool, with_energy: bool) -> Iterator[Operation]:
        """All operations of a block: head, loop, rest of the last step."""
        head = list(self._made_of(self._head, (), needs_forces, False))
        again = list(self._made_of(self._rest, self._head, False, False))
        last = list(self._made_of(self._rest, (), False, with_energy))
        is_slow = any(one.code == 0 for one in again)  # there may be much time in a call of Python
        self.count[[UNTIL_BREATH, BREATH]] = 1 if is_slow else max(1, ATOM_STEPS // max(1, len(self._state.positions)))
        yield from head
        yield operation(self._calls, count_step, self._counting, otherwise=1 + len(again), python=self._breathe)
        for k, one in enumerate(again):
            yield one._replace(then=one.then - len(again) - 1) if k == len(again) - 1 and one.then == 1 else one
        yield from last

    def _breathe(self, _answer: int) -> None:
        """Python looks whether to go on."""
        if self._around.stop_requested:
            self.count[TO_MAKE] = self.count[MADE] + 1

    def _made_of(
        self, rest: Sequence[Event], head: Sequence[Event], needs_forces: bool, with_energy: bool
    ) -> Iterator[Operation]:
        """The operations of the rest of a step, or the head of a first one, and of the head of the next."""
        is_first = rest is self._head
        moment = Moment(self.count, 0 if is_first else -1, *self._after(() if is_first else self._head), 1.0)
        flows: list[tuple[float, float, float]] = []
        last_force = max((k for k, one in enumerate(rest) if isinstance(one, Force)), default=-1)
        for k, one in enumerate((*rest, *head)):
            if k == len(rest):
                moment = moment._replace(begun=0, phase=0.0, contact=0)
            if isinstance(one, Kick) and needs_forces:
                unit, needs_forces = self._unit_of(one) * self._method.timestep, False
                yield from self._passed(flows)
                yield from self._forces.operations(False, moment._replace(unit=unit))
                yield from self._noting_power()
            if isinstance(one, Force):
                yield from self._passed(flows)
                moment = moment._replace(unit=one.unit * self._method.timestep)
                yield from self._forces.operations(with_energy and k == last_force, moment)
                yield from self._noting_power()
            elif isinstance(one, Kick):
                duration = one.coefficient * self._method.timestep
                flows.append((KICK, duration, self._unit_of(one) * self._method.timestep))
                if self._forces.power is not None:
                    yield from self._passed(flows)
                    yield in_python(lambda duration=duration: self._work(duration))
            elif isinstance(one, Drift):
                duration = one.coefficient * self._method.timestep
                if self._around.constraints is None:
                    flows.append((DRIFT, duration, self._unit_of(one) * self._method.timestep))
                else:
                    yield from self._passed(flows)
                    yield from self._constrained(duration)
                moment = moment._replace(phase=moment.phase + one.coefficient)
            elif isinstance(one, Projection):
                yield from self._passed(flows)
                yield from projected(self._state, self._around)
            else:
                yield from self._passed(flows)
                duration = one.coefficient * self._method.timestep
                yield from self._method.contact(self._state, duration, self._around, moment)
                moment = moment._replace(contact=moment.contact + 1)
        yield from self._passed(flows)

    @staticmethod
    def _after(events: Sequence[Event]) -> tuple[float, int]:
        """The phase and the number of contacts after some events of a step."""
        return (
            sum((one.coefficient for one in events if isinstance(one, Drift)), 0.0),
            sum(isinstance(one, Thermalize) for one in events),
        )

    def _passed(self, flows: list[tuple[float, float, float]]) -> Iterator[Operation]:
        """Kicks and drifts in one pass over memory; flows is empty afterwards."""
        if flows:
            state, n_chunks = self._state, n_chunks_of(len(self._state.positions))
            parts = state.positions, state.velocities, state.pushes, state.inverse_masses
            moving = Moving(*parts, np.array(flows), state.steps, n_chunks)
            flows.clear()
            yield operation(self._calls, move_atoms, moving, n_chunks, python=lambda _answer: state.check_range())

    def _constrained(self, duration: float) -> Iterator[Operation]:
        """A drift that keeps constrained lengths."""
        state, around = self._state, self._around
        if isinstance(state, GridState) or around.constraints is None:
            yield in_python(lambda: around.drift(state, duration))
        else:
            yield from around.constraints.drifts(state.positions, state.velocities, duration)

    def _noting_power(self) -> Iterator[Operation]:
        if self._forces.power is not None:
            yield in_python(lambda: setattr(self._around, "power", self._forces.power()))

    def _work(self, duration: float) -> None:
        self._around.work += duration * self._around.power


def projected(state: State, around: Surroundings) -> Iterator[Operation]:
    """Velocities projected, so that they change no constrained length."""
    if isinstance(state, GridState):
        yield in_python(lambda: around.project(state))
    elif around.constraints is not None:
        yield from around.constraints.projections(state.positions, state.velocities)
