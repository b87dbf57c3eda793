"""The observers of a run: which of them look at a step, and how far it is to the next such step."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from minimd.engine.engine import Engine
from minimd.observers.accumulator import Accumulator
from minimd.structure.checks import shown
from minimd.structure.console import outside_minimd
from minimd.structure.errors import ConstraintError, NonFiniteError


class Attached:
    """Observers with steps of their own, at one engine; without any, nothing is done.

    observers : what a user has passed to a run.  functions : those that are plain functions.  accumulators : the others.

    Raises TypeError for what is no list of observers.  ValueError if two have the same name.
    """

    def __init__(self, observers: Any, engine: Engine) -> None:
        if not isinstance(observers, list | tuple) or not all(_is_observer(one) for one in observers):
            kinds = "a list of functions of a simulation, and of observers such as md.observers.RadialDistribution()"
            raise TypeError(f"observers must be {kinds}; observers = {shown(observers)}")
        self.accumulators: Sequence[Accumulator] = [one for one in observers if isinstance(one, Accumulator)]
        self.functions: Sequence[Callable] = [one for one in observers if not isinstance(one, Accumulator)]
        names = [one.name for one in self.accumulators]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"each observer needs a name of its own; {min(twice)!r} is that of several: pass name= to one of them")
        self._engine = engine
        if not engine.is_as_left:  # somebody has changed the state since the last run
            for one in self.accumulators:
                one.interrupt()

    def begin(self) -> None:
        """Look at the first state.  Raises ValueError if something cannot be observed."""
        for one in self.accumulators:
            one.prepare(self._engine)
        self.look()

    def steps_to_next(self) -> int | float:
        """From the present step to the next at which one of them looks."""
        return min((one.every - self._engine.step % one.every for one in self.accumulators), default=float("inf"))

    def need_energy(self, step: int) -> bool:
        """Whether one that looks at this step needs energy and virial."""
        return any(one.needs_energy and step % one.every == 0 for one in self.accumulators)

    def look(self) -> None:
        """Those that are due look at the present state."""
        for one in self.accumulators:
            if self._engine.step % one.every == 0:
                one.observe(self._engine)

    @contextmanager
    def broken_off(self) -> Iterator[None]:
        """Context of a run. If the run fails, a warning names those that have looked at steps after its last good one."""
        try:
            yield
        except (NonFiniteError, ConstraintError):
            step = self._engine.step
            for one in self.accumulators:
                if n_later := one.break_off(step):
                    what = f"{one!r} has looked {n_later} times after step {step}, the last good one of a run that failed"
                    warnings.warn(f"{what}; its answer includes these looks", stacklevel=outside_minimd())
            raise


def _is_observer(one: Any) -> bool:
    """Whether it can look at a run; a class of observers cannot, its objects can."""
    return isinstance(one, Accumulator) or (callable(one) and not (isinstance(one, type) and issubclass(one, Accumulator)))
