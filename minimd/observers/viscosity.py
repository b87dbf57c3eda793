"""The autocorrelation of the stress, and the shear viscosity that follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look, check_has_volume
from minimd.core.structure.arrays import Array
from minimd.core.structure.statistics import with_error
from minimd.core.structure.units import MPA_S
from minimd.observers.accumulator import ObservedRun, Result, Series
from minimd.observers.arguments import argument, label, levels, steps
from minimd.observers.correlator import MultipleTau, Product
from minimd.observers.time_correlation import (
    HEAD,
    LEVELS,
    TEMPERATURE,
    VOLUME,
    Plateau,
    TimeCorrelation,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ENOUGH = 100.0  # times the start of the plateau: a shorter run knows its error bar badly
# entries on each level of the correlator: averages are over at most a sixteenth of a lag
POINTS = 32
WEIGHT = 10.0  # divisor of the sum over all components of a symmetric tensor without trace


class Viscosity(TimeCorrelation):
    """Shear viscosity by Green and Kubo, from all components of the stress without its trace, by a multiple-tau
    correlator that averages.

        C(t) = Σ_ab ⟨P_ab(0) P_ab(t)⟩ / 10,   P = −(σ + σᵀ)/2 + tr σ / 3
        η = V / (k_B T) ∫ C(t) dt

    Each look evaluates the virial with the forces of its step. The time between looks must be short compared with the
    time in which the stress changes: about 20 fs, or 0.02 τ. A bath that acts on each atom, such as Langevin's,
    changes the viscosity. The longest lag is 31 · 2ᵏ⁻¹ · every steps, for k levels.

    P. J. Daivis, D. J. Evans, J. Chem. Phys. 100, 541 (1994), on all components.

    Raises ValueError for arguments out of range; when a run begins, for a cell without a volume.
    """

    kind = "viscosity"
    needs_energy = True
    every: int = steps(5)
    n_levels: int = argument(levels, LEVELS, 10)
    name: str = label()

    def _begin(self, engine: Engine) -> None:
        check_has_volume(engine)

    def _laid_out(self, scene: ObservedRun) -> None:
        starts = np.array([0, 1])
        self._correlate_by(MultipleTau(Product(), starts, 6, POINTS, self.n_levels, averages=True))

    def _look(self, engine: Engine) -> None:
        engine.evaluate()
        look = Look(engine)
        self._add(look, traceless(-look.stress)[:, None])

    def result(self) -> ViscosityResult:
        """η so far, with its standard error.
        Raises ValueError before the first look."""
        scene = self.answered()
        seen, times, longest = self._seen()
        k_B = scene.unit_system.k_B

        def correlation(sums: Array) -> Array:
            products = self._correlator.correlations(sums[HEAD:])[1][seen, 0]
            return np.asarray(products.sum(axis=1) / WEIGHT)

        def integrand(sums: Array) -> Array:
            # both are sums over the same looks
            return correlation(sums) * (sums[VOLUME] / (k_B * sums[TEMPERATURE]))

        integral, error, plateau = self._integral(times, longest, integrand)
        correlations = self._estimate(times, longest, correlation)
        duration = self.n_looks * scene.spacing
        return ViscosityResult(scene, times, *correlations, integral, error, plateau, duration)


def traceless(tensor: Array) -> Array:
    """(6,) numbers whose squares add up to Σ_ab P_ab², P being the symmetric part of a tensor (3, 3) without trace."""
    p = 0.5 * (tensor + tensor.T) - np.eye(3) * np.trace(tensor) / 3.0
    root = np.sqrt(2.0)
    return np.array([p[0, 0], p[1, 1], p[2, 2], root * p[1, 2], root * p[0, 2], root * p[0, 1]])


@dataclass(frozen=True, repr=False)
class ViscosityResult(Result):
    """A stress autocorrelation, its integral, and the viscosity.

    times : (T,) lags [time].
    autocorrelation, autocorrelation_error : C, (T,) [pressure²].
    integral, integral_error : V/(k_B T) ∫₀ᵗ C, (T,) [pressure time].
    plateau : of the integral, with η.
    duration : of the run [time].
    """

    times: Array
    autocorrelation: Array
    autocorrelation_error: Array
    integral: Array
    integral_error: Array
    plateau: Plateau
    duration: float
    title = "viscosity"
    coefficients = ("viscosity", "viscosity_error")

    @property
    def viscosity(self) -> float:
        """η [pressure time]."""
        return self.plateau.value

    @property
    def viscosity_error(self) -> float:
        """Its standard error."""
        return self.plateau.error

    @property
    def shown(self) -> tuple[float, str]:
        """The factor and the unit in which η is shown."""
        units = self.units
        return (
            (1.0 / MPA_S, "mPa s")
            if units.name == "ASE"
            else (1.0, f"{units.pressure} {units.time}")
        )

    def series(self) -> list[Series]:
        """See Result."""
        units = self.units
        correlation = (self.autocorrelation, self.autocorrelation_error)
        integral = (self.integral, self.integral_error)
        return [
            Series("time", units.time, self.times),
            Series("autocorrelation", f"({units.pressure})²", *correlation),
            Series("integral", f"{units.pressure} {units.time}", *integral),
        ]

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        factor, unit = self.shown
        viscosity = with_error(self.viscosity * factor, self.viscosity_error * factor)
        rows = [("viscosity", f"η = {viscosity} {unit}; {self.plateau.said(units)}")]
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
        viscosity = factor * self.viscosity
        start, end = np.array(self.plateau.window) * self.units.to_picosecond
        panel.axvspan(start, end, color="0.93")
        panel.axhline(viscosity, color="0.6", lw=0.8, ls="--")
        bars = factor * self.integral_error
        panel.errorbar(times, factor * self.integral, bars, lw=1.1, elinewidth=0.6)
        panel.set(
            xlabel=f"t  [{time}]",
            ylabel=f"η  [{unit}]",
            title=f"{self.title}, running integral",
            xlim=(0.0, 2.0 * end or None),
            ylim=(0.0, 2.0 * viscosity if viscosity > 0.0 else None),
        )
