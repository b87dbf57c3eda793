"""Fields: external forces on each atom, functions of its position and the time."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.by_address import ByAddress
from minimd.compiled.fixed_point import in_steps
from minimd.compiled.kernels import DirectCalls, by_type, called_kernel, without_cache
from minimd.compiled.program import GO_ON, OUT_OF_RANGE, Operation, in_python, n_chunks_of, operation
from minimd.console.words import shown
from minimd.potentials.accumulators import force_along, is_too_large
from minimd.potentials.each import Array
from minimd.potentials.field_laws import ConstantLaw, RestraintLaw
from minimd.potentials.law import evaluate_law
from minimd.potentials.pair_loop import ByPair, parameters_of_pair
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, OwnPotential, OwnTerm, Target, Term
from minimd.potentials.user_laws import is_recognized
from minimd.structure.cell import minimum_image
from minimd.structure.checks import checked_indices, checked_number, checked_numbers
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


class OwnField(OwnPotential):
    """Base class of fields.  atoms : (n,) int, those on which it acts; all if not given."""

    atoms: NDArray[np.int64] | None

    def atoms_in(self, system: System) -> NDArray[np.int64]:
        """(n,) int, those on which it acts in a system.  Raises ValueError if they name missing atoms."""
        if self.atoms is None:
            return np.arange(len(system))
        if self.atoms.max(initial=-1) >= len(system):
            name, last = type(self).__name__, len(system) - 1
            raise ValueError(f"atoms of {name} must be atoms 0 to {last}; they name atom {self.atoms.max()}")
        return self.atoms


class ConstantForce(OwnField):
    """A constant force F on atoms, u = −F·r; r is never wrapped: u changes steadily as an atom is pulled through cells.

    Parameters
    ----------
    force : F, three numbers [energy/length], the same for all atoms, or (n, 3).  atoms : indices; all if not given.

    Raises
    ------
    ValueError : if a number is not finite, or shapes do not fit.
    """

    def __init__(self, force: ArrayLike, atoms: ArrayLike | None = None) -> None:
        self.force, self.atoms = checked_vectors("force", force), checked_atoms(atoms)

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {"force": self.force, "atoms": self.atoms}

    def bind(self, system: System) -> Term:
        """The term of this force in a system.  Raises ValueError if atoms, or their forces, are missing."""
        atoms = self.atoms_in(system)
        return FieldTerm(atoms, ConstantLaw(), vector_columns("force", self.force, len(atoms)))


class Gravity(OwnField):
    """Weight, F = m g, u = −m g·r.

    Parameters
    ----------
    acceleration : g, three numbers [length/time²]; or one, downwards along z.  atoms : indices; all if not given.

    Raises
    ------
    ValueError : if a number is not finite, or shapes do not fit.
    """

    def __init__(self, acceleration: ArrayLike, atoms: ArrayLike | None = None) -> None:
        given = checked_numbers("acceleration", acceleration, "one number, downwards, or three")
        self.acceleration = checked_vectors("acceleration", [0.0, 0.0, -float(given)] if given.ndim == 0 else given)
        self.atoms = checked_atoms(atoms)
        if self.acceleration.ndim != 1:
            shape = self.acceleration.shape
            raise ValueError(f"acceleration must be one number, downwards, or three; its shape is {shape}")

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {"acceleration": self.acceleration, "atoms": self.atoms}

    def bind(self, system: System) -> Term:
        """The term of the weight of a system.  Raises ValueError if atoms do not exist."""
        atoms = self.atoms_in(system)
        weights = system.masses[atoms, None] * self.acceleration
        return FieldTerm(atoms, ConstantLaw(), vector_columns("force", weights, len(atoms)))


class Restraint(OwnField):
    """Harmonic springs from atoms to points, u = ½ Σ k_c (r − p)_c², c = x, y, z; r − p is that of the nearest image.

    Parameters
    ----------
    k : stiffness [energy/length²], one number or three, one for each direction; 0 leaves a direction free.
    points : p, (3,) one for all atoms, or (n, 3) [length].  atoms : indices; all if not given.

    Raises
    ------
    ValueError : if k is negative, a number is not finite, or shapes do not fit.
    """

    def __init__(self, k: ArrayLike, points: ArrayLike, atoms: ArrayLike | None = None) -> None:
        self.k, self.points, self.atoms = checked_stiffness(k), checked_vectors("points", points), checked_atoms(atoms)

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {"k": self.k, "points": self.points, "atoms": self.atoms}

    def bind(self, system: System) -> Term:
        """The term of these springs in a system.  Raises ValueError if atoms, or their points, are missing."""
        atoms = self.atoms_in(system)
        points = np.stack(vector_columns("points", self.points, len(atoms)), axis=-1)
        numbers = np.concatenate([np.broadcast_to(self.k, 3), np.zeros(3)])
        return FieldTerm(atoms, RestraintLaw(), tuple(np.full(len(atoms), one) for one in numbers.tolist()), points)


class SteeredSpring(Restraint):
    """Harmonic springs from atoms to moving points, p(t) = p + v (t' − start), with t' = t limited to [start, end].

    The work that moving the points does on the atoms, W = ∫ ∂u/∂t dt, is counted, and recorded as `work`.

    Parameters
    ----------
    k, points, atoms : as for Restraint; the points are those at the start.
    velocity : v, three numbers [length/time].  start, end : of the motion [time], by the clock of the simulation.

    Raises
    ------
    ValueError : as Restraint, or if end is not after start.
    """

    def __init__(
        self,
        k: ArrayLike,
        points: ArrayLike,
        velocity: ArrayLike,
        atoms: ArrayLike | None = None,
        *,
        start: float = 0.0,
        end: float = inf,
    ) -> None:
        super().__init__(k, points, atoms)
        self.velocity, self.start = checked_vectors("velocity", velocity), checked_number("start", start)
        self.end = inf if isinstance(end, float) and end == inf else checked_number("end", end)
        if self.velocity.ndim != 1 or not self.end > self.start:
            given = f"velocity = {shown(velocity)}, start = {start!r}, end = {end!r}"
            raise ValueError(f"velocity must be three numbers, and end after start; {given}")

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {name: getattr(self, name) for name in ("k", "points", "velocity", "atoms", "start", "end")}

    def points_at(self, time: float) -> Array:
        """p(t), of the shape of points [length]."""
        moved: Array = self.points + self.velocity * (min(max(time, self.start), self.end) - self.start)
        return moved

    def bind(self, system: System) -> Term:
        """See Restraint."""
        return _SteeredTerm(self, system)


class _SteeredTerm(FieldTerm):
    """A steered spring: before each evaluation its points move to where they are at that time."""

    depends_on_time = True
    fits_grid = False  # its work is no whole number of steps

    def __init__(self, spring: SteeredSpring, system: System) -> None:
        atoms = spring.atoms_in(system)
        self._spring, self._starts = spring, vector_columns("points", spring.points, len(atoms))
        numbers = np.concatenate([np.broadcast_to(spring.k, 3), np.zeros(3)])
        columns = tuple(np.full(len(atoms), one) for one in numbers.tolist())
        super().__init__(atoms, RestraintLaw(), columns, np.stack(self._starts, axis=-1))

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        yield in_python(self._move_points)
        yield from super().operations(system, target)

    def _move_points(self) -> None:
        spring = self._spring
        self.anchors[:] = spring.points_at(self.time)
        moves = spring.start <= self.time < spring.end
        for column, v in zip(self.columns[3:], spring.velocity.tolist(), strict=True):
            column[:] = v if moves else 0.0


def checked_atoms(atoms: ArrayLike | None) -> NDArray[np.int64] | None:
    """(n,) int, different atoms; None for None.  Raises ValueError for anything else."""
    if atoms is None:
        return None
    found = checked_indices("atoms", atoms, "a list of atoms")
    if found.ndim != 1 or found.min(initial=0) < 0 or len(np.unique(found)) < len(found):
        raise ValueError(f"atoms must be a list of different atoms, from 0 on; atoms = {shown(found.tolist())}")
    return found


def checked_vectors(name: str, values: ArrayLike) -> Array:
    """(3,) or (n, 3) finite numbers.  Raises ValueError for anything else."""
    array = checked_numbers(name, values, "three numbers, or three for each atom")
    if array.shape != (3,) and (array.ndim != 2 or array.shape[1] != 3):
        raise ValueError(f"{name} must be three numbers, or three for each atom; its shape is {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite; {name} = {shown(array.tolist())}")
    return array


def checked_stiffness(k: ArrayLike) -> Array:
    """One number or three, not negative.  Raises ValueError for anything else."""
    array = checked_numbers("k", k, "one number, or three")
    if array.shape not in ((), (3,)) or not (np.isfinite(array) & (array >= 0.0)).all():
        raise ValueError(f"k must be one number or three, finite and not negative; k = {shown(array.tolist())}")
    return array


def vector_columns(name: str, vectors: Array, n: int) -> tuple[Array, ...]:
    """The components of vectors for each of n atoms, (n,) each.  Raises ValueError for another number of vectors."""
    if vectors.shape not in ((3,), (n, 3)):
        wanted = f"three numbers or ({n}, 3), one row for each atom"
        raise ValueError(f"{name} must be {wanted}; its shape is {vectors.shape}")
    return tuple(np.array(np.broadcast_to(vectors[..., c], n)) for c in range(3))  # as columns_of
