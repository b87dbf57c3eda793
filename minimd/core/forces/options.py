"""Options of the computation of forces: threads, precision, skin."""

from dataclasses import dataclass
from typing import Literal, get_args

from minimd.core.compiled.machine import default_threads
from minimd.core.compiled.threads import ThreadPool, thread_pool
from minimd.core.neighbors import domains
from minimd.core.structure.checks import checked_choice, checked_count, checked_kind, checked_number
from minimd.core.structure.grid import Grid

Precision = Literal["double", "fixed-point"]
FIXED_POINT: Precision = "fixed-point"


@dataclass(frozen=True)
class Options:
    """Options of the computation of forces.

    threads : maximum number; all cores of the process if not given. The result has the same bits for any number.
    precision : "double": all arithmetic in float64. "fixed-point": positions, momenta and the impulse of each pair are
        whole multiples of the steps of a grid, so that all sums are exact.
    skin : of the lists of neighbors [length]; chosen by neighbors.verlet_list.best_skin if not given.
    grid : of fixed-point arithmetic; chosen by Grid.of_scene if not given.

    Raises ValueError for a number of threads below one, an unknown precision, a skin that is negative or not finite,
    a grid without fixed-point.
    """

    threads: int | None = None
    precision: Precision = "double"
    skin: float | None = None
    grid: Grid | None = None

    def __post_init__(self) -> None:
        checked_choice("precision", self.precision, get_args(Precision))
        checked_kind("grid", self.grid, Grid | None, "a minimd.Grid")
        if self.grid is not None and self.precision != FIXED_POINT:
            raise ValueError(
                f"a grid is for precision='fixed-point'; precision = {self.precision!r}"
            )

        if self.threads is not None:
            object.__setattr__(self, "threads", checked_count("threads", self.threads))
        if self.skin is not None:
            skin = checked_number("skin", self.skin, "finite and not negative")
            object.__setattr__(self, "skin", skin)

    @property
    def most_threads(self) -> int:
        """The number of threads given, or default_threads()."""
        return self.threads or default_threads()


def pool_for(options: Options, n_atoms: int) -> ThreadPool:
    """The threads for a scene of so many atoms: with few for each of them, they would cost more than they gain."""
    return thread_pool(max(1, min(options.most_threads, n_atoms // domains.ATOMS_PER_DOMAIN)))


def described(precision: Precision) -> str:
    """A precision as text."""
    return "fixed-point arithmetic" if precision == FIXED_POINT else f"{precision} precision"
