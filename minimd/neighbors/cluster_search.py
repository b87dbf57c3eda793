"""Which clusters each atom must meet: columns ahead, bounding boxes, then the atoms themselves.

Every pair of clusters is met once: an atom's row looks at its own cluster (later lanes only), at what stands above it in
its own column, and at the columns ahead:

    . . f f f        c  the column itself, upwards only
    . . f f f        f  columns ahead, over their whole height
    . . c f f        .  columns that look at this one instead
    . . . f f
    . . . f f

All of these are runs of copies in the chunk of the atom: the search knows nothing of periodicity, nor does the loop over rows.
"""

from typing import Any, NamedTuple

import numpy as np

from minimd.compiled.kernels import inlined, scalar, shared_kernel
from minimd.compiled.simd import bits_from_mask, broadcast, fma, load
from minimd.compiled.threads import begin, finish_and_take, take, wait
from minimd.forces.cluster_loop import BLOCK, COPY_BITS, LANES, LANES_FROM
from minimd.neighbors.domains import ALL_LANES, HOME, image_key
from minimd.structure.cell import minimum_image


class Work(NamedTuple):
    """Room for one cluster: the copies first to last of each run ahead; candidates, the entries they become, whom they are near to."""

    ahead: Any
    candidates: Any
    entries: Any
    near: Any


@inlined
def make_work(chunks, columns):
    """Enough for any cluster of any chunk."""
    n_runs = (columns.reach[0] + 1) * (2 * columns.reach[1] + 1)
    n = 0
    for chunk in range(chunks.run.size - 1):
        n = max(n, chunks.copy[chunks.run[chunk + 1]] - chunks.copy[chunks.run[chunk]])
    return Work(np.empty((n_runs, 2), dtype=np.int64), np.empty(n, dtype=np.int64), np.empty(n, dtype=np.uint32), np.empty(n, dtype=np.uint8))


@scalar
def find_rows(chunk, chunks, clusters, columns, copies, coordinates, reach, rows, room, work):
    """Write the rows of one chunk; return how many entries there are, or more than that if there is not enough room.

    reach : [length].  room : first and last of the chunk's entries.
    """
    width, depth = columns.counts[1] + 2 * columns.reach[1], columns.reach[1]
    ahead = work.ahead
    first, last = room
    n_entries = first
    for x in range(chunks.column[chunk], chunks.column[chunk + 1]):
        for y in range(columns.counts[1]):
            column = x * columns.counts[1] + y
            n_ahead = 0
            for run_x in range(columns.reach[0] + 1):
                for run_y in range(-depth if run_x > 0 else 0, depth + 1):
                    run = chunks.run[chunk] + (x - chunks.column[chunk] + run_x) * width + y + run_y + depth
                    ahead[n_ahead, 0], ahead[n_ahead, 1] = chunks.copy[run], chunks.copy[run + 1]
                    n_ahead += ahead[n_ahead, 0] < ahead[n_ahead, 1]
            for k in range(clusters.column_start[column], clusters.column_start[column + 1]):
                home = copies.home[k]
                ahead[0, 0] = home + 1
                n = _candidates(home, n_ahead, ahead, copies, columns.along, reach, work.candidates)
                n_entries = _prune(k, home, n, work, clusters, copies, coordinates, reach, rows, n_entries, last)
    if n_entries < last:
        rows.entries[n_entries] = 0  # see Rows
    return n_entries + 1 - first


@scalar
def _candidates(i, n_ahead, ahead, copies, along, reach, candidates):
    """Copies ahead of copy i whose boxes are within reach; returns how many. The first column of each run moves up with i."""
    boxes, bottom, top = copies.boxes, copies.bottom, copies.top
    low, high = bottom[i] - along, top[i] + along
    x_low, y_low, z_low, x_high, y_high, z_high = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3], boxes[i, 4], boxes[i, 5]
    n = 0
    for run in range(n_ahead):
        j, last = ahead[run, 0], ahead[run, 1]
        while j < last and top[j] < low:
            j += 1
        ahead[run, 0] = j
        while j < last and bottom[j] <= high:
            gap_x = max(0.0, max(boxes[j, 0] - x_high, x_low - boxes[j, 3]))
            gap_y = max(0.0, max(boxes[j, 1] - y_high, y_low - boxes[j, 4]))
            gap_z = max(0.0, max(boxes[j, 2] - z_high, z_low - boxes[j, 5]))
            candidates[n] = j
            n += gap_x * gap_x + gap_y * gap_y + gap_z * gap_z < reach * reach
            j += 1
    return n


