"""The autocorrelation of the stress, and the shear viscosity that follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Rows
from minimd.engine.engine import Engine
from minimd.engine.observation import Look, check_has_volume
from minimd.observers.accumulator import ObservedRun, Result, Series
from minimd.observers.correlator import MultipleTau, Product
from minimd.observers.time_correlation import HEAD, TEMPERATURE, VOLUME, Plateau, TimeCorrelation
from minimd.structure.checks import checked_count
from minimd.structure.statistics import with_error
from minimd.structure.units import BAR, PICOSECOND

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
POINTS = 32  # entries on each level of the correlator: averages are over at most a sixteenth of a lag
WEIGHT = 10.0  # divisor of the sum over all components of a symmetric tensor without trace
MPA_S = 1e-4 / (BAR * PICOSECOND)  # per eV/Å³ Å √(u/eV): a bar times a picosecond is 1e-4 mPa s


class Viscosity(TimeCorrelation):
    """Shear viscosity by Green and Kubo, from all components of the stress without its trace,
    by a multiple-tau correlator that averages.

        C(t) = Σ_ab ⟨P_ab(0) P_ab(t)⟩ / 10,   P = −(σ + σᵀ)/2 + tr σ / 3
        η = V / (k_B T) ∫ C(t) dt

    Each look evaluates the virial with the forces of its step. The time between looks must be short compared with the
    time in which the stress changes: about 20 fs, or 0.02 τ. A bath that acts on each atom, such as Langevin's,
    changes the viscosity.

    P. J. Daivis, D. J. Evans, J. Chem. Phys. 100, 541 (1994), on all components.

    Parameters
    ----------
    every : steps between two looks.  n_levels : k, largest number of levels of the correlator:
        the longest lag is 31 · 2ᵏ⁻¹ · every steps.
    name : its name in files, "viscosity" if not given.

    Raises
    ------
    ValueError : for arguments out of range; when a run begins, for a cell without a volume.
    """

    kind = "viscosity"
    arguments = ("every", "n_levels")
    needs_energy = True

    def __init__(self, every: int = 5, n_levels: int = 10, name: str = "") -> None:
        super().__init__(every, name)
        self.n_levels = checked_count("n_levels", n_levels, 1, 40)

    def _begin(self, engine: Engine) -> None:
        check_has_volume(engine)

    def _laid_out(self, scene: ObservedRun) -> None:
        self._correlate_by(MultipleTau(Product(), np.array([0, 1]), 6, POINTS, self.n_levels, averages=True))

    def _look(self, engine: Engine) -> None:
        engine.evaluate()
        look = Look(engine)
        self._add(look, traceless(-look.stress)[:, None])

    def result(self) -> ViscosityResult:
        """η so far, with its standard error.  Raises ValueError before the first look."""
        scene = self.answered()
        seen, times, longest = self._seen()
        k_B = scene.unit_system.k_B

        def correlation(sums: Array) -> Array:
            found: Array = self._correlator.correlations(sums[HEAD:])[1][seen, 0].sum(axis=1) / WEIGHT
            return found

        def integrand(sums: Array) -> Array:
            return correlation(sums) * (sums[VOLUME] / (k_B * sums[TEMPERATURE]))  # both are sums over the same looks

        values, errors, found = self._integral(times, longest, integrand)
        return ViscosityResult(scene, times, *self._estimate(times, longest, correlation), values, errors, found)


def traceless(tensor: Array) -> Array:
    """(6,) numbers whose squares add up to Σ_ab P_ab², with P the symmetric part of a tensor (3, 3)
    without its trace."""
    p = 0.5 * (tensor + tensor.T) - np.eye(3) * np.trace(tensor) / 3.0
    root = np.sqrt(2.0)
    return np.array([p[0, 0], p[1, 1], p[2, 2], root * p[1, 2], root * p[0, 2], root * p[0, 1]])


@dataclass(frozen=True, repr=False)
class ViscosityResult(Result):
    """A stress autocorrelation, its integral, and the viscosity.

    times : (T,) lags [time].  autocorrelation, autocorrelation_error : C, (T,) [pressure²].
    integral, integral_error : V/(k_B T) ∫₀ᵗ C, (T,) [pressure time].  plateau : of the integral, with η.
    """

    scene: ObservedRun
    times: Array
    autocorrelation: Array
    autocorrelation_error: Array
    integral: Array
    integral_error: Array
    plateau: Plateau
    title: ClassVar[str] = "viscosity"
    coefficients: ClassVar[tuple[str, ...]] = ("viscosity", "viscosity_error")

    @property
    def viscosity(self) -> float:
        """η [pressure time]."""
        return self.plateau.value

    @property
    def viscosity_error(self) -> float:
        """Its standard error."""
        return self.plateau.error

    def series(self) -> Series:
        """See Result."""
        autocorrelation = ("autocorrelation", self.autocorrelation, self.autocorrelation_error)
        return [("time", self.times, None), autocorrelation, ("integral", self.integral, self.integral_error)]

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.scene.unit_system
        words = f"{with_error(self.viscosity, self.viscosity_error)} {units.pressure} {units.time}"
        if units.name == "ASE":
            words = f"{with_error(self.viscosity * MPA_S, self.viscosity_error * MPA_S)} mPa s"
        return [("viscosity", f"η = {words}; {self.plateau.said(units)}")]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        units, (start, end) = self.scene.unit_system, self.plateau.window
        times = self.times * units.to_picosecond
        panel.axvspan(start * units.to_picosecond, end * units.to_picosecond, color="0.93")
        panel.axhline(self.viscosity, color="0.6", lw=0.8, ls="--")
        panel.errorbar(times, self.integral, self.integral_error, lw=1.1, elinewidth=0.6)
        panel.set(
            xlabel=f"t  [{units.shown_time}]",
            ylabel=f"η  [{units.pressure} {units.time}]",
            title="viscosity, running integral",
        )
        panel.set(
            xlim=(0.0, 2.0 * end * units.to_picosecond or None),
            ylim=(0.0, 2.0 * self.viscosity if self.viscosity > 0.0 else None),
        )
