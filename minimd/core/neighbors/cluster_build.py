"""The operations that keep a cluster list valid: atoms to their clusters and ghosts; where it is not valid any more,
sort, cut, find rows, in memory that is already there."""

from collections import namedtuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import called_kernel, filling_kernel, kernel
from minimd.core.compiled.program import GO_ON, JUMP, NEEDS_ROOM, NOT_FINITE
from minimd.core.compiled.simd import bits_from_mask
from minimd.core.compiled.simd.vector import count, gathered, loaded, stored
from minimd.core.neighbors.cluster_memory import place
from minimd.core.neighbors.cluster_search import (
    BUILDS,
    IN_USE,
    LAYERS,
    exclude,
    find_rows,
    make_work,
)
from minimd.core.neighbors.clusters import (
    DIMENSIONS,
    columns_fit,
    count_columns,
    fill_column,
)
from minimd.core.neighbors.domains import (
    BLOCKS,
    GHOSTS,
    cut_into_domains,
    fill_ghosts,
    fill_shifts,
    sort_ghosts,
)
from minimd.core.neighbors.search import WIDER, counting_sort
from minimd.core.neighbors.verlet_list import count_not_finite
from minimd.core.structure.vectors import dot, minus, transformed


class Building(
    ByAddress,
    namedtuple(
        "Building",
        "positions arrays binned n_blocks n_chunks goes_along "
        "entry_start needed excluded slot_of images",
    ),
):
    """What the operations work on.
    positions : (N, 3) [length].  Outputs: arrays : ClusterArrays but its columns, binned : Binned.
    n_blocks : of forces, as there is room.
    n_chunks : of columns.
    goes_along : see cut_into_domains.
    entry_start : (K + 1,) int, first entry of each domain.
    needed : (K,) int, output, entries that each domain needs, which may be more than there is room for.
    excluded : partners of each atom, see find_pairs; if there are any, slot_of : (N,) int, output, slot of each atom.
    images : Images."""


@called_kernel
def place_atoms(building, domain):
    """Positions of the atoms of a domain to all their ghosts; memory.layers[domain] = how many layers of the rows are
    needed, LAYERS + 1 if the list is no longer valid, as for a position that is not a number."""
    arrays = building.arrays
    clusters = arrays.clusters
    lanes = clusters.lanes
    limits2 = arrays.rows.limits2
    n_lanes = count(lanes)
    all_lanes = (1 << n_lanes) - 1
    n_layers = 1
    if arrays.rows.layers[IN_USE] == 0:  # there is no list
        return GO_ON

    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        at = gathered(building.positions, clusters.atom, k * n_lanes, lanes)
        start = np.uintp(k) * np.uintp(DIMENSIONS * n_lanes)
        moved = minus(at, loaded(clusters.positions, start, lanes))
        moved2 = dot(moved, moved)  # padding moves with the last atom
        while n_layers <= LAYERS and bits_from_mask(moved2 <= limits2[n_layers - 1]) != all_lanes:
            n_layers += 1
        place(k, arrays, at)

    arrays.memory.layers[domain] = n_layers
    return GO_ON


@called_kernel
def is_valid(building, _chunk):
    """JUMP if the list is valid, with the layers that are needed in use; else there is none from now on."""
    arrays = building.arrays
    layers = arrays.rows.layers
    if layers[IN_USE] > 0:
        for domain in range(arrays.memory.layers.size):
            layers[IN_USE] = max(layers[IN_USE], arrays.memory.layers[domain])
        if layers[IN_USE] <= LAYERS:
            return JUMP
    layers[IN_USE] = 0
    return NOT_FINITE if count_not_finite(building.positions)[0] > 0 else GO_ON


@called_kernel
def find_columns(building, _chunk):
    """NEEDS_ROOM if the atoms have left the columns."""
    return GO_ON if columns_fit(building.positions, building.arrays.columns) else NEEDS_ROOM


@called_kernel
def sort_atoms(building, _chunk):
    """Atoms into the bins of all columns; the first cluster of each, the second lattice direction running faster."""
    columns = building.arrays.columns
    clusters = building.arrays.clusters
    binned = building.binned
    counts = columns.counts
    column_start = clusters.column_start
    n_lanes = count(clusters.lanes)

    # the cell of the clusters is the one in which they are made
    for a in range(DIMENSIONS):
        for b in range(DIMENSIONS):
            clusters.wrapping.inverse[a, b] = columns.inverse[a, b]
            clusters.wrapping.lattice[a, b] = columns.lattice[a, b]

    counting_sort(building.positions, columns.inverse, columns.pbc, columns, binned)

    column_start[0] = 0
    for column in range(counts[0] * counts[1]):
        n = binned.bin_start[(column + 1) * counts[2]] - binned.bin_start[column * counts[2]]
        column_start[column + 1] = column_start[column] + (n + n_lanes - 1) // n_lanes
    return GO_ON


