"""The operations of pair laws on the cluster list: the loop over the clusters of a domain, the sums of its forces."""

from collections import namedtuple

import numpy as np

from minimd.compiled.by_address import ByAddress
from minimd.compiled.call_by_address import run_at
from minimd.compiled.kernels import called_kernel, scalar
from minimd.compiled.program import GO_ON, OUT_OF_RANGE
from minimd.compiled.simd import lane
from minimd.compiled.simd.lanes import count
from minimd.neighbors.cluster_memory import clear, collected
from minimd.neighbors.cluster_search import BUILDS, IN_USE, LAYERS, PREPARED_FOR
from minimd.neighbors.domains import LATE


class Evaluation(ByAddress, namedtuple("Evaluation", "arrays add prepare work forces steps is_first")):
    """What the operations work on.

    arrays : ClusterArrays.
    add, prepare : addresses of add_forces_of_laws and, if the loop needs it after a list build, of prepare_loop, or 0;
        compiled for each law, so that the kernels of this file are the same for all laws.
    work : address of their Work.
    forces : (N, 3) output [energy/length]; int64 impulses in fixed-point arithmetic, where steps : Steps, else ().
    is_first : whether there is nothing to add to: forces = and not forces +=.
    """


@called_kernel
def prepare_laws(evaluation, _chunk):
    """What the loop needs of a new list, or of other layers of one."""
    layers = evaluation.arrays.rows.layers
    now = layers[BUILDS] * (LAYERS + 1) + layers[IN_USE]
    if layers[PREPARED_FOR] != now:
        layers[PREPARED_FOR] = now
        run_at(evaluation.prepare, (evaluation.arrays, evaluation.work))
    return GO_ON


@called_kernel
def add_domain(evaluation, domain):
    """Forces between the atoms of a domain and all that it sees. On one thread the sums of what is whole are taken at
    once: while they are in the cache."""
    arrays = evaluation.arrays
    clear(domain, arrays)
    if domain < arrays.memory.is_out.size:
        arrays.memory.is_out[domain] = 0
    run_at(evaluation.add, (domain, arrays, evaluation.work, evaluation.steps))
    if domain >= arrays.domains.numbers[LATE]:
        _collect(domain, evaluation)
    return GO_ON


@called_kernel
def collect_domain(evaluation, domain):
    """The forces on the atoms of a domain that were not taken before.  OUT_OF_RANGE if one of a pair was, in
    fixed-point arithmetic."""
    if domain < evaluation.arrays.domains.numbers[LATE]:
        _collect(domain, evaluation)
    is_out = evaluation.arrays.memory.is_out
    return OUT_OF_RANGE if is_out.size > 0 and is_out[domain] else GO_ON


@scalar
def _collect(domain, evaluation):
    """forces (N, 3) = or += those on the atoms of a domain."""
    arrays, forces, clusters = evaluation.arrays, evaluation.forces, evaluation.arrays.clusters
    n_lanes = count(clusters.lanes)
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        x, y, z = collected(k, arrays)
        for k_lane in range(n_lanes):
            if k_lane < clusters.filled[k]:
                i = np.uintp(clusters.atom[k * n_lanes + k_lane])
                if evaluation.is_first:
                    forces[i, 0], forces[i, 1], forces[i, 2] = lane(x, k_lane), lane(y, k_lane), lane(z, k_lane)
                else:
                    forces[i, 0] += lane(x, k_lane)
                    forces[i, 1] += lane(y, k_lane)
                    forces[i, 2] += lane(z, k_lane)
