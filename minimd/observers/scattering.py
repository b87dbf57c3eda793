"""What atoms scatter: the static structure factor S(q), and the self-intermediate scattering function F_s(q, t).

Wave vectors are those of the periodic cell, q = 2π k · (a⁻¹)ᵀ with whole numbers k and lattice vectors a: only for
these does S(q) exist.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from math import e, pi
from typing import TYPE_CHECKING

import numpy as np

from minimd.core.compiled.kernels import kernel
from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_count
from minimd.core.structure.statistics import with_error
from minimd.core.structure.system import System
from minimd.observers.accumulator import (
    Accumulator,
    BlockedSums,
    ObservedRun,
    Result,
    Series,
    first_peak,
)
from minimd.observers.arguments import argument, label, positive, steps
from minimd.observers.correlator import Product
from minimd.observers.motion import MOST_ATOMS, MeanSquareDisplacement

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PEAK = 1.15 * 2.0 * pi  # q (V/N)^(1/d) of the main peak of a simple liquid
FAR = 3.0  # in q of the peak, the largest q if not given
GOLDEN = pi * (3.0 - 5.0**0.5)  # angle between two directions that follow each other
MOST_PERIODS = 10_000  # in the cell
MOST_WAVES = 100_000  # in all shells
TABLE = 2**18  # cosines of k for atoms
# wave vectors for F_s, the nearest of those in so many directions
N_WAVES = 3
MANY = 60
Q_MAX = "largest q; if not given, three times that of the main peak of a simple liquid"
Q_SELF = "length of the wave vectors; if not given, the main peak of a simple liquid, 1.15 · 2π (N/V)^(1/d)"
PER_SHELL = "number of directions for which wave vectors are chosen in each shell of q"


def peak_of(system: System, what: str) -> float:
    """q of the main peak of a simple liquid of this density [1/length].
    Raises ValueError without a volume."""
    if system.volume is None:
        raise ValueError(
            f"{what} needs a cell that is periodic in all directions; this run has {system!r}"
        )
    return PEAK / system.cell.spacing(len(system))


def waves_near(lengths: Array, cell: Cell, n_directions: int) -> Indices:
    """(M, 3) whole numbers k of the wave vectors of the cell that are nearest to those of given lengths [1/length] in
    directions spread evenly over a hemisphere, in a plane over half a circle; not 0, and only one of k and −k.
    Raises ValueError for large ones."""
    n_lengths = len(lengths)
    z = np.broadcast_to((np.arange(n_directions) + 0.5) / n_directions, (n_lengths, n_directions))
    flat = np.sqrt(1.0 - z * z)
    turn = GOLDEN * np.arange(z.size).reshape(z.shape)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=2)
    if cell.dimensions == 2:
        directions = np.stack([np.cos(pi * z), np.sin(pi * z), 0.0 * z], axis=2)
    exact = lengths[:, None, None] * directions @ cell.vectors.T / (2.0 * pi)
    if np.abs(exact).max() > MOST_PERIODS:
        raise ValueError(
            f"q = {lengths.max():.6g} has more than {MOST_PERIODS} periods in this cell; lower q"
        )
    waves = np.rint(exact).astype(np.int64).reshape(-1, 3)
    largest = np.abs(waves).max()
    leading = np.sign(waves @ [4 * largest**2 + 4, 2 * largest + 1, 1])
    return np.unique((waves * leading[:, None])[leading != 0], axis=0)


def vectors_of(waves: Indices, cell: Cell) -> Array:
    """(M, 3) q = 2π k · (a⁻¹)ᵀ [1/length]; a is cell.vectors, which remain those of the run if the cell changes."""
    return np.asarray(2.0 * pi * waves @ np.linalg.inv(cell.vectors).T)


@partial(kernel, fastmath={"reassoc", "nsz", "contract"})  # sums over atoms in any order
def add_densities(tables, waves, sums):
    """sums[:, w] += Σ_j exp(i q_w · r_j), real and imaginary part.

    tables : (3, K + 1, 2, N), cos and sin of 2π k s for whole numbers k and fractional coordinates s; those of k = 0
        and 1 are given, the others are found here.
    waves : (M, 3) int.
    sums : (2, M).
    """
    for d in range(3):
        once = tables[d, 1]
        for k in range(2, tables.shape[1]):
            before = tables[d, k - 1]
            to = tables[d, k]
            for i in range(tables.shape[3]):
                to[0, i] = before[0, i] * once[0, i] - before[1, i] * once[1, i]
                to[1, i] = before[1, i] * once[0, i] + before[0, i] * once[1, i]

    for w in range(waves.shape[0]):
        kx, ky, kz = waves[w, 0], waves[w, 1], waves[w, 2]
        x, y, z = tables[0, abs(kx)], tables[1, abs(ky)], tables[2, abs(kz)]
        sign_x, sign_y, sign_z = np.sign(kx), np.sign(ky), np.sign(kz)
        real = 0.0
        imaginary = 0.0

        for i in range(tables.shape[3]):
            cx = x[0, i]
            sx = sign_x * x[1, i]
            cy = y[0, i]
            sy = sign_y * y[1, i]
            cz = z[0, i]
            sz = sign_z * z[1, i]
            c = cx * cy - sx * sy
            s = cx * sy + sx * cy
            real += c * cz - s * sz
            imaginary += c * sz + s * cz

        sums[0, w] += real
        sums[1, w] += imaginary


class StructureFactor(Accumulator):
    """S(q) of all atoms, whatever their species, in shells of wave vectors of the cell.

        S(q) = ⟨|Σ_j exp(i q · r_j)|²⟩ / N

    Each shell has the mean over some n_waves wave vectors: those of the cell that are nearest to n_waves directions,
    spread evenly. This suits liquids and glasses, which look the same in all directions; in a crystal most Bragg peaks
    are missed. Shells without a wave vector of the cell, as at small q, are left out. If the cell changes, so do the
    wave vectors, not the shells; q is the mean over the run.

    Raises ValueError for arguments out of range; when a run begins, for a cell that is not periodic in all directions.
    """

    kind = "structure-factor"
    fits_plane = True
    q_max: float | None = argument(positive, Q_MAX, None, "inverse length")
    n_bins: int = argument(checked_count, "number of bins", 80)
    n_waves: int = argument(checked_count, PER_SHELL, 6)
    every: int = steps(200)
    name: str = label()
    waves: list[list[int]] = field(init=False, default_factory=list)
    shells: list[int] = field(init=False, default_factory=list)  # of each wave vector

    def _begin(self, engine: Engine) -> None:
        peak = peak_of(engine.system, "S(q)")
        cell = engine.system.cell
        n_bins = self.n_bins
        q_max = self.q_max or FAR * peak
        n = n_bins * self.n_waves
        if n > MOST_WAVES:
            raise ValueError(
                f"n_bins · n_waves must be at most {MOST_WAVES}; {n_bins} · {self.n_waves} = {n}"
            )

        waves = waves_near((np.arange(n_bins) + 0.5) * q_max / n_bins, cell, self.n_waves)
        lengths = np.linalg.norm(vectors_of(waves, cell), axis=1)
        shells = (lengths / q_max * n_bins).astype(np.int64)
        inside = shells < n_bins
        if not inside.any():
            raise ValueError(
                f"no wave vector of this cell is shorter than q_max = {q_max:.6g}; raise q_max"
            )

        self.waves = waves[inside].tolist()
        self.shells = np.unique(shells[inside], return_inverse=True)[1].tolist()

    def _laid_out(self, scene: ObservedRun) -> None:
        self._waves = np.array(self.waves)
        self._of_shell = np.bincount(self.shells)
        # number of looks, then q and S of each shell
        self.sums = BlockedSums(1 + 2 * len(self._of_shell))

    def _look(self, engine: Engine) -> None:
        cell = engine.system.cell
        n_atoms = len(engine.positions)
        highest = int(np.abs(self._waves).max())
        sums = np.zeros((2, len(self._waves)))
        n_parts = -(-n_atoms * (highest + 1) // TABLE)
        for positions in np.array_split(engine.positions, n_parts):
            tables = np.empty((3, highest + 1, 2, len(positions)))
            turns = vectors_of(np.eye(3, dtype=int), cell) @ positions.T
            for k in range(2):
                tables[:, k, 0] = np.cos(k * turns)
                tables[:, k, 1] = np.sin(k * turns)
            add_densities(tables, self._waves, sums)
        lengths = np.linalg.norm(vectors_of(self._waves, cell), axis=1)
        squares = (sums**2).sum(axis=0) / n_atoms
        of_shells = [np.bincount(self.shells, values) for values in (lengths, squares)]
        self.sums.total[0] += 1.0
        self.sums.total[1:] += (of_shells / self._of_shell).ravel()

    def result(self) -> StructureFactorResult:
        """S(q) so far, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()
        values, errors = self.sums.estimate(lambda sums: sums[1:] / sums[0])
        q, s = np.split(values, 2)
        return StructureFactorResult(scene, q, s, np.split(errors, 2)[1], self.n_looks)


