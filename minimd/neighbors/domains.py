"""The cell cut into chunks, each with a copy of everything its atoms can see: shares of work that never meet in memory.

A chunk is a range of columns along the first lattice vector. Its rows look ahead only, so around its own columns (o) it
needs those ahead (h), through periodic boundaries where they are crossed; whoever is behind (.) looks at the chunk instead:

    . . h h h h h h h        second lattice vector  ↑
    . . o o o o o h h
    . . o o o o o h h        first lattice vector   →
    . . h h h h h h h

Each of these columns is a run of copies of clusters, sorted along the third lattice vector, with images below and above:

    | image −1: the highest of the column | the column itself | image +1: the lowest of the column |

A copy is a cluster moved by a lattice vector, with forces of its own. Positions are handed out to all copies of a cluster,
and the forces on them summed again, in the order of the copies: the same bits, whoever did the work.
"""

from typing import Any, NamedTuple

import numpy as np

from minimd.compiled.kernels import kernel, scalar
from minimd.compiled.simd import load, store
from minimd.compiled.threads import MOST_SHARES
from minimd.forces.cluster_loop import BLOCK, LANES
from minimd.neighbors.clusters import Clusters, Columns

ALL_LANES = 255
IMAGES, HOME = 27, 13  # number of images, and the code of image (0, 0, 0)
ATOMS_IN_A_CHUNK = 800  # at least, on average: a share of work must be worth handing out


class Chunks(NamedTuple):
    """column : (K + 1,) int, first column of each chunk along the first lattice vector.  cluster : (K + 1,) int, its first cluster.

    run : (K + 1,) int, the first run of each chunk.  copy : (runs + 1,) int, the first copy of each run.
    """

    column: Any
    cluster: Any
    run: Any
    copy: Any


class Copies(NamedTuple):
    """What stands in memory for M copies of C clusters.

    owner, key : (M,) int, which cluster, and that with its image as one number.  shift : (M, 3) lattice vector of that image [length].
    bottom, top : (M,) fractional coordinates along the third lattice vector.  boxes : (M, 6) see Clusters.
    lanes : (M,) uint8, bit k is set if lane k is not padding.
    home : (C,) int, the copy in image HOME in the cluster's own chunk.
    is_used : (M,) bool, true for copies that stand in a row, and for those at home.
    of : (U,) int, all used copies cluster by cluster, those of cluster k from start[k].  start : (C + 1,) int.
    """

    owner: Any
    key: Any
    shift: Any
    bottom: Any
    top: Any
    boxes: Any
    lanes: Any
    home: Any
    is_used: Any
    of: Any
    start: Any


