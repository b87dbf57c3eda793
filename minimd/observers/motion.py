"""The motion of atoms: mean-square displacement and velocity autocorrelation, by species and direction."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import field
from math import ceil
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.engine.cell_rescaling import Molecules
from minimd.engine.engine import Engine
from minimd.engine.observation import Look
from minimd.observers.accumulator import Kept, ObservedRun, State
from minimd.observers.arguments import argument, count, label, levels, steps
from minimd.observers.correlator import MultipleTau, Product, SquaredDifference
from minimd.observers.diffusion import DisplacementResult, VelocityResult, is_cubic
from minimd.observers.time_correlation import COUNT, HEAD, LEVELS, TimeCorrelation
from minimd.structure.cell import Cell
from minimd.structure.observables import center

Array = NDArray[np.float64]
POINTS = 16  # entries on each level of the correlator
MOST_ATOMS = "largest number of atoms, chosen evenly; time and memory are proportional to it"


class _OfAtoms(TimeCorrelation):
    """A correlation of a vector of each atom, relative to the center of mass of all atoms if n_dof leaves it out."""

    law: ClassVar[tuple]  # of the correlator
    every: int = steps(10)
    n_levels: int = argument(levels, LEVELS, 10)
    most_atoms: int = argument(count, MOST_ATOMS, 4096)
    name: str = label()
    chosen: list[int] = field(init=False, default_factory=lambda: [0])
    is_cubic: bool = field(init=False, default=False)
    numbers: list[int] = field(init=False, default_factory=lambda: [1])  # of chosen atoms of each species

    def _begin(self, engine: Engine) -> None:
        system = engine.system
        some = np.arange(0, len(system), ceil(len(system) / self.most_atoms))
        self.chosen = some[np.argsort(system.species_index[some], kind="stable")].tolist()
        self.is_cubic = is_cubic(system.cell)
        self.numbers = np.bincount(system.species_index[some], minlength=len(system.species_names)).tolist()

    def _laid_out(self, scene: ObservedRun) -> None:
        starts = np.concatenate([[0], np.cumsum(self.numbers)])
        self._order = np.array(self.chosen)
        self._takes_all = np.array_equal(self._order, np.arange(scene.n_atoms))
        self._correlate_by(MultipleTau(type(self).law, starts, 3, POINTS, self.n_levels, averages=False))

    def _look(self, engine: Engine) -> None:
        look = Look(engine)
        vectors, of_center = self._vectors(look)
        self._add(look, ((vectors if self._takes_all else np.take(vectors, self._order, axis=0)) - of_center).T)

    @abstractmethod
    def _vectors(self, look: Look) -> tuple[Array, Array]:
        """The vectors of all atoms, (N, 3), and what to subtract from them, (3,)."""

    def _means(self, seen: NDArray[np.bool_]) -> Callable[[Array], Array]:
        """The function of the sums that gives means over all atoms, over those of each species, and along x, y, z,
        (1 + S + 3, T)."""
        numbers = np.maximum(1, np.array(self.numbers))

        def law(sums: Array) -> Array:
            found = self._correlator.correlations(sums[HEAD:])[1][seen]  # (T, S, 3)
            along = found.sum(axis=1).T / numbers.sum()
            return np.concatenate([along.sum(axis=0, keepdims=True), (found.sum(axis=2) / numbers).T, along])

        return law


class CellMotion:
    """The displacements of atoms that are due to the motion of the cell, which looks take off their positions.

    From one look to the next each atom is moved with the cell; of a molecule with lengths held fixed the center is, and
    the molecule turns as the cell does.
    """

    def __init__(self) -> None:
        self._carried: Array | None = None  # the displacements, (N, 3)
        self._before: tuple[Cell, Array] | None = None  # cell and positions at the last look
        self._molecules: Molecules | None = None

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
            self._molecules = Molecules(engine.system, engine.constraint_set)
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
            self._before = cell, np.array(state["positions"])
        self._carried = np.array(state["carried"]) if "carried" in state else None


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
        self._of_cell = CellMotion()

    def _vectors(self, look: Look) -> tuple[Array, Array]:
        vectors = self._of_cell.taken_off(look.engine)
        return vectors, center(vectors, look.system.masses, look.engine.conserves_momentum)

    def _parts(self) -> list[Kept]:
        return [*super()._parts(), self._of_cell]

    def result(self, window: tuple[float, float] | None = None, viscosity: float | None = None) -> DisplacementResult:
        """The displacements so far, and D of the atoms, each with its standard error.

        window : lags for the fit of a straight line [time]; if not given, a decade that begins when atoms have moved by
            half the distance of neighbors, and ends at a quarter of the run at the latest.
        viscosity : η [energy time/length³], for the finite-size correction of Yeh and Hummer, which needs a cubic cell.

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
        values, errors, found = self._integral(times, longest, lambda sums: law(sums)[0] / 3.0)
        means = self._estimate(times, longest, law)
        return VelocityResult(scene, times, *means, values, errors, found, sum(self.numbers))
