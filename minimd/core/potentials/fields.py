"""Fields, springs and walls: external forces on each atom, functions of its position and the time.

A user's field, its force and its change with time are checked before they are trusted.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import inf, isclose, isfinite, nan
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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
    share_of,
)
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import NOT_NEGATIVE, POSITIVE, Declared, declared
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
from minimd.core.potentials.term import FORCES, PER_ATOM, ROUGH, TOTALS, OwnTerm, Target, Term
from minimd.core.potentials.truncation import Shifted
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import nearest_translation
from minimd.core.structure.system import System

NOWHERE = np.zeros((0, 3))
TRIED = 5  # atoms at which a user's law is tried
BESIDE = 3e-3 * np.array([1.0, -0.7, 0.4])  # an atom at a minimum: there all numbers are rounding
TIMES = (0.0, 0.37, 1.9, 29.0, 410.0)  # at which it is tried
SOON = TIMES[2]  # up to here it must be defined
TIMED = 5  # numbers that it returns if its u depends on time
SLOPES = ("-∂u/∂x", "-∂u/∂y", "-∂u/∂z", "∂u/∂t")
RETURNED = "u, three forces, and ∂u/∂t if it depends on t"
WALL_LAWS: dict[str, Any] = {"9-3": LennardJones93Law(), "12-6": LennardJonesLaw()}
WallLaw = Literal["9-3", "12-6"]  # the keys of WALL_LAWS
REACH = "distance beyond which the wall exerts no force; no cutoff if not given"
OF_DISTANCE = "energy at the distance d: ε [2/15 (σ/d)⁹ − (σ/d)³], or 4ε [(σ/d)¹² − (σ/d)⁶]; shifted to 0 at the cutoff"
# of a lattice vector: one that leaves the plane of a wall by less counts as parallel to it
ALONG = 1e-9
ROUNDED = 1e-12  # of a time that is a number of steps
# arguments of several classes
ATOMS = declared(kind.atoms, default=None)
EPSILON = declared(kind.each, "strength of the wall", "energy", NOT_NEGATIVE, default=1.0)
SIGMA = declared(kind.each, "range of the wall", "length", POSITIVE, default=1.0)
CUTOFF = declared(kind.number, REACH, "length", POSITIVE, default=None)
WALL_LAW = declared(kind.choice, OF_DISTANCE, of=WALL_LAWS, default="9-3")


class FieldRows(
    ByAddress,
    namedtuple(
        "FieldRows", "positions images atoms anchors law columns time forces steps detail sums"
    ),
):
    """Where a field acts, and what on.

    positions : (N, 3) [length].
    images : Images.
    atoms : (n,) int, all different.
    anchors : (n, 3) points from which positions are counted, to the nearest image [length]; or (0, 3).
    law : law type.
    columns : (n,) numbers for each parameter.
    time : (1,) t [time].
    forces, steps, detail : see Target.
    sums : Σ u [energy] and Σ ∂u/∂t [energy/time], (chunks,) output, and energies (N,), to which PER_ATOM adds.
    """


@by_type
def _rate(returned):
    """∂u/∂t from what a law returns; zero if it returns only u and the force."""
    return (lambda returned: returned[4]) if len(returned) > 4 else lambda returned: 0.0


@called_kernel
def add_field(sites, chunk):
    """Add the forces and energies of a field u(x, y, z, t).  OUT_OF_RANGE if a force is beyond the range of a grid.
    The virial is left out: fields act from outside."""
    positions, images, atoms, anchors, law, columns, time, forces, steps, detail, sums = sites
    totals, powers, energies = sums
    n_chunks = totals.size
    total = 0.0
    power = 0.0
    is_out = False

    first, last = share_of(chunk, n_chunks, atoms.size)

    for n in range(first, last):
        i = atoms[n]
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        if anchors.shape[0] > 0:
            x, y, z = x - anchors[n, 0], y - anchors[n, 1], z - anchors[n, 2]
            dx, dy, dz = nearest_translation((x, y, z), images)
            x, y, z = x + dx, y + dy, z + dz

        returned = evaluate_law(law, x, (y, z, time[0]) + row_of(columns, n))
        u, fx, fy, fz = returned[:4]
        forces[i, 0] += force_along(fx, 1.0, steps)
        forces[i, 1] += force_along(fy, 1.0, steps)
        forces[i, 2] += force_along(fz, 1.0, steps)
        power += _rate(returned)
        is_out |= is_too_large(fx * fx + fy * fy + fz * fz, steps)
        if detail != FORCES:
            total += in_steps(u, steps)
        if detail == PER_ATOM:
            energies[i] += in_steps(u, steps)

    totals[chunk] = total
    powers[chunk] = power
    return OUT_OF_RANGE if is_out else GO_ON


class FieldTerm(OwnTerm):
    """A field on atoms, (n,) int, all different.
    columns : (n,) numbers of each, for each parameter of the law.
    anchors : see FieldRows.
    prepare : called before each evaluation, if given.
    changes_along, falls_along : periodic directions along which an atom and its image feel different forces; or have
        different energies."""

    acts_from_outside = fits_grid = True
    prepare: Callable[[], None] | None = None
    changes_along: tuple[int, ...] = ()
    falls_along: tuple[int, ...] = ()

    def __init__(
        self, acting: Indices, law: tuple, columns: tuple, anchors: Array = NOWHERE
    ) -> None:
        n_chunks = n_chunks_of(len(acting))
        self.anchors = np.ascontiguousarray(anchors)
        self.columns = columns
        self._atoms = acting
        self._law = law
        self._time = np.zeros(1)
        self._totals = np.zeros(n_chunks)
        self._powers = np.zeros(n_chunks)
        self._loop = loop_for(add_field, law)
        self._calls = DirectCalls()

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        if self.prepare is not None:
            yield in_python(self.prepare)
        sites = FieldRows(
            system.positions,
            target.images,
            self._atoms,
            self.anchors,
            self._law,
            self.columns,
            self._time,
            target.forces,
            target.steps,
            target.detail,
            (self._totals, self._powers, target.energies),
        )
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

    def atoms_in(self, system: System) -> Indices:
        """(n,) int, those on which it acts in a system.
        Raises ValueError if they name missing atoms."""
        atoms: Indices | None = getattr(self, "atoms", None)
        n_atoms = len(system)
        if atoms is None:
            return np.arange(n_atoms)
        if atoms.max(initial=-1) >= n_atoms:
            raise ValueError(
                f"atoms of {type(self).__name__} must be atoms 0 to {n_atoms - 1}; they name atom {atoms.max()}"
            )
        return atoms


def rows_of(name: str, vectors: Any, n: int) -> Array:
    """Vectors for each of n atoms, (n, 3).
    Raises ValueError for another number of vectors."""
    if vectors.shape not in ((3,), (n, 3)):
        raise ValueError(
            f"{name} must be three numbers or ({n}, 3), one row for each atom; its shape is {vectors.shape}"
        )
    return np.array(np.broadcast_to(vectors, (n, 3)))


def falling(term: FieldTerm, system: System) -> FieldTerm:
    """The term of constant forces, with the directions along which they do work."""
    forces = np.column_stack(term.columns)
    for axis in np.flatnonzero(system.cell.pbc).tolist():
        if (forces @ system.cell.vectors[axis]).any():
            term.falls_along += (axis,)
    return term


class ConstantForce(OnAtoms):
    """A constant force F on atoms, u = −F·r. r is never wrapped: u changes steadily as an atom is pulled along."""

    force: ArrayLike = declared(kind.vectors, "force on each atom", "force")
    atoms: ArrayLike | None = ATOMS

    def bind(self, system: System) -> Term:
        """The term of this force in a system.
        Raises ValueError if atoms, or their forces, are missing."""
        acting = self.atoms_in(system)
        forces = rows_of("force", self.force, len(acting))
        return falling(FieldTerm(acting, ConstantLaw(), tuple(forces.T)), system)


class Gravity(OnAtoms):
    """Weight, F = m g, u = −m g·r."""

    acceleration: ArrayLike = declared(kind.weight, "acceleration of free fall", "acceleration")
    atoms: ArrayLike | None = ATOMS

    def bind(self, system: System) -> Term:
        """The term of the weight of a system.
        Raises ValueError if atoms do not exist."""
        acting = self.atoms_in(system)
        weights = np.outer(np.asarray(self.acceleration), system.masses[acting])
        return falling(FieldTerm(acting, ConstantLaw(), tuple(weights)), system)


class Springs(OnAtoms):
    """Base class of harmonic springs from atoms to points."""

    def bind(self, system: System) -> FieldTerm:
        """The term of these springs in a system.
        Raises ValueError if atoms, or their points, are missing."""
        acting = self.atoms_in(system)
        arguments = self.arguments()
        numbers = (*np.broadcast_to(arguments["k"], 3), 0.0, 0.0, 0.0)  # the points are at rest
        columns = tuple(np.full(len(acting), number) for number in numbers)
        points = rows_of("points", arguments["points"], len(acting))
        return FieldTerm(acting, RestraintLaw(), columns, points)


class Restraint(Springs):
    """Harmonic springs from atoms to points, u = ½ Σ k_c (r − p)_c², c = x, y, z; r − p to the nearest image.

    k = 0 leaves a direction free.
    """

    k: ArrayLike = declared(kind.stiffness, "u = k (r − point)²/2", "stiffness", NOT_NEGATIVE)
    points: ArrayLike = declared(
        kind.points, "anchor points, one for all atoms or one for each", "length"
    )
    atoms: ArrayLike | None = ATOMS


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
    atoms: ArrayLike | None = ATOMS
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
        elapsed = min(max(time, self.start), self.end) - self.start
        return np.asarray(self.points) + np.asarray(self.velocity) * elapsed

    def bind(self, system: System) -> FieldTerm:
        """See Restraint."""
        term = super().bind(system)
        term.prepare = partial(self._move_points, term)
        term.depends_on_time = True
        term.fits_grid = False  # its work is no whole number of steps
        return term

    def _move_points(self, term: FieldTerm) -> None:
        """Move the points to where they are at the time of the term."""
        time = term.time
        for end in (self.start, self.end):
            if isclose(time, end, rel_tol=ROUNDED):
                time = end
        term.anchors[:] = self.points_at(time)
        term.is_moved = self.start < time <= self.end, self.start <= time < self.end
        for column, v in zip(term.columns[3:], np.asarray(self.velocity), strict=True):
            column[:] = v


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
    atoms: ArrayLike | None = ATOMS

    def bind(self, system: System) -> Term:
        """The term of this field in a system.
        Raises ValueError, TypeError as the class says."""
        acting = self.atoms_in(system)
        columns = self.columns("atoms", len(acting))
        trials = []
        if len(acting):
            for k in np.unique(np.linspace(0, len(acting) - 1, TRIED).astype(int)):
                numbers = tuple(column[k].item() for column in columns)
                trials.append(_Trial(self.law, system.positions[acting[k]] + BESIDE, numbers))
        _check_slopes(trials)
        term: Any = FieldTerm(acting, self.law, columns)  # type: ignore[arg-type]
        for k in np.flatnonzero(system.cell.pbc):
            if any(trial.changes(system.cell.vectors[k]) for trial in trials):
                term.changes_along += (int(k),)
        term.depends_on_time = any(len(trial.at(TIMES[0])) == TIMED for trial in trials)
        term.fits_grid = not term.depends_on_time  # its work is no whole number of steps
        return term


class _Trial(NamedTuple):
    """A user's law at the position of an atom, (3,), with its numbers."""

    law: Any
    position: Array
    numbers: tuple[float, ...]

    def at(self, time: float, shift: Array | float = 0.0) -> tuple[float, ...]:
        """What the law returns, at a time or (4,) away.
        Raises TypeError unless that is four or five numbers."""
        name = type(self.law).python.__name__
        x, *others = (np.array([*self.position, time]) + shift).tolist()
        try:
            returned = tuple(map(float, evaluate_law(self.law, x, (*others, *self.numbers))))
        except ArithmeticError:
            return (nan,) * 4
        except Exception as error:  # whatever a law of the user's raises
            raise TypeError(
                f"the law {name} must take x, y, z, t and {len(self.numbers)} parameters, "
                f"and return {RETURNED}: {error}"
            ) from None
        if len(returned) not in (4, TIMED):
            raise TypeError(
                f"the law {name} must return {RETURNED}; it returns {len(returned)} numbers"
            )
        return returned

    def compared(self, time: float) -> list[tuple[int, str]]:
        """The index of each number after u that is not zero, or should not be, by central differences; and what is
        wrong with it, or nothing."""
        u, *returned = self.at(time)
        position = ", ".join(f"{c:.4g}" for c in self.position)
        where = f"at ({position}), t = {time:g}"
        compared = []

        for k, step in enumerate(STEP * np.eye(len(SLOPES))):
            sign = -1.0 if k < 3 else 1.0
            slope, coarse = (
                sign * (self.at(time, n * step)[0] - self.at(time, -n * step)[0]) / (2.0 * n * STEP)
                for n in (1.0, 2.0)
            )
            number = returned[k] if k < len(returned) else 0.0
            are_zero = agree(number, 0.0, u) and agree(slope, 0.0, u)
            if are_zero or not (isfinite(number) and isfinite(slope)):
                continue
            if agree(number, slope, u, ROUGH * abs(slope - coarse)):
                fault = ""
            elif k < len(returned):
                fault = (
                    f"the law must return u, -∇u and ∂u/∂t, to a relative {ACCURACY:g}; {where} it returns "
                    f"{number:.8g} where {SLOPES[k]} is {slope:.8g}; "
                    "a force without a potential is a Term with is_checked = False (docs/own-laws.md)"
                )
            else:
                fault = (
                    "the law must return ∂u/∂t as its fifth number, because u depends on t; "
                    f"{where} it is {slope:.6g}"
                )

            compared.append((k, fault))

        return compared

    def changes(self, vector: Array) -> bool:
        """Whether the force is another one a lattice vector away."""
        force = np.array(self.at(TIMES[0])[1:4])
        at_image = self.at(TIMES[0], np.append(vector, 0.0))[1:4]
        tolerance = ACCURACY * np.abs(force).max()
        return not np.allclose(force, at_image, rtol=ACCURACY, atol=tolerance)


