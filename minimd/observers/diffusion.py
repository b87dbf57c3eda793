"""Whether atoms diffuse, and how fast: one rule for observers and files, for displacements and velocities.

    D_k = (msd(t_k+1) − msd(t_k)) / 6 (t_k+1 − t_k),   t_k+1 = 2 t_k ≤ T/4

D_k is the mean over an octave of lags of the integral of the velocity autocorrelation. Where atoms diffuse it no longer
changes with the lag; what they did before, in flight or in a cage, is an offset of the msd and cancels. A straight line
through D_k over k, with weights 2⁻ᵏ as the variances of a random walk grow, has a level and a trend; their errors come
from blocks of time.

1. The trend over the last three octaves must be below 2.5 of its errors. While it is known worse than to 10 % of D, the
   longest octave is left out.
2. Earlier octaves are added as long as the trend is below two errors. D is the level over two octaves, which begin one
   after the first of these.
3. The error of D contains the difference to D one octave later, and grows with the last lag t by 1 + 2 t/T.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.structure.statistics import spread, with_error
from minimd.core.structure.units import UnitSystem

Array = NDArray[np.float64]
LONGEST = 0.25  # of the duration: longer lags have too few origins
OCTAVES = 3  # over so many at least a trend is looked for
SURE, SEEN = 2.5, 2.0  # errors: of a trend over the last octaves, and of one that begins earlier
SHARP = 0.1  # of D: a trend known worse tells nothing
KNOWN = 0.3  # of D: with a larger error only a limit is known
SPAN = 2  # octaves of D
LATE = 2.0  # see 3; found by trying, as are the numbers above
WITHIN = 0.999  # of a lag: nearer is rounding
USUAL = 10.0  # 10⁻⁵ cm²/s per Å²/ps
DIFFUSIVE, NOT_YET, UNKNOWN, SHORT = "diffusive", "not diffusive yet", "unknown", "short"


def diffusion_words(coefficient: float, error: float, units: UnitSystem) -> str:
    """D in words, in Å²/ps and cm²/s, or in reduced units."""
    if units.name != "ASE":
        return f"{with_error(coefficient, error)} {units.length}²/{units.time}"
    per_ps = coefficient / units.to_picosecond
    its_error = error / units.to_picosecond
    usual = with_error(USUAL * per_ps, USUAL * its_error)
    return f"{with_error(per_ps, its_error)} Å²/ps = ({usual})·10⁻⁵ cm²/s"


class Diffusivity(NamedTuple):
    """D, or why there is none.

    state : DIFFUSIVE, NOT_YET, UNKNOWN (too noisy), or SHORT (fewer than four lags that double).
    value, error : D and its standard error [length²/time]; NaN unless diffusive.
    window : lags of D; if there is none, those whose slopes were compared [time].
    trend, trend_error : relative change of the slope when the lag doubles.
    limit : D is below the slope at the longest lags and two errors [length²/time]; NaN if the slope still rises.
    """

    state: str
    value: float = np.nan
    error: float = np.nan
    window: tuple[float, float] = (np.nan, np.nan)
    trend: float = np.nan
    trend_error: float = np.nan
    limit: float = np.nan

    @property
    def is_reached(self) -> bool:
        """Whether D no longer changes with the lag."""
        return self.state == DIFFUSIVE

    def times(self, factor: float) -> Diffusivity:
        """This with D multiplied."""
        return self._replace(value=factor * self.value, error=factor * self.error, limit=factor * self.limit)

    def in_words(self, units: UnitSystem, has_centers: bool) -> str:
        """D and from where it is; or why there is none, what is known of it, and what to do.
        has_centers : whether centers of molecules could be measured instead of atoms."""
        advice = 'run longer, or measure centers of molecules: of="molecules"' if has_centers else "run longer"
        if self.state == SHORT:
            return f"unknown: the run has fewer than four lags that double, up to a quarter of it; {advice}"
        start, end = self.window
        lags = f"lags of {units.shown(start)} to {units.shown(end)}"
        change = f"{100.0 * self.trend:+.0f} ± {100.0 * self.trend_error:.0f} % when the lag doubles"
        if self.state == DIFFUSIVE:
            return f"D = {diffusion_words(self.value, self.error, units)}, from {lags} (slope: {change}), in this cell"
        limit = f"D is below {diffusion_words(float(f'{self.limit:.2g}'), 0.0, units)}; "
        slope = f"at {lags} the slope of the mean square changes by {change}"
        if self.state == UNKNOWN:
            return f"unknown, {limit}{slope}; {advice}"
        return f"NOT DIFFUSIVE YET: {slope}; {limit if np.isfinite(self.limit) else ''}{advice}"


class _Octaves:
    """Slopes over octaves of lags.

    times, mean, without : as for diffusivity.  start, end : of the lags.
    lags : (n + 1,), each twice the one before, or nearly.
    """

    def __init__(self, times: Array, mean: Array, without: Array, start: float, end: float) -> None:
        inside = np.flatnonzero((times > 0.0) & (times >= start) & (times <= end))
        places = inside[-1:].tolist()
        while places and 0.5 * times[places[-1]] >= WITHIN * times[inside[0]]:
            places.append(int(np.abs(times - 0.5 * times[places[-1]]).argmin()))
        chosen = np.array(places[::-1], dtype=np.int64)
        self.lags = times[chosen].tolist()
        self.n = max(0, len(chosen) - 1)
        self._slopes = np.diff(mean[chosen]) / (6.0 * np.diff(self.lags))
        self._replicas = np.diff(without[:, chosen]) / (6.0 * np.diff(self.lags))

    def level(self, first: int, last: int) -> tuple[float, float]:
        """The mean slope of octaves from first up to last, and its error."""
        return self._sums(self._weights(first, last))

    def trend(self, first: int, last: int) -> tuple[float, float]:
        """The relative change of the slope for each octave, and its error."""
        octave = np.arange(self.n)
        weights = self._weights(first, last)
        change = weights * (octave - weights @ octave)
        value, error = self._sums(change / (change @ octave))
        size = abs(self.level(first, last)[0]) or np.nan
        return value / size, error / size

    def _weights(self, first: int, last: int) -> Array:
        octave = np.arange(self.n)
        weights = np.where((octave >= first) & (octave < last), 0.5 ** (octave - first), 0.0)
        return np.asarray(weights / weights.sum())

    def _sums(self, weights: Array) -> tuple[float, float]:
        return float(self._slopes @ weights), float(spread(self._replicas @ weights))


def diffusivity(times: Array, mean: Array, without: Array, longest: float) -> Diffusivity:
    """D by the rule of this module, or why there is none.

    times : (T,) lags [time], with nearly all halves of the longest.  mean : (T,) mean square displacements [length²].
    without : (K, T), its replicas, each without one block of time.  longest : lag, a quarter of the run [time].
    """
    octaves = _Octaves(times, mean, without, 0.0, longest)
    n = octaves.n
    if n < OCTAVES:
        return Diffusivity(SHORT)
    end = n
    while end > OCTAVES and not octaves.trend(end - OCTAVES, end)[1] < SHARP:
        end -= 1
    late = end - OCTAVES
    trend, trend_error = octaves.trend(late, end)
    begin = end
    limit_of_trend = SURE
    for first in range(late, -1, -1):
        change, error = octaves.trend(first, end)
        if not (abs(change) < limit_of_trend * error and error < SHARP):
            break
        begin, trend, trend_error = first, change, error
        limit_of_trend = SEEN
    is_flat = begin < end
    start = 1 + (begin if is_flat else late)
    stop = min(start + SPAN, end)
    value, scatter = octaves.level(start, stop)
    later, _ = octaves.level(start + 1, min(stop + 1, end))
    window = (octaves.lags[start], octaves.lags[stop])
    error = float(np.hypot(scatter, value - later)) * (1.0 + LATE * LONGEST * window[1] / longest)
    last, its_error = octaves.level(n - SPAN, n)
    limit = abs(last) + 2.0 * (1.0 + LATE * LONGEST) * its_error
    if is_flat and error < KNOWN * value:
        return Diffusivity(DIFFUSIVE, value, error, window, trend, trend_error, limit)
    is_changing = not is_flat and abs(trend) >= SURE * trend_error
    if is_changing and trend > 0.0 and end == n:
        limit = np.nan
    compared = (octaves.lags[late], octaves.lags[end])
    return Diffusivity(NOT_YET if is_changing else UNKNOWN, np.nan, np.nan, compared, trend, trend_error, limit)


def slope(times: Array, squares: Array) -> Array:
    """Slopes of straight lines through mean squares (..., T) at times (T,), each point weighted by 1/t, because its
    error grows as t."""
    weights = 1.0 / times
    weights = weights**2 / (weights**2).sum()
    t = times - weights @ times
    return np.asarray((squares * (weights * t)).sum(axis=-1) / (weights * t * t).sum())


def fitted(times: Array, mean: Array, without: Array, window: tuple[float, float]) -> Diffusivity:
    """D of a straight line within a window, whether atoms diffuse there or not.  Others as for diffusivity.
    Raises ValueError for a window with fewer than 3 lags."""
    start, end = window
    inside = (times >= start) & (times <= end) & (times > 0.0)
    if inside.sum() < 3:
        held = f"({start:.4g}, {end:.4g}) holds {inside.sum()} of {len(times)}"
        raise ValueError(f"the window of the fit must hold at least 3 lags; {held}")
    chosen = times[inside]
    value = float(slope(chosen, mean[inside])) / 6.0
    error = float(spread(slope(chosen, without[:, inside]) / 6.0))
    octaves = _Octaves(times, mean, without, start, end)
    trend = octaves.trend(0, octaves.n) if octaves.n > 1 else (np.nan, np.nan)
    return Diffusivity(DIFFUSIVE, value, error, (float(chosen[0]), float(chosen[-1])), *trend)
