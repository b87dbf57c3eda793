"""The kernel of pair laws on the cluster list: the forces of a state, or many kicks and drifts with forces in between,
on a pool of threads."""

from collections import namedtuple

import numpy as np

from minimd.compiled.by_address import ByAddress
from minimd.compiled.call_by_address import run_at
from minimd.compiled.fixed_point import MOST, is_fixed
from minimd.compiled.kernels import by_type, scalar, shared_kernel
from minimd.compiled.simd import bits_from_mask, lane, load, store, total
from minimd.compiled.simd.lanes import count
from minimd.compiled.threads import barrier, begin, finish_and_take, stop, take, was_stopped
from minimd.forces.cluster_loop import lanes_beyond
from minimd.integrators.splitting.flows import (
    drifted,
    drifted_on_grid,
    kicked,
    kicked_on_grid,
    mixed,
    momentum_in_steps,
    velocity_of,
)
from minimd.neighbors.cluster_list import clear, collected, gather, is_mixed, place
from minimd.neighbors.clusters import DIMENSIONS, gathered, loaded
from minimd.neighbors.domains import LATE
from minimd.structure.observables import kinetic_energy_of


class Loop(namedtuple("Loop", "add prepare work")):
    """What differs from law to law, which is compiled apart:
    so that the kernels of this file are the same for all laws.

    add, prepare : addresses of add_forces_of_laws and, if the loop needs it after a list build, of prepare_loop,
        else 0.
    work : address of their Work.
    """


class Contacts(ByAddress, namedtuple("Contacts", "kept spread duration noise masses before after energy")):
    """Contacts with a bath, each followed by a drift, after each kick and drift:
    see Contact in integrators.splitting.state.

    noise : (n, N, 3), of kick and drift k in row k; n is 0 if there is no bath.  masses : (N,).
    before, after : (N,) output, kinetic energies of the atoms, of the last contact [energy].
    energy : (1,), to which is added what each contact gives to the atoms [energy].
    """


class Atoms(
    ByAddress,
    namedtuple("Atoms", "velocities inverse_masses mass_step own_positions own_velocities own_inverse_masses"),
):
    """What moves beside the positions.  velocities : (N, 3) [length/time].  inverse_masses : (N,) [1/mass].

    mass_step : how far apart those of neighboring slots are in own_inverse_masses: 0 if all are the same,
        so that a vector of them is enough.
    own_positions, own_velocities, own_inverse_masses : flat, a block for each cluster: the atoms in the order of the
        clusters. They are read at the start of a Motion and written back at its end. So no two threads write to the
        same cache line, and vectors of atoms move at a time. In fixed-point arithmetic own_velocities holds momenta,
        in steps.
    """


class Motion(ByAddress, namedtuple("Motion", "steps durations course contacts atoms")):
    """Kicks and drifts, each kick after an evaluation of the forces; only an evaluation if none is to be made.

    steps : Steps of fixed-point arithmetic, or ().
    durations : (P, 2, 2) of P kicks and drifts, in turn from the first,
        and the times of which they are whole multiples [time].
    course : (2,) int, how many were made before, and how many there are to be in all.  contacts : Contacts.  atoms :
        Atoms.
    """


MADE, TO_MAKE = 0, 1  # places in a course


@shared_kernel
def evaluate_clusters(worker, task, positions, arrays, loop, forces, motion):
    """forces (N, 3) += those of all laws; or, with a Motion that is not at its end, atoms move. Each domain is a chunk.

    Returns how many kicks and drifts were made: fewer than are left if the list is outdated then,
    or positions are not finite.

    positions : (N, 3) [length].  arrays : ClusterArrays.  loop : Loop.  motion : Motion.
    """
    n, n_moves, n_made, n_late = arrays.domain_start.size - 1, moves(motion), 0, arrays.domains.numbers[LATE]
    phase = begin(worker, task)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        _begin(chunk, arrays, positions, motion)
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)
    while True:
        chunk, is_valid = take(worker, phase, n), True
        while chunk >= 0:
            clear(chunk, arrays)
            run_at(loop.add, (chunk, arrays, loop.work, motion.steps, which_kick(motion, n_made)))
            if chunk >= n_late and not _finish(
                chunk, arrays, (0.0, 0.0, 0.0), forces, motion, n_made
            ):  # on one thread: while it is in the cache
                is_valid = False
            chunk = finish_and_take(worker, phase, n)
        phase = barrier(worker, phase)
        if is_mixed(arrays):
            chunk = take(worker, phase, n)
            while chunk >= 0:
                _sum_forces(chunk, arrays)
                chunk = finish_and_take(worker, phase, n)
            phase = barrier(worker, phase)
        excess, is_in_range = _excess(arrays, forces), are_in_range(arrays, motion.steps)
        chunk = take(worker, phase, n_late)
        while chunk >= 0:
            if not (is_in_range and _finish(chunk, arrays, excess, forces, motion, n_made) and is_valid):
                stop(worker, phase)
            chunk = finish_and_take(worker, phase, n_late)
        moved, phase = phase, barrier(worker, phase)
        if has_bath(motion):
            chunk = take(worker, phase, 1)
            while chunk >= 0:
                count_energy(motion.contacts)
                chunk = finish_and_take(worker, phase, 1)
            phase = barrier(worker, phase)
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


