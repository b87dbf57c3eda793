"""What the methods for small systems return, in the manner of SciPy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass
class Solution:
    """A path on a grid of times.

    t : (n + 1,) times.  q, v : (n + 1, …) positions and velocities at these times.  nfev : evaluations of the force.
    success, message : whether the end was reached, and if not, why.
    """

    t: NDArray[np.float64]
    q: NDArray[np.float64]
    v: NDArray[np.float64]
    nfev: int
    success: bool = True
    message: str = "the end was reached"
