"""The cell cut into domains, each with ghosts of all clusters that its atoms can see: so no two domains write to the same memory.

A domain is a range of columns along the first lattice vector. Its rows look ahead only. So around its own columns (o) it
needs those ahead (h), through periodic boundaries where these are crossed; atoms in the columns behind (.) look at the domain instead:

    . . h h h h h h h        second lattice vector  ↑
    . . o o o o o h h
    . . o o o o o h h        first lattice vector   →
    . . h h h h h h h

Each of these columns is a run of ghosts, sorted along the third lattice vector, with images below and above:

    | image −1: the highest of the column | the column itself | image +1: the lowest of the column |

A ghost is a cluster moved by a lattice vector, with forces of its own; the one in the cluster's own domain, moved by zero, is its home. Positions
are copied to all ghosts of a cluster, and the forces on them are summed in the order of the ghosts: the same bits, whichever thread did the work.
"""

import functools
from collections import namedtuple

import numpy as np

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import scalar
from minimd.compiled.simd import load, store
from minimd.compiled.simd.lanes import count
from minimd.compiled.threads import MOST_CHUNKS
from minimd.neighbors.buffers import Buffers
from minimd.neighbors.clusters import DIMENSIONS, Columns

SIDES = 6  # of a box: smallest x, y, z, and largest
BOXES = 8  # compared at a time
OUTWARD = 2e-7  # of a coordinate: boxes in float32 are larger by its rounding
IMAGES, HOME = 27, 13  # number of images, and the code of image (0, 0, 0)
ATOMS_PER_DOMAIN = 800  # at least, on average: with fewer, handing out the work costs more than a second thread gains


class Domains(ByAddress, namedtuple("Domains", "column cluster first run ghost")):
    """column : (K + 1,) int, first column of each domain along the first lattice vector.  cluster, first : (K + 1,) int, its first cluster and ghost.

    run : (K + 1,) int, the first run of each domain.  ghost : (runs + 1,) int, the first ghost of each run; the last number is M.
    """


class GhostClusters(ByAddress, namedtuple("GhostClusters", "owner key shift bottom top boxes lanes home is_used of start")):
    """M ghosts of C clusters. Arrays have room for more.

    owner : (M,) int, the cluster.  key : (M,) int, 27 · cluster + code of the image (a, b, c), which is 9 (a + 1) + 3 (b + 1) + c + 1.
    shift : (M, 3) lattice vector of that image [length].
    bottom, top : (M,) fractional coordinates along the third lattice vector.
    boxes : flat float32, for each of the SIDES a row of at least M + BOXES numbers, in units of Columns.distance: any length has room.
    lanes : (M,) uint8, bit k is set if lane k is not padding.
    home : (C,) int, the home of each cluster.
    is_used : (M,) bool, true for ghosts that stand in a row, and for homes.
    of : (U,) int, all used ghosts cluster by cluster, those of cluster k from start[k].  start : (C + 1,) int.
    """


class Layout(ByAddress, namedtuple("Layout", "columns clusters domains ghosts coordinates")):
    """The clusters of a scene and where their ghosts stand.  coordinates : flat, a block for each ghost [length]."""


