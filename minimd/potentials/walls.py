"""Walls: a law of the distance from a plane, or from the inside of a cylinder or a sphere."""

from __future__ import annotations

from math import inf
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from minimd.console.words import shown
from minimd.potentials.each import Array, checked_each, columns_of
from minimd.potentials.field_laws import Curved, Planar
from minimd.potentials.fields import NOWHERE, FieldTerm, OwnField, checked_atoms, checked_vectors
from minimd.potentials.law import law_at
from minimd.potentials.laws import LennardJones93Law, LennardJonesLaw
from minimd.potentials.term import Term
from minimd.potentials.truncation import Shifted
from minimd.structure.checks import checked_choice, checked_number
from minimd.structure.system import System

WALL_LAWS: dict[str, Any] = {"9-3": LennardJones93Law(), "12-6": LennardJonesLaw()}
WallLaw = Literal["9-3", "12-6"]  # the keys of WALL_LAWS
ALONG = 1e-9  # of a lattice vector: one that leaves the plane of a wall by less counts as parallel to it


class OwnWall(OwnField):
    """Base class of walls.

    epsilon : ε [energy], sigma : σ [length], one number each, or one for each atom.  cutoff : distance beyond which
    there is no force [length]; None for none. The energy is shifted to be zero there.
    law : "9-3", ε [2/15 (σ/d)⁹ − (σ/d)³], or "12-6", 4ε [(σ/d)¹² − (σ/d)⁶].
    """

    around: ClassVar[Any]  # Planar or Curved
    names: ClassVar[tuple[str, ...]]  # of the arguments that place it

    def _hold(
        self, epsilon: ArrayLike, sigma: ArrayLike, cutoff: float | None, law: WallLaw, atoms: ArrayLike | None
    ) -> None:
        self.parameters = checked_each("atoms", {"epsilon": epsilon, "sigma": sigma}, not_negative=("epsilon",))
        if (self.parameters["sigma"] <= 0.0).any():
            raise ValueError(f"sigma must be positive; sigma = {shown(self.parameters['sigma'].tolist())}")
        self.cutoff = None if cutoff is None else checked_number("cutoff", cutoff, "positive and finite")
        self.law, self.atoms = checked_choice("law", law, WALL_LAWS), checked_atoms(atoms)

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        placed = {name: getattr(self, name) for name in self.names}
        return placed | self.parameters | {"cutoff": self.cutoff, "law": self.law, "atoms": self.atoms}

    def _place(self) -> tuple[Array, float]:
        """Normal, three numbers, and the position of the plane along it; or axis and radius [length]."""
        raise NotImplementedError

    def _distances(self, system: System, positions: Array) -> Array:
        """(n,) distances of atoms from the wall, negative behind it [length]."""
        raise NotImplementedError

    def _anchors(self, n: int) -> Array:
        return NOWHERE

    def bind(self, system: System) -> Term:
        """The term of this wall in a system.

        Raises
        ------
        ValueError : if atoms are missing or lie on the wall or behind it, or if the wall crosses a periodic direction.
        """
        atoms = self.atoms_in(system)
        distances = self._distances(system, system.positions[atoms])
        if (behind := np.flatnonzero(~(distances > 0.0))).size:
            atom, d = int(atoms[behind[0]]), float(distances[behind[0]])
            others = f", and {behind.size - 1} more" if behind.size > 1 else ""
            where = f"atom {atom} lies {-d:.3g} {system.units.length} behind it{others}"
            raise ValueError(f"atoms must be in front of a {type(self).__name__}; {where}: move it, or the wall")
        own = columns_of("atoms", self.parameters, len(atoms))
        law, reach = WALL_LAWS[self.law], inf if self.cutoff is None else self.cutoff
        rows, of_each = np.unique(np.stack(own, axis=-1), axis=0, return_inverse=True)
        at_cutoff = np.array([0.0 if reach == inf else law_at(law, reach, tuple(row.tolist()))[0] for row in rows])
        direction, place = self._place()
        numbers = (np.full(len(atoms), one) for one in (*direction.tolist(), place, reach))
        columns = (*numbers, np.ascontiguousarray(at_cutoff[of_each.reshape(-1)]), *own)
        return FieldTerm(atoms, self.around(Shifted(law)), columns, self._anchors(len(atoms)))


