"""Options of the computation of forces: threads, precision, skin."""

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Literal, get_args

from minimd.compiled.machine import available_cores
from minimd.structure.system import LARGEST

Precision = Literal["double", "mixed"]


@dataclass(frozen=True)
class Options:
    """Options of the computation of forces.

    threads : maximum number; all cores of the process if not given. The result has the same bits for any number.
    precision : "double": all arithmetic in float64. "mixed": pairs of cluster lists, and the sums of their forces
        within a domain, in float32; positions, velocities, energies, virials and the sums over ghosts in float64.
    skin : of the lists of neighbors [length]; chosen by neighbors.verlet_list.best_skin if not given.

    Raises ValueError for a number of threads below one, another precision, a skin that is negative or not finite.
    """

    threads: int | None = None
    precision: Precision = "double"
    skin: float | None = None

    def __post_init__(self) -> None:
        if self.threads is not None and not (isinstance(self.threads, Integral) and self.threads >= 1):
            raise ValueError(f"threads must be a whole number, at least 1, or None for all cores; threads = {self.threads!r}")
        if self.precision not in get_args(Precision):
            raise ValueError(f"precision must be one of {', '.join(get_args(Precision))}; precision = {self.precision!r}")
        if self.skin is not None and not (isinstance(self.skin, Real) and 0.0 <= self.skin < LARGEST):
            raise ValueError(f"skin must be a number from 0 to {LARGEST:g}; skin = {self.skin!r}")

    @property
    def most_threads(self) -> int:
        """The number of threads given, or that of all cores."""
        return self.threads or available_cores()
