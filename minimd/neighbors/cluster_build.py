"""The build of a cluster list as one kernel: sort, cut, find rows, in memory that is already there."""

from collections import namedtuple

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import scalar, shared_kernel
from minimd.compiled.threads import MOST_CHUNKS, barrier, begin, finish_and_take, take
from minimd.neighbors.cluster_search import LAYERS, find_rows, make_work
from minimd.neighbors.clusters import DIMENSIONS, fill_clusters, sort_into_columns
from minimd.neighbors.domains import BLOCKS, GHOSTS, cut_into_domains, fill_ghosts, fill_shifts, sort_ghosts


class Building(ByAddress, namedtuple("Building", "binned layout rows n_blocks goes_along entry_start needed")):
    """Memory for a build.  binned, layout, rows : Binned, Layout, Rows, all of them outputs but for layout.columns.

    n_blocks : of forces for which there is room.  goes_along : see cut_into_domains.
    entry_start : (K + 1,) int, first entry of each domain.
    needed : (K,) int, output, entries that each domain needs, which may be more than there is room for.
    """


@shared_kernel
def build_clusters(worker, task, positions, building):
    """Clusters, domains, ghosts and rows of atoms at positions (N, 3). Returns 1, or 0 if there is too little room.

    How much is needed is then in layout.domains, and, if there is room for all ghosts, in needed.
    """
    binned, (columns, clusters, domains, ghosts, _, _), _, n_blocks, goes_along, entry_start, needed = building
    phase = begin(worker, task)
    chunk = take(worker, phase, 1)
    while chunk >= 0:
        sort_into_columns(positions, columns, binned, clusters)
        chunk = finish_and_take(worker, phase, 1)
    phase, n = barrier(worker, phase), min(columns.counts[0], MOST_CHUNKS)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        fill_clusters(chunk, n, positions, columns, binned, clusters)
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)
    chunk = take(worker, phase, 1)
    while chunk >= 0:
        cut_into_domains(clusters, columns, domains, goes_along)
        fill_shifts(columns, building.layout.shifts)
        _forget_strain(columns, clusters.wrapping, building.rows)
        chunk = finish_and_take(worker, phase, 1)
    phase = barrier(worker, phase)
    if not _has_room(domains, ghosts, n_blocks) or entry_start.size != domains.column.size:
        return 0
    chunk = take(worker, phase, needed.size)
    while chunk >= 0:
        fill_ghosts(chunk, building.layout)
        chunk = finish_and_take(worker, phase, needed.size)
    phase = barrier(worker, phase)
    work = make_work(building.layout)
    chunk = take(worker, phase, needed.size)
    while chunk >= 0:
        needed[chunk] = find_rows(
            chunk, building.layout, building.rows, (entry_start[chunk], entry_start[chunk + 1]), work
        )
        chunk = finish_and_take(worker, phase, needed.size)
    phase = barrier(worker, phase)
    chunk = take(worker, phase, 1)
    while chunk >= 0:
        sort_ghosts(domains, ghosts)
        chunk = finish_and_take(worker, phase, 1)
    barrier(worker, phase)
    return 1 if _is_enough(entry_start, needed) else 0


@scalar
def _forget_strain(columns, wrapping, rows):
    """The cell of the clusters is the one in which they are made."""
    for a in range(DIMENSIONS):
        for b in range(DIMENSIONS):
            wrapping.inverse[a, b], wrapping.lattice[a, b] = columns.inverse[a, b], columns.lattice[a, b]
    for layer in range(LAYERS):
        rows.limits2[layer] = rows.limits2_at_build[layer]


@scalar
def _has_room(domains, ghosts, n_blocks):
    """Whether there is room for all ghosts, and for the forces on them."""
    is_enough = (
        domains.numbers[GHOSTS] <= ghosts.owner.size and domains.window[domains.window.size - 1] <= ghosts.parts.size
    )
    return is_enough and domains.numbers[BLOCKS] <= n_blocks


@scalar
def _is_enough(entry_start, needed):
    """Whether each domain had room for its entries."""
    answer = True
    for d in range(needed.size):
        answer &= needed[d] <= entry_start[d + 1] - entry_start[d]
    return answer
