"""The simulation cell: any three lattice vectors, each direction periodic or open, and periodic images."""

from collections import namedtuple
from dataclasses import dataclass, field
from itertools import compress, product
from math import sqrt
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import kernel, scalar
from minimd.core.compiled.machine import EPS
from minimd.core.console.display import Displayed, Rows, as_text
from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import LARGEST, SMALLEST, checked_array, checked_numbers
from minimd.core.structure.vectors import along, combined, follow_lattice, inverse_of, transformed

# images among which one length is searched for: 40 cells in each of three directions
MOST_IMAGES = 2**16
# smallest singular value of the unit lattice vectors below which they count as linearly dependent
FLAT = 1e-9
OPEN = (
    "in a direction that does not repeat give length 0, or any length and pbc=False there, such as "
    "pbc=(True, True, False) of a slab"
)
# combinations of vectors that could be shorter
COMBINED = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
ALL = np.ones(3, dtype=bool)  # directions
IN_PLANE = np.array([True, True, False])
NAMES_OF_VOLUME = {2: "area", 3: "volume"}  # by dimensions
SHORTER = 1.0 - 1e-12  # a lattice vector is replaced only by one shorter than rounding can explain


@dataclass(frozen=True, repr=False)
class Cell(Displayed):
    """Lattice vectors and periodicity, checked, with the reduced lattice that searches use.

    Made by Cell.of; never changed.

    Attributes
    ----------
    vectors : (3, 3) array [length]; rows are the lattice vectors as given, zeros where there is none.
    pbc : (3,) bool; direction k repeats with vectors[k].
    lattice : (3, 3) array [length]; the same lattice from its shortest vectors; an open direction holds a unit vector
        perpendicular to the periodic ones, whatever vectors says there.
    reduction : (3, 3) int; lattice = reduction @ vectors on periodic rows, zero on open ones.
    inverse : (3, 3) array [1/length]; positions @ inverse are fractional coordinates in lattice.
    dimensions : 3, or 2 of a plane, z = 0, in which all atoms lie and move: its third direction is open.
    heights : (3,) array [length]; distance of the two faces across each direction of lattice.
    volume : of the cell [length³], of a plane its area [length²]; None unless all its directions are periodic.
    safe_distance2 : squared length below which a vector is certainly its own minimum image:
        (smallest periodic height/2)² [length²]; infinite if there is none.
    """

    vectors: Array
    pbc: NDArray[np.bool_]
    dimensions: int = 3
    lattice: Array = field(init=False)
    reduction: Indices = field(init=False)
    inverse: Array = field(init=False)
    heights: Array = field(init=False)
    volume: float | None = field(init=False)
    safe_distance2: float = field(init=False)

    def __post_init__(self) -> None:
        self.__dict__.update(vectors=_as_matrix(self.vectors), pbc=_as_flags(self.pbc))
        _check_independent(self.vectors, self.pbc)
        if self.dimensions == 2:
            _check_plane(self.vectors, self.pbc)
        self._complete(*_reduced(self.vectors, self.pbc))

    def _complete(self, lattice: Array, reduction: Indices) -> None:
        inverse, heights, determinant = faces_of(lattice)
        periodic = list(compress(heights.tolist(), self.pbc.tolist()))
        self.__dict__.update(
            lattice=lattice,
            reduction=reduction,
            inverse=inverse,
            heights=heights,
            # the open direction of a plane holds a unit vector
            volume=abs(determinant) if len(periodic) == self.dimensions else None,
            safe_distance2=(0.5 * min(periodic, default=np.inf)) ** 2,
        )
        self.__setstate__(self.__dict__)

    def __setstate__(self, state: dict) -> None:
        """Arrays are read-only, in a copy too, where NumPy forgets it: kernels are not compiled for a second kind."""
        self.__dict__.update(state)
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @classmethod
    def of(
        cls, vectors: ArrayLike | None, pbc: ArrayLike | None = None, planar: bool = False
    ) -> "Cell":
        """A cell from one length, three lengths or a (3, 3) array of rows; by default pbc is True where one is given.
        Of a plane two lengths, a (2, 2) array and two bools do, too.
        Raises ValueError if the shape is wrong, a number is masked, complex or not finite, pbc is neither one bool nor
        three, a periodic direction has no vector, or the periodic vectors are linearly dependent."""
        if planar:
            return cls(*_plane_of(vectors, pbc), dimensions=2)
        matrix = _as_matrix(vectors)
        return cls(matrix, np.any(matrix != 0.0, axis=1) if pbc is None else _as_flags(pbc))

    @classmethod
    def of_reduction(cls, vectors: Array, reduction: Indices) -> "Cell":
        """A cell whose reduced lattice is known, reduction @ vectors; periodic in all directions, those of a plane if
        the last row of the reduction is zero."""
        cell = object.__new__(cls)
        pbc = ALL if reduction[2].any() else IN_PLANE
        cell.__dict__.update(vectors=np.array(vectors), pbc=pbc, dimensions=int(pbc.sum()))
        cell._complete(lattice_of(cell.vectors, reduction), reduction)
        return cell

    def with_vectors(self, vectors: Array) -> "Cell":
        """A cell with other vectors, (3, 3), and the same periodicity."""
        return Cell(vectors, self.pbc, self.dimensions)

    def strained(self, vectors: Array) -> "Cell":
        """The cell, which has a volume, after a small change of its vectors; the reduction stays while it is one."""
        cell = Cell.of_reduction(vectors, self.reduction)
        return cell if is_reduced(cell.lattice) else self.with_vectors(vectors)

    def __repr__(self) -> str:
        plane = "" if self.dimensions == 3 else ", dimensions=2"
        return f"Cell({self.vectors.tolist()}, pbc={self.pbc.tolist()}{plane})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        if not self.vectors.any():
            return [("cell", "none")]
        rows = []
        for k, name in enumerate(("cell a", "b", "c")):
            is_open = "" if self.pbc[k] else ", open"
            rows.append((name, f"{as_text(tuple(self.vectors[k].tolist()))}{is_open}"))
        if self.dimensions == 2:
            rows[2] = ("plane", "z = 0")
        if self.volume is not None:
            rows.append((NAMES_OF_VOLUME[self.dimensions], f"{self.volume:.10g}"))
        return rows

    def spacing(self, n: int) -> float:
        """(V/n)^(1/d), the distance of n particles spread evenly over a cell with a volume [length]."""
        return float((self.volume or 0.0) / n) ** (1.0 / self.dimensions)

    @property
    def is_periodic(self) -> bool:
        """True if any direction repeats."""
        return bool(self.pbc.any())

    def projected(self, vectors: Array) -> Array:
        """Vectors, (N, 3), in a plane without their z."""
        return vectors * (np.arange(3) < self.dimensions)

    def wrapped(self, positions: Array) -> Array:
        """Positions moved by lattice vectors into the cell spanned by vectors, where it is periodic; a new array."""
        full = np.where(self.pbc[:, None], self.vectors, self.lattice)
        cells = np.floor(positions @ np.linalg.inv(full))
        return positions - np.where(self.pbc, cells, 0.0) @ full

    def follow(self, cell: "Cell", translations: Array) -> None:
        """Lattice vectors, (n, 3) or in blocks (n, 3, m), become the same multiples of those of a cell, in place."""
        follow_lattice(translations, self.vectors, cell.vectors)

    def same_as(self, other: "Cell") -> bool:
        """True if vectors and periodicity are equal to the last bit."""
        return self is other or (
            np.array_equal(self.vectors, other.vectors)
            and np.array_equal(self.pbc, other.pbc)
            and self.dimensions == other.dimensions
        )


