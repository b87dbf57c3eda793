"""How stiff a scene is: bounds of its bonds and angles, collisions of Lennard-Jones atoms, the mode of one state."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from minimd.core.compiled.machine import EPS
from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.forces.forces import Forces
from minimd.core.neighbors.queries import closest_pair
from minimd.core.potentials.bonded import Bonded, HarmonicAngle, HarmonicBond
from minimd.core.potentials.laws import LennardJonesLaw
from minimd.core.potentials.pair import Nonbonded, curvature_at_minimum
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import among
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.system import System
from minimd.core.structure.units import BOLTZMANN_EV_PER_K, KJ_PER_MOL_PER_EV

# of the closest pair: central differences are then right to 1e-9, and few pairs cross their cutoff
DISPLACEMENT = 1e-6
ROUNDINGS = 1e-9  # of the largest coordinate: the smallest displacement, with six digits left after rounding
ROUNDINGS_OF_FORCES = 100.0  # in a sum over some fifty neighbors and its projection
SMALL = 90  # coordinates; up to this number the whole matrix is as cheap as iterations
ACCURACY = 1e-4  # of ω², relative
SEED = 1  # of the vector from which iterations start
# ω of the stiffest mode of a liquid, divided by that of a pair at rest; the modes: 4.8 at T* 0.7, ρ* 0.85; 5.8 at 1.44,
# 0.8442. (ω/ω_pair)² = cold + heat T*^(7/6) through these two; u″ ∝ u^(7/6) where a wall r⁻¹² stops an atom
CROWDED = 5.0
CROWDED_COLD = 15.0
CROWDED_HEAT = 12.2
# T* below which the floor of CROWDED counts
COLDEST = ((CROWDED**2 - CROWDED_COLD) / CROWDED_HEAT) ** (6.0 / 7.0)
# eV, eV, Å: ε of no atom that is wider than WIDE, and of no atom at all; metals: W 1.07 eV, 2.56 Å
DEEP = 0.5
DEEPEST = 2.0
WIDE = 2.7
# eV: ε of helium is 9e-4, that of xenon 0.02
SHALLOW = 5e-4
LIKELY = 0.05
READINGS = (  # of an ε in another unit: its name, its size in eV, and the factor in words
    ("K", BOLTZMANN_EV_PER_K, "* md.units.ASE.k_B"),
    ("kJ/mol", 1.0 / KJ_PER_MOL_PER_EV, "/ md.units.KJ_PER_MOL_PER_EV"),
    ("kcal/mol", 4.184 / KJ_PER_MOL_PER_EV, "* 4.184 / md.units.KJ_PER_MOL_PER_EV"),
    ("meV", 1e-3, "/ 1000"),
)


class Stiffness:
    """What is known of a scene without computing forces; each number is computed when it is first asked for."""

    def __init__(
        self, system: System, potentials: Sequence[Any], constraint_set: ConstraintSet
    ) -> None:
        self.system = system
        self._potentials = potentials
        self._constraint_set = constraint_set
        bonds = constraint_set.bonds
        no_bonds = np.zeros((0, 2), dtype=np.int64)
        self._held: Indices = no_bonds if bonds is None else bonds.pairs

    @cached_property
    def harmonic(self) -> list[Any]:
        """The potentials of harmonic bonds and angles."""
        return [law for law in self._potentials if isinstance(law, HarmonicBond | HarmonicAngle)]

    @property
    def stiffest_bond(self) -> Indices:
        """The harmonic bond with the largest k (1/m_i + 1/m_j), as (1, 2); (0, 2) without one."""
        inverse_masses = self._constraint_set.inverse_masses
        stiffest = np.zeros((0, 2), dtype=np.int64)
        largest = 0.0
        for law in self.harmonic:
            pairs = law.groups_in(self.system)
            if isinstance(law, HarmonicBond) and len(pairs):
                squares = law.numbers()["k"] * inverse_masses[pairs].sum(axis=1)
                b = int(np.argmax(squares))
                if squares[b] > largest:
                    largest = squares[b]
                    stiffest = pairs[b : b + 1]
        return stiffest

    @cached_property
    def bound(self) -> float:
        """ω² that no mode of the harmonic bonds and angles alone exceeds, near their rest angles [1/time²]:

            bonds + angles, each  max Σ_a |∇_a q| p_a/m_a,  p_a = Σ k |∇_a q|

        q is the length of a bond, or an angle; the first sum is over its atoms a, the second over all bonds, or angles,
        of an atom. For a long straight chain of bonds this is its ω². Row sums bound the eigenvalues (S. Gershgorin) of
        F G in E. B. Wilson, J. C. Decius, P. C. Cross, Molecular Vibrations (1955), chapter 4."""
        return sum(self._bound_of(kind) for kind in (HarmonicBond, HarmonicAngle))

    def _bound_of(self, kind: type[Bonded]) -> float:
        system = self.system
        pulls = np.zeros(len(system))
        terms = []
        for law in self.harmonic:
            if not isinstance(law, kind):
                continue
            groups = law.groups_in(system)
            k = np.broadcast_to(law.numbers()["k"], len(groups))
            slopes = np.ones(groups.shape)
            if kind is HarmonicBond and len(self._held):
                k = np.where(among(groups, self._held), 0.0, k)
            elif kind is HarmonicAngle:
                for end in (0, 2):
                    arms = nearest_vectors(system.positions, system.cell, groups[:, [1, end]])
                    slopes[:, end] = 1.0 / np.linalg.norm(arms, axis=1)
                slopes[:, 1] = slopes[:, 0] + slopes[:, 2]  # at most
            np.add.at(pulls, groups.ravel(), (k[:, None] * slopes).ravel())
            terms.append((groups, np.where(k[:, None] > 0.0, slopes, 0.0)))
        pulls *= self._constraint_set.inverse_masses
        rows = [np.einsum("ga,ga->g", slopes, pulls[groups]) for groups, slopes in terms]
        return max((float(squares.max(initial=0.0)) for squares in rows), default=0.0)

    def collisions(self, at_rest: bool = False) -> float:
        """ω of Lennard-Jones atoms that collide in a liquid [1/time]; 0 if there are none.

            ω² = u″(r_min)/μ · max(5², 15 + 12.2 T*^(7/6)),   T* = k_B T/ε of the velocities

        This is the largest ω of all pairs of species. An atom bonded to a heavier one moves with it, and does not
        count.
        at_rest : whether the velocities are left out."""
        system = self.system
        bonds = np.concatenate([system.bonds, self._held])
        masses = system.masses
        of_bonds = masses[bonds]
        lighter = bonds[np.arange(len(bonds)), np.argmin(of_bonds, axis=1)]
        inverse = np.divide(1.0, masses, out=np.zeros(len(masses)), where=masses > 0.0)
        inverse[lighter[of_bonds[:, 0] != of_bonds[:, 1]]] = 0.0
        fastest = np.zeros(len(system.species_names))
        np.maximum.at(fastest, system.species_index, inverse)
        thermal = 0.0 if at_rest else system.units.k_B * self.temperature
        square = 0.0
        for epsilon, sigma in self._wells():
            each = fastest if len(epsilon) > 1 else fastest.max(keepdims=True)
            is_moving = (each[:, None] > 0.0) & (each > 0.0)
            inverse_mass = np.where(is_moving, each[:, None] + each, 0.0)
            no_heat = np.zeros_like(epsilon)
            with np.errstate(over="ignore"):  # in a run that has blown up
                heat = np.divide(thermal, epsilon, out=no_heat, where=epsilon > 0.0)
                stiffness = curvature_at_minimum(epsilon, sigma) * inverse_mass
                crowd = np.maximum(CROWDED**2, CROWDED_COLD + CROWDED_HEAT * heat ** (7.0 / 6.0))
                square = max(square, float((stiffness * crowd).max()))
        return square**0.5

    @property
    def temperature(self) -> float:
        """T of the velocities relative to the center of mass, unless atoms are fixed [temperature]; 0 at rest."""
        return self._constraint_set.temperature(
            self.system.velocities, self.system, conserves_momentum=True
        )

    @cached_property
    def strange_depth(self) -> tuple[str, str] | None:
        """A cause and an advice if an ε in eV is larger than that of any atom, as a number in K or kJ/mol would be."""
        if self.system.units.is_reduced:
            return None
        for epsilon, sigma in self._wells():
            is_strange = (epsilon > DEEPEST) | ((epsilon > DEEP) & (sigma > WIDE))
            worst = float((epsilon * is_strange).max())
            if worst > 0.0:
                advice = [
                    f"if epsilon is in {unit}, it is {worst * size:.3g} eV: give epsilon={worst:.6g} {factor}"
                    for unit, size, factor in READINGS
                    if SHALLOW <= worst * size <= LIKELY
                ]
                usual = "noble gases 0.001 to 0.02 eV, metals up to 1 eV"
                cause = f"epsilon = {worst:.6g} eV is far deeper than any Lennard-Jones well of atoms ({usual})"
                return cause, "; ".join(advice) or "check its unit"
        return None

    def _wells(self) -> Iterator[tuple[Array, Array]]:
        """ε and σ of each Lennard-Jones potential for pairs of species, (S, S) each."""
        for potential in self._potentials:
            is_pair = isinstance(potential, Nonbonded)
            if is_pair and isinstance(potential.plain_law, LennardJonesLaw):
                table = potential.table(self.system.species_names)
                yield table[..., -2], table[..., -1]


def direction(arm: Array) -> Array:
    """The unit vector along a bond, (3,); an arbitrary one if its atoms are at the same place."""
    return arm / np.linalg.norm(arm) if arm.any() else np.full(3, 3.0**-0.5)


class Curvature:
    """Products of D = M^−1/2 (∇²U − Σ λ ∇²g) M^−1/2 with vectors, on the directions that constraints allow.

    g = ½ (r² − d²) of each constraint, and λ its multiplier at rest: the curvature of the constraints acts like springs
    of stiffness −λ. Vectors w are mass-weighted displacements, w = M^1/2 u; D w is the change of M^−1/2 times the
    forces, with the opposite sign, from central differences. Positions of the system are changed and put back.
    is_finite : whether the forces of the state are finite.
    displacement : of the atom that is moved most [length]."""

    def __init__(self, forces: Forces, constraint_set: ConstraintSet) -> None:
        self._forces = forces
        self._constraint_set = constraint_set
        self._system = forces.system
        constraint_set.fit(self._system)
        self._root = np.sqrt(constraint_set.inverse_masses)[:, None]
        self._start = self._system.positions.copy()
        self._first = forces.compute().forces.copy()
        self.is_finite = bool(np.isfinite(self._first).all())
        # (pairs, λ) of each group of constraints, for atoms at rest
        self._springs: list[tuple[Indices, Array]] = []
        bonds = constraint_set.bonds
        if bonds is not None:
            accelerations = self._first * constraint_set.inverse_masses[:, None]
            at_rest = np.zeros_like(self._start)
            groups = bonds.multipliers(self._start, at_rest, accelerations)
            self._springs = [(bonds.pairs[order], multipliers) for order, multipliers in groups]
        closest = closest_pair(self._system)
        scale = closest.distance if closest and closest.distance > 0.0 else 1.0
        self.displacement = max(DISPLACEMENT * scale, ROUNDINGS * float(np.abs(self._start).max()))

    @property
    def rounding(self) -> float:
        """The error of D that rounding of the forces causes [1/time²]: smaller eigenvalues mean nothing."""
        inverse_masses = self._constraint_set.inverse_masses
        largest = float(np.abs(self._first).max(initial=0.0)) * float(inverse_masses.max())
        return ROUNDINGS_OF_FORCES * EPS * largest / self.displacement

    def times(self, vector: Array) -> Array:
        """D w, (3N,) both [1/time²]; first w is projected onto the directions that constraints allow."""
        steps = self._root * vector.reshape(-1, 3)
        self._constraint_set.project(steps, self._start)
        longest = float(np.sqrt(np.einsum("ij,ij->i", steps, steps).max()))
        if longest == 0.0:
            return np.zeros_like(vector)
        step = self.displacement / longest
        change = self._forces_at(steps, -step) - self._forces_at(steps, step)
        product = change * (0.5 * longest / self.displacement)
        # λ r_ij is the force on j: a step u changes it by λ (u_j − u_i)
        for pairs, multipliers in self._springs:
            pull = multipliers[:, None] * (steps[pairs[:, 1]] - steps[pairs[:, 0]])
            np.add.at(product, pairs[:, 1], -pull)
            np.add.at(product, pairs[:, 0], pull)
        accelerations = self._constraint_set.inverse_masses[:, None] * product
        self._constraint_set.project(accelerations, self._start)
        weighted = np.zeros_like(accelerations)
        np.divide(accelerations, self._root, out=weighted, where=self._root > 0.0)
        return weighted.ravel()

    def stiffest(self, guess: Array, accuracy: float = ACCURACY) -> tuple[float, Array]:
        """The largest eigenvalue of D [1/time²] and its vector, (N, 3), of length one.
        guess : (N, 3), of a start.
        accuracy : of ω², relative, at least."""
        if guess.size <= SMALL:
            matrix = np.stack([self.times(unit) for unit in np.eye(guess.size)])
            squares, modes = np.linalg.eigh(0.5 * (matrix + matrix.T))
            return float(squares[-1]), modes[:, -1].reshape(-1, 3)
        # no curvature at all, which iterations do not accept
        if not self.times(guess.ravel()).any():
            return 0.0, np.zeros_like(guess)
        from scipy.sparse.linalg import LinearOperator, eigsh

        operator = LinearOperator((guess.size, guess.size), matvec=self.times, dtype=np.float64)
        squares, modes = eigsh(operator, k=1, which="LA", v0=guess.ravel(), tol=accuracy)
        return float(squares[0]), modes[:, 0].reshape(-1, 3)

    def guess(self, bond: Indices) -> Array:
        """A vector that contains a part of every mode, and a large part of the stretching of a bond. (N, 3).
        bond : (1, 2), or (0, 2) for none."""
        start = self._start
        vector = np.random.default_rng(SEED).standard_normal(start.shape) / np.sqrt(start.size)
        return vector + self.stretching(bond).sum(axis=0)

    def stretching(self, pairs: Indices) -> Array:
        """The stretching mode of each pair alone: its atoms move apart, in any direction if they are at the same place.
        (B, N, 3), of length one."""
        modes = np.zeros((len(pairs), *self._start.shape))
        arms = nearest_vectors(self._start, self._system.cell, pairs)
        for mode, pair, arm in zip(modes, pairs, arms, strict=True):
            mode[pair] = np.outer(self._root[pair] * [[-1.0], [1.0]], direction(arm))
            mode /= np.linalg.norm(mode)
        return modes

    def _forces_at(self, steps: Array, length: float) -> Array:
        try:
            self._system.positions[:] = self._start + length * self._system.cell.projected(steps)
            return self._forces.compute().forces.copy()
        finally:
            self._system.positions[:] = self._start
