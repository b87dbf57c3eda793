"""The kernel of pair laws on the cluster list: the forces of a state, or many kicks and drifts with forces in between, on a pool of threads."""

from collections import namedtuple

import numpy as np

from minimd.compiled.kernels import by_type, scalar, shared_kernel
from minimd.compiled.simd.lanes import count
from minimd.compiled.threads import barrier, begin, finish_and_take, is_stopped, stop, take
from minimd.forces.cluster_loop import add_cluster_forces
from minimd.integrators.splitting.splitting import drift_atom, kick_atom
from minimd.neighbors.cluster_list import are_near, collect, gather, is_mixed, place, scatter
from minimd.neighbors.clusters import DIMENSIONS


class Rest(namedtuple("Rest", "")):
    """No motion: the forces are evaluated once."""


class Motion(namedtuple("Motion", "velocities inverse_masses durations first n limit2")):
    """n kicks and drifts, each kick after an evaluation of the forces; only an evaluation if n is 0.

    velocities : (N, 3) [length/time].  inverse_masses : (N,) [1/mass].  durations : (P, 2) of P kicks and drifts, in turn from the first [time].
    limit2 : square of the distance that an atom may be from where it was when the list was built [length²].
    """


@shared_kernel
def evaluate_clusters(worker, task, positions, arrays, laws, sums, forces, motion):
    """forces (N, 3) += those of all laws; with a Motion the atoms move, too. Returns how many kicks and drifts were made; each domain is a chunk.

    positions : (N, 3) [length].  arrays : ClusterArrays.  laws : tuple of pairs, a law type and its parameters, SameForAll or ByLane.
    sums : Sums or ForceSums.  motion : Rest, or Motion, whose forces must be zero before and are zero afterwards.
    """
    n, n_made = arrays.domain_start.size - 1, 0
    space = np.empty(DIMENSIONS * count(arrays.clusters.lanes))
    phase = begin(worker, task)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        for k in range(arrays.domain_start[chunk], arrays.domain_start[chunk + 1]):
            gather(k, arrays, positions, space)
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)
    while True:
        chunk = take(worker, phase, n)
        while chunk >= 0:
            _add_all(chunk, arrays, laws, sums)
            chunk = finish_and_take(worker, phase, n)
        phase = barrier(worker, phase)
        chunk = take(worker, phase, n)
        while chunk >= 0:
            if _end_step(chunk, arrays, positions, forces, space, motion, n_made):
                stop(worker, task)
            chunk = finish_and_take(worker, phase, n)
        phase = barrier(worker, phase)
        if is_mixed(arrays):
            chunk = take(worker, phase, n)
            while chunk >= 0:
                if _end_mixed_step(chunk, arrays, positions, forces, space, motion, n_made):
                    stop(worker, task)
                chunk = finish_and_take(worker, phase, n)
            phase = barrier(worker, phase)
        n_made += 1
        if n_made >= motion_steps(motion) or is_stopped(worker, task):
            return n_made


@by_type
def motion_steps(motion):
    """The number of kicks and drifts of a Motion; 0 of Rest."""
    return (lambda motion: 0) if motion.instance_class is Rest else lambda motion: motion.n


@by_type
def _add_all(domain, arrays, laws, sums):
    """add_cluster_forces for each law, unrolled by the compiler."""
    if len(laws) == 1:
        return lambda domain, arrays, laws, sums: add_cluster_forces(domain, arrays, laws[0][0], laws[0][1], sums)

    def add(domain, arrays, laws, sums):
        add_cluster_forces(domain, arrays, laws[0][0], laws[0][1], sums)
        _add_all(domain, arrays, laws[1:], sums)

    return add


@scalar
def _end_step(domain, arrays, positions, forces, work, motion, n_made):
    """Forces of the atoms of a domain, with which they move unless precision is mixed. True if the list is outdated then."""
    n_lanes, net, x, y, z, is_outdated = count(arrays.clusters.lanes), arrays.memory.net, 0.0, 0.0, 0.0, False
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        collect(k, arrays, work)
        if is_mixed(arrays):
            for lane in range(arrays.clusters.filled[k]):
                x, y, z = x + work[lane], y + work[n_lanes + lane], z + work[2 * n_lanes + lane]
        if not is_mixed(arrays) and motion_steps(motion) > 0:
            is_outdated |= _kick_and_drift(k, arrays, positions, work, motion, n_made)
        else:
            scatter(k, arrays.clusters, work, forces)
    if is_mixed(arrays):
        net[domain, 0], net[domain, 1], net[domain, 2] = x, y, z
    return is_outdated


@scalar
def _end_mixed_step(domain, arrays, positions, forces, work, motion, n_made):
    """forces −= Σ F / N, if finite: the net force of pairs is only rounding, and without it momentum is conserved. Then the atoms move."""
    clusters, net, n_lanes, is_outdated = arrays.clusters, arrays.memory.net, count(arrays.clusters.lanes), False
    x = y = z = 0.0
    for d in range(net.shape[0]):
        x, y, z = x + net[d, 0], y + net[d, 1], z + net[d, 2]
    if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
        x = y = z = 0.0
    x, y, z = x / forces.shape[0], y / forces.shape[0], z / forces.shape[0]
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        for lane in range(clusters.filled[k]):
            i = clusters.atom[k * n_lanes + lane]
            forces[i, 0], forces[i, 1], forces[i, 2] = forces[i, 0] - x, forces[i, 1] - y, forces[i, 2] - z
            if motion_steps(motion) > 0:
                work[lane], work[n_lanes + lane], work[2 * n_lanes + lane] = forces[i, 0], forces[i, 1], forces[i, 2]
                forces[i, 0] = forces[i, 1] = forces[i, 2] = 0.0
        if motion_steps(motion) > 0:
            is_outdated |= _kick_and_drift(k, arrays, positions, work, motion, n_made)
    return is_outdated


@by_type
def _kick_and_drift(k, arrays, positions, block, motion, n_made):
    """The atoms of cluster k move, and its ghosts with them. True if the list is outdated then.

    block : (3 n,), the forces on the atoms; afterwards their positions.
    """
    if motion.instance_class is Rest:
        return lambda k, arrays, positions, block, motion, n_made: False

    def move(k, arrays, positions, block, motion, n_made):
        clusters, n_lanes = arrays.clusters, count(arrays.clusters.lanes)
        durations, last = motion.durations[(motion.first + n_made) % motion.durations.shape[0]], clusters.filled[k] - 1
        for lane in range(n_lanes):
            i = clusters.atom[k * n_lanes + lane]
            if lane <= last:  # not padding
                kick_atom(i, motion.velocities, (block[lane], block[n_lanes + lane], block[2 * n_lanes + lane]), motion.inverse_masses, durations[0])
                drift_atom(i, positions, motion.velocities, durations[1])
            for c in range(3):
                block[c * n_lanes + lane] = positions[i, c]
        place(k, arrays, block)
        return not are_near(k, clusters, block, motion.limit2)

    return move
