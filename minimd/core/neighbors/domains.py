"""The cell cut into domains, each with forces of its own on all clusters that its atoms can see:
so no two domains write to the same memory.

A domain is a range of columns along the first lattice vector. Its rows look ahead only. So around its own columns (o)
it sees those ahead (h), through periodic boundaries where these are crossed; atoms in the columns behind (.)
look at the domain instead:

    . . h h h h h h h        second lattice vector  ↑
    . . o o o o o h h
    . . o o o o o h h        first lattice vector   →
    . . h h h h h h h

Each of these columns is a run of ghosts, sorted along the third lattice vector, with images below and above:

    | image −1: the highest of the column | the column itself | image +1: the lowest of the column |

A ghost is a cluster moved by a lattice vector; the one moved by zero is its home. Ghosts are numbered column after
column, so those that a domain sees, its window, have consecutive numbers; the windows of neighboring domains overlap.
Positions are copied to all ghosts of a cluster. Forces belong to a ghost in a window, and are summed window by window,
in the order of the ghosts: the same bits, whichever thread did the work.

    ghosts    | 0 0 0 0 0 0 0 0 | 1 1 1 1 1 1 1 1 | 2 2 2 2 2 2 2 2 | behind the last column: images of the first
    window 0  | o o o o o o o o   h h h |
    window 1                    | o o o o o o o o   h h h |
    window 2                                      | o o o o o o o o   h h h |

One thread needs memory for the forces of few windows at a time: as soon as a domain and those behind it are done, the
sums of its atoms are whole. Only the first domains, which the last ones see, must wait to the end.
"""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import scalar
from minimd.core.compiled.simd import store
from minimd.core.compiled.simd.vector import count, loaded
from minimd.core.compiled.threads import MOST_CHUNKS
from minimd.core.neighbors.buffers import Buffers
from minimd.core.neighbors.clusters import DIMENSIONS, Columns, offsets_of
from minimd.core.structure.vectors import plus, transformed

SIDES = 6  # of a box: smallest x, y, z, and largest
BOXES = 8  # compared at a time
OUTWARD = 2e-7  # of a coordinate: boxes in float32 are larger by its rounding
# number of images, and the code of image (0, 0, 0)
IMAGES = 27
HOME = 13
# places in Domains.numbers
LATE = 0
BLOCKS = 1
GHOSTS = 2
# at least, on average: with fewer, handing out the work costs more than a second thread gains
ATOMS_PER_DOMAIN = 800


class Domains(ByAddress, namedtuple("Domains", "column cluster first window place numbers ghost")):
    """column, cluster : (K + 1,) int, first column of each domain along the first lattice vector, and first cluster.
    first : (K,) int, the first ghost that it sees.
    window : (K + 1,) int, how many all domains before it see together.
    place : (K,) int, the block of forces of its first ghost.
    numbers : (3,) int, LATE: how many of the domains, the first ones, wait until all forces are computed; all of them,
        unless one thread goes from domain to domain.  BLOCKS: how many blocks of forces there are.  GHOSTS: M.
    ghost : (runs + 1,) int, the first ghost of each run; the last number is M."""


class GhostClusters(
    ByAddress,
    namedtuple(
        "GhostClusters", "owner image bottom top boxes lanes home is_used of start parts part_start"
    ),
):
    """M ghosts of C clusters, and W of them in windows. Arrays have room for more.
    owner : (M,) int, the cluster.
    image : (M,) int, code of its image (a, b, c): 9 (a + 1) + 3 (b + 1) + c + 1.
    bottom, top : (M,) fractional coordinates along the third lattice vector.
    boxes : flat float32, for each of the SIDES a row of at least M + BOXES numbers, in units of Columns.distance:
        any length has room.
    lanes : (M,) uint8, bit k is set if lane k is not padding.
    home : (C,) int, the home of each cluster.
    is_used : (W + M,) bool, window after window, true for ghosts that stand in a row of the domain, and for its homes;
        then for each ghost whether it is used in any of them.
    of : (U,) int, ghosts used in some window, by cluster, those of cluster k from start[k].
    start : (C + 1,) int.
    parts : (P,) int, the blocks of the forces on them, likewise, from part_start[k].
    part_start : (C + 1,) int.
    bottom, top, boxes, lanes and is_used are needed for a build only."""


