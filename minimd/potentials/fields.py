"""Fields: external forces on each atom, functions of its position and the time."""

from __future__ import annotations

from collections import namedtuple
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.kernels import by_type, kernel, without_cache
from minimd.potentials.accumulators import force_along, in_steps, watch
from minimd.potentials.each import Array
from minimd.potentials.field_laws import ConstantLaw, RestraintLaw
from minimd.potentials.law import evaluate_law
from minimd.potentials.pair_loop import ByPair, parameters_of_pair
from minimd.potentials.term import FORCES, OwnPotential, OwnTerm, Term
from minimd.potentials.user_laws import is_recognized
from minimd.structure.cell import minimum_image
from minimd.structure.checks import checked_indices, checked_number, checked_numbers, shown
from minimd.structure.system import System

NOWHERE = np.zeros((0, 3))


class Sites(namedtuple("Sites", "atoms anchors lattice inverse pbc safe_distance2")):
    """Where a field acts.

    atoms : (n,) int.  anchors : (n, 3) points from which positions are counted, to the nearest image [length]; (0, 3)
        for the origin, and none.
    lattice, inverse, pbc, safe_distance2 : of the Cell.
    """


@by_type
def _rate(found):
    """∂u/∂t from what a law returns; zero if it returns only u and the force."""
    return (lambda found: found[4]) if len(found) > 4 else lambda found: 0.0


@kernel
def add_field_forces(positions, sites, law, parameters, time, detail, sums):
    """Add the forces and energies of a field u(x, y, z, t), and return Σ ∂u/∂t [energy/time].

    The virial is left out: fields act from outside.

    positions : (N, 3) [length].  sites : Sites.  law : law type.  parameters : see parameters_of_pair, of each site.
        time : t [time].
    detail : see Term.add.  sums : its accumulators forces and energies; or GridSums.
    """
    forces, energies = sums[0], sums[1]
    power, relative = 0.0, sites.anchors.shape[0] > 0
    for n in range(sites.atoms.size):
        i = sites.atoms[n]
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        if relative:
            x, y, z = x - sites.anchors[n, 0], y - sites.anchors[n, 1], z - sites.anchors[n, 2]
            a, b, c = minimum_image(x, y, z, sites.lattice, sites.inverse, sites.pbc, sites.safe_distance2)
            x += a * sites.lattice[0, 0] + b * sites.lattice[1, 0] + c * sites.lattice[2, 0]
            y += a * sites.lattice[0, 1] + b * sites.lattice[1, 1] + c * sites.lattice[2, 1]
            z += a * sites.lattice[0, 2] + b * sites.lattice[1, 2] + c * sites.lattice[2, 2]
        found = evaluate_law(law, x, (y, z, time) + parameters_of_pair(parameters, n, i, i))
        forces[i, 0] += force_along(found[1], 1.0, sums)
        forces[i, 1] += force_along(found[2], 1.0, sums)
        forces[i, 2] += force_along(found[3], 1.0, sums)
        power += _rate(found)
        watch(found[1] * found[1] + found[2] * found[2] + found[3] * found[3], sums)
        if detail != FORCES:
            energies[i] += in_steps(found[0], sums)
    return power


class FieldTerm(OwnTerm):
    """A field on some atoms.

    atoms : (n,) int.  columns : (n,) numbers of each, for each parameter of the law.  anchors : see Sites.
    """

    acts_from_outside = True

    def __init__(
        self,
        atoms: NDArray[np.int64],
        law: tuple,
        columns: tuple[Array, ...],
        anchors: Array = NOWHERE,
        warning: str = "",
    ) -> None:
        self._atoms, self._law, self.anchors, self.warning = atoms, law, np.ascontiguousarray(anchors), warning
        self.columns = columns
        self._loop = add_field_forces if is_recognized(law) else without_cache(add_field_forces)

    def add_to(self, system: System, detail: int, sums: Any) -> None:
        """See Term."""
        cell = system.cell
        sites = Sites(self._atoms, self.anchors, cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
        self.power = self._loop(system.positions, sites, self._law, ByPair(self.columns), self.time, detail, sums)


class OwnField(OwnPotential):
    """Base class of fields.  atoms : (n,) int, those on which it acts; all if not given."""

    atoms: NDArray[np.int64] | None

    def atoms_in(self, system: System) -> NDArray[np.int64]:
        """(n,) int, those on which it acts in a system.  Raises ValueError if they name missing atoms."""
        if self.atoms is None:
            return np.arange(len(system))
        if self.atoms.max(initial=-1) >= len(system):
            raise ValueError(
                f"atoms of {type(self).__name__} must be atoms 0 to {len(system) - 1}; they name atom "
                f"{self.atoms.max()}"
            )
        return self.atoms


class ConstantForce(OwnField):
    """A constant force F on atoms, u = −F·r; r is never wrapped,
    so the energy changes steadily as an atom is pulled through the cells.

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
        """The term of this force in a system.  Raises ValueError if atoms do not exist,
        or do not have one force each."""
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
            raise ValueError(
                f"acceleration must be one number, downwards, or three; its shape is {self.acceleration.shape}"
            )

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
        """The term of these springs in a system.  Raises ValueError if atoms do not exist,
        or do not have one point each."""
        atoms = self.atoms_in(system)
        points = np.stack(vector_columns("points", self.points, len(atoms)), axis=-1)
        numbers = np.concatenate([np.broadcast_to(self.k, 3), np.zeros(3)])
        return FieldTerm(atoms, RestraintLaw(), tuple(np.full(len(atoms), one) for one in numbers.tolist()), points)


class SteeredSpring(Restraint):
    """Harmonic springs from atoms to points that move, p(t) = p + v (t' − start),
    where t' is t limited to the time from start to end.

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
            raise ValueError(
                f"velocity must be three numbers, and end after start; velocity = {shown(velocity)}, start = "
                f"{start!r}, end = {end!r}"
            )

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {
            "k": self.k,
            "points": self.points,
            "velocity": self.velocity,
            "atoms": self.atoms,
            "start": self.start,
            "end": self.end,
        }

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

    def add_to(self, system: System, detail: int, sums: Any) -> None:
        """See Term."""
        spring = self._spring
        self.anchors[:] = spring.points_at(self.time)
        moves = spring.start <= self.time < spring.end
        for column, v in zip(self.columns[3:], spring.velocity.tolist(), strict=True):
            column[:] = v if moves else 0.0
        super().add_to(system, detail, sums)


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
        raise ValueError(
            f"{name} must be three numbers or ({n}, 3), one row for each atom; its shape is {vectors.shape}"
        )
    return tuple(np.array(np.broadcast_to(vectors[..., c], n)) for c in range(3))  # as columns_of
