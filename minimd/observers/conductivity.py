"""The electrical conductivity, from the autocorrelation of the current of ions."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil

import numpy as np

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import checked_count
from minimd.core.structure.constraints import molecules_of
from minimd.core.structure.units import S_PER_M
from minimd.observers.accumulator import ObservedRun
from minimd.observers.arguments import argument, label, levels, steps
from minimd.observers.correlator import MultipleTau, Product
from minimd.observers.molecules import NEUTRAL
from minimd.observers.motion import MOST_ATOMS
from minimd.observers.time_correlation import (
    HEAD,
    LEVELS,
    POINTS,
    IntegralResult,
    Plateau,
    TimeCorrelation,
    running_integral,
)

ALL, EACH = range(2)  # the current of all ions, and those of single ions


class Conductivity(TimeCorrelation):
    """Electrical conductivity of ions by Green and Kubo, with the part of self-diffusion.

        J = Σ q v,   C(t) = ⟨J(0) · J(t)⟩ / 3
        σ = 1/(V k_B T) ∫ C(t) dt
        σ_NE = 1/(3 V k_B T) Σ q² ∫ ⟨v(0) · v(t)⟩ dt          Nernst and Einstein: as if ions moved independently

    q and v are the charge and the velocity of the center of each ion: of an atom, or of a molecule, whose inner motion
    carries no steady current. Neutral molecules do not count. Velocities are relative to the center of mass of all
    atoms if its motion is no degree of freedom. ⟨|∫J|²⟩ is the second integral of 2 ⟨J · J⟩, and σ its slope by the
    rule of MeanSquareDisplacement.

    The time between looks must be short compared with the time in which the current changes: about 5 fs for a molten
    salt. A bath that acts on each atom, such as Langevin's, changes the conductivity.

    J.-P. Hansen, I. R. McDonald, Theory of Simple Liquids, 4th ed. (2013), section 10.5.

    Raises ValueError for arguments out of range; when a run begins, for a cell without a volume, or without ions.
    """

    kind = "conductivity"
    every: int = steps(5)
    n_levels: int = argument(levels, LEVELS, 10)
    most_atoms: int = argument(checked_count, MOST_ATOMS, 4096)
    name: str = label()
    chosen: list[int] = field(init=False, default_factory=lambda: [0])  # molecules
    # of these, enlarged so that the sum of their squares is that of all
    charges: list[float] = field(init=False, default_factory=lambda: [1.0])

    def _begin(self, engine: Engine) -> None:
        system = engine.system
        molecules = molecules_of(system)
        charges = np.bincount(molecules, system.charges)
        is_ion = np.abs(charges) > NEUTRAL * np.abs(system.charges).max(initial=0.0)
        if system.volume is None or not is_ion.any():
            raise ValueError(
                "a conductivity needs ions, atoms or molecules with a charge, and a cell that is periodic in all "
                f"directions; this run has {system!r}"
            )
        species = system.species_index[np.unique(molecules, return_index=True)[1]]
        ions = np.flatnonzero(is_ion)
        ions = ions[np.lexsort([species[ions], charges[ions]])]
        chosen = ions[:: ceil(len(ions) / self.most_atoms)]
        enlarged = np.linalg.norm(charges[ions]) / np.linalg.norm(charges[chosen])
        self.chosen = chosen.tolist()
        self.charges = (enlarged * charges[chosen]).tolist()

    def _laid_out(self, scene: ObservedRun) -> None:
        n = len(self.chosen)
        is_possible = 0 < n == len(self.charges) and 0 <= min(self.chosen) <= max(self.chosen)
        if not is_possible or max(self.chosen) >= scene.n_atoms:
            raise ValueError(f"{self.name} cannot have chosen {n} of {scene.n_atoms} atoms")
        self._molecules: Indices | None = None
        starts = np.array([0, 1, 1 + n])
        self._correlate_by(MultipleTau(Product(), starts, 3, POINTS, self.n_levels, averages=True))

    def _look(self, engine: Engine) -> None:
        look = Look(engine)
        system = engine.system
        if self._molecules is None:
            self._molecules = molecules_of(system)
        momenta = system.masses[:, None] * (engine.velocities - look.drift)
        masses = np.bincount(self._molecules, system.masses)
        velocities = [np.bincount(self._molecules, along) / masses for along in momenta.T]
        current = velocities @ np.bincount(self._molecules, system.charges)
        of_each = np.array(velocities)[:, self.chosen] * self.charges
        self._add(look, np.column_stack([current, of_each]))

    def result(self) -> ConductivityResult:
        """σ so far, with its standard error.
        Raises ValueError before the first look."""
        scene = self.answered()
        seen, times, longest = self._seen()
        k_B = scene.unit_system.k_B

        def correlations(sums: Array) -> Array:
            products = self._correlator.correlations(sums[HEAD:])[1][seen]
            return np.asarray(products.sum(axis=2).T / 3.0)

        def integrals(sums: Array) -> Array:
            looks, temperature, volume = sums[:HEAD]
            weight = looks**2 / (k_B * temperature * volume)
            return weight * running_integral(times, correlations(sums))

        series = self._series(
            times,
            longest,
            lambda sums: correlations(sums)[ALL],
            lambda sums: integrals(sums)[ALL],
        )
        *_, of_each = self._integral(times, longest, lambda sums: integrals(sums)[EACH])
        return ConductivityResult(scene, times, *series, of_each)


@dataclass(frozen=True, repr=False)
class ConductivityResult(IntegralResult):
    """A conductivity, see IntegralResult; the autocorrelation is C.

    of_each : plateau of the integral of single ions, the conductivity of Nernst and Einstein.
    """

    of_each: Plateau
    title = "conductivity"
    symbol = "σ"
    in_si = (1.0 / S_PER_M, "S/m")
    coefficients = (
        "conductivity",
        "conductivity_error",
        "nernst_einstein",
        "nernst_einstein_error",
    )

    @property
    def square(self) -> str:
        """See IntegralResult."""
        return f"(e·{self.units.length}/({self.units.time}))²"

    @property
    def unit(self) -> str:
        """See IntegralResult."""
        return f"e²/({self.units.energy} {self.units.length} {self.units.time})"

    @property
    def conductivity(self) -> float:
        """σ [e²/(energy length time)]."""
        return self.plateau.value

    @property
    def conductivity_error(self) -> float:
        """Its standard error."""
        return self.plateau.error

    @property
    def nernst_einstein(self) -> float:
        """σ_NE [e²/(energy length time)]."""
        return self.of_each.value

    @property
    def nernst_einstein_error(self) -> float:
        """Its standard error."""
        return self.of_each.error

    def display_rows(self) -> Rows:
        """See Displayed."""
        of_each = self.in_words(self.nernst_einstein, self.nernst_einstein_error)
        ratio = self.conductivity / self.nernst_einstein
        part = f"{of_each} by Nernst and Einstein, if ions moved independently: {ratio:.2f} of it"
        return [*super().display_rows(), ("", part)]