def _check_slopes(trials: list[_Trial]) -> None:
    """Raise ValueError if a number that a law returns is wrong at most places and times."""
    compared: list[tuple[int, str]] = []
    for trial in trials:
        for time in TIMES:
            try:
                compared += trial.compared(time)
            except TypeError:
                if time <= SOON:
                    raise  # at later times a law may have ended
    for k, fault in compared:
        faults = [other for index, other in compared if index == k]
        if fault and 2 * faults.count("") < len(faults):
            raise ValueError(fault)


class OwnWall(OnAtoms):
    """Base class of walls.

    around : Planar or Curved.  place(system, positions) : normal, three numbers, and place of the plane along it, or
    axis and radius [length]; and the distances (n,) of atoms from the wall, negative behind it [length].
    """

    around: ClassVar[Any]
    place: ClassVar[Callable[..., tuple[Any, float, Array]]]

    def bind(self, system: System) -> Term:
        """The term of this wall in a system.
        Raises ValueError if atoms are missing or lie on the wall or behind it, or if the wall crosses a periodic
            direction."""
        acting = self.atoms_in(system)
        arguments = self.arguments()
        normal, place, distances = self.place(system, system.positions[acting])
        behind = np.flatnonzero(~(distances > 0.0))
        if behind.size:
            d = float(distances[behind[0]])
            side = "inside" if self.around is Curved else "in front of"
            how = f"{-d:.3g} {system.units.length} behind" if d < 0.0 else "on"
            others = f", and {behind.size - 1} more" if behind.size > 1 else ""
            raise ValueError(
                f"atoms must be {side} a {type(self).__name__}; "
                f"atom {acting[behind[0]]} lies {how} the wall{others}: move the atom or the wall"
            )

        numbers = self.columns("atoms", len(acting))
        law = WALL_LAWS[arguments["law"]]
        reach = arguments["cutoff"] or inf
        rows, row_of_atom = np.unique(np.stack(numbers, axis=-1), axis=0, return_inverse=True)
        at_cutoff = np.zeros(len(rows))
        if reach < inf:
            at_cutoff[:] = [law_at(law, reach, tuple(row))[0] for row in rows.tolist()]
        shape = [np.full(len(acting), number) for number in (*normal.tolist(), place, reach)]
        columns = (*shape, at_cutoff[row_of_atom.reshape(-1)], *numbers)
        anchors = NOWHERE
        if self.around is Curved:
            anchors = np.tile(arguments["point"], (len(acting), 1))
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
    epsilon: ArrayLike = EPSILON
    sigma: ArrayLike = SIGMA
    cutoff: float | None = CUTOFF
    law: WallLaw = WALL_LAW
    atoms: ArrayLike | None = ATOMS

    def place(self, system: System, positions: Array) -> tuple[Any, float, Array]:
        """See OwnWall."""
        cell = system.cell
        vectors = cell.vectors[cell.pbc]
        normal = np.asarray(self.normal)
        crossed = np.abs((vectors * normal).sum(axis=1)) > ALONG * np.linalg.norm(vectors, axis=1)
        if crossed.any():
            k = np.flatnonzero(cell.pbc)[np.argmax(crossed)]
            raise ValueError(
                f"a Wall must lie along all periodic directions; it crosses {'abc'[k]}: set pbc to False there "
                f'(in a charged slab with Coulomb(..., slab="{"xyz"[k]}")), or turn the wall'
            )
        along_normal = float((normal * self.point).sum())
        distances = ((positions - np.asarray(self.point)) * normal).sum(axis=1)
        return normal, along_normal, distances


