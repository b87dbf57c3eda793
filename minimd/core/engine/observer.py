"""What a run asks of an observer, and a file of one that keeps a state."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from minimd.core.engine.engine import Engine


class PeriodicObserver(ABC):
    """Base class of observers with steps of their own, which look at an engine rather than at a simulation.

    Attributes
    ----------
    every : steps between two looks.
    needs_energy : whether the next looks need energies or the virial.
    """

    every: int
    needs_energy: Any = False

    @abstractmethod
    def prepare(self, engine: Engine) -> None:
        """A run begins.
        Raises ValueError if it cannot be observed."""

    @abstractmethod
    def observe(self, engine: Engine) -> None:
        """Look at the present state, of a step that is a multiple of every."""

    @abstractmethod
    def end(self, engine: Engine) -> None:
        """The run has ended."""


class StoredObserver(PeriodicObserver):
    """Base class of those whose sums and results are kept in files; see minimd.observers.accumulator.Accumulator.

    Attributes
    ----------
    kind : its name in scene files and H5MD files.
    name : of this one among the observers of a run.
    last_step : the step of the last look, −1 if there is none.
    """

    kind: ClassVar[str]
    name: str
    last_step: int

    @property
    @abstractmethod
    def n_looks(self) -> int:
        """The number of looks."""

    @abstractmethod
    def made_with(self) -> dict[str, Any]:
        """The arguments with which it was made, for JSON."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """What restore needs: arrays, and numbers and texts for JSON."""

    @abstractmethod
    def can_restore(self, state: dict[str, Any]) -> bool:
        """Whether a state is one of such an observer."""

    @abstractmethod
    def restore(self, state: dict[str, Any]) -> None:
        """Take the sums of a state, and go on from there."""

    @abstractmethod
    def interrupt(self) -> None:
        """Steps are missing: do not correlate later looks with earlier ones."""

    @abstractmethod
    def break_off(self, step: int) -> int:
        """A run has failed; step is its last good one. Returns the number of later looks, which remain in the sums."""

    @abstractmethod
    def result(self) -> Any:
        """The result of all looks.
        Raises ValueError before the first."""
