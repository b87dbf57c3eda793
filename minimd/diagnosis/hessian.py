"""The curvature of the potential energy around a state: the stiffness of its bonds in closed form,
and its stiffest mode."""

from collections.abc import Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.machine import EPS
from minimd.constraints.constraint_set import ConstraintSet
from minimd.engine.engine import Engine
from minimd.forces.forces import Forces
from minimd.integrators.splitting.order_conditions import stability_limit
from minimd.neighbors.queries import closest_pair
from minimd.potentials.bonded import HarmonicBond
from minimd.structure.bond_graph import among
from minimd.structure.images import nearest_vectors
from minimd.structure.system import System

Array = NDArray[np.float64]

DISPLACEMENT = (
    1e-6  # of the closest pair: central differences are then right to some 1e-9, and few pairs cross their cutoff
)
ROUNDINGS = 1e-9  # of the largest coordinate: the smallest displacement, with six digits left after rounding
ROUNDINGS_OF_FORCES = 100.0  # in a sum over some fifty neighbors and its projection
SMALL = 90  # coordinates; up to this number the whole matrix is as cheap as iterations
ACCURACY = 1e-4  # of ω², relative
TRIED = 16  # bonds of the highest bare frequencies, whose freedom to stretch is examined
RIGID = 1e-9  # of its bare 1/μ: a bond to which constraints leave less cannot stretch
SEED = 1  # of the vector from which iterations start


class StiffBond(NamedTuple):
    """Atoms i and j of a harmonic bond with ω² = k (1/m_i + 1/m_j) [1/time²]."""

    i: int
    j: int
    square: float


def stiffest_bond(system: System, potentials: Sequence[Any], constraint_set: ConstraintSet) -> StiffBond | None:
    """The harmonic bond with the highest frequency of its own, ω² = k/μ; None if there is none that can stretch.

    With other bonds, and if nothing is compressed, the stiffest mode is faster still:
    ω² is a lower bound for its square.
    """
    found: list[StiffBond] = []
    for potential in potentials:
        if isinstance(potential, HarmonicBond):
            pairs = potential.groups_in(system)
            squares = potential.numbers()["k"] * constraint_set.inverse_masses[pairs].sum(axis=1)
            squares[among(pairs, constraint_set.bonds.pairs if constraint_set.bonds else pairs[:0])] = 0.0
            found += [
                StiffBond(int(pairs[b, 0]), int(pairs[b, 1]), float(squares[b]))
                for b in np.argsort(-squares)[:TRIED]
                if squares[b] > 0.0
            ]
    if constraint_set.bonds is not None:
        found = [bond._replace(square=bond.square * _free_part(system, bond, constraint_set)) for bond in found]
    return max((bond for bond in found if bond.square > 0.0), key=lambda bond: bond.square, default=None)


def _free_part(system: System, bond: StiffBond, constraint_set: ConstraintSet) -> float:
    """The fraction of 1/μ that constraints leave to a bond: the relative velocity that a unit impulse along it causes,
    times μ. From 0 to 1."""
    pair, inverse_masses = np.array([[bond.i, bond.j]]), constraint_set.inverse_masses[[bond.i, bond.j]]
    arm = _direction(nearest_vectors(system.positions, system.cell, pair)[0])
    velocities = np.zeros_like(system.positions)
    velocities[[bond.i, bond.j]] = np.outer(inverse_masses * [-1.0, 1.0], arm)
    constraint_set.project(velocities, system.positions)
    part = float((velocities[bond.j] - velocities[bond.i]) @ arm / inverse_masses.sum())
    return part if part > RIGID else 0.0


def _direction(arm: Array) -> Array:
    """The unit vector along a bond, (3,); an arbitrary one if its atoms are at the same place."""
    return arm / np.linalg.norm(arm) if arm.any() else np.full(3, 3.0**-0.5)


def unstable_bond(engine: Engine) -> str | None:
    """A clause if the time step is longer than a harmonic bond allows, else None. Other forces may allow still less."""
    bond, method, shown = (
        stiffest_bond(engine.system, engine.interactions.potentials, engine.constraint_set),
        engine.method,
        engine.system.units.shown,
    )
    if bond is None or abs(method.timestep) <= (limit := stability_limit(method.sequence()) / sqrt(bond.square)):
        return None
    return (
        f"timestep {shown(abs(method.timestep))} is longer than the bond of atoms {bond.i} and {bond.j} allows: "
        f"{method.name} is stable up to {shown(limit)} for it"
    )


