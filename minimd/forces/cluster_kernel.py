"""The kernel of pair laws on the cluster list: the forces of a state, or many kicks and drifts with forces in between, on a pool of threads."""

from collections import namedtuple

import numpy as np

from minimd.compiled.kernels import by_type, scalar, shared_kernel
from minimd.compiled.simd.lanes import count
from minimd.compiled.threads import barrier, begin, finish_and_take, is_stopped, stop, take
from minimd.forces.cluster_loop import add_cluster_forces
from minimd.integrators.splitting.splitting import drift_atom, kick_atom
from minimd.neighbors.cluster_list import gather, is_mixed, scatter
from minimd.neighbors.clusters import DIMENSIONS
from minimd.neighbors.verlet_list import has_moved


class Rest(namedtuple("Rest", "")):
    """No motion: the forces are evaluated once."""


class Motion(namedtuple("Motion", "velocities inverse_masses durations n built_at limit2")):
    """n kicks and drifts, each kick after an evaluation of the forces; only an evaluation if n is 0.

    velocities : (N, 3) [length/time].  inverse_masses : (N,) [1/mass].  durations : (P, 2) of P kicks and drifts, in turn [time].
    built_at : (N, 3) positions of the last list build.  limit2 : square of the distance from there at which the list is outdated [length²].
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
        gather(chunk, arrays, positions)
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
            scatter(chunk, arrays, forces, space)
            if not is_mixed(arrays):
                _move(chunk, arrays, positions, forces, motion, n_made, worker, task)
            chunk = finish_and_take(worker, phase, n)
        phase = barrier(worker, phase)
        if is_mixed(arrays):
            chunk = take(worker, phase, n)
            while chunk >= 0:
                _level(chunk, arrays, forces)
                _move(chunk, arrays, positions, forces, motion, n_made, worker, task)
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
def _level(domain, arrays, forces):
    """forces −= Σ F / N on the atoms of a domain, if finite. The net force of pairs is only rounding; without it momentum is conserved."""
    clusters, net, n_lanes = arrays.clusters, arrays.memory.net, count(arrays.clusters.lanes)
    x = y = z = 0.0
    for d in range(net.shape[0]):
        x, y, z = x + net[d, 0], y + net[d, 1], z + net[d, 2]
    if np.isfinite(x) and np.isfinite(y) and np.isfinite(z):
        x, y, z = x / forces.shape[0], y / forces.shape[0], z / forces.shape[0]
        for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
            for slot in range(k * n_lanes, k * n_lanes + clusters.filled[k]):
                i = clusters.atom[slot]
                forces[i, 0], forces[i, 1], forces[i, 2] = forces[i, 0] - x, forces[i, 1] - y, forces[i, 2] - z


@by_type
def _move(domain, arrays, positions, forces, motion, n_made, worker, task):
    """Kick and drift the atoms of a domain, and set their forces to zero; with Rest nothing. Stops the task if the list is outdated then."""
    if motion.instance_class is Rest:
        return lambda domain, arrays, positions, forces, motion, n_made, worker, task: None

    def move(domain, arrays, positions, forces, motion, n_made, worker, task):
        if motion.n > 0 and _kick_and_drift(domain, arrays, positions, forces, motion, motion.durations[n_made % motion.durations.shape[0]]):
            stop(worker, task)

    return move


@scalar
def _kick_and_drift(domain, arrays, positions, forces, motion, durations):
    """See _move; true if an atom is farther from where the list was built than it may be, or nowhere."""
    clusters, n_lanes, is_outdated = arrays.clusters, count(arrays.clusters.lanes), False
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        for slot in range(k * n_lanes, k * n_lanes + clusters.filled[k]):
            i = clusters.atom[slot]
            kick_atom(i, motion.velocities, forces, motion.inverse_masses, durations[0])
            drift_atom(i, positions, motion.velocities, durations[1])
            forces[i, 0] = forces[i, 1] = forces[i, 2] = 0.0
            is_outdated |= has_moved(i, positions, motion.built_at, motion.limit2)
    gather(domain, arrays, positions)
    return is_outdated
