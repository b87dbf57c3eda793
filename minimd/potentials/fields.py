"""Fields: external forces on each atom, functions of its position and the time.

A user's field, its force and its change with time are checked before they are trusted.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Sequence
from math import inf, isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.by_address import ByAddress
from minimd.compiled.fixed_point import force_along, in_steps, is_too_large
from minimd.compiled.kernels import DirectCalls, by_type, called_kernel, without_cache
from minimd.compiled.program import GO_ON, OUT_OF_RANGE, Operation, in_python, n_chunks_of, operation
from minimd.potentials.declared import (
    NOT_NEGATIVE,
    Array,
    Declared,
    atoms,
    declared,
    number,
    own_law,
    own_parameters,
    points,
    stiffness,
    vector,
    vectors,
    weight,
)
from minimd.potentials.law import ACCURACY, agree, evaluate_law
from minimd.potentials.laws import ConstantLaw, RestraintLaw
from minimd.potentials.pair_loop import ByPair, parameters_of_pair
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, OwnTerm, Target, Term
from minimd.potentials.user_laws import is_recognized
from minimd.structure.cell import minimum_image
from minimd.structure.system import System

NOWHERE = np.zeros((0, 3))


class Sites(
    ByAddress,
    namedtuple(
        "Sites", "positions images atoms anchors law parameters time forces steps detail totals powers energies"
    ),
):
    """Where a field acts, and what on.

    positions : (N, 3) [length].  images : Images.  atoms : (n,) int, all different.
    anchors : (n, 3) points from which positions are counted, to the nearest image [length]; (0, 3) for the origin, and
        none.
    law : law type.  parameters : see parameters_of_pair, of each site.  time : (1,) t [time].
    forces, steps, detail : see Target.  totals, powers : (chunks,) output, Σ u [energy] and Σ ∂u/∂t [energy/time].
    energies : (N,), to which PER_ATOM adds.
    """


@by_type
def _rate(found):
    """∂u/∂t from what a law returns; zero if it returns only u and the force."""
    return (lambda found: found[4]) if len(found) > 4 else lambda found: 0.0


@called_kernel
def add_field(sites, chunk):
    """Add the forces and energies of a field u(x, y, z, t).  OUT_OF_RANGE if a force is beyond the range of a grid.
    The virial is left out: fields act from outside."""
    positions, images, atoms, anchors, law, parameters, time, forces, steps, detail, totals, powers, energies = sites
    lattice, inverse, pbc, safe_distance2 = images
    n_chunks, total, power, is_out = totals.size, 0.0, 0.0, False
    for n in range(chunk * atoms.size // n_chunks, (chunk + 1) * atoms.size // n_chunks):
        i = atoms[n]
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        if anchors.shape[0] > 0:
            x, y, z = x - anchors[n, 0], y - anchors[n, 1], z - anchors[n, 2]
            a, b, c = minimum_image(x, y, z, lattice, inverse, pbc, safe_distance2[0])
            x += a * lattice[0, 0] + b * lattice[1, 0] + c * lattice[2, 0]
            y += a * lattice[0, 1] + b * lattice[1, 1] + c * lattice[2, 1]
            z += a * lattice[0, 2] + b * lattice[1, 2] + c * lattice[2, 2]
        found = evaluate_law(law, x, (y, z, time[0]) + parameters_of_pair(parameters, n, i, i))
        forces[i, 0] += force_along(found[1], 1.0, steps)
        forces[i, 1] += force_along(found[2], 1.0, steps)
        forces[i, 2] += force_along(found[3], 1.0, steps)
        power += _rate(found)
        is_out |= is_too_large(found[1] * found[1] + found[2] * found[2] + found[3] * found[3], steps)
        if detail != FORCES:
            total += in_steps(found[0], steps)
        if detail == PER_ATOM:
            energies[i] += in_steps(found[0], steps)
    totals[chunk], powers[chunk] = total, power
    return OUT_OF_RANGE if is_out else GO_ON


class FieldTerm(OwnTerm):
    """A field on some atoms.

    atoms : (n,) int, all different.  columns : (n,) numbers of each, for each parameter of the law.  anchors : see
        Sites.
    """

    acts_from_outside = fits_grid = True

    def __init__(
        self,
        atoms: NDArray[np.int64],
        law: tuple,
        columns: tuple[Array, ...],
        anchors: Array = NOWHERE,
        warning: str = "",
    ) -> None:
        self._atoms, self._law, self.anchors, self.warning = atoms, law, np.ascontiguousarray(anchors), warning
        self.columns, self._time = columns, np.zeros(1)
        n_chunks = n_chunks_of(len(atoms))
        self._totals, self._powers = np.zeros(n_chunks), np.zeros(n_chunks)
        self._loop = add_field if is_recognized(law) else without_cache(add_field)
        self._calls = DirectCalls()

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        sums = target.detail, self._totals, self._powers, target.energies
        acting = self._atoms, self.anchors, self._law, ByPair(self.columns), self._time, target.forces, target.steps
        sites = Sites(system.positions, target.images, *acting, *sums)
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
            name, last = type(self).__name__, len(system) - 1
            raise ValueError(f"atoms of {name} must be atoms 0 to {last}; they name atom {own.max()}")
        return own


class ConstantForce(OnAtoms):
    """A constant force F on atoms, u = −F·r. r is never wrapped: u changes steadily as an atom is pulled along."""

    force: ArrayLike = declared(vectors, "on each atom", "force")
    atoms: ArrayLike | None = declared(atoms, default=None)

    def bind(self, system: System) -> Term:
        """The term of this force in a system.  Raises ValueError if atoms, or their forces, are missing."""
        acting = self.atoms_in(system)
        return FieldTerm(acting, ConstantLaw(), (*rows_of("force", self.force, len(acting)).T,))


class Gravity(OnAtoms):
    """Weight, F = m g, u = −m g·r."""

    acceleration: ArrayLike = declared(weight, "of free fall", "acceleration")
    atoms: ArrayLike | None = declared(atoms, default=None)

    def bind(self, system: System) -> Term:
        """The term of the weight of a system.  Raises ValueError if atoms do not exist."""
        acting = self.atoms_in(system)
        return FieldTerm(acting, ConstantLaw(), (*np.outer(np.asarray(self.acceleration), system.masses[acting]),))


class Springs(OnAtoms):
    """Base class of harmonic springs from atoms to points."""

    def bind(self, system: System) -> Term:
        """The term of these springs in a system.  Raises ValueError if atoms, or their points, are missing."""
        return SpringTerm(self, self.atoms_in(system))


class Restraint(Springs):
    """Harmonic springs from atoms to points, u = ½ Σ k_c (r − p)_c², c = x, y, z; r − p to the nearest image.

    k = 0 leaves a direction free.
    """

    k: ArrayLike = declared(stiffness, "u = k (r − point)²/2", "stiffness", NOT_NEGATIVE)
    points: ArrayLike = declared(points, "one for all atoms, or one for each", "length")
    atoms: ArrayLike | None = declared(atoms, default=None)


class SteeredSpring(Springs):
    """Harmonic springs from atoms to moving points, p(t) = p + v (t' − start), with t' = t limited to [start, end].

    The work that moving the points does on the atoms, W = ∫ ∂u/∂t dt, is counted, and recorded as `work`.
    start and end are by the clock of the simulation.
    """

    k: ArrayLike = declared(stiffness, "u = k (r − point)²/2", "stiffness", NOT_NEGATIVE)
    points: ArrayLike = declared(points, "at the start; one for all atoms, or one for each", "length")
    velocity: ArrayLike = declared(vector, "of the points", "velocity")
    atoms: ArrayLike | None = declared(atoms, default=None)
    start: float = declared(number, "of the motion of the points", "time", default=0.0, kw_only=True)
    end: float = declared(number, "of it; never if not given", "time", of=inf, default=inf, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.end > self.start:
            raise ValueError(f"end must be after start; start = {self.start!r}, end = {self.end!r}")

    def points_at(self, time: float) -> Array:
        """p(t), of the shape of points [length]."""
        moved: Array = np.asarray(self.velocity) * (min(max(time, self.start), self.end) - self.start)
        return np.asarray(self.points) + moved

    def bind(self, system: System) -> Term:
        """See Restraint."""
        return SteeredTerm(self, self.atoms_in(system))


class SpringTerm(FieldTerm):
    """Springs on atoms, (n,) int."""

    def __init__(self, springs: Any, acting: NDArray[np.int64]) -> None:
        numbers = np.concatenate([np.broadcast_to(springs.k, 3), np.zeros(3)])  # the points are at rest
        columns = (*np.repeat(numbers[:, None], len(acting), axis=1),)
        super().__init__(acting, RestraintLaw(), columns, rows_of("points", springs.points, len(acting)))


class SteeredTerm(SpringTerm):
    """Steered springs: before each evaluation their points move to where they are at that time."""

    depends_on_time = True
    fits_grid = False  # its work is no whole number of steps

    def __init__(self, spring: SteeredSpring, acting: NDArray[np.int64]) -> None:
        super().__init__(spring, acting)
        self._spring = spring

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        yield in_python(self._move_points)
        yield from super().operations(system, target)

    def _move_points(self) -> None:
        spring = self._spring
        self.anchors[:] = spring.points_at(self.time)
        moves = spring.start <= self.time < spring.end
        for column, v in zip(self.columns[3:], np.asarray(spring.velocity), strict=True):
            column[:] = v if moves else 0.0


def rows_of(name: str, vectors: Any, n: int) -> Array:
    """Vectors for each of n atoms, (n, 3).  Raises ValueError for another number of vectors."""
    if vectors.shape not in ((3,), (n, 3)):
        wanted = f"three numbers or ({n}, 3), one row for each atom"
        raise ValueError(f"{name} must be {wanted}; its shape is {vectors.shape}")
    return np.array(np.broadcast_to(vectors, (n, 3)))


TRIED = 5  # atoms at which a law is tried
TIMES = (0.0, 0.37, 1.9)  # at which it is tried
TIMED = 5  # numbers that a law returns if its u depends on time
STEP = 1e-5  # of a central difference, of the units of length and time


class Field(OnAtoms):
    """A user's field, u(x, y, z, t).

        def trap(x, y, z, t, k):
            return 0.5 * k * (x * x + y * y), -k * x, -k * y, 0.0

        md.Field(trap, (2.0,))

    law(x, y, z, t, *parameters) of the position of an atom, which is never wrapped [length], and the time [time]
    returns u [energy] and the force, three numbers [energy/length]; and, if u depends on t, ∂u/∂t [energy/time] as a
    fifth number, from which the work is counted. It is plain Python, or compiled by numba.njit. bind raises TypeError
    for a law that does not return such numbers, ValueError for a force that is not −∇u, or a u that changes with time
    where ∂u/∂t is not returned.
    """

    law: Callable = declared(own_law, "law(x, y, z, t, *parameters)")
    parameters: Sequence[ArrayLike] = declared(own_parameters, default=())
    atoms: ArrayLike | None = declared(atoms, default=None)

    def bind(self, system: System) -> Term:
        """The term of this field in a system.  Raises ValueError, TypeError as the class says."""
        acting = self.atoms_in(system)
        columns = self.columns("atoms", len(acting))
        law: Any = self.law
        some = np.unique(np.linspace(0, len(acting) - 1, TRIED).astype(int)) if len(acting) else ()
        tried = [_Tried(law, system.positions[acting[k]], tuple(one[k].item() for one in columns)) for k in some]
        faults = [fault for one in tried for time in TIMES for fault in one.wrong(time)]
        for k, sentence in faults:
            if 2 * sum(other == k for other, _ in faults) > len(tried) * len(TIMES):
                raise ValueError(sentence)
        warning = next((words for one in tried if (words := one.repeats(system))), "")
        term = FieldTerm(acting, law, columns, warning=warning)
        term.depends_on_time = any(one.is_timed for one in tried)
        term.fits_grid = not term.depends_on_time  # its work is no whole number of steps
        return term


class _Tried:
    """A user's law at the position of an atom."""

    def __init__(self, law: tuple, place: Array, numbers: tuple[float, ...]) -> None:
        self.law, self.place, self.numbers = law, place, numbers
        self.is_timed = len(self.at(TIMES[0])) == TIMED

    def at(self, time: float, shift: Array | float = 0.0) -> tuple[float, ...]:
        """What the law returns.  Raises TypeError unless that is four or five numbers."""
        name = type(self.law).python.__name__  # type: ignore[attr-defined]
        x, y, z = (self.place + shift).tolist()
        wanted = "u, three forces, and ∂u/∂t if it depends on t"
        try:
            found = tuple(float(one) for one in evaluate_law(self.law, x, (y, z, time, *self.numbers)))
        except ArithmeticError:
            return (nan,) * 4
        except Exception as error:  # whatever a law of the user's raises
            taken = f"x, y, z, t and {len(self.numbers)} parameters"
            raise TypeError(f"the law {name} must take {taken}, and return {wanted}: {error}") from None
        if len(found) not in (4, TIMED):
            raise TypeError(f"the law {name} must return {wanted}; it returns {len(found)} numbers")
        return found

    def slopes(self, time: float) -> Array:
        """−∇u and ∂u/∂t by central differences, (4,)."""
        steps = [(h, 0.0) for h in STEP * np.eye(3)] + [(np.zeros(3), STEP)]
        return np.array([(self.at(time - dt, h)[0] - self.at(time + dt, -h)[0]) / (-2.0 * STEP) for h, dt in steps])

    def wrong(self, time: float) -> Iterator[tuple[int, str]]:
        """What is wrong: the index of a wrong number among those after u, and a sentence."""
        u, *told = self.at(time)
        for k, (said, slope) in enumerate(zip((*told, 0.0)[:4], self.slopes(time).tolist(), strict=True)):
            if isfinite(said) and isfinite(slope) and not agree(said, slope, u):
                at = f"at ({', '.join(f'{c:.4g}' for c in self.place)}), t = {time:g}"
                what = f"-∂u/∂{'xyz'[k]}" if k < len("xyz") else "∂u/∂t"
                if k == len(told):
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