class Curvature:
    """Products of D = M^−1/2 (∇²U − Σ λ ∇²g) M^−1/2 with vectors, on the directions that constraints allow.

    g = ½ (r² − d²) of each constraint, and λ its multiplier at rest: the curvature of the constraints acts like springs
    of stiffness −λ. Vectors w are mass-weighted displacements, w = M^1/2 u; D w is the change of M^−1/2 times the
    forces, with the opposite sign, from central differences. Positions of the system are changed and put back.

    is_finite : whether the forces of the state are finite numbers.  displacement :
        of the atom that is moved most [length].
    """

    def __init__(self, forces: Forces, constraint_set: ConstraintSet) -> None:
        self._forces, self._constraint_set, self._system = forces, constraint_set, forces.system
        constraint_set.fit(self._system)
        self._root = np.sqrt(constraint_set.inverse_masses)[:, None]
        self._start = self._system.positions.copy()
        self._first = forces.compute().copy()
        self.is_finite = bool(np.isfinite(self._first).all())
        self._springs: list[
            tuple[NDArray[np.int64], Array]
        ] = []  # (pairs, λ) of each group of constraints, for atoms at rest
        if (bonds := constraint_set.bonds) is not None:
            accelerations = self._first * constraint_set.inverse_masses[:, None]
            found = bonds.multipliers(self._start, np.zeros_like(self._start), accelerations)
            self._springs = [(bonds.pairs[order], multipliers) for order, multipliers in found]
        closest = closest_pair(self._system)
        scale = closest.distance if closest and closest.distance > 0.0 else 1.0
        self.displacement = max(DISPLACEMENT * scale, ROUNDINGS * float(np.abs(self._start).max()))

    @property
    def rounding(self) -> float:
        """The error of D that rounding of the forces causes [1/time²]: smaller eigenvalues mean nothing."""
        largest = float(np.abs(self._first).max(initial=0.0)) * float(self._constraint_set.inverse_masses.max())
        return ROUNDINGS_OF_FORCES * EPS * largest / self.displacement

    def times(self, vector: Array) -> Array:
        """D w, (3N,) both [1/time²]; first w is projected onto the directions that constraints allow."""
        steps = self._root * vector.reshape(-1, 3)
        self._constraint_set.project(steps, self._start)
        longest = float(np.sqrt(np.einsum("ij,ij->i", steps, steps).max()))
        if longest == 0.0:
            return np.zeros_like(vector)
        change = self._forces_at(steps, -self.displacement / longest) - self._forces_at(
            steps, self.displacement / longest
        )
        product = change * (0.5 * longest / self.displacement) + self._constraint_springs(steps)
        accelerations = self._constraint_set.inverse_masses[:, None] * product
        self._constraint_set.project(accelerations, self._start)
        return np.divide(accelerations, self._root, out=np.zeros_like(accelerations), where=self._root > 0.0).ravel()

    def stiffest(self, guess: Array) -> tuple[float, Array]:
        """The largest eigenvalue of D [1/time²] and its vector, (N, 3), of length one.  guess : (N, 3),
        a vector to start from."""
        if guess.size <= SMALL:
            matrix = np.stack([self.times(unit) for unit in np.eye(guess.size)])
            squares, modes = np.linalg.eigh(0.5 * (matrix + matrix.T))
            return float(squares[-1]), modes[:, -1].reshape(-1, 3)
        if not self.times(guess.ravel()).any():  # no curvature at all, which iterations do not accept
            return 0.0, np.zeros_like(guess)
        from scipy.sparse.linalg import LinearOperator, eigsh

        operator = LinearOperator((guess.size, guess.size), matvec=self.times, dtype=np.float64)
        squares, modes = eigsh(operator, k=1, which="LA", v0=guess.ravel(), tol=ACCURACY)
        return float(squares[0]), modes[:, 0].reshape(-1, 3)

    def guess(self, bond: StiffBond | None) -> Array:
        """A vector that contains a part of every mode, and a large part of the stretching of a bond. (N, 3)."""
        vector = np.random.default_rng(SEED).standard_normal(self._start.shape) / np.sqrt(self._start.size)
        return vector if bond is None else vector + self.stretching(np.array([[bond.i, bond.j]]))[0]

    def stretching(self, pairs: NDArray[np.int64]) -> Array:
        """The stretching mode of each pair alone: its atoms move apart, in any direction if they are at the same place.
        (B, N, 3), of length one."""
        modes = np.zeros((len(pairs), *self._start.shape))
        for mode, (i, j), arm in zip(modes, pairs, nearest_vectors(self._start, self._system.cell, pairs), strict=True):
            mode[i], mode[j] = np.outer((-self._root[i], self._root[j]), _direction(arm))
            mode /= np.linalg.norm(mode)
        return modes

    def _forces_at(self, steps: Array, length: float) -> Array:
        try:
            self._system.positions[:] = self._start + length * steps
            return self._forces.compute().copy()
        finally:
            self._system.positions[:] = self._start

    def _constraint_springs(self, steps: Array) -> Array:
        """−Σ λ ∇²g u, (N, 3): λ r_ij is the force on j, so that a step u changes it by λ (u_j − u_i)."""
        forces = np.zeros_like(steps)
        for pairs, multipliers in self._springs:
            pull = multipliers[:, None] * (steps[pairs[:, 1]] - steps[pairs[:, 0]])
            np.add.at(forces, pairs[:, 1], -pull)
            np.add.at(forces, pairs[:, 0], pull)
        return forces
