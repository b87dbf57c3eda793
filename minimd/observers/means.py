"""The base of observers of means over time: each of several quantities, with its standard error."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.structure.arrays import Array
from minimd.core.structure.statistics import FEWEST, correlation_times, short_run, with_error
from minimd.observers.accumulator import Accumulator, BlockedSums, ObservedRun, Result, Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes


STILL = 1e-6  # of a mean: a smaller error may be rounding, of a quantity that is constant


class Quantity(NamedTuple):
    """name : in numbers and columns.  symbol : in words.  unit : its name."""

    name: str
    symbol: str
    unit: str


@dataclass(frozen=True, repr=False)
class MeansResult(Result):
    """Means of Q quantities over a run; each is an attribute by its name, and its standard error by that and _error.

    quantities : Q of them.
    values, errors : (Q,) and their standard errors.
    times : (B,) of the last looks in parts of the run [time].
    parts : (B, Q) of each part, or up to its end.
    n_frames : number of looks.
    lengths : of the run in correlation times, (Q,) of each quantity, or of what counts; NaN if unknown.
    """

    quantities: list[Quantity]
    values: Array
    errors: Array
    times: Array
    parts: Array
    n_frames: int
    lengths: Array
    of_parts: ClassVar[str] = "mean of each part of the run"
    correlated: ClassVar[str] = ""  # what lengths are of, if not of the quantities
    enough: ClassVar[float] = FEWEST  # of lengths, for an error bar that can be trusted

    def __getattr__(self, name: str) -> float:
        if name.startswith("_") or name not in self.numbers():
            known = ", ".join(quantity.name for quantity in self.quantities)
            raise AttributeError(
                f"there is no {name!r}; this result has {known}, each also with _error"
            )
        return self.numbers()[name]

    def numbers(self) -> dict[str, float]:
        """See Result."""
        numbers = {}
        for k, quantity in enumerate(self.quantities):
            numbers[quantity.name] = float(self.values[k])
            numbers[f"{quantity.name}_error"] = float(self.errors[k])
        return numbers

    def series(self) -> list[Series]:
        """See Result: the parts of the run, of the quantities that are known."""
        parts = zip(self.quantities, self.parts.T, np.isfinite(self.values), strict=True)
        of_parts = [
            Series(name, unit, part) for (name, _, unit), part, is_known in parts if is_known
        ]
        return [Series("time", self.units.time, self.times), *of_parts]

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [(self.title, f"mean of {self.scene.frames(self.n_frames)}")]
        for (_, symbol, unit), value, error in zip(
            self.quantities, self.values, self.errors, strict=True
        ):
            rows.append(("", f"{symbol} = {with_error(value, error)} {unit}".rstrip()))
        slowest = self.correlated
        if not slowest and np.isfinite(self.lengths).any():
            slowest = self.quantities[np.nanargmin(self.lengths)].symbol
        short = short_run(self.correlation_times, slowest, self.enough)
        return [*rows, ("", short)] if short else rows

    @property
    def correlation_times(self) -> float:
        """Length of the run in correlation times of the slowest quantity; NaN if unknown."""
        return float(np.fmin.reduce(self.lengths))

    def draw(self, panel: Axes) -> None:
        """See Result: the quantities that have the unit of the first one."""
        unit = self.quantities[0].unit
        drawn = [k for k, quantity in enumerate(self.quantities) if quantity.unit == unit]
        self.draw_quantities(panel, drawn, unit)

    def draw_quantities(self, panel: Axes, drawn: list[int], unit: str, size: float = 1.0) -> None:
        """Draw the parts of the run, and the mean with a band of one standard error.

        drawn : the numbers of quantities.
        unit : the one in which they are drawn; size is its size in their own.
        """
        symbols = [self.quantities[k].symbol for k in drawn]
        curves = [Series(self.quantities[k].symbol, unit, self.parts[:, k] / size) for k in drawn]
        label = ", ".join([*symbols[: len(drawn) == 1], self.of_parts])
        self.draw_curves(panel, curves, "t", f"{label}  [{unit}]".replace("  []", ""))
        panel.set_title(f"{self.title}, {self.scene.frames(self.n_frames)}")
        for k, curve in zip(drawn, [*panel.lines], strict=True):
            color = curve.get_color()
            mean = self.values[k] / size
            error = np.nan_to_num(self.errors[k]) / size
            panel.axhline(mean, color=color, lw=0.8, ls="--")
            panel.axhspan(mean - error, mean + error, color=color, alpha=0.15, lw=0.0)


class Means(Accumulator):
    """An observer of means; its sums are the number of looks, the quantities, and their squares."""

    answer: ClassVar[type[MeansResult]]

    def _laid_out(self, scene: ObservedRun) -> None:
        self.sums = BlockedSums(1 + 2 * len(self._quantities(scene)))

    def _look(self, engine: Engine) -> None:
        values = self._values(engine)
        self.sums.total += np.concatenate([[1.0], values, values**2])

    @abstractmethod
    def _quantities(self, scene: ObservedRun) -> list[Quantity]:
        """What is measured."""

    @abstractmethod
    def _values(self, engine: Engine) -> Array:
        """Their present values, (Q,)."""

    def result(self) -> MeansResult:
        """The means so far, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()
        quantities = self._quantities(scene)
        n = len(quantities)

        def law(sums: Array) -> Array:
            return sums[1 : 1 + n] / sums[0]

        values, errors = self.sums.estimate(law)
        variances = self.sums.total[1 + n :] / self.sums.total[0] - values**2
        lengths = np.where(
            errors > STILL * np.abs(values), correlation_times(variances, errors), np.nan
        )
        parts = self._history(law, self.sums.parts())
        return self.answer(scene, quantities, values, errors, *parts, self.n_looks, lengths)
