"""The thermal conductivity, from the autocorrelation of the heat flux."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look, check_has_volume
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.constraints import molecules_of
from minimd.core.structure.system import System
from minimd.core.structure.units import W_PER_M_K
from minimd.observers.accumulator import ObservedRun
from minimd.observers.arguments import argument, label, levels, steps
from minimd.observers.correlator import MultipleTau, Product
from minimd.observers.time_correlation import (
    HEAD,
    LEVELS,
    POINTS,
    IntegralResult,
    TimeCorrelation,
    running_integral,
)

MOST_KINDS = 16  # of particles


class ThermalConductivity(TimeCorrelation):
    """Thermal conductivity by Green and Kubo, at no flux of mass between kinds of particles.

        J = Σ_i [(K_i + u_i) v_i + W_i v_i]                             of the energy, times the volume
        J_k = Σ m v                                                     of the mass of each kind but the last
        L_ab(t) = ∫₀ᵗ ⟨J_a(0) · J_b(t')⟩ dt' / (3 V k_B T²)
        λ = L_JJ − Σ_kl L_Jk (L⁻¹)_kl L_lJ

    K, u and W are energies and virial of each atom. Terms of three and four atoms count by the centroid form, see
    Forces.heat_flux. Atoms or molecules of the same composition are one kind. A liquid of one kind has λ = L_JJ. Of
    several, L_JJ depends on the zeros of their energies, and λ does not; each kind must diffuse, so that λ of a crystal
    of several kinds is too noisy. Velocities are relative to the center of mass.

    The time between looks must be short compared with the time in which the flux changes: about 5 fs, or 0.01 τ. Each
    look evaluates the energies and virials of single atoms.

    J.-P. Hansen, I. R. McDonald, Theory of Simple Liquids, 4th ed. (2013), section 8.5; R. Bertossa, F. Grasselli,
    L. Ercole, S. Baroni, Phys. Rev. Lett. 122, 255901 (2019), on mixtures; D. Surblys, H. Matsubara, G. Kikugawa,
    T. Ohara, Phys. Rev. E 99, 051301 (2019), on the centroid form.

    Raises ValueError for arguments out of range; when a run begins, for a cell without a volume, a momentum that is not
    constant, lengths held fixed, and potentials without a heat flux: sums over waves, embedded atoms, your own terms.
    """

    kind = "thermal-conductivity"
    every: int = steps(5)
    n_levels: int = argument(levels, LEVELS, 10)
    name: str = label()
    n_kinds: int = field(init=False, default=1)

    def _begin(self, engine: Engine) -> None:
        check_has_volume(engine)
        if engine.constraint_set.bonds is not None or not engine.conserves_momentum:
            raise ValueError(
                "a heat flux needs a momentum that is constant, and no lengths held fixed: leave fixed atoms, fields, "
                "rigid bonds and baths that act on each atom out; take md.VelocityVerlet, or "
                "md.StochasticVelocityRescaling with a long relaxation time"
            )
        _ = Look(engine).heat_flux  # refuses
        self.n_kinds = int(kinds_of_particles(engine.system).max()) + 1
        if self.n_kinds > MOST_KINDS:
            raise ValueError(
                f"a heat flux is of {MOST_KINDS} kinds of atoms or molecules at most; this run has {self.n_kinds}"
            )

    def _laid_out(self, scene: ObservedRun) -> None:
        m = self.n_kinds
        if not 0 < m <= MOST_KINDS:
            raise ValueError(f"{self.name} cannot have {m} kinds of particles")
        self._kinds: Indices | None = None
        self._pairs = np.triu_indices(m, 1)
        starts = np.arange(m + len(self._pairs[0]) + 1)
        self._correlate_by(MultipleTau(Product(), starts, 3, POINTS, self.n_levels, averages=True))

    def _look(self, engine: Engine) -> None:
        look = Look(engine)
        system = engine.system
        if self._kinds is None:
            self._kinds = kinds_of_particles(system)
        fluxes = [look.heat_flux]
        momenta = system.masses[:, None] * (engine.velocities - look.drift)
        for kind in range(self.n_kinds - 1):
            fluxes.append(momenta[self._kinds == kind].sum(axis=0))
        first, second = self._pairs
        each = np.array(fluxes)
        # ⟨(a + b)²⟩ − ⟨a²⟩ − ⟨b²⟩ = ⟨a b⟩ + ⟨b a⟩
        self._add(look, np.concatenate([each, each[first] + each[second]]).T.copy())

    def result(self) -> ThermalConductivityResult:
        """λ so far, with its standard error.
        Raises ValueError before the first look."""
        scene = self.answered()
        seen, times, longest = self._seen()
        k_B = scene.unit_system.k_B
        m = self.n_kinds
        first, second = self._pairs

        def correlations(sums: Array) -> Array:
            products = self._correlator.correlations(sums[HEAD:])[1][seen].sum(axis=2).T / 3.0
            matrix = np.empty((m, m, products.shape[1]))
            matrix[range(m), range(m)] = products[:m]
            cross = 0.5 * (products[m:] - products[first] - products[second])
            matrix[first, second] = cross
            matrix[second, first] = cross
            return matrix

        def integral(sums: Array) -> Array:
            looks, temperature, volume = sums[:HEAD]
            weight = looks**3 / (k_B * temperature**2 * volume)
            integrals = weight * running_integral(times, correlations(sums))
            inner = np.nan_to_num(integrals[1:, 1:].T)
            cross = integrals[0, 1:].T[:, :, None]
            mass = cross.swapaxes(1, 2) @ np.linalg.pinv(inner, hermitian=True) @ cross
            return np.asarray(integrals[0, 0] - mass[:, 0, 0])

        series = self._series(times, longest, lambda sums: correlations(sums)[0, 0], integral)
        return ThermalConductivityResult(scene, times, *series, m)


def kinds_of_particles(system: System) -> Indices:
    """(N,) for each atom the kind of its molecule, or of itself: particles of the same composition are one kind."""
    molecules = molecules_of(system)
    numbers = np.zeros((molecules.max() + 1, len(system.species_names)), dtype=np.int64)
    np.add.at(numbers, (molecules, system.species_index), 1)
    return np.unique(numbers, axis=0, return_inverse=True)[1].ravel()[molecules]


@dataclass(frozen=True, repr=False)
class ThermalConductivityResult(IntegralResult):
    """A thermal conductivity, see IntegralResult; the autocorrelation is ⟨J(0) · J(t)⟩ / 3 of the energy.

    n_kinds : of particles, between which no mass flows.
    """

    n_kinds: int
    title = "thermal conductivity"
    symbol = "λ"
    in_si = (1.0 / W_PER_M_K, "W/(m K)")
    coefficients = ("thermal_conductivity", "thermal_conductivity_error")

    @property
    def square(self) -> str:
        """See IntegralResult."""
        return f"({self.units.energy} {self.units.length}/({self.units.time}))²"

    @property
    def unit(self) -> str:
        """See IntegralResult."""
        units = self.units
        if units.name == "ASE":
            return f"{units.energy}/({units.length} {units.time} {units.temperature})"
        return f"k_B/({units.length} {units.time})"

    @property
    def thermal_conductivity(self) -> float:
        """λ [energy/(length time temperature)]."""
        return self.plateau.value

    @property
    def thermal_conductivity_error(self) -> float:
        """Its standard error."""
        return self.plateau.error

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = super().display_rows()
        if self.n_kinds > 1:
            rows.append(("", f"no mass flows between the {self.n_kinds} kinds of particles"))
        return rows
