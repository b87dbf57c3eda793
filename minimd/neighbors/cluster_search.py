"""Which clusters each atom must meet: columns ahead, bounding boxes, then the atoms themselves; and the ghosts this takes.

Every pair of clusters is met once: an atom's row looks at its own cluster (later lanes only), at what stands above it in
its own column, and at the columns ahead:

    . . f f f        c  the column itself, upwards only
    . . f f f        f  columns ahead, over their whole height
    . . c f f        .  columns that look at this one instead
    . . . f f
    . . . f f

A cluster seen through a periodic boundary is a ghost: a copy of it, shifted by a lattice vector, made when somebody first
needs it. The loop over rows then knows nothing of periodicity.
"""

import numpy as np

from minimd.compiling import kernel, scalar
from minimd.potentials.cluster_loop import BLOCK, LANES
from minimd.simd import bits_from_mask, broadcast, fma, load, store

HOME = 13  # row of image (0, 0, 0) among the 27 images
ALL_LANES = 255


@kernel
def find_rows(
    coordinates,
    atom,
    boxes,
    bottom,
    top,
    column_start,
    counts,
    reach_columns,
    along,
    reach,
    pbc,
    lattice,
    ghost_of,
    ghosts,
    candidates,
    start,
    cluster,
    lanes,
):
    """Write the rows of all slots; return how many entries and ghosts there are, which may be more than there is room for.

    coordinates : flat, of real clusters; those of ghosts are appended.  atom, bottom, top, column_start : of Clusters.
    boxes : (clusters, 6).  counts, reach_columns, along : of Columns.  reach : [length].
    ghost_of : (27, clusters) int, −1 on entry; the number of the ghost of each image and cluster.
    ghosts : (G, 2) int, output: owner and image of each ghost.  candidates : (C, 2) int, work space.
    start, cluster, lanes : outputs, see potentials.cluster_loop.Rows.
    """
    n_clusters = boxes.shape[0]
    n_entries, n_ghosts, most = 0, 0, 0
    columns = np.empty((3 * (reach_columns[0] + 1) * (2 * reach_columns[1] + 1), 3), dtype=np.int64)
    shifts = np.empty((columns.shape[0], 3))
    for column_x in range(counts[0]):
        for column_y in range(counts[1]):
            own = column_x * counts[1] + column_y
            if column_start[own] == column_start[own + 1]:
                continue
            n_columns = _columns_ahead(column_x, column_y, column_start, counts, reach_columns, pbc, lattice, columns, shifts)
            for i in range(column_start[own], column_start[own + 1]):
                n = _candidates(i, n_columns, columns, shifts, boxes, bottom, top, along, reach, candidates)
                most = max(most, n)
                n = min(n, candidates.shape[0])
                n_ghosts = _as_blocks(n, n_clusters, coordinates, lattice, candidates, ghost_of, ghosts, n_ghosts)
                if n_ghosts > ghosts.shape[0]:
                    return n_entries, n_ghosts, most
                n_entries = _prune(i, n, coordinates, atom, reach, candidates, start, cluster, lanes, n_entries)
    start[n_clusters * LANES] = n_entries
    return n_entries, n_ghosts, most


@scalar
def _columns_ahead(column_x, column_y, column_start, counts, reach_columns, pbc, lattice, columns, shifts):
    """The column itself, what is above it, and the columns ahead, with their images; returns how many.

    columns : rows (first cluster, last cluster + 1, image).  shifts : lattice vector of each image.
    """
    n = 0
    for ahead_x in range(reach_columns[0] + 1):
        for ahead_y in range(-reach_columns[1] if ahead_x > 0 else 0, reach_columns[1] + 1):
            to_x, to_y = column_x + ahead_x, column_y + ahead_y
            cell_x, cell_y = to_x // counts[0], to_y // counts[1]
            if (cell_x != 0 and not pbc[0]) or (cell_y != 0 and not pbc[1]):
                continue
            column = (to_x - cell_x * counts[0]) * counts[1] + to_y - cell_y * counts[1]
            lowest = 0 if ahead_x == 0 and ahead_y == 0 else -1
            for cell_z in range(lowest if pbc[2] else 0, 2 if pbc[2] else 1):
                columns[n, 0], columns[n, 1] = column_start[column], column_start[column + 1]
                columns[n, 2] = (cell_x + 1) * 9 + (cell_y + 1) * 3 + cell_z + 1
                for d in range(3):
                    shifts[n, d] = cell_x * lattice[0, d] + cell_y * lattice[1, d] + cell_z * lattice[2, d]
                n += 1
    return n


