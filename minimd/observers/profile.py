"""Profiles of density, temperature and flow along an axis of the cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count, checked_flag
from minimd.core.structure.observables import temperature
from minimd.core.structure.system import System
from minimd.observers.accumulator import AIR, Accumulator, BlockedSums, ObservedRun, Result, Series
from minimd.observers.arguments import AXES, argument, axis_name, interval, label, steps

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEAT = "#c8501e"  # the color of temperatures
MOST_UNSURE = 0.2  # relative error of a temperature that is drawn
STEEP = 0.5  # of the highest value: an axis begins at zero if the lowest is less
EXTENT_WORDS = "lower and upper end, needed if the axis is open; atoms outside are not counted"
CENTER_WORDS = (
    "whether z is the distance from the center of mass, of a film that moves along a periodic axis"
)
# places in the sums, before the densities of each species, and Σ g, Σ m v², Σ m and Σ m v of the atoms in each bin
FRAMES, EXTENT, HEAD = range(3)


class Stack(NamedTuple):
    """Where the layers of one state are.

    normal : (3,) across them, of length area.
    area : of a layer [length²], in a plane its length.
    height : of all layers together [length].
    lower : where they begin, along the normal [length].
    """

    normal: Array
    area: float
    height: float
    lower: float

    def rises(self, vectors: Array) -> Array:
        """(n,) of vectors (n, 3), along the normal, in heights."""
        return np.einsum("ij,j->i", vectors, self.normal) / self.area / self.height

    def fractions(self, positions: Array) -> Array:
        """(n,) of positions (n, 3), from 0 to 1 within the layers."""
        return self.rises(positions) - self.lower / self.height


class Layers(Accumulator):
    """An observer in layers across one axis of the cell."""

    axis: str = argument(axis_name, "the lattice vector a, b or c", "c")
    n_bins: int = argument(checked_count, "number of bins", 100)
    every: int = steps(50)
    extent: tuple[float, float] | None = argument(interval, EXTENT_WORDS, None, "length")
    center: bool = argument(checked_flag, CENTER_WORDS, False)
    name: str = label()

    def _begin(self, engine: Engine) -> None:
        pbc = engine.system.cell.pbc
        k = AXES.index(self.axis)
        n = engine.system.dimensions
        if k >= n or not np.delete(pbc[:n], k).all():
            raise ValueError(
                f"layers across axis {self.axis} need a cell that is periodic along the other axes, of a plane a and "
                f"b; its pbc = {pbc.tolist()}"
            )
        if pbc[k] and self.extent is not None:
            raise ValueError(f"axis {self.axis} of this cell is periodic: leave extent out")
        if self.center and not pbc[k]:
            raise ValueError(f"axis {self.axis} of this cell is open: leave center=True out")
        if not pbc[k] and self.extent is None:
            raise ValueError(f"axis {self.axis} of this cell is open: give extent=(lower, upper)")

    def _stack(self, system: System) -> Stack:
        k = AXES.index(self.axis)
        cell = system.cell
        vectors = cell.vectors.copy()
        if cell.dimensions == 2:
            vectors[2] = [0.0, 0.0, 1.0]  # areas are lengths
        normal = np.cross(vectors[k - 2], vectors[k - 1])
        area = float(np.linalg.norm(normal))
        if self.extent is not None:
            lower, upper = self.extent
            return Stack(normal, area, upper - lower, lower)
        along = float(vectors[k] @ normal)
        stack = Stack(np.sign(along) * normal, area, abs(along) / area, 0.0)
        if not self.center:
            return stack
        wave = system.masses @ np.exp(2j * np.pi * stack.fractions(system.positions))
        center = np.angle(wave) / (2.0 * np.pi)
        return stack._replace(lower=(center - 0.5) * stack.height)

    def _middles(self) -> Array:
        """z of the layers, (B,) [length]."""
        height = self.sums.total[EXTENT] / self.sums.total[FRAMES]
        lower = -0.5 * height if self.center else 0.0
        if self.extent is not None:
            lower = self.extent[0]
        return np.asarray(lower + (np.arange(self.n_bins) + 0.5) * height / self.n_bins)


class Profile(Layers):
    """Number density of each species, temperature and flow in layers across one axis of the cell.

        ρ(z) = ⟨n(z) / ΔV⟩,   u(z) = ⟨Σ m v⟩ / ⟨Σ m⟩,   T(z) = (⟨Σ m v²⟩ − ⟨Σ m⟩ u²) / (k_B ⟨Σ g⟩)

    g are the degrees of freedom of each atom: 0 if it is fixed, less than 3 with constraints (ConstraintSet.shares).
    z is the distance along the normal of the two other lattice vectors. If the cell changes, layers of a periodic axis
    move with it, and z is given in the mean cell. A steady flow u is no heat. The velocity of the whole is left out
    if n_dof leaves it out.

    With center=True z runs from −L/2 to L/2, with 0 at the center of mass along the periodic axis, of length L:

        z₀ = (L/2π) arg Σ m e^(2πi z/L)

    L. Bai, D. Breen, J. Graphics, GPU, Game Tools 13 (4), 53 (2008), on this center.

    Raises ValueError for arguments out of range; when a run begins, if the cell and extent do not define the volume of
    layers: the other two axes must be periodic, and the axis itself without extent, or with center=True.
    """

    kind = "profile"
    fits_plane = True
    convention = 3  # degrees of freedom, mass and momentum of each layer

    def _laid_out(self, scene: ObservedRun) -> None:
        self.sums = BlockedSums(HEAD + (len(scene.numbers) + 6) * self.n_bins)

    def _look(self, engine: Engine) -> None:
        system = engine.system
        n_bins = self.n_bins
        stack = self._stack(system)
        layers = np.floor(stack.fractions(system.positions) * n_bins)
        if self.extent is None:
            layers %= n_bins
        inside = (layers >= 0) & (layers < n_bins)
        layers = layers[inside].astype(np.int64)
        places = system.species_index[inside] * n_bins + layers
        velocities = system.velocities - engine.drift
        momenta = system.masses[:, None] * velocities
        squares = np.einsum("ij,ij->i", momenta, velocities)
        shares = engine.constraint_set.shares(system.positions, engine.conserves_momentum)
        added = shares, squares, system.masses, *momenta.T
        numbers = np.bincount(places, minlength=len(system.species_names) * n_bins)
        self.sums.total += np.concatenate(
            [
                [1.0, stack.height],
                numbers / (stack.area * stack.height / n_bins),
                *(np.bincount(layers, of_atoms[inside], n_bins) for of_atoms in added),
            ]
        )

    def result(self) -> ProfileResult:
        """The profiles so far, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()
        n = self.n_bins

        def law(sums: Array) -> Array:
            layers = sums[HEAD:].reshape(-1, n)
            shares, squares, masses = layers[-6:-3]
            flow = layers[-3:] / masses
            thermal = 0.5 * (squares - masses * (flow**2).sum(axis=0))
            heat = temperature(thermal, shares, scene.unit_system.k_B)
            return np.array([*flow, heat, *(layers[:-6] / sums[FRAMES])])

        values, errors = self.sums.estimate(law)
        profiles = (values[4:], errors[4:], values[3], errors[3], values[:3], errors[:3])
        return ProfileResult(scene, self.axis, self._middles(), *profiles, self.n_looks)


