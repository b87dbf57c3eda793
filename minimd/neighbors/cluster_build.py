"""The build of a cluster list as one kernel: sort, cut, find rows, in memory that is already there."""

from collections import namedtuple

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import scalar, shared_kernel
from minimd.compiled.threads import MOST_CHUNKS, barrier, begin, finish_and_take, take
from minimd.neighbors.cluster_search import find_rows, make_work
from minimd.neighbors.clusters import fill_clusters, sort_into_columns
from minimd.neighbors.domains import cut_into_domains, fill_ghosts, sort_ghosts


class Building(ByAddress, namedtuple("Building", "binned layout rows entry_start needed")):
    """Memory for a build.  binned, layout, rows : Binned, Layout, Rows, all of them outputs but for layout.columns.

    entry_start : (K + 1,) int, first entry of each domain.
    needed : (K,) int, output, entries that each domain needs, which may be more than there is room for.
    """


@shared_kernel
def build_clusters(worker, task, positions, building):
    """Clusters, domains, ghosts and rows of atoms at positions (N, 3). Returns 1, or 0 if there is too little room.

    How much is needed is then in layout.domains.ghost[−1], and, if it is no more than there is, in needed.
    """
    binned, (columns, clusters, domains, ghosts, _), _, entry_start, needed = building
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
        cut_into_domains(clusters, columns, domains)
        chunk = finish_and_take(worker, phase, 1)
    phase, n_ghosts = barrier(worker, phase), domains.ghost[domains.ghost.size - 1]
    if n_ghosts > ghosts.owner.size or entry_start.size != domains.run.size:
        return 0
    work = make_work(building.layout)
    chunk = take(worker, phase, needed.size)
    while chunk >= 0:
        _build_domain(chunk, building, work)
        chunk = finish_and_take(worker, phase, needed.size)
    phase = barrier(worker, phase)
    chunk = take(worker, phase, 1)
    while chunk >= 0:
        sort_ghosts(n_ghosts, ghosts)
        chunk = finish_and_take(worker, phase, 1)
    barrier(worker, phase)
    return 1 if _is_enough(entry_start, needed) else 0


@scalar
def _build_domain(domain, building, work):
    """Ghosts and rows of one domain."""
    start = building.entry_start
    fill_ghosts(domain, building.layout)
    building.needed[domain] = find_rows(domain, building.layout, building.rows, (start[domain], start[domain + 1]), work)


@scalar
def _is_enough(entry_start, needed):
    """Whether each domain had room for its entries."""
    answer = True
    for d in range(needed.size):
        answer &= needed[d] <= entry_start[d + 1] - entry_start[d]
    return answer
