"""Heat capacity, compressibility and expansion from the fluctuations of energy and volume."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look
from minimd.core.structure.arrays import Array
from minimd.core.structure.observables import temperature
from minimd.core.structure.statistics import (
    FEWEST,
    correlation_times,
    short_run,
    standard_error,
    with_error,
)
from minimd.observers.accumulator import Accumulator, BlockedSums, ObservedRun
from minimd.observers.arguments import label, steps
from minimd.observers.means import MeansResult, Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

N_SERIES = 3  # K, U, V
KINETIC, ENERGY, VOLUME = range(N_SERIES)
# K, E and V, as weights of K, U, V
OF_INTEREST = ((1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# of the error of the jackknife: the least error; not all of it, because it scatters more than the other estimate
JACKKNIFE = 0.7
ENOUGH = 100.0  # correlation times; the error bar of a shorter run is itself too uncertain
C_V, C_P = 1, 2  # places in the values


class Fluctuations(Accumulator):
    """Heat capacity, compressibility and expansion from fluctuations, by the formulas of the ensemble of the run.

        constant energy        C_V = (f k_B/2) / (1 − 2 ⟨δK²⟩ / (f k_B² T²))
        constant temperature   C_V = ⟨δE²⟩ / (k_B T²)
        constant pressure      C_P = ⟨δH²⟩ / (k_B T²),  κ_T = ⟨δV²⟩ / (k_B T V), α_P = ⟨δV δH⟩ / (k_B T² V), H = E + PV

    f is the number of degrees of freedom in K, which is thermal; T and P are those of the bath, and without a bath T is
    the mean temperature. The compressibility needs a volume that fluctuates.

    The variance of a run of n_c correlation times is too small by that of its mean, the part 2/n_c, which is added. The
    standard error is the change of the coefficient if all variances grow by a factor e^√(2/n_c), where √(2/n_c) is the
    relative standard error of the variance of a series with correlations e^(−t/τ); or 0.7 of the jackknife's, if that
    is more, as where correlations oscillate. The jackknife alone gives too small an error to runs whose variance is too
    small by chance. A run cannot tell that it is shorter than 30 correlation times; n_c is 30 then.

    J. L. Lebowitz, J. K. Percus, L. Verlet, Phys. Rev. 153, 250 (1967), on constant energy; M. P. Allen, D. J.
    Tildesley, Computer Simulation of Liquids, 2nd ed. (2017), section 2.5.
    """

    kind = "fluctuations"
    fits_plane = True
    needs_energy = True
    convention = 2  # thermal energy, not kinetic energy
    every: int = steps(20)
    name: str = label()
    reference: list[float] = field(init=False, default_factory=list)  # the first K, U, V

    def _laid_out(self, scene: ObservedRun) -> None:
        # number of looks, sums, sums of products
        self.sums = BlockedSums(1 + N_SERIES + N_SERIES**2)

    def _look(self, engine: Engine) -> None:
        engine.evaluate()
        look = Look(engine)
        now = [look.thermal_energy, look.potential_energy, engine.system.volume or 0.0]
        # sums are over differences from the reference, which are small
        self.reference = self.reference or now
        change = np.array(now) - self.reference
        self.sums.total += np.concatenate([[1.0], change, np.outer(change, change).ravel()])

    def result(self) -> FluctuationResult:
        """The coefficients so far, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()
        reference = np.array(self.reference)
        times = lengths(self.sums)
        missing = 2.0 / np.fmax(FEWEST, np.nan_to_num(times, nan=np.inf))
        grown = 1.0 + missing

        def law(sums: Array) -> Array:
            return _coefficients(sums, reference, scene, grown)

        values, errors = self.sums.estimate(law)
        wider = _coefficients(self.sums.total, reference, scene, grown * np.exp(missing**0.5))
        least = np.maximum(JACKKNIFE * errors, np.abs(wider - values))
        errors = np.where(wider == values, errors, least)
        ensemble = "constant energy"
        fluctuating = [KINETIC]
        if scene.bath_temperature is not None:
            ensemble = "constant temperature"
            fluctuating = [ENERGY, VOLUME]
        # the volume is not constant
        if self.sums.total[1 + VOLUME] != 0.0 or self.sums.total[-1] != 0.0:
            ensemble = "constant pressure"
        length = float(np.fmin.reduce(times[fluctuating]))
        units = scene.unit_system
        heat = f"{units.energy}/{units.temperature}"
        quantities = [
            Quantity("temperature", "T", units.temperature),
            Quantity("heat_capacity_v", "C_V", heat),
            Quantity("heat_capacity_p", "C_P", heat),
            Quantity("compressibility", "κ_T", f"{units.volume}/{units.energy}"),
            Quantity("expansion", "α_P", f"1/{units.temperature}"),
        ]
        running = self._history(law, self.sums.until())
        return FluctuationResult(
            scene, quantities, values, errors, *running, self.n_looks, np.array([length]), ensemble
        )


