"""Walls: a law of the distance from a plane, or from the inside of a cylinder or a sphere."""

from __future__ import annotations

from math import inf
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from minimd.potentials.declared import (
    NOT_NEGATIVE,
    POSITIVE,
    Array,
    atoms,
    choice,
    declared,
    direction,
    each,
    number,
    vector,
)
from minimd.potentials.fields import NOWHERE, FieldTerm, OnAtoms
from minimd.potentials.law import law_at
from minimd.potentials.laws import Curved, LennardJones93Law, LennardJonesLaw, Planar
from minimd.potentials.term import Term
from minimd.potentials.truncation import Shifted
from minimd.structure.system import System

WALL_LAWS: dict[str, Any] = {"9-3": LennardJones93Law(), "12-6": LennardJonesLaw()}
WallLaw = Literal["9-3", "12-6"]  # the keys of WALL_LAWS
REACH = "distance from the wall from which on there is no force; none if not given"
OF_DISTANCE = "of the distance d: ε [2/15 (σ/d)⁹ − (σ/d)³], or 4ε [(σ/d)¹² − (σ/d)⁶]; shifted to 0 at the cutoff"
ALONG = 1e-9  # of a lattice vector: one that leaves the plane of a wall by less counts as parallel to it


class OwnWall(OnAtoms):
    """Base class of walls."""

    around: ClassVar[Any]  # Planar or Curved

    def place(self) -> tuple[Any, float]:
        """Normal, three numbers, and the position of the plane along it; or axis and radius [length]."""
        raise NotImplementedError(f"{type(self).__name__} has no place")

    def distances(self, system: System, positions: Array) -> Array:
        """(n,) distances of atoms from the wall, negative behind it [length]."""
        raise NotImplementedError(f"{type(self).__name__} has no distances")

    def bind(self, system: System) -> Term:
        """The term of this wall in a system.

        Raises
        ------
        ValueError : if atoms are missing or lie on the wall or behind it, or if the wall crosses a periodic direction.
        """
        acting, given = self.atoms_in(system), self.arguments()
        distances = self.distances(system, system.positions[acting])
        if (behind := np.flatnonzero(~(distances > 0.0))).size:
            atom, d = int(acting[behind[0]]), float(distances[behind[0]])
            others = f", and {behind.size - 1} more" if behind.size > 1 else ""
            where = f"atom {atom} lies {-d:.3g} {system.units.length} behind it{others}"
            raise ValueError(f"atoms must be in front of a {type(self).__name__}; {where}: move it, or the wall")
        own = self.columns("atoms", len(acting))
        law, reach = WALL_LAWS[given["law"]], inf if given["cutoff"] is None else given["cutoff"]
        rows, of_each = np.unique(np.stack(own, axis=-1), axis=0, return_inverse=True)
        at_cutoff = np.array([0.0 if reach == inf else law_at(law, reach, tuple(row.tolist()))[0] for row in rows])
        normal, place = self.place()
        numbers = (np.full(len(acting), one) for one in (*normal.tolist(), place, reach))
        columns = (*numbers, np.ascontiguousarray(at_cutoff[of_each.reshape(-1)]), *own)
        anchors = np.tile(given["point"], (len(acting), 1)) if self.around is Curved else NOWHERE
        return FieldTerm(acting, self.around(Shifted(law)), columns, anchors)


class Wall(OwnWall):
    """A flat wall, u(d) of the distance d = n·(r − p) of an atom; atoms are on the side to which the normal n points.

    The plane must lie along all periodic directions, in which it has no end. LAMMPS: `fix wall/lj93`, `fix wall/lj126`.
    """

    around = Planar
    point: ArrayLike = declared(vector, "of the plane", "length")
    normal: ArrayLike = declared(direction, "of the plane, towards the atoms, of any length")
    epsilon: ArrayLike = declared(each, "strength of the wall", "energy", NOT_NEGATIVE, default=1.0)
    sigma: ArrayLike = declared(each, "range of the wall", "length", POSITIVE, default=1.0)
    cutoff: float | None = declared(number, REACH, "length", POSITIVE, default=None)
    law: WallLaw = declared(choice, OF_DISTANCE, of=WALL_LAWS, default="9-3")
    atoms: ArrayLike | None = declared(atoms, default=None)

    def place(self) -> tuple[Any, float]:
        """See OwnWall."""
        normal = np.asarray(self.normal)
        return normal, float((normal * self.point).sum())

    def distances(self, system: System, positions: Array) -> Array:
        """See OwnWall."""
        vectors, normal = system.cell.vectors[system.cell.pbc], np.asarray(self.normal)
        crossed = np.abs((vectors * normal).sum(axis=1)) > ALONG * np.linalg.norm(vectors, axis=1)
        if crossed.any():
            name = "abc"[np.flatnonzero(system.cell.pbc)[np.argmax(crossed)]]
            hint = "set pbc to False there, or turn the wall"
            raise ValueError(f"a Wall must lie along all periodic directions; it crosses {name}: {hint}")
        distances: Array = ((positions - np.asarray(self.point)) * normal).sum(axis=1)
        return distances


class RoundWall(OwnWall):
    """Base class of walls with atoms inside, around a point that stands for all its images."""

    around = Curved

    def distances(self, system: System, positions: Array) -> Array:
        """See OwnWall."""
        cell, (axis, radius) = system.cell, self.place()
        away = positions - self.arguments()["point"]
        away = away - np.where(cell.pbc, np.rint(np.einsum("ij,jk->ik", away, cell.inverse)), 0.0) @ cell.lattice
        across = away - (away * axis).sum(axis=1)[:, None] * axis
        distances: Array = radius - np.linalg.norm(across, axis=1)
        return distances


class CylinderWall(RoundWall):
    """The wall of a cylinder with atoms inside: u(d) of the distance d = R − ρ from it.

    Positions count relative to the nearest image of the point.
    """

    point: ArrayLike = declared(vector, "on the axis", "length")
    axis: ArrayLike = declared(direction, "direction, of any length")
    radius: float = declared(number, "of the cylinder; atoms are inside", "length", POSITIVE)
    epsilon: ArrayLike = declared(each, "strength of the wall", "energy", NOT_NEGATIVE, default=1.0)
    sigma: ArrayLike = declared(each, "range of the wall", "length", POSITIVE, default=1.0)
    cutoff: float | None = declared(number, REACH, "length", POSITIVE, default=None)
    law: WallLaw = declared(choice, OF_DISTANCE, of=WALL_LAWS, default="9-3")
    atoms: ArrayLike | None = declared(atoms, default=None)

    def place(self) -> tuple[Any, float]:
        """See OwnWall."""
        return self.axis, self.radius


class SphereWall(RoundWall):
    """The wall of a sphere with atoms inside: u(d) of the distance d = R − |r − p| from it."""

    point: ArrayLike = declared(vector, "the center", "length")
    radius: float = declared(number, "of the sphere; atoms are inside", "length", POSITIVE)
    epsilon: ArrayLike = declared(each, "strength of the wall", "energy", NOT_NEGATIVE, default=1.0)
    sigma: ArrayLike = declared(each, "range of the wall", "length", POSITIVE, default=1.0)
    cutoff: float | None = declared(number, REACH, "length", POSITIVE, default=None)
    law: WallLaw = declared(choice, OF_DISTANCE, of=WALL_LAWS, default="9-3")
    atoms: ArrayLike | None = declared(atoms, default=None)

    def place(self) -> tuple[Any, float]:
        """See OwnWall."""
        return np.zeros(3), self.radius  # the distance from the center, not from an axis