class Images(ByAddress, namedtuple("Images", "lattice inverse pbc safe_distance2")):
    """What kernels need to know about a cell to find images: attributes of Cell, the last of them as an array (1,).
    The arrays stay the same when the scene gets another cell, see take."""

    @classmethod
    def of(cls, cell: Cell) -> Self:
        """Those of a cell."""
        images = cls(np.empty((3, 3)), np.empty((3, 3)), np.empty(3, dtype=np.bool_), np.empty(1))
        images.take(cell)
        return images

    def take(self, cell: Cell) -> None:
        """Those of another cell."""
        for name, array in zip(self._fields, self, strict=True):
            array[:] = getattr(cell, name)


@kernel
def lattice_of(vectors, reduction):
    """reduction @ vectors, (3, 3) both; of a plane with the normal behind."""
    lattice = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for c in range(3):
                lattice[i, c] += reduction[i, j] * vectors[j, c]
    if not reduction[2].any():
        lattice[2, 2] = 1.0
    return lattice


@kernel
def faces_of(lattice):
    """The inverse of a lattice, the distances of the two faces across each vector, (3,) [length], the determinant."""
    inverse, determinant = inverse_of(lattice)
    heights = np.empty(3)
    for k in range(3):
        x, y, z = inverse[0, k], inverse[1, k], inverse[2, k]
        heights[k] = 1.0 / sqrt(x * x + y * y + z * z)
    return inverse, heights, determinant


