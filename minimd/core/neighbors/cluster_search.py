"""Which clusters each atom must meet: columns ahead, bounding boxes, then the atoms themselves.

Every pair of clusters is met once: an atom's row looks at its own cluster (later lanes only), at what stands above it
in its own column, and at the columns ahead:

    . . f f f        c  the column itself, upwards only
    . . f f f        f  columns ahead, over their whole height
    . . c f f        .  columns that look at this one instead
    . . . f f
    . . . f f

All of these are runs of ghosts in the window of the atom's domain:
neither the search nor the loop over rows knows of periodicity.
"""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import inlined, scalar
from minimd.core.compiled.simd import (
    bits_from_mask,
    broadcast,
    fma,
    load,
    select,
    store,
    trailing_zeros,
)
from minimd.core.compiled.simd.vector import count, loaded
from minimd.core.neighbors.clusters import DIMENSIONS
from minimd.core.neighbors.domains import BOXES, HOME, SIDES, first_run
from minimd.core.structure.cell import minimum_image

# the bits of an entry below this one number a ghost, those above it stand for lanes
LANES_FROM = 24
GHOST_BITS = (1 << LANES_FROM) - 1
LAYERS = 2  # of each row; with more, a build costs as much more as steps cost less
# places in Rows.layers
IN_USE = 0
BUILDS = 1
PREPARED_FOR = 2
AHEAD = 2 * BOXES  # see Rows
WORD = 64  # candidates, one for each bit of a number
AT_A_TIME = 4  # entries written without a branch
# of boxes, row k those whose bits are set in k
SETS = np.arange(1 << BOXES)[:, None] >> np.arange(BOXES) & 1 == 1
HOW_MANY = SETS.sum(axis=1)
# their numbers, and then the others
SET_BITS = np.argsort(~SETS, axis=1, kind="stable").astype(np.int32).ravel()
ROUNDED_UP = 1.0 + 1e-6  # the squared reach, in units of itself, by the rounding of float32


class Rows(
    ByAddress, namedtuple("Rows", "start stops entries reaches2 limits2 limits2_at_build layers")
):
    """Clusters near each atom, in layers: entries[start[s] : stops[l, s]] have an atom within reach l of the one in s.
    start : (slots,) int.
    stops : (LAYERS, slots) int.
    entries : (E,) uint32, the number of a ghost in the window of the domain, and above its 24 bits one for each lane.
    reaches2 : (LAYERS,) squared, from the shortest to the longest [length²].
    limits2 : (LAYERS,) squared distances that an atom may move before another layer is needed, or a new list [length²].
    limits2_at_build : the same as long as the cell has not been strained since.
    layers : (3,) int: how many layers are IN_USE, 0 if there is no list; the number of BUILDS so far; and, for the loop
        over clusters, for which of them, see prepare_loop, it is prepared.
    After the last entry there is memory for AHEAD more: some read ahead. The loop reads one: it must name a ghost."""


class SearchMemory(namedtuple("SearchMemory", "ahead candidates entries near")):
    """Memory for the search of one cluster. Ghosts are numbered as in GhostClusters, but for those in entries.
    ahead : (runs, 2) int, first and last ghost of each run ahead.
    candidates, entries : (M,) ghosts, their entries.
    near : flat int64, for each WORD candidates, each layer and each lane of the cluster a number: bit b is set if
        candidate b stands in that layer of the row of the atom in that lane."""


