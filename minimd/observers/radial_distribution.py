"""The radial distribution functions of all pairs of species."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, Program, operation
from minimd.core.compiled.simd import lane, load
from minimd.core.compiled.simd.vector import count
from minimd.core.compiled.threads import ThreadPool
from minimd.core.console.display import Rows
from minimd.core.engine.engine import Engine
from minimd.core.forces.cluster_loop import separations
from minimd.core.neighbors.cluster_list import ClusterList
from minimd.core.neighbors.cluster_search import GHOST_BITS, LAYERS
from minimd.core.neighbors.clusters import DIMENSIONS
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_count
from minimd.core.structure.statistics import with_error
from minimd.core.structure.system import System
from minimd.observers.accumulator import (
    AIR,
    Accumulator,
    Array,
    BlockedSums,
    ObservedRun,
    Result,
    Series,
)
from minimd.observers.arguments import argument, label, positive, steps

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FRAMES, HEAD = range(2)  # places in the sums: number of frames, then V times the numbers of pairs
NO_PAIRS = np.zeros((0, 2), dtype=np.int64)
# of a spike, beside all that is beyond it; and below which g(r) is a gap
SPIKE = 3.0
GAP = 0.3
SPACINGS = 4.0  # in r_max if not given: four shells of neighbors
R_MAX = "largest distance; if not given, the smaller of 4 (V/N)^(1/3) and half the smallest height of the initial cell"


class PairCounting(
    ByAddress, namedtuple("PairCounting", "arrays species kinds per_width beyond counts")
):
    """arrays : ClusterArrays of a list whose cutoff is r_max.
    species : (slots,) int, of the atoms in clusters.
    kinds : (S, S) int, the number of each pair of species.
    per_width : 1/Δr [1/length].
    beyond : (n,) columns, one for each lane, of pairs farther away: a single one would wait for itself at each of them.
    counts : (K, P, columns) int, its numbers of pairs by kind and bin."""


@called_kernel
def count_pairs(counting, domain):
    """counts[domain, p, k] += number of pairs of kind p, with all images, with k Δr ≤ r < (k + 1) Δr, of the atoms of
    a domain with those of their rows."""
    arrays, species, kinds, per_width, beyond, _ = counting
    clusters = arrays.clusters
    ghosts = arrays.ghosts
    rows = arrays.rows
    memory = arrays.memory
    lanes = clusters.lanes
    counts = counting.counts[domain]
    first = arrays.domains.first[domain]
    n_lanes = count(lanes)
    columns = load(beyond, 0, lanes)
    coordinates = memory.coordinates[first * DIMENSIONS * n_lanes :]

    for slot in range(
        arrays.domain_start[domain] * n_lanes, arrays.domain_start[domain + 1] * n_lanes
    ):
        place = (ghosts.home[slot // n_lanes] - first) * DIMENSIONS * n_lanes + slot % n_lanes
        at = coordinates[place], coordinates[place + n_lanes], coordinates[place + 2 * n_lanes]
        kinds_of_pairs = kinds[species[slot]]

        for entry in range(np.uintp(rows.start[slot]), np.uintp(rows.stops[LAYERS - 1, slot])):
            now = rows.entries[entry]
            _, _, _, r2 = separations(coordinates, memory.far, now, at, lanes)
            places = min(np.sqrt(r2) * per_width, columns)
            other = np.uintp(ghosts.owner[first + np.intp(now & GHOST_BITS)]) * np.uintp(n_lanes)

            for k in range(np.uintp(n_lanes)):
                counts[
                    np.uintp(kinds_of_pairs[np.uintp(species[other + k])]),
                    np.uintp(lane(places, k)),
                ] += 1

    return GO_ON


class RadialDistribution(Accumulator):
    """g(r) of each pair of species, from all pairs and images within r_max.

        g_ab(r) = ⟨V n_ab(r)⟩ / (N_ab · 4π/3 [(r + Δr/2)³ − (r − Δr/2)³])

    n_ab(r) is the number of pairs in a bin, of N_ab = N_a N_b, or N_a (N_a − 1)/2, pairs. V is the volume at each look;
    it may change. Bonded pairs count like all others.

    Raises ValueError for arguments out of range; when a run begins, for a cell that is not periodic in all directions,
    or a single atom.
    """

    kind = "radial-distribution"
    r_max: float | None = argument(positive, R_MAX, None, "length")
    n_bins: int = argument(checked_count, "number of bins", 200)
    every: int = steps(100)
    name: str = label()
    reach: float = field(init=False, default=0.0)  # r_max

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and deepcopy: a copy makes a list of its own."""
        return {**vars(self), "_list": None}

    def _begin(self, engine: Engine) -> None:
        system = engine.system
        if system.volume is None or len(system) < 2:
            raise ValueError(
                "g(r) needs at least two atoms, and a cell that is periodic in all directions; "
                f"this run has {system!r}"
            )
        spacing = (system.volume / len(system)) ** (1.0 / 3.0)
        lowest = float(system.cell.heights.min())
        self.reach = self.r_max or min(SPACINGS * spacing, lowest / 2.0)

    def _laid_out(self, scene: ObservedRun) -> None:
        n = len(scene.numbers)
        self._pairs = [(a, b) for a in range(n) for b in range(a, n)]
        self._kinds = np.zeros((n, n), dtype=np.int64)
        for p, (a, b) in enumerate(self._pairs):
            self._kinds[a, b] = p
            self._kinds[b, a] = p
        self._list: tuple[int, ClusterList, DirectCalls] | None = None  # of a number of atoms
        self.sums = BlockedSums(HEAD + len(self._pairs) * self.n_bins)

    def _look(self, engine: Engine) -> None:
        system = engine.system
        counts = self._counts(system, engine.interactions.pool)[:, : self.n_bins]
        self.sums.total[FRAMES] += 1.0
        self.sums.total[HEAD:] += float(system.volume or 0.0) * counts.ravel()

    def _counts(self, system: System, pool: ThreadPool) -> Array:
        """(P, columns) numbers of pairs, from a list of clusters; a cell too small for one is repeated."""
        positions = system.positions
        species = system.species_index
        cell = system.cell
        n = np.ceil(self.reach / cell.heights).astype(np.int64)
        if n.max() > 1:
            steps = np.stack(np.meshgrid(*map(np.arange, n)), axis=-1).reshape(-1, 1, 3)
            positions = (steps @ cell.lattice + positions).reshape(-1, 3)
            species = np.tile(species, n.prod())
            cell = Cell.of(n[:, None] * cell.lattice)

        if self._list is None or self._list[0] != len(positions):
            clusters = ClusterList(len(positions), self.reach, 0.0, NO_PAIRS, False, pool)
            self._list = (len(positions), clusters, DirectCalls())
        _, clusters, calls = self._list
        clusters.update(positions, cell)
        n_lanes = clusters.lanes.size
        shape = (clusters.n_domains, len(self._pairs), self.n_bins + n_lanes)
        counting = PairCounting(
            arrays=clusters.arrays,
            species=species[clusters.clusters.atom[: clusters.n_clusters * n_lanes]],
            kinds=self._kinds,
            per_width=self.n_bins / self.reach,
            beyond=self.n_bins + np.arange(n_lanes, dtype=np.float64),
            counts=np.zeros(shape, dtype=np.int64),
        )
        count_all = operation(calls, count_pairs, counting, clusters.n_domains)
        Program(lambda: [count_all], lambda: 0, pool).run()
        return counting.counts.sum(axis=0) / n.prod()

    def result(self) -> RadialDistributionResult:
        """g(r) so far, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()
        edges = np.linspace(0.0, self.reach, self.n_bins + 1)
        shells = 4.0 / 3.0 * np.pi * np.diff(edges**3)
        n = scene.numbers
        numbers = np.array([n[a] * (n[b] - (a == b)) / (1.0 + (a == b)) for a, b in self._pairs])
        names = tuple(f"{scene.species[a]}-{scene.species[b]}" for a, b in self._pairs)

        def law(sums: Array) -> Array:
            densities = sums[HEAD:].reshape(len(numbers), -1) / (sums[FRAMES] * shells)
            of_all = densities.sum(axis=0, keepdims=True) / numbers.sum()
            return np.concatenate([of_all, densities / numbers[:, None]])

        g, errors = self.sums.estimate(law)
        r = 0.5 * (edges[1:] + edges[:-1])
        return RadialDistributionResult(
            scene, r, g[0], errors[0], names, g[1:], errors[1:], self.n_looks
        )


@dataclass(frozen=True, repr=False)
class RadialDistributionResult(Result):
    """g(r).

    r : (B,) middles of the bins [length].
    g, error : (B,) of all atoms, and its standard error.
    pairs : names of the pairs of species, P of them.
    g_of_pairs, errors_of_pairs : (P, B).
    n_frames : number of looks.
    """

    r: Array
    g: Array
    error: Array
    pairs: tuple[str, ...]
    g_of_pairs: Array
    errors_of_pairs: Array
    n_frames: int
    title = "radial distribution"

    def series(self) -> list[Series]:
        """See Result."""
        series = [Series("r", self.units.length, self.r), Series("g", "", self.g, self.error)]
        if len(self.pairs) > 1:
            of_pairs = zip(self.pairs, self.g_of_pairs, self.errors_of_pairs, strict=True)
            series += [Series(f"g_{pair}", "", *numbers) for pair, *numbers in of_pairs]
        return series

    def display_rows(self) -> Rows:
        """See Displayed."""
        length = self.units.length
        lines = [f"{len(self.r)} bins up to {self.r[-1]:.4g} {length}, {self.n_frames} frames"]
        for pair, g, errors in zip(self.pairs, self.g_of_pairs, self.errors_of_pairs, strict=True):
            if np.isnan(g).any():
                continue  # a pair of a species with a single atom
            first = beyond_spikes(g)
            k = first + int(np.argmax(g[first:]))
            highest = f"highest at {self.r[k]:.4g} {length}, {with_error(g[k], errors[k])}"
            if first:
                spike = self.r[np.argmax(g[:first])]
                highest += f", beyond a spike of {g[:first].max():.3g} at {spike:.4g} {length}"
            lines.append(f"{pair}: {highest}")
        return [("g(r)" * (k == 0), line) for k, line in enumerate(lines)]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        pairs = zip(self.pairs, self.g_of_pairs, self.errors_of_pairs, strict=True)
        curves = [Series(pair, "", *curve) for pair, *curve in pairs]
        panel.axhline(1.0, color="0.7", lw=0.8)
        self.draw_curves(panel, curves, "r", "g(r)")
        panel.set(title=f"{self.title}, {self.scene.frames(self.n_frames)}", xlim=(0.0, self.r[-1]))
        limit_to_neighbors(panel, self.r, self.g_of_pairs)


def beyond_spikes(g: Array) -> int:
    """The index of g(r), (B,), beyond the spikes of neighbors in a molecule; 0 without them.

    A spike is more than SPIKE times as high as all of g beyond a gap after it, where g is below GAP.
    """
    empty = g < GAP
    ends = np.flatnonzero(empty[:-1] & ~empty[1:]) + 1
    spikes = [end for end in ends if g[:end].max() > SPIKE * g[end:].max() > SPIKE * GAP]
    return int(spikes[-1]) if spikes else 0


def limit_to_neighbors(panel: Axes, r: Array, curves: Array) -> None:
    """Let a panel end above the highest of several g(r), (P, B), beyond spikes; a note says so where it cuts them."""
    curves = np.nan_to_num(curves)
    highest = max(float(g[beyond_spikes(g) :].max()) for g in curves) or 1.0
    panel.set_ylim(0.0, AIR * highest)
    peaks = [(float(r[np.argmax(g)]), float(g.max())) for g in curves if g.max() > AIR * highest]
    for k, (place, height) in enumerate(sorted(peaks)):
        panel.annotate(
            f" ↑ {height:.3g}",
            (place, 1.0 - 0.08 * k),
            xycoords=("data", "axes fraction"),
            va="top",
            fontsize=8,
            color="0.3",
            bbox={"color": "white", "pad": 0.5},
        )
