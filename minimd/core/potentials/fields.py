"""Fields, springs and walls: external forces on each atom, functions of its position and the time.

A user's field, its force and its change with time are checked before they are trusted.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import inf, isfinite, nan
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import force_along, in_steps, is_too_large
from minimd.core.compiled.kernels import DirectCalls, by_type, called_kernel
from minimd.core.compiled.program import (
    GO_ON,
    OUT_OF_RANGE,
    Operation,
    in_python,
    n_chunks_of,
    operation,
)
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import NOT_NEGATIVE, POSITIVE, Array, Declared, declared
from minimd.core.potentials.law import ACCURACY, STEP, agree, evaluate_law, law_at, loop_for
from minimd.core.potentials.laws import (
    ConstantLaw,
    Curved,
    LennardJones93Law,
    LennardJonesLaw,
    Planar,
    RestraintLaw,
)
from minimd.core.potentials.pair_loop import row_of
from minimd.core.potentials.term import FORCES, PER_ATOM, TOTALS, OwnTerm, Target, Term
from minimd.core.potentials.truncation import Shifted
from minimd.core.structure.cell import minimum_image
from minimd.core.structure.system import System

NOWHERE = np.zeros((0, 3))
TRIED = 5  # atoms at which a user's law is tried
BESIDE = 3e-3 * np.array([1.0, -0.7, 0.4])  # an atom at a minimum: there all numbers are rounding
TIMES = (0.0, 0.37, 1.9, 29.0, 410.0)  # at which it is tried
SOON = TIMES[2]  # up to here it must be defined
TIMED = 5  # numbers that it returns if its u depends on time
RETURNED = "u, three forces, and ∂u/∂t if it depends on t"
WALL_LAWS: dict[str, Any] = {"9-3": LennardJones93Law(), "12-6": LennardJonesLaw()}
WallLaw = Literal["9-3", "12-6"]  # the keys of WALL_LAWS
REACH = "distance beyond which the wall exerts no force; no cutoff if not given"
OF_DISTANCE = "energy at the distance d: ε [2/15 (σ/d)⁹ − (σ/d)³], or 4ε [(σ/d)¹² − (σ/d)⁶]; shifted to 0 at the cutoff"
# of a lattice vector: one that leaves the plane of a wall by less counts as parallel to it
ALONG = 1e-9


class Sites(
    ByAddress,
    namedtuple("Sites", "positions images atoms anchors law columns time forces steps detail sums"),
):
    """Where a field acts, and what on.

    positions : (N, 3) [length].  images : Images.  atoms : (n,) int, all different.
    anchors : (n, 3) points from which positions are counted, to the nearest image [length]; or (0, 3).
    law : law type.  columns : (n,) numbers for each parameter.  time : (1,) t [time].  forces, steps, detail : see
    Target.  sums : Σ u [energy] and Σ ∂u/∂t [energy/time], (chunks,) output, and energies (N,), to which PER_ATOM adds.
    """


@by_type
def _rate(found):
    """∂u/∂t from what a law returns; zero if it returns only u and the force."""
    return (lambda found: found[4]) if len(found) > 4 else lambda found: 0.0


@called_kernel
def add_field(sites, chunk):
    """Add the forces and energies of a field u(x, y, z, t).  OUT_OF_RANGE if a force is beyond the range of a grid.
    The virial is left out: fields act from outside."""
    (
        positions,
        images,
        atoms,
        anchors,
        law,
        columns,
        time,
        forces,
        steps,
        detail,
        (totals, powers, energies),
    ) = sites
    lattice, inverse, pbc, safe_distance2 = images
    n_chunks = totals.size
    total = 0.0
    power = 0.0
    is_out = False
    for n in range(chunk * atoms.size // n_chunks, (chunk + 1) * atoms.size // n_chunks):
        i = atoms[n]
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        if anchors.shape[0] > 0:
            x, y, z = x - anchors[n, 0], y - anchors[n, 1], z - anchors[n, 2]
            a, b, c = minimum_image(x, y, z, lattice, inverse, pbc, safe_distance2[0])
            x += a * lattice[0, 0] + b * lattice[1, 0] + c * lattice[2, 0]
            y += a * lattice[0, 1] + b * lattice[1, 1] + c * lattice[2, 1]
            z += a * lattice[0, 2] + b * lattice[1, 2] + c * lattice[2, 2]
        found = evaluate_law(law, x, (y, z, time[0]) + row_of(columns, n))
        forces[i, 0] += force_along(found[1], 1.0, steps)
        forces[i, 1] += force_along(found[2], 1.0, steps)
        forces[i, 2] += force_along(found[3], 1.0, steps)
        power += _rate(found)
        is_out |= is_too_large(
            found[1] * found[1] + found[2] * found[2] + found[3] * found[3], steps
        )
        if detail != FORCES:
            total += in_steps(found[0], steps)
        if detail == PER_ATOM:
            energies[i] += in_steps(found[0], steps)
    totals[chunk] = total
    powers[chunk] = power
    return OUT_OF_RANGE if is_out else GO_ON


class FieldTerm(OwnTerm):
    """A field on atoms, (n,) int, all different.  columns : (n,) numbers of each, for each parameter of the law.
    anchors : see Sites.  prepare : called before each evaluation, if given."""

    acts_from_outside = fits_grid = True
    prepare: Callable[[], None] | None = None

    def __init__(
        self, acting: NDArray[np.int64], law: tuple, columns: tuple, anchors: Array = NOWHERE
    ) -> None:
        self._atoms, self._law, self.anchors, self.columns = (
            acting,
            law,
            np.ascontiguousarray(anchors),
            columns,
        )
        self._time, (self._totals, self._powers) = (
            np.zeros(1),
            np.zeros((2, n_chunks_of(len(acting)))),
        )
        self._loop, self._calls = loop_for(add_field, law), DirectCalls()

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        if self.prepare is not None:
            yield in_python(self.prepare)
        acting = (
            self._atoms,
            self.anchors,
            self._law,
            self.columns,
            self._time,
            target.forces,
            target.steps,
        )
        sums = self._totals, self._powers, target.energies
        sites = Sites(system.positions, target.images, *acting, target.detail, sums)
        yield operation(self._calls, self._loop, sites, len(self._totals))

    def collect(self, target: Target) -> None:
        """See Term."""
        if target.detail == TOTALS:
            target.energies[0] += self._totals.sum()

    @property
    def time(self) -> float:  # type: ignore[override]
        """See Term."""
        return float(self._time[0])

    @time.setter
    def time(self, time: float) -> None:
        self._time[0] = time

    @property
    def power(self) -> float:  # type: ignore[override]
        """See Term."""
        return float(self._powers.sum())


class OnAtoms(Declared):
    """Base class of fields, which act on some atoms."""

    def atoms_in(self, system: System) -> NDArray[np.int64]:
        """(n,) int, those on which it acts in a system.  Raises ValueError if they name missing atoms."""
        own: NDArray[np.int64] | None = getattr(self, "atoms", None)
        if own is None:
            return np.arange(len(system))
        if own.max(initial=-1) >= len(system):
            name = type(self).__name__
            last = len(system) - 1
            raise ValueError(
                f"atoms of {name} must be atoms 0 to {last}; they name atom {own.max()}"
            )
        return own


def rows_of(name: str, vectors: Any, n: int) -> Array:
    """Vectors for each of n atoms, (n, 3).  Raises ValueError for another number of vectors."""
    if vectors.shape not in ((3,), (n, 3)):
        wanted = f"three numbers or ({n}, 3), one row for each atom"
        raise ValueError(f"{name} must be {wanted}; its shape is {vectors.shape}")
    return np.array(np.broadcast_to(vectors, (n, 3)))


class ConstantForce(OnAtoms):
    """A constant force F on atoms, u = −F·r. r is never wrapped: u changes steadily as an atom is pulled along."""

    force: ArrayLike = declared(kind.vectors, "force on each atom", "force")
    atoms: ArrayLike | None = declared(kind.atoms, default=None)

    def bind(self, system: System) -> Term:
        """The term of this force in a system.  Raises ValueError if atoms, or their forces, are missing."""
        acting = self.atoms_in(system)
        return FieldTerm(acting, ConstantLaw(), (*rows_of("force", self.force, len(acting)).T,))


class Gravity(OnAtoms):
    """Weight, F = m g, u = −m g·r."""

    acceleration: ArrayLike = declared(kind.weight, "acceleration of free fall", "acceleration")
    atoms: ArrayLike | None = declared(kind.atoms, default=None)

    def bind(self, system: System) -> Term:
        """The term of the weight of a system.  Raises ValueError if atoms do not exist."""
        acting = self.atoms_in(system)
        return FieldTerm(
            acting,
            ConstantLaw(),
            (*np.outer(np.asarray(self.acceleration), system.masses[acting]),),
        )


class Springs(OnAtoms):
    """Base class of harmonic springs from atoms to points."""

    def bind(self, system: System) -> FieldTerm:
        """The term of these springs in a system.  Raises ValueError if atoms, or their points, are missing."""
        acting = self.atoms_in(system)
        given = self.arguments()
        numbers = (*np.broadcast_to(given["k"], 3), 0.0, 0.0, 0.0)  # the points are at rest
        columns = tuple(np.full(len(acting), one) for one in numbers)
        return FieldTerm(
            acting, RestraintLaw(), columns, rows_of("points", given["points"], len(acting))
        )


class Restraint(Springs):
    """Harmonic springs from atoms to points, u = ½ Σ k_c (r − p)_c², c = x, y, z; r − p to the nearest image.

    k = 0 leaves a direction free.
    """

    k: ArrayLike = declared(kind.stiffness, "u = k (r − point)²/2", "stiffness", NOT_NEGATIVE)
    points: ArrayLike = declared(
        kind.points, "anchor points, one for all atoms or one for each", "length"
    )
    atoms: ArrayLike | None = declared(kind.atoms, default=None)


class SteeredSpring(Springs):
    """Harmonic springs from atoms to moving points, p(t) = p + v (t' − start), with t' = t limited to [start, end].

    The work that moving the points does on the atoms, W = ∫ ∂u/∂t dt, is counted, and recorded as `work`.
    start and end are by the clock of the simulation.
    """

    k: ArrayLike = declared(kind.stiffness, "u = k (r − point)²/2", "stiffness", NOT_NEGATIVE)
    points: ArrayLike = declared(
        kind.points, "points at the start, one for all atoms or one for each", "length"
    )
    velocity: ArrayLike = declared(kind.vector, "velocity of the points", "velocity")
    atoms: ArrayLike | None = declared(kind.atoms, default=None)
    start: float = declared(
        kind.number, "start of the motion of the points", "time", default=0.0, kw_only=True
    )
    end: float = declared(
        kind.number, "end of the motion; default: never", "time", default=inf, kw_only=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.end > self.start:
            raise ValueError(f"end must be after start; start = {self.start!r}, end = {self.end!r}")

    def points_at(self, time: float) -> Array:
        """p(t), of the shape of points [length]."""
        moved: Array = np.asarray(self.velocity) * (
            min(max(time, self.start), self.end) - self.start
        )
        return np.asarray(self.points) + moved

    def bind(self, system: System) -> FieldTerm:
        """See Restraint."""
        term = super().bind(system)
        term.prepare = partial(self._move_points, term)
        term.depends_on_time = True
        term.fits_grid = False  # its work is no whole number of steps
        return term

    def _move_points(self, term: FieldTerm) -> None:
        """Move the points to where they are at the time of the term."""
        term.anchors[:] = self.points_at(term.time)
        moves = self.start <= term.time < self.end
        for column, v in zip(term.columns[3:], np.asarray(self.velocity), strict=True):
            column[:] = v if moves else 0.0


class Field(OnAtoms):
    """A user's field, u(x, y, z, t).

        def trap(x, y, z, t, k):
            return 0.5 * k * (x * x + y * y), -k * x, -k * y, 0.0

        md.Field(trap, (2.0,))

    law(x, y, z, t, *parameters) of the position of an atom, which is never wrapped [length], and the time [time]
    returns u [energy] and the force, three numbers [energy/length]; and, if u depends on t, ∂u/∂t [energy/time] as a
    fifth number, from which the work is counted. It is plain Python, or compiled by numba.njit. bind raises TypeError
    for a law that does not return such numbers, ValueError for a force that at most places is not −∇u, or
    a u that changes with time where ∂u/∂t is not returned.
    """

    law: Callable = declared(kind.own_law, "law(x, y, z, t, *parameters)")
    parameters: Sequence[ArrayLike] = declared(kind.own_parameters, default=())
    atoms: ArrayLike | None = declared(kind.atoms, default=None)

    def bind(self, system: System) -> Term:
        """The term of this field in a system.  Raises ValueError, TypeError as the class says."""
        acting = self.atoms_in(system)
        law = self.law
        columns = self.columns("atoms", len(acting))
        some = np.unique(np.linspace(0, len(acting) - 1, TRIED).astype(int)) if len(acting) else ()
        tried = [
            _Tried(
                law, system.positions[acting[k]] + BESIDE, tuple(one[k].item() for one in columns)
            )
            for k in some
        ]
        compared: list[tuple[int, str]] = []
        for one in tried:
            for time in TIMES:
                try:
                    compared += one.compared(time)
                except TypeError:
                    if time <= SOON:
                        raise  # at later times a law may have ended
        for k, sentence in compared:
            verdicts = [bool(told) for other, told in compared if other == k]
            if sentence and 2 * sum(verdicts) > len(verdicts):
                raise ValueError(sentence)
        term: Any = FieldTerm(acting, law, columns)  # type: ignore[arg-type]
        term.warning = next((words for one in tried if (words := one.repeats(system))), "")
        term.depends_on_time = any(len(one.at(TIMES[0])) == TIMED for one in tried)
        term.fits_grid = not term.depends_on_time  # its work is no whole number of steps
        return term


class _Tried(NamedTuple):
    """A user's law at the position of an atom, (3,), with its numbers."""

    law: Any
    place: Array
    numbers: tuple[float, ...]

    def at(self, time: float, shift: Array | float = 0.0) -> tuple[float, ...]:
        """What the law returns.  Raises TypeError unless that is four or five numbers."""
        name = type(self.law).python.__name__
        x, y, z = (self.place + shift).tolist()
        try:
            found = tuple(
                float(one) for one in evaluate_law(self.law, x, (y, z, time, *self.numbers))
            )
        except ArithmeticError:
            return (nan,) * 4
        except Exception as error:  # whatever a law of the user's raises
            taken = f"x, y, z, t and {len(self.numbers)} parameters"
            raise TypeError(
                f"the law {name} must take {taken}, and return {RETURNED}: {error}"
            ) from None
        if len(found) not in (4, TIMED):
            raise TypeError(
                f"the law {name} must return {RETURNED}; it returns {len(found)} numbers"
            )
        return found

    def compared(self, time: float) -> Iterator[tuple[int, str]]:
        """The index of each number after u that is not zero, or should not be, by central differences; and what is
        wrong with it, or nothing."""
        steps = [(h, 0.0) for h in STEP * np.eye(3)] + [(np.zeros(3), STEP)]
        (u, *told) = self.at(time)
        ends = ((self.at(time - dt, h)[0], self.at(time + dt, -h)[0]) for h, dt in steps)
        slopes = [(u_plus - u_minus) / (-2.0 * STEP) for u_plus, u_minus in ends]  # −∇u and ∂u/∂t
        for k, (said, slope) in enumerate(zip((*told, 0.0)[:4], slopes, strict=True)):
            if (
                isfinite(said)
                and isfinite(slope)
                and not (agree(said, 0.0, u) and agree(slope, 0.0, u))
            ):
                at = f"at ({', '.join(f'{c:.4g}' for c in self.place)}), t = {time:g}"
                what = f"-∂u/∂{'xyz'[k]}" if k < len("xyz") else "∂u/∂t"
                if agree(said, slope, u):
                    yield k, ""
                elif k == len(told):
                    fifth = "the law must return ∂u/∂t as its fifth number, because u depends on t"
                    yield k, f"{fifth}; {at} it is {slope:.6g}"
                else:
                    wanted = "the law must return u, -∇u and ∂u/∂t"
                    yield k, f"{wanted}; {at} it returns {said:.6g} where {what} is {slope:.6g}"

    def repeats(self, system: System) -> str:
        """A warning if the force is another one lattice vector away; empty if not."""
        here = np.array(self.at(TIMES[0])[1:4])
        for k in np.flatnonzero(system.cell.pbc):
            there = self.at(TIMES[0], system.cell.vectors[k])[1:4]
            if not np.allclose(here, there, rtol=ACCURACY, atol=ACCURACY * np.abs(here).max()):
                where = f"the cell is periodic along {'abc'[k]}, but the field is not"
                return f"{where}: an atom and its image feel different forces"
        return ""


class OwnWall(OnAtoms):
    """Base class of walls.

    around : Planar or Curved.  place(system, positions) : normal, three numbers, and place of the plane along it, or
    axis and radius [length]; and the distances (n,) of atoms from the wall, negative behind it [length].
    """

    around: ClassVar[Any]
    place: ClassVar[Callable[..., tuple[Any, float, Array]]]

    def bind(self, system: System) -> Term:
        """The term of this wall in a system.  Raises ValueError if atoms are missing or lie on the wall or behind it,
        or if the wall crosses a periodic direction."""
        acting = self.atoms_in(system)
        given = self.arguments()
        normal, place, distances = self.place(system, system.positions[acting])
        if (behind := np.flatnonzero(~(distances > 0.0))).size:
            atom = int(acting[behind[0]])
            d = float(distances[behind[0]])
            others = f", and {behind.size - 1} more" if behind.size > 1 else ""
            how = f"{-d:.3g} {system.units.length} behind" if d < 0.0 else "on"
            where = f"atom {atom} lies {how} the wall{others}"
            side = "inside" if self.around is Curved else "in front of"
            wanted = f"atoms must be {side} a {type(self).__name__}"
            raise ValueError(f"{wanted}; {where}: move the atom or the wall")
        own = self.columns("atoms", len(acting))
        law = WALL_LAWS[given["law"]]
        reach = inf if given["cutoff"] is None else given["cutoff"]
        rows, of_each = np.unique(np.stack(own, axis=-1), axis=0, return_inverse=True)
        at_cutoff = np.array(
            [0.0 if reach == inf else law_at(law, reach, tuple(row.tolist()))[0] for row in rows]
        )
        numbers = (np.full(len(acting), one) for one in (*normal.tolist(), place, reach))
        columns = (*numbers, np.ascontiguousarray(at_cutoff[of_each.reshape(-1)]), *own)
        anchors = np.tile(given["point"], (len(acting), 1)) if self.around is Curved else NOWHERE
        return FieldTerm(acting, self.around(Shifted(law)), columns, anchors)


class Wall(OwnWall):
    """A flat wall, u(d) of the distance d = n·(r − p) of an atom; atoms are on the side to which the normal n points.

    The plane must lie along all periodic directions, in which it has no end. LAMMPS: `fix wall/lj93`, `fix wall/lj126`.
    """

    around = Planar
    point: ArrayLike = declared(kind.vector, "point of the plane", "length")
    normal: ArrayLike = declared(
        kind.direction, "normal of the plane, towards the atoms, of any length"
    )
    epsilon: ArrayLike = declared(
        kind.each, "strength of the wall", "energy", NOT_NEGATIVE, default=1.0
    )
    sigma: ArrayLike = declared(kind.each, "range of the wall", "length", POSITIVE, default=1.0)
    cutoff: float | None = declared(kind.number, REACH, "length", POSITIVE, default=None)
    law: WallLaw = declared(kind.choice, OF_DISTANCE, of=WALL_LAWS, default="9-3")
    atoms: ArrayLike | None = declared(kind.atoms, default=None)

    def place(self, system: System, positions: Array) -> tuple[Any, float, Array]:
        """See OwnWall."""
        vectors = system.cell.vectors[system.cell.pbc]
        normal = np.asarray(self.normal)
        crossed = np.abs((vectors * normal).sum(axis=1)) > ALONG * np.linalg.norm(vectors, axis=1)
        if crossed.any():
            name = "abc"[np.flatnonzero(system.cell.pbc)[np.argmax(crossed)]]
            hint = "set pbc to False there, or turn the wall"
            raise ValueError(
                f"a Wall must lie along all periodic directions; it crosses {name}: {hint}"
            )
        return (
            normal,
            float((normal * self.point).sum()),
            ((positions - np.asarray(self.point)) * normal).sum(axis=1),
        )


class RoundWall(OwnWall):
    """Base class of walls with atoms inside, around a point that stands for all its images."""

    around = Curved

    def place(self, system: System, positions: Array) -> tuple[Any, float, Array]:
        """See OwnWall; without an axis, distances are those from the center."""
        cell = system.cell
        given = self.arguments()
        axis = getattr(self, "axis", np.zeros(3))
        away = positions - given["point"]
        away = (
            away
            - np.where(cell.pbc, np.rint(np.einsum("ij,jk->ik", away, cell.inverse)), 0.0)
            @ cell.lattice
        )
        across = away - (away * axis).sum(axis=1)[:, None] * axis
        return axis, given["radius"], given["radius"] - np.linalg.norm(across, axis=1)


class CylinderWall(RoundWall):
    """The wall of a cylinder with atoms inside: u(d) of the distance d = R − ρ from it.

    Positions count relative to the nearest image of the point.
    """

    point: ArrayLike = declared(kind.vector, "point on the axis", "length")
    axis: ArrayLike = declared(kind.direction, "direction of the axis, of any length")
    radius: float = declared(
        kind.number, "radius of the cylinder; atoms are inside", "length", POSITIVE
    )
    epsilon: ArrayLike = declared(
        kind.each, "strength of the wall", "energy", NOT_NEGATIVE, default=1.0
    )
    sigma: ArrayLike = declared(kind.each, "range of the wall", "length", POSITIVE, default=1.0)
    cutoff: float | None = declared(kind.number, REACH, "length", POSITIVE, default=None)
    law: WallLaw = declared(kind.choice, OF_DISTANCE, of=WALL_LAWS, default="9-3")
    atoms: ArrayLike | None = declared(kind.atoms, default=None)


class SphereWall(RoundWall):
    """The wall of a sphere with atoms inside: u(d) of the distance d = R − |r − p| from it."""

    point: ArrayLike = declared(kind.vector, "center of the sphere", "length")
    radius: float = declared(
        kind.number, "radius of the sphere; atoms are inside", "length", POSITIVE
    )
    epsilon: ArrayLike = declared(
        kind.each, "strength of the wall", "energy", NOT_NEGATIVE, default=1.0
    )
    sigma: ArrayLike = declared(kind.each, "range of the wall", "length", POSITIVE, default=1.0)
    cutoff: float | None = declared(kind.number, REACH, "length", POSITIVE, default=None)
    law: WallLaw = declared(kind.choice, OF_DISTANCE, of=WALL_LAWS, default="9-3")
    atoms: ArrayLike | None = declared(kind.atoms, default=None)
