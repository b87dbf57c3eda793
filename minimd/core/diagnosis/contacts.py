"""Contacts of single atoms: how far, how strong and how stiff each pair is, and which law gives no finite number; and
of atoms with their own images."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan, sqrt
from typing import Any

import numpy as np

from minimd.core.console.quiet import quiet
from minimd.core.console.words import shown
from minimd.core.forces.forces import Forces
from minimd.core.forces.options import Options
from minimd.core.neighbors.queries import neighbor_list
from minimd.core.potentials.bonded import Bond
from minimd.core.potentials.law import is_user_law, law_at, reads_table
from minimd.core.potentials.laws import FENELaw, HarmonicLaw, LennardJonesLaw
from minimd.core.potentials.pair import Nonbonded, curvature_at_minimum
from minimd.core.potentials.term import PER_ATOM
from minimd.core.structure.arrays import Array
from minimd.core.structure.bond_graph import checked_pairs, pairs_by_bonds_apart
from minimd.core.structure.cell import nearest_vectors
from minimd.core.structure.system import System

# neighbors of each atom that are examined: more than the 12 to 14 of a dense shell in a liquid
NEAREST = 16
# times the distance of an atom from its nearest image: a law that keeps atoms apart pushes it there; neighbors are that
# near, FEWEST of them in a layer of a crystal and two images
FARTHER = 1.1
AROUND = 1.05
FEWEST = 6
OPEN_IT = "leave this direction open, as with pbc=(True, True, False), in a scene [structure] pbc, or make it thicker"
STEP = 1e-5  # of a central difference, relative to the distance


@dataclass(frozen=True)
class Contact:
    """What one law does to one pair.

    first, second : atoms.
    law : name of the potential.
    is_bond : whether the pair is bonded.
    is_users : whether the law is a user's, or a table.
    distance : r [length], of the nearest image.
    ratio : r/σ, or r/r₀ of a harmonic bond; None if the law has no length of its own.
    energy, force : u(r), −u′(r) [energy], [energy/length]; positive where the pair repels.
    frequency : √(u″/μ) [1/time], None where u″ ≤ 0.
    rest_frequency : √(u″/μ) at the minimum [1/time], of Lennard-Jones pairs and harmonic bonds; None of others.
    sinks : whether the pair attracts, and the energy still falls at half the distance: nothing keeps the atoms apart.
    longest : R of a FENE bond [length]; None of others.
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
    sinks: bool = False
    longest: float | None = None

    @property
    def is_finite(self) -> bool:
        """True if energy and force are finite."""
        return isfinite(self.energy) and isfinite(self.force)

    @property
    def atoms(self) -> str:
        """The pair as text."""
        return f"atoms {self.first} and {self.second}"

    def apart(self, length: str) -> str:
        """The distance as text.
        length : its unit."""
        rest = "r₀" if self.is_bond else "σ"
        ratio = "" if self.ratio is None else f" (r/{rest} = {self.ratio:.3g})"
        limit = "" if self.longest is None else f" (longest = {self.longest:.4g} {length})"
        return f"{self.distance:.3g} {length} apart{ratio}{limit}"

    def without_number(self, length: str) -> str:
        """That the law gives no finite number here, as a clause.
        length : as for apart."""
        return (
            f"the law of {self.law} gives no finite number for {self.atoms}, {self.apart(length)}"
        )

    @property
    def cure(self) -> str:
        """What to do about a law without a finite number."""
        if self.longest is not None and self.distance >= self.longest:
            return "begin with shorter bonds or give a larger longest; if a run broke the bond, reduce the timestep"
        return "correct the law at that distance, or keep atoms away from it"

    def stiffness(self, timestep: float) -> str:
        """Δt·ω as text; empty if the pair does not oscillate."""
        return "" if self.frequency is None else f", Δt·ω = {self.frequency * abs(timestep):.3g}"


def why_not_finite(system: System, potentials: Sequence[Any]) -> str:
    """Which law of which atoms, or which potential, gives energies or forces that are not finite, as a clause."""
    for potential in potentials:
        with quiet():  # its warnings have been given
            alone = Forces(system, potential, Options(skin=0.0))
            sums = alone.compute(PER_ATOM)
        is_finite = np.isfinite(sums.forces).all(axis=1) & np.isfinite(sums.energies)
        bad = np.flatnonzero(~is_finite).tolist()
        if bad:
            for contact in contacts(system, [potential], np.ones(len(system)), bad[:2]):
                if not contact.is_finite:
                    return f"{contact.without_number(system.units.length)}; {contact.cure}"
            return f"{shown(potential)} gives no finite number for atom {bad[0]}"

    return "each potential alone is finite, but not their sum"


def thin_cell(system: System, potentials: Sequence[Any]) -> str:
    """That atoms are pushed by their own images, as a clause; empty if they are not. OPEN_IT says what to do.

    As in a file of two dimensions, whose third edge has no meaning. The pair energy of an atom and its nearest image
    would fall if this distance grew by a tenth, and half of the atoms have fewer than FEWEST neighbors as near, images
    in other directions among them: in a compressed crystal there are more.
    """
    cell = system.cell
    if not cell.is_periodic:
        return ""
    vector = min(cell.lattice[cell.pbc], key=np.linalg.norm)
    edge = float(np.linalg.norm(vector))
    is_pushed = any(
        np.diff(potential.pair_energy([edge, FARTHER * edge], name, name)) < 0.0
        for potential in potentials
        if isinstance(potential, Nonbonded)
        for name in system.species_names
    )
    if not is_pushed or np.median(np.bincount(neighbor_list("i", system, AROUND * edge))) >= FEWEST:
        return ""
    length = f"its lattice vector {vector} is {edge:.3g} {system.units.length} long"
    return f"the cell is thinner than the distance of neighbors: {length}, and atoms push their own images away"


