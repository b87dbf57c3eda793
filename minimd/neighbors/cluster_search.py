"""Which clusters each atom must meet: columns ahead, bounding boxes, then the atoms themselves.

Every pair of clusters is met once: an atom's row looks at its own cluster (later lanes only), at what stands above it in
its own column, and at the columns ahead:

    . . f f f        c  the column itself, upwards only
    . . f f f        f  columns ahead, over their whole height
    . . c f f        .  columns that look at this one instead
    . . . f f
    . . . f f

All of these are runs of ghosts in the domain of the atom: neither the search nor the loop over rows knows of periodicity.
"""

from collections import namedtuple

import numpy as np

from minimd.compiled.kernels import inlined, scalar, shared_kernel
from minimd.compiled.simd import bits_from_mask, broadcast, fma, load
from minimd.compiled.simd.lanes import count
from minimd.compiled.threads import barrier, begin, finish_and_take, take
from minimd.neighbors.clusters import DIMENSIONS
from minimd.neighbors.domains import BOXES, HOME, IMAGES, SIDES
from minimd.structure.cell import minimum_image

LANES_FROM = 24  # the bits of an entry below this one number a ghost, those above it stand for lanes
GHOST_BITS = (1 << LANES_FROM) - 1
ROUNDED_UP = 1.0 + 1e-6  # the squared reach, in units of itself, by the rounding of float32


class Rows(namedtuple("Rows", "start stop entries")):
    """Clusters within reach of each atom: those of the atom in slot s are entries[start[s] : stop[s]].

    start, stop : (slots,) int.  entries : (E,) uint32, the number of a ghost, and above its 24 bits one for each lane that counts.
    One more entry follows the last one: the loop reads one entry ahead."""


class Work(namedtuple("Work", "ahead candidates entries near")):
    """Memory for the search of one cluster.

    ahead : (runs, 2) int, first and last ghost of each run ahead.  candidates, entries : (M,) ghosts, and the entries they become.
    near : (M,) uint8, bit k is set if the candidate is near the atom in lane k.
    """


@inlined
def make_work(domains, columns):
    """Enough for any cluster of any domain."""
    n_runs = (columns.reach[0] + 1) * (2 * columns.reach[1] + 1)
    n = 0
    for k in range(domains.run.size - 1):
        n = max(n, domains.ghost[domains.run[k + 1]] - domains.ghost[domains.run[k]])
    return Work(np.empty((n_runs, 2), dtype=np.int64), np.empty(n + BOXES, dtype=np.int64), np.empty(n, dtype=np.uint32), np.empty(n, dtype=np.uint8))


@scalar
def find_rows(domain, layout, rows, room, work):
    """Write the rows of one domain; return how many entries there are, or more than that if there is not enough room.

    room : first and last of the domain's entries.
    """
    columns, domains, column_start = layout.columns, layout.domains, layout.clusters.column_start
    width, depth = columns.counts[1] + 2 * columns.reach[1], columns.reach[1]
    ahead, (first, last) = work.ahead, room
    n_entries = first
    for x in range(domains.column[domain], domains.column[domain + 1]):
        for y in range(columns.counts[1]):
            column = x * columns.counts[1] + y
            n_ahead = 0
            for run_x in range(columns.reach[0] + 1):
                for run_y in range(-depth if run_x > 0 else 0, depth + 1):
                    run = domains.run[domain] + (x - domains.column[domain] + run_x) * width + y + run_y + depth
                    ahead[n_ahead, 0], ahead[n_ahead, 1] = domains.ghost[run], domains.ghost[run + 1]
                    n_ahead += ahead[n_ahead, 0] < ahead[n_ahead, 1]
            for k in range(column_start[column], column_start[column + 1]):
                ahead[0, 0] = layout.ghosts.home[k] + 1
                n = _candidates(k, n_ahead, layout, work)
                n_entries = _prune(k, n, layout, rows, n_entries, last, work)
    if n_entries < last:
        rows.entries[n_entries] = 0  # see Rows
    return n_entries + 1 - first


@scalar
def _candidates(k, n_ahead, layout, work):
    """Ghosts ahead of cluster k whose boxes are within reach; returns how many. The first ghost of each run moves up with k."""
    ghosts, along, limit2, ahead, candidates = layout.ghosts, layout.columns.along, np.float32(ROUNDED_UP), work.ahead, work.candidates
    boxes, bottom, top, i = ghosts.boxes, ghosts.bottom, ghosts.top, ghosts.home[k]
    low, high = bottom[i] - along, top[i] + along
    own, stride = _box(boxes, i), boxes.size // SIDES
    n = 0
    for run in range(n_ahead):
        j, last = ahead[run, 0], ahead[run, 1]
        while j < last and top[j] < low:
            j += 1
        ahead[run, 0] = j
        while j < last and bottom[j] <= high:
            x = _gap(boxes, j, stride, own[0], own[3])
            y = _gap(boxes, j + stride, stride, own[1], own[4])
            z = _gap(boxes, j + 2 * stride, stride, own[2], own[5])
            near = bits_from_mask(fma(x, x, fma(y, y, z * z)) < limit2)
            for lane in range(min(BOXES, last - j)):
                candidates[n] = j + lane
                n += near >> lane & 1
            j += BOXES
    return n


@scalar
def _box(boxes, i):
    """The six sides of box i, each in all lanes of a vector."""
    like, stride = load(boxes, 0, BOXES), boxes.size // SIDES
    x_low, y_low, z_low = broadcast(boxes[i], like), broadcast(boxes[i + stride], like), broadcast(boxes[i + 2 * stride], like)
    i += 3 * stride
    return x_low, y_low, z_low, broadcast(boxes[i], like), broadcast(boxes[i + stride], like), broadcast(boxes[i + 2 * stride], like)