def make_domains(columns: Columns, n_atoms: int) -> Domains:
    """As many domains as have enough atoms each and are at least as wide as their rows look ahead; the same for any number of threads."""
    across = int(columns.counts[0]) // max(1, int(columns.reach[0]))
    n_domains = max(1, min(n_atoms // ATOMS_PER_DOMAIN, across, MOST_CHUNKS))
    n_runs = int((columns.counts[0] + n_domains * columns.reach[0]) * (columns.counts[1] + 2 * columns.reach[1]))
    column, cluster, first, run = (np.zeros(n_domains + 1, dtype=np.int64) for _ in range(4))
    return Domains(column, cluster, first, run, np.zeros(n_runs + 1, dtype=np.int64))


def make_ghosts(n_clusters: int, n_ghosts: int, memory: Buffers) -> GhostClusters:
    """Arrays with room for so many, to be filled by fill_ghosts and sort_ghosts."""
    room = functools.partial(memory.array, spare=1.0)
    owner, key, of = (room(name, np.int32, n_ghosts) for name in ("owner", "key", "of"))
    bottom, top = (room(name, np.float64, n_ghosts) for name in ("ghost bottom", "ghost top"))
    shift, boxes = room("shift", np.float64, n_ghosts, 3), room("ghost boxes", np.float32, SIDES * (n_ghosts + BOXES))
    lanes, is_used = room("lanes", np.uint8, n_ghosts), room("is_used", np.bool_, n_ghosts)
    home, start = room("home", np.int32, n_clusters), room("start", np.int32, n_clusters + 1)
    return GhostClusters(owner, key, shift, bottom, top, boxes, lanes, home, is_used, of, start)


@scalar
def cut_into_domains(clusters, columns, domains):
    """Fill Domains: which columns and clusters each has, and how many ghosts it sees."""
    counts, reach, column_start = columns.counts, columns.reach, clusters.column_start
    n_domains, n_clusters = domains.column.size - 1, column_start[counts[0] * counts[1]]
    x = 0
    for d in range(n_domains + 1):
        while 0 < d and x < counts[0] and (column_start[x * counts[1]] + column_start[(x + 1) * counts[1]]) * n_domains <= 2 * d * n_clusters:
            x += 1  # to the border nearest to d equal shares
        domains.column[d] = counts[0] if d == n_domains else x
        domains.cluster[d] = column_start[domains.column[d] * counts[1]]
    run = 0
    for d in range(n_domains):
        domains.run[d], domains.first[d] = run, domains.ghost[run]
        for run_x in range(domains.column[d], domains.column[d + 1] + reach[0]):
            for run_y in range(-reach[1], counts[1] + reach[1]):
                n = 0
                if run_x > domains.column[d] or run_y >= 0:  # no row looks at what is behind the first column
                    for image_z in range(-1, 2):
                        first, last, _ = _seen(run_x, run_y, image_z, clusters, columns)
                        n += last - first
                domains.ghost[run + 1] = domains.ghost[run] + n
                run += 1
    domains.run[n_domains], domains.first[n_domains] = run, domains.ghost[run]


@scalar
def _seen(run_x, run_y, image_z, clusters, columns):
    """Clusters first to last of a column, inside the cell or beyond its faces, whose image can be seen from it; the image's code."""
    counts, pbc = columns.counts, columns.pbc
    image_x, image_y = run_x // counts[0], run_y // counts[1]
    image = (image_x + 1) * 9 + (image_y + 1) * 3 + image_z + 1
    if (image_x != 0 and not pbc[0]) or (image_y != 0 and not pbc[1]) or (image_z != 0 and not pbc[2]):
        return 0, 0, image
    column = (run_x - image_x * counts[0]) * counts[1] + run_y - image_y * counts[1]
    first, last = clusters.column_start[column], clusters.column_start[column + 1]
    while image_z > 0 and last > first and clusters.bottom[last - 1] > columns.along:
        last -= 1
    while image_z < 0 and last > first and clusters.top[first] < 1.0 - columns.along:
        first += 1
    return first, last, image


@scalar
def fill_ghosts(domain, layout):
    """Write the ghosts of one domain. is_used is true for the domain's own clusters only; find_rows sets it for the others."""
    columns, clusters, domains, ghosts, coordinates = layout
    stride, unit = ghosts.boxes.size // SIDES, columns.distance
    lattice, lanes, n_lanes = columns.lattice, clusters.lanes, count(clusters.lanes)
    run = domains.run[domain]
    for run_x in range(domains.column[domain], domains.column[domain + 1] + columns.reach[0]):
        for run_y in range(-columns.reach[1], columns.counts[1] + columns.reach[1]):
            ghost = domains.ghost[run]
            run += 1
            if ghost == domains.ghost[run]:
                continue
            for image_z in range(-1, 2):
                first, last, image = _seen(run_x, run_y, image_z, clusters, columns)
                a, b = image // 9 - 1, image // 3 % 3 - 1
                is_home = image == HOME and run_x < domains.column[domain + 1]
                for k in range(first, last):
                    ghosts.owner[ghost], ghosts.key[ghost], ghosts.is_used[ghost] = k, k * IMAGES + image, is_home
                    ghosts.lanes[ghost] = (1 << clusters.filled[k]) - 1
                    ghosts.bottom[ghost], ghosts.top[ghost] = clusters.bottom[k] + image_z, clusters.top[k] + image_z
                    for d in range(3):
                        shift = a * lattice[0, d] + b * lattice[1, d] + image_z * lattice[2, d]
                        ghosts.shift[ghost, d] = shift
                        low, high = (clusters.boxes[k, d] + shift) / unit, (clusters.boxes[k, d + 3] + shift) / unit
                        ghosts.boxes[d * stride + ghost] = low - OUTWARD * abs(low)
                        ghosts.boxes[(d + 3) * stride + ghost] = high + OUTWARD * abs(high)
                        place = (k * DIMENSIONS + d) * n_lanes
                        x = load(clusters.positions, place, lanes) + load(clusters.offsets, place, lanes)
                        store(coordinates, (ghost * DIMENSIONS + d) * n_lanes, x + shift)
                    if is_home:
                        ghosts.home[k] = ghost
                    ghost += 1


@scalar
def sort_ghosts(n, ghosts):
    """Fill ghosts.of and ghosts.start: the used ones of n ghosts, cluster by cluster, in the order of their numbers."""
    for k in range(ghosts.start.size):
        ghosts.start[k] = 0
    for m in range(n):
        ghosts.start[ghosts.owner[m]] += ghosts.is_used[m]
    for k in range(1, ghosts.start.size):
        ghosts.start[k] += ghosts.start[k - 1]
    for m in range(n - 1, -1, -1):  # what starts as the end of each cluster ends as its start
        if ghosts.is_used[m]:
            ghosts.start[ghosts.owner[m]] -= 1
            ghosts.of[ghosts.start[ghosts.owner[m]]] = m
