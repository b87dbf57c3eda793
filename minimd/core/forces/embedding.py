"""Passes before the forces, for embedded atoms: the density at each atom, its energy in it, and the slope of that.

    ρᵢ = Σⱼ g(r_ij),   U = Σ_pairs φ(r_ij) + Σᵢ F(ρᵢ)

The slopes F′(ρ) of both atoms are then parameters of the law of a pair. On the clusters densities are summed in the
memory of the forces, in the place of their x, and go the same way: to all ghosts in a window, and back to the atoms.
"""

from collections import namedtuple
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel, scalar
from minimd.core.compiled.program import GO_ON, Operation, operation
from minimd.core.compiled.simd import broadcast, lane, load, select, store, total, with_lane, zeros
from minimd.core.compiled.simd.vector import count
from minimd.core.forces.cluster_loop import parameters_of_lanes, separations, slots_of
from minimd.core.neighbors.cluster_memory import clear, collected
from minimd.core.neighbors.cluster_search import GHOST_BITS
from minimd.core.neighbors.clusters import DIMENSIONS
from minimd.core.neighbors.domains import LATE
from minimd.core.potentials.embedded_laws import densities
from minimd.core.potentials.law import evaluate_law, loop_for
from minimd.core.potentials.pair_loop import (
    from_table,
    parameters_of_pair,
    row_of,
    separation,
)
from minimd.core.potentials.term import PER_ATOM, TOTALS, Embedding, Target
from minimd.core.structure.system import System


class Embeddings(ByAddress, namedtuple("Embeddings", "law columns species energies")):
    """The embedding of all atoms.

    law : law type of F.
    columns : tuple of (S,) arrays, its parameters by species.
    species : (N,) int, of the atoms.
    energies : (N,), output, F(ρ) [energy].
    """


class ClusterDensities(ByAddress, namedtuple("ClusterDensities", "arrays law source embeddings")):
    """What the passes over clusters work on.

    arrays : ClusterArrays.
    law : law type of the pairs, see densities.
    source : SlopesByLane, whose slopes are output.
    embeddings : Embeddings.
    """


class PairDensities(
    ByAddress, namedtuple("PairDensities", "positions pairs law source embeddings order density")
):
    """What the pass over a pair list works on.

    positions : (N, 3) in the order of the list.
    pairs : Pairs.
    law, source : as of ClusterDensities, with Slopes.
    embeddings : Embeddings, by atom.
    order : (N,) int, atoms in the order of the list.
    density : (N,), output.
    """


