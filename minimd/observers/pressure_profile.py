"""The profile of the pressure along an axis of the cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minimd.core.compiled.kernels import kernel
from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look
from minimd.core.structure.arrays import Array
from minimd.core.structure.statistics import with_error
from minimd.observers.accumulator import BlockedSums, ObservedRun, Result, Series
from minimd.observers.profile import FRAMES, HEAD, Layers
from minimd.observers.surface_tension import TAILS


@kernel
def add_to_layers(starts, rises, products, is_periodic, sums):
    """sums (B, 2) += products (L, 2) times the share of each line that lies in a layer.

    starts, rises : (L,) from where along the axis, and how far, in layers.
    is_periodic : whether the layers repeat; if not, what is outside of them is left out.
    """
    n_layers = sums.shape[0]
    for l in range(starts.size):
        lower = min(starts[l], starts[l] + rises[l])
        upper = max(starts[l], starts[l] + rises[l])
        for layer in range(int(np.floor(lower)), int(np.floor(upper)) + 1):
            if is_periodic or 0 <= layer < n_layers:
                inside = min(upper, layer + 1) - max(lower, layer)
                share = inside / (upper - lower) if upper > lower else 1.0
                for c in range(2):
                    sums[layer % n_layers, c] += share * products[l, c]


class PressureProfile(Layers):
    """Pressure across and along layers, P_N and P_T, by Irving and Kirkwood: along straight lines between atoms.

        P(z) = ⟨Σ_i m v ⊗ v + Σ_lines s r ⊗ f⟩ / ΔV,   P_N = n · P n,   P_T = ½ (tr P − P_N)

    n is the normal of the layers, ΔV the volume of one, in which the atoms i are. Each pair, bond and length held fixed
    has a line r, with the force f on its far end, an angle two, a dihedral three and a DihedralMap six, along their
    bonds; s is the share of the line in the layer. Velocities are relative to the center of mass. The mean over all
    layers is the pressure without tail corrections, and ∫ (P_N − P_T) dz the surface tension times the number of
    surfaces, see SurfaceTension.
    In equilibrium P_N is the same in all layers. The layers are those of Profile.

    J. H. Irving, J. G. Kirkwood, J. Chem. Phys. 18, 817 (1950).

    Raises ValueError as Profile; also for potentials whose forces do not act along such lines: sums over waves,
    embedded atoms, fields, your own terms.
    """

    kind = "pressure-profile"
    needs_energy = True

    def _begin(self, engine: Engine) -> None:
        super()._begin(engine)
        instead = "sum virials of atoms in layers, see docs/pressure.md"
        engine.interactions.check_pairwise("a pressure profile", instead)

    def _laid_out(self, scene: ObservedRun) -> None:
        self.sums = BlockedSums(HEAD + 2 * self.n_bins)

    def _look(self, engine: Engine) -> None:
        engine.evaluate()
        look = Look(engine)
        system = engine.system
        stack = self._stack(system)
        velocities = system.velocities - look.drift
        momenta = system.masses[:, None] * velocities
        atoms = (system.positions, 0.0 * velocities, velocities, momenta)
        lines = [(start, arms, arms, pulls) for start, arms, pulls in look.lines]
        n = self.n_bins
        sums = np.zeros((n, 2))
        for line in (atoms, *lines):
            start, way, arms, pulls = (vectors.reshape(-1, 3) for vectors in line)
            normal = stack.height**2 * stack.rises(arms) * stack.rises(pulls)
            tangential = 0.5 * (np.einsum("ij,ij->i", arms, pulls) - normal)
            products = np.column_stack([normal, tangential])
            places = (n * stack.fractions(start), n * stack.rises(way))
            add_to_layers(*places, products, self.extent is None, sums)
        volume = stack.area * stack.height / n
        self.sums.total += np.concatenate([[1.0, stack.height], *(sums.T / volume)])

    def result(self) -> PressureProfileResult:
        """The profile so far, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()

        def law(sums: Array) -> Array:
            _, height, *profiles = sums / sums[FRAMES]
            normal, tangential = np.reshape(profiles, (2, -1))
            return np.array([*profiles, height * (normal - tangential).mean()])

        values, errors = self.sums.estimate(law)
        n = self.n_bins
        profiles = (values[:n], errors[:n], values[n:-1], errors[n:-1])
        integral = float(values[-1]), float(errors[-1])
        return PressureProfileResult(
            scene, self.axis, self._middles(), *profiles, *integral, self.n_looks
        )


@dataclass(frozen=True, repr=False)
class PressureProfileResult(Result):
    """The pressure along an axis.

    axis : its name.
    z : (B,) middles of the layers [length].
    normal, normal_error, tangential, tangential_error : (B,) P_N and P_T [energy/length³].
    integral, integral_error : ∫ (P_N − P_T) dz over all layers [energy/length²].
    n_frames : number of looks.
    """

    axis: str
    z: Array
    normal: Array
    normal_error: Array
    tangential: Array
    tangential_error: Array
    integral: float
    integral_error: float
    n_frames: int
    title = "pressure profile"
    coefficients = ("integral", "integral_error")

    def series(self) -> list[Series]:
        """See Result."""
        units = self.units
        return [
            Series("z", units.length, self.z),
            Series("normal", units.pressure, self.normal, self.normal_error),
            Series("tangential", units.pressure, self.tangential, self.tangential_error),
        ]

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        layers = f"along {self.axis}, {len(self.z)} layers, {self.scene.frames(self.n_frames)}"
        normal = f"P_N from {self.normal.min():.4g} to {self.normal.max():.4g} {units.pressure}"
        integral = with_error(self.integral, self.integral_error)
        tension = f"∫ (P_N − P_T) dz = {integral} {units.energy}/{units.length}²"
        return [(self.title, f"{layers}; {normal}"), ("", tension), ("", TAILS)]
