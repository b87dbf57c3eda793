"""The vector loop over clusters: the same pair laws as pair_loop, applied to all lanes of a vector at a time.

Atoms near each other form clusters, of as many as there are lanes; see neighbors.clusters for the picture. A row
belongs to one atom i and lists the clusters j with atoms within its reach.
Lanes that do not count are infinitely far from it, see Memory.far.
"""

from collections import namedtuple

import numpy as np
from numba import types

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import BIAS, biased_product, in_steps, is_fixed, on_grid
from minimd.core.compiled.kernels import by_type, called_kernel, scalar
from minimd.core.compiled.simd import (
    bits_from_mask,
    broadcast,
    fma,
    load,
    select,
    store,
    total,
    zeros,
)
from minimd.core.compiled.simd.vector import count, loaded, loaded_columns
from minimd.core.neighbors.cluster_search import GHOST_BITS, LANES_FROM
from minimd.core.neighbors.clusters import DIMENSIONS
from minimd.core.neighbors.domains import GHOSTS
from minimd.core.potentials.law import evaluate_law
from minimd.core.potentials.pair_loop import SameForAll, with_product, with_slopes
from minimd.core.potentials.term import PER_ATOM

SUMS = 7  # accumulators: an energy, and a virial as xx yy zz yz xz xy
# rows of accumulators from domain to domain: so no two threads write to the same line of the cache
APART = 2


class ByLane(ByAddress, namedtuple("ByLane", "columns species slots table of_atoms")):
    """Parameters by species, laid out for lanes.

    columns : tuple of (S · slots,) arrays; element a · slots + s is the parameter of the atom in slot s with species a.
    species : (slots,) int.
    slots : number of slots, ghosts included, for which there is room.
    table : (S, S, 1 + P) parameters of pairs of species.
    of_atoms : (N,) int, species of the atoms.
    """


class ChargesByLane(ByAddress, namedtuple("ChargesByLane", "of_slots of_atoms source")):
    """The product of charges, and what another source has.

    of_slots : (slots,), those of of_atoms (N,) [√(energy · length)].
    source : SameForAll or ByLane.
    """


class SlopesByLane(ByAddress, namedtuple("SlopesByLane", "of_slots source")):
    """The slopes of both atoms, and what another source has.

    of_slots : (slots,), those of embedded atoms [energy/density], written by a pass before the forces, see embedding.
    source : SameForAll or ByLane.
    """


class TwoKindsOfRows(ByAddress, namedtuple("TwoKindsOfRows", "full bare is_bare")):
    """Charges beside another law, which is zero for all pairs of some species, as of the hydrogens of water: their rows
    are bare.

    full : ChargesByLane, whose source is ByLane.
    bare : ChargesByLane for the law of charges alone.
    is_bare : (S,) bool, by species.
    """


@by_type
def parameters_of_lanes(source, slot, cluster, lanes):
    """Parameters of pairs of the atom in a slot with the lanes of a cluster: numbers, or vectors if species differ."""
    if source.instance_class is SameForAll:
        return lambda source, slot, cluster, lanes: source.numbers
    if source.instance_class is ChargesByLane:
        return lambda source, slot, cluster, lanes: with_product(
            parameters_of_lanes(source.source, slot, cluster, lanes),
            load(source.of_slots, cluster * count(lanes), lanes) * source.of_slots[slot],
        )
    if source.instance_class is SlopesByLane:
        return lambda source, slot, cluster, lanes: with_slopes(
            parameters_of_lanes(source.source, slot, cluster, lanes),
            source.of_slots[slot],
            load(source.of_slots, cluster * count(lanes), lanes),
        )

    return lambda source, slot, cluster, lanes: loaded_columns(
        source.columns, source.species[slot] * source.slots + cluster * count(lanes), lanes
    )


