"""The plain loop over pairs: the one place where a law of one pair at a time becomes forces, energies and virial."""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import force_along, in_steps, is_too_large, no_force
from minimd.core.compiled.kernels import by_type, called_kernel, scalar
from minimd.core.compiled.program import GO_ON, OUT_OF_RANGE
from minimd.core.compiled.simd import fma
from minimd.core.potentials.law import evaluate_law
from minimd.core.potentials.term import FORCES, PER_ATOM, PairLaw
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.system import System


class SameForAll(namedtuple("SameForAll", "numbers")):
    """One tuple of numbers for every pair."""


class BySpecies(namedtuple("BySpecies", "columns species")):
    """columns : tuple of (S, S) arrays, one for each parameter.
    species : (N,) int."""


class Charges(namedtuple("Charges", "of_atoms source")):
    """The product of charges, and what another source has.
    of_atoms : (N,) [√(energy · length)]."""


class Slopes(namedtuple("Slopes", "of_atoms source")):
    """The slopes F′ of both atoms, and what another source has.
    of_atoms : (N,) [energy/density]."""


@by_type
def parameters_of_pair(source, i, j):
    """The parameters of a pair of atoms: a tuple of numbers, the squared cutoff first."""
    kind = source.instance_class
    if kind is SameForAll:
        return lambda source, i, j: source.numbers
    if kind is Charges:
        return lambda source, i, j: with_product(
            parameters_of_pair(source.source, i, j), source.of_atoms[i] * source.of_atoms[j]
        )
    if kind is Slopes:
        return lambda source, i, j: with_slopes(
            parameters_of_pair(source.source, i, j), source.of_atoms[i], source.of_atoms[j]
        )
    return lambda source, i, j: row_of(source.columns, (source.species[i], source.species[j]))


@scalar
def with_product(numbers, product):
    """The squared cutoff, a product of charges, all other numbers."""
    return (numbers[0], product) + numbers[1:]


@scalar
def with_slopes(numbers, first, second):
    """The squared cutoff, the slopes of both atoms, all other numbers."""
    return (numbers[0], first, second) + numbers[1:]


@by_type
def row_of(columns, index):
    """(columns[0][index], columns[1][index], …), unrolled by the compiler."""
    if len(columns) == 0:
        return lambda columns, index: ()
    return lambda columns, index: (columns[0][index],) + row_of(columns[1:], index)


def source_for(
    law: PairLaw, system: System, order: Indices, slopes: Array
) -> SameForAll | BySpecies | Charges | Slopes:
    """Where the loop finds the numbers of a law, for atoms in some order (N,).
    slopes : (N,) of the embedding in this order, if the law has one."""
    source: SameForAll | BySpecies = SameForAll(tuple(law.table[0, 0].tolist()))
    if len(law.table) > 1:
        source = BySpecies(from_table(law.table), system.species_index[order])
    if law.embedding is not None:
        return Slopes(slopes, source)
    return source if law.charges is None else Charges(law.charges[order], source)


def from_table(table: Array) -> tuple[Array, ...]:
    """The columns (last axis) of a parameter table as contiguous arrays."""
    return tuple(np.ascontiguousarray(table[..., k]) for k in range(table.shape[-1]))


class PairWork(
    ByAddress, namedtuple("PairWork", "positions pairs law parameters steps detail sums")
):
    """What the loop works on.

    positions : (N, 3) [length].
    pairs : Pairs.
    law : law type.
    parameters : see parameters_of_pair.
    steps : Steps, or ().
    detail : with FORCES only forces are changed. TOTALS adds each pair to energies and virials of its first atom, so
        that their sums are right; PER_ATOM adds half of it to both atoms.
    sums : forces (N, 3), int64 impulses in fixed-point arithmetic; energies (N,), virials (N, 6).
    """


@scalar
def separation(positions, pairs, at, p):
    """r_ij = (dx, dy, dz) and r² of pair p of a list, from the position of its first atom [length]."""
    j = np.uintp(pairs.second[p])
    dx, dy, dz = positions[j, 0] - at[0], positions[j, 1] - at[1], positions[j, 2] - at[2]
    if pairs.translations.shape[0] > 0:
        t = np.uintp(pairs.image[p])
        dx = dx + pairs.translations[t, 0]
        dy = dy + pairs.translations[t, 1]
        dz = dz + pairs.translations[t, 2]
    return dx, dy, dz, fma(dx, dx, fma(dy, dy, dz * dz))


@called_kernel
def add_pair_forces(work, _chunk):
    """Add the forces of a pair law on pairs within its cutoff.  OUT_OF_RANGE if one is beyond the range of a grid.

    r_ij = r_j − r_i + translation,   f = −u′(r)/r,   F_j += f r_ij,   F_i −= f r_ij,   W += f r_ij ⊗ r_ij
    """
    positions, pairs, law, parameters, steps, detail, (forces, energies, virials) = work
    own_share = 0.5 if detail == PER_ATOM else 1.0
    is_out = False
    for i in range(pairs.start.size - 1):
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        fx = fy = fz = no_force(steps)
        energy = xx = yy = zz = yz = xz = xy = size2 = 0.0
        # unsigned: no check for indices that count from the end
        for p in range(np.uintp(pairs.start[i]), np.uintp(pairs.start[i + 1])):
            j = np.uintp(pairs.second[p])
            dx, dy, dz, r2 = separation(positions, pairs, (x, y, z), p)
            numbers = parameters_of_pair(parameters, i, j)
            if r2 < numbers[0]:
                u, f = evaluate_law(law, r2, numbers[1:])
                gx = force_along(f, dx, steps)
                gy = force_along(f, dy, steps)
                gz = force_along(f, dz, steps)
                fx, fy, fz = fx - gx, fy - gy, fz - gz
                forces[j, 0] += gx
                forces[j, 1] += gy
                forces[j, 2] += gz
                size2 += f * f * r2
                if detail != FORCES:
                    hx, hy, hz = f * dx, f * dy, f * dz
                    u = in_steps(u, steps)
                    wxx = in_steps(hx * dx, steps)
                    wyy = in_steps(hy * dy, steps)
                    wzz = in_steps(hz * dz, steps)
                    wyz = in_steps(hy * dz, steps)
                    wxz = in_steps(hx * dz, steps)
                    wxy = in_steps(hx * dy, steps)
                    energy += u
                    xx = xx + wxx
                    yy = yy + wyy
                    zz = zz + wzz
                    yz = yz + wyz
                    xz = xz + wxz
                    xy = xy + wxy
                    if detail == PER_ATOM:
                        energies[j] += 0.5 * u
                        for c, w in enumerate((wxx, wyy, wzz, wyz, wxz, wxy)):
                            virials[j, c] += 0.5 * w

        for c, g in enumerate((fx, fy, fz)):
            forces[i, c] += g
        is_out |= is_too_large(size2, steps)
        if detail != FORCES:
            energies[i] += own_share * energy
            for c, w in enumerate((xx, yy, zz, yz, xz, xy)):
                virials[i, c] += own_share * w

    return OUT_OF_RANGE if is_out else GO_ON
