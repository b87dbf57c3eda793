"""Steps whose forces or contacts with a bath are functions in Python, as operations of a program."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar, Protocol

from minimd.core.compiled.program import Operation, in_python
from minimd.core.integrators.state import Bath, State, Surroundings
from minimd.core.integrators.steps import ForceSource, Moment, Row, Steps
from minimd.core.structure.observables import kinetic_energy


class RowInPython(Row, Protocol):
    """A method whose bath is a function in Python; see Splitting."""

    is_thermostat: ClassVar[bool]

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """A contact with the bath."""


def advance(
    method: Row,
    state: State,
    compute_forces: Callable[[State, bool], None],
    n_steps: int,
    with_energy: bool,
    surroundings: Surroundings | None,
) -> int:
    """See Splitting.advance."""

    def evaluation(with_energy: bool, _unit: float, _moment: Moment) -> Iterable[Operation]:
        yield in_python(lambda: compute_forces(state, with_energy))

    around = Surroundings() if surroundings is None else surroundings
    first = 0 if around.bath is None else around.bath.step
    steps = Steps(method, state, around, ForceSource(evaluation))
    n_made = steps.advance(n_steps, with_energy, first)
    if around.bath is not None:
        around.bath.step += n_made
    return n_made


def contact(
    method: RowInPython, state: State, duration: float, around: Surroundings, moment: Moment
) -> Iterable[Operation]:
    """A contact made once, by the method's thermalize.  See Splitting.contact."""

    def thermalize() -> None:
        bath = Bath() if around.bath is None else around.bath
        bath.step = moment.step
        bath.contact = moment.contact
        heat = bath.energy
        around.project(state)
        before = kinetic_energy(state.velocities, state.masses)
        method.thermalize(state, duration, around)
        around.project(state)
        if method.is_thermostat:
            bath.energy = heat + kinetic_energy(state.velocities, state.masses) - before
        state.settle()

    yield in_python(thermalize)
