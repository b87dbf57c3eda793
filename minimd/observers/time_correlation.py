"""The base of observers of correlations in time: the correlator, its sums, and their integrals.

Transport coefficients are integrals of time correlations: the plateau of the integral, with its standard error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look
from minimd.core.structure.arrays import Array
from minimd.core.structure.statistics import spread, with_error
from minimd.core.structure.units import UnitSystem
from minimd.observers.accumulator import Accumulator, BlockedSums, Result, Series
from minimd.observers.correlator import MultipleTau
from minimd.observers.diffusion import LONGEST

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ENOUGH = 100.0  # times the start of the plateau: a shorter run knows its error bar badly
# entries on each level of a correlator that averages: over at most a sixteenth of a lag
POINTS = 32
# S: ratio of the slowest correlation time to the mean time of the integral; Wolff's value
SLOWER = 1.5
OCTAVE = 2.0  # a plateau lasts from a time to this multiple of it
FEWEST_LAGS = 3  # in a plateau
# multiples of its start at which a plateau still has its value, and the errors by which it may differ
FLAT_UNTIL = np.array([2.0, 4.0])
FLAT = 1.5


class Plateau(NamedTuple):
    """value, error : of the integral, in its units.
    window : (start, end) [time].
    is_reached : whether the integral has a plateau."""

    value: float
    error: float
    window: tuple[float, float]
    is_reached: bool

    def said(self, units: UnitSystem) -> str:
        """Where the value is from, in words."""
        where = f"{units.shown(self.window[0])} to {units.shown(self.window[1])}"
        reached = (
            "plateau of its integral,"
            if self.is_reached
            else "NO PLATEAU of its integral, taken from"
        )
        return f"{reached} {where}"


def running_integral(times: Array, correlation: Array) -> Array:
    """∫₀ᵗ C dt' by trapezoids, (..., T), of C (..., T) at times (T,)."""
    steps = 0.5 * (correlation[..., 1:] + correlation[..., :-1]) * np.diff(times)
    start = np.zeros((*correlation.shape[:-1], 1))
    return np.concatenate([start, np.cumsum(steps, axis=-1)], axis=-1)


def plateau(times: Array, integral: Array, without: Array) -> Plateau:
    """The mean of the integral over an octave of times, t to 2t, that begins where the noise grows faster than the
    missing rest decreases.

        A(t) e^(−t/Sτ) ≤ σ(t) Sτ/2t,   τ(t) = ∫₀ᵗ |I(t) − I(s)| ds / A(t),   A(t) = max |I(s)|, s ≤ t,   S = 1.5

    The first t that fulfills this is used: there the sum of both errors is smallest, if the rest beyond t is A
    e^(−t/Sτ) and the standard error σ grows as √t. For C = e^(−t/τ₀), τ is τ₀; a slow part contributes to τ in
    proportion to its share of the integral. A correlation that is negative at last, as that of ions in a solvent, has
    an integral with a maximum, which is no plateau: at 2t and 4t the integral must differ from I(t) by less than 1.5
    of the standard errors of these differences. If there is no such t, the last octave is used. A slow correlation
    whose whole share of the integral is below the error bar is not noticed, and is missing from the result.

    times, integral : (T,), from time 0.
    without : (K, T), replicas of the integral.

    U. Wolff, Comput. Phys. Commun. 156, 143 (2004), on the window and S, with τ from the whole integral instead of
    C(0); N. Madras, A. D. Sokal, J. Stat. Phys. 50, 109 (1988), on windows that are multiples of τ.
    """
    errors = spread(without)
    largest = np.maximum.accumulate(np.abs(integral))
    inside = times >= times[-1] / OCTAVE
    is_reached = False

    for i in range(1, int((OCTAVE * times <= times[-1]).sum())):
        start = times[i]
        octave = (times >= start) & (times <= OCTAVE * start)
        late = np.trapezoid(np.abs(integral[i] - integral[: i + 1]), times[: i + 1])
        slowest = SLOWER * late / largest[i] if largest[i] > 0.0 else np.inf
        noise = errors[i] * slowest / (2.0 * start)
        is_late = not slowest > 0.0 or largest[i] * np.exp(-start / slowest) <= noise
        later = np.searchsorted(times, start * FLAT_UNTIL)
        later = later[later < len(times)]
        change = np.abs(integral[later] - integral[i])
        is_flat = (change <= FLAT * spread(without[:, later] - without[:, i, None])).all()
        if octave.sum() >= FEWEST_LAGS and is_late and is_flat:
            inside = octave
            is_reached = True
            break

    t = times[inside]
    duration = t[-1] - t[0]

    def mean(values: Array) -> Array:
        chosen = values[..., inside]
        if duration > 0.0:
            return np.asarray(np.trapezoid(chosen, t) / duration)
        return np.asarray(chosen.mean(axis=-1))

    window = (float(t[0]), float(t[-1]))
    return Plateau(float(mean(integral)), float(spread(mean(without))), window, is_reached)


COUNT, TEMPERATURE, VOLUME, HEAD = range(4)  # places in the sums, before those of the correlator
LEVELS = "largest number of levels of the correlator"


