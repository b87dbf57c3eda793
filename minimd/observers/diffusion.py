"""Whether atoms diffuse, and how fast: one rule for observers and files, for displacements and velocities.

    D_k = (msd(t_k+1) − msd(t_k)) / 6 (t_k+1 − t_k),   t_k+1 = 2 t_k ≤ T/4

D_k is the mean over an octave of lags of the integral of the velocity autocorrelation. Where atoms diffuse it no longer
changes with the lag; what they did before, in flight or in a cage, is an offset of the msd and cancels. A straight line
through D_k over k, with weights 2⁻ᵏ as the variances of a random walk grow, has a level and a trend; their errors come
from blocks of time.

1. The trend over some number of late octaves, three or more, must be below two of its errors. Earlier octaves are added
   one by one until the trend is above three errors: where it is above two by chance, earlier octaves show that there is
   none. While the trend of the last three is known worse than to 10 % of D, the longest octave is left out.
2. D is the level over two octaves. They begin one octave after the earliest start whose trend is below two errors.
3. The error of D contains the difference to D one octave later.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from minimd.core.structure.arrays import Array
from minimd.core.structure.statistics import spread, with_error
from minimd.core.structure.units import CM2_PER_S, PICOSECOND, UnitSystem

LONGEST = 0.25  # of the duration: longer lags have too few origins
OCTAVES = 3  # over so many at least a trend is looked for
SEEN = 2.0  # errors of a trend, see 1; found by trying, as are the numbers below
SURE = 3.0  # likewise
SHARP = 0.1  # of D: a trend known worse tells nothing
KNOWN = 0.3  # of D: with a larger error only a limit is known
LEFT = 0.1  # of the msd: where less is due to the limit of D, atoms swing about their places
SPAN = 2  # octaves of D
WITHIN = 0.999  # of a lag: nearer is rounding
USUAL = 1e-5 * CM2_PER_S  # of a liquid
DIFFUSIVE = "diffusive"
NOT_YET = "not diffusive yet"
UNKNOWN = "unknown"
AT_PLACES = "at their places"
SHORT = "short"
FIXED = "fixed"
OF_ATOMS = '; of molecules, measure the centers: of="molecules"'
SLOPE = "slope of the mean square"


def diffusion_words(coefficient: float, error: float, units: UnitSystem) -> str:
    """D in words, in Å²/ps and cm²/s, or in reduced units."""
    if units.name != "ASE":
        return f"{_known(coefficient, error)} {units.length}²/{units.time}"
    numbers = np.array([coefficient, error])
    return f"{_known(*PICOSECOND * numbers)} Å²/ps = ({_known(*numbers / USUAL)})·10⁻⁵ cm²/s"


def _known(value: float, error: float) -> str:
    """A value with its error; to two digits if it has none."""
    return with_error(value, error) if error > 0.0 else f"{value:.2g}"


class Diffusivity(NamedTuple):
    """D, or why there is none.

    state : DIFFUSIVE, NOT_YET, UNKNOWN (too noisy), FIXED (no atom can move), AT_PLACES (of a crystal or a glass: at
        the longest lag the limit of D explains less than a tenth of the mean square), or SHORT (fewer than four lags
        that double).
    value, error : D and its standard error [length²/time]; NaN unless diffusive.
    window : lags of D; if there is none, those whose slopes were compared [time].
    trend, trend_error : relative change of the slope when the lag doubles.
    limit : D is below the slope at the longest lags and two errors [length²/time]; NaN if the slope rises, or if D is
        known.
    """

    state: str
    value: float = np.nan
    error: float = np.nan
    window: tuple[float, float] = (np.nan, np.nan)
    trend: float = np.nan
    trend_error: float = np.nan
    limit: float = np.nan

    def in_words(self, units: UnitSystem, quantity: str = SLOPE, are_joined: bool = False) -> str:
        """D and from where it is; or why there is none, what is known of it, and what to do.

        quantity : that of which the change is told.
        are_joined : whether it is of atoms of molecules.
        """
        advice = "run longer" + OF_ATOMS * are_joined
        if self.state == SHORT:
            return f"unknown: the run has fewer than four lags that double, up to a quarter of it; {advice}"
        if self.state == FIXED:
            return "does not move by itself: all these atoms are fixed, or massless sites"
        start, end = self.window
        lags = f"lags of {units.shown(start)} to {units.shown(end)}"
        percent = _known(100.0 * self.trend, 100.0 * self.trend_error)
        change = f"{percent} % when the lag doubles"
        if self.state == DIFFUSIVE:
            value = diffusion_words(self.value, self.error, units)
            has_error = (
                "" if self.error > 0.0 else " without an error bar, for which the run is too short"
            )
            slope = (
                f"{quantity.partition(' ')[0]}: {change}"
                if np.isfinite(self.trend)
                else "one octave"
            )
            return f"D = {value}{has_error}, from {lags} ({slope}), in this cell"
        limit = ""
        if np.isfinite(self.limit):
            limit = f"D is below {diffusion_words(self.limit, 0.0, units)}; "
        if self.state == AT_PLACES:
            return f"unknown, {limit}at {lags} atoms have not left their places, as in a crystal"
        slope = f"at {lags} the {quantity} changes by {change}"
        if self.state == UNKNOWN:
            return f"unknown, {limit}{slope}; {advice}"
        return f"NOT DIFFUSIVE YET: {slope}; {limit}{advice}"


class _Octaves:
    """Slopes over octaves of lags from start to end.  Others as for diffusivity.

    lags : (n + 1,), each twice the one before, or nearly.
    """

    def __init__(
        self,
        times: Array,
        mean: Array,
        without: Array,
        dimensions: int,
        start: float,
        end: float,
    ) -> None:
        inside = np.flatnonzero((times > 0.0) & (times >= start) & (times <= end))
        places = inside[-1:].tolist()
        while places and 0.5 * times[places[0]] >= WITHIN * times[inside[0]]:
            places.insert(0, int(np.abs(times - 0.5 * times[places[0]]).argmin()))
        self.lags = times[places].tolist()
        squares = np.vstack([mean, without])[:, places]
        self._slopes = np.diff(squares) / (2.0 * dimensions * np.diff(self.lags))
        self.n = self._slopes.shape[1]

    def level(self, first: int, last: int) -> tuple[float, float]:
        """The mean slope of octaves from first up to last, and its error."""
        return self._sums(self._weights(first, last))

    def trend(self, first: int, last: int) -> tuple[float, float]:
        """The relative change of the slope for each octave, and its error; NaN for a single one."""
        octave = np.arange(self.n)
        weights = self._weights(first, last)
        change = weights * (octave - weights @ octave)
        size = abs(self.level(first, last)[0]) * (change @ octave) or np.nan
        return self._sums(change / size)

    def _weights(self, first: int, last: int) -> Array:
        weights = np.zeros(self.n)
        weights[first:last] = 0.5 ** np.arange(last - first)
        return weights / weights.sum()

    def _sums(self, weights: Array) -> tuple[float, float]:
        slopes = self._slopes @ weights
        return float(slopes[0]), float(spread(slopes[1:]))


def diffusivity(
    times: Array,
    mean: Array,
    without: Array,
    longest: float,
    window: tuple[float, float] | None = None,
    dimensions: int = 3,
) -> Diffusivity:
    """D by the rule of this module, or why there is none.

    times : (T,) lags [time], with nearly all halves of the longest.
    mean : (T,) mean square displacements [length²]; NaN of atoms that are all fixed.
    without : (K, T), its replicas, each without one block of time.
    longest : lag, a quarter of the run [time].
    window : lags; D is then the level over all of its octaves, whether atoms diffuse there or not [time].

    Raises ValueError for a window without an octave of lags.
    """
    if np.isnan(mean).all():
        return Diffusivity(FIXED)
    octaves = _Octaves(times, mean, without, dimensions, *(window or (0.0, longest)))
    lags = octaves.lags
    n = octaves.n
    if window is not None:
        if n == 0:
            span = f"{times[0]:.4g} to {times[-1]:.4g}"
            raise ValueError(
                f"the window must hold a lag and its double; window = {window}, lags = {span}"
            )

        used = (lags[0], lags[n])
        return Diffusivity(DIFFUSIVE, *octaves.level(0, n), used, *octaves.trend(0, n))

    if n < OCTAVES:
        return Diffusivity(SHORT)
    end = n
    while end > OCTAVES and not octaves.trend(end - OCTAVES, end)[1] < SHARP:
        end -= 1
    late = end - OCTAVES
    trend, trend_error = octaves.trend(late, end)
    begin = end

    for first in range(late, -1, -1):
        change, its_error = octaves.trend(first, end)
        if not (abs(change) < SURE * its_error and its_error < SHARP):
            break
        if abs(change) < SEEN * its_error:
            begin = first
            trend = change
            trend_error = its_error

    start = 1 + min(begin, late)
    stop = min(start + SPAN, end)
    value, scatter = octaves.level(start, stop)
    later, _ = octaves.level(start + 1, min(stop + 1, end))
    error = float(np.hypot(scatter, value - later))
    if begin < end and error < KNOWN * value:
        return Diffusivity(DIFFUSIVE, value, error, (lags[start], lags[stop]), trend, trend_error)
    last, its_error = octaves.level(n - SPAN, n)
    limit = abs(last) + 2.0 * its_error
    state = UNKNOWN
    used = (lags[late], lags[end])
    if 2.0 * dimensions * limit * lags[n] < LEFT * np.interp(lags[n], times, mean):
        state = AT_PLACES
        used = (lags[n - SPAN], lags[n])
    elif begin == end and abs(trend) >= SEEN * trend_error:
        state = NOT_YET
        limit = np.nan if trend > 0.0 and end == n else limit
    return Diffusivity(state, np.nan, np.nan, used, trend, trend_error, limit)