class Wall(OwnWall):
    """A flat wall, u(d) of the distance d = n·(r − p) of an atom; atoms are on the side to which the normal n points.

    The plane must lie along all periodic directions, in which it has no end. LAMMPS: `fix wall/lj93`, `fix wall/lj126`.

    Parameters
    ----------
    point : p, a point of the plane, three numbers [length].  normal : n, of any length, towards the atoms.
    epsilon : ε [energy], sigma : σ [length], one number each, or one for each atom.
    cutoff : distance beyond which there is no force [length]; None for none. The energy is shifted to be zero there.
    law : "9-3", u = ε [2/15 (σ/d)⁹ − (σ/d)³], of a half-space of atoms; or "12-6", u = 4ε [(σ/d)¹² − (σ/d)⁶],
        of a layer.
    atoms : indices; all if not given.

    Raises
    ------
    ValueError : if a number is not finite or out of range, or shapes do not fit; and, when it is bound to a system, for
        atoms on the wall or behind it.
    """

    around, names = Planar, ("point", "normal")

    def __init__(
        self,
        point: ArrayLike,
        normal: ArrayLike,
        epsilon: ArrayLike = 1.0,
        sigma: ArrayLike = 1.0,
        cutoff: float | None = None,
        law: WallLaw = "9-3",
        atoms: ArrayLike | None = None,
    ) -> None:
        self.point, self.normal = _vector("point", point), _unit_vector("normal", normal)
        self._hold(epsilon, sigma, cutoff, law, atoms)

    def _place(self) -> tuple[Array, float]:
        return self.normal, float((self.normal * self.point).sum())

    def _distances(self, system: System, positions: Array) -> Array:
        vectors = system.cell.vectors[system.cell.pbc]
        crossed = np.abs((vectors * self.normal).sum(axis=1)) > ALONG * np.linalg.norm(vectors, axis=1)
        if crossed.any():
            name = "abc"[np.flatnonzero(system.cell.pbc)[np.argmax(crossed)]]
            hint = "set pbc to False there, or turn the wall"
            raise ValueError(f"a Wall must lie along all periodic directions; it crosses {name}: {hint}")
        distances: Array = ((positions - self.point) * self.normal).sum(axis=1)
        return distances


class RoundWall(OwnWall):
    """Base class of walls with atoms inside, around a point that stands for all its images."""

    around = Curved
    point: Array

    def _distances(self, system: System, positions: Array) -> Array:
        cell, (axis, radius) = system.cell, self._place()
        away = positions - self.point
        away = away - np.where(cell.pbc, np.rint(np.einsum("ij,jk->ik", away, cell.inverse)), 0.0) @ cell.lattice
        across = away - (away * axis).sum(axis=1)[:, None] * axis
        distances: Array = radius - np.linalg.norm(across, axis=1)
        return distances

    def _anchors(self, n: int) -> Array:
        return np.tile(self.point, (n, 1))


class CylinderWall(RoundWall):
    """The wall of a cylinder with atoms inside: u(d) of the distance d = R − ρ from it.

    Parameters
    ----------
    point : on the axis, three numbers [length].  axis : direction, three numbers of any length.  radius : R [length].
    epsilon, sigma, cutoff, law, atoms : as for Wall. The law is that of a flat wall at the nearest point.

    Positions count relative to the nearest image of the point.

    Raises
    ------
    ValueError : as Wall, and for a radius that is not positive.
    """

    names = ("point", "axis", "radius")

    def __init__(
        self,
        point: ArrayLike,
        axis: ArrayLike,
        radius: float,
        epsilon: ArrayLike = 1.0,
        sigma: ArrayLike = 1.0,
        cutoff: float | None = None,
        law: WallLaw = "9-3",
        atoms: ArrayLike | None = None,
    ) -> None:
        self.point, self.axis = _vector("point", point), _unit_vector("axis", axis)
        self.radius = checked_number("radius", radius, "positive and finite")
        self._hold(epsilon, sigma, cutoff, law, atoms)

    def _place(self) -> tuple[Array, float]:
        return self.axis, self.radius


class SphereWall(RoundWall):
    """The wall of a sphere with atoms inside: u(d) of the distance d = R − |r − p| from it.

    Parameters
    ----------
    point : p, the center, three numbers [length].  radius : R [length].  epsilon, sigma, cutoff, law, atoms :
        as for CylinderWall.

    Raises
    ------
    ValueError : as CylinderWall.
    """

    names = ("point", "radius")

    def __init__(
        self,
        point: ArrayLike,
        radius: float,
        epsilon: ArrayLike = 1.0,
        sigma: ArrayLike = 1.0,
        cutoff: float | None = None,
        law: WallLaw = "9-3",
        atoms: ArrayLike | None = None,
    ) -> None:
        self.point, self.radius = _vector("point", point), checked_number("radius", radius, "positive and finite")
        self._hold(epsilon, sigma, cutoff, law, atoms)

    def _place(self) -> tuple[Array, float]:
        return np.zeros(3), self.radius  # the distance from the center, not from an axis


def _vector(name: str, values: ArrayLike) -> Array:
    array = checked_vectors(name, values)
    if array.ndim != 1:
        raise ValueError(f"{name} must be three numbers; its shape is {array.shape}")
    return array


def _unit_vector(name: str, values: ArrayLike) -> Array:
    array = _vector(name, values)
    largest = float(np.abs(array).max())
    # no square leaves the range of floats
    length = largest * float(np.linalg.norm(array / largest)) if largest > 0.0 else 0.0
    if not 0.0 < length < inf:
        raise ValueError(f"{name} must not be zero, nor of infinite length; {name} = {array.tolist()}")
    return array / length
