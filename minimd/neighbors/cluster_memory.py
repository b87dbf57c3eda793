"""The memory on which the loop over clusters works: positions of ghosts, forces on them, copies to and from them."""

from collections import namedtuple

import numpy as np
from numba import types

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import by_type, scalar
from minimd.compiled.simd import broadcast, convert, lane, load, store, with_lane
from minimd.compiled.simd.lanes import count
from minimd.neighbors.clusters import DIMENSIONS, loaded, offsets_of
from minimd.neighbors.domains import IMAGES, SIDES

GRID = 2.0**31  # steps of the coordinates in mixed precision, from one end of the scene to the other


class Memory(ByAddress, namedtuple("Memory", "coordinates shift origin unit forces first_sum far net layers")):
    """What the loop reads and writes; coordinates have the precision of the pair arithmetic, see cluster_loop.

    coordinates, forces : flat, a block for each ghost, and for each ghost in a window.
    shift : (IMAGES, 3), as the coordinates, which are (x − origin) / unit.  origin : (3,), unit : (1,) [length].
    first_sum : (W,) int64, what sums of forces begin with in fixed-point arithmetic, filled by the loop; else empty.
    far : flat, n numbers for each set of lanes, the bits of its number: 0 for those in it, ∞ for others [length²].
    net : (K, 3); in mixed precision the sum of the forces on the atoms of each domain [energy/length]; in fixed-point
        arithmetic not zero where a force of the domain (first column) has left its range.
    layers : (K,) int, how many layers of the rows the atoms of each domain need.
    """


class ClusterArrays(ByAddress, namedtuple("ClusterArrays", "clusters domain_start domains ghosts rows memory")):
    """What the loop over clusters gets from the list.  domain_start : (K + 1,) int, first cluster of each domain."""


@scalar
def lay_grid(n, boxes, shifts, columns_reach, skin, memory):
    """The grid of mixed precision: memory.origin, .unit and .shift.  boxes, shifts : of n ghosts, of images.
    columns_reach : the unit of boxes [length]."""
    unit, stride = 0.0, boxes.size // SIDES
    for c in range(DIMENSIONS):
        low, high = np.inf, -np.inf
        for m in range(n):
            low, high = min(low, boxes[c * stride + m]), max(high, boxes[(c + 3) * stride + m])
        memory.origin[c] = 0.5 * (low + high) * columns_reach
        unit = max(unit, ((high - low) * columns_reach + 2.0 * skin) / GRID)
    memory.unit[0] = unit
    for image in range(IMAGES):
        for c in range(DIMENSIONS):
            memory.shift[image, c] = np.int32(np.rint(shifts[image, c] / unit))


@scalar
def place(k, arrays, at):
    """Positions of the atoms of cluster k, vectors x, y, z [length], to all its ghosts.

    Indices are unsigned: none counts from the end.
    """
    ghosts, memory, lanes = arrays.ghosts, arrays.memory, arrays.clusters.lanes
    n_lanes = np.uintp(count(lanes))
    like, block = load(memory.coordinates, 0, lanes), np.uintp(DIMENSIONS) * n_lanes
    x, y, z = offsets_of(np.uintp(k) * block, arrays.clusters)
    x = coordinate(at[0] + x, memory.origin[0], memory.unit[0], like)
    y = coordinate(at[1] + y, memory.origin[1], memory.unit[0], like)
    z = coordinate(at[2] + z, memory.origin[2], memory.unit[0], like)
    for p in range(np.uintp(ghosts.start[k]), np.uintp(ghosts.start[k + 1])):
        m = np.uintp(ghosts.of[p])
        image = np.uintp(ghosts.image[m])
        store(memory.coordinates, m * block, x + memory.shift[image, 0])
        store(memory.coordinates, m * block + n_lanes, y + memory.shift[image, 1])
        store(memory.coordinates, m * block + n_lanes + n_lanes, z + memory.shift[image, 2])


@by_type
def coordinate(x, origin, unit, like):
    """A vector of coordinates x [length] as an array of coordinates holds it, see Memory; like : a vector of those."""
    if like.is_float:
        return lambda x, origin, unit, like: x
    lanes = x.lanes

    def on_grid(x, origin, unit, like):
        for k in range(lanes):
            like = with_lane(like, k, np.int32(np.rint((lane(x, k) - origin) / unit)))
        return like

    return on_grid


@scalar
def clear(domain, arrays):
    """Forces on all ghosts in the window of a domain = 0, or first_sum.

    Who adds to them does so, and has them in its cache then.
    """
    lanes, forces, domains = arrays.clusters.lanes, arrays.memory.forces, arrays.domains
    first = domains.place[domain]
    for block in range(first, first + domains.window[domain + 1] - domains.window[domain]):
        nothing = broadcast(_first_sum(block, arrays.memory.first_sum, forces), load(forces, 0, lanes))
        for c in range(DIMENSIONS):
            store(forces, (block * DIMENSIONS + c) * count(lanes), nothing)


@by_type
def _first_sum(block, first_sum, forces):
    """What the sum of the forces in a block begins with."""
    if isinstance(forces.dtype, types.Float):
        return lambda block, first_sum, forces: 0.0
    return lambda block, first_sum, forces: first_sum[block]


@scalar
def collected(k, arrays):
    """The forces on the atoms of cluster k, sums over its ghosts in all windows: vectors x, y, z, float64 or int64."""
    ghosts, forces, lanes = arrays.ghosts, arrays.memory.forces, arrays.clusters.lanes
    block, first = np.uintp(DIMENSIONS * count(lanes)), np.uintp(ghosts.part_start[k])
    x, y, z = loaded(forces, np.uintp(ghosts.parts[first]) * block, lanes)
    x, y, z = in_full(x), in_full(y), in_full(z)
    for p in range(first + np.uintp(1), np.uintp(ghosts.part_start[k + 1])):
        more_x, more_y, more_z = loaded(forces, np.uintp(ghosts.parts[p]) * block, lanes)
        x, y, z = x + in_full(more_x), y + in_full(more_y), z + in_full(more_z)
    return x, y, z


@by_type
def in_full(force):
    """A vector of forces in double precision; whole numbers as they are."""
    return (lambda force: convert(force, 0.0)) if force.is_float else lambda force: force


@by_type
def is_mixed(arrays):
    """Whether the pair arithmetic is float32, as a constant for the compiler."""
    memory = arrays[-1]
    answer = memory.types[memory.fields.index("far")].dtype == types.float32
    return lambda arrays: answer