@scalar
def _finish(domain, arrays, excess, forces, motion, n_made):
    """What is done with the forces on the atoms of a domain, once they are whole: they are handed over,
    or the atoms move. See _move."""
    if moves(motion) == 0:
        _scatter(domain, arrays, excess, forces)
        return True
    return _move(domain, arrays, excess, motion, n_made)


@scalar
def moves(motion):
    """The number of kicks and drifts that are left of a Motion."""
    return motion.course[TO_MAKE] - motion.course[MADE]


@scalar
def has_bath(motion):
    """Whether atoms of a Motion are in contact with a bath."""
    return motion.contacts.noise.shape[0] > 0


@scalar
def count_energy(contacts):
    """energy += Σ after − Σ before, in the order of the user, as kinetic_energy has it."""
    before, after = 0.0, 0.0
    for i in range(contacts.before.size):
        before += contacts.before[i]
        after += contacts.after[i]
    contacts.energy[0] += after - before


@scalar
def which_kick(motion, n_made):
    """The number of the next kick in the cycle."""
    return (motion.course[MADE] + n_made) % motion.durations.shape[0]


@by_type
def are_in_range(arrays, steps):
    """Whether all forces are in the range of fixed-point arithmetic."""
    if not is_fixed(steps):
        return lambda arrays, steps: True

    def of_all_domains(arrays, steps):
        answer = True
        for d in range(arrays.memory.net.shape[0]):
            answer &= arrays.memory.net[d, 0] == 0.0
        return answer

    return of_all_domains


@scalar
def _begin(domain, arrays, positions, motion):
    """Positions of the atoms of a domain to all their ghosts, and to own_positions if there is a Motion."""
    clusters, n_lanes, is_in_motion = arrays.clusters, count(arrays.clusters.lanes), moves(motion) > 0
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        place(k, arrays, gathered(k, clusters, positions))
        if is_in_motion:
            start = k * DIMENSIONS * n_lanes
            gather(k, clusters, positions, motion.atoms.own_positions, start)
            gather(k, clusters, motion.atoms.velocities, motion.atoms.own_velocities, start)
            if motion.atoms.mass_step > 0:
                for slot in range(k * n_lanes, (k + 1) * n_lanes):
                    motion.atoms.own_inverse_masses[slot] = motion.atoms.inverse_masses[clusters.atom[slot]]
            _to_momenta(k, start, n_lanes, motion, motion.steps)


@by_type
def _to_momenta(k, start, n_lanes, motion, steps):
    """In fixed-point arithmetic: own velocities of cluster k become momenta."""
    if not is_fixed(steps):
        return lambda k, start, n_lanes, motion, steps: None

    def to_momenta(k, start, n_lanes, motion, steps):
        for at in range(start, start + DIMENSIONS * n_lanes):
            inverse_mass = motion.atoms.own_inverse_masses[
                (k * n_lanes + (at - start) % n_lanes) * motion.atoms.mass_step
            ]
            motion.atoms.own_velocities[at] = momentum_in_steps(motion.atoms.own_velocities[at], inverse_mass, steps)

    return to_momenta


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
    """Σ F / N (x, y, z) in mixed precision, if finite; else 0.

    The net force of pairs is only rounding; without it momentum is conserved.
    """
    net, x, y, z = arrays.memory.net, 0.0, 0.0, 0.0
    for d in range(net.shape[0] if is_mixed(arrays) else 0):
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


