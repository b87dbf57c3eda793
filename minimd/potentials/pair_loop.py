"""The plain loop over pairs: the one place where a pair law becomes forces, energies and virial;
bonds run through it too."""

from collections import namedtuple
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from minimd.compiled.kernels import by_type, kernel, without_cache
from minimd.compiled.simd import fma
from minimd.neighbors.pair_list import fixed_pairs
from minimd.potentials.accumulators import force_along, in_steps, no_force, watch
from minimd.potentials.law import evaluate_law
from minimd.potentials.term import BOND_LOOP, FORCES, PER_ATOM, OwnTerm
from minimd.potentials.user_laws import is_recognized
from minimd.structure.cell import minimum_image_translations
from minimd.structure.system import System


class SameForAll(namedtuple("SameForAll", "numbers")):
    """One tuple of numbers for every pair."""


class BySpecies(namedtuple("BySpecies", "columns species")):
    """columns : tuple of (S, S) arrays, one for each parameter.  species : (N,) int."""


class ByPair(namedtuple("ByPair", "columns")):
    """columns : tuple of (P,) arrays, one for each parameter."""


def parameters_of_pair(source, p, i, j):
    """The parameters of pair p between atoms i and j: a tuple of numbers, the squared cutoff first."""
    if isinstance(source, SameForAll):
        return source.numbers
    if isinstance(source, BySpecies):
        return tuple(column[source.species[i], source.species[j]] for column in source.columns)
    return tuple(column[p] for column in source.columns)


@overload(parameters_of_pair)
def _parameters_of_pair(source, p, i, j):
    kind = source.instance_class
    if kind is SameForAll:
        return lambda source, p, i, j: source.numbers
    if kind is BySpecies:
        return lambda source, p, i, j: _row(source.columns, (source.species[i], source.species[j]))
    return lambda source, p, i, j: _row(source.columns, p)


@by_type
def _row(columns, index):
    """(columns[0][index], columns[1][index], …), unrolled by the compiler."""
    if len(columns) == 1:
        return lambda columns, index: (columns[0][index],)
    return lambda columns, index: (columns[0][index],) + _row(columns[1:], index)


def by_species(table: NDArray[np.float64], species: NDArray[np.int64]) -> SameForAll | BySpecies:
    """Where the loop finds the numbers of a table (S, S, 1 + P), for atoms of these species (N,)."""
    if len(table) == 1:
        return SameForAll(tuple(table[0, 0].tolist()))
    return BySpecies(from_table(table), species)


def from_table(table: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """The columns (last axis) of a parameter table as contiguous arrays."""
    return tuple(np.ascontiguousarray(table[..., k]) for k in range(table.shape[-1]))


@kernel
def add_pair_forces(positions, pairs, law, parameters, detail, sums):
    """Add the forces of a pair law on pairs within its cutoff.

        r_ij = r_j − r_i + translation,   f = −u′(r)/r,   F_j += f r_ij,   F_i −= f r_ij,   W += f r_ij ⊗ r_ij

    positions : (N, 3) [length].  pairs : Pairs.  law : law type.  parameters : see parameters_of_pair.
    detail : with FORCES only forces are changed. TOTALS adds each pair to energies and virials of its first atom, so
        that their sums are right; PER_ATOM adds half of it to both atoms.
    sums : the accumulators forces, energies and virials, see Term.add; or GridSums.
    """
    forces, energies, virials = sums[0], sums[1], sums[2]
    shifted = pairs.translations.shape[0] > 0
    own_share = 0.5 if detail == PER_ATOM else 1.0
    for i in range(pairs.start.size - 1):
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        fx = fy = fz = no_force(sums)
        energy = xx = yy = zz = yz = xz = xy = size2 = 0.0
        for p in range(
            np.uintp(pairs.start[i]), np.uintp(pairs.start[i + 1])
        ):  # unsigned: no check for indices that count from the end
            j = np.uintp(pairs.second[p])
            dx, dy, dz = positions[j, 0] - x, positions[j, 1] - y, positions[j, 2] - z
            if shifted:
                t = np.uintp(pairs.image[p])
                dx, dy, dz = dx + pairs.translations[t, 0], dy + pairs.translations[t, 1], dz + pairs.translations[t, 2]
            r2 = fma(dx, dx, fma(dy, dy, dz * dz))
            numbers = parameters_of_pair(parameters, p, i, j)
            if r2 < numbers[0]:
                u, f = evaluate_law(law, r2, numbers[1:])
                gx, gy, gz = force_along(f, dx, sums), force_along(f, dy, sums), force_along(f, dz, sums)
                fx, fy, fz = fx - gx, fy - gy, fz - gz
                forces[j, 0] += gx
                forces[j, 1] += gy
                forces[j, 2] += gz
                size2 += f * f * r2
                if detail != FORCES:
                    hx, hy, hz = f * dx, f * dy, f * dz
                    u, wxx, wyy, wzz = (
                        in_steps(u, sums),
                        in_steps(hx * dx, sums),
                        in_steps(hy * dy, sums),
                        in_steps(hz * dz, sums),
                    )
                    wyz, wxz, wxy = in_steps(hy * dz, sums), in_steps(hx * dz, sums), in_steps(hx * dy, sums)
                    energy += u
                    xx, yy, zz, yz, xz, xy = xx + wxx, yy + wyy, zz + wzz, yz + wyz, xz + wxz, xy + wxy
                    if detail == PER_ATOM:
                        energies[j] += 0.5 * u
                        for c, w in enumerate((wxx, wyy, wzz, wyz, wxz, wxy)):
                            virials[j, c] += 0.5 * w
        for c, g in enumerate((fx, fy, fz)):
            forces[i, c] += g
        watch(size2, sums)
        if detail != FORCES:
            energies[i] += own_share * energy
            for c, w in enumerate((xx, yy, zz, yz, xz, xy)):
                virials[i, c] += own_share * w


def pair_loop_for(law: tuple):
    """add_pair_forces; not cached on disk for laws of the user's that the cache cannot recognize."""
    return add_pair_forces if is_recognized(law) else without_cache(add_pair_forces)


class FixedPairs(OwnTerm):
    """A law on pairs that never change, each taken at its nearest image.

    pairs : (P, 2) int.  law : law type.  table : (P, 1 + n) numbers of each pair, the squared cutoff first.
    """

    ingredient = BOND_LOOP

    def __init__(self, system: System, pairs: NDArray[np.int64], law: tuple, table: NDArray[np.float64]) -> None:
        self._pairs, order = fixed_pairs(pairs, len(system), system.cell.is_periodic)
        self._first, self._second = pairs[order, 0], pairs[order, 1]
        self._law, self._loop = law, pair_loop_for(law)
        self._parameters = ByPair(from_table(table[order]))

    def follow(self, system: System) -> bool:
        """See Term; images are looked for again."""
        self._pairs.translations[:] = 0.0
        return True

    def add_to(self, system: System, detail: int, sums: Any) -> None:
        """See Term."""
        cell = system.cell
        if cell.is_periodic:
            lattice = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
            minimum_image_translations(system.positions, self._first, self._second, *lattice, self._pairs.translations)
        self._loop(system.positions, self._pairs, self._law, self._parameters, detail, sums)
