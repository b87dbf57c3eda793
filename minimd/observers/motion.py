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
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_count, checked_number
from minimd.core.structure.observables import center
from minimd.core.structure.statistics import spread, with_error
from minimd.core.structure.units import UnitSystem
from minimd.observers.accumulator import ObservedRun, Result, Series, State
from minimd.observers.arguments import argument, label, levels, steps
from minimd.observers.correlator import MultipleTau, Product, SquaredDifference
from minimd.observers.time_correlation import COUNT, HEAD, LEVELS, Plateau, TimeCorrelation
from minimd.observers.viscosity import ViscosityResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
POINTS = 16  # entries on each level of the correlator
MOST_ATOMS = "largest number of atoms, chosen evenly, with up to one more for each species; it bounds time and memory"
XI = 2.837297  # ξ of a cubic cell
CUBIC = 1e-9  # largest relative deviation of the squares and products of lattice vectors from those of a cube
DECADE = 10.0  # the window of a fit ends at this multiple of its start
LEFT = 0.5  # of the distance of neighbors: an atom that has moved by more has left its place
USUAL = 10.0  # 10⁻⁵ cm²/s per Å²/ps
AXES = ("x", "y", "z")


def is_cubic(cell: Cell) -> bool:
    """Whether a cell is a cube that is periodic in all directions."""
    square = cell.vectors @ cell.vectors.T
    return bool(cell.pbc.all() and np.abs(square - np.eye(3) * square[0, 0]).max() < CUBIC * square[0, 0])


def slope(times: Array, squares: Array) -> Array:
    """Slopes of straight lines through mean squares (..., T) at times (T,), each point weighted by 1/t, because its
    error grows as t."""
    weights = 1.0 / times
    weights = weights**2 / (weights**2).sum()
    t = times - weights @ times
    return np.asarray((squares * (weights * t)).sum(axis=-1) / (weights * t * t).sum())


def finite_size_correction(thermal_energy: float, viscosity: float, edge: float) -> float:
    """The correction that is added to D in a cubic periodic cell to get D of an infinite system [length²/time].

        D∞ = D + ξ k_B T / (6π η L),   ξ = 2.837297

    thermal_energy : k_B T [energy].  viscosity : η [energy time/length³].  edge : L [length].
    I.-C. Yeh, G. Hummer, J. Phys. Chem. B 108, 15873 (2004); B. Dünweg, K. Kremer, J. Chem. Phys. 99, 6983 (1993).
    """
    return XI * thermal_energy / (6.0 * np.pi * viscosity * edge)


def with_its_error(viscosity: float | ViscosityResult) -> tuple[float, float]:
    """A viscosity and its standard error, 0 if it is a number."""
    if isinstance(viscosity, ViscosityResult):
        return checked_number("viscosity", viscosity.viscosity, "positive and finite"), viscosity.viscosity_error
    return checked_number("viscosity", viscosity, "positive and finite"), 0.0


def diffusion_words(coefficient: float, error: float, units: UnitSystem) -> str:
    """D in words, in Å²/ps and cm²/s, or in reduced units."""
    if units.name != "ASE":
        return f"{with_error(coefficient, error)} {units.length}²/{units.time}"
    return per_ps_in_words(coefficient / units.to_picosecond, error / units.to_picosecond)


def per_ps_in_words(coefficient: float, error: float) -> str:
    """D [Å²/ps] in words, also in cm²/s."""
    return f"{with_error(coefficient, error)} Å²/ps = ({with_error(USUAL * coefficient, USUAL * error)})·10⁻⁵ cm²/s"


