"""The radial distribution functions of all pairs of species."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, Program, operation
from minimd.core.compiled.simd import lane, load
from minimd.core.compiled.simd.vector import count
from minimd.core.console.display import Rows
from minimd.core.console.words import listed, shown
from minimd.core.engine.engine import Engine
from minimd.core.forces.cluster_loop import separations
from minimd.core.neighbors.cluster_list import ClusterList
from minimd.core.neighbors.cluster_search import GHOST_BITS, LAYERS
from minimd.core.neighbors.clusters import DIMENSIONS
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_count, checked_flag
from minimd.core.structure.constraints import molecules_of
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
from minimd.observers.arguments import (
    ATOMS,
    argument,
    label,
    names,
    particles,
    positive,
    steps,
)
from minimd.observers.molecules import Molecules
from minimd.observers.motion import OF, of_molecules

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FRAMES, HEAD = range(2)  # places in the sums: number of frames, then V times the numbers of pairs
NO_PAIRS = np.zeros((0, 2), dtype=np.int64)
SPACINGS = 4.0  # in r_max if not given: four shells of neighbors
R_MAX = "largest distance; if not given, the smaller of 4 (V/N)^(1/d) and half the smallest height of the initial cell"
PAIRS = 'pairs of species, such as "O-O", or a list of them; all if not given'
INSIDE = "whether pairs of atoms of one molecule count, too; without bonds, or with a single molecule, all pairs count"


class PairCounting(
    ByAddress, namedtuple("PairCounting", "arrays labels kinds per_width beyond counts")
):
    """arrays : ClusterArrays of a list whose cutoff is r_max.
    labels : (slots, 2) int, species and molecule of the atoms in clusters.
    kinds : (2, S, S) int, the number of each pair of species, in two molecules and in one.
    per_width : 1/Δr [1/length].
    beyond : (n,) columns, one for each lane, of pairs farther away: a single one would wait for itself at each of them.
    counts : (K, P, columns) int, its numbers of pairs by kind and bin."""


@called_kernel
def count_pairs(counting, domain):
    """counts[domain, p, k] += number of pairs of kind p, with all images, with k Δr ≤ r < (k + 1) Δr, of the atoms of
    a domain with those of their rows."""
    arrays, labels, kinds, per_width, beyond, _ = counting
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
        species = labels[slot, 0]
        molecule = labels[slot, 1]

        for entry in range(np.uintp(rows.start[slot]), np.uintp(rows.stops[LAYERS - 1, slot])):
            now = rows.entries[entry]
            _, _, _, r2 = separations(coordinates, memory.far, now, at, lanes)
            places = min(np.sqrt(r2) * per_width, columns)
            other = np.uintp(ghosts.owner[first + np.intp(now & GHOST_BITS)]) * np.uintp(n_lanes)

            for k in range(np.uintp(n_lanes)):
                same = np.uintp(labels[other + k, 1] == molecule)
                kind = kinds[same, species, labels[other + k, 0]]
                counts[np.uintp(kind), np.uintp(lane(places, k))] += 1

    return GO_ON


class RadialDistribution(Accumulator):
    """g(r) of pairs of species, with all images within r_max.

        g_ab(r) = ⟨V n_ab(r)⟩ / (N_ab · 4π/3 [(r + Δr/2)³ − (r − Δr/2)³])

    n_ab(r) is the number of pairs in a bin. V is the volume at each look; it may change. Where bonds or rigid lengths
    connect the atoms of several molecules, pairs of atoms of one molecule, and of its images, are left out unless
    intramolecular=True. Of all pairs, N_ab is the number of those that count, so that g goes to 1 where distances are
    those of independent molecules, also if these are few:

        N_ab = (N_a N_b − Σ n_a n_b) / (1 + δ_ab)           sum over molecules, with n_a atoms of species a in each

    With all pairs Σ n_a n_b is δ_ab N_a, as for molecules of one atom.

    Raises ValueError for arguments out of range; when a run begins, for a cell that is not periodic in all directions,
    a single atom or molecule, or pairs that do not exist.
    """

    kind = "radial-distribution"
    convention = 2  # without pairs of one molecule
    fits_plane = True
    r_max: float | None = argument(positive, R_MAX, None, "length")
    n_bins: int = argument(checked_count, "number of bins", 200)
    every: int = steps(100)
    pairs: str | list[str] | None = argument(names, PAIRS, None)
    intramolecular: bool = argument(checked_flag, INSIDE, False)
    of: str = argument(particles, OF, ATOMS)
    name: str = label()
    reach: float = field(init=False, default=0.0)  # r_max
    # whether pairs of one molecule are left out
    is_between: bool = field(init=False, default=False)
    # of the pairs that count: names, numbers of species, N_ab
    names_of_pairs: list[str] = field(init=False, default_factory=list)
    ends: list[list[int]] = field(init=False, default_factory=list)
    numbers: list[int] = field(init=False, default_factory=list)

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and deepcopy: a copy makes a list of its own."""
        return {**vars(self), "_list": None}

    def _begin(self, engine: Engine) -> None:
        system = engine.system
        names, labels, _ = self._particles(system)
        if system.volume is None or len(labels) < 2:
            raise ValueError(
                f"g(r) needs at least two {self.of}, and a cell that is periodic in all directions; "
                f"this run has {system!r}"
            )
        cell = system.cell
        lowest = float(cell.heights[cell.pbc].min())
        self.reach = self.r_max or min(SPACINGS * cell.spacing(len(labels)), lowest / 2.0)

        species, molecules = labels.T
        self.is_between = not self.intramolecular and 1 < int(molecules.max()) + 1 < len(system)
        total = np.bincount(species)
        within = np.diag(total)
        if self.is_between:
            counts = _counted(species, molecules)
            within = counts.T @ counts
        numbers = np.outer(total, total) - within

        ends = [*combinations_with_replacement(range(len(names)), 2)]
        if self.pairs is not None:
            known = {f"{names[a]}-{names[b]}": (a, b) for a, b in ends}
            known |= {f"{names[b]}-{names[a]}": (a, b) for a, b in ends}
            ends = [known[pair] for pair in self.pairs if pair in known]
            if len(set(ends)) < len(self.pairs):
                raise ValueError(
                    f"pairs must be different ones of the species {listed(names)}, such as "
                    f"'{names[0]}-{names[-1]}'; pairs = {shown(self.pairs)}"
                )

        self.ends = [[*pair] for pair in ends]
        self.numbers = [int(numbers[a, b]) // (1 + (a == b)) for a, b in ends]
        self.names_of_pairs = [*(self.pairs or (f"{names[a]}-{names[b]}" for a, b in ends))]

    def _particles(self, system: System) -> tuple[list[str], Indices, Molecules | None]:
        """Names of the species, (n, 2) species and molecule of each particle; and the molecules, if these are meant."""
        if self.of == ATOMS:
            labels = np.column_stack([system.species_index, molecules_of(system)])
            return [*map(str, system.species_names)], labels, None
        molecules = Molecules(system)
        formulas, kinds = _formulas(system, molecules.label)
        return formulas, np.column_stack([kinds, np.arange(len(kinds))]), molecules

    def _laid_out(self, scene: ObservedRun) -> None:
        n = len(self.numbers)
        are_pairs = all(len(pair) == 2 and min(pair) >= 0 for pair in self.ends)
        if not (are_pairs and n == len(self.names_of_pairs) == len(self.ends)):
            raise ValueError(f"{self.name} cannot have {n} numbers of the pairs {self.ends}")
        self._known: tuple[Indices, Indices, Molecules | None] | None = None  # labels, kinds
        self._list: tuple[int, ClusterList, DirectCalls] | None = None  # of a number of atoms
        self.sums = BlockedSums(HEAD + n * self.n_bins)

    def _look(self, engine: Engine) -> None:
        counts = self._counts(engine)
        self.sums.total[FRAMES] += 1.0
        self.sums.total[HEAD:] += float(engine.system.volume or 0.0) * counts.ravel()

    def _kinds(self, n_species: int) -> Indices:
        """See PairCounting; the last number is that of pairs that do not count."""
        n = len(self.ends)
        kinds = np.full((2, n_species, n_species), n)

        for p, (a, b) in enumerate(self.ends):
            kinds[:, a, b] = p
            kinds[:, b, a] = p

        if self.is_between:
            kinds[1] = n
        return kinds

    def _counts(self, engine: Engine) -> Array:
        """(P, B) numbers of pairs, from a list of clusters; a cell too small for one is repeated."""
        system = engine.system
        pool = engine.interactions.pool
        if self._known is None:
            names, labels, molecules = self._particles(system)
            self._known = labels, self._kinds(len(names)), molecules

        labels, kinds, molecules = self._known
        positions: Array = system.positions
        if molecules is not None:
            _, first = np.unique(molecules.label, return_index=True)
            whole = molecules.whole(system)
            positions = of_molecules(whole, system.masses, molecules.label)[first]

        cell = system.cell
        n = np.where(cell.pbc, np.ceil(self.reach / cell.heights), 1).astype(np.int64)
        if n.max() > 1:
            steps = np.stack(np.meshgrid(*map(np.arange, n)), axis=-1).reshape(-1, 1, 3)
            positions = (steps @ cell.lattice + positions).reshape(-1, 3)
            labels = np.tile(labels, (n.prod(), 1))
            cell = Cell(n[:, None] * cell.lattice, cell.pbc, cell.dimensions)

        if self._list is None or self._list[0] != len(positions):
            clusters = ClusterList(len(positions), self.reach, 0.0, NO_PAIRS, False, pool)
            self._list = (len(positions), clusters, DirectCalls())
        _, clusters, calls = self._list
        clusters.update(positions, cell)
        n_lanes = clusters.lanes.size
        shape = (clusters.n_domains, len(self.numbers) + 1, self.n_bins + n_lanes)
        counting = PairCounting(
            arrays=clusters.arrays,
            labels=labels[clusters.clusters.atom[: clusters.n_clusters * n_lanes]],
            kinds=kinds,
            per_width=self.n_bins / self.reach,
            beyond=self.n_bins + np.arange(n_lanes, dtype=np.float64),
            counts=np.zeros(shape, dtype=np.int64),
        )
        count_all = operation(calls, count_pairs, counting, clusters.n_domains)
        Program(lambda: [count_all], lambda: 0, pool).run()
        return counting.counts.sum(axis=0)[:-1, : self.n_bins] / n.prod()

    def result(self) -> RadialDistributionResult:
        """g(r) so far, with standard errors.
        Raises ValueError before the first look."""
        scene = self.answered()
        edges = np.linspace(0.0, self.reach, self.n_bins + 1)
        shells = np.pi * np.diff(edges**2)
        if scene.dimensions == 3:
            shells = 4.0 / 3.0 * np.pi * np.diff(edges**3)
        numbers = np.array(self.numbers)

        def law(sums: Array) -> Array:
            densities = sums[HEAD:].reshape(len(numbers), -1) / (sums[FRAMES] * shells)
            of_all = densities.sum(axis=0, keepdims=True) / numbers.sum()
            return np.concatenate([of_all, densities / numbers[:, None]])

        g, errors = self.sums.estimate(law)
        r = 0.5 * (edges[1:] + edges[:-1])
        names = tuple(self.names_of_pairs)
        return RadialDistributionResult(
            scene, r, g[0], errors[0], names, g[1:], errors[1:], self.n_looks, self.is_between
        )


def _counted(species: Indices, molecules: Indices) -> Indices:
    """(M, S) numbers of atoms of each molecule.
    species, molecules : (N,) of the atoms."""
    counts = np.zeros((molecules.max() + 1, species.max() + 1), dtype=np.int64)
    np.add.at(counts, (molecules, species), 1)
    return counts


def _formulas(system: System, molecules: Indices) -> tuple[list[str], Indices]:
    """The different formulas of molecules, such as "H2O", and (M,) the number of that of each."""
    counts = _counted(system.species_index, molecules)
    formulas, kinds = np.unique(counts, axis=0, return_inverse=True)
    names = []

    for numbers in formulas.tolist():
        counted = zip(system.species_names, numbers, strict=True)
        names.append("".join(f"{name}{n if n > 1 else ''}" for name, n in counted if n))

    return names, kinds.ravel()


@dataclass(frozen=True, repr=False)
class RadialDistributionResult(Result):
    """g(r); r, g = result gives the two.

    r : (B,) middles of the bins [length].
    g, error : (B,) of all these pairs, and its standard error.
    pairs : names of the pairs of species, P of them.
    g_of_pairs, errors_of_pairs : (P, B).
    n_frames : number of looks.
    is_between : whether pairs of one molecule are left out.

    numbers() has the first peak of each pair: r_peak, see first_peak, which leaves out the first bin here; g_peak in
    its highest bin, and g_peak_error. Names end in that of the pair if there are several.
    """

    r: Array
    g: Array
    error: Array
    pairs: tuple[str, ...]
    g_of_pairs: Array
    errors_of_pairs: Array
    n_frames: int
    is_between: bool = False

    @property
    def title(self) -> str:  # type: ignore[override]
        """See Result."""
        return "radial distribution" + " between molecules" * self.is_between

    def __iter__(self) -> Iterator[Array]:
        return iter((self.r, self.g))

    def peaks(self) -> dict[str, tuple[float, float, float]]:
        """Of each pair that was seen, by name: r, g and the standard error of g at its first peak."""
        peaks = {}
        for pair, g, errors in zip(self.pairs, self.g_of_pairs, self.errors_of_pairs, strict=True):
            if g[1:].max(initial=0.0) > 0.0:  # not NaN, as of a species with a single atom
                place, k = first_peak(self.r[1:], g[1:])
                peaks[pair] = place, float(g[1 + k]), float(errors[1 + k])
        return peaks

    def numbers(self) -> dict[str, float]:
        """See Result."""
        numbers: dict[str, float] = {}
        for pair, peak in self.peaks().items():
            end = f"_{pair}" if len(self.pairs) > 1 else ""
            names = f"r_peak{end}", f"g_peak{end}", f"g_peak{end}_error"
            numbers.update(zip(names, peak, strict=True))
        return numbers

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
        left_out = ", without pairs of one molecule" * self.is_between
        width = 2.0 * self.r[0]
        lines = [
            f"{len(self.r)} bins of {width:.3g} {length}, {self.scene.frames(self.n_frames)}{left_out}"
        ]
        for pair, (r, g, error) in self.peaks().items():
            line = f"{pair}: first peak at {r:.4g} {length}, {with_error(g, error)}"
            if g - 1.0 <= 2.0 * error:
                line += ", IS NOISE: there are too few pairs, or frames"
            lines.append(line)
        return [("g(r)" * (k == 0), line) for k, line in enumerate(lines)]

    def draw(self, panel: Axes) -> None:
        """See Result."""
        pairs = zip(self.pairs, self.g_of_pairs, self.errors_of_pairs, strict=True)
        curves = [Series(pair, "", *curve) for pair, *curve in pairs]
        panel.axhline(1.0, color="0.7", lw=0.8)
        is_one_of_several = len(curves) == 1 and len(self.scene.species) > 1
        of_pair = f" of {self.pairs[0]}" if is_one_of_several else ""
        self.draw_curves(panel, curves, "r", f"g(r){of_pair}")
        panel.set(title=f"{self.title}, {self.scene.frames(self.n_frames)}", xlim=(0.0, self.r[-1]))