@called_kernel
def sum_cluster_densities(work, domain):
    """The densities that the atoms of a domain and all that it sees give each other. On one thread those that are whole
    are taken at once, as forces are."""
    arrays = work.arrays
    clear(domain, arrays)
    rows = arrays.rows
    lanes = arrays.clusters.lanes
    n_lanes = count(lanes)
    first = arrays.domains.first[domain]
    block = DIMENSIONS * n_lanes
    coordinates = arrays.memory.coordinates[first * block :]
    density = arrays.memory.forces[arrays.domains.place[domain] * block :]
    zero = zeros(lanes)
    stops = rows.stops[rows.layers[0] - 1]
    first_slot, last_slot = slots_of(domain, arrays)

    for slot in range(first_slot, last_slot):
        home = arrays.ghosts.home[slot // n_lanes]
        place = (home - first) * block + slot % n_lanes
        own_slot = home * n_lanes + slot % n_lanes
        x, y, z = coordinates[place], coordinates[place + n_lanes], coordinates[place + 2 * n_lanes]
        at = broadcast(x, zero), broadcast(y, zero), broadcast(z, zero)
        after = rows.entries[np.uintp(rows.start[slot])]
        ahead = separations(coordinates, arrays.memory.far, after, at, lanes)
        own = zero
        for entry in range(np.uintp(rows.start[slot]), np.uintp(stops[slot])):
            now = after
            r2 = ahead[3]
            after = rows.entries[entry + np.uintp(1)]
            ahead = separations(coordinates, arrays.memory.far, after, at, lanes)
            ghost = np.uintp(now & GHOST_BITS)
            numbers = parameters_of_lanes(work.source, own_slot, first + np.intp(ghost), lanes)
            to_own, to_other = densities(work.law, r2, numbers[1:])
            near = r2 < numbers[0]
            own = own + select(near, to_own, 0.0)
            k = ghost * np.uintp(block)
            store(density, k, load(density, k, lanes) + select(near, to_other, 0.0))
        density[place] += total(own)

    if domain >= arrays.domains.numbers[LATE]:
        _embed(domain, work)
    return GO_ON


@called_kernel
def embed_late(work, domain):
    """The embedding of the atoms of a domain whose densities were not taken before."""
    if domain < work.arrays.domains.numbers[LATE]:
        _embed(domain, work)
    return GO_ON


@scalar
def _embed(domain, work):
    """Energies of the atoms of a domain; slopes of each cluster, to all its ghosts."""
    arrays = work.arrays
    clusters = arrays.clusters
    ghosts = arrays.ghosts
    n_lanes = count(clusters.lanes)

    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        density, _, _ = collected(k, arrays)
        slopes = zeros(clusters.lanes)
        for k_lane in range(n_lanes):
            if k_lane < clusters.filled[k]:
                i = clusters.atom[k * n_lanes + k_lane]
                slopes = with_lane(
                    slopes, k_lane, _slope(i, lane(density, k_lane), work.embeddings)
                )
        for p in range(ghosts.start[k], ghosts.start[k + 1]):
            store(work.source.of_slots, ghosts.of[p] * n_lanes, slopes)


@scalar
def _slope(i, density, embeddings):
    """F′(ρ) of atom i [energy/density]; F(ρ) goes to the energies."""
    numbers = row_of(embeddings.columns, embeddings.species[i])
    energy, slope = evaluate_law(embeddings.law, density, numbers)
    embeddings.energies[i] = energy
    return slope


@called_kernel
def sum_pair_densities(work, _chunk):
    """The densities of all atoms, one pair after the other; then their embedding."""
    positions, pairs, law, source, embeddings, order, density = work
    density[:] = 0.0

    for i in range(pairs.start.size - 1):
        at = positions[i, 0], positions[i, 1], positions[i, 2]
        own = 0.0
        for p in range(np.uintp(pairs.start[i]), np.uintp(pairs.start[i + 1])):
            j = np.uintp(pairs.second[p])
            _, _, _, r2 = separation(positions, pairs, at, p)
            numbers = parameters_of_pair(source, i, j)
            if r2 < numbers[0]:
                to_own, to_other = densities(law, r2, numbers[1:])
                own += to_own
                density[j] += to_other
        density[i] += own

    for k in range(order.size):
        source.of_atoms[k] = _slope(order[k], density[k], embeddings)
    return GO_ON


class EmbeddingPasses:
    """The passes of one law of embedded atoms, on either list.

    slopes : (N,) F′(ρ), in the order of a pair list [energy/density].
    """

    def __init__(self, law: tuple, embedding: Embedding, system: System) -> None:
        n_atoms = len(system)
        table = embedding.table
        species = system.species_index if len(table) > 1 else np.zeros(n_atoms, dtype=np.int64)
        self.slopes = np.zeros(n_atoms)
        self._density = np.zeros(n_atoms)
        self._law = law
        self._all = Embeddings(embedding.law, from_table(table), species, np.zeros(n_atoms))
        laws = self._law, self._all.law
        self._sum_of_clusters = loop_for(sum_cluster_densities, *laws)
        self._late = loop_for(embed_late, *laws)
        self._sum_of_pairs = loop_for(sum_pair_densities, *laws)
        self._calls = DirectCalls()

    def on_clusters(self, arrays: Any, source: Any, n_domains: int) -> Iterator[Operation]:
        """The operations on a cluster list, before those of forces."""
        work = ClusterDensities(arrays, self._law, source, self._all)
        yield operation(self._calls, self._sum_of_clusters, work, n_domains)
        yield operation(self._calls, self._late, work, n_domains)

    def on_pairs(
        self, positions: NDArray, pairs: Any, source: Any, order: NDArray
    ) -> Iterator[Operation]:
        """The operation on a pair list, likewise."""
        work = PairDensities(positions, pairs, self._law, source, self._all, order, self._density)
        yield operation(self._calls, self._sum_of_pairs, work)

    def collect(self, target: Target) -> None:
        """Add Σ F(ρ), or each of them, to the energies of a target."""
        if target.detail == TOTALS:
            target.energies[0] += self._all.energies.sum()
        elif target.detail == PER_ATOM:
            target.energies[:] += self._all.energies
