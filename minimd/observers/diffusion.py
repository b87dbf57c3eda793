"""Self-diffusion: the slope of a mean-square displacement, the correction for the size of a periodic cell,
and the results of the observers of the motion of atoms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Rows
from minimd.observers.accumulator import Result, Series
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

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T), of all atoms, of those of each species, and along x, y, z.
    """

    times: Array
    means: Array
    errors: Array
    symbol: ClassVar[str]  # name of the series
    coefficients = ("diffusion", "diffusion_error")

    @property
    def unit(self) -> str:
        """The unit of the means."""
        return f"{self.units.length}²"

    def series(self) -> list[Series]:
        """See Result: means over all atoms, over each species if there are several, and along each direction."""
        names = ["", *(f"_{label}" for label in (*self.scene.species, *AXES))]
        rows = zip(names, self.means, self.errors, strict=True)
        found = [Series(self.symbol + name, self.unit, *row) for name, *row in rows]
        if len(self.scene.species) == 1:
            del found[1]  # the same as of all atoms
        return [Series("time", self.units.time, self.times), *found]


@dataclass(frozen=True, repr=False)
class DisplacementResult(MotionResult):
    """A mean-square displacement, and the self-diffusion that follows from it.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T) [length²], of all atoms, of those of each species, and along x, y, z.
    diffusion, diffusion_error : D in this cell [length²/time]; NaN if the window holds too few lags.
        diffusion_of_species : D of each, (S,).
    infinite, infinite_error : D of an infinite system by Yeh and Hummer; NaN without a viscosity.
    window : of the straight line [time].  temperature, volume : means.
    n_atoms : number of atoms whose displacements were measured.
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
    title = "mean-square displacement"
    symbol = "msd"

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
        spacing = (self.volume / self.scene.n_atoms) ** (1.0 / 3.0)
        start, end = window or (0.1 * longest, longest if np.isnan(spacing) else 0.0)
        has_left = self.msd > (LEFT * spacing) ** 2  # False for all lags without a volume
        if window is None and has_left.any():
            start = float(self.times[np.argmax(has_left)])
            end = min(DECADE * start, longest)
        inside = (self.times >= start) & (self.times <= end) & (self.times > 0.0)
        if inside.sum() < 3:
            if window is None:
                return self
            held = f"({start:.4g}, {end:.4g}) holds {inside.sum()} of {len(self.times)}"
            raise ValueError(f"the window of the fit must hold at least 3 lags; {held}")
        times, n = self.times[inside], 1 + len(self.scene.species)
        coefficients = slope(times, self.means[:n, inside]) / 6.0
        error = float(spread(slope(times, without[:, 0, inside]) / 6.0)) if len(without) else np.nan
        found, *of_species = coefficients.tolist()
        ends, infinite = (float(times[0]), float(times[-1])), np.nan
        if viscosity is not None:
            if not self.is_cubic:
                needs = "needs a cubic cell that is periodic in all directions; leave viscosity out"
                raise ValueError(f"the correction of Yeh and Hummer {needs}")
            thermal_energy, edge = self.units.k_B * self.temperature, self.volume ** (1.0 / 3.0)
            infinite = found + finite_size_correction(thermal_energy, viscosity, edge)
        made = {"diffusion": found, "diffusion_error": error, "diffusion_of_species": tuple(of_species)}
        return replace(self, **made, window=ends, infinite=infinite)

    def numbers(self) -> dict[str, float]:
        """See Result."""
        return {**super().numbers(), "diffusion_infinite": self.infinite}

    def display_rows(self) -> Rows:
        """See Displayed."""
        units, (start, end) = self.units, self.window
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
        (times, unit), later = self.abscissa(), self.times > 0.0
        panel.loglog(times[later], self.msd[later], marker="o", ms=2.5, lw=1.0)
        if np.isfinite(self.diffusion):
            line = 6.0 * self.diffusion * self.times[later]
            panel.loglog(times[later], line, color="0.6", lw=0.8, ls="--", label="6 D t")
            panel.legend(frameon=False, fontsize=8)
        panel.set(xlabel=f"t  [{unit}]", ylabel=f"⟨|r(t) − r(0)|²⟩  [{self.unit}]", title=self.title)


@dataclass(frozen=True, repr=False)
class VelocityResult(MotionResult):
    """A velocity autocorrelation, its integral, and the self-diffusion that follows from it.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T) [length²/time²], of all atoms, of those of each species, and along x, y, z.
    integral, integral_error : (T,) ⅓ ∫₀ᵗ ⟨v · v⟩ [length²/time].  plateau : of the integral.
    n_atoms : number of atoms that were observed.
    """

    integral: Array
    integral_error: Array
    plateau: Plateau
    n_atoms: int
    title = "velocity autocorrelation"
    symbol = "vacf"

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

    @property
    def unit(self) -> str:
        """The unit of the means."""
        return f"{self.units.length}²/({self.units.time})²"

    def series(self) -> list[Series]:
        """See Result."""
        unit = f"{self.units.length}²/{self.units.time}"
        return [*super().series(), Series("integral", unit, self.integral, self.integral_error)]

    def display_rows(self) -> Rows:
        """See Displayed."""
        words = diffusion_words(self.diffusion, self.diffusion_error, self.units)
        return [("velocities", f"D = {words}, in this cell; {self.plateau.said(self.units)}")]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        panel.axhline(0.0, color="0.7", lw=0.8)
        self.draw_curves(panel, {"": self.vacf / self.vacf[0]}, "t", "⟨v(0) · v(t)⟩ / ⟨v²⟩")
        last = max(self.plateau.window[1], float(self.times[min(15, len(self.times) - 1)]))
        panel.set(xlim=(0.0, last * self.units.to_picosecond or None))
