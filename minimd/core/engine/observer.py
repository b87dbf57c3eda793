"""What a run asks of an observer, and a file of one that keeps a state."""

from typing import Any, Protocol, runtime_checkable

from minimd.core.engine.engine import Engine


@runtime_checkable
class PeriodicObserver(Protocol):
    """An observer with steps of its own: those of minimd.observers, or any object with these."""

    @property
    def every(self) -> int:
        """Steps between two looks."""

    @property
    def needs_energy(self) -> bool:
        """Whether it needs energies or the virial."""

    def prepare(self, engine: Engine) -> None:
        """The run begins."""

    def observe(self, engine: Engine) -> None:
        """Look at the present state."""

    def end(self, engine: Engine) -> None:
        """The run has ended."""


@runtime_checkable
class StoredObserver(PeriodicObserver, Protocol):
    """One whose state and results are kept in files."""

    name: str
    n_looks: int
    last_step: int

    @property
    def kind(self) -> str:
        """Its name among kinds of observers."""

    def made_with(self) -> dict[str, Any]:
        """The arguments with which it was made."""

    def state(self) -> dict[str, Any]:
        """For restore."""

    def can_restore(self, state: dict[str, Any]) -> bool:
        """Whether restore takes it."""

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""

    def interrupt(self) -> None:
        """Steps are missing."""

    def break_off(self, step: int) -> int:
        """The run has failed at a step; the number of later states that were seen."""

    def result(self) -> Any:
        """Its answer."""