@kernel
def is_reduced(lattice):
    """Whether no combination of lattice vectors is shorter than one of them (Minkowski's conditions)."""
    for i, j, k in COMBINED:
        combined2 = _length2(0.0, 0.0, 0.0, i, j, k, lattice)
        for d, times in enumerate((i, j, k)):
            x, y, z = lattice[d, 0], lattice[d, 1], lattice[d, 2]
            if times != 0 and combined2 < SHORTER * (x * x + y * y + z * z):
                return False
    return True


@scalar
def minimum_image(dx, dy, dz, lattice, inverse, pbc, safe_distance2):
    """Integers (a, b, c) for which d + (a, b, c) · lattice is shortest. A vector shorter than half the smallest height
    is its own minimum image. Otherwise the fractional coordinates are rounded. A result as short as that is right; a
    longer one is compared with its 26 neighbors, which suffices in a reduced lattice."""
    if dx * dx + dy * dy + dz * dz <= safe_distance2:
        return 0.0, 0.0, 0.0
    a, b, c = transformed((dx, dy, dz), inverse)
    a = -np.rint(a) if pbc[0] else 0.0
    b = -np.rint(b) if pbc[1] else 0.0
    c = -np.rint(c) if pbc[2] else 0.0
    shortest2 = _length2(dx, dy, dz, a, b, c, lattice)
    if shortest2 <= safe_distance2:
        return a, b, c
    best = (a, b, c)

    for i in range(-int(pbc[0]), int(pbc[0]) + 1):
        for j in range(-int(pbc[1]), int(pbc[1]) + 1):
            for k in range(-int(pbc[2]), int(pbc[2]) + 1):
                length2 = _length2(dx, dy, dz, a + i, b + j, c + k, lattice)
                if length2 < shortest2:
                    shortest2 = length2
                    best = (a + i, b + j, c + k)

    return best


@scalar
def nearest_translation(separation, images):
    """The translation (x, y, z) that makes a separation (x, y, z) + translation shortest [length].
    images : Images."""
    lattice, inverse, pbc, safe_distance2 = images
    x, y, z = separation
    a, b, c = minimum_image(x, y, z, lattice, inverse, pbc, safe_distance2[0])
    return combined(1.0, combined(a, lattice[0], b, lattice[1]), c, lattice[2])


@scalar
def _length2(dx, dy, dz, a, b, c, lattice):
    x = dx + a * lattice[0, 0] + b * lattice[1, 0] + c * lattice[2, 0]
    y = dy + a * lattice[0, 1] + b * lattice[1, 1] + c * lattice[2, 1]
    z = dz + a * lattice[0, 2] + b * lattice[1, 2] + c * lattice[2, 2]
    return x * x + y * y + z * z


@kernel
def minimum_image_translations(
    positions, first, second, lattice, inverse, pbc, safe_distance2, translations
):
    """translations[p] = the lattice vector that makes r_j − r_i + translation shortest, for fixed pairs (i, j)
    = (first, second)[p].
    positions : (N, 3) [length].
    first, second : (P,) int.
    translations : (P, 3) [length], lattice vectors, such as zeros or the previous ones;
        kept where they are still certainly right."""
    for p in range(np.uintp(first.size)):  # unsigned: no check for indices that count from the end
        i, j = np.uintp(first[p]), np.uintp(second[p])
        dx = positions[j, 0] - positions[i, 0]
        dy = positions[j, 1] - positions[i, 1]
        dz = positions[j, 2] - positions[i, 2]
        x, y, z = dx + translations[p, 0], dy + translations[p, 1], dz + translations[p, 2]
        if x * x + y * y + z * z <= safe_distance2:
            continue
        a, b, c = minimum_image(dx, dy, dz, lattice, inverse, pbc, safe_distance2)
        for k in range(3):
            translations[p, k] = along((a, b, c), lattice, k)


