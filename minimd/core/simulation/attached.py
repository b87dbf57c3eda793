"""The observers of a run, and when each looks."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
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

    observers : as passed to a run.
    functions : the plain functions among them.
    accumulators : those with results.

    Raises TypeError for anything but a list of observers, ValueError if two have the same name.
    """

    def __init__(self, observers: Any, engine: Engine) -> None:
        self.accumulators: list[StoredObserver] = []
        self.functions: list[Callable] = []
        self._with_steps: list[PeriodicObserver] = []
        self._engine = engine
        if not isinstance(observers, list | tuple):
            raise _not_observers(observers)
        for observer in observers:
            if isinstance(observer, PeriodicObserver):
                self._with_steps.append(observer)
            elif _is_function(observer):
                self.functions.append(observer)
            else:
                raise _not_observers(observers)
            if isinstance(observer, StoredObserver):
                self._add_accumulator(observer)
        if not engine.enter():  # the state was changed since the last run
            self.interrupt()

    def _add_accumulator(self, observer: StoredObserver) -> None:
        if any(observer.name == other.name for other in self.accumulators):
            raise ValueError(
                f"observers must have different names; {observer.name!r} is the name of several: "
                "pass another name= to one of them"
            )
        self.accumulators.append(observer)

    def interrupt(self) -> None:
        """Atoms were moved: later looks are not correlated with earlier ones."""
        for accumulator in self.accumulators:
            accumulator.interrupt()

    def begin(self) -> None:
        """Look at the first state.
        Raises ValueError if something cannot be observed."""
        for observer in self._with_steps:
            observer.prepare(self._engine)
        self.look()

    def steps_to_next(self) -> float:
        """The number of steps to the next look of any of them; infinite without observers."""
        steps = inf
        for observer in self._with_steps:
            steps = min(steps, observer.every - self._engine.step % observer.every)
        return steps

    def need_energy(self, step: int) -> bool:
        """Whether an observer that looks at this step needs energy and virial."""
        return any(
            observer.needs_energy and step % observer.every == 0 for observer in self._with_steps
        )

    def look(self) -> float:
        """Let the observers that are due look at the present state; return the seconds that this took, without
        compilation."""
        if not self._with_steps:
            return 0.0
        began = perf_counter() - compile_clock.seconds
        for observer in self._with_steps:
            if self._engine.step % observer.every == 0:
                observer.observe(self._engine)
        return perf_counter() - compile_clock.seconds - began

    @contextmanager
    def broken_off(self) -> Iterator[None]:
        """Context of a run: if it fails, a warning names the observers that have looked after its last good step.
        At the end streams are closed."""
        try:
            yield
        except (NonFiniteError, ConstraintError):
            step = self._engine.step
            for accumulator in self.accumulators:
                n_later = accumulator.break_off(step)
                if n_later:
                    warn(
                        f"the run has failed after step {step}, and the result of {accumulator!r} includes "
                        f"{n_later} later states; use another observer to run again"
                    )
            raise
        finally:
            for observer in self._with_steps:
                observer.end(self._engine)


def _is_function(candidate: Any) -> bool:
    """Whether an object can be called with a simulation; a class of observers cannot, but its objects can observe."""
    is_class = isinstance(candidate, type) and issubclass(candidate, PeriodicObserver)
    return callable(candidate) and not is_class


def _not_observers(observers: Any) -> TypeError:
    return TypeError(
        "observers must be a list of functions of a simulation, and of observers such as "
        f"md.observers.RadialDistribution(); observers = {shown(observers)}"
    )
