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
    lengths : (Q,) of the run in correlation times of each quantity; NaN if unknown, or if it is constant.
    """

    quantities: list[Quantity]
    values: Array
    errors: Array
    times: Array
    parts: Array
    n_frames: int
    lengths: Array
    of_parts: ClassVar[str] = "means of parts of the run"
    heading: ClassVar[str] = ""  # of the picture
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
        """See Result: the parts of the run."""
        parts = zip(self.quantities, self.parts.T, strict=True)
        of_parts = [Series(quantity.name, quantity.unit, part) for quantity, part in parts]
        return [Series("time", self.units.time, self.times), *of_parts]

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [(self.title, f"mean of {self.scene.frames(self.n_frames)}")]
        for (_, symbol, unit), value, error in zip(
            self.quantities, self.values, self.errors, strict=True
        ):
            rows.append(("", f"{symbol} = {with_error(value, error)} {unit}".rstrip()))
        if np.isfinite(self.lengths).any():
            k = int(np.nanargmin(self.lengths))
            of = self.correlated or self.quantities[k].symbol
            short = short_run(float(self.lengths[k]), of, self.enough)
            rows += [("", short)] if short else []
        return rows

    def draw(self, panel: Axes) -> None:
        """See Result: the quantities that have the unit of the first one, and its mean."""
        unit = self.quantities[0].unit
        curves = [curve for curve in self.series()[1:] if curve.unit == unit]
        symbol = f"{self.quantities[0].symbol}, " if len(curves) == 1 else ""
        panel.axhline(self.values[0], color="0.6", lw=0.8, ls="--")
        label = f"{symbol}{self.of_parts}  [{unit}]".replace("  []", "")
        self.draw_curves(panel, curves, "t", label)
        if self.heading:
            panel.set_title(f"{self.heading}, {self.scene.frames(self.n_frames)}")


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