class Sums(ByAddress, namedtuple("Sums", "forces of_rows of_lanes detail")):
    """The accumulators of the loop.

    forces : flat, a block for each ghost in a window, see Domains.place, of the type of the pair arithmetic
        [energy/length]; in fixed-point arithmetic int64 impulses.
    of_rows : (n, SUMS) [energy], with PER_ATOM of the atom of each row, (slots, SUMS), else of each domain, APART.
    of_lanes : flat, SUMS · n numbers for each ghost of each window, of the lanes; empty unless PER_ATOM.
    detail : TOTALS or PER_ATOM, see term.
    """


class TotalSums(Sums):
    """Accumulators for TOTALS: a type of its own, for which the virial is not summed pair by pair, see add_virial."""


class ForceSums(Sums):
    """Accumulators of forces only: a type of its own, for which the compiler leaves out energies and virials."""


@by_type
def with_energy(sums):
    """Whether energies are wanted, as a constant for the compiler."""
    answer = sums.instance_class is not ForceSums
    return lambda sums: answer


@by_type
def by_pair(sums, steps):
    """Whether the virial is the sum of those of all pairs, as a constant: each rounded in fixed-point arithmetic, so
    that the sum is the same for any list."""
    answer = sums.instance_class is Sums or (sums.instance_class is TotalSums and is_fixed(steps))
    return lambda sums, steps: answer


@by_type
def looks_ahead(vector, parameters):
    """Whether the loop computes separations one entry ahead, so that the processor has work while it waits for the law.

    It does with vectors of 512 bits: processors that have them have the 32 registers it needs, and gain a twentieth. So
    do embedded atoms, whose law takes long.
    """
    is_long = parameters.instance_class is SlopesByLane
    answer = is_long or vector.lanes * vector.element.bitwidth == 512
    return lambda vector, parameters: answer


class LoopWork(ByAddress, namedtuple("LoopWork", "laws sums")):
    """What the loop does.

    laws : tuple of (law type, its parameters, see add_cluster_forces).
    sums : Sums, TotalSums or ForceSums.
    """


@called_kernel
def add_forces_of_laws(domain, arrays, work, steps):
    """add_cluster_forces for each law of a Work; its energies and virials begin with zero."""
    _start_energies(domain, arrays, work.sums)
    _add_forces_of(domain, arrays, work.laws, work.sums, steps)
    add_virial(domain, arrays, work.sums, steps)


@by_type
def add_virial(domain, arrays, sums, steps):
    """The virial of a domain, from the forces on all ghosts in its window, whose sum is zero:

        W = Σ_pairs f r_ij ⊗ r_ij = Σ_ghosts F ⊗ (r − r₀)

    r₀, any point near by, keeps rounding errors small.
    """
    if sums.instance_class is not TotalSums or is_fixed(steps):
        return lambda domain, arrays, sums, steps: None

    def add(domain, arrays, sums, steps):
        domains = arrays.domains
        memory = arrays.memory
        lanes = arrays.clusters.lanes
        n_lanes = count(lanes)
        start = arrays.domain_start[domain]
        if start == arrays.domain_start[domain + 1]:
            return
        block = DIMENSIONS * n_lanes
        first = domains.first[domain]
        place = domains.place[domain]
        at = arrays.ghosts.home[start] * block
        x0 = memory.coordinates[at]
        y0 = memory.coordinates[at + n_lanes]
        z0 = memory.coordinates[at + 2 * n_lanes]
        _, virial = _none_of(zeros(lanes))

        for k in range(domains.window[domain + 1] - domains.window[domain]):
            x, y, z = loaded(memory.coordinates, (first + k) * block, lanes)
            force = loaded(sums.forces, (place + k) * block, lanes)
            virial = plus_virials(force, (x - x0, y - y0, z - z0), virial, steps)

        for c, w in enumerate(virial):
            sums.of_rows[APART * domain, 1 + c] += total(w)

    return add


