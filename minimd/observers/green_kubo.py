"""Transport coefficients as integrals of time correlations: the plateau of the integral, and its standard error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.structure.statistics import spread
from minimd.structure.units import UnitSystem

Array = NDArray[np.float64]
SLOWER = 1.5  # S: ratio of the slowest correlation time to the mean time of the integral; Wolff's value
OCTAVE = 2.0  # a plateau lasts from a time to this multiple of it
FEWEST_LAGS = 3  # in a plateau


class Plateau(NamedTuple):
    """value, error : of the integral, in its units.  window : (start, end) [time].  is_reached :
    whether the integral has a plateau."""

    value: float
    error: float
    window: tuple[float, float]
    is_reached: bool

    def said(self, units: UnitSystem) -> str:
        """Where the value is from, in words."""
        where = f"{units.shown(self.window[0])} to {units.shown(self.window[1])}"
        return f"{'plateau of its integral,' if self.is_reached else 'NO PLATEAU of its integral, taken from'} {where}"


def running_integral(times: Array, correlation: Array) -> Array:
    """∫₀ᵗ C dt' by trapezoids, (..., T), of C (..., T) at times (T,)."""
    steps = 0.5 * (correlation[..., 1:] + correlation[..., :-1]) * np.diff(times)
    return np.concatenate([np.zeros((*correlation.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)


def plateau(times: Array, integral: Array, without: Array) -> Plateau:
    """The mean of the integral over an octave of times, t to 2t,
    that begins where the noise grows faster than the missing rest decreases.

        A(t) e^(−t/Sτ) ≤ σ(t) Sτ/2t,   τ(t) = ∫₀ᵗ |I(t) − I(s)| ds / A(t),   A(t) = max |I(s)|, s ≤ t,   S = 1.5

    The first t that fulfills this is used: there the sum of both errors is smallest, if the rest beyond t is A
    e^(−t/Sτ) and the standard error σ grows as √t. For C = e^(−t/τ₀), τ is τ₀; a slow part contributes to τ in
    proportion to its share of the integral. If there is no such t, the last octave is used. A slow correlation whose
    whole share of the integral is below the error bar is not noticed, and is missing from the result.

    times, integral : (T,), from time 0.  without : (K, T), replicas of the integral.

    U. Wolff, Comput. Phys. Commun. 156, 143 (2004), on the window and S, with τ from the whole integral instead of
    C(0); N. Madras, A. D. Sokal, J. Stat. Phys. 50, 109 (1988), on windows that are multiples of τ.
    """
    errors, largest = spread(without), np.maximum.accumulate(np.abs(integral))
    for i in range(1, len(times)):
        inside = (times >= times[i]) & (times <= OCTAVE * times[i])
        if OCTAVE * times[i] > times[-1]:
            break
        late = np.trapezoid(np.abs(integral[i] - integral[: i + 1]), times[: i + 1])
        slowest = SLOWER * late / largest[i] if largest[i] > 0.0 else np.inf
        is_late = (
            largest[i] * np.exp(-times[i] / slowest) <= errors[i] * slowest / (2.0 * times[i])
            if slowest > 0.0
            else True
        )
        if inside.sum() >= FEWEST_LAGS and is_late:
            return _mean_of(times, integral, without, inside, is_reached=True)
    return _mean_of(times, integral, without, times >= times[-1] / OCTAVE, is_reached=False)


def _mean_of(times: Array, integral: Array, without: Array, inside: NDArray[np.bool_], is_reached: bool) -> Plateau:
    start, end = float(times[inside][0]), float(times[inside][-1])

    def mean(values: Array) -> Array:
        return np.asarray(
            np.trapezoid(values[..., inside], times[inside]) / (end - start)
            if end > start
            else values[..., inside].mean(axis=-1)
        )

    return Plateau(
        float(mean(integral)), float(spread(mean(without))) if len(without) else np.nan, (start, end), is_reached
    )