@scalar
def _prune(k, home, n, work, clusters, copies, coordinates, reach, rows, n_entries, last):
    """The rows of the atoms of cluster k: each of n candidates with an atom within reach, its own cluster last."""
    if n_entries + LANES * (n + 1) >= last:  # no room: an upper bound tells how much is missing
        return n_entries + LANES * (n + 1) + 1
    own = home * BLOCK
    x, y, z = load(coordinates, own, LANES), load(coordinates, own + LANES, LANES), load(coordinates, own + 2 * LANES, LANES)
    for c in range(n):
        copy = work.candidates[c]
        nearest = broadcast(np.inf, x)
        for lane in range(LANES):  # eight atoms of k at a time against one of the candidate's
            other = copy * BLOCK + lane
            dx, dy, dz = x - coordinates[other], y - coordinates[other + LANES], z - coordinates[other + 2 * LANES]
            nearest = min(nearest, fma(dx, dx, fma(dy, dy, dz * dz)))
        near = bits_from_mask(nearest < reach * reach)
        work.near[c], work.entries[c] = near, copy | copies.lanes[copy] << LANES_FROM
        copies.is_used[copy] |= near != 0
    end = np.uintp(n_entries)  # unsigned: no check for indices that count from the end
    for lane in range(LANES):
        rows.start[k * LANES + lane] = end
        if lane < clusters.filled[k]:
            for c in range(n):
                rows.entries[end] = work.entries[c]  # overwritten by the next unless near
                end += np.uintp(work.near[c] >> lane & 1)
            rows.entries[end] = home | ((ALL_LANES << (lane + 1)) & copies.lanes[home]) << LANES_FROM
            end += np.uintp(lane < clusters.filled[k] - 1)
        rows.stop[k * LANES + lane] = end
    return np.int64(end)


@shared_kernel
def exclude_pairs(me, task, clusters, chunk_start, copies, cell, excluded_start, excluded, slot_of, rows):
    """Clear the lane of each excluded partner, at its nearest image, in the row where the pair is listed; each chunk is a share of work.

    cell : lattice, inverse, pbc, safe_distance2 of Cell.  excluded_start, excluded : see find_pairs.
    slot_of : (N,) int, output, slot of each atom.
    """
    n = chunk_start.size - 1
    phase = begin(me, task)
    chunk = take(me, phase, n)
    while chunk >= 0:
        for cluster in range(chunk_start[chunk], chunk_start[chunk + 1]):
            for slot in range(cluster * LANES, cluster * LANES + clusters.filled[cluster]):
                slot_of[clusters.atom[slot]] = slot
        chunk = finish_and_take(me, phase, n)
    phase = wait(me, phase)
    chunk = take(me, phase, n)
    while chunk >= 0:
        for cluster in range(chunk_start[chunk], chunk_start[chunk + 1]):
            for slot in range(cluster * LANES, cluster * LANES + clusters.filled[cluster]):
                i = clusters.atom[slot]
                for p in range(excluded_start[i], excluded_start[i + 1]):
                    _exclude(slot, slot_of[excluded[p]], clusters, copies, cell, rows)
        chunk = finish_and_take(me, phase, n)
    wait(me, phase)


@scalar
def _exclude(slot, other, clusters, copies, cell, rows):
    """Clear the lane of the atom in slot other in the row of a slot, if it is there."""
    cluster, lane = other // LANES, other % LANES
    own, place = slot // LANES * BLOCK + slot % LANES, cluster * BLOCK + lane
    x = clusters.coordinates[place] - clusters.coordinates[own]
    y = clusters.coordinates[place + LANES] - clusters.coordinates[own + LANES]
    z = clusters.coordinates[place + 2 * LANES] - clusters.coordinates[own + 2 * LANES]
    a, b, c = minimum_image(x, y, z, *cell)
    key = image_key(cluster, HOME + int(9.0 * a + 3.0 * b + c))
    for entry in range(np.uintp(rows.start[slot]), np.uintp(rows.stop[slot])):  # unsigned: no check for indices that count from the end
        if copies.key[rows.entries[entry] & COPY_BITS] == key:
            rows.entries[entry] &= ~np.uint32(1 << (LANES_FROM + lane))
            return