def nearest_images(positions: Array, cell: Cell, pairs: Indices) -> Array:
    """(K, 3) lattice vectors [length] that make r_j − r_i of each pair shortest."""
    translations = np.zeros((len(pairs), 3))
    if cell.is_periodic:
        first = np.ascontiguousarray(pairs[:, 0])
        second = np.ascontiguousarray(pairs[:, 1])
        lattice = cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2
        minimum_image_translations(positions, first, second, *lattice, translations)
    return translations


def nearest_vectors(positions: Array, cell: Cell, pairs: Indices) -> Array:
    """(K, 3) r_j − r_i of each pair, to the nearest image [length]."""
    return positions[pairs[:, 1]] - positions[pairs[:, 0]] + nearest_images(positions, cell, pairs)


def images_of_length(positions: Array, cell: Cell, pairs: Indices, lengths: Array) -> Array:
    """(K, 3) lattice vectors [length] for which |r_j − r_i| of each pair is closest to its length. Up to half the cell
    these are the nearest images. Raises ValueError for a length that reaches over more than MOST_IMAGES."""
    translations = nearest_images(positions, cell, pairs)

    for k in np.flatnonzero(lengths**2 >= cell.safe_distance2):
        nearest = positions[pairs[k, 1]] - positions[pairs[k, 0]] + translations[k]
        reach = np.where(cell.pbc, (lengths[k] + np.linalg.norm(nearest)) // cell.heights + 1, 0)
        n_images = np.prod(2.0 * reach + 1.0)
        if n_images > MOST_IMAGES:
            raise ValueError(
                f"lengths[{k}] = {lengths[k]:g} reaches over {n_images:.1e} images of the cell, which is only "
                f"{cell.heights[cell.pbc].min():.3g} high; at most {MOST_IMAGES} images are possible: reduce the length"
            )

        steps = np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij")
        others = np.stack(steps, axis=-1).reshape(-1, 3) @ cell.lattice
        distances = np.linalg.norm(nearest + others, axis=1)
        translations[k] += others[np.argmin(np.abs(distances - lengths[k]))]

    return translations


def _as_matrix(vectors: ArrayLike | None) -> Array:
    if vectors is None:
        return np.zeros((3, 3))
    if isinstance(vectors, list | tuple) and any(row is None for row in vectors):
        raise ValueError(f"cell must hold numbers; cell = {shown(vectors)}: {OPEN}")
    expected = "one length, three lengths or a (3, 3) array of rows"
    array = checked_numbers("cell", vectors, expected)
    if array.ndim == 0 or array.shape == (3,):
        if (array < 0.0).any():
            raise ValueError(f"lengths of a cell must not be negative; cell = {array.tolist()}")
        array = np.diag(np.broadcast_to(array, 3)).copy()
    if array.shape != (3, 3):
        raise ValueError(f"cell must be {expected}; its shape is {array.shape}: {OPEN}")
    if not np.isfinite(array).all():
        raise ValueError(f"cell must be finite; cell = {array.tolist()}: {OPEN}")
    return array


def _plane_of(vectors: Any, pbc: Any) -> tuple[Array, NDArray[np.bool_]]:
    """(3, 3) lattice vectors of a plane and (3,) flags. Its third vector, of files, is as long as its longest."""
    numbers = None if vectors is None else np.asarray(vectors)
    matrix = np.zeros((3, 3))
    if numbers is not None and numbers.shape in [(), (2,), (2, 2)]:
        rows = checked_numbers("cell", vectors, "one length, two lengths or a (2, 2) array of rows")
        matrix[:2, :2] = rows if rows.ndim == 2 else np.diag(np.broadcast_to(rows, 2))
        matrix = _as_matrix(matrix)
    else:
        matrix = _as_matrix(vectors)
    if not matrix[2].any():
        matrix[2, 2] = np.linalg.norm(matrix, axis=1).max()
    if pbc is None:
        return matrix, np.any(matrix != 0.0, axis=1) & IN_PLANE
    flags = np.atleast_1d(checked_array("pbc", pbc, "one bool, two or three", "bi"))
    if flags.shape in ((1,), (2,)):
        flags = np.append(np.broadcast_to(flags, 2), False)
    return matrix, _as_flags(flags)


def _check_plane(vectors: Array, pbc: NDArray[np.bool_]) -> None:
    if pbc[2] or vectors[:2, 2].any() or vectors[2, :2].any():
        raise ValueError(
            "a plane is z = 0: its first two lattice vectors must lie in it, and its third direction must be open, "
            f"pbc=(True, True, False); cell = {vectors.tolist()}, pbc = {pbc.tolist()}"
        )


def _as_flags(pbc: ArrayLike) -> NDArray[np.bool_]:
    """(3,) bool; 0 and 1 count as bools."""
    array = checked_array("pbc", pbc, "one bool or three", "bi")
    if array.shape not in ((), (3,)) or not np.isin(array, (0, 1)).all():
        raise ValueError(f"pbc must be one bool or three; pbc = {shown(pbc)}")
    return np.array(np.broadcast_to(array.astype(bool), 3))


def _check_independent(vectors: Array, pbc: NDArray[np.bool_]) -> None:
    has_vector = vectors.any(axis=1)

    for k in np.flatnonzero(pbc & ~has_vector):
        raise ValueError(
            f"pbc[{k}] is True but cell[{k}] is zero; give a lattice vector there, or leave it open: "
            f"pbc={tuple((pbc & has_vector).tolist())}"
        )

    rows = vectors[pbc]
    if rows.size == 0:
        return
    largest = np.abs(rows).max(axis=1)
    if largest.min() < SMALLEST or largest.max() > LARGEST:
        raise ValueError(
            f"lattice vectors must be between {SMALLEST:g} and {LARGEST:g} long; take other units: they are "
            f"{rows.tolist()}"
        )

    if EPS * largest.max() > largest.min():
        raise ValueError(
            f"lengths of lattice vectors must not differ by more than a factor of {1.0 / EPS:.1g}; they are "
            f"{rows.tolist()}"
        )

    unit = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    if np.linalg.svd(unit, compute_uv=False).min() < FLAT:
        raise ValueError(
            f"the periodic lattice vectors must be linearly independent; they are {rows.tolist()}: {OPEN}"
        )


def _reduced(vectors: Array, pbc: NDArray[np.bool_]) -> tuple[Array, Indices]:
    """Minkowski-reduced periodic rows, completed to three dimensions; and the integers that make them from vectors."""
    periodic = np.flatnonzero(pbc)
    rows = vectors[periodic]
    steps = np.eye(len(periodic), dtype=np.int64)
    while _shorten(steps, rows):
        pass
    lattice = np.zeros((3, 3))
    reduction = np.zeros((3, 3), np.int64)
    reduction[np.ix_(periodic, periodic)] = steps
    lattice[periodic] = steps @ rows
    # open rows: unit vectors perpendicular to the periodic ones and to each other
    if len(periodic) < 3:
        directions = np.linalg.svd(lattice[pbc])[2] if len(periodic) else np.eye(3)
        lattice[~pbc] = directions[len(periodic) :]
    return lattice, reduction


def _shorten(steps: Indices, rows: Array) -> bool:
    """Replace one vector of steps @ rows by a shorter one of the same lattice; False if there is none.
    Beginning with the second shortest, the combination of all shorter ones that is nearest to a vector is subtracted
    from it; it is found among the rounded coefficients and their neighbors. The number of replacements grows as the
    logarithm of the skew (Semaev, CaLC 2001, LNCS 2146, p. 181)."""
    current = steps @ rows
    length2 = (current**2).sum(axis=1)
    order = np.argsort(length2, kind="stable")
    for k in range(1, len(order)):
        shorter = order[:k]
        vector = order[k]
        coefficients, *_ = np.linalg.lstsq(current[shorter].T, current[vector])
        nearest = np.rint(coefficients).astype(np.int64)
        around = nearest + np.array([*product((0, -1, 1), repeat=k)])
        candidates = steps[vector] - around @ steps[shorter]
        candidate2 = ((candidates @ rows) ** 2).sum(axis=1)
        best = int(np.argmin(candidate2))
        if candidate2[best] < SHORTER * length2[vector]:
            steps[vector] = candidates[best]
            return True
    return False