class _OfAtoms(TimeCorrelation):
    """A correlation of a vector of each atom, relative to the center of mass of all atoms if n_dof leaves it out."""

    law: ClassVar[tuple]  # of the correlator
    every: int = steps(10)
    n_levels: int = argument(levels, LEVELS, 10)
    most_atoms: int = argument(checked_count, MOST_ATOMS, 4096)
    name: str = label()
    chosen: list[int] = field(init=False, default_factory=lambda: [0])
    is_cubic: bool = field(init=False, default=False)
    numbers: list[int] = field(init=False, default_factory=lambda: [1])  # of chosen atoms of each species

    @property
    def n_components(self) -> int:
        """C, of what is correlated."""
        return 3

    def _begin(self, engine: Engine) -> None:
        system, index = engine.system, engine.system.species_index
        stride = ceil(len(system) / self.most_atoms)  # not over all atoms: it could keep step with molecules
        chosen = [np.flatnonzero(index == k)[::stride] for k in range(len(system.species_names))]
        self.chosen, self.numbers = np.concatenate(chosen).tolist(), [len(one) for one in chosen]
        self.is_cubic = is_cubic(system.cell)

    def _laid_out(self, scene: ObservedRun) -> None:
        are_atoms = min(self.chosen) >= 0 and max(self.chosen) < scene.n_atoms
        if not are_atoms or sum(self.numbers) != len(self.chosen) or min(self.numbers) < 0:
            raise ValueError(f"{self.name} cannot have chosen {self.numbers} of {scene.n_atoms} atoms")
        starts = np.concatenate([[0], np.cumsum(self.numbers)])
        self._order = np.array(self.chosen)
        self._takes_all = self.chosen == [*range(len(self.chosen))] and len(self.chosen) == scene.n_atoms
        correlator = MultipleTau(type(self).law, starts, self.n_components, POINTS, self.n_levels, averages=False)
        self._correlate_by(correlator)

    def _look(self, engine: Engine) -> None:
        look = Look(engine)
        vectors, of_center = self._vectors(look)
        chosen = vectors if self._takes_all else np.take(vectors, self._order, axis=0)
        self._add(look, self._entry(chosen - of_center))

    def _entry(self, vectors: Array) -> Array:
        """What is correlated of vectors, (n, 3): (C, n)."""
        return vectors.T

    @abstractmethod
    def _vectors(self, look: Look) -> tuple[Array, Array]:
        """The vectors of all atoms, (N, 3), and what to subtract from them, (3,)."""

    def _means(self, seen: NDArray[np.bool_]) -> Callable[[Array], Array]:
        """The function of the sums that gives means over all atoms, over those of each species, and of each
        component, (1 + S + C, T)."""
        numbers = np.maximum(1, np.array(self.numbers))

        def law(sums: Array) -> Array:
            found = self._correlator.correlations(sums[HEAD:])[1][seen]  # (T, S, C)
            along = found.sum(axis=1).T / sum(self.numbers)
            return np.concatenate([along.sum(axis=0, keepdims=True), (found.sum(axis=2) / numbers).T, along])

        return law