# two atoms, their distance, the factor on the law, and its numbers
Pair = tuple[int, int, float, float, tuple[float, ...]]


def contacts(
    system: System,
    potentials: Sequence[Any],
    inverse_masses: Array,
    atoms: Iterable[int],
) -> list[Contact]:
    """The contacts of some atoms with their nearest neighbors, by pair potentials and bonds; others have none.

    inverse_masses : (N,) [1/mass], zero for atoms held fixed.
    atoms : finite in their positions.
    """
    examined: list[Contact] = []
    known = sorted(set(atoms))

    for potential in potentials:
        if isinstance(potential, Nonbonded):
            pairs = _near_pairs(potential, system, known)
        elif isinstance(potential, Bond):
            pairs = _bonds(potential, system, known)
        else:
            continue
        for pair in pairs:
            inverse_mass = float(inverse_masses[list(pair[:2])].sum())
            examined.append(_contact(potential, pair, inverse_mass))

    return examined


def bonded_scales(potential: Nonbonded, system: System) -> dict[frozenset[int], float]:
    """The factor on the law for each pair of atoms up to three bonds apart, and for its exclusions."""
    pairs_of = (
        *pairs_by_bonds_apart(system.bonds),
        checked_pairs("exclusions", potential.exclusions),
    )
    with_factors = zip(pairs_of, (*potential.bonded_scale, 0.0), strict=True)
    return {frozenset(pair): factor for pairs, factor in with_factors for pair in pairs.tolist()}


def _near_pairs(potential: Nonbonded, system: System, atoms: list[int]) -> Iterator[Pair]:
    """Pairs of some atoms with their nearest neighbors within the cutoff, each once."""
    table = potential.table(system.species_names)
    index = system.species_index
    seen = set()
    scales = bonded_scales(potential, system)

    for atom in atoms:
        others = np.delete(np.arange(len(system)), atom)
        pairs = np.column_stack([np.full_like(others, atom), others])
        distances = np.linalg.norm(nearest_vectors(system.positions, system.cell, pairs), axis=1)

        for k in np.argsort(distances)[:NEAREST]:
            other = int(others[k])
            r = float(distances[k])
            pair = frozenset((atom, other))
            scale = scales.get(pair, 1.0)
            row = table[index[atom], index[other]] if len(table) > 1 else table[0, 0]
            cutoff2, *numbers = row.tolist()
            if pair not in seen and r * r < cutoff2 and scale != 0.0:
                seen.add(pair)
                yield atom, other, r, scale, (*potential.alone, *numbers)


def _bonds(potential: Bond, system: System, atoms: list[int]) -> Iterator[Pair]:
    """The bonds of some atoms."""
    pairs = potential.groups_in(system)
    rows = np.flatnonzero(np.isin(pairs, atoms).any(axis=1))
    distances = np.linalg.norm(nearest_vectors(system.positions, system.cell, pairs[rows]), axis=1)
    numbers = [column[rows].tolist() for column in potential.columns("bonds", len(pairs))]
    for (i, j), r, *own in zip(pairs[rows].tolist(), distances.tolist(), *numbers, strict=True):
        yield i, j, r, 1.0, tuple(own)


def _contact(potential: Nonbonded | Bond, pair: Pair, inverse_mass: float) -> Contact:
    first, second, r, scale, numbers = pair
    u, f = law_at(potential.law, r, numbers)
    high, low = (
        -(1.0 + h) * law_at(potential.law, r * (1.0 + h), numbers)[1] for h in (STEP, -STEP)
    )
    # u″ by a central difference of u′ = −f r
    curvature = (high - low) / (2.0 * STEP) if r > 0.0 else nan
    length, rest = None, nan  # σ or r₀, and u″ at the minimum
    if isinstance(potential, Nonbonded) and isinstance(potential.plain_law, LennardJonesLaw):
        epsilon, length = numbers[-2:]
        rest = curvature_at_minimum(epsilon, length)
    elif isinstance(potential.law, HarmonicLaw):
        rest, length = numbers

    is_bond = isinstance(potential, Bond)
    is_users = is_user_law(potential.law) or reads_table(potential.law)
    frequency, at_rest = (
        sqrt(k * inverse_mass) if 0.0 < k < inf else None for k in (scale * curvature, scale * rest)
    )
    deeper, pull = law_at(potential.law, 0.5 * r, numbers)
    sinks = scale > 0.0 and f < 0.0 and pull < 0.0 and deeper < u and not is_bond
    ratio = r / length if length else None
    longest = numbers[1] if isinstance(potential.law, FENELaw) else None
    return Contact(
        first,
        second,
        law=type(potential).__name__,
        is_bond=is_bond,
        is_users=is_users,
        distance=r,
        ratio=ratio,
        energy=scale * u,
        force=scale * f * r,
        frequency=frequency,
        rest_frequency=at_rest,
        sinks=bool(sinks),
        longest=longest,
    )