@dataclass(frozen=True, repr=False)
class ProfileResult(Result):
    """Profiles along an axis.

    axis : its name.
    z : (B,) middles of the layers [length].
    densities, density_errors : (S, B) of each species [1/length³].
    temperature, temperature_error : (B,); NaN in layers where no atom moves. Of n visits of atoms to a layer the flow
        takes one, so that the temperature is low by one part in n: of a single visit it is 0.
    flow, flow_errors : (3, B) u along x, y and z [length/time]; NaN in empty layers.
    n_frames : number of looks.
    """

    axis: str
    z: Array
    densities: Array
    density_errors: Array
    temperature: Array
    temperature_error: Array
    flow: Array
    flow_errors: Array
    n_frames: int
    title = "profile"

    @property
    def density(self) -> Array:
        """(B,) of all atoms [1/length³]."""
        return np.asarray(self.densities.sum(axis=0))

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """(B,) bool, layers whose temperature is known to 20 %."""
        return self.temperature_error < MOST_UNSURE * self.temperature

    def series(self) -> list[Series]:
        """See Result."""
        units = self.units
        heat = (self.temperature, self.temperature_error)
        series = [
            Series("z", units.length, self.z),
            Series("temperature", units.temperature, *heat),
        ]
        densities = zip(self.scene.species, self.densities, self.density_errors, strict=True)
        for species, *density in densities:
            series.append(Series(f"density_{species}", f"1/{units.volume}", *density))
        for axis, *flow in zip("xyz", self.flow, self.flow_errors, strict=True):
            series.append(Series(f"flow_{axis}", f"{units.length}/{units.time}", *flow))
        return series

    def display_rows(self) -> Rows:
        """See Displayed."""
        layers = f"along {self.axis}, {len(self.z)} layers, {self.scene.frames(self.n_frames)}"
        between = f"from {self.density.min():.4g} to {self.density.max():.4g} /{self.units.volume}"
        rows = [("profile", f"{layers}; density {between}")]
        heat = self.temperature[self.is_known]
        if heat.size:
            unit = self.units.temperature
            rows.append(("", f"temperature from {heat.min():.4g} to {heat.max():.4g} {unit}"))
        return rows

    def draw(self, panel: Axes) -> None:
        """See Result."""
        units = self.units
        curves = [
            Series(f"density {species}", "", *density)
            for species, *density in zip(
                self.scene.species, self.densities, self.density_errors, strict=True
            )
        ]
        self.draw_curves(panel, curves, f"along {self.axis}", f"density  [1/{units.volume}]")
        title = f"density and temperature, mean of {self.scene.frames(self.n_frames)}"
        panel.set(ylim=limits(self.densities), title=title)

        is_known = self.is_known
        if is_known.any():
            beside = panel.twinx()
            heat = self.temperature[is_known]
            errors = self.temperature_error[is_known]
            beside.errorbar(
                self.z[is_known],
                heat,
                errors,
                color=HEAT,
                fmt=".",
                ms=4,
                elinewidth=0.6,
            )
            beside.spines["top"].set_visible(False)
            unit = units.temperature.replace("k_B", "$k_B$")
            beside.set(ylim=limits(np.concatenate([heat - errors, heat + errors])))
            beside.set_ylabel(f"temperature  [{unit}]", color=HEAT)


def limits(values: Array) -> tuple[float, float]:
    """Ends of an axis: from zero, or, where all values are more than half of the highest, from below the lowest."""
    highest = values.max()
    lowest = values.min()
    air = (AIR - 1.0) * highest
    return (0.0 if lowest < STEEP * highest else lowest - air), highest + air
