"""The autocorrelation of the stress, and the shear viscosity that follows from it."""

from __future__ import annotations

import numpy as np

from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look, check_has_volume
from minimd.core.structure.arrays import Array
from minimd.core.structure.units import MPA_S
from minimd.observers.accumulator import ObservedRun
from minimd.observers.arguments import argument, label, levels, steps
from minimd.observers.correlator import MultipleTau, Product
from minimd.observers.time_correlation import (
    HEAD,
    LEVELS,
    POINTS,
    TEMPERATURE,
    VOLUME,
    IntegralResult,
    TimeCorrelation,
    running_integral,
)

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

        def integral(sums: Array) -> Array:
            # both are sums over the same looks
            weight = sums[VOLUME] / (k_B * sums[TEMPERATURE])
            return weight * running_integral(times, correlation(sums))

        series = self._series(times, longest, correlation, integral)
        return ViscosityResult(scene, times, *series)


def traceless(tensor: Array) -> Array:
    """(6,) numbers whose squares add up to Σ_ab P_ab², P being the symmetric part of a tensor (3, 3) without trace."""
    p = 0.5 * (tensor + tensor.T) - np.eye(3) * np.trace(tensor) / 3.0
    root = np.sqrt(2.0)
    return np.array([p[0, 0], p[1, 1], p[2, 2], root * p[1, 2], root * p[0, 2], root * p[0, 1]])


class ViscosityResult(IntegralResult):
    """A shear viscosity, viscosity, see IntegralResult; the autocorrelation is C [pressure²]."""

    title = "viscosity"
    symbol = "η"
    in_si = (1.0 / MPA_S, "mPa s")
    coefficients = ("viscosity", "viscosity_error")

    @property
    def square(self) -> str:
        """See IntegralResult."""
        return f"({self.units.pressure})²"

    @property
    def unit(self) -> str:
        """See IntegralResult."""
        return f"{self.units.pressure} {self.units.time}"

    @property
    def viscosity(self) -> float:
        """η [pressure time]."""
        return self.plateau.value

    @property
    def viscosity_error(self) -> float:
        """Its standard error."""
        return self.plateau.error
