"""The radial distribution functions of all pairs of species."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel
from minimd.console.display import Rows
from minimd.engine.engine import Engine
from minimd.neighbors.search import atoms_in_reach, bins_of, make_grid, sort_into_bins
from minimd.observers.accumulator import Accumulator, BlockedSums, ObservedRun, Result, Series
from minimd.observers.arguments import argument, label, positive, steps
from minimd.structure.checks import checked_count
from minimd.structure.statistics import with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
FRAMES, HEAD = 0, 1  # places in the sums: number of frames, then V times the numbers of pairs
SPREAD = 8  # columns for pairs that are too far away: one of them would wait for itself at each of these pairs
SPACINGS = 4.0  # in r_max if not given: four shells of neighbors
R_MAX = "largest distance; if not given 4 (V/N)^(1/3), but at most half the smallest height of the cell at the start"


@kernel
def count_pairs(positions, species, bins, pair_of_species, width, counts):
    """counts[p, k] += number of pairs of kind p = pair_of_species[a, b] with k · width ≤ r < (k + 1) · width, with all
    images. The last SPREAD columns count pairs farther away, of those that were looked at.

    positions : (3, N) [length], in the order of the bins and inside the cell.  bins : see neighbors.search.
    species : (N,) int, in the same order.
    """
    size, bin_start, n_bins = bins.counts, bins.bin_start, counts.shape[1] - SPREAD
    per_width, ranges, room = 1.0 / width, np.empty((bins.forward.shape[0] + 1, 3), dtype=np.int64), 0
    near, kind_of, places = np.empty((3, room)), np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int32)
    for bin_x in range(size[0]):
        for bin_y in range(size[1]):
            for bin_z in range(size[2]):
                own = (bin_x * size[1] + bin_y) * size[2] + bin_z
                if bin_start[own] == bin_start[own + 1]:
                    continue
                n_ranges, n = atoms_in_reach(bin_x, bin_y, bin_z, bins, ranges), 0
                for k in range(n_ranges):
                    n += ranges[k, 1] - ranges[k, 0]
                if n > room:
                    room = 2 * n
                    near, kind_of = np.empty((3, room)), np.empty(room, dtype=np.int64)
                    places = np.empty(room, dtype=np.int32)
                n = 0
                for k in range(n_ranges):  # side by side, for vectors; those of the bin itself come first
                    t = bins.translations[ranges[k, 2]]
                    for j in range(ranges[k, 0], ranges[k, 1]):
                        for c in range(3):
                            near[c, n] = positions[c, j] + t[c]
                        kind_of[n] = species[j]
                        n += 1
                for i in range(bin_start[own], bin_start[own + 1]):
                    x, y, z, kinds = positions[0, i], positions[1, i], positions[2, i], pair_of_species[species[i]]
                    first = i + 1 - bin_start[own]
                    xs, ys, zs, to = near[0, first:n], near[1, first:n], near[2, first:n], places[first:n]
                    for k in range(to.size):
                        dx, dy, dz = xs[k] - x, ys[k] - y, zs[k] - z
                        part = np.sqrt(dx * dx + dy * dy + dz * dz) * per_width
                        to[k] = np.int32(part if part < n_bins else n_bins + k % SPREAD)
                    of = kind_of[first:n]
                    for k in range(to.size):
                        counts[kinds[of[k]], to[k]] += 1


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

    def _begin(self, engine: Engine) -> None:
        system = engine.system
        if system.volume is None or len(system) < 2:
            needs = "at least two atoms, and a cell that is periodic in all directions"
            raise ValueError(f"g(r) needs {needs}; this run has {system!r}")
        spacing = (system.volume / len(system)) ** (1.0 / 3.0)
        self.reach = self.r_max or min(SPACINGS * spacing, float(system.cell.heights.min()) / 2.0)

    def _laid_out(self, scene: ObservedRun) -> None:
        n = len(scene.numbers)
        self._pairs = [(a, b) for a in range(n) for b in range(a, n)]
        self._kinds = np.zeros((n, n), dtype=np.int64)
        for p, (a, b) in enumerate(self._pairs):
            self._kinds[a, b] = self._kinds[b, a] = p
        self._counts = np.zeros((len(self._pairs), self.n_bins + SPREAD), dtype=np.int64)
        self.sums = BlockedSums(HEAD + len(self._pairs) * self.n_bins)

    def _look(self, engine: Engine) -> None:
        system, cell = engine.system, engine.system.cell
        grid = make_grid(cell, system.positions, self.reach)
        order, offsets, bin_start = sort_into_bins(system.positions, cell.lattice, cell.inverse, cell.pbc, grid)
        local, bins = np.ascontiguousarray((system.positions[order] + offsets).T), bins_of(cell, grid, bin_start)
        self._counts[:] = 0
        count_pairs(local, system.species_index[order], bins, self._kinds, self.reach / self.n_bins, self._counts)
        self.sums.total[FRAMES] += 1.0
        self.sums.total[HEAD:] += float(system.volume or 0.0) * self._counts[:, :-SPREAD].ravel()

    def result(self) -> RadialDistributionResult:
        """g(r) so far, with standard errors.  Raises ValueError before the first look."""
        scene = self.answered()
        edges = np.linspace(0.0, self.reach, self.n_bins + 1)
        shells = 4.0 / 3.0 * np.pi * np.diff(edges**3)
        n = scene.numbers
        numbers = np.array([n[a] * (n[b] - (a == b)) / (1.0 + (a == b)) for a, b in self._pairs])
        names = tuple(f"{scene.species[a]}-{scene.species[b]}" for a, b in self._pairs)

        def law(sums: Array) -> Array:
            found = sums[HEAD:].reshape(len(numbers), -1) / (sums[FRAMES] * shells)
            return np.concatenate([found.sum(axis=0, keepdims=True) / numbers.sum(), found / numbers[:, None]])

        (total, *g), (total_error, *errors) = self.sums.estimate(law)
        r = 0.5 * (edges[1:] + edges[:-1])
        return RadialDistributionResult(
            scene, r, total, total_error, names, np.array(g), np.array(errors), self.n_looks
        )


@dataclass(frozen=True, repr=False)
class RadialDistributionResult(Result):
    """g(r).

    r : (B,) middles of the bins [length].  g, error : (B,) of all atoms, and its standard error.
    pairs : names of the pairs of species, P of them.  g_of_pairs, errors_of_pairs : (P, B).
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
        of_pairs = zip(self.pairs, self.g_of_pairs, self.errors_of_pairs, strict=True)
        found = [Series(f"g_{pair}", "", g, error) for pair, g, error in of_pairs] if len(self.pairs) > 1 else []
        return [Series("r", self.units.length, self.r), Series("g", "", self.g, self.error), *found]

    def display_rows(self) -> Rows:
        """See Displayed."""
        k, length = int(np.argmax(self.g)), self.units.length
        highest = f"highest at {self.r[k]:.4g} {length}, {with_error(self.g[k], self.error[k])}"
        return [("g(r)", f"{len(self.r)} bins up to {self.r[-1]:.4g} {length}, {self.n_frames} frames; {highest}")]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        panel.axhline(1.0, color="0.7", lw=0.8)
        self.draw_curves(panel, dict(zip(self.pairs, self.g_of_pairs, strict=True)), "r", "g(r)")
        panel.set(title=f"{self.title}, {self.n_frames} frames", xlim=(0.0, self.r[-1]), ylim=(0.0, None))