@called_kernel
def cut_columns(building, chunk):
    """Columns into clusters: a chunk is some rows of them along the second lattice vector."""
    columns = building.arrays.columns
    clusters = building.arrays.clusters
    n = building.n_chunks
    counts = columns.counts
    first = chunk * counts[0] // n * counts[1]
    last = (chunk + 1) * counts[0] // n * counts[1]
    for column in range(first, last):
        fill_column(column, building.positions, columns, building.binned, clusters)
    return GO_ON


@called_kernel
def find_domains(building, _chunk):
    """Clusters into domains.  NEEDS_ROOM if there is too little: how much is needed is then in domains."""
    arrays = building.arrays
    domains = arrays.domains
    ghosts = arrays.ghosts
    rows = arrays.rows
    cut_into_domains(arrays.clusters, arrays.columns, domains, building.goes_along)
    fill_shifts(arrays.columns, arrays.memory.shifts)
    for layer in range(LAYERS):
        rows.limits2[layer] = rows.limits2_at_build[layer]

    has_room = (
        domains.numbers[GHOSTS] <= ghosts.owner.size
        and domains.window[domains.window.size - 1] <= ghosts.parts.size
        and domains.numbers[BLOCKS] <= building.n_blocks
    )
    return GO_ON if has_room else NEEDS_ROOM


@called_kernel
def place_ghosts(building, domain):
    """The ghosts that a domain sees."""
    fill_ghosts(domain, building.arrays)
    return GO_ON


@filling_kernel
def list_rows(building, domain):
    """The rows of a domain.  NEEDS_ROOM if there is too little: how much is needed is then in needed."""
    arrays = building.arrays
    first = building.entry_start[domain]
    last = building.entry_start[domain + 1]
    needed = find_rows(domain, arrays, (first, last), make_work(arrays))
    building.needed[domain] = needed
    return GO_ON if needed <= last - first else NEEDS_ROOM


@called_kernel
def finish_list(building, _chunk):
    """Which ghosts are used. There is a list now."""
    sort_ghosts(building.arrays.domains, building.arrays.ghosts)
    layers = building.arrays.rows.layers
    layers[IN_USE] = 1
    layers[BUILDS] += 1
    return GO_ON


@called_kernel
def number_slots(building, domain):
    """The slot of each atom of a domain."""
    arrays = building.arrays
    n_lanes = count(arrays.clusters.lanes)
    first = arrays.domain_start[domain] * n_lanes
    last = arrays.domain_start[domain + 1] * n_lanes
    # backwards: padding comes before the atom that it repeats
    for slot in range(last - 1, first - 1, -1):
        building.slot_of[arrays.clusters.atom[slot]] = slot
    return GO_ON


@called_kernel
def exclude_pairs(building, domain):
    """Clear the lane of each excluded partner, at its nearest image, in the row of a domain that has it."""
    arrays = building.arrays
    start, values = building.excluded
    clusters = arrays.clusters
    lattice, inverse, pbc, safe_distance2 = building.images
    image = (lattice, inverse, pbc, safe_distance2[0])
    n_lanes = count(clusters.lanes)
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        for slot in range(k * n_lanes, k * n_lanes + clusters.filled[k]):
            i = clusters.atom[slot]
            # unsigned: none counts from the end
            for p in range(np.uintp(start[i]), np.uintp(start[i + 1])):
                partner = np.uintp(values[p])
                exclude(domain, slot, building.slot_of[partner], arrays, image)
    return GO_ON


@kernel
def follow_strain(building, strain, lattice, inverse, heights, region):
    """A list follows the cell, strained with all atoms; False if that needs other columns, and so a new list.

    building : Building, whose clusters have origins of their own.
    strain : (3, 3) of all positions since the list was built.
    lattice, inverse, heights : of the Cell now.
    region : of the columns, see region_of."""
    arrays = building.arrays
    columns = arrays.columns
    clusters = arrays.clusters
    images = building.images
    smallest = np.inf
    n_lanes = count(clusters.lanes)
    numbers = np.empty(5, dtype=np.int64)
    n_atoms = building.positions.shape[0]
    count_columns(heights, region, columns.is_crossed, n_atoms, columns.distance, n_lanes, numbers)
    for d in range(5):
        if numbers[d] != (columns.counts[d] if d < 3 else columns.reach[d - 3]):
            return False

    for d in range(DIMENSIONS):
        columns.along[d] = WIDER * columns.distance / heights[d]
        smallest = min(smallest, heights[d])
        for c in range(DIMENSIONS):
            for held in (columns.lattice, clusters.wrapping.lattice, images.lattice):
                held[d, c] = lattice[d, c]
            columns.inverse[d, c] = images.inverse[d, c] = inverse[d, c]
    images.safe_distance2[0] = (0.5 * smallest) ** 2
    fill_shifts(columns, arrays.memory.shifts)

    for k in range(clusters.column_start[-1]):
        start = np.uintp(k * DIMENSIONS * n_lanes)
        at = loaded(clusters.origins, start, clusters.lanes)
        stored(clusters.positions, start, transformed(at, strain))
    return True
