"""The motion of atoms: mean-square displacement and velocity autocorrelation, by species and direction; self-diffusion,
and its correction for the size of a periodic cell."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import ceil
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.display import Rows
from minimd.core.engine.cell_rescaling import StrainedBodies
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_count, checked_number
from minimd.core.structure.constraints import molecules_of
from minimd.core.structure.observables import center
from minimd.core.structure.statistics import with_error
from minimd.core.structure.units import ASE, MPA_S
from minimd.observers.accumulator import ObservedRun, Result, Series, State
from minimd.observers.arguments import (
    ATOMS,
    MOLECULES,
    argument,
    interval,
    label,
    levels,
    particles,
    steps,
)
from minimd.observers.correlator import MultipleTau, Product, SquaredDifference
from minimd.observers.diffusion import SLOPE, Diffusivity, diffusion_words, diffusivity
from minimd.observers.time_correlation import COUNT, HEAD, LEVELS, TimeCorrelation, running_integral
from minimd.observers.viscosity import ViscosityResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS = 16  # entries on each level of the correlator
MOST_ATOMS = "largest number of atoms, chosen evenly, with up to one more for each species; it bounds time and memory"
XI = 2.837297  # ξ of a cubic cell
CUBIC = 1e-9  # largest relative deviation of the squares and products of lattice vectors from those of a cube
OF = "atoms, or centers of molecules (atoms that bonds or rigid lengths connect); displacements count by atom"
AXES = ("x", "y", "z")
BESIDE = "tab:orange"  # color of a second ordinate


def is_cubic(cell: Cell) -> bool:
    """Whether a cell is a cube that is periodic in all directions."""
    products = cell.vectors @ cell.vectors.T
    square = products[0, 0]
    return bool(cell.pbc.all() and np.abs(products - np.eye(3) * square).max() < CUBIC * square)


def finite_size_correction(thermal_energy: float, viscosity: float, edge: float) -> float:
    """The correction that is added to D in a cubic periodic cell to get D of an infinite system [length²/time].

        D∞ = D + ξ k_B T / (6π η L),   ξ = 2.837297

    thermal_energy : k_B T [energy].
    viscosity : η [energy time/length³].
    edge : L [length].
    I.-C. Yeh, G. Hummer, J. Phys. Chem. B 108, 15873 (2004); B. Dünweg, K. Kremer, J. Chem. Phys. 99, 6983 (1993).
    Raises ValueError for a number out of range."""
    checked_number("thermal_energy", thermal_energy, "finite and not negative")
    checked_number("viscosity", viscosity, "positive and finite")
    checked_number("edge", edge, "positive and finite")
    return XI * thermal_energy / (6.0 * np.pi * viscosity * edge)


def of_molecules(vectors: Array, masses: Array, molecules: Indices) -> Array:
    """(N, 3) for each atom, of vectors (N, 3) of atoms, the mean of its molecule, weighted by masses.
    molecules : see molecules_of."""
    sums = [np.bincount(molecules, masses * along) for along in vectors.T]
    return np.asarray((sums / np.bincount(molecules, masses)).T[molecules])


class _OfAtoms(TimeCorrelation):
    """A correlation of a vector of each atom that is not fixed, or of the center of its molecule, relative to the
    center of mass of all atoms: if the momentum is constant, or if nothing holds several molecules, which a bath moves
    together."""

    convention = 3  # relative to the center of mass also under a bath
    law: ClassVar[tuple]  # of the correlator
    every: int = steps(10)
    n_levels: int = argument(levels, LEVELS, 10)
    most_atoms: int = argument(checked_count, MOST_ATOMS, 4096)
    of: str = argument(particles, OF, ATOMS)
    name: str = label()
    chosen: list[int] = field(init=False, default_factory=lambda: [0])
    is_cubic: bool = field(init=False, default=False)
    # of chosen atoms of each species
    numbers: list[int] = field(init=False, default_factory=lambda: [1])
    is_relative: bool = field(init=False, default=False)  # to the center of mass
    # of D: n/(n − 1) for n independent particles relative to it
    widening: float = field(init=False, default=1.0)

    @property
    def n_components(self) -> int:
        """C, of what is correlated."""
        return 3

    def _begin(self, engine: Engine) -> None:
        system = engine.system
        moves = engine.constraint_set.inverse_masses > 0.0
        # not over all atoms: it could keep step with molecules
        stride = ceil(moves.sum() / self.most_atoms)
        species = range(len(system.species_names))
        chosen = [np.flatnonzero(moves & (system.species_index == k))[::stride] for k in species]
        self.chosen = np.concatenate(chosen).tolist()
        self.numbers = [*map(len, chosen)]
        self.is_cubic = is_cubic(system.cell)
        n_molecules = int(molecules_of(system).max()) + 1
        n_particles = n_molecules if self.of == MOLECULES else int(moves.sum())
        self.is_relative = engine.conserves_momentum or (engine.moves_freely and n_molecules > 1)
        if self.is_relative and not engine.conserves_momentum:
            self.widening = n_particles / (n_particles - 1.0)

    def _laid_out(self, scene: ObservedRun) -> None:
        n_atoms = scene.n_atoms
        n_chosen = len(self.chosen)
        are_atoms = min(self.chosen) >= 0 and max(self.chosen) < n_atoms
        if not are_atoms or sum(self.numbers) != n_chosen or min(self.numbers) < 0:
            raise ValueError(f"{self.name} cannot have chosen {self.numbers} of {n_atoms} atoms")
        starts = np.concatenate([[0], np.cumsum(self.numbers)])
        self._order = np.array(self.chosen)
        self._takes_all = n_chosen == n_atoms and self.chosen == [*range(n_atoms)]
        self._molecules: Indices | None = None
        law = type(self).law
        shape = (self.n_components, POINTS, self.n_levels)
        self._correlate_by(MultipleTau(law, starts, *shape, averages=False))

    def _look(self, engine: Engine) -> None:
        look = Look(engine)
        vectors = self._vectors(look)
        masses = engine.system.masses
        of_center = center(vectors, masses, self.is_relative)
        if self.of == MOLECULES:
            if self._molecules is None:
                self._molecules = molecules_of(engine.system)
            vectors = of_molecules(vectors, masses, self._molecules)
        chosen = vectors if self._takes_all else np.take(vectors, self._order, axis=0)
        self._add(look, self._entry(chosen - of_center))

    def _entry(self, vectors: Array) -> Array:
        """What is correlated of vectors, (n, 3): (C, n)."""
        return vectors.T

    @property
    def _are_joined(self) -> bool:
        return self.answered().has_molecules and self.of == ATOMS

    @abstractmethod
    def _vectors(self, look: Look) -> Array:
        """The vectors of all atoms, (N, 3)."""

    def _means(self, seen: NDArray[np.bool_]) -> Callable[[Array], Array]:
        """The function of the sums that gives means over all atoms, over those of each species, and of each
        component, (1 + S + C, T); NaN of a species whose atoms are all fixed."""
        numbers = np.array([n or np.nan for n in self.numbers])

        def law(sums: Array) -> Array:
            products = self._correlator.correlations(sums[HEAD:])[1][seen]  # (T, S, C)
            along = products.sum(axis=1).T / sum(self.numbers)
            of_species = (products.sum(axis=2) / numbers).T
            return np.concatenate([along.sum(axis=0, keepdims=True), of_species, along])

        return law


class CellMotion:
    """The displacements of atoms that are due to the motion of the cell, which looks take off their positions.

    From one look to the next each atom is moved with the cell; of a molecule with lengths held fixed the center is, and
    the molecule turns as the cell does.
    n_atoms : N.
    dimensions : of the cell.
    """

    def __init__(self, n_atoms: int, dimensions: int = 3) -> None:
        self._n_atoms = n_atoms
        self._dimensions = dimensions
        self._carried: Array | None = None  # the displacements, (N, 3)
        self._before: tuple[Cell, Array] | None = None  # cell and positions at the last look
        self._molecules: StrainedBodies | None = None

    def taken_off(self, engine: Engine) -> Array:
        """The present positions without it, (N, 3)."""
        positions = engine.positions
        cell = engine.system.cell
        was, old = self._before or (cell, np.empty_like(positions))
        if not cell.same_as(was):
            carried = self._moved(engine, was, old)
            self._carried = carried if self._carried is None else self._carried + carried
        old[:] = positions
        self._before = (cell, old)
        return positions if self._carried is None else positions - self._carried

    def _moved(self, engine: Engine, was: Cell, old: Array) -> Array:
        """Displacements since the last look, (N, 3).
        was, old : cell and positions at that look."""
        cell = engine.system.cell
        bonds = engine.constraint_set.bonds
        # vectors that span space: those of the cell, and unit vectors in open directions
        before, now = (np.where(c.pbc[:, None], c.vectors, c.lattice) for c in (was, cell))
        strain = np.linalg.solve(before, now)
        if bonds is None:
            return old @ strain - old
        if self._molecules is None:
            self._molecules = StrainedBodies(engine.system, engine.constraint_set)
        molecules = self._molecules
        # translations that join the atoms of a molecule; they change with the cell
        images = molecules.whole(bonds)
        images_before = images.copy()
        cell.follow(was, images_before)
        whole = old + images_before
        centers = molecules.centers(whole)[molecules.bodies.label]
        left, _, right = np.linalg.svd(strain)
        turned = (whole - centers) @ (left @ right - np.eye(3))
        moved: Array = centers @ (strain - np.eye(3)) + turned
        return moved - (images - images_before)

    def state(self) -> State:
        """See Kept."""
        arrays: State = {}
        if self._before is not None:
            cell, positions = self._before
            arrays["cell"] = cell.vectors
            arrays["pbc"] = cell.pbc.astype(np.int64)
            arrays["positions"] = positions
        if self._carried is not None:
            arrays["carried"] = self._carried
        return arrays

    def restore(self, state: State) -> None:
        """See Kept."""
        if "positions" in state:
            pbc = np.array(state["pbc"], dtype=bool)
            cell = Cell(np.array(state["cell"]), pbc, self._dimensions)
            self._before = cell, self._of_atoms(state["positions"])
        self._carried = self._of_atoms(state["carried"]) if "carried" in state else None

    def _of_atoms(self, vectors: Array) -> Array:
        copy = np.empty((self._n_atoms, 3))
        copy[:] = vectors
        return copy


class MeanSquareDisplacement(_OfAtoms):
    """⟨|r(t₀ + t) − r(t₀)|²⟩ and the coefficient of self-diffusion, by a multiple-tau correlator with lags up to
    15 · 2ᵏ⁻¹ · every steps in k levels.

    Every lag is exact: levels are thinned, never averaged. If the cell changes, as with a barostat, the motion of the
    cell is not counted: from one look to the next each atom, or the center of its rigid molecule, is first moved with
    the cell, and only the rest is its displacement. S. von Bülow, J. T. Bullerjahn, G. Hummer, J. Chem. Phys. 153,
    021101 (2020), on why.
    """

    kind = "mean-square-displacement"
    fits_plane = True
    law = SquaredDifference()

    def _laid_out(self, scene: ObservedRun) -> None:
        super()._laid_out(scene)
        self._of_cell = CellMotion(scene.n_atoms, scene.dimensions)

    def _vectors(self, look: Look) -> Array:
        return self._of_cell.taken_off(look.engine)

    def _parts(self) -> list[Any]:
        return [*super()._parts(), self._of_cell]

    def result(
        self,
        window: tuple[float, float] | None = None,
        viscosity: float | ViscosityResult | None = None,
    ) -> DisplacementResult:
        """The displacements so far, and D of the atoms, each with its standard error.

        window : lags [time]; D is then the mean slope over its octaves, whether atoms diffuse there or not. If not
            given, D is that of diffusivity, if the slope has stopped to change with the lag.
        viscosity : η [energy time/length³], such as 0.855 * md.units.MPA_S, for the finite-size correction of Yeh and
            Hummer, which needs a cubic cell; or the result of md.observers.Viscosity, whose error then counts, too.

        Raises ValueError before the first look, for a window without an octave of lags, or if a viscosity is given and
        the cell is not cubic.
        """
        if window is not None:
            interval("window", window)
        scene = self.answered()
        seen, times, longest = self._seen()
        law = self._means(seen)
        means, errors = self._estimate(times, longest, law)
        squares = self.widening * means
        without = self.widening * self.sums.replicas(law)
        rows = range(1 + len(scene.species))
        d = scene.dimensions
        each = [diffusivity(times, squares[k], without[:, k], longest, window, d) for k in rows]
        _, temperature, volume = (self.sums.total[:HEAD] / self.sums.total[COUNT]).tolist()
        result = DisplacementResult(
            scene=scene,
            times=times,
            means=means,
            errors=errors,
            diffusivity=each[0],
            n_atoms=sum(self.numbers),
            are_joined=self._are_joined,
            of_species=tuple(each[1:]),
            is_cubic=self.is_cubic,
            temperature=temperature,
            volume=volume,
        )
        return result if viscosity is None else result.corrected(viscosity)


class VelocityAutocorrelation(_OfAtoms):
    """⟨v(t₀) · v(t₀ + t)⟩, and the coefficient of self-diffusion as its integral, D = ∫ ⟨v(0) · v(t)⟩ dt / d.

    d is 3, or 2 in a plane.

    It is computed by a multiple-tau correlator, with the parameters of MeanSquareDisplacement. The time between looks
    must be short compared with the time in which velocities change: about 20 fs, or 0.02 τ.
    """

    kind = "velocity-autocorrelation"
    fits_plane = True
    law = Product()

    def _vectors(self, look: Look) -> Array:
        return look.engine.velocities

    def result(self) -> VelocityResult:
        """The autocorrelation so far, its running integral, and D, each with its standard error.
        Raises ValueError before the first look."""
        scene = self.answered()
        seen, times, longest = self._seen()
        law = self._means(seen)
        values, errors = self._estimate(times, longest, law)

        def integral(sums: Array) -> Array:
            return running_integral(times, law(sums)[0] / scene.dimensions)

        along, its_error = self._estimate(times, longest, integral)
        # the integral of this one is a mean square displacement
        factor = 2.0 * scene.dimensions * self.widening
        squares = factor * running_integral(times, along)
        without = factor * running_integral(times, self.sums.replicas(integral))
        of_all = diffusivity(times, squares, without, longest, dimensions=scene.dimensions)
        return VelocityResult(
            scene=scene,
            times=times,
            means=values,
            errors=errors,
            diffusivity=of_all,
            n_atoms=sum(self.numbers),
            are_joined=self._are_joined,
            integral=along,
            integral_error=its_error,
        )


@dataclass(frozen=True, repr=False)
class MotionResult(Result):
    """Means over atoms as functions of the lag.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T), of all atoms, of those of each species, and along x, y, z.
    diffusivity : Diffusivity of all atoms in this cell.
    n_atoms : number of atoms that were observed.
    are_joined : whether they are atoms of molecules, and not the centers of these.
    """

    times: Array
    means: Array
    errors: Array
    diffusivity: Diffusivity
    n_atoms: int
    are_joined: bool
    symbol: ClassVar[str]  # name of the series
    compared: ClassVar[str] = SLOPE  # with that at other lags
    coefficients = ("diffusion", "diffusion_error")

    @property
    def diffusion(self) -> float:
        """D in this cell [length²/time]."""
        return self.diffusivity.value

    @property
    def diffusion_error(self) -> float:
        """Its standard error."""
        return self.diffusivity.error

    @property
    def unit(self) -> str:
        """The unit of the means."""
        return f"{self.units.length}²"

    def in_words(self, diffusivity: Diffusivity) -> str:
        """D, or why there is none."""
        return diffusivity.in_words(self.units, self.compared, self.are_joined)

    @property
    def fixed_rows(self) -> Rows:
        """That fixed atoms do not count, if there are any."""
        n = self.scene.n_fixed
        return [("", f"of all atoms but the {n} that are fixed")] if n else []

    @property
    def shown(self) -> tuple[float, str]:
        """The factor and the unit in which D is drawn."""
        return 1.0 / self.units.to_picosecond, f"{self.units.length}²/{self.units.shown_time}"

    @property
    def known(self) -> str:
        """D with its error, for a legend."""
        factor, unit = self.shown
        return f"D = {with_error(factor * self.diffusion, factor * self.diffusion_error)} {unit}"

    def series(self) -> list[Series]:
        """See Result: means over all atoms, over each species if there are several, and along each direction."""
        names = ["", *(f"_{label}" for label in (*self.scene.species, *AXES))]
        rows = zip(names, self.means, self.errors, strict=True)
        series = [Series(self.symbol + name, self.unit, *row) for name, *row in rows]
        if len(self.scene.species) == 1:
            del series[1]  # the same as of all atoms
        return [Series("time", self.units.time, self.times), *series]


@dataclass(frozen=True, repr=False)
class DisplacementResult(MotionResult):
    """A mean-square displacement, and the self-diffusion that follows from it.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T) [length²], of all atoms, of those of each species, and along x, y, z.
    diffusivity, of_species : Diffusivity of all atoms in this cell, and of those of each species, (S,).
    n_atoms, are_joined : see MotionResult.
    diffusion, diffusion_error : D, and its standard error [length²/time]; NaN unless the slope has stopped to change.
        diffusion_of_species : D of each, (S,).
    window : lags of D [time].
    infinite, infinite_error : D of an infinite system by Yeh and Hummer; NaN without a viscosity. The error includes
        that of the viscosity, if it is known.
    viscosity : the one with which infinite was computed [energy time/length³].
    temperature, volume : means.
    """

    of_species: tuple[Diffusivity, ...]
    is_cubic: bool
    temperature: float
    volume: float
    infinite: float = np.nan
    infinite_error: float = np.nan
    viscosity: float = np.nan
    title = "mean-square displacement"
    symbol = "msd"

    @property
    def msd(self) -> Array:
        """(T,) [length²], of all atoms."""
        return np.asarray(self.means[0])

    @property
    def diffusion_of_species(self) -> tuple[float, ...]:
        """D of each species."""
        return tuple(diffusivity.value for diffusivity in self.of_species)

    @property
    def window(self) -> tuple[float, float]:
        """The lags of D [time]."""
        return self.diffusivity.window

    def corrected(self, viscosity: float | ViscosityResult) -> DisplacementResult:
        """This result with D of an infinite system.
        Raises ValueError."""
        if not self.is_cubic:
            raise ValueError(
                "the correction of Yeh and Hummer needs a cubic cell that is periodic in all directions; "
                "without one, do not pass viscosity"
            )
        thermal_energy = self.units.k_B * self.temperature
        edge = self.volume ** (1.0 / 3.0)
        viscosity_error = 0.0
        if isinstance(viscosity, ViscosityResult):
            viscosity_error = viscosity.viscosity_error
            viscosity = viscosity.viscosity
        added = finite_size_correction(thermal_energy, viscosity, edge)
        error = float(np.hypot(self.diffusion_error, added * viscosity_error / viscosity))
        infinite = self.diffusion + added
        return replace(self, infinite=infinite, infinite_error=error, viscosity=viscosity)

    def numbers(self) -> dict[str, float]:
        """See Result."""
        numbers = super().numbers()
        numbers["diffusion_infinite"] = self.infinite
        numbers["diffusion_infinite_error"] = self.infinite_error
        if len(self.of_species) > 1:
            for name, diffusivity in zip(self.scene.species, self.of_species, strict=True):
                numbers[f"diffusion_{name}"] = diffusivity.value
                numbers[f"diffusion_{name}_error"] = diffusivity.error
        return numbers

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        of_all = self.in_words(self.diffusivity)
        rows = [("diffusion", of_all), *self.fixed_rows]
        # species by their words: those of a molecule move with its center
        alike = dict[str, list[str]]()
        for name, of_one in zip(self.scene.species, self.of_species, strict=True):
            alike.setdefault(self.in_words(of_one), []).append(name)
        for words, names in alike.items():
            if words != of_all:
                rows.append(("", f"{', '.join(names)}: {words}"))
        if np.isfinite(self.infinite):
            infinite = diffusion_words(self.infinite, self.infinite_error, units)
            eta = f"{self.viscosity:.4g} {units.pressure} {units.time}"
            if units == ASE:
                eta = f"{self.viscosity / MPA_S:.4g} mPa s"
            rows.append(
                ("", f"D = {infinite} in an infinite cell (Yeh and Hummer, with η = {eta})")
            )
        elif self.is_cubic and np.isfinite(self.diffusion):
            larger = "in a larger cell D is larger: result(viscosity=...) corrects for this"
            rows.append(("", larger))
        return rows

    def draw(self, panel: Axes) -> None:
        """See Result."""
        times, unit = self.abscissa()
        later = self.times > 0.0
        panel.loglog(times[later], self.msd[later], marker="o", ms=2.5, lw=1.0)
        if np.isfinite(self.diffusion):
            start, end = self.window
            inside = (self.times >= start) & (self.times <= end)
            label = f"slope {2 * self.scene.dimensions} D, {self.known}"
            line = {"color": "0.4", "lw": 3.0, "alpha": 0.5, "label": label}
            panel.loglog(times[inside], self.msd[inside], **line)
            panel.legend(frameon=False, fontsize=8)
        quantity = f"⟨|r(t) − r(0)|²⟩  [{self.unit}]"
        panel.set(xlabel=f"t  [{unit}]", ylabel=quantity, title=self.title)


@dataclass(frozen=True, repr=False)
class VelocityResult(MotionResult):
    """A velocity autocorrelation, its integral, and the self-diffusion that follows from it.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T) [length²/time²], of all atoms, of those of each species, and along x, y, z.
    integral, integral_error : (T,) ∫₀ᵗ ⟨v · v⟩ / d in d dimensions [length²/time].
    diffusivity : Diffusivity, by means of the integral over octaves of lags.
    n_atoms, are_joined : see MotionResult.
    """

    integral: Array
    integral_error: Array
    title = "velocity autocorrelation"
    symbol = "vacf"
    compared = "integral"

    @property
    def vacf(self) -> Array:
        """(T,) [length²/time²], of all atoms."""
        return np.asarray(self.means[0])

    @property
    def unit(self) -> str:
        """The unit of the means."""
        return f"{self.units.length}²/({self.units.time})²"

    def series(self) -> list[Series]:
        """See Result."""
        unit = f"{self.units.length}²/{self.units.time}"
        return [*super().series(), Series("integral", unit, self.integral, self.integral_error)]

    def display_rows(self) -> Rows:
        """See Displayed."""
        return [("velocities", self.in_words(self.diffusivity)), *self.fixed_rows]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        panel.axhline(0.0, color="0.7", lw=0.8)
        part = Series("", "", self.vacf / self.vacf[0], self.errors[0] / self.vacf[0])
        self.draw_curves(panel, [part], "t", "⟨v(0) · v(t)⟩ / ⟨v²⟩")
        last = np.fmax(self.diffusivity.window[1], self.times[min(15, len(self.times) - 1)])
        if last > 0.0:
            ends = np.array([self.times[1], last]) * self.units.to_picosecond
            panel.set(xscale="log", xlim=ends)
        beside = panel.twinx()
        factor, unit = self.shown
        inside = self.times <= last
        times = self.times[inside] * self.units.to_picosecond
        integral = factor * self.integral[inside]
        errors = factor * self.integral_error[inside]
        beside.plot(times, integral, color=BESIDE, lw=1.1)
        beside.fill_between(
            times, integral - errors, integral + errors, color=BESIDE, alpha=0.25, lw=0
        )
        one_of_d = {2: "½", 3: "⅓"}[self.scene.dimensions]
        beside.set_ylabel(f"{one_of_d} ∫ ⟨v(0) · v(t)⟩ dt  [{unit}]", color=BESIDE)
        if np.isfinite(self.diffusion):
            ends = np.array(self.diffusivity.window) * self.units.to_picosecond
            line: dict[str, Any] = {"color": "0.4", "lw": 3.0, "alpha": 0.5, "label": self.known}
            beside.plot(ends, np.full(2, factor * self.diffusion), **line)
            beside.legend(frameon=False, fontsize=8)