@scalar
def _move(domain, arrays, excess, motion, n_made):
    """The atoms of a domain move, and their ghosts with them. Returns whether the list is still valid for them."""
    clusters, lanes, n_lanes, is_valid = arrays.clusters, arrays.clusters.lanes, count(arrays.clusters.lanes), True
    flows, limit2 = of_cycle(motion, which_kick(motion, n_made)), arrays.rows.limits2[arrays.rows.layers[0] - 1]
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        start = k * DIMENSIONS * n_lanes
        inverse_mass = load(motion.atoms.own_inverse_masses, k * n_lanes * motion.atoms.mass_step, lanes)
        for c, force in enumerate(collected(k, arrays)):
            at = start + c * n_lanes
            velocity, position = (
                load(motion.atoms.own_velocities, at, lanes),
                load(motion.atoms.own_positions, at, lanes),
            )
            velocity, position = _moved(velocity, position, force - excess[c], inverse_mass, flows, motion.steps)
            store(motion.atoms.own_velocities, at, velocity)
            store(motion.atoms.own_positions, at, position)
        if has_bath(motion):
            for k_lane in range(clusters.filled[k]):
                _touch(
                    clusters.atom[k * n_lanes + k_lane], start + k_lane, n_lanes, motion, motion.course[MADE] + n_made
                )
        moved2 = size2 = 0.0 * inverse_mass
        for c in range(DIMENSIONS):
            at = start + c * n_lanes
            velocity, position = (
                load(motion.atoms.own_velocities, at, lanes),
                load(motion.atoms.own_positions, at, lanes),
            )
            moved = position - load(clusters.positions, at, lanes)
            moved2 = moved2 + moved * moved
            size2 = size2 + velocity * velocity
        filled = (1 << clusters.filled[k]) - 1
        is_valid &= ~bits_from_mask(moved2 <= limit2) & filled == 0
        if lanes_beyond(size2, _most_momentum2(motion.steps)) & filled:
            arrays.memory.net[domain, 1], is_valid = 1.0, False
        place(k, arrays, loaded(motion.atoms.own_positions, start, lanes))
    return is_valid


@scalar
def _touch(i, place, n_lanes, motion, row):
    """Contact of atom i with the bath, and its second drift.  place : of its x in its own arrays.  row :
    of the noise."""
    contacts, at, v = motion.contacts, motion.atoms.own_positions, motion.atoms.own_velocities
    mass, y, z = contacts.masses[i], place + n_lanes, place + 2 * n_lanes
    scale = contacts.spread * np.sqrt(motion.atoms.inverse_masses[i])
    contacts.before[i] = kinetic_energy_of(mass, v[place], v[y], v[z])
    for c in range(DIMENSIONS):
        slot = place + c * n_lanes
        v[slot] = mixed(v[slot], contacts.noise[row, i, c], contacts.kept, scale)
        at[slot] = drifted(at[slot], v[slot], contacts.duration)
    contacts.after[i] = kinetic_energy_of(mass, v[place], v[y], v[z])


@scalar
def of_cycle(motion, k):
    """Durations of kick and drift k of the cycle [time], how many units they have, and the unit of the drift [time]."""
    kick, drift, kick_unit, unit = (
        motion.durations[k, 0, 0],
        motion.durations[k, 1, 0],
        motion.durations[k, 0, 1],
        motion.durations[k, 1, 1],
    )
    return kick, drift, np.rint(kick / kick_unit), np.rint(drift / unit), unit


@by_type
def _moved(velocity, position, force, inverse_mass, flows, steps):
    """Velocity and position after a kick and a drift.  flows : see of_cycle.

    In fixed-point arithmetic momentum, and force is an impulse.
    """
    if not is_fixed(steps):

        def moved(velocity, position, force, inverse_mass, flows, steps):
            velocity = kicked(velocity, force, inverse_mass, flows[0])
            return velocity, drifted(position, velocity, flows[1])

        return moved

    def moved_on_grid(velocity, position, force, inverse_mass, flows, steps):
        momentum = kicked_on_grid(velocity, force, inverse_mass, flows[2])
        return momentum, drifted_on_grid(position, momentum, inverse_mass, flows[4], flows[3], steps)

    return moved_on_grid


@by_type
def _most_momentum2(steps):
    """The square of the largest momentum, in fixed-point arithmetic; () without it."""
    return (lambda steps: MOST * MOST) if is_fixed(steps) else lambda steps: ()


@scalar
def _end(domain, arrays, positions, motion):
    """Positions and velocities from the order of the clusters to that of the user."""
    clusters, atoms, n_lanes = arrays.clusters, motion.atoms, count(arrays.clusters.lanes)
    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        for k_lane in range(clusters.filled[k]):
            slot = k * n_lanes + k_lane
            i, inverse_mass = clusters.atom[slot], atoms.own_inverse_masses[slot * atoms.mass_step]
            for c in range(3):
                place = (k * DIMENSIONS + c) * n_lanes + k_lane
                positions[i, c] = atoms.own_positions[place]
                atoms.velocities[i, c] = _velocity(atoms.own_velocities[place], inverse_mass, motion.steps)


@by_type
def _velocity(velocity, inverse_mass, steps):
    """A velocity; in fixed-point arithmetic of a momentum in steps."""
    if is_fixed(steps):
        return lambda velocity, inverse_mass, steps: velocity_of(velocity, inverse_mass, steps)
    return lambda velocity, inverse_mass, steps: velocity
