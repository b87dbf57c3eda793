"""Transport coefficients as integrals of time correlations: where the integral has reached its plateau, and how uncertain that is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.structure.statistics import spread

Array = NDArray[np.float64]
CHANGE = 1.5  # standard errors that an integral may change in a plateau
OCTAVE = 2.0  # a plateau lasts from a time to this multiple of it
LONGEST = 0.25  # of the duration: later lags have too few origins
FEWEST_LAGS = 3  # in a plateau


class Plateau(NamedTuple):
    """value, error : of the integral, in its units.  window : (start, end) [time].  is_reached : whether the integral stays there."""

    value: float
    error: float
    window: tuple[float, float]
    is_reached: bool


def running_integral(times: Array, correlation: Array) -> Array:
    """∫₀ᵗ C dt' by trapezoids, (..., T), of C (..., T) at times (T,)."""
    steps = 0.5 * (correlation[..., 1:] + correlation[..., :-1]) * np.diff(times)
    return np.concatenate([np.zeros((*correlation.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)


def plateau(times: Array, integral: Array, without: Array) -> Plateau:
    """The earliest octave of times, t to 2t, in which the integral changes by at most one and a half standard errors of the change; its mean there.

    times, integral : (T,).  without : (K, T), replicas of the integral. If there is no such octave, that before the last time.
    The longer one integrates, the more noise is added, while the correlations that are left out become less.
    R. E. Jones, K. K. Mandadapu, J. Chem. Phys. 136, 154102 (2012), on the trade between the two.
    """
    for i in range(1, len(times)):
        inside = (times >= times[i]) & (times <= OCTAVE * times[i])
        if OCTAVE * times[i] > times[-1]:
            break
        change, error = integral[inside] - integral[i], spread(without[:, inside] - without[:, i : i + 1])
        if inside.sum() >= FEWEST_LAGS and (np.abs(change) <= CHANGE * error)[1:].all():
            return _mean_of(times, integral, without, inside, is_reached=True)
    return _mean_of(times, integral, without, times >= times[-1] / OCTAVE, is_reached=False)


def _mean_of(times: Array, integral: Array, without: Array, inside: NDArray[np.bool_], is_reached: bool) -> Plateau:
    error = float(spread(without[:, inside].mean(axis=1))) if len(without) else np.nan
    return Plateau(float(integral[inside].mean()), error, (float(times[inside][0]), float(times[inside][-1])), is_reached)