def make_domains(columns: Columns, n_atoms: int) -> Domains:
    """As many domains, for any number of threads, as have enough atoms and are as wide as their rows look ahead."""
    n_x, n_y, _ = columns.counts.tolist()
    ahead_x, ahead_y = columns.reach.tolist()
    across = n_x // max(1, ahead_x)
    n = max(1, min(n_atoms // ATOMS_PER_DOMAIN, across, MOST_CHUNKS))
    n_runs = (n_x + ahead_x) * (n_y + 2 * ahead_y)
    sizes = n + 1, n + 1, n, n + 1, n, 3, n_runs + 1
    return Domains(*(np.zeros(size, dtype=np.int64) for size in sizes))


def make_ghosts(
    n_clusters: int, n_ghosts: int, n_in_windows: int, buffers: Buffers
) -> GhostClusters:
    """Arrays with room for so many, for fill_ghosts and sort_ghosts."""
    array = buffers.array
    return GhostClusters(
        array("owner", np.int32, n_ghosts),
        array("image", np.uint8, n_ghosts),
        array("ghost bottom", np.float64, n_ghosts),
        array("ghost top", np.float64, n_ghosts),
        array("ghost boxes", np.float32, SIDES * (n_ghosts + BOXES)),
        array("ghost lanes", np.uint8, n_ghosts),
        array("home", np.int32, n_clusters + 1),
        array("is used", np.bool_, n_in_windows + n_ghosts),
        array("of", np.int32, n_ghosts),
        array("start", np.int32, n_clusters + 1),
        array("parts", np.int32, n_in_windows),
        array("part start", np.int32, n_clusters + 1),
    )


@scalar
def cut_into_domains(clusters, columns, domains, goes_along):
    """Fill Domains: which columns and clusters each has, and which ghosts it sees.

    clusters : Clusters.
    columns : Columns.
    domains : Domains, output.
    goes_along : whether one thread goes from domain to domain: forces then take the place of those no longer needed."""
    counts = columns.counts
    reach = columns.reach
    column_start = clusters.column_start
    n_across = counts[1]
    n_domains = domains.first.size
    n_clusters = column_start[counts[0] * n_across]

    x = 0

    for d in range(1, n_domains):
        # to the border nearest to d equal shares
        while x < counts[0]:
            middle = column_start[x * n_across] + column_start[(x + 1) * n_across]
            if middle * n_domains > 2 * d * n_clusters:
                break
            x += 1

        domains.column[d] = x
        domains.cluster[d] = column_start[x * n_across]

    domains.column[n_domains] = counts[0]
    domains.cluster[n_domains] = n_clusters

    run = 0

    for run_x in range(counts[0] + reach[0]):
        for run_y in range(-reach[1], counts[1] + reach[1]):
            domains.ghost[run + 1] = domains.ghost[run]
            run += 1
            if run_x > 0 or run_y >= 0:  # no row looks at what is behind the first column
                for image_z in range(-1, 2):
                    first, last, _ = _seen(run_x, run_y, image_z, clusters, columns)
                    domains.ghost[run] += last - first

    for d in range(n_domains):
        domains.first[d] = domains.ghost[first_run(domains.column[d], columns)]
        last = domains.ghost[first_run(domains.column[d + 1] + reach[0], columns)]
        domains.window[d + 1] = domains.window[d] + last - domains.first[d]

    domains.numbers[GHOSTS] = domains.ghost[run]
    _place_windows(columns, domains, goes_along)


@scalar
def _place_windows(columns, domains, goes_along):
    """Where the forces of each window stand: each by itself, or all but the late ones where others are done."""
    n = domains.first.size
    column = domains.column
    reach = columns.reach[0]

    n_late = 0
    n_open = 1
    widest = 0
    behind = 0
    for d in range(n):
        n_late += column[d] < reach  # the last domains see it
        widest = max(widest, domains.window[d + 1] - domains.window[d])

    for d in range(n + 1):
        while behind < n - 1 and column[behind + 1] + reach <= column[d]:
            behind += 1
        n_open = max(n_open, min(d, n - 1) + 1 - behind)

    is_less = goes_along > 0 and (n_late + n_open) * widest < domains.window[n]
    for d in range(n):
        place = d if d < n_late else n_late + (d - n_late) % n_open
        domains.place[d] = widest * place if is_less else domains.window[d]
    domains.numbers[LATE] = max(1, n_late) if goes_along else n
    domains.numbers[BLOCKS] = (n_late + n_open) * widest if is_less else domains.window[n]


@scalar
def first_run(x, columns):
    """The first run of a column along the first lattice vector."""
    return x * (columns.counts[1] + 2 * columns.reach[1])


@scalar
def _seen(run_x, run_y, image_z, clusters, columns):
    """Clusters first to last of a column, in the cell or beyond its faces, whose image it can see; the image's code.

    run_x, run_y : the column, below zero or above its number beyond the faces.
    image_z : −1, 0 or 1, along the third lattice vector."""
    counts = columns.counts
    is_crossed = columns.is_crossed
    image_x, image_y = run_x // counts[0], run_y // counts[1]
    image = 9 * image_x + 3 * image_y + image_z + HOME
    if (
        (image_x and not is_crossed[0])
        or (image_y and not is_crossed[1])
        or (image_z and not is_crossed[2])
    ):
        return 0, 0, image

    x, y = run_x - image_x * counts[0], run_y - image_y * counts[1]
    column = x * counts[1] + y
    first = clusters.column_start[column]
    last = clusters.column_start[column + 1]
    while image_z > 0 and last > first and clusters.bottom[last - 1] > columns.along[2]:
        last -= 1
    while image_z < 0 and last > first and clusters.top[first] < 1.0 - columns.along[2]:
        first += 1
    return first, last, image


@scalar
def fill_ghosts(domain, arrays):
    """Write the ghosts of the columns of a domain, of the last one also those behind the last column.
    In its window is_used is then true for the domain's own clusters only; find_rows sets it for the others."""
    columns = arrays.columns
    clusters = arrays.clusters
    domains = arrays.domains
    ghosts = arrays.ghosts
    shifts = arrays.memory.shifts
    stride = ghosts.boxes.size // SIDES
    unit = columns.distance
    depth = columns.reach[1]
    lanes = clusters.lanes
    n_lanes = count(lanes)
    first_used = domains.window[domain]
    for place in range(first_used, domains.window[domain + 1]):
        ghosts.is_used[place] = False

    last_x = domains.column[domain + 1]
    if domain == domains.first.size - 1:
        last_x += columns.reach[0]

    run = first_run(domains.column[domain], columns)

    for run_x in range(domains.column[domain], last_x):
        for run_y in range(-depth, columns.counts[1] + depth):
            ghost = domains.ghost[run]
            run += 1
            if ghost == domains.ghost[run]:
                continue

            for image_z in range(-1, 2):
                first, last, image = _seen(run_x, run_y, image_z, clusters, columns)
                for k in range(first, last):
                    ghosts.owner[ghost] = k
                    ghosts.image[ghost] = image
                    ghosts.lanes[ghost] = (1 << clusters.filled[k]) - 1
                    ghosts.bottom[ghost] = clusters.bottom[k] + image_z
                    ghosts.top[ghost] = clusters.top[k] + image_z
                    start = np.uintp(k * DIMENSIONS * n_lanes)
                    positions = loaded(clusters.positions, start, lanes)

                    for d, x in enumerate(plus(positions, offsets_of(start, clusters))):
                        shift = shifts[image, d]
                        low = (clusters.boxes[k, d] + shift) / unit
                        high = (clusters.boxes[k, d + 3] + shift) / unit
                        ghosts.boxes[d * stride + ghost] = low - OUTWARD * abs(low)
                        ghosts.boxes[(d + 3) * stride + ghost] = high + OUTWARD * abs(high)
                        store(
                            arrays.memory.coordinates, (ghost * DIMENSIONS + d) * n_lanes, x + shift
                        )

                    if image == HOME:
                        ghosts.home[k] = ghost
                        ghosts.is_used[first_used + ghost - domains.first[domain]] = True
                    ghost += 1


@scalar
def fill_shifts(columns, shifts):
    """The lattice vector of each image.

    columns : Columns.
    shifts : (IMAGES, 3) output [length]."""
    for image in range(IMAGES):
        cells = image // 9 - 1, image // 3 % 3 - 1, image % 3 - 1
        for d, x in enumerate(transformed(cells, columns.lattice)):
            shifts[image, d] = x


@scalar
def sort_ghosts(domains, ghosts):
    """What is used, by cluster, by window, in the order of their numbers.

    domains : Domains.
    ghosts : GhostClusters; of, start, parts, part_start and the last part of is_used are output."""
    owner = ghosts.owner
    start = ghosts.start
    part_start = ghosts.part_start
    window = domains.window
    is_used = ghosts.is_used
    n_ghosts = domains.numbers[GHOSTS]
    n_domains = domains.first.size
    somewhere = window[n_domains]  # behind the windows: whether a ghost is used in any of them

    for m in range(n_ghosts):
        is_used[somewhere + m] = False
    for k in range(start.size):
        start[k] = 0
        part_start[k] = 0

    for d in range(n_domains):
        for place in range(window[d], window[d + 1]):
            if is_used[place]:
                m = domains.first[d] + place - window[d]
                start[owner[m]] += not is_used[somewhere + m]
                part_start[owner[m]] += 1
                is_used[somewhere + m] = True

    for k in range(1, start.size):
        start[k] += start[k - 1]
        part_start[k] += part_start[k - 1]

    # what starts as the end of each cluster ends as its start
    for m in range(n_ghosts - 1, -1, -1):
        if is_used[somewhere + m]:
            k = owner[m]
            start[k] -= 1
            ghosts.of[start[k]] = m

    for d in range(n_domains - 1, -1, -1):
        for place in range(window[d + 1] - 1, window[d] - 1, -1):
            if is_used[place]:
                k = owner[domains.first[d] + place - window[d]]
                part_start[k] -= 1
                ghosts.parts[part_start[k]] = domains.place[d] + place - window[d]