def moments(sums: Array) -> tuple[Array, Array]:
    """Means, (3,), and covariances, (3, 3), of K, U and V, relative to the reference."""
    means = sums[1 : 1 + N_SERIES] / sums[0]
    products = sums[1 + N_SERIES :].reshape(N_SERIES, N_SERIES) / sums[0]
    return means, products - np.outer(means, means)


def lengths(sums: BlockedSums) -> Array:
    """The length of a run in correlation times of K, E and V, (3,); NaN if there are too few blocks, or if the series
    is constant."""
    parts = sums.parts()
    weights = np.array(OF_INTEREST)
    _, covariance = moments(sums.total)
    errors = standard_error(parts[:, 1 : 1 + N_SERIES] @ weights.T / parts[:, :1])
    return correlation_times(np.diag(weights @ covariance @ weights.T), errors)


def _coefficients(sums: Array, reference: Array, scene: ObservedRun, grown: Array) -> Array:
    """T, C_V, C_P, κ_T, α_P; NaN for those that do not follow from the ensemble.
    grown : (3,) factors for the variances of K, E and V."""
    means, covariance = moments(sums)
    weights = np.array(OF_INTEREST) * np.sqrt(grown)[:, None]
    covariance = weights @ covariance @ weights.T
    means = means + reference
    k_B = scene.unit_system.k_B
    f = scene.n_dof
    mean_temperature = temperature(means[KINETIC], f, k_B)
    bath = scene.bath_temperature
    pressure = scene.bath_pressure
    T = mean_temperature if bath is None else bath  # noqa: N806
    c_v = c_p = compressibility = expansion = np.nan
    if covariance[VOLUME, VOLUME] > 0.0:
        enthalpy = np.array([0.0, 1.0, np.nan if pressure is None else pressure])
        c_p = enthalpy @ covariance @ enthalpy / (k_B * T**2)
        compressibility = covariance[VOLUME, VOLUME] / (k_B * T * means[VOLUME])
        expansion = enthalpy @ covariance[:, VOLUME] / (k_B * T**2 * means[VOLUME])
    elif bath is None:
        c_v = 0.5 * f * k_B / (1.0 - 2.0 * covariance[KINETIC, KINETIC] / (f * k_B**2 * T**2))
    else:
        c_v = covariance[ENERGY, ENERGY] / (k_B * T**2)

    return np.array([mean_temperature, c_v, c_p, compressibility, expansion])


@dataclass(frozen=True, repr=False)
class FluctuationResult(MeansResult):
    """Coefficients from fluctuations, see MeansResult; parts are their values up to the times.

    values, errors : (5,) mean temperature, C_V and C_P of the whole system [energy/temperature], κ_T [length³/energy],
        α_P [1/temperature], and their standard errors; NaN for those that do not follow from the ensemble. Printed and
        drawn are the heat capacities per atom, C/(N k_B).
    ensemble : in words.
    """

    ensemble: str
    title = "fluctuations"
    of_parts = "running value"

    @property
    def _per_atom(self) -> float:
        """k_B of all atoms [energy/temperature]."""
        return self.scene.n_atoms * self.units.k_B

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        temperature = f"{with_error(self.temperature, self.temperature_error)} {units.temperature}"
        frames = f"at {self.ensemble}, {self.scene.frames(self.n_frames)}, T = {temperature}"
        rows = [(self.title, frames)]

        for k in range(C_V, len(self.quantities)):
            _, symbol, unit = self.quantities[k]
            size = 1.0
            if k in (C_V, C_P):
                size = self._per_atom
                unit = "k_B per atom"
            if np.isfinite(self.values[k]):
                value = with_error(self.values[k] / size, self.errors[k] / size)
                rows.append(("", f"{symbol} = {value} {unit}"))

        slowest = "volume or energy" if np.isfinite(self.compressibility) else "energy"
        short = short_run(self.correlation_times, slowest, ENOUGH)
        return [*rows, ("", short)] if short else rows

    def draw(self, panel: Axes) -> None:
        """See Result: the heat capacity."""
        drawn = C_V if np.isfinite(self.values[C_V]) else C_P
        self.draw_quantities(panel, [drawn], "k_B per atom", self._per_atom)