class CellMotion:
    """The displacements of atoms that are due to the motion of the cell, which looks take off their positions.

    From one look to the next each atom is moved with the cell; of a molecule with lengths held fixed the center is, and
    the molecule turns as the cell does.  n_atoms : N.
    """

    def __init__(self, n_atoms: int) -> None:
        self._n_atoms = n_atoms
        self._carried: Array | None = None  # the displacements, (N, 3)
        self._before: tuple[Cell, Array] | None = None  # cell and positions at the last look
        self._molecules: StrainedBodies | None = None

    def taken_off(self, engine: Engine) -> Array:
        """The present positions without it, (N, 3)."""
        positions, cell = engine.positions, engine.system.cell
        was, old = self._before or (cell, np.empty_like(positions))
        if not cell.same_as(was):
            carried = self._moved(engine, was, old)
            self._carried = carried if self._carried is None else self._carried + carried
        old[:] = positions
        self._before = cell, old
        return positions if self._carried is None else positions - self._carried

    def _moved(self, engine: Engine, was: Cell, old: Array) -> Array:
        """Displacements since the last look, (N, 3).  was, old : cell and positions at that look."""
        cell, bonds = engine.system.cell, engine.constraint_set.bonds
        # vectors that span space: those of the cell, and unit vectors in open directions
        spanning = (np.where(one.pbc[:, None], one.vectors, one.lattice) for one in (was, cell))
        strain = np.linalg.solve(*spanning)
        if bonds is None:
            return old @ strain - old
        if self._molecules is None:
            self._molecules = StrainedBodies(engine.system, engine.constraint_set)
        # translations that join the atoms of a molecule; they change with the cell
        images = self._molecules.whole(bonds)
        images_before = images.copy()
        cell.follow(was, images_before)
        whole = old + images_before
        centers = self._molecules.centers(whole)[self._molecules.bodies.label]
        left, _, right = np.linalg.svd(strain)
        moved: Array = centers @ (strain - np.eye(3)) + (whole - centers) @ (left @ right - np.eye(3))
        return moved - (images - images_before)

    def state(self) -> State:
        """See Kept."""
        arrays: State = {}
        if self._before is not None:
            cell, positions = self._before
            arrays = {"cell": cell.vectors, "pbc": cell.pbc.astype(np.int64), "positions": positions}
        return arrays if self._carried is None else {**arrays, "carried": self._carried}

    def restore(self, state: State) -> None:
        """See Kept."""
        if "positions" in state:
            cell = Cell(np.array(state["cell"]), np.array(state["pbc"], dtype=bool))
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
    law = SquaredDifference()

    def _laid_out(self, scene: ObservedRun) -> None:
        super()._laid_out(scene)
        self._of_cell = CellMotion(scene.n_atoms)

    def _vectors(self, look: Look) -> tuple[Array, Array]:
        vectors = self._of_cell.taken_off(look.engine)
        return vectors, center(vectors, look.system.masses, look.engine.conserves_momentum)

    def _parts(self) -> list[Any]:
        return [*super()._parts(), self._of_cell]

    def result(
        self, window: tuple[float, float] | None = None, viscosity: float | ViscosityResult | None = None
    ) -> DisplacementResult:
        """The displacements so far, and D of the atoms, each with its standard error.

        window : lags for the fit of a straight line [time]; if not given, a decade that begins when atoms have moved by
            half the distance of neighbors, and ends at a quarter of the run at the latest.
        viscosity : η [energy time/length³], for the finite-size correction of Yeh and Hummer, which needs a cubic cell;
            or the result of md.observers.Viscosity, whose error then counts, too.

        Raises ValueError before the first look, for a window with fewer than 3 lags, or if a viscosity is given and the
        cell is not cubic.
        """
        scene = self.answered()
        seen, times, longest = self._seen()
        means, errors = self._estimate(times, longest, self._means(seen))
        _, temperature, volume = (self.sums.total[:HEAD] / self.sums.total[COUNT]).tolist()
        n_atoms = sum(self.numbers)
        found = DisplacementResult(scene, times, means, errors, self.is_cubic, temperature, volume, n_atoms)
        return found.fitted(self.sums.replicas(self._means(seen)), window, longest, viscosity)


class VelocityAutocorrelation(_OfAtoms):
    """⟨v(t₀) · v(t₀ + t)⟩, and the coefficient of self-diffusion as its integral, D = ⅓ ∫ ⟨v(0) · v(t)⟩ dt.

    It is computed by a multiple-tau correlator, with the parameters of MeanSquareDisplacement. The time between looks
    must be short compared with the time in which velocities change: about 20 fs, or 0.02 τ.
    """

    kind = "velocity-autocorrelation"
    law = Product()

    def _vectors(self, look: Look) -> tuple[Array, Array]:
        return look.engine.velocities, look.drift

    def result(self) -> VelocityResult:
        """The autocorrelation so far, its running integral, and D, each with its standard error.
        Raises ValueError before the first look."""
        scene = self.answered()
        seen, times, longest = self._seen()
        law = self._means(seen)
        (values, errors), n_atoms = self._estimate(times, longest, law), sum(self.numbers)
        integral, error, found = self._integral(times, longest, lambda sums: law(sums)[0] / 3.0)
        return VelocityResult(scene, times, values, errors, integral, error, found, n_atoms)


