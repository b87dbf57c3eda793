"""Profiles of density and temperature along an axis of the cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Rows
from minimd.console.words import shown
from minimd.engine.engine import Engine
from minimd.observers.accumulator import Accumulator, BlockedSums, ObservedRun, Result, Series
from minimd.structure.checks import checked_choice, checked_count, checked_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
AXES = "abc"
# places in the sums, before the densities of each species, and Σ m v² of the atoms in each bin
FRAMES, EXTENT, HEAD = range(3)


class Profile(Accumulator):
    """Number density of each species, and temperature, in layers across one axis of the cell.

        ρ(z) = ⟨n(z) / ΔV⟩,   T(z) = ⟨Σ m v²⟩ / (g k_B ⟨n(z)⟩),   g = n_dof / N

    z is the distance along the normal of the two other lattice vectors. If the cell changes, layers of a periodic axis
    move with it, and z is given in the mean cell. The velocities of a flow count as thermal,
    but not those of the whole if n_dof leaves them out.

    Parameters
    ----------
    axis : "a", "b" or "c", the lattice vector.  n_bins : B layers.  every : steps between two looks.
    extent : (lower, upper) [length], required for an open axis; atoms outside are not counted.
        The other two axes must be periodic.
    name : its name in files, "profile" if not given.

    Raises
    ------
    ValueError : for arguments out of range; when a run begins,
        if the cell and extent do not define the volume of layers.
    """

    kind = "profile"
    arguments = ("axis", "n_bins", "every", "extent")

    def __init__(
        self,
        axis: str = "c",
        n_bins: int = 100,
        every: int = 50,
        extent: tuple[float, float] | None = None,
        name: str = "",
    ) -> None:
        super().__init__(every, name)
        self.axis, self.n_bins = checked_choice("axis", axis, tuple(AXES)), checked_count("n_bins", n_bins)
        if extent is not None and (not isinstance(extent, list | tuple) or len(extent) != 2):
            raise ValueError(f"extent must be two numbers, lower and upper; extent = {shown(extent)}")
        self.extent = None if extent is None else [checked_number("extent", one) for one in extent]
        if self.extent is not None and self.extent[1] <= self.extent[0]:
            raise ValueError(f"extent must be two numbers, the lower one first; extent = {shown(extent)}")

    def _begin(self, engine: Engine) -> None:
        pbc, k = engine.system.cell.pbc, AXES.index(self.axis)
        if not np.delete(pbc, k).all():
            raise ValueError(
                f"layers across axis {self.axis} need a cell that is periodic along the other two axes; its pbc = "
                f"{pbc.tolist()}"
            )
        if pbc[k] != (self.extent is None):
            needed = "is periodic: leave extent out" if pbc[k] else "is open: give extent=(lower, upper)"
            raise ValueError(f"axis {self.axis} of this cell {needed}")

    def _laid_out(self, scene: ObservedRun) -> None:
        self.sums = BlockedSums(HEAD + (len(scene.numbers) + 1) * self.n_bins)

    def _look(self, engine: Engine) -> None:
        system, k, n_species = engine.system, AXES.index(self.axis), len(engine.system.species_names)
        vectors = system.cell.vectors
        normal = np.cross(vectors[k - 2], vectors[k - 1])
        area = float(np.linalg.norm(normal))
        heights = np.einsum("ij,j->i", system.positions, normal) / area
        if self.extent is None:
            lower, height = 0.0, abs(float(vectors[k] @ normal)) / area
            layers = (
                np.floor(heights * np.sign(vectors[k] @ normal) / height % 1.0 * self.n_bins).astype(np.int64)
                % self.n_bins
            )
        else:
            lower, height = self.extent[0], self.extent[1] - self.extent[0]
            layers = np.floor((heights - lower) / height * self.n_bins).astype(np.int64)
        inside = (layers >= 0) & (layers < self.n_bins)
        places = system.species_index[inside] * self.n_bins + layers[inside]
        velocities = system.velocities - engine.drift
        squares = system.masses * np.einsum("ij,ij->i", velocities, velocities)
        sums, volume = self.sums.total, area * height / self.n_bins
        sums[:HEAD] += 1.0, height
        sums[HEAD : -self.n_bins] += np.bincount(places, minlength=n_species * self.n_bins) / volume
        sums[-self.n_bins :] += np.bincount(layers[inside], weights=squares[inside], minlength=self.n_bins) / volume

    def result(self) -> ProfileResult:
        """The profiles so far, with standard errors.  Raises ValueError before the first look."""
        scene, n = self.answered(), self.n_bins
        share = scene.n_dof / scene.n_atoms * scene.unit_system.k_B

        def law(sums: Array) -> Array:
            density = sums[HEAD:-n].reshape(-1, n)
            return np.concatenate([density / sums[FRAMES], (sums[-n:] / (share * density.sum(axis=0)))[None]])

        values, errors = self.sums.estimate(law)
        lower = 0.0 if self.extent is None else self.extent[0]
        z = lower + (np.arange(n) + 0.5) * self.sums.total[EXTENT] / self.sums.total[FRAMES] / n
        return ProfileResult(scene, self.axis, z, values[:-1], errors[:-1], values[-1], errors[-1], self.n_looks)


@dataclass(frozen=True, repr=False)
class ProfileResult(Result):
    """Profiles along an axis.

    axis : its name.  z : (B,) middles of the layers [length].  densities, density_errors : (S, B)
        of each species [1/length³].
    temperature, temperature_error : (B,); NaN in layers without atoms.  n_frames : number of looks.
    """

    scene: ObservedRun
    axis: str
    z: Array
    densities: Array
    density_errors: Array
    temperature: Array
    temperature_error: Array
    n_frames: int
    title: ClassVar[str] = "profile"

    @property
    def density(self) -> Array:
        """(B,) of all atoms [1/length³]."""
        found: Array = self.densities.sum(axis=0)
        return found

    def series(self) -> Series:
        """See Result."""
        names = [f"density_{one}" for one in self.scene.species]
        densities = zip(names, self.densities, self.density_errors, strict=True)
        return [("z", self.z, None), ("temperature", self.temperature, self.temperature_error), *densities]

    def display_rows(self) -> Rows:
        """See Displayed."""
        length, low, high = self.scene.unit_system.length, self.density.min(), self.density.max()
        return [
            (
                "profile",
                f"along {self.axis}, {len(self.z)} layers, {self.n_frames} looks; density from {low:.4g} to {high:.4g} "
                f"/{length}³",
            )
        ]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        length = self.scene.unit_system.length
        self.draw_curves(panel, self.z, dict(zip(self.scene.species, self.densities, strict=True)))
        title = f"{self.title}, {self.n_frames} looks"
        panel.set(
            xlabel=f"along {self.axis}  [{length}]", ylabel=f"density  [1/{length}³]", ylim=(0.0, None), title=title
        )
