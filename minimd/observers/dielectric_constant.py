"""The dielectric constant, from the fluctuations of the dipole of all molecules."""

from __future__ import annotations

from math import exp, pi

import numpy as np

from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look
from minimd.core.structure.arrays import Array
from minimd.core.structure.statistics import FEWEST, correlation_times, standard_error
from minimd.observers.accumulator import Accumulator, BlockedSums, ObservedRun
from minimd.observers.arguments import label, steps
from minimd.observers.fluctuations import ENOUGH, JACKKNIFE
from minimd.observers.means import MeansResult, Quantity
from minimd.observers.molecules import NEUTRAL, Molecules

COUNT, TEMPERATURE, VOLUME = range(
    3
)  # places in the sums, before M and the squares of its components
DIPOLE = slice(3, 6)
SQUARES = slice(6, 9)


class DielectricConstant(Accumulator):
    """Static dielectric constant of a liquid from the fluctuations of its dipole, with conducting surroundings at
    infinity, as Ewald sums have them.

        ε = 1 + 4π k_e (⟨M²⟩ − ⟨M⟩²) / (3 V k_B T),   M = Σ q r       k_e = 1/(4π ε₀)

    M is the sum of the dipoles of molecules, each made whole bond by bond; they must have no net charge. T is that of
    the bath, and without one the mean temperature. V is the mean volume.

    The variance of a run of n_c correlation times of M is too small by the part 2/n_c, which is added. The standard
    error is that of the variance of three series with correlations e^(−t/τ), the relative error √(2/3n_c), or 0.7 of
    the jackknife's, if that is more; see Fluctuations.

    M. Neumann, Mol. Phys. 50, 841 (1983), eq. 27.

    Raises ValueError for arguments out of range; when a run begins, for a cell without a volume, for atoms without
    charges, or molecules that have a net charge or are joined to their own images.
    """

    kind = "dielectric-constant"
    every: int = steps(20)
    name: str = label()

    def _begin(self, engine: Engine) -> None:
        system = engine.system
        if system.volume is None or not system.charges.any():
            raise ValueError(
                "a dielectric constant needs charges, and a cell that is periodic in all directions; "
                f"this run has {system!r}"
            )
        charges = np.bincount(Molecules(system).label, system.charges)
        is_ion = np.abs(charges) > NEUTRAL * np.abs(system.charges).max()
        if is_ion.any():
            molecule = int(is_ion.argmax())
            atom = int((Molecules(system).label == molecule).argmax())
            raise ValueError(
                "molecules must have no net charge, because the dipole of an ion depends on the origin; the molecule "
                f"of atom {atom} ({system.species[atom]}) has {charges[molecule]:.6g} e: give all bonds, or leave "
                "this observer out where there are ions"
            )

    def _laid_out(self, scene: ObservedRun) -> None:
        self._molecules: Molecules | None = None
        self.sums = BlockedSums(SQUARES.stop)

    def _look(self, engine: Engine) -> None:
        system = engine.system
        self._molecules = self._molecules or Molecules(system)
        dipole = system.charges @ self._molecules.whole(system)
        state = [1.0, Look(engine).temperature, float(system.volume or 0.0)]
        self.sums.total += np.concatenate([state, dipole, dipole**2])

    def result(self) -> DielectricConstantResult:
        """ε so far, with its standard error.
        Raises ValueError before the first look."""
        scene = self.answered()
        length = self._correlation_times()
        missing = 2.0 / np.fmax(FEWEST, length)

        def law(sums: Array, widening: float = 1.0) -> Array:
            _, temperature, volume = sums[: DIPOLE.start] / sums[COUNT]
            thermal = scene.unit_system.k_B * (scene.bath_temperature or temperature)
            strength = 4.0 * pi * scene.unit_system.coulomb / (3.0 * volume * thermal)
            variance = variances(sums).sum() * (1.0 + missing) * widening
            return np.array([1.0 + strength * variance])

        value, error = self.sums.estimate(law)
        wider = law(self.sums.total, exp((missing / 3.0) ** 0.5))
        error = np.fmax(JACKKNIFE * error, wider - value)
        running = self._history(law, self.sums.until())
        quantities = [Quantity("dielectric_constant", "ε", "")]
        lengths = np.array([length])
        return DielectricConstantResult(
            scene, quantities, value, error, *running, self.n_looks, lengths
        )

    def _correlation_times(self) -> float:
        """The length of the run in correlation times of M, of all components together; NaN if unknown.
        n_c = 2 s²/error², see Fluctuations."""
        parts = self.sums.parts()
        errors = standard_error(parts[:, DIPOLE] / parts[:, :1])
        variance = float(variances(self.sums.total).sum())
        return float(correlation_times(variance, float(np.linalg.norm(errors))))


def variances(sums: Array) -> Array:
    """(3,) variances of the components of M."""
    return np.asarray(sums[SQUARES] / sums[COUNT] - (sums[DIPOLE] / sums[COUNT]) ** 2)


class DielectricConstantResult(MeansResult):
    """A dielectric constant, dielectric_constant, see MeansResult; parts are its values up to the times."""

    title = "dielectric constant"
    of_parts = "running value"
    correlated = "dipole"
    enough = ENOUGH