@dataclass(frozen=True, repr=False)
class MotionResult(Result):
    """Means over atoms as functions of the lag.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T), of all atoms, of those of each species, and along x, y, z.
    """

    times: Array
    means: Array
    errors: Array
    symbol: ClassVar[str]  # name of the series
    coefficients = ("diffusion", "diffusion_error")

    @property
    def unit(self) -> str:
        """The unit of the means."""
        return f"{self.units.length}²"

    def series(self) -> list[Series]:
        """See Result: means over all atoms, over each species if there are several, and along each direction."""
        names = ["", *(f"_{label}" for label in (*self.scene.species, *AXES))]
        rows = zip(names, self.means, self.errors, strict=True)
        found = [Series(self.symbol + name, self.unit, *row) for name, *row in rows]
        if len(self.scene.species) == 1:
            del found[1]  # the same as of all atoms
        return [Series("time", self.units.time, self.times), *found]


@dataclass(frozen=True, repr=False)
class DisplacementResult(MotionResult):
    """A mean-square displacement, and the self-diffusion that follows from it.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T) [length²], of all atoms, of those of each species, and along x, y, z.
    diffusion, diffusion_error : D in this cell [length²/time]; NaN if the window holds too few lags.
        diffusion_of_species : D of each, (S,).
    infinite, infinite_error : D of an infinite system by Yeh and Hummer; NaN without a viscosity. The error includes
        that of the viscosity, if it is known.
    window : of the straight line [time].  temperature, volume : means.
    n_atoms : number of atoms whose displacements were measured.
    """

    is_cubic: bool
    temperature: float
    volume: float
    n_atoms: int
    diffusion: float = np.nan
    diffusion_error: float = np.nan
    diffusion_of_species: tuple[float, ...] = ()
    infinite: float = np.nan
    infinite_error: float = np.nan
    window: tuple[float, float] = (np.nan, np.nan)
    title = "mean-square displacement"
    symbol = "msd"

    @property
    def msd(self) -> Array:
        """(T,) [length²], of all atoms."""
        return np.asarray(self.means[0])

    def fitted(self, without: Array, window: tuple[float, float] | None, longest: float,
               viscosity: float | ViscosityResult | None) -> DisplacementResult:  # fmt: skip
        """This result with D.  without : (K, 1 + S + 3, T) replicas of the means.  longest : last lag for a fit [time].
        Raises ValueError."""
        spacing = (self.volume / self.scene.n_atoms) ** (1.0 / 3.0)
        start, end = window or (0.1 * longest, longest if np.isnan(spacing) else 0.0)
        has_left = self.msd > (LEFT * spacing) ** 2  # False for all lags without a volume
        if window is None and has_left.any():
            start = float(self.times[np.argmax(has_left)])
            end = min(DECADE * start, longest)
        inside = (self.times >= start) & (self.times <= end) & (self.times > 0.0)
        if inside.sum() < 3:
            if window is None:
                return self
            held = f"({start:.4g}, {end:.4g}) holds {inside.sum()} of {len(self.times)}"
            raise ValueError(f"the window of the fit must hold at least 3 lags; {held}")
        times, n = self.times[inside], 1 + len(self.scene.species)
        coefficients = slope(times, self.means[:n, inside]) / 6.0
        error = float(spread(slope(times, without[:, 0, inside]) / 6.0)) if len(without) else np.nan
        found, *of_species = coefficients.tolist()
        made = {"diffusion": found, "diffusion_error": error, "diffusion_of_species": tuple(of_species)}
        made["window"] = float(times[0]), float(times[-1])
        if viscosity is not None:
            if not self.is_cubic:
                needs = "needs a cubic cell that is periodic in all directions; without one, do not pass viscosity"
                raise ValueError(f"the correction of Yeh and Hummer {needs}")
            thermal_energy, edge = self.units.k_B * self.temperature, self.volume ** (1.0 / 3.0)
            eta, eta_error = with_its_error(viscosity)
            added = finite_size_correction(thermal_energy, eta, edge)
            made |= {"infinite": found + added, "infinite_error": float(np.hypot(error, added * eta_error / eta))}
        return replace(self, **made)

    def numbers(self) -> dict[str, float]:
        """See Result."""
        infinite = {"diffusion_infinite": self.infinite, "diffusion_infinite_error": self.infinite_error}
        return {**super().numbers(), **infinite}

    def display_rows(self) -> Rows:
        """See Displayed."""
        units, (start, end) = self.units, self.window
        if np.isnan(self.diffusion):
            said = f"unknown: the atoms have not left their places in lags up to {units.shown(self.times[-1])}"
            return [("diffusion", said)]
        words = diffusion_words(self.diffusion, self.diffusion_error, units)
        rows = [("diffusion", f"D = {words}, from lags of {units.shown(start)} to {units.shown(end)}, in this cell")]
        if np.isfinite(self.infinite):
            words = diffusion_words(self.infinite, self.infinite_error, units)
            rows.append(("", f"D = {words} in an infinite cell (Yeh and Hummer)"))
        elif self.is_cubic:
            rows.append(("", "in a larger cell D is larger: result(viscosity=...) corrects for this"))
        return rows

    def draw(self, panel: Axes) -> None:
        """See Result."""
        (times, unit), later = self.abscissa(), self.times > 0.0
        panel.loglog(times[later], self.msd[later], marker="o", ms=2.5, lw=1.0)
        if np.isfinite(self.diffusion):
            line = 6.0 * self.diffusion * self.times[later]
            panel.loglog(times[later], line, color="0.6", lw=0.8, ls="--", label="6 D t")
            panel.legend(frameon=False, fontsize=8)
        panel.set(xlabel=f"t  [{unit}]", ylabel=f"⟨|r(t) − r(0)|²⟩  [{self.unit}]", title=self.title)


