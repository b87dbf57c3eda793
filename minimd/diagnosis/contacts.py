"""The contacts of single atoms: how far their neighbors are, how hard each pair pushes, how stiff it is."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.potentials.bonded import BondPotential
from minimd.potentials.law import evaluate_law, is_user_law
from minimd.potentials.laws import HarmonicLaw, LennardJonesLaw
from minimd.potentials.pair import PairPotential
from minimd.structure.bond_graph import pairs_by_bonds_apart
from minimd.structure.images import nearest_images
from minimd.structure.system import System

NEAREST = 16  # neighbors of each atom that are looked at
STEP = 1e-5  # of a central difference, relative to the distance


@dataclass(frozen=True)
class Contact:
    """What one law does to one pair.

    Attributes
    ----------
    first, second : atoms.  law : name of the potential.  is_bond : whether the pair is fixed.  is_users : whether the law is the user's own.
    distance : r [length], of the nearest image.  ratio : r/σ, or r/r₀ of a harmonic bond; None where the law has no length of its own.
    energy, force : u(r), −u′(r) [energy], [energy/length]; positive where the pair repels.  frequency : √(u″/μ) [1/time], None where u″ ≤ 0.
    rest_frequency : √(u″/μ) at the minimum [1/time], of Lennard-Jones pairs and harmonic bonds; None of others.
    """

    first: int
    second: int
    law: str
    is_bond: bool
    is_users: bool
    distance: float
    ratio: float | None
    energy: float
    force: float
    frequency: float | None
    rest_frequency: float | None

    @property
    def is_finite(self) -> bool:
        """True if energy and force are finite."""
        return isfinite(self.energy) and isfinite(self.force)


def contacts(system: System, potentials: Sequence[Any], inverse_masses: NDArray[np.float64], atoms: Iterable[int]) -> list[Contact]:
    """The contacts of some atoms with their nearest neighbors, by pair potentials and bonds; other potentials have none.

    inverse_masses : (N,) [1/mass], zero for atoms held fixed.  atoms : finite in their positions.
    """
    known = sorted(set(atoms))
    return [
        _contact(potential, numbers, scale, pair, inverse_masses)
        for potential in potentials
        for numbers, scale, pair in _pairs_of(potential, system, known)
    ]


def law_at(law: tuple, r: float, numbers: tuple[float, ...]) -> tuple[float, float]:
    """u [energy] and u′ [energy/length] at a distance r [length]; NaN where the law has no finite number."""
    try:
        u, f = evaluate_law(law, r * r, numbers)
        return (nan, nan) if isinstance(u, complex) or isinstance(f, complex) else (float(u), -float(f) * r)
    except (ArithmeticError, ValueError):
        return nan, nan


def curvature(law: tuple, r: float, numbers: tuple[float, ...]) -> float:
    """u″(r) [energy/length²], by a central difference of u′."""
    high, low = (law_at(law, r * (1.0 + h), numbers)[1] for h in (STEP, -STEP))
    return (high - low) / (2.0 * STEP * r) if r > 0.0 else nan


Pair = tuple[int, int, float]  # two atoms and their distance


def _pairs_of(potential: Any, system: System, atoms: list[int]) -> Iterator[tuple[tuple[float, ...], float, Pair]]:
    """Numbers of the law, the factor on it, and the pair, of each contact."""
    if isinstance(potential, PairPotential):
        table, index, scales = potential.table(system.species_names), system.species_index, _scales(potential, system, atoms)
        for first, second, distance in _nearest(system, atoms):
            cutoff2, *numbers = table[index[first], index[second]] if len(table) > 1 else table[0, 0]
            scale = scales.get((min(first, second), max(first, second)), 1.0)
            if distance * distance < cutoff2 and scale != 0.0:
                yield tuple(map(float, numbers)), scale, (first, second, distance)
    elif isinstance(potential, BondPotential):
        pairs = np.asarray(system.bonds if potential.pairs is None else potential.pairs)
        if not len(pairs):
            return
        rows = np.flatnonzero(np.isin(pairs, atoms).any(axis=1))
        distances = _distances(system, pairs[rows])
        for row, distance in zip(rows, distances, strict=True):
            numbers = potential.table(len(pairs))[row, 1:]
            yield tuple(map(float, numbers)), 1.0, (int(pairs[row, 0]), int(pairs[row, 1]), float(distance))


def _scales(potential: PairPotential, system: System, atoms: list[int]) -> dict[tuple[int, int], float]:
    """Factors on pairs a few bonds apart, of those that hold one of the atoms."""
    if not len(system.bonds) or potential.bonded_scale == (1.0, 1.0, 1.0):
        return {}
    by_bonds = pairs_by_bonds_apart(system.bonds, len(system))
    return {
        (int(i), int(j)): factor
        for pairs, factor in zip(by_bonds, potential.bonded_scale, strict=True)
        for i, j in pairs[np.isin(pairs, atoms).any(axis=1)]
    }


def _nearest(system: System, atoms: list[int]) -> Iterator[Pair]:
    """The nearest neighbors of some atoms, each pair once."""
    told = set()
    for atom in atoms:
        others = np.delete(np.arange(len(system)), atom)
        distances = _distances(system, np.column_stack([np.full_like(others, atom), others]))
        for k in np.argsort(distances)[:NEAREST]:
            other = int(others[k])
            if (other, atom) not in told and np.isfinite(distances[k]):
                told.add((atom, other))
                yield atom, other, float(distances[k])


def _distances(system: System, pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    vectors = system.positions[pairs[:, 1]] - system.positions[pairs[:, 0]] + nearest_images(system.positions, system.cell, pairs)
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def _contact(potential: Any, numbers: tuple[float, ...], scale: float, pair: Pair, inverse_masses: NDArray[np.float64]) -> Contact:
    first, second, r = pair
    u, slope = law_at(potential.law, r, numbers)
    inverse_mass = float(inverse_masses[first] + inverse_masses[second])
    length, rest = _length_and_stiffness(potential, numbers)
    return Contact(
        first=first,
        second=second,
        law=type(potential).__name__,
        is_bond=isinstance(potential, BondPotential),
        is_users=is_user_law(potential.law),
        distance=r,
        ratio=r / length if length else None,
        energy=scale * u,
        force=-scale * slope,
        frequency=_frequency(scale * curvature(potential.law, r, numbers), inverse_mass),
        rest_frequency=_frequency(scale * rest, inverse_mass),
    )


def _length_and_stiffness(potential: Any, numbers: tuple[float, ...]) -> tuple[float | None, float]:
    """σ or r₀, and u″ at the minimum: 72 ε/(2^{1/3} σ²) of Lennard-Jones pairs, k of harmonic bonds; None and NaN if unknown."""
    if isinstance(potential, PairPotential) and isinstance(potential.plain_law, LennardJonesLaw):
        epsilon, sigma = numbers[-2:]
        return sigma, 72.0 * epsilon / (2.0 ** (1.0 / 3.0) * sigma * sigma)
    if isinstance(potential, BondPotential) and isinstance(potential.law, HarmonicLaw):
        return numbers[1] or None, numbers[0]
    return None, nan


def _frequency(stiffness: float, inverse_mass: float) -> float | None:
    return sqrt(stiffness * inverse_mass) if 0.0 < stiffness < inf else None
