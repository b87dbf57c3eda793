"""When a list of neighbors must be built anew: the one rule for all lists."""

from abc import ABC, abstractmethod
from math import sqrt
from typing import NamedTuple

import numpy as np

from minimd.core.compiled.kernels import kernel
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell
from minimd.core.structure.errors import NonFiniteError

DEFAULT_SKIN = 0.12  # of the cutoff, if nothing is known about the speed of the atoms
LEAST_SKIN = 0.02  # of the cutoff
SKINS = np.geomspace(LEAST_SKIN, 1.0, 100)  # of the cutoff, to choose from
# ns per atom: a constant, and per atom in a cube as wide as the list reaches
STEP_COST = (16.0, 3.0)
BUILD_COST = (56.0, 7.0)  # ns per atom, likewise
CALLS_COST = 10_000.0  # ns of each build, however small the scene is


def best_skin(
    cutoff: float,
    density: float,
    displacement: float,
    n_atoms: int,
    layers: int = 1,
    work: float = 1.0,
) -> float:
    """The skin that makes a step cheapest [length].

        cost(s) = step(c̄) + build(c) / n,   c = ρ (r_c + s)³,   n = s/2 / d steps between two builds

    c̄ is the mean of ρ (r_c + s l/L)³ over the layers l = 1 … L of a list, taken into use one after the other.
    cutoff : r_c [length].
    density : ρ [1/length³].
    displacement : d, of the fastest atom in a step.
    layers : L.
    work : of a pair, in those of a Lennard-Jones pair; step(c̄) grows with it.
    The costs were measured on the Lennard-Jones liquid with cluster lists; the minimum is flat."""
    if not displacement > 0.0:
        return DEFAULT_SKIN * cutoff

    skins = SKINS * cutoff
    crowd = density * (cutoff + skins) ** 3
    reaches = [cutoff + skins * (layer / layers) for layer in range(1, layers + 1)]
    in_use = density * np.mean([reach**3 for reach in reaches], axis=0)

    builds = np.minimum(1.0, 2.0 * displacement / skins)  # in each step
    build = BUILD_COST[0] + BUILD_COST[1] * crowd + CALLS_COST / n_atoms
    cost = work * (STEP_COST[0] + STEP_COST[1] * in_use) + build * builds
    return float(skins[np.argmin(cost)])


class Built(NamedTuple):
    """What determines the order of a list, and so the rounding of its sums.
    skin : [length].
    positions : (N, 3) when it was built [length], a copy; None if there is no list that can be used.
    cell : Cell in which it was built, if that has been strained since.
    region : (7,) of its columns, see region_of in clusters; None if it has none."""

    skin: float
    positions: Array | None
    cell: Cell | None = None
    region: Array | None = None


