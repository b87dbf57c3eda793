"""The motion of atoms: mean-square displacement and velocity autocorrelation, by species and direction."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from math import ceil
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.engine.cell_rescaling import Molecules
from minimd.engine.engine import Engine
from minimd.engine.observation import Look
from minimd.observers.accumulator import ObservedRun
from minimd.observers.correlator import MultipleTau, Product, SquaredDifference
from minimd.observers.diffusion import DisplacementResult, VelocityResult, is_cubic
from minimd.observers.time_correlation import COUNT, HEAD, TEMPERATURE, VOLUME, TimeCorrelation
from minimd.structure.cell import Cell
from minimd.structure.checks import checked_count
from minimd.structure.observables import center

Array = NDArray[np.float64]
POINTS = 16  # entries on each level of the correlator


class _OfAtoms(TimeCorrelation):
    """A correlation of a vector of each atom, relative to the center of mass of all atoms if n_dof leaves it out."""

    arguments = ("every", "n_levels", "most_atoms")
    settled = ("chosen", "is_cubic", "numbers")
    law: ClassVar[tuple]  # of the correlator

    def __init__(self, every: int = 10, n_levels: int = 10, most_atoms: int = 4096, name: str = "") -> None:
        super().__init__(every, name)
        self.n_levels = checked_count("n_levels", n_levels, 1, 40)
        self.most_atoms = checked_count("most_atoms", most_atoms)
        self.is_cubic, self.chosen, self.numbers = False, [0], [1]

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
        """The function of the sums that gives means over all atoms, over those of each species, and along x, y, z;
        (1 + S + 3, T)."""
        numbers = np.maximum(1, np.array(self.numbers))

        def law(sums: Array) -> Array:
            found = self._correlator.correlations(sums[HEAD:])[1][seen]  # (T, S, 3)
            along = found.sum(axis=1).T / numbers.sum()
            return np.concatenate([along.sum(axis=0, keepdims=True), (found.sum(axis=2) / numbers).T, along])

        return law


class MeanSquareDisplacement(_OfAtoms):
    """⟨|r(t₀ + t) − r(t₀)|²⟩ and the coefficient of self-diffusion,
    by a multiple-tau correlator with lags up to 15 · 2ᵏ⁻¹ · every steps in k levels.

    Every lag is exact: levels are thinned, never averaged. If the cell changes, as with a barostat, the motion of the
    cell is not counted: from one look to the next each atom, or the center of its rigid molecule, is first moved with
    the cell, and only the rest is its displacement. S. von Bülow, J. T. Bullerjahn, G. Hummer, J. Chem. Phys. 153,
    021101 (2020), on why.

    Parameters
    ----------
    every : steps between two looks.  n_levels : largest number of levels.  most_atoms : largest number of atoms, chosen
        evenly; time and memory are proportional to it.
    name : its name in files, "mean_square_displacement" if not given.
    """

    kind = "mean-square-displacement"
    law = SquaredDifference()

    def _laid_out(self, scene: ObservedRun) -> None:
        super()._laid_out(scene)
        self._carried: Array | None = None  # displacements due to the motion of the cell
        self._before: tuple[Cell, Array] | None = None  # cell and positions at the last look
        self._molecules: Molecules | None = None

    def _vectors(self, look: Look) -> tuple[Array, Array]:
        engine = look.engine
        positions, cell = engine.positions, engine.system.cell
        if self._before is not None and not cell.same_as(self._before[0]):
            was, old = self._before
            carried = self._moved_by_cell(engine, was, old)
            self._carried = carried if self._carried is None else self._carried + carried
        if self._before is None:
            self._before = cell, np.empty_like(positions)
        self._before[1][:] = positions
        self._before = cell, self._before[1]
        vectors = positions if self._carried is None else positions - self._carried
        return vectors, center(vectors, engine.system.masses, engine.conserves_momentum)

    def _moved_by_cell(self, engine: Engine, was: Cell, old: Array) -> Array:
        """Displacements due to the motion of the cell since the last look, (N, 3).  was, old :
        cell and positions at that look.

        Each atom moves with the cell; of a molecule with lengths held fixed the center does,
        and the molecule turns as the cell does.
        """
        cell, bonds = engine.system.cell, engine.constraint_set.bonds
        strain = np.linalg.solve(_spanning(was), _spanning(cell))
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

    def _arrays(self) -> dict[str, NDArray[Any]]:
        arrays = super()._arrays()
        if self._before is not None:
            arrays |= {
                "cell": self._before[0].vectors,
                "pbc": self._before[0].pbc.astype(np.int64),
                "positions": self._before[1],
            }
        return arrays if self._carried is None else arrays | {"carried": self._carried}

    def _take_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        super()._take_arrays(arrays)
        if "positions" in arrays:
            self._before = (
                Cell(np.array(arrays["cell"]), np.array(arrays["pbc"], dtype=bool)),
                np.array(arrays["positions"]),
            )
        self._carried = np.array(arrays["carried"]) if "carried" in arrays else None

    def result(self, window: tuple[float, float] | None = None, viscosity: float | None = None) -> DisplacementResult:
        """The displacements so far, and D of the atoms, each with its standard error.

        window : lags for the fit of a straight line [time]; if not given, a decade that begins when atoms have moved by
            half the distance of neighbors, and ends at a quarter of the run at the latest.
        viscosity : η [energy time/length³], for the finite-size correction of Yeh and Hummer, which needs a cubic cell.

        Raises ValueError before the first look, for a window with fewer than 3 lags,
        or if a viscosity is given and the cell is not cubic.
        """
        scene = self.answered()
        seen, times, longest = self._seen()
        means, errors = self._estimate(times, longest, self._means(seen))
        head = self.sums.total[:HEAD] / self.sums.total[COUNT]
        found = DisplacementResult(
            scene, times, means, errors, self.is_cubic, float(head[TEMPERATURE]), float(head[VOLUME]), sum(self.numbers)
        )
        return found.fitted(self.sums.replicas(self._means(seen)), window, longest, viscosity)


def _spanning(cell: Cell) -> Array:
    """Three vectors that span space: those of the cell, and unit vectors in open directions."""
    return np.where(cell.pbc[:, None], cell.vectors, cell.lattice)


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
        return VelocityResult(
            scene, times, *self._estimate(times, longest, law), values, errors, found, sum(self.numbers)
        )
