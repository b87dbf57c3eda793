"""The observers of a run: those that look at a given step, and the number of steps to the next look."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from minimd.console.quiet import outside_minimd
from minimd.console.words import shown
from minimd.engine.engine import Engine
from minimd.observers.accumulator import Accumulator
from minimd.structure.errors import ConstraintError, NonFiniteError


class Attached:
    """The observers of a run on one engine, each with its own steps.

    observers : as passed to a run.  functions : the plain functions among them.  accumulators : the others.

    Raises TypeError for anything but a list of observers.  ValueError if two have the same name.
    """

    def __init__(self, observers: Any, engine: Engine) -> None:
        if not isinstance(observers, list | tuple) or not all(_is_observer(one) for one in observers):
            kinds = "a list of functions of a simulation, and of observers such as md.observers.RadialDistribution()"
            raise TypeError(f"observers must be {kinds}; observers = {shown(observers)}")
        self.accumulators: Sequence[Accumulator] = [one for one in observers if isinstance(one, Accumulator)]
        self.functions: Sequence[Callable] = [one for one in observers if not isinstance(one, Accumulator)]
        names = [one.name for one in self.accumulators]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(
                f"observers must have different names; {min(twice)!r} is the name of several: pass another name= to "
                "one of them"
            )
        self._engine = engine
        if not engine.is_as_left:  # the state was changed since the last run
            for one in self.accumulators:
                one.interrupt()

    def begin(self) -> None:
        """Look at the first state.  Raises ValueError if something cannot be observed."""
        for one in self.accumulators:
            one.prepare(self._engine)
        self.look()

    def steps_to_next(self) -> int | float:
        """The number of steps to the next look of any of them; infinite without observers."""
        return min((one.every - self._engine.step % one.every for one in self.accumulators), default=float("inf"))

    def need_energy(self, step: int) -> bool:
        """Whether an observer that looks at this step needs energy and virial."""
        return any(one.needs_energy and step % one.every == 0 for one in self.accumulators)

    def look(self) -> None:
        """Let the observers that are due look at the present state."""
        for one in self.accumulators:
            if self._engine.step % one.every == 0:
                one.observe(self._engine)

    @contextmanager
    def broken_off(self) -> Iterator[None]:
        """Context of a run.

        If the run fails, a warning names the observers that have looked at steps after its last good one.
        """
        try:
            yield
        except (NonFiniteError, ConstraintError):
            step = self._engine.step
            for one in self.accumulators:
                if n_later := one.break_off(step):
                    what = (
                        f"{one!r} has looked {n_later} times after step {step}, the last good one of a run that failed"
                    )
                    warnings.warn(f"{what}; its result includes these looks", stacklevel=outside_minimd())
            raise


def _is_observer(one: Any) -> bool:
    """Whether an object can observe a run; a class of observers cannot, but its objects can."""
    return isinstance(one, Accumulator) or (
        callable(one) and not (isinstance(one, type) and issubclass(one, Accumulator))
    )
