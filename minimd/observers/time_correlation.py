"""The base of observers of correlations in time: the correlator, its sums, and integrals of correlations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.engine.observation import Look
from minimd.observers.accumulator import Accumulator
from minimd.observers.blocked_sums import BlockedSums
from minimd.observers.correlator import MultipleTau
from minimd.observers.green_kubo import Plateau, plateau, running_integral
from minimd.structure.cell import Cell
from minimd.structure.observables import temperature

Array = NDArray[np.float64]
COUNT, TEMPERATURE, VOLUME, HEAD = 0, 1, 2, 3  # places in the sums, before those of the correlator
LONGEST = 0.25  # of the duration: longer lags have too few origins


class Integral(NamedTuple):
    """values, errors : a running integral and its standard errors, (T,).  plateau : of the integral."""

    values: Array
    errors: Array
    plateau: Plateau


class TimeCorrelation(Accumulator):
    """An observer of a correlation in time.

    Its sums are the number of looks, temperatures, volumes, and those of a multiple-tau correlator.
    """

    convention = 2  # relative to the center of mass where its motion is no degree of freedom
    _correlator: MultipleTau

    def interrupt(self) -> None:
        """See Accumulator."""
        if self.scene is not None:
            self._correlator.interrupt()

    def _correlate_by(self, correlator: MultipleTau) -> None:
        """Make the sums."""
        self._correlator, self.sums = correlator, BlockedSums(HEAD + correlator.size)
        self._volume_of: Cell | None = None
        self._volume = np.nan

    def _add(self, look: Look, entry: Array) -> None:
        """Add a look to the sums.  entry : (C, n), for the correlator."""
        sums, system = self.sums.total, look.system
        if self._volume_of is not system.cell:  # the determinant takes as long as a lag of the correlator
            self._volume_of, self._volume = system.cell, system.volume or np.nan
        sums[:HEAD] += 1.0, temperature(look.thermal_energy, look.engine.n_dof, system.units.k_B), self._volume
        self._correlator.add(entry, sums[HEAD:])

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return self._correlator.state()

    def _take_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        self._correlator.restore(arrays)

    def _seen(self) -> tuple[NDArray[np.bool_], Array, float]:
        """Whether each lag has origins; the lags that have [time];
        and the longest lag for fits and integrals [time]."""
        counts, _ = self._correlator.correlations(self.sums.total[HEAD:])
        seen, spacing = counts > 0.0, self.answered().spacing
        times: Array = self._correlator.lags[seen] * np.float64(spacing)
        return seen, times, LONGEST * (self.n_looks - 1) * spacing

    def _estimate(self, times: Array, longest: float, law: Callable[[Array], Array]) -> tuple[Array, Array]:
        """The result of a law for the sums, (..., T), and its standard errors;
        NaN for lags that only a small part of the blocks contains."""
        values, errors = self.sums.estimate(law)
        errors[..., times > 2.0 * longest] = np.nan
        return values, errors

    def _integral(self, times: Array, longest: float, correlation: Callable[[Array], Array]) -> Integral:
        """The running integral of a correlation, (T,).  correlation : function of the sums."""

        def integral(sums: Array) -> Array:
            return running_integral(times, correlation(sums))

        values, errors = self._estimate(times, longest, integral)
        good, without = times <= max(longest, times[min(1, len(times) - 1)]), self.sums.replicas(integral)
        found = plateau(times[good], values[good], without[:, good] if len(without) else np.zeros((0, good.sum())))
        return Integral(values, errors, found)