@dataclass(frozen=True, repr=False)
class StructureFactorResult(Result):
    """S(q).

    q : (B,) mean length of the wave vectors of each shell [1/length].
    s, error : (B,) S(q), and its standard error.
    n_frames : number of looks.

    numbers() has the first peak: q_peak, see first_peak, s_peak in its highest shell, and s_peak_error.
    """

    q: Array
    s: Array
    error: Array
    n_frames: int
    title = "structure factor"

    def series(self) -> list[Series]:
        """See Result."""
        return [Series("q", f"1/{self.units.length}", self.q), Series("s", "", self.s, self.error)]

    def numbers(self) -> dict[str, float]:
        """See Result."""
        place, k = first_peak(self.q, self.s)
        return {"q_peak": place, "s_peak": float(self.s[k]), "s_peak_error": float(self.error[k])}

    def display_rows(self) -> Rows:
        """See Displayed."""
        shells = f"{len(self.q)} shells up to {self.q[-1]:.4g}, {self.n_frames} frames"
        q, s, error = self.numbers().values()
        peak = f"first peak at {q:.4g} /{self.units.length}, {with_error(s, error)}"
        return [("S(q)", f"{shells}; {peak}")]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        panel.axhline(1.0, color="0.7", lw=0.8)
        self.draw_curves(panel, self.series()[1:], "q", "S(q)")
        title = f"{self.title}, {self.scene.frames(self.n_frames)}"
        panel.set(title=title, ylim=(0.0, None))


