"""The kernel of pair laws on the cluster list: the forces of a state, or many kicks and drifts with forces in between, on a pool of threads."""

from collections import namedtuple

import numpy as np

from minimd.compiled.kernels import by_type, scalar, shared_kernel
from minimd.compiled.simd import bits_from_mask, lane, load, store, total
from minimd.compiled.simd.lanes import count
from minimd.compiled.threads import barrier, begin, finish_and_take, stop, take, was_stopped
from minimd.forces.cluster_loop import add_cluster_forces
from minimd.integrators.splitting.splitting import drifted, kicked
from minimd.neighbors.cluster_list import clear, collected, gather, is_mixed, place
from minimd.neighbors.clusters import DIMENSIONS, gathered, loaded


class Rest(namedtuple("Rest", "")):
    """No motion: the forces are evaluated once."""


class Motion(namedtuple("Motion", "durations first n limit2 velocities inverse_masses own_positions own_velocities own_inverse_masses")):
    """n kicks and drifts, each kick after an evaluation of the forces; only an evaluation if n is 0.

    durations : (P, 2) of P kicks and drifts, in turn from the first [time].
    limit2 : square of the distance that an atom may be from where it was when the list was built [length²].
    velocities : (N, 3) [length/time].  inverse_masses : (N,) [1/mass].
    own_positions, own_velocities, own_inverse_masses : flat, a block for each cluster: the atoms in the order of the clusters. They are read
        at the start and written back at the end. So no two threads write to the same cache line, and vectors of atoms move at a time.
    """


@shared_kernel
def evaluate_clusters(worker, task, positions, arrays, laws, sums, forces, motion):
    """forces (N, 3) += those of all laws; or, with a Motion that has n > 0, atoms move. Each domain is a chunk.

    Returns how many kicks and drifts were made: fewer than n if the list is outdated then, or positions are not finite.

    positions : (N, 3) [length].  arrays : ClusterArrays.  laws : tuple of pairs, a law type and its parameters, SameForAll or ByLane.
    sums : Sums or ForceSums.  motion : Motion or Rest.
    """
    n, n_moves, n_made = arrays.domain_start.size - 1, moves(motion), 0
    phase = begin(worker, task)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        _begin(chunk, arrays, positions, motion)
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)
    while True:
        chunk = take(worker, phase, n)
        while chunk >= 0:
            clear(chunk, arrays)
            _add_all(chunk, arrays, laws, sums)
            chunk = finish_and_take(worker, phase, n)
        phase = barrier(worker, phase)
        if is_mixed(arrays):
            chunk = take(worker, phase, n)
            while chunk >= 0:
                _sum_forces(chunk, arrays)
                chunk = finish_and_take(worker, phase, n)
            phase = barrier(worker, phase)
        excess = _excess(arrays, forces)
        chunk = take(worker, phase, n)
        while chunk >= 0:
            if n_moves == 0:
                _scatter(chunk, arrays, excess, forces)
            elif not _move(chunk, arrays, excess, motion, n_made):
                stop(worker, phase)
            chunk = finish_and_take(worker, phase, n)
        moved, phase = phase, barrier(worker, phase)
        n_made += 1
        if n_made >= n_moves or was_stopped(worker, moved):
            break
    if n_moves > 0:
        chunk = take(worker, phase, n)
        while chunk >= 0:
            _end(chunk, arrays, positions, motion)
            chunk = finish_and_take(worker, phase, n)
        barrier(worker, phase)
    return n_made


@by_type
def moves(motion):
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


@by_type
def _begin(domain, arrays, positions, motion):
    """Positions of the atoms of a domain to all their ghosts; of a Motion also its own arrays."""
    if motion.instance_class is Rest:
        return lambda domain, arrays, positions, motion: _place_all(domain, arrays, positions)

    def begin_motion(domain, arrays, positions, motion):
        if motion.n == 0:
            _place_all(domain, arrays, positions)
            return
        clusters, n_lanes = arrays.clusters, count(arrays.clusters.lanes)
        for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
            start = k * DIMENSIONS * n_lanes
            gather(k, clusters, positions, motion.own_positions, start)
            gather(k, clusters, motion.velocities, motion.own_velocities, start)
            place(k, arrays, loaded(motion.own_positions, start, clusters.lanes))
            for slot in range(k * n_lanes, (k + 1) * n_lanes):
                motion.own_inverse_masses[slot] = motion.inverse_masses[clusters.atom[slot]]

    return begin_motion


