"""The vector loop over clusters: the same pair laws as pair_loop, applied to eight pairs at a time.

Atoms near each other form clusters of eight; see neighbors.clusters for the picture. A row belongs to one atom i and lists the
clusters j with atoms within its reach. For each of these clusters a mask marks the lanes that count.
"""

import functools
from collections import namedtuple

import numpy as np
from numba import types
from numba.core.errors import NumbaError

from minimd.compiled.kernels import by_type, kernel, scalar, without_cache
from minimd.compiled.simd import broadcast, convert, fma, load, mask_from_bits, select, store, total
from minimd.neighbors.cluster_search import GHOST_BITS, LANES_FROM
from minimd.neighbors.clusters import BLOCK, LANES
from minimd.potentials.law import evaluate_law
from minimd.potentials.pair_loop import SameForAll
from minimd.potentials.term import PER_ATOM
from minimd.potentials.user_laws import is_recognized, is_user_law

LANE_SUMS = 7  # accumulators of a lane with PER_ATOM: energy, and six of the virial


class ByLane(namedtuple("ByLane", "columns species slots")):
    """Parameters by species, laid out for lanes.

    columns : tuple of (S · slots,) arrays; element a · slots + s is the parameter of the atom in slot s with species a.
    species : (slots,) int.  slots : number of slots, ghosts included.
    """


@by_type
def parameters_of_lanes(source, slot, cluster):
    """Parameters of the pairs of the atom in a slot with the lanes of a cluster: numbers, or vectors if species differ."""
    if source.instance_class is SameForAll:
        return lambda source, slot, cluster: source.numbers
    return lambda source, slot, cluster: _loaded(source.columns, source.species[slot] * source.slots + cluster * LANES)


@by_type
def _loaded(columns, start):
    """LANES elements of each column, starting at an index; unrolled by the compiler."""
    if len(columns) == 1:
        return lambda columns, start: (load(columns[0], start, LANES),)
    return lambda columns, start: (load(columns[0], start, LANES),) + _loaded(columns[1:], start)


class Sums(namedtuple("Sums", "forces energies virials lane_sums detail")):
    """The accumulators of the loop.

    forces : flat, BLOCK numbers for each ghost, of the type of the pair arithmetic [energy/length].
    energies : (slots,) and virials : (slots, 6), xx yy zz yz xz xy, of the atoms of the rows with PER_ATOM, else (C,) and (C, 6) of their clusters.
    lane_sums : flat, LANE_SUMS · LANES numbers for each ghost: energies and virials of the lanes; empty unless PER_ATOM.
    detail : TOTALS or PER_ATOM, see term.
    """


class ForceSums(Sums):
    """Accumulators of forces only: a type of its own, for which the compiler leaves out energies and virials."""

    __slots__ = ()


@by_type
def with_energy(sums):
    """Whether energies and virials are wanted, as a constant for the compiler."""
    answer = sums.instance_class is not ForceSums
    return lambda sums: answer