def cut_into_chunks(clusters: Clusters, columns: Columns, n_atoms: int, pbc: Any) -> Chunks:
    """As many chunks as give each enough atoms and make it at least as wide as it sees; the same for any number of threads."""
    across = int(columns.counts[0]) // max(1, int(columns.reach[0]))
    n_chunks = max(1, min(n_atoms // ATOMS_IN_A_CHUNK, across, MOST_SHARES))
    n_runs = int((columns.counts[0] + n_chunks * columns.reach[0]) * (columns.counts[1] + 2 * columns.reach[1]))
    column, cluster, run = (np.empty(n_chunks + 1, dtype=np.int64) for _ in range(3))
    chunks = Chunks(column, cluster, run, np.zeros(n_runs + 1, dtype=np.int64))
    _cut(clusters, columns, pbc, chunks)
    return chunks


@kernel
def _cut(clusters, columns, pbc, chunks):
    counts, reach, column_start = columns.counts, columns.reach, clusters.column_start
    n_chunks, n_clusters = chunks.column.size - 1, column_start[counts[0] * counts[1]]
    x = 0
    for c in range(n_chunks + 1):
        while x < counts[0] and column_start[x * counts[1]] * n_chunks < c * n_clusters:
            x += 1
        chunks.column[c] = counts[0] if c == n_chunks else x
        chunks.cluster[c] = column_start[chunks.column[c] * counts[1]]
    run = 0
    for c in range(n_chunks):
        chunks.run[c] = run
        for run_x in range(chunks.column[c], chunks.column[c + 1] + reach[0]):
            for run_y in range(-reach[1], counts[1] + reach[1]):
                n = 0
                if run_x > chunks.column[c] or run_y >= 0:  # nobody looks at what is behind the first
                    for image_z in range(-1, 2):
                        first, last, _ = _seen(run_x, run_y, image_z, clusters, columns, pbc)
                        n += last - first
                chunks.copy[run + 1] = chunks.copy[run] + n
                run += 1
    chunks.run[n_chunks] = run


@scalar
def _seen(run_x, run_y, image_z, clusters, columns, pbc):
    """Clusters first to last of a column, inside the cell or beyond its faces, whose image can be seen from it; the image's code."""
    counts = columns.counts
    image_x, image_y = run_x // counts[0], run_y // counts[1]
    image = (image_x + 1) * 9 + (image_y + 1) * 3 + image_z + 1
    if (image_x != 0 and not pbc[0]) or (image_y != 0 and not pbc[1]) or (image_z != 0 and not pbc[2]):
        return 0, 0, image
    column = (run_x - image_x * counts[0]) * counts[1] + run_y - image_y * counts[1]
    first, last = clusters.column_start[column], clusters.column_start[column + 1]
    if image_z > 0:
        end = first
        while end < last and clusters.bottom[end] <= columns.along:
            end += 1
        last = end
    if image_z < 0:
        begin = last
        while begin > first and clusters.top[begin - 1] >= 1.0 - columns.along:
            begin -= 1
        first = begin
    return first, last, image


@scalar
def image_key(cluster, image):
    """A cluster and the code of its image as one number."""
    return cluster * IMAGES + image


@scalar
def fill_copies(chunk, chunks, clusters, columns, pbc, lattice, copies, coordinates):
    """Make the copies of one chunk."""
    run = chunks.run[chunk]
    for run_x in range(chunks.column[chunk], chunks.column[chunk + 1] + columns.reach[0]):
        for run_y in range(-columns.reach[1], columns.counts[1] + columns.reach[1]):
            copy = chunks.copy[run]
            run += 1
            if copy == chunks.copy[run]:
                continue
            for image_z in range(-1, 2):
                first, last, image = _seen(run_x, run_y, image_z, clusters, columns, pbc)
                a, b = image // 9 - 1, image // 3 % 3 - 1
                x = a * lattice[0, 0] + b * lattice[1, 0] + image_z * lattice[2, 0]
                y = a * lattice[0, 1] + b * lattice[1, 1] + image_z * lattice[2, 1]
                z = a * lattice[0, 2] + b * lattice[1, 2] + image_z * lattice[2, 2]
                is_home = image == HOME and run_x < chunks.column[chunk + 1]
                for k in range(first, last):
                    copies.owner[copy], copies.key[copy], copies.is_used[copy] = k, image_key(k, image), is_home
                    copies.lanes[copy] = ALL_LANES >> (LANES - clusters.filled[k])
                    copies.bottom[copy], copies.top[copy] = clusters.bottom[k] + image_z, clusters.top[k] + image_z
                    for d, shift in enumerate((x, y, z)):
                        copies.shift[copy, d] = shift
                        copies.boxes[copy, d], copies.boxes[copy, d + 3] = clusters.boxes[k, d] + shift, clusters.boxes[k, d + 3] + shift
                        store(coordinates, copy * BLOCK + d * LANES, load(clusters.coordinates, k * BLOCK + d * LANES, LANES) + shift)
                    if is_home:
                        copies.home[k] = copy
                    copy += 1


@kernel
def sort_copies(copies):
    """Fill copies.of and copies.start: the used copies of each cluster, in the order of their numbers."""
    copies.start[:] = 0
    for m in range(copies.owner.size):
        copies.start[copies.owner[m] + 1] += copies.is_used[m]
    for k in range(copies.start.size - 1):
        copies.start[k + 1] += copies.start[k]
    place = copies.start[:-1].copy()
    for m in range(copies.owner.size):
        if copies.is_used[m]:
            copies.of[place[copies.owner[m]]] = m
            place[copies.owner[m]] += 1
