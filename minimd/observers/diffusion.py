"""Self-diffusion: the slope of a mean-square displacement, the correction for the size of a periodic cell,
and the results of the observers of the motion of atoms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Rows
from minimd.observers.accumulator import ObservedRun, Result, Series
from minimd.observers.time_correlation import Plateau
from minimd.structure.cell import Cell
from minimd.structure.statistics import spread, with_error
from minimd.structure.units import UnitSystem

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
XI = 2.837297  # ξ of a cubic cell
CUBIC = 1e-9  # largest relative deviation of the squares and products of lattice vectors from those of a cube
DECADE = 10.0  # the window of a fit ends at this multiple of its start
LEFT = 0.5  # of the distance of neighbors: an atom that has moved by more has left its place
CM2_PER_S = 1e-4  # per Å²/ps
AXES = ("x", "y", "z")


def is_cubic(cell: Cell) -> bool:
    """Whether a cell is a cube that is periodic in all directions."""
    square = cell.vectors @ cell.vectors.T
    return bool(cell.pbc.all() and np.abs(square - np.eye(3) * square[0, 0]).max() < CUBIC * square[0, 0])


def slope(times: Array, squares: Array) -> Array:
    """Slopes of straight lines through mean squares (..., T) at times (T,), each point weighted by 1/t,
    because its error grows as t."""
    weights = 1.0 / times
    weights = weights**2 / (weights**2).sum()
    t = times - weights @ times
    found: Array = (squares * (weights * t)).sum(axis=-1) / (weights * t * t).sum()
    return found


def finite_size_correction(thermal_energy: float, viscosity: float, edge: float) -> float:
    """The correction that is added to D in a cubic periodic cell to get D of an infinite system [length²/time].

        D∞ = D + ξ k_B T / (6π η L),   ξ = 2.837297

    thermal_energy : k_B T [energy].  viscosity : η [energy time/length³].  edge : L [length].
    I.-C. Yeh, G. Hummer, J. Phys. Chem. B 108, 15873 (2004); B. Dünweg, K. Kremer, J. Chem. Phys. 99, 6983 (1993).
    """
    return XI * thermal_energy / (6.0 * np.pi * viscosity * edge)


def diffusion_words(coefficient: float, error: float, units: UnitSystem) -> str:
    """D in words, in Å²/ps and cm²/s, or in reduced units."""
    if units.name != "ASE":
        return f"{with_error(coefficient, error)} {units.length}²/{units.time}"
    per_ps = 1.0 / units.to_picosecond
    mean, uncertain = coefficient * per_ps, error * per_ps
    return f"{with_error(mean, uncertain)} Å²/ps = {mean * CM2_PER_S:.4g} cm²/s"


@dataclass(frozen=True, repr=False)
class MotionResult(Result):
    """Means over atoms as functions of the lag.

    times : (T,) lags [time].  means, errors : (1 + S + 3, T), of all atoms, of those of each species,
        and along x, y, z.
    """

    scene: ObservedRun
    times: Array
    means: Array
    errors: Array
    symbol: ClassVar[str]  # name of the series
    coefficients: ClassVar[tuple[str, ...]] = ("diffusion", "diffusion_error")

    def series(self) -> Series:
        """See Result: means over all atoms, over each species if there are several, and along each direction."""
        names = [self.symbol, *(f"{self.symbol}_{label}" for label in (*self.scene.species, *AXES))]
        found = list(zip(names, self.means, self.errors, strict=True))
        if len(self.scene.species) == 1:
            del found[1]  # the same as of all atoms
        return [("time", self.times, None), *found]


@dataclass(frozen=True, repr=False)
class DisplacementResult(MotionResult):
    """A mean-square displacement, and the self-diffusion that follows from it.

    times : (T,) lags [time].  means, errors : (1 + S + 3, T) [length²], of all atoms, of those of each species,
        and along x, y, z.
    diffusion, diffusion_error : D in this cell [length²/time]; NaN if the window holds too few lags.
        diffusion_of_species : D of each, (S,).
    infinite, infinite_error : D of an infinite system by Yeh and Hummer; NaN without a viscosity.
    window : of the straight line [time].  temperature, volume : means.  n_atoms :
        number of atoms whose displacements were measured.
    """

    is_cubic: bool
    temperature: float
    volume: float
    n_atoms: int
    diffusion: float = np.nan
    diffusion_error: float = np.nan
    diffusion_of_species: tuple[float, ...] = ()
    infinite: float = np.nan
    window: tuple[float, float] = (np.nan, np.nan)
    title: ClassVar[str] = "mean-square displacement"
    symbol: ClassVar[str] = "msd"

    @property
    def msd(self) -> Array:
        """(T,) [length²], of all atoms."""
        found: Array = self.means[0]
        return found

    @property
    def infinite_error(self) -> float:
        """Standard error of infinite; it does not include the error of the viscosity."""
        return self.diffusion_error if np.isfinite(self.infinite) else np.nan

    def fitted(
        self, without: Array, window: tuple[float, float] | None, longest: float, viscosity: float | None
    ) -> DisplacementResult:
        """This result with D.  without : (K, 1 + S + 3, T) replicas of the means.  longest : last lag for a fit [time].
        Raises ValueError."""
        start, end = window or self._own_window(longest)
        inside = (self.times >= start) & (self.times <= end) & (self.times > 0.0)
        if inside.sum() < 3:
            if window is not None:
                raise ValueError(
                    f"the window of the fit must hold at least 3 lags; ({start:.4g}, {end:.4g}) holds {inside.sum()} "
                    f"of {len(self.times)}"
                )
            return self
        times, n = self.times[inside], 1 + len(self.scene.species)
        coefficients = slope(times, self.means[:n, inside]) / 6.0
        error = float(spread(slope(times, without[:, 0, inside]) / 6.0)) if len(without) else np.nan
        made = replace(
            self,
            diffusion=float(coefficients[0]),
            diffusion_error=error,
            diffusion_of_species=tuple(coefficients[1:].tolist()),
            window=(float(times[0]), float(times[-1])),
        )
        return made if viscosity is None else replace(made, infinite=made.diffusion + self._correction(viscosity))

    def _own_window(self, longest: float) -> tuple[float, float]:
        spacing = (self.volume / self.scene.n_atoms) ** (1.0 / 3.0)
        has_left = self.msd > (LEFT * spacing) ** 2  # False for all lags without a volume
        if not has_left.any():
            return 0.1 * longest, longest if np.isnan(spacing) else 0.0
        start = float(self.times[np.argmax(has_left)])
        return start, min(DECADE * start, longest)

    def _correction(self, viscosity: float) -> float:
        if not self.is_cubic:
            raise ValueError(
                "the correction of Yeh and Hummer needs a cubic cell that is periodic in all directions; leave "
                "viscosity out"
            )
        return finite_size_correction(
            self.scene.unit_system.k_B * self.temperature, viscosity, self.volume ** (1.0 / 3.0)
        )

    def numbers(self) -> dict[str, float]:
        """See Result."""
        return {**super().numbers(), "diffusion_infinite": self.infinite}

    def display_rows(self) -> Rows:
        """See Displayed."""
        units, (start, end) = self.scene.unit_system, self.window
        if np.isnan(self.diffusion):
            said = f"unknown: the atoms have not left their places in lags up to {units.shown(self.times[-1])}"
            return [("diffusion", said)]
        words = diffusion_words(self.diffusion, self.diffusion_error, units)
        rows = [("diffusion", f"D = {words}, from lags of {units.shown(start)} to {units.shown(end)}, in this cell")]
        if np.isfinite(self.infinite):
            words = diffusion_words(self.infinite, self.infinite_error, units)
            rows.append(("", f"D = {words} in an infinite cell (Yeh and Hummer)"))
        elif self.is_cubic:
            rows.append(("", "in a larger cell D is larger: result(viscosity=...) corrects for this"))
        return rows

    def draw(self, panel: Axes) -> None:
        """See Result."""
        units, positive = self.scene.unit_system, self.times > 0.0
        times = self.times[positive] * units.to_picosecond
        panel.loglog(times, self.msd[positive], marker="o", ms=2.5, lw=1.0)
        if np.isfinite(self.diffusion):
            panel.loglog(
                times, 6.0 * self.diffusion * self.times[positive], color="0.6", lw=0.8, ls="--", label="6 D t"
            )
            panel.legend(frameon=False, fontsize=8)
        panel.set(
            xlabel=f"t  [{units.shown_time}]",
            ylabel=f"⟨|r(t) − r(0)|²⟩  [{units.length}²]",
            title="mean-square displacement",
        )


@dataclass(frozen=True, repr=False)
class VelocityResult(MotionResult):
    """A velocity autocorrelation, its integral, and the self-diffusion that follows from it.

    times : (T,) lags [time].  means, errors : (1 + S + 3, T) [length²/time²], of all atoms, of those of each species,
        and along x, y, z.
    integral, integral_error : (T,) ⅓ ∫₀ᵗ ⟨v · v⟩ [length²/time].  plateau : of the integral.  n_atoms :
        number of atoms that were observed.
    """

    integral: Array
    integral_error: Array
    plateau: Plateau
    n_atoms: int
    title: ClassVar[str] = "velocity autocorrelation"
    symbol: ClassVar[str] = "vacf"

    @property
    def vacf(self) -> Array:
        """(T,) [length²/time²], of all atoms."""
        found: Array = self.means[0]
        return found

    @property
    def diffusion(self) -> float:
        """D in this cell [length²/time]."""
        return self.plateau.value

    @property
    def diffusion_error(self) -> float:
        """Its standard error."""
        return self.plateau.error

    def series(self) -> Series:
        """See Result."""
        return [*super().series(), ("integral", self.integral, self.integral_error)]

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.scene.unit_system
        words = diffusion_words(self.diffusion, self.diffusion_error, units)
        return [("velocities", f"D = {words}, in this cell; {self.plateau.said(units)}")]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        units = self.scene.unit_system
        panel.axhline(0.0, color="0.7", lw=0.8)
        panel.plot(self.times * units.to_picosecond, self.vacf / self.vacf[0], lw=1.1)
        last = max(self.plateau.window[1], float(self.times[min(15, len(self.times) - 1)])) * units.to_picosecond
        panel.set(
            xlabel=f"t  [{units.shown_time}]",
            ylabel="⟨v(0) · v(t)⟩ / ⟨v²⟩",
            xlim=(0.0, last or None),
            title="velocity autocorrelation",
        )