@by_type
def _start_energies(domain, arrays, sums):
    """Energies and virials of a domain = 0, where they are wanted."""
    if sums.instance_class is ForceSums:
        return lambda domain, arrays, sums: None

    def start(domain, arrays, sums):
        if sums.detail != PER_ATOM:
            sums.of_rows[APART * domain] = 0.0
            return
        window = arrays.domains.window
        first, last = slots_of(domain, arrays)
        sums.of_rows[first:last] = 0.0
        n_sums = SUMS * count(arrays.clusters.lanes)
        sums.of_lanes[window[domain] * n_sums : window[domain + 1] * n_sums] = 0.0

    return start


@by_type
def _add_forces_of(domain, arrays, laws, sums, steps):
    """Unrolled by the compiler."""
    if len(laws) == 0:
        return lambda domain, arrays, laws, sums, steps: None

    def add(domain, arrays, laws, sums, steps):
        add_cluster_forces(domain, arrays, laws[0][0], laws[0][1], sums, steps)
        _add_forces_of(domain, arrays, laws[1:], sums, steps)

    return add


@scalar
def add_cluster_forces(domain, arrays, law, parameters, sums, steps):
    """Forces between the atoms of a domain and the clusters of their rows.

        r_ij = r_j − r_i,   f = −u′(r)/r,   F_j += f r_ij,   F_i −= Σ f r_ij,   W += f r_ij ⊗ r_ij

    arrays : ClusterArrays.
    law : law type.
    parameters : SameForAll, ByLane, ChargesByLane, SlopesByLane or TwoKindsOfRows.
    sums : with TOTALS each pair is added to the domain, with PER_ATOM half of it to each atom.
    steps : () or, in fixed-point arithmetic, Steps.
    """
    rows = arrays.rows
    memory = arrays.memory
    lanes = arrays.clusters.lanes
    n_lanes = count(lanes)
    first = arrays.domains.first[domain]
    block = DIMENSIONS * n_lanes
    coordinates = memory.coordinates[first * block :]  # of this window, as the forces
    forces = sums.forces[arrays.domains.place[domain] * block :]
    window = first, coordinates, memory.far, forces
    stops = rows.stops[rows.layers[0] - 1]
    zero = zeros(lanes)
    energy, virial = _none_of(zero)
    first_slot, last_slot = slots_of(domain, arrays)
    for slot in range(first_slot, last_slot):
        if rows.start[slot] == stops[slot] and not with_energy(sums):
            continue  # in a gas many rows are empty
        home = arrays.ghosts.home[slot // n_lanes] - first
        lane = slot % n_lanes
        place = home * block + lane
        x, y, z = coordinates[place], coordinates[place + n_lanes], coordinates[place + 2 * n_lanes]
        at = broadcast(x, zero), broadcast(y, zero), broadcast(z, zero)
        entries = rows.entries, np.uintp(rows.start[slot]), np.uintp(stops[slot])
        row = (first + home) * n_lanes + lane, at, entries, arrays.domains.window[domain]
        pull, size2, energy, virial = added_row(
            law, parameters, row, window, sums, steps, (energy, virial)
        )
        _give_back(forces, place, pull, stops[slot] - rows.start[slot], lanes)
        if lanes_beyond(size2, steps):
            memory.is_out[domain] = 1
        if with_energy(sums) and (sums.detail == PER_ATOM or lane == n_lanes - 1):
            _book(sums, slot if sums.detail == PER_ATOM else APART * domain, energy, virial, steps)
            energy, virial = _none_of(zero)


@by_type
def added_row(law, parameters, row, window, sums, steps, so_far):
    """See _added_row; of two kinds of rows those that are bare have a simpler law."""
    if parameters.instance_class is not TwoKindsOfRows:
        return lambda law, parameters, row, window, sums, steps, so_far: _added_row(
            law, parameters, row, window, sums, steps, so_far
        )

    def either(law, parameters, row, window, sums, steps, so_far):
        if parameters.is_bare[parameters.full.source.species[row[0]]]:
            return _added_row(law.charges, parameters.bare, row, window, sums, steps, so_far)
        return _added_row(law, parameters.full, row, window, sums, steps, so_far)

    return either


@scalar
def _added_row(law, parameters, row, window, sums, steps, so_far):
    """The entries of a row: forces are added to the ghosts; returned are Σ f r_ij, its square where forces are watched,
    and energy and virial.

    row : slot of the atom among those of the ghosts; its position; entries, the first and that behind the last; the
        first ghost of the window among those of all windows.
    window : its first ghost, coordinates, far of Memory, forces.
    so_far : energy and virial before.
    Indices in the loop are unsigned: the compiler need not check for those that count from the end.
    """
    own_slot, at, (entries, start, stop), first_of_all = row
    first, coordinates, far, forces = window
    energy, virial = so_far
    lanes = at[0]
    nothing = broadcast(0, load(forces, 0, lanes))
    zero = broadcast(0.0, lanes)
    scale = scale_of(steps, zero)
    after = entries[start]
    ahead = separations(coordinates, far, after, at, lanes)
    fx = fy = fz = nothing
    size2 = zero
    for entry in range(start, stop):
        if looks_ahead(nothing, parameters):
            now = after
            dx, dy, dz, r2 = ahead
            after = entries[entry + np.uintp(1)]
            ahead = separations(coordinates, far, after, at, lanes)
        else:
            now = entries[entry]
            dx, dy, dz, r2 = separations(coordinates, far, now, at, lanes)
        ghost = np.uintp(now & GHOST_BITS)
        numbers = parameters_of_lanes(parameters, own_slot, first + np.intp(ghost), lanes)
        near = r2 < numbers[0]
        u, f = evaluate_law(law, r2, numbers[1:])
        f = select(near, f, 0.0)
        g = as_impulse(f, scale)
        size2 = summed_squares(g, size2, steps)
        fx = plus_product(g, dx, fx)
        fy = plus_product(g, dy, fy)
        fz = plus_product(g, dz, fz)
        push(forces, ghost, g, (dx, dy, dz))
        if with_energy(sums):
            u = in_steps(select(near, u, 0.0), steps)
            energy = energy + u
        if by_pair(sums, steps):
            pull = f * dx, f * dy, f * dz
            virial = plus_virials(pull, (dx, dy, dz), virial, steps)
            if sums.detail == PER_ATOM:
                _share(sums, first_of_all + np.intp(ghost), u, pull, (dx, dy, dz), steps, lanes)

    return (fx, fy, fz), size2, energy, virial


@scalar
def slots_of(domain, arrays):
    """The first slot of a domain, and the one behind its last."""
    n_lanes = count(arrays.clusters.lanes)
    return arrays.domain_start[domain] * n_lanes, arrays.domain_start[domain + 1] * n_lanes


@scalar
def _none_of(zero):
    """Energy and virial before the first pair."""
    return zero, (zero, zero, zero, zero, zero, zero)


@scalar
def _give_back(forces, place, sums, n_entries, lanes):
    """F_i −= Σ f r_ij, of all lanes."""
    n_lanes = count(lanes)
    fx, fy, fz = sums
    forces[place] -= without_bias(total(fx), n_entries, lanes)
    forces[place + n_lanes] -= without_bias(total(fy), n_entries, lanes)
    forces[place + 2 * n_lanes] -= without_bias(total(fz), n_entries, lanes)


@scalar
def _share(sums, ghost, u, force, separation, steps, lanes):
    """Half of the energy and virial of pairs to the lanes of a ghost."""
    n_lanes = count(lanes)
    fx, fy, fz = force
    dx, dy, dz = separation
    for c, w in enumerate((u, fx * dx, fy * dy, fz * dz, fy * dz, fx * dz, fx * dy)):
        at = (ghost * SUMS + c) * n_lanes
        so_far = load(sums.of_lanes, at, lanes)
        store(sums.of_lanes, at, so_far + 0.5 * in_steps(w, steps))


@scalar
def _book(sums, k, energy, virial, steps):
    """Energy and, where it is summed by pairs, virial of all lanes to row k; with PER_ATOM the half of atom i."""
    share = 0.5 if sums.detail == PER_ATOM else 1.0
    sums.of_rows[k, 0] += share * total(energy)
    if by_pair(sums, steps):
        for c, w in enumerate(virial):
            sums.of_rows[k, 1 + c] += share * total(w)


@scalar
def separations(coordinates, far, entry, at, lanes):
    """r_j − r_i = (dx, dy, dz) and r² from a position to the lanes of an entry, ∞ for those that do not count [length].

    coordinates : of the ghosts in the window.
    far : of Memory.
    """
    n_lanes = np.uintp(count(lanes))
    x = np.uintp(entry & GHOST_BITS) * np.uintp(DIMENSIONS) * n_lanes
    y = x + n_lanes
    z = y + n_lanes
    dx = load(coordinates, x, lanes) - at[0]
    dy = load(coordinates, y, lanes) - at[1]
    dz = load(coordinates, z, lanes) - at[2]
    apart = load(far, np.uintp(entry >> LANES_FROM) * n_lanes, lanes)
    return dx, dy, dz, fma(dx, dx, fma(dy, dy, fma(dz, dz, apart)))


@by_type
def scale_of(steps, like):
    """What makes impulses of forces, in steps of momentum, in all lanes; () where forces are summed as they are."""
    if is_fixed(steps):
        return lambda steps, like: broadcast(steps.per_force[0], like)
    return lambda steps, like: ()


@by_type
def as_impulse(f, scale):
    """f = −u′/r [energy/length²], or the same as an impulse [1/length]."""
    if f == scale:
        return lambda f, scale: f * scale
    return lambda f, scale: f


@by_type
def plus_product(f, x, to):
    """to + f x, lane by lane; where it is of int64, with the product rounded to a whole number, and BIAS added,
    see without_bias."""
    if to.is_float:
        return lambda f, x, to: fma(f, x, to)
    return lambda f, x, to: to + biased_product(f, x)


@by_type
def without_bias(total, n, lanes):
    """The sum of n entries of a row on all lanes, without their biases."""
    if isinstance(total, types.Float):
        return lambda total, n, lanes: total
    return lambda total, n, lanes: total - n * count(lanes) * BIAS


@called_kernel
def prepare_loop(arrays, work):
    """What the loop needs beside the list, to be made after each list build and each change of the layers in use."""
    fill_lanes(arrays, work.laws)
    start_sums(arrays, len(work.laws), arrays.memory.first_sum, arrays.memory.forces)


@by_type
def fill_lanes(arrays, laws):
    """Columns and species of each law with a table, see ByLane, for slots of all ghosts; unrolled by the compiler."""
    if len(laws) == 0:
        return lambda arrays, laws: None

    def fill(arrays, laws):
        _fill_lanes(laws[0][1], arrays)
        fill_lanes(arrays, laws[1:])

    return fill


@scalar
def _atom_in(slot, arrays):
    n_lanes = count(arrays.clusters.lanes)
    return arrays.clusters.atom[arrays.ghosts.owner[slot // n_lanes] * n_lanes + slot % n_lanes]


@by_type
def _fill_lanes(source, arrays):
    if source.instance_class is SameForAll:
        return lambda source, arrays: None
    if source.instance_class is ChargesByLane:

        def fill_charges(source, arrays):
            n_lanes = count(arrays.clusters.lanes)
            for slot in range(arrays.domains.numbers[GHOSTS] * n_lanes):
                source.of_slots[slot] = source.of_atoms[_atom_in(slot, arrays)]
            _fill_lanes(source.source, arrays)

        return fill_charges
    if source.instance_class is SlopesByLane:
        return lambda source, arrays: _fill_lanes(source.source, arrays)
    if source.instance_class is TwoKindsOfRows:
        return lambda source, arrays: _fill_lanes(source.full, arrays)

    def fill(source, arrays):
        for slot in range(arrays.domains.numbers[GHOSTS] * count(arrays.clusters.lanes)):
            b = source.of_atoms[_atom_in(slot, arrays)]
            source.species[slot] = b
            for a in range(source.table.shape[0]):
                _fill_columns(source.columns, source.table, a, b, 0, a * source.slots + slot)

    return fill


@by_type
def _fill_columns(columns, table, a, b, p, place):
    """Element `place` of each column from p on = table[a, b, p]; unrolled by the compiler."""
    if len(columns) == 0:
        return lambda columns, table, a, b, p, place: None

    def fill(columns, table, a, b, p, place):
        columns[0][place] = table[a, b, p]
        _fill_columns(columns[1:], table, a, b, p + 1, place)

    return fill


@by_type
def start_sums(arrays, n_laws, first_sum, forces):
    """first_sum (W,) int64 = what sums of forces begin with on each ghost of each window:
    minus the biases that the rows of n_laws will add."""
    if isinstance(forces.dtype, types.Float):
        return lambda arrays, n_laws, first_sum, forces: None

    def start(arrays, n_laws, first_sum, forces):
        rows = arrays.rows
        stops = rows.stops[rows.layers[0] - 1]
        first_sum[:] = 0

        for domain in range(arrays.domains.first.size):
            window = arrays.domains.window[domain]
            first_slot, last_slot = slots_of(domain, arrays)

            for slot in range(first_slot, last_slot):
                for entry in range(rows.start[slot], stops[slot]):
                    ghost = np.intp(rows.entries[entry] & GHOST_BITS)
                    first_sum[window + ghost] -= n_laws * BIAS

    return start


@scalar
def plus_virials(force, separation, to, steps):
    """to + f ⊗ r of pairs, as xx yy zz yz xz xy."""
    fx, fy, fz = force
    dx, dy, dz = separation
    xx, yy, zz, yz, xz, xy = to
    xx = plus_virial(fx, dx, xx, steps)
    yy = plus_virial(fy, dy, yy, steps)
    zz = plus_virial(fz, dz, zz, steps)
    yz = plus_virial(fy, dz, yz, steps)
    xz = plus_virial(fx, dz, xz, steps)
    xy = plus_virial(fx, dy, xy, steps)
    return xx, yy, zz, yz, xz, xy


@by_type
def plus_virial(g, x, to, steps):
    """to + g x, a component of the virial [energy]."""
    if is_fixed(steps):
        return lambda g, x, to, steps: to + on_grid(g * x, steps.energy)
    return lambda g, x, to, steps: fma(g, x, to)


@by_type
def summed_squares(f, to, steps):
    """to + f², lane by lane, where forces are watched: in fixed-point arithmetic."""
    if is_fixed(steps):
        return lambda f, to, steps: fma(f, f, to)
    return lambda f, to, steps: to


@by_type
def lanes_beyond(size2, steps):
    """The lanes, as bits, whose squares are beyond limit2 of Steps or no numbers; none without Steps."""
    if not is_fixed(steps):
        return lambda size2, steps: 0
    all_lanes = (1 << size2.lanes) - 1
    return lambda size2, steps: ~bits_from_mask(size2 <= steps.limit2) & all_lanes


@scalar
def push(forces, ghost, f, separation):
    """F_j += f r_ij on the lanes of a ghost.
    separation : (dx, dy, dz) of r_ij."""
    dx, dy, dz = separation
    n_lanes = np.uintp(count(f))
    x = ghost * np.uintp(DIMENSIONS) * n_lanes
    y = x + n_lanes
    z = y + n_lanes
    store(forces, x, plus_product(f, dx, load(forces, x, f)))
    store(forces, y, plus_product(f, dy, load(forces, y, f)))
    store(forces, z, plus_product(f, dz, load(forces, z, f)))
