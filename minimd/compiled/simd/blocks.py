"""Vectors from and to memory: blocks, where all x of some atoms stand together, then all y, all z; rows of tables."""

import numpy as np

from minimd.compiled.kernels import by_type, scalar
from minimd.compiled.simd.lanes import count
from minimd.compiled.simd.vector import load, store, with_lane, zeros


@scalar
def loaded(blocks, start, lanes):
    """The vectors x, y, z of a block, from index start on."""
    n = np.uintp(count(lanes))
    return load(blocks, start, lanes), load(blocks, start + n, lanes), load(blocks, start + n + n, lanes)


@scalar
def stored(blocks, start, xyz):
    """Write the vectors x, y, z of a block."""
    (x, y, z), n = xyz, np.uintp(count(xyz[0]))
    store(blocks, start, x)
    store(blocks, start + n, y)
    store(blocks, start + n + n, z)


@scalar
def gathered(table, numbers, start, lanes):
    """The vectors x, y, z of the rows numbers[start], numbers[start + 1], … of a table (N, 3)."""
    x = y = z = zeros(lanes)
    for k in range(count(lanes)):
        i = np.uintp(numbers[start + k])
        x, y, z = with_lane(x, k, table[i, 0]), with_lane(y, k, table[i, 1]), with_lane(z, k, table[i, 2])
    return x, y, z


@by_type
def loaded_columns(columns, start, lanes):
    """A vector of each of a tuple of columns, from index start on; unrolled by the compiler."""
    if len(columns) == 0:
        return lambda columns, start, lanes: ()
    return lambda columns, start, lanes: (load(columns[0], start, lanes),) + loaded_columns(columns[1:], start, lanes)
