"""Pair laws on the cluster list: eight pairs at a time, on a pool of threads."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import by_type, kernel, shared_kernel, without_cache
from minimd.compiled.simd.lanes import DOUBLE, MIXED, count
from minimd.compiled.threads import barrier, begin, finish_and_take, take, thread_pool
from minimd.forces.cluster_loop import LANE_SUMS, ByLane, ForceSums, Sums, add_cluster_forces
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws, skin_for
from minimd.neighbors import domains
from minimd.neighbors.buffers import Buffers
from minimd.neighbors.cluster_list import ClusterList, gather, scatter
from minimd.neighbors.clusters import DIMENSIONS
from minimd.potentials.pair_loop import SameForAll
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, Term
from minimd.potentials.user_laws import is_recognized
from minimd.structure.system import System


@shared_kernel
def evaluate_clusters(worker, task, positions, arrays, laws, sums, forces):
    """forces (N, 3) += those of all laws; each domain is a chunk of the task.

    positions : (N, 3) [length].  arrays : ClusterArrays.  laws : tuple of pairs, a law type and its parameters, SameForAll or ByLane.
    sums : Sums or ForceSums.
    """
    n = arrays.domain_start.size - 1
    phase = begin(worker, task)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        gather(chunk, arrays, positions)
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        _add_all(chunk, arrays, laws, sums)
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)
    space = np.empty(DIMENSIONS * count(arrays.clusters.lanes))
    chunk = take(worker, phase, n)
    while chunk >= 0:
        scatter(chunk, arrays, forces, space)
        chunk = finish_and_take(worker, phase, n)
    barrier(worker, phase)


@by_type
def _add_all(domain, arrays, laws, sums):
    """add_cluster_forces for each law, unrolled by the compiler."""
    if len(laws) == 1:
        return lambda domain, arrays, laws, sums: add_cluster_forces(domain, arrays, laws[0][0], laws[0][1], sums)

    def add(domain, arrays, laws, sums):
        add_cluster_forces(domain, arrays, laws[0][0], laws[0][1], sums)
        _add_all(domain, arrays, laws[1:], sums)

    return add


class ClusterTerm(Term):
    """Laws on all pairs within their cutoffs, eight at a time, found with one cluster list."""

    list: ClusterList
    needs_one_accumulator = True

    def __init__(self, system: System, laws: PairLaws, options: Options, displacement: float = 0.0) -> None:
        self._pool = thread_pool(max(1, min(options.most_threads, len(system) // domains.ATOMS_PER_DOMAIN)))
        self._is_mixed = options.precision == "mixed"
        if self._is_mixed:
            laws.check_single_precision()
        skin = skin_for(system, laws, options, displacement)
        self.list = ClusterList(len(system), laws.cutoff, skin, laws.excluded, self._is_mixed, self._pool)
        self._pair_laws = laws
        are_recognized = all(is_recognized(one.law) for one in laws.members)
        self._evaluate = evaluate_clusters if are_recognized else without_cache(evaluate_clusters)
        self._compiled: dict[int, Callable] = {}  # by detail
        self._prepared_for = 0  # which build of the list
        self._memory = Buffers()

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """See Term."""
        self.list.update(system.positions, system.cell)
        if self._prepared_for != self.list.n_builds:
            self._prepare(system)
        before = net_force(forces) if self._is_mixed else None
        sums = self._force_sums if detail == FORCES else self._sums(detail)
        arguments = (system.positions, self.list.arrays, self._laws, sums, forces)
        if detail not in self._compiled:
            self._compiled[detail] = self._pool.compiled(self._evaluate, *arguments)
        self._pool.run(self._compiled[detail], *arguments)
        if before is not None:
            take_out(before, forces)
        if detail == TOTALS:
            energies[0] += sums.energies.sum()
            virials[0] += sums.virials.sum(axis=0)
        elif detail == PER_ATOM:
            self._add_each(sums, energies, virials)

    def _prepare(self, system: System) -> None:
        """After a list build: parameters in the order of its clusters, and the array of its forces."""
        of_lanes = [self._by_lane(k, one.table, system.species_index) for k, one in enumerate(self._pair_laws.members)]
        self._laws = tuple((one.law, parameters) for one, parameters in zip(self._pair_laws.members, of_lanes, strict=True))
        self._force_sums = ForceSums(self.list.memory.forces, np.zeros(0), np.zeros((0, 6)), np.zeros(0), FORCES)
        self._prepared_for = self.list.n_builds

    def _sums(self, detail: int) -> Sums:
        """Accumulators with zeros: one for each cluster if only totals are wanted, else one for each slot, and for each lane of a ghost."""
        clusters = self.list.clusters
        n = len(clusters.filled) if detail == TOTALS else len(clusters.atom)
        lane_sums = np.zeros(len(self.list.ghosts.owner) * self.list.lanes.size * LANE_SUMS if detail == PER_ATOM else 0)
        return Sums(self.list.memory.forces, np.zeros(n), np.zeros((n, 6)), lane_sums, detail)

    def _add_each(self, sums: Sums, energies: NDArray, virials: NDArray) -> None:
        """Add the sums of slots and lanes to the energies (N,) and virials (N, 6) of their atoms."""
        clusters, n_lanes = self.list.clusters, self.list.lanes.size
        real = (np.arange(n_lanes) < clusters.filled[:, None]).ravel()
        energies[clusters.atom[real]] += sums.energies[real]
        virials[clusters.atom[real]] += sums.virials[real]
        atoms, of_lanes = clusters.atom.reshape(-1, n_lanes)[self.list.ghosts.owner], sums.lane_sums.reshape(-1, LANE_SUMS, n_lanes)
        np.add.at(energies, atoms, of_lanes[:, 0])
        np.add.at(virials, atoms, of_lanes[:, 1:].transpose(0, 2, 1))

    @property
    def summary(self) -> str:  # type: ignore[override]
        """The list, for the report."""
        n = min(self._pool.n_threads, self.list.n_domains) if self.list.n_builds else self._pool.n_threads
        threads = f"{n} thread{'s' if n > 1 else ''}"
        vectors = f"vectors of {self.list.lanes.size} × {MIXED if self._is_mixed else DOUBLE} bits"
        return f"cluster list (skin {self.list.skin:.3g}, {threads}, {'mixed' if self._is_mixed else 'double'} precision) on {vectors}"

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return self._pair_laws.skipped()

    def _by_lane(self, k: int, table: NDArray[np.float64], species_index: NDArray[np.int64]) -> SameForAll | ByLane:
        """Parameters of law k, from a table (S, S, 1 + P)."""
        if len(table) == 1:
            return SameForAll(tuple(table[0, 0].tolist()))
        slots, number = len(self.list.ghosts.owner) * self.list.lanes.size, np.float32 if self._is_mixed else np.float64
        values = self._memory.array(f"parameters of law {k}", number, table.shape[-1] * len(table) * slots)
        columns = values.reshape(table.shape[-1], -1)
        species = self._memory.array(f"species of law {k}", np.int64, slots)
        fill_lanes(table, species_index, self.list.clusters.atom.reshape(-1, self.list.lanes.size), self.list.ghosts.owner, columns, species)
        return ByLane(tuple(columns), species, slots)


@kernel
def fill_lanes(table, species_index, atom, owner, columns, species):
    """species (slots,) and columns (1 + P, S · slots), as ByLane describes them, of all lanes of all ghosts."""
    slots, n_lanes = species.size, atom.shape[1]
    for slot in range(slots):
        species[slot] = species_index[atom[owner[slot // n_lanes], slot % n_lanes]]
        for a in range(table.shape[0]):
            for p in range(table.shape[2]):
                columns[p, a * slots + slot] = table[a, species[slot], p]


@kernel
def net_force(forces):
    """Σ F = (x, y, z) [energy/length]."""
    x = y = z = 0.0
    for i in range(forces.shape[0]):
        x, y, z = x + forces[i, 0], y + forces[i, 1], z + forces[i, 2]
    return x, y, z


@kernel
def take_out(before, forces):
    """forces −= (Σ F − before) / N, if finite. The net force of pairs is only rounding; without it momentum is conserved."""
    x, y, z = net_force(forces)
    x, y, z = x - before[0], y - before[1], z - before[2]
    if np.isfinite(x) and np.isfinite(y) and np.isfinite(z):
        x, y, z = x / forces.shape[0], y / forces.shape[0], z / forces.shape[0]
        for i in range(forces.shape[0]):
            forces[i, 0], forces[i, 1], forces[i, 2] = forces[i, 0] - x, forces[i, 1] - y, forces[i, 2] - z
