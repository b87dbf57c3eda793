"""The observers of a run, and when each looks."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import Any

from minimd.core.compiled.kernels import compile_clock
from minimd.core.console.quiet import warn
from minimd.core.console.words import shown
from minimd.core.engine.engine import Engine
from minimd.core.engine.observer import PeriodicObserver, StoredObserver
from minimd.core.structure.errors import ConstraintError, NonFiniteError


class Attached:
    """The observers of a run on one engine, each with its own steps.

    observers : as passed to a run.  functions : the plain functions among them.  accumulators : those with results.

    Raises TypeError for anything but a list of observers, ValueError if two have the same name.
    """

    def __init__(self, observers: Any, engine: Engine) -> None:
        if not isinstance(observers, list | tuple) or not all(
            _is_observer(one) for one in observers
        ):
            kinds = "a list of functions of a simulation, and of observers such as md.observers.RadialDistribution()"
            raise TypeError(f"observers must be {kinds}; observers = {shown(observers)}")
        self.accumulators: Sequence[StoredObserver] = [
            one for one in observers if isinstance(one, StoredObserver)
        ]
        self.functions: Sequence[Callable] = [
            one for one in observers if not isinstance(one, PeriodicObserver)
        ]
        self._with_steps: Sequence[PeriodicObserver] = [
            one for one in observers if isinstance(one, PeriodicObserver)
        ]
        names = [one.name for one in self.accumulators]
        if twice := {name for name in names if names.count(name) > 1}:
            several = f"{min(twice)!r} is the name of several: pass another name= to one of them"
            raise ValueError(f"observers must have different names; {several}")
        self._engine = engine
        if not engine.enter():  # the state was changed since the last run
            self.interrupt()

    def interrupt(self) -> None:
        """Atoms were moved: later looks are not correlated with earlier ones."""
        for one in self.accumulators:
            one.interrupt()

    def begin(self) -> None:
        """Look at the first state.  Raises ValueError if something cannot be observed."""
        for one in self._with_steps:
            one.prepare(self._engine)
        self.look()

    def steps_to_next(self) -> int | float:
        """The number of steps to the next look of any of them; infinite without observers."""
        return min(
            (one.every - self._engine.step % one.every for one in self._with_steps),
            default=float("inf"),
        )

    def need_energy(self, step: int) -> bool:
        """Whether an observer that looks at this step needs energy and virial."""
        return any(one.needs_energy and step % one.every == 0 for one in self._with_steps)

    def look(self) -> float:
        """Let the observers that are due look at the present state; return the seconds that this took, without
        compilation."""
        began = perf_counter() - compile_clock.seconds
        for one in self._with_steps:
            if self._engine.step % one.every == 0:
                one.observe(self._engine)
        return perf_counter() - compile_clock.seconds - began if self._with_steps else 0.0

    @contextmanager
    def broken_off(self) -> Iterator[None]:
        """Context of a run: if it fails, a warning names the observers that have looked after its last good step.
        At the end streams are closed."""
        try:
            yield
        except (NonFiniteError, ConstraintError):
            step = self._engine.step
            for one in self.accumulators:
                if n_later := one.break_off(step):
                    seen = f"the result of {one!r} includes {n_later} later states"
                    failed = f"the run has failed after step {step}, and {seen}; use another observer to run again"
                    warn(failed)
            raise
        finally:
            for looking in self._with_steps:
                looking.end(self._engine)


def _is_observer(one: Any) -> bool:
    """Whether an object can observe a run; a class of observers cannot, but its objects can."""
    is_class = isinstance(one, type) and issubclass(one, PeriodicObserver)
    return not is_class and (isinstance(one, PeriodicObserver) or callable(one))