class VerletList(ABC):
    """A list of all pairs within cutoff + skin, kept until an atom has moved by more than skin/2.

    Until then no pair that is not listed can have come within the cutoff: two atoms approach each other by at most the
    skin. True displacements count: an atom moved by a lattice vector has moved. L. Verlet, Phys. Rev. 159, 98 (1967).

    A list can follow a homogeneous strain F of cell and atoms, r → r F. Pairs that are not listed were farther apart
    than the reach R, so that they are now farther apart than s R, s being the smallest singular value of F, or less.
    So the list holds until an atom has moved, beside the strain, by more than (s R − r_c)/2.
    cutoff : [length].
    skin : [length], ≥ 0.
    n_builds : how often it was built.
    version : of the memory it lies in.
    limit2 : square of the distance that an atom may move before the list is outdated [length²]."""

    def __init__(self, cutoff: float, skin: float) -> None:
        self.cutoff = cutoff
        self.skin = skin
        self.n_builds = 0
        self.version = 0
        self._cell: Cell | None = None
        self._built_in: Cell | None = None
        self._stretch = 1.0  # s
        self._region: Array | None = None
        self.limit2 = self._limit2(skin)

    def _limit2(self, margin: float) -> float:
        """The square of (s R − r_c)/2, with R = r_c + margin; negative if no displacement is allowed."""
        if self.cutoff == np.inf:
            return float(np.finfo(float).max)  # until a position is not finite
        limit = 0.5 * margin * self._stretch - 0.5 * (1.0 - self._stretch) * self.cutoff
        return limit * limit if limit >= 0.0 else -1.0

    @abstractmethod
    def _build(self, positions: Array, cell: Cell) -> None:
        """List what is within cutoff + skin."""

    @abstractmethod
    def ready(self, positions: Array, cell: Cell) -> None:
        """Arrange memory for operations on these positions in this cell; a list of another cell counts no more."""

    @abstractmethod
    def update(self, positions: Array, cell: Cell) -> bool:
        """Build the list anew if it may miss a pair; True if it was built.
        Raises NonFiniteError if a position is not finite."""

    @abstractmethod
    def _built_at(self) -> Array:
        """Positions at the last build, (N, 3), a copy."""

    @abstractmethod
    def _strain(self, strain: Array, before: Cell, cell: Cell) -> None:
        """Positions of the last build become r F, F = strain (3, 3), lattice vectors of a cell new; limit2 is set."""

    def follow(self, cell: Cell) -> None:
        """Adapt the list to a cell that was strained with all positions. The result depends on the cell alone."""
        if self._cell is None or self._built_in is None:
            return
        is_same = cell.reduction is self._cell.reduction
        if not (is_same or np.array_equal(cell.reduction, self._cell.reduction)):
            self._cell = None  # other lattice vectors: a new list
            return
        strain = self._built_in.inverse @ cell.lattice
        self._stretch = least_stretch(strain)
        self._strain(strain, self._cell, cell)
        self._cell = cell

    def built(self) -> Built:
        """What build_again needs to make the same list."""
        if self._cell is None:
            return Built(self.skin, None, None, self._region)
        built_in = None if self._cell is self._built_in else self._built_in
        return Built(self.skin, self._built_at(), built_in, self._region)

    def build_again(self, built: Built, cell: Cell) -> None:
        """Build a list again; it must have the same skin."""
        self._cell = None
        self._region = built.region
        if built.positions is not None:
            self._build_in(cell if built.cell is None else built.cell, built.positions)
            if built.cell is not None:
                self.follow(cell)

    def _build_in(self, cell: Cell, positions: Array) -> None:
        self._stretch = 1.0
        self._build(positions, cell)
        self._cell = cell
        self._built_in = cell
        self.n_builds += 1

    def settle(self) -> None:  # noqa: B027 - there may be nothing to do
        """After operations: take note of what they have done to the list."""


@kernel
def least_stretch(strain):
    """A lower bound of the smallest singular value of F, (3, 3), exact if the rows of F are orthogonal:
    s² ≥ min_i (C_ii − Σ_j≠i |C_ij|) with C = F Fᵀ (circles of Gershgorin)."""
    least = np.inf
    for i in range(3):
        bound = 0.0
        for j in range(3):
            product = 0.0
            for c in range(3):
                product += strain[i, c] * strain[j, c]
            bound += product if i == j else -abs(product)
        least = min(least, bound)
    return sqrt(max(0.0, least))


@kernel
def any_moved(positions, reference, limit2):
    """True if an atom is farther than √limit2 from its reference position, or if its position is NaN.

    positions, reference : (N, 3) [length].
    limit2 : [length²]."""
    for i in range(positions.shape[0]):
        dx = positions[i, 0] - reference[i, 0]
        dy = positions[i, 1] - reference[i, 1]
        dz = positions[i, 2] - reference[i, 2]
        if not dx * dx + dy * dy + dz * dz <= limit2:
            return True
    return False


@kernel
def count_not_finite(positions):
    """How many atoms have a position that is not finite, (N, 3), and the first of them."""
    n_bad = 0
    first = -1
    for i in range(positions.shape[0]):
        if not np.isfinite(positions[i, 0] + positions[i, 1] + positions[i, 2]):
            first = i if n_bad == 0 else first
            n_bad += 1
    return n_bad, first


def raise_not_finite(positions: Array) -> None:
    """Raise NonFiniteError if positions (N, 3) are not all finite."""
    n_bad, first = count_not_finite(positions)
    if n_bad:
        raise NonFiniteError(
            f"positions of {n_bad} atoms are not finite; the first of them is atom {first}"
        )


def partners(pairs: Indices, n_atoms: int) -> tuple[Indices, Indices]:
    """Partners of each atom in pairs (P, 2): (start, values), those of atom a are values[start[a] : start[a + 1]]."""
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    return starts(both[:, 0], n_atoms), np.ascontiguousarray(both[:, 1])


def starts(first: Indices, n_atoms: int) -> Indices:
    """(N + 1,) int: in a table sorted by first, the rows of atom a are start[a] to start[a + 1] − 1."""
    start = np.zeros(n_atoms + 1, dtype=np.int64)
    np.cumsum(np.bincount(first, minlength=n_atoms), out=start[1:])
    return start
