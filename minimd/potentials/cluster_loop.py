"""The vector loop over clusters: the same pair laws as pair_loop, applied to eight pairs at a time.

Atoms stand in clusters of eight that are near each other; see neighbors.cluster_list for the picture. A row belongs to one
atom i and names the clusters j that hold atoms within its reach; a mask says which lanes of each count.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core.errors import NumbaError
from numba.extending import overload

from minimd.compiling import kernel, without_cache
from minimd.potentials.law import evaluate_law, is_user_law
from minimd.potentials.parameters import SameForAll
from minimd.simd import broadcast, fma, load, mask_from_bits, select, store, total

LANES = 8
BLOCK = 3 * LANES  # numbers of one cluster in memory: eight x, eight y, eight z


class Rows(NamedTuple):
    """Clusters within reach of each atom: those of the atom in slot s are cluster[start[s] : start[s + 1]].

    start : (slots + 1,) int.  cluster : (E,) int.  lanes : (E,) uint8, bit k is set if the atom in lane k counts.
    """

    start: Any
    cluster: Any
    lanes: Any


class ByLane(NamedTuple):
    """Parameters by species, laid out for lanes.

    columns : tuple of (S · slots,) arrays; element a · slots + s is the parameter of the atom in slot s with species a.
    species : (slots,) int.  slots : number of slots, ghosts included.
    """

    columns: Any
    species: Any
    slots: Any


def parameters_of_lanes(source, slot, cluster):
    """Parameters of the pairs of the atom in a slot with the lanes of a cluster: numbers, or vectors if species differ."""
    raise NotImplementedError


@overload(parameters_of_lanes)
def _parameters_of_lanes(source, slot, cluster):
    if source.instance_class is SameForAll:
        return lambda source, slot, cluster: source.numbers
    return lambda source, slot, cluster: _loaded(source.columns, source.species[slot] * source.slots + cluster * LANES)


def _loaded(columns, start):
    """Eight elements of each column, from an index, unrolled by the compiler."""
    raise NotImplementedError


@overload(_loaded)
def _loaded_overload(columns, start):
    if len(columns) == 1:
        return lambda columns, start: (load(columns[0], start, LANES),)
    return lambda columns, start: (load(columns[0], start, LANES),) + _loaded(columns[1:], start)


@kernel
def add_cluster_forces(first, last, rows, coordinates, law, parameters, look, on_clusters, on_atoms, energies, virials):
    """Forces between the atoms in slots first to last and the clusters of their rows.

        r_ij = r_j − r_i,   f = −u′(r)/r,   F_j += f r_ij into on_clusters,   F_i −= Σ f r_ij into on_atoms

    coordinates, on_clusters, on_atoms : flat, BLOCK numbers for each cluster [length], [energy/length].
    look : also add to energies (slots,) and virials (slots, 6) as xx yy zz yz xz xy; each pair is booked on its atom i.
    """
    zero = load(coordinates, 0, LANES) * 0.0
    for slot in range(first, last):
        block = slot // LANES * BLOCK + slot % LANES
        x = broadcast(coordinates[block], zero)
        y = broadcast(coordinates[block + LANES], zero)
        z = broadcast(coordinates[block + 2 * LANES], zero)
        fx = fy = fz = energy = xx = yy = zz = yz = xz = xy = zero
        for entry in range(rows.start[slot], rows.start[slot + 1]):
            cluster = rows.cluster[entry]
            j = cluster * BLOCK
            dx = load(coordinates, j, LANES) - x
            dy = load(coordinates, j + LANES, LANES) - y
            dz = load(coordinates, j + 2 * LANES, LANES) - z
            r2 = fma(dx, dx, fma(dy, dy, dz * dz))
            numbers = parameters_of_lanes(parameters, slot, cluster)
            near = (r2 < numbers[0]) & mask_from_bits(rows.lanes[entry], zero)
            u, f = evaluate_law(law, r2, numbers[1:])
            f = select(near, f, 0.0)
            gx, gy, gz = f * dx, f * dy, f * dz
            fx, fy, fz = fx - gx, fy - gy, fz - gz
            store(on_clusters, j, load(on_clusters, j, LANES) + gx)
            store(on_clusters, j + LANES, load(on_clusters, j + LANES, LANES) + gy)
            store(on_clusters, j + 2 * LANES, load(on_clusters, j + 2 * LANES, LANES) + gz)
            if look:
                energy = energy + select(near, u, 0.0)
                xx, yy, zz = fma(gx, dx, xx), fma(gy, dy, yy), fma(gz, dz, zz)
                yz, xz, xy = fma(gy, dz, yz), fma(gx, dz, xz), fma(gx, dy, xy)
        on_atoms[block] += total(fx)
        on_atoms[block + LANES] += total(fy)
        on_atoms[block + 2 * LANES] += total(fz)
        if look:
            energies[slot] += total(energy)
            virials[slot, 0] += total(xx)
            virials[slot, 1] += total(yy)
            virials[slot, 2] += total(zz)
            virials[slot, 3] += total(yz)
            virials[slot, 4] += total(xz)
            virials[slot, 5] += total(xy)


def cluster_loop_for(law: tuple):
    """add_cluster_forces, compiled so that the cache serves all laws it can recognise."""
    return without_cache(add_cluster_forces) if is_user_law(law) else add_cluster_forces


def runs_on_vectors(law: tuple, n_parameters: int) -> bool:
    """Whether a law compiles for vectors. Those of minimd do; one of the user's that branches on its arguments does not."""
    if not is_user_law(law):
        return True

    @numba.njit(error_model="numpy")
    def attempt(law, values, parameters):
        u, f = evaluate_law(law, load(values, 0, LANES), parameters)
        return total(u) + total(f)

    try:
        attempt(law, np.ones(LANES), (1.0,) * n_parameters)
    except NumbaError:
        return False
    return True