@inlined
def make_work(arrays):
    """Enough for any cluster of any domain."""
    window = arrays.domains.window
    depth_x, depth_y = arrays.columns.reach[0], arrays.columns.reach[1]
    n_runs = (depth_x + 1) * (2 * depth_y + 1)
    n = 0
    for k in range(window.size - 1):
        n = max(n, window[k + 1] - window[k])

    n_near = (n // WORD + 1) * LAYERS * count(arrays.clusters.lanes)
    return SearchMemory(
        np.empty((n_runs, 2), dtype=np.int64),
        np.empty(n + BOXES, dtype=np.int32),
        np.empty(n + WORD + 1, dtype=np.uint32),
        np.empty(n_near, dtype=np.int64),
    )


@scalar
def find_rows(domain, arrays, room, work):
    """Write the rows of a domain; return how many entries there are, more if there is no room.

    arrays : ClusterArrays; its rows are output.
    room : first and last of the entries that may be written.
    work : SearchMemory."""
    columns = arrays.columns
    domains = arrays.domains
    column_start = arrays.clusters.column_start
    n_across = columns.counts[1]
    depth = columns.reach[1]
    ahead = work.ahead
    first, last = room
    n_entries = first

    for x in range(domains.column[domain], domains.column[domain + 1]):
        for y in range(n_across):
            n_ahead = 0

            for run_x in range(columns.reach[0] + 1):
                for run_y in range(-depth if run_x > 0 else 0, depth + 1):
                    run = first_run(x + run_x, columns) + y + run_y + depth
                    ahead[n_ahead, 0] = domains.ghost[run]
                    ahead[n_ahead, 1] = domains.ghost[run + 1]
                    n_ahead += ahead[n_ahead, 0] < ahead[n_ahead, 1]

            column = x * n_across + y

            for k in range(column_start[column], column_start[column + 1]):
                ahead[0, 0] = arrays.ghosts.home[k] + 1
                n = _candidates(k, n_ahead, arrays, work)
                n_entries = _prune(k, n, domain, arrays, (n_entries, last), work)

    if n_entries < last:
        arrays.rows.entries[n_entries] = 0  # see Rows
    return n_entries + 1 - first


@scalar
def _candidates(k, n_ahead, arrays, work):
    """How many ghosts ahead of cluster k have boxes within reach: they are written to work.candidates.

    n_ahead : number of runs in work.ahead; the first ghost of each moves up with k."""
    ghosts = arrays.ghosts
    ahead = work.ahead
    candidates = work.candidates
    along = arrays.columns.along[2]
    limit2 = np.float32(ROUNDED_UP)
    boxes = ghosts.boxes
    bottom = ghosts.bottom
    top = ghosts.top

    i = ghosts.home[k]
    low = bottom[i] - along
    high = top[i] + along
    n = 0

    stride = boxes.size // SIDES
    like = load(boxes, 0, BOXES)
    x_low = broadcast(boxes[i], like)
    y_low = broadcast(boxes[i + stride], like)
    z_low = broadcast(boxes[i + 2 * stride], like)
    x_high = broadcast(boxes[i + 3 * stride], like)
    y_high = broadcast(boxes[i + 4 * stride], like)
    z_high = broadcast(boxes[i + 5 * stride], like)

    for run in range(n_ahead):
        j = ahead[run, 0]
        last = ahead[run, 1]
        while j < last and top[j] < low:
            j += 1
        ahead[run, 0] = j

        while j < last and bottom[j] <= high:
            x = _gap(boxes, j, stride, x_low, x_high)
            y = _gap(boxes, j + stride, stride, y_low, y_high)
            z = _gap(boxes, j + 2 * stride, stride, z_low, z_high)
            are_near = bits_from_mask(_length2(x, y, z) < limit2)
            near = are_near & (1 << min(BOXES, last - j)) - 1
            numbers = load(SET_BITS, near * BOXES, BOXES)
            store(candidates, n, numbers + j)
            n += HOW_MANY[near]
            j += BOXES

    return n


@scalar
def _length2(x, y, z):
    """x² + y² + z²."""
    return fma(x, x, fma(y, y, z * z))


@scalar
def _gap(boxes, j, stride, low, high):
    """Distances along one axis [reach] from an interval, low to high, to those of BOXES boxes; 0 where they overlap."""
    return max(0.0, max(load(boxes, j, BOXES) - high, low - load(boxes, j + 3 * stride, BOXES)))


@scalar
def _prune(k, n, domain, arrays, room, work):
    """Write the rows of the atoms of cluster k: k itself, then those of the n candidates that are within reach.
    room : first and last of the entries that are left.  Returns the end of the entries."""
    rows = arrays.rows
    ghosts = arrays.ghosts
    n_lanes = count(arrays.clusters.lanes)
    n_entries, last = room
    most = n_lanes * (n + 1) + AT_A_TIME
    if n_entries + most >= last:  # no room: an upper bound tells how much is missing
        return n_entries + most + 1
    _find_near(k, n, domain, arrays, work)

    # unsigned: no check for indices that count from the end
    end = np.uintp(n_entries)
    home = ghosts.home[k]
    own = home - arrays.domains.first[domain]

    for lane in range(n_lanes):
        slot = k * n_lanes + lane
        rows.start[slot] = end
        later = ghosts.lanes[home] >> (lane + 1) << (lane + 1)
        rows.entries[end] = own | later << LANES_FROM
        later &= _own_lanes_near(home, lane, arrays)
        end += np.uintp(later != 0)
        n_listed = n if lane < arrays.clusters.filled[k] else 0

        for layer in range(LAYERS):
            for first in range(0, n_listed, WORD):
                near = work.near[(first // WORD * LAYERS + layer) * n_lanes + lane]
                end = _append(work, first, near, rows.entries, end)
            rows.stops[layer, slot] = end

    return np.int64(end)


@scalar
def _own_lanes_near(home, lane, arrays):
    """The lanes of a cluster, as bits, whose atoms are within reach of the atom in one of them."""
    coordinates = arrays.memory.coordinates
    lanes = arrays.clusters.lanes
    n_lanes = count(lanes)
    start = home * DIMENSIONS * n_lanes
    x, y, z = loaded(coordinates, np.uintp(start), lanes)
    dx = x - coordinates[start + lane]
    dy = y - coordinates[start + lane + n_lanes]
    dz = z - coordinates[start + lane + 2 * n_lanes]
    return bits_from_mask(_length2(dx, dy, dz) < arrays.rows.reaches2[LAYERS - 1])


@scalar
def _append(work, first, near, entries, end):
    """Append those of WORD candidates whose bits in near are set; the end of the entries.

    first : the first of these candidates.
    entries, end : where they are written."""
    bits = np.uint64(near)
    while True:
        # without a branch: what is one too many is overwritten by the next
        for _ in range(AT_A_TIME):
            entries[end] = work.entries[np.uintp(first) + trailing_zeros(bits)]
            end += np.uintp(bits != np.uint64(0))
            bits &= bits - np.uint64(1)
        if bits == np.uint64(0):
            return end


@scalar
def _find_near(k, n, domain, arrays, work):
    """work.near : which of the n candidates stand in which layers of the rows of cluster k; work.entries : of them."""
    ghosts = arrays.ghosts
    coordinates = arrays.memory.coordinates
    reaches2 = arrays.rows.reaches2
    lanes = arrays.clusters.lanes
    n_lanes = count(lanes)
    block = np.uintp(DIMENSIONS * n_lanes)
    first_seen = np.uintp(arrays.domains.first[domain])
    window = np.uintp(arrays.domains.window[domain])
    x, y, z = loaded(coordinates, np.uintp(ghosts.home[k]) * block, lanes)
    none = broadcast(0, load(work.near, 0, lanes))

    for first in range(0, n, WORD):
        bit = broadcast(1, none)
        inner = none
        both = none

        for p in range(np.uintp(first), np.uintp(min(first + WORD, n))):
            ghost = np.uintp(work.candidates[p])
            nearest2 = broadcast(np.inf, x)

            # all atoms of k at a time against one of the candidate's
            for lane in range(np.uintp(n_lanes)):
                at = ghost * block + lane
                dx = x - coordinates[at]
                dy = y - coordinates[at + np.uintp(n_lanes)]
                dz = z - coordinates[at + np.uintp(2 * n_lanes)]
                nearest2 = min(nearest2, _length2(dx, dy, dz))

            within = nearest2 < reaches2[1]
            inner = inner | select(nearest2 < reaches2[0], bit, none)
            both = both | select(within, bit, none)
            bit = bit + bit
            seen = ghost - first_seen
            ghosts.is_used[window + seen] |= bits_from_mask(within) != 0
            work.entries[p] = seen | np.uintp(ghosts.lanes[ghost]) << np.uintp(LANES_FROM)

        place = first // WORD * LAYERS * n_lanes
        store(work.near, place, inner)
        store(work.near, place + n_lanes, both - inner)  # each layer holds those before it


@scalar
def exclude(domain, slot, other, arrays, image):
    """Clear the lane of an atom, at its nearest image, in the row of another, if it is there.

    slot : whose row.
    other : the slot of the other atom.
    image : see minimum_image."""
    rows = arrays.rows
    coordinates = arrays.memory.coordinates
    n_lanes = count(arrays.clusters.lanes)
    cluster = other // n_lanes
    lane = np.uint32(other % n_lanes)

    own = arrays.ghosts.home[slot // n_lanes]
    home = arrays.ghosts.home[cluster]
    at = own * DIMENSIONS * n_lanes + slot % n_lanes
    to = home * DIMENSIONS * n_lanes + lane
    x = coordinates[to] - coordinates[at]
    y = coordinates[to + n_lanes] - coordinates[at + n_lanes]
    z = coordinates[to + 2 * n_lanes] - coordinates[at + 2 * n_lanes]

    a, b, c = minimum_image(x, y, z, *image)
    ghost = _ghost_of(domain, cluster, HOME + int(9.0 * a + 3.0 * b + c), arrays)
    if ghost == home and other < slot:  # rows look ahead
        return
    entry = _find_entry(rows, slot, ghost - arrays.domains.first[domain])
    if entry >= 0:
        rows.entries[np.uintp(entry)] &= ~np.uint32(np.uint32(1) << (np.uint32(LANES_FROM) + lane))


@scalar
def _ghost_of(domain, cluster, image, arrays):
    """The ghost of a cluster in the window of a domain; −1 if there is none."""
    ghosts = arrays.ghosts
    domains = arrays.domains
    first = domains.first[domain]
    last = first + domains.window[domain + 1] - domains.window[domain]
    for p in range(np.uintp(ghosts.start[cluster]), np.uintp(ghosts.start[cluster + 1])):
        ghost = ghosts.of[p]
        if first <= ghost < last and ghosts.image[ghost] == image:
            return ghost
    return -1


@scalar
def _find_entry(rows, slot, ghost):
    """Where a ghost stands in the row of a slot, −1 if nowhere. Many entries are compared at a time."""
    entries = rows.entries
    start = np.uintp(rows.start[slot])
    stop = np.uintp(rows.stops[LAYERS - 1, slot])
    while start < stop:
        first = load(entries, start, BOXES) & GHOST_BITS
        second = load(entries, start + np.uintp(BOXES), BOXES) & GHOST_BITS
        bits = bits_from_mask(first == ghost) | bits_from_mask(second == ghost) << BOXES
        if bits != 0:
            place = start + trailing_zeros(np.uint64(bits))
            return np.int64(place) if place < stop else -1
        start += np.uintp(2 * BOXES)
    return -1