@scalar
def _candidates(i, n_columns, columns, shifts, boxes, bottom, top, along, reach, candidates):
    """Clusters ahead of cluster i whose boxes are within reach: rows (cluster, image) of candidates; returns how many."""
    n = 0
    for k in range(n_columns):
        first, last, image = columns[k, 0], columns[k, 1], columns[k, 2]
        cell_z = image % 3 - 1
        low, high = bottom[i] - along - cell_z, top[i] + along - cell_z
        if first == last or top[last - 1] < low or bottom[first] > high:
            continue
        if k == 0:
            first = i + 1
        x, y, z = shifts[k, 0], shifts[k, 1], shifts[k, 2]
        for j in range(first, last):
            if top[j] < low:
                continue
            if bottom[j] > high:
                break
            gap_x = max(0.0, max(boxes[j, 0] + x - boxes[i, 3], boxes[i, 0] - boxes[j, 3] - x))
            gap_y = max(0.0, max(boxes[j, 1] + y - boxes[i, 4], boxes[i, 1] - boxes[j, 4] - y))
            gap_z = max(0.0, max(boxes[j, 2] + z - boxes[i, 5], boxes[i, 2] - boxes[j, 5] - z))
            if gap_x * gap_x + gap_y * gap_y + gap_z * gap_z < reach * reach:
                if n < candidates.shape[0]:
                    candidates[n, 0], candidates[n, 1] = j, image
                n += 1
    return n


@scalar
def _as_blocks(n, n_clusters, coordinates, lattice, candidates, ghost_of, ghosts, n_ghosts):
    """Turn (cluster, image) into the number of the cluster or its ghost; make ghosts that do not exist yet; returns how many exist."""
    for k in range(n):
        owner, image = candidates[k, 0], candidates[k, 1]
        if image == HOME:
            continue
        if ghost_of[image, owner] < 0:
            if n_ghosts < ghosts.shape[0]:
                ghost_of[image, owner] = n_clusters + n_ghosts
                ghosts[n_ghosts, 0], ghosts[n_ghosts, 1] = owner, image
                copy_shifted(coordinates, owner, n_clusters + n_ghosts, image, lattice)
            n_ghosts += 1
        candidates[k, 0] = ghost_of[image, owner]
    return n_ghosts


@scalar
def _prune(i, n, coordinates, atom, reach, candidates, start, cluster, lanes, n_entries):
    """The rows of the eight atoms of cluster i: its own cluster first, then each candidate with an atom within reach."""
    zero = load(coordinates, 0, LANES) * 0.0
    for k in range(LANES):
        slot = i * LANES + k
        start[slot] = n_entries
        if atom[slot] < 0:
            continue
        x = broadcast(coordinates[i * BLOCK + k], zero)
        y = broadcast(coordinates[i * BLOCK + LANES + k], zero)
        z = broadcast(coordinates[i * BLOCK + 2 * LANES + k], zero)
        if n_entries + n + 1 > cluster.size:  # no room: an upper bound tells how much is missing
            n_entries += n + 1
            continue
        cluster[n_entries], lanes[n_entries] = i, (ALL_LANES << (k + 1)) & ALL_LANES
        n_entries += k < LANES - 1
        for c in range(n):
            j = candidates[c, 0] * BLOCK
            dx = load(coordinates, j, LANES) - x
            dy = load(coordinates, j + LANES, LANES) - y
            dz = load(coordinates, j + 2 * LANES, LANES) - z
            near = bits_from_mask(fma(dx, dx, fma(dy, dy, dz * dz)) < reach * reach)
            cluster[n_entries], lanes[n_entries] = candidates[c, 0], ALL_LANES  # overwritten by the next unless near
            n_entries += near != 0
    return n_entries


@scalar
def copy_shifted(coordinates, owner, ghost, image, lattice):
    """Coordinates of a ghost = those of its owner + the lattice vector of its image."""
    a, b, c = image // 9 - 1, image // 3 % 3 - 1, image % 3 - 1
    for d in range(3):
        shift = a * lattice[0, d] + b * lattice[1, d] + c * lattice[2, d]
        store(coordinates, ghost * BLOCK + d * LANES, load(coordinates, owner * BLOCK + d * LANES, LANES) + shift)


@kernel
def refresh_ghosts(coordinates, n_clusters, ghosts, lattice):
    """Move all ghosts to where their owners are now."""
    for g in range(ghosts.shape[0]):
        copy_shifted(coordinates, ghosts[g, 0], n_clusters + g, ghosts[g, 1], lattice)


@kernel
def fold_ghosts(on_clusters, n_clusters, ghosts):
    """Forces on ghosts are forces on their owners."""
    for g in range(ghosts.shape[0]):
        for d in range(3):
            owner = ghosts[g, 0] * BLOCK + d * LANES
            store(on_clusters, owner, load(on_clusters, owner, LANES) + load(on_clusters, (n_clusters + g) * BLOCK + d * LANES, LANES))


@kernel
def exclude_lanes(atom, slot_of, excluded_start, excluded, nearest, ghost_of, start, cluster, lanes):
    """Clear the lane of each excluded partner, at its nearest image, in the row where the pair is listed.

    slot_of : (N,) int, slot of each atom.  excluded_start, excluded : see find_pairs.
    nearest : (P,) int, image of each partner that is nearest to the atom.
    """
    for slot in range(atom.size):
        i = atom[slot]
        if i < 0:
            continue
        for p in range(excluded_start[i], excluded_start[i + 1]):
            other = slot_of[excluded[p]]
            where = other // LANES if nearest[p] == HOME else ghost_of[nearest[p], other // LANES]
            for entry in range(start[slot], start[slot + 1]):
                if cluster[entry] == where:
                    lanes[entry] = lanes[entry] & np.uint8(ALL_LANES - (1 << (other % LANES)))