@dataclass(frozen=True, repr=False)
class VelocityResult(MotionResult):
    """A velocity autocorrelation, its integral, and the self-diffusion that follows from it.

    times : (T,) lags [time].
    means, errors : (1 + S + 3, T) [length²/time²], of all atoms, of those of each species, and along x, y, z.
    integral, integral_error : (T,) ⅓ ∫₀ᵗ ⟨v · v⟩ [length²/time].  plateau : of the integral.
    n_atoms : number of atoms that were observed.
    """

    integral: Array
    integral_error: Array
    plateau: Plateau
    n_atoms: int
    title = "velocity autocorrelation"
    symbol = "vacf"

    @property
    def vacf(self) -> Array:
        """(T,) [length²/time²], of all atoms."""
        return np.asarray(self.means[0])

    @property
    def diffusion(self) -> float:
        """D in this cell [length²/time]."""
        return self.plateau.value

    @property
    def diffusion_error(self) -> float:
        """Its standard error."""
        return self.plateau.error

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
        words = diffusion_words(self.diffusion, self.diffusion_error, self.units)
        return [("velocities", f"D = {words}, in this cell; {self.plateau.said(self.units)}")]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        panel.axhline(0.0, color="0.7", lw=0.8)
        self.draw_curves(panel, {"": self.vacf / self.vacf[0]}, "t", "⟨v(0) · v(t)⟩ / ⟨v²⟩")
        last = max(self.plateau.window[1], float(self.times[min(15, len(self.times) - 1)]))
        panel.set(xlim=(0.0, last * self.units.to_picosecond or None))