@scalar
def _place_all(domain, arrays, positions):
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        place(k, arrays, gathered(k, arrays.clusters, positions))


@scalar
def _sum_forces(domain, arrays):
    """The net force on the atoms of a domain: without padding, on which no forces act."""
    net, x, y, z = arrays.memory.net, 0.0, 0.0, 0.0
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        fx, fy, fz = collected(k, arrays)
        x, y, z = x + total(fx), y + total(fy), z + total(fz)
    net[domain, 0], net[domain, 1], net[domain, 2] = x, y, z


@scalar
def _excess(arrays, forces):
    """Σ F / N (x, y, z) in mixed precision, if finite; else 0. The net force of pairs is only rounding; without it momentum is conserved."""
    net, x, y, z = arrays.memory.net, 0.0, 0.0, 0.0
    for d in range(net.shape[0]):
        x, y, z = x + net[d, 0], y + net[d, 1], z + net[d, 2]
    if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
        return 0.0, 0.0, 0.0
    return x / forces.shape[0], y / forces.shape[0], z / forces.shape[0]


@scalar
def _scatter(domain, arrays, excess, forces):
    """forces (N, 3) += those on the atoms of a domain, less the excess."""
    clusters, n_lanes = arrays.clusters, count(arrays.clusters.lanes)
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        x, y, z = collected(k, arrays)
        x, y, z, filled = x - excess[0], y - excess[1], z - excess[2], clusters.filled[k]
        for k_lane in range(n_lanes):
            if k_lane < filled:
                i = np.uintp(clusters.atom[k * n_lanes + k_lane])
                forces[i, 0] += lane(x, k_lane)
                forces[i, 1] += lane(y, k_lane)
                forces[i, 2] += lane(z, k_lane)


@by_type
def _move(domain, arrays, excess, motion, n_made):
    """The atoms of a domain move, and their ghosts with them. Returns whether the list is still valid for them."""
    if motion.instance_class is Rest:
        return lambda domain, arrays, excess, motion, n_made: True

    def move(domain, arrays, excess, motion, n_made):
        clusters, lanes, n_lanes, is_valid = arrays.clusters, arrays.clusters.lanes, count(arrays.clusters.lanes), True
        kick, drift = motion.durations[(motion.first + n_made) % motion.durations.shape[0]]
        for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
            start = k * DIMENSIONS * n_lanes
            inverse_mass = load(motion.own_inverse_masses, k * n_lanes, lanes)
            moved2 = 0.0 * inverse_mass
            for c, force in enumerate(collected(k, arrays)):
                at = start + c * n_lanes
                velocity = kicked(load(motion.own_velocities, at, lanes), force - excess[c], inverse_mass, kick)
                position = drifted(load(motion.own_positions, at, lanes), velocity, drift)
                store(motion.own_velocities, at, velocity)
                store(motion.own_positions, at, position)
                moved = position - load(clusters.positions, at, lanes)
                moved2 = moved2 + moved * moved
            is_valid &= ~bits_from_mask(moved2 <= motion.limit2) & (1 << clusters.filled[k]) - 1 == 0
            place(k, arrays, loaded(motion.own_positions, start, lanes))
        return is_valid

    return move


@by_type
def _end(domain, arrays, positions, motion):
    """Positions and velocities from the order of the clusters to that of the user."""
    if motion.instance_class is Rest:
        return lambda domain, arrays, positions, motion: None

    def end(domain, arrays, positions, motion):
        clusters, n_lanes = arrays.clusters, count(arrays.clusters.lanes)
        for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
            for k_lane in range(clusters.filled[k]):
                i = clusters.atom[k * n_lanes + k_lane]
                for c in range(3):
                    place = (k * DIMENSIONS + c) * n_lanes + k_lane
                    positions[i, c], motion.velocities[i, c] = motion.own_positions[place], motion.own_velocities[place]

    return end