class TimeCorrelation(Accumulator):
    """An observer of a correlation in time: its sums are the number of looks, temperatures, volumes, and those of a
    multiple-tau correlator."""

    convention = 2  # relative to the center of mass where its motion is no degree of freedom

    def prepare(self, engine: Engine) -> None:
        """See Accumulator.
        Raises ValueError also for a method whose steps do not follow each other in time."""
        if not engine.method.is_dynamics:
            raise ValueError(
                f"{self.kind} is a correlation in time, which {engine.method.name} does not have: "
                "take dynamics, such as LangevinBAOAB or VelocityVerlet"
            )
        super().prepare(engine)

    def interrupt(self) -> None:
        """See Accumulator."""
        if self.scene is not None:
            self._correlator.interrupt()

    def _correlate_by(self, correlator: MultipleTau) -> None:
        """Make the sums."""
        self._correlator = correlator
        self.sums = BlockedSums(HEAD + correlator.size)

    def _add(self, look: Look, entry: Array) -> None:
        """Add a look to the sums.
        entry : (C, n), for the correlator."""
        sums = self.sums.total
        sums[:HEAD] += 1.0, look.temperature, look.system.volume or np.nan
        self._correlator.add(entry, sums[HEAD:])

    def _parts(self) -> list[Any]:
        return [self.sums, self._correlator]

    def _seen(self) -> tuple[NDArray[np.bool_], Array, float]:
        """Whether each lag has origins; the lags that have [time]; the longest lag for fits and integrals [time]."""
        counts, _ = self._correlator.correlations(self.sums.total[HEAD:])
        seen = counts > 0.0
        spacing = self.answered().spacing
        times: Array = self._correlator.lags[seen] * np.float64(spacing)
        return seen, times, LONGEST * (self.n_looks / self.n_runs - 1) * spacing

    def _estimate(
        self, times: Array, longest: float, law: Callable[[Array], Array]
    ) -> tuple[Array, Array]:
        """The result of a law for the sums, (..., T), and its standard errors; NaN for lags that only a small part of
        the blocks contains."""
        values, errors = self.sums.estimate(law)
        errors[..., times > 2.0 * longest] = np.nan
        return values, errors

    def _integral(
        self, times: Array, longest: float, law: Callable[[Array], Array]
    ) -> tuple[Array, Array, Plateau]:
        """A running integral, (T,), its standard errors, and its plateau.
        law : of the sums."""
        values, errors = self._estimate(times, longest, law)
        good = times <= max(longest, times[min(1, len(times) - 1)])
        replicas = self.sums.replicas(law)[:, good]
        return values, errors, plateau(times[good], values[good], replicas)

    def _series(
        self,
        times: Array,
        longest: float,
        correlation: Callable[[Array], Array],
        integral: Callable[[Array], Array],
    ) -> tuple[Array, Array, Array, Array, Plateau, float]:
        """What an IntegralResult has after its times.
        correlation, integral : laws of the sums."""
        correlations = self._estimate(times, longest, correlation)
        duration = self.n_looks * self.answered().spacing
        return *correlations, *self._integral(times, longest, integral), duration


@dataclass(frozen=True, repr=False)
class IntegralResult(Result):
    """A transport coefficient: an autocorrelation, and its running integral with the plateau.

    times : (T,) lags [time].
    autocorrelation, autocorrelation_error : (T,).
    integral, integral_error : its integral up to each lag, times what makes it the coefficient, (T,).
    plateau : of the integral.
    duration : of the run [time].

    A class gives the symbol of the coefficient, square and unit, which are those of autocorrelation and integral, and
    in_si, the factor and the unit in which the coefficient is shown if it is in ASE's units.
    """

    times: Array
    autocorrelation: Array
    autocorrelation_error: Array
    integral: Array
    integral_error: Array
    plateau: Plateau
    duration: float
    symbol: ClassVar[str]
    square: ClassVar[Any]
    unit: ClassVar[Any]
    in_si: ClassVar[tuple[float, str]]

    @property
    def shown(self) -> tuple[float, str]:
        """The factor and the unit in which the coefficient is shown."""
        return self.in_si if self.units.name == "ASE" else (1.0, self.unit)

    def series(self) -> list[Series]:
        """See Result."""
        correlation = (self.autocorrelation, self.autocorrelation_error)
        return [
            Series("time", self.units.time, self.times),
            Series("autocorrelation", self.square, *correlation),
            Series("integral", self.unit, self.integral, self.integral_error),
        ]

    def in_words(self, value: float, error: float) -> str:
        """A coefficient, in the unit in which it is shown."""
        factor, unit = self.shown
        return f"{self.symbol} = {with_error(factor * value, factor * error)} {unit}"

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        value = self.in_words(self.plateau.value, self.plateau.error)
        rows = [(self.title, f"{value}; {self.plateau.said(units)}")]
        enough = ENOUGH * self.plateau.window[0]
        if self.duration < enough:
            short = f"the run is SHORT, {units.shown(self.duration)}"
            needed = f"a reliable error bar takes at least about {units.shown(enough)}"
            rows.append(("", f"{short}: {needed}"))
        return rows

    def draw(self, panel: Axes) -> None:
        """See Result."""
        times, time = self.abscissa()
        factor, unit = self.shown
        value = factor * self.plateau.value
        start, end = np.array(self.plateau.window) * self.units.to_picosecond
        panel.axvspan(start, end, color="0.93")
        panel.axhline(value, color="0.6", lw=0.8, ls="--")
        bars = factor * self.integral_error
        panel.errorbar(times, factor * self.integral, bars, lw=1.1, elinewidth=0.6)
        highest = factor * self.integral[times <= 2.0 * end].max()  # not of the noise beyond
        panel.set(
            xlabel=f"t  [{time}]",
            ylabel=f"{self.symbol}  [{unit}]",
            title=f"{self.title}, running integral",
            xlim=(0.0, 2.0 * end or None),
            ylim=(0.0, max(2.0 * value, 1.1 * highest) or None),
        )