@scalar
def _gap(boxes, j, stride, low, high):
    """Distances along one axis, in units of the reach, from an interval, low to high, to those of BOXES boxes; 0 where they overlap."""
    return max(0.0, max(load(boxes, j, BOXES) - high, low - load(boxes, j + 3 * stride, BOXES)))


@scalar
def _prune(k, n, layout, rows, n_entries, last, work):
    """Write the rows of the atoms of cluster k: those of the n candidates that are within reach, then k itself. Returns the end of the entries."""
    lanes, n_lanes = layout.clusters.lanes, count(layout.clusters.lanes)
    if n_entries + n_lanes * (n + 1) >= last:  # no room: an upper bound tells how much is missing
        return n_entries + n_lanes * (n + 1) + 1
    ghosts, coordinates, reach, filled = layout.ghosts, layout.coordinates, layout.columns.distance, layout.clusters.filled[k]
    home, own = ghosts.home[k], ghosts.home[k] * DIMENSIONS * n_lanes
    x, y, z = load(coordinates, own, lanes), load(coordinates, own + n_lanes, lanes), load(coordinates, own + 2 * n_lanes, lanes)
    for c in range(n):
        ghost = work.candidates[c]
        nearest = broadcast(np.inf, x)
        for lane in range(n_lanes):  # all atoms of k at a time against one of the candidate's
            other = ghost * DIMENSIONS * n_lanes + lane
            dx, dy, dz = x - coordinates[other], y - coordinates[other + n_lanes], z - coordinates[other + 2 * n_lanes]
            nearest = min(nearest, fma(dx, dx, fma(dy, dy, dz * dz)))
        near = bits_from_mask(nearest < reach * reach)
        work.near[c], work.entries[c] = near, ghost | ghosts.lanes[ghost] << LANES_FROM
        ghosts.is_used[ghost] |= near != 0
    end = np.uintp(n_entries)  # unsigned: no check for indices that count from the end
    for lane in range(n_lanes):
        rows.start[k * n_lanes + lane] = end
        if lane < filled:
            for c in range(n):
                rows.entries[end] = work.entries[c]  # overwritten by the next unless near
                end += np.uintp(work.near[c] >> lane & 1)
            rows.entries[end] = home | (ghosts.lanes[home] >> (lane + 1) << (lane + 1)) << LANES_FROM
            end += np.uintp(lane < filled - 1)
        rows.stop[k * n_lanes + lane] = end
    return np.int64(end)


@shared_kernel
def exclude_pairs(worker, task, layout, image, partners, slot_of, rows):
    """Clear the lane of each excluded partner, at its nearest image, in the row where the pair is listed; each domain is a chunk.

    image : lattice, inverse, pbc, safe_distance2 of Cell.  partners : see find_pairs.  slot_of : (N,) int, output, slot of each atom.
    """
    n = layout.domains.cluster.size - 1
    phase = begin(worker, task)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        _find_slots(chunk, layout, slot_of)
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        _exclude_partners(chunk, layout, image, partners, slot_of, rows)
        chunk = finish_and_take(worker, phase, n)
    barrier(worker, phase)


@scalar
def _find_slots(domain, layout, slot_of):
    clusters, domain_start, n_lanes = layout.clusters, layout.domains.cluster, count(layout.clusters.lanes)
    for slot in range(domain_start[domain] * n_lanes, domain_start[domain + 1] * n_lanes):
        if slot % n_lanes < clusters.filled[slot // n_lanes]:
            slot_of[clusters.atom[slot]] = slot


@scalar
def _exclude_partners(domain, layout, image, partners, slot_of, rows):
    clusters, domain_start, (start, values) = layout.clusters, layout.domains.cluster, partners
    n_lanes = count(clusters.lanes)
    for k in range(domain_start[domain], domain_start[domain + 1]):
        for slot in range(k * n_lanes, k * n_lanes + clusters.filled[k]):
            i = clusters.atom[slot]
            for p in range(np.uintp(start[i]), np.uintp(start[i + 1])):  # unsigned: no check for indices that count from the end
                _exclude(domain, slot, slot_of[np.uintp(values[p])], layout, image, rows)


@scalar
def _exclude(domain, slot, other, layout, image, rows):
    """Clear the lane of the atom in slot other in the row of a slot, if it is there."""
    ghosts, coordinates, n_lanes = layout.ghosts, layout.coordinates, count(layout.clusters.lanes)
    cluster, lane = other // n_lanes, np.uint32(other % n_lanes)
    own, home = ghosts.home[slot // n_lanes], ghosts.home[cluster]
    at, place = own * DIMENSIONS * n_lanes + slot % n_lanes, home * DIMENSIONS * n_lanes + lane
    x, y = coordinates[place] - coordinates[at], coordinates[place + n_lanes] - coordinates[at + n_lanes]
    z = coordinates[place + 2 * n_lanes] - coordinates[at + 2 * n_lanes]
    a, b, c = minimum_image(x, y, z, *image)
    key, others = cluster * IMAGES + HOME + int(9.0 * a + 3.0 * b + c), ~np.uint32(np.uint32(1) << (np.uint32(LANES_FROM) + lane))
    if layout.domains.cluster[domain] <= cluster < layout.domains.cluster[domain + 1] and key == ghosts.key[home]:
        if other < slot:  # rows look ahead
            return
        if home == own:  # the last of each row
            rows.entries[np.uintp(rows.stop[slot] - 1)] &= others
            return
    for entry in range(np.uintp(rows.start[slot]), np.uintp(rows.stop[slot])):
        if ghosts.key[rows.entries[entry] & GHOST_BITS] == key:
            rows.entries[entry] &= others
            return