class RoundWall(OwnWall):
    """Base class of walls with atoms inside, around a point that stands for all its images."""

    around = Curved

    def place(self, system: System, positions: Array) -> tuple[Any, float, Array]:
        """See OwnWall; without an axis, distances are those from the center."""
        cell = system.cell
        arguments = self.arguments()
        radius = arguments["radius"]
        axis = getattr(self, "axis", np.zeros(3))
        away = positions - arguments["point"]
        n_cells = np.rint(np.einsum("ij,jk->ik", away, cell.inverse))
        away = away - np.where(cell.pbc, n_cells, 0.0) @ cell.lattice
        across = away - (away * axis).sum(axis=1)[:, None] * axis
        return axis, radius, radius - np.linalg.norm(across, axis=1)


class CylinderWall(RoundWall):
    """The wall of a cylinder with atoms inside: u(d) of the distance d = R − ρ from it.

    Positions count relative to the nearest image of the point.
    """

    point: ArrayLike = declared(kind.vector, "point on the axis", "length")
    axis: ArrayLike = declared(kind.direction, "direction of the axis, of any length")
    radius: float = declared(
        kind.number, "radius of the cylinder; atoms are inside", "length", POSITIVE
    )
    epsilon: ArrayLike = EPSILON
    sigma: ArrayLike = SIGMA
    cutoff: float | None = CUTOFF
    law: WallLaw = WALL_LAW
    atoms: ArrayLike | None = ATOMS


class SphereWall(RoundWall):
    """The wall of a sphere with atoms inside: u(d) of the distance d = R − |r − p| from it."""

    point: ArrayLike = declared(kind.vector, "center of the sphere", "length")
    radius: float = declared(
        kind.number, "radius of the sphere; atoms are inside", "length", POSITIVE
    )
    epsilon: ArrayLike = EPSILON
    sigma: ArrayLike = SIGMA
    cutoff: float | None = CUTOFF
    law: WallLaw = WALL_LAW
    atoms: ArrayLike | None = ATOMS
