"""The results of the drivers for small systems, in the manner of SciPy."""

from dataclasses import dataclass
from typing import Self

from minimd.integrators.method import Array
from minimd.structure.errors import ConvergenceError, NonFiniteError

__all__ = ["Solution"]


@dataclass
class Solution:
    """A path on a grid of times.

    t : (n + 1,) times.  y : (n + 1, size) states.  q, v : (n + 1, …) positions and velocities, of problems that have them.
    nfev : evaluations of the right-hand side (of f, for problems with q and v).  n_rejected : steps tried in vain.
    success, message : whether the end was reached, and if not, why.
    """

    t: Array
    y: Array
    nfev: int
    shape: tuple[int, ...] | None = None
    success: bool = True
    message: str = "the end was reached"
    n_rejected: int = 0

    @property
    def q(self) -> Array:
        """(n + 1, …) positions."""
        return self._half(0)

    @property
    def v(self) -> Array:
        """(n + 1, …) velocities."""
        return self._half(1)

    def ended(self, why: str) -> Self:
        """The same solution, which did not reach its end."""
        self.success, self.message = False, why
        return self

    def _half(self, k: int) -> Array:
        if self.shape is None:
            raise AttributeError("this problem has no q and v; its states are in y")
        n = self.y.shape[1] // 2
        return self.y[:, k * n : (k + 1) * n].reshape(-1, *self.shape)


def with_path(error: ConvergenceError | NonFiniteError, path: Solution) -> ConvergenceError | NonFiniteError:
    """The error of a run with the path before it, error.solution."""
    error.solution = path.ended(str(error))
    return error
