"""Massless sites: atoms without mass whose places are given by those of other atoms, their parents."""

from collections import namedtuple

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import kernel, scalar
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import Cell, Images, nearest_translation
from minimd.core.structure.checks import check_rows, checked_indices, checked_numbers
from minimd.core.structure.vectors import combined, cross, minus

ONE = 1e-6  # by which a sum of weights may differ from 1: files have few digits


class Sites:
    """Massless sites of a System, such as M of TIP4P: each follows its parents, atoms, which get the forces on it.

        r = r_0 + Σ_p w_p d_p + c d_1 × d_2,   d_p = r_p − r_0 to the nearest image,   Σ w_p = 1
        F_1 += w_1 F + c d_2 × F,   F_2 += w_2 F + c F × d_1,   F_p += w_p F,   F_0 += the rest of F

    Without c a site is a weighted mean of its parents. Laws of pairs act on sites as on all atoms, so that exclusions
    are needed between sites and atoms of their molecule. Sites belong to the molecule of parent 0.

    Parameters
    ----------
    atoms : (S,) int, which atoms of the System are sites; their masses are 0, their positions follow.
    parents : (S, P) int, atoms that are no sites, two of them or more.
    weights : (S, P), or (P,) for all sites.
    out_of_plane : c, one number or (S,) [1/length]; 0 for fewer than three parents.

    Raises
    ------
    ValueError : if a shape does not fit, a site is given twice or is a parent, weights do not add up to 1. A System
        raises it for atoms that it does not have.
    """

    def __init__(
        self,
        atoms: ArrayLike,
        parents: ArrayLike,
        weights: ArrayLike,
        out_of_plane: ArrayLike = 0.0,
    ) -> None:
        self.atoms = checked_indices("sites", atoms, "a list of atoms")
        n = self.atoms.size
        self.parents = checked_indices("parents of sites", parents, "an (S, P) array of atoms")
        if self.atoms.shape != (n,) or self.parents.ndim != 2 or len(self.parents) != n:
            raise ValueError(
                "sites must be (S,) atoms, with parents (S, P); their shapes are "
                f"{self.atoms.shape} and {self.parents.shape}"
            )
        n_parents = self.parents.shape[1]
        self.weights = _of_each("weights of sites", weights, (n, n_parents))
        self.out_of_plane = _of_each("out_of_plane of sites", out_of_plane, (n,))
        if n_parents < 2 + self.out_of_plane.any():
            raise ValueError(
                "sites must have two parents or more, and three out of their plane; they have "
                f"{n_parents}"
            )

        is_first = np.isin(np.arange(n), np.unique(self.atoms, return_index=True)[1])
        check_rows("sites", "atoms, each named once", is_first & (self.atoms >= 0), self.atoms)
        is_atom = (self.parents >= 0) & ~np.isin(self.parents, self.atoms)
        check_rows("parents of sites", "atoms that are no sites", is_atom.all(axis=1), self.parents)
        is_mean = np.abs(self.weights.sum(axis=1) - 1.0) <= ONE
        check_rows("weights of sites", "numbers with the sum 1", is_mean, self.weights)

    def __repr__(self) -> str:
        return f"Sites({len(self.atoms)} atoms of {self.parents.shape[1]} parents)"

    def __eq__(self, other: object) -> bool:
        """Whether these are the same sites, to the last bit."""
        return isinstance(other, Sites) and all(
            map(np.array_equal, vars(self).values(), vars(other).values())
        )

    __hash__ = None  # type: ignore[assignment]

    @property
    def pairs(self) -> Indices:
        """(S, 2) each site and its parent 0."""
        return np.column_stack([self.atoms, self.parents[:, 0]])

    def rows(self, positions: Array, images: Images) -> "SiteRows":
        """What kernels need of sites in (N, 3) positions."""
        return SiteRows(positions, images, *map(np.copy, vars(self).values()))


def _of_each(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    numbers = checked_numbers(name, values, "numbers")
    if numbers.shape not in (shape, shape[1:]):
        raise ValueError(
            f"{name} must have the shape {shape} or {shape[1:]}; theirs is {numbers.shape}"
        )
    numbers = np.broadcast_to(numbers, shape).copy()
    check_rows(name, "finite", np.isfinite(numbers).reshape(len(numbers), -1).all(axis=1), numbers)
    return numbers


class SiteRows(
    ByAddress, namedtuple("SiteRows", "positions images atoms parents weights out_of_plane")
):
    """Sites, see Sites, as kernels read them.
    positions : (N, 3) [length].
    images : Images."""


@scalar
def arm(rows, s, p):
    """d_p of site s: from parent 0 to the nearest image of parent p [length]."""
    d = minus(rows.positions[rows.parents[s, p]], rows.positions[rows.parents[s, 0]])
    return combined(1.0, d, 1.0, nearest_translation(d, rows.images))


@kernel
def place(rows):
    """Positions of all sites, from those of their parents."""
    for s in range(rows.atoms.size):
        d = (0.0, 0.0, 0.0)
        for p in range(1, rows.parents.shape[1]):
            d = combined(1.0, d, rows.weights[s, p], arm(rows, s, p))
        if rows.out_of_plane[s] != 0.0:
            d = combined(1.0, d, rows.out_of_plane[s], cross(arm(rows, s, 1), arm(rows, s, 2)))
        for c in range(3):
            rows.positions[rows.atoms[s], c] = rows.positions[rows.parents[s, 0], c] + d[c]


def place_in(positions: Array, cell: Cell, sites: Sites | None) -> None:
    """Bring sites, if there are any, to their places among (N, 3) positions."""
    if sites is not None:
        place(sites.rows(positions, Images.of(cell)))
