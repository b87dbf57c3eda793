"""The memory on which the loop over clusters works: positions of ghosts, forces on them, copies to and from them."""

from collections import namedtuple

import numpy as np
from numba import types

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import by_type, scalar
from minimd.core.compiled.simd import broadcast, load, store
from minimd.core.compiled.simd.vector import count, loaded, stored
from minimd.core.neighbors.clusters import DIMENSIONS, offsets_of
from minimd.core.structure.vectors import plus


class ClusterMemory(
    ByAddress, namedtuple("ClusterMemory", "coordinates shifts forces first_sum far is_out layers")
):
    """What the loop reads and writes.
    coordinates, forces : flat, a block for each ghost, and for each ghost in a window.
    shifts : (IMAGES, 3), translations of images [length].
    first_sum : (W,) int64, what sums of forces begin with in fixed-point arithmetic, filled by the loop; else empty.
    far : flat, n numbers for each set of lanes, the bits of its number: 0 for those in it, ∞ for others [length²].
    is_out : (K,) int, not zero where a force of a domain has left its range; empty but in fixed-point arithmetic.
    layers : (K,) int, how many layers of the rows the atoms of each domain need."""


class ClusterArrays(
    ByAddress,
    namedtuple("ClusterArrays", "clusters domain_start domains ghosts rows memory columns"),
):
    """A cluster list: what its build fills, and what the loop over clusters gets from it.
    domain_start : (K + 1,) int, first cluster of each domain."""


@scalar
def place(k, arrays, at):
    """Positions of the atoms of cluster k to all its ghosts.
    Indices are unsigned: none counts from the end.

    arrays : ClusterArrays.
    at : vectors x, y, z [length]."""
    ghosts = arrays.ghosts
    memory = arrays.memory
    shifts = memory.shifts
    n_lanes = np.uintp(count(arrays.clusters.lanes))
    block = np.uintp(DIMENSIONS) * n_lanes
    x, y, z = plus(at, offsets_of(np.uintp(k) * block, arrays.clusters))
    for p in range(np.uintp(ghosts.start[k]), np.uintp(ghosts.start[k + 1])):
        m = np.uintp(ghosts.of[p])
        image = np.uintp(ghosts.image[m])
        shifted = (x + shifts[image, 0], y + shifts[image, 1], z + shifts[image, 2])
        stored(memory.coordinates, m * block, shifted)


@scalar
def clear(domain, arrays):
    """Set the forces on all ghosts in the window of a domain to 0; in fixed-point arithmetic to first_sum.
    The thread that adds to them calls it, and so has them in its cache."""
    forces = arrays.memory.forces
    domains = arrays.domains
    like = load(forces, 0, arrays.clusters.lanes)
    first = domains.place[domain]
    for block in range(first, first + domains.window[domain + 1] - domains.window[domain]):
        nothing = broadcast(_first_sum(block, arrays.memory.first_sum, forces), like)
        for c in range(DIMENSIONS):
            store(forces, (block * DIMENSIONS + c) * count(like), nothing)


@by_type
def _first_sum(block, first_sum, forces):
    """What the sum of the forces in a block begins with."""
    if isinstance(forces.dtype, types.Float):
        return lambda block, first_sum, forces: 0.0
    return lambda block, first_sum, forces: first_sum[block]


@scalar
def collected(k, arrays):
    """The forces on the atoms of cluster k, sums over its ghosts in all windows: vectors x, y, z, float64 or int64."""
    ghosts = arrays.ghosts
    forces = arrays.memory.forces
    lanes = arrays.clusters.lanes
    block = np.uintp(DIMENSIONS * count(lanes))
    first = np.uintp(ghosts.part_start[k])
    total = loaded(forces, np.uintp(ghosts.parts[first]) * block, lanes)
    for p in range(first + np.uintp(1), np.uintp(ghosts.part_start[k + 1])):
        total = plus(total, loaded(forces, np.uintp(ghosts.parts[p]) * block, lanes))
    return total