@scalar
def add_cluster_forces(domain, arrays, law, parameters, sums):
    """Forces between the atoms of a domain and the clusters of their rows.

        r_ij = r_j − r_i,   f = −u′(r)/r,   F_j += f r_ij,   F_i −= Σ f r_ij,   W += f r_ij ⊗ r_ij

    arrays : ClusterArrays.  law : law type.  parameters : SameForAll or ByLane.
    sums : with TOTALS each pair is added to the cluster of its atom i, with PER_ATOM half of it to each atom.
    """
    rows, homes, coordinates, unit = arrays.rows, arrays.ghosts.home, arrays.memory.coordinates, arrays.memory.unit
    nothing, like = broadcast(0.0, load(sums.forces, 0, LANES)), load(coordinates, 0, LANES)
    zero = convert(nothing, 0.0)
    own_share = 0.5 if sums.detail == PER_ATOM else 1.0
    for slot in range(arrays.domain_start[domain] * LANES, arrays.domain_start[domain + 1] * LANES):
        home, lane = homes[slot // LANES], slot % LANES
        place = home * BLOCK + lane
        at = (broadcast(coordinates[place], like), broadcast(coordinates[place + LANES], like), broadcast(coordinates[place + 2 * LANES], like))
        after = rows.entries[rows.start[slot]]
        ahead = separations(coordinates, after & GHOST_BITS, at, unit)
        fx = fy = fz = nothing
        energy = xx = yy = zz = yz = xz = xy = zero
        for entry in range(rows.start[slot], rows.stop[slot]):
            ghost, lanes, (dx, dy, dz, r2) = after & GHOST_BITS, after >> LANES_FROM, ahead
            after = rows.entries[entry + 1]  # one entry ahead, so that the processor has work while it waits for the law
            ahead = separations(coordinates, after & GHOST_BITS, at, unit)
            numbers = parameters_of_lanes(parameters, home * LANES + lane, ghost)
            near = (r2 < numbers[0]) & mask_from_bits(lanes, nothing)
            u, f = evaluate_law(law, r2, numbers[1:])
            f = select(near, f, 0.0)
            gx, gy, gz = f * dx, f * dy, f * dz
            fx, fy, fz = fx - gx, fy - gy, fz - gz
            j = ghost * BLOCK
            add(sums.forces, j, gx)
            add(sums.forces, j + LANES, gy)
            add(sums.forces, j + 2 * LANES, gz)
            if with_energy(sums):
                u = convert(select(near, u, 0.0), 0.0)
                dx, dy, dz = convert(dx, 0.0), convert(dy, 0.0), convert(dz, 0.0)
                gx, gy, gz = convert(gx, 0.0), convert(gy, 0.0), convert(gz, 0.0)
                energy = energy + u
                xx, yy, zz = fma(gx, dx, xx), fma(gy, dy, yy), fma(gz, dz, zz)
                yz, xz, xy = fma(gy, dz, yz), fma(gx, dz, xz), fma(gx, dy, xy)
                if sums.detail == PER_ATOM:
                    for c, w in enumerate((u, gx * dx, gy * dy, gz * dz, gy * dz, gx * dz, gx * dy)):
                        add(sums.lane_sums, (ghost * LANE_SUMS + c) * LANES, 0.5 * w)
        sums.forces[place] += total(fx)
        sums.forces[place + LANES] += total(fy)
        sums.forces[place + 2 * LANES] += total(fz)
        if with_energy(sums):
            k = slot if sums.detail == PER_ATOM else slot // LANES
            sums.energies[k] += own_share * total(energy)
            for c, w in enumerate((xx, yy, zz, yz, xz, xy)):
                sums.virials[k, c] += own_share * total(w)


@scalar
def separations(coordinates, ghost, at, unit):
    """r_j − r_i = (dx, dy, dz) and r² of the lanes of a ghost, from a position x, y, z [length]."""
    place = ghost * BLOCK
    dx = separation(coordinates, place, at[0], unit)
    dy = separation(coordinates, place + LANES, at[1], unit)
    dz = separation(coordinates, place + 2 * LANES, at[2], unit)
    return dx, dy, dz, fma(dx, dx, fma(dy, dy, dz * dz))


@by_type
def separation(coordinates, place, x, unit):
    """coordinates[place : place + LANES] − x [length].

    In double precision coordinates are float64 [length]. In mixed precision they are int32 in units of a length; their
    difference has no rounding error, however far the atoms are from the origin, and becomes float32.
    """
    if isinstance(coordinates.dtype, types.Float):
        return lambda coordinates, place, x, unit: load(coordinates, place, LANES) - x
    return lambda coordinates, place, x, unit: convert(load(coordinates, place, LANES) - x, np.float32(0.0)) * unit


@scalar
def add(sums, place, vector):
    """sums[place : place + LANES] += vector."""
    store(sums, place, load(sums, place, LANES) + vector)


@kernel
def sum_over_lanes(law, distances2, parameters):
    """Σ (u + f) of a law at LANES squared distances [length²]: compiles only if the law runs on vectors."""
    u, f = evaluate_law(law, load(distances2, 0, LANES), parameters)
    return total(u) + total(f)


@functools.cache
def runs_on_vectors(law: tuple, n_parameters: int) -> bool:
    """Whether a law compiles for vectors. Those of minimd do; a law of the user's that branches on its arguments does not."""
    if not is_user_law(law):
        return True
    attempt = sum_over_lanes if is_recognized(law) else without_cache(sum_over_lanes)
    try:
        attempt(law, np.ones(LANES), (1.0,) * n_parameters)
    except NumbaError:
        return False
    return True