class SelfScattering(MeanSquareDisplacement):
    """F_s(q, t) = ⟨cos q · (r(t₀ + t) − r(t₀))⟩, the self-intermediate scattering function, and the time in which it
    falls to 1/e.

    It is the mean over all atoms, and over up to 3 wave vectors of the cell at the start, whose lengths are nearest to
    q; by the multiple-tau correlator of MeanSquareDisplacement, and with its displacements: relative to the center of
    mass, and beside the motion of the cell.

    Raises ValueError for arguments out of range; when a run begins, for a cell that is not periodic in all directions.
    """

    kind = "self-scattering"
    law = Product()
    every: int = steps(20)
    most_atoms: int = argument(checked_count, MOST_ATOMS, 1000)
    q: float | None = argument(positive, Q_SELF, None, "inverse length")
    q_vectors: list[list[float]] = field(init=False, default_factory=list)

    @property
    def n_components(self) -> int:
        """Cosine and sine for each wave vector."""
        return 2 * len(self.q_vectors)

    def _begin(self, engine: Engine) -> None:
        super()._begin(engine)
        peak = peak_of(engine.system, "F_s(q, t)")
        q = self.q or peak
        cell = engine.system.cell
        waves = waves_near(np.array([q]), cell, MANY)
        if not len(waves):
            raise ValueError(f"no wave vector of this cell is as short as q = {q:.6g}; raise q")
        vectors = vectors_of(waves, cell)
        distances = np.abs(np.linalg.norm(vectors, axis=1) - q)
        self.q_vectors = vectors[np.argsort(distances, kind="stable")[:N_WAVES]].tolist()

    def _entry(self, moved: Array) -> Array:
        phases = np.array(self.q_vectors) @ moved.T
        return np.concatenate([np.cos(phases), np.sin(phases)])

    def result(self) -> SelfScatteringResult:  # type: ignore[override]
        """F_s so far, and the time in which it falls to 1/e, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()
        seen, times, longest = self._seen()
        means = self._means(seen)
        n_rows = 1 + len(scene.species)

        def law(sums: Array) -> Array:
            return np.asarray(means(sums)[:n_rows] / len(self.q_vectors))

        values, errors = self._estimate(times, longest, law)
        time, its_error = self.sums.estimate(lambda sums: fall_time(times, law(sums)[0]))
        q = float(np.linalg.norm(self.q_vectors, axis=1).mean())
        return SelfScatteringResult(scene, q, times, values, errors, float(time), float(its_error))


def fall_time(times: Array, values: Array) -> float:
    """Where a function, (T,), of times, (T,), falls below 1/e, on a straight line between two times; NaN if nowhere."""
    k = int(np.argmax(values < 1.0 / e))  # 0 if nowhere: there it is 1
    return float(np.interp(1.0 / e, values[[k, k - 1]], times[[k, k - 1]])) if k else np.nan


@dataclass(frozen=True, repr=False)
class SelfScatteringResult(Result):
    """F_s(q, t).

    q : mean length of the wave vectors [1/length].
    times : (T,) lags [time].
    means, errors : (1 + S, T), of all atoms, and of those of each species.
    relaxation_time, relaxation_time_error : where F_s of all atoms falls to 1/e [time]; NaN if it does not.
    """

    q: float
    times: Array
    means: Array
    errors: Array
    relaxation_time: float
    relaxation_time_error: float
    title = "self-intermediate scattering"
    coefficients = ("q", "relaxation_time", "relaxation_time_error")

    def series(self) -> list[Series]:
        """See Result: of all atoms, and of each species if there are several."""
        species = self.scene.species if len(self.scene.species) > 1 else []
        names = ["f_s", *(f"f_s_{name}" for name in species)]
        rows = zip(names, self.means, self.errors, strict=False)
        times = Series("time", self.units.time, self.times)
        return [times, *(Series(name, "", *row) for name, *row in rows)]

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        falls = "NOT to 1/e"
        if np.isfinite(self.relaxation_time):
            time = self.relaxation_time * units.to_picosecond
            error = self.relaxation_time_error * units.to_picosecond
            falls = f"to 1/e in {with_error(time, error)} {units.shown_time}"
        last = f"lags up to {units.shown(self.times[-1])}"
        return [("F_s(q, t)", f"at q = {self.q:.4g} /{units.length}: falls {falls}; {last}")]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        symbol = "Fₛ(q, t)"
        series = self.series()[1:]  # f_s, and f_s_A of species A
        curves = [curve._replace(name=f"{symbol} {curve.name[4:]}".strip()) for curve in series]
        panel.axhline(1.0 / e, color="0.7", lw=0.8, ls="--")
        self.draw_curves(panel, curves, "t", symbol)
        title = f"{self.title}, q = {self.q:.4g} /{self.units.length}"
        panel.set(xscale="log", title=title)
