"""Pair laws on the cluster list: one term of a scene, evaluated by a team of threads."""

from collections.abc import Iterable

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel, shared_kernel, without_cache
from minimd.compiled.threads import begin, finish_and_take, take, thread_pool, wait
from minimd.forces.cluster_loop import BLOCK, LANES, SHARES, ByLane, ForceSums, Sums, add_cluster_forces
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws, check_single_precision, skin_for
from minimd.neighbors.buffers import Buffers
from minimd.neighbors.cluster_list import ClusterList, gather, scatter
from minimd.neighbors.domains import ATOMS_IN_A_CHUNK
from minimd.potentials.law import is_user_law
from minimd.potentials.pair_loop import FORCES, PER_ATOM, TOTALS
from minimd.potentials.parameters import SameForAll
from minimd.structure.system import System


@shared_kernel
def evaluate_clusters(me, task, positions, clusters, chunk_start, copies, rows, memory, laws, parameters, detail, sums, forces):
    """forces (N, 3) += those of all laws; each chunk is a share of work."""
    n, work = chunk_start.size - 1, np.empty(BLOCK)
    phase = begin(me, task)
    chunk = take(me, phase, n)
    while chunk >= 0:
        gather(chunk_start[chunk], chunk_start[chunk + 1], clusters, copies, positions, memory)
        chunk = finish_and_take(me, phase, n)
    phase = wait(me, phase)
    chunk = take(me, phase, n)
    while chunk >= 0:
        place = (chunk_start[chunk], chunk_start[chunk + 1], copies.home, rows, memory.coordinates, memory.unit)
        _add_all_laws(place, laws, parameters, (detail, sums))
        chunk = finish_and_take(me, phase, n)
    phase = wait(me, phase)
    chunk = take(me, phase, n)
    while chunk >= 0:
        scatter(chunk_start[chunk], chunk_start[chunk + 1], clusters, copies, memory, forces, work)
        chunk = finish_and_take(me, phase, n)
    wait(me, phase)


def _add_all_laws(place, laws, parameters, sums):
    """add_cluster_forces for each law, unrolled by the compiler."""
    raise NotImplementedError


@overload(_add_all_laws)
def _add_all_laws_overload(place, laws, parameters, sums):
    if len(laws) == 1:
        return lambda place, laws, parameters, sums: add_cluster_forces(*place, laws[0], parameters[0], *sums)

    def add(place, laws, parameters, sums):
        add_cluster_forces(*place, laws[0], parameters[0], *sums)
        _add_all_laws(place, laws[1:], parameters[1:], sums)

    return add


class ClusteredPairs:
    """Laws on all pairs within their cutoffs, eight at a time, found with one cluster list."""

    def __init__(self, system: System, laws: PairLaws, options: Options, stride: float = 0.0) -> None:
        self._team = thread_pool(max(1, min(options.most_threads, len(system) // ATOMS_IN_A_CHUNK)))
        self._is_mixed = options.precision == "mixed"
        if self._is_mixed:
            check_single_precision(laws)
        skin = skin_for(system, laws, options, stride)
        self.list = ClusterList(len(system), laws.cutoff, skin, laws.excluded, self._is_mixed, self._team)
        self._laws = laws
        self._markers = tuple(laws.laws)
        self._number = np.float32 if self._is_mixed else np.float64
        is_known = not any(is_user_law(law) for law in laws.laws)
        self._evaluate = evaluate_clusters if is_known else without_cache(evaluate_clusters)
        self._parameters: tuple = ()
        self._parameters_of = 0  # which build of the list
        self._memory = Buffers()

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """See Term."""
        self.list.update(system.positions, system.cell)
        if self._parameters_of != self.list.n_builds:
            self._parameters = tuple(self._by_lane(k, table, system.species_index) for k, table in enumerate(self._laws.tables))
            self._parameters_of = self.list.n_builds
        clusters, copies, memory = self.list.clusters, self.list.copies, self.list.memory
        n_books = {FORCES: 0, TOTALS: len(clusters.filled), PER_ATOM: len(clusters.atom)}[detail]
        shares = np.zeros(len(copies.owner) * LANES * SHARES if detail == PER_ATOM else 0)
        sums = (Sums if detail != FORCES else ForceSums)(memory.forces, np.zeros(n_books), np.zeros((n_books, 6)), shares)
        scene = (system.positions, clusters, self.list.chunks.cluster, copies, self.list.rows, memory)
        before = net_force(forces) if self._is_mixed else None
        self._team.run(self._evaluate, *scene, self._markers, self._parameters, detail, sums, forces)
        if before is not None:
            net = np.subtract(net_force(forces), before)
            if np.isfinite(net).all():
                take_out(*net, forces)
        if detail == TOTALS:
            energies[0] += sums.energies.sum()
            virials[0] += sums.virials.sum(axis=0)
        elif detail == PER_ATOM:
            self._book(sums, energies, virials)

    def _book(self, sums: Sums, energies: NDArray, virials: NDArray) -> None:
        """Add what was found to the energies (N,) and virials (N, 6) of the atoms."""
        clusters = self.list.clusters
        real = (np.arange(LANES) < clusters.filled[:, None]).ravel()
        energies[clusters.atom[real]] += sums.energies[real]
        virials[clusters.atom[real]] += sums.virials[real]
        atoms, of_lanes = clusters.atom.reshape(-1, LANES)[self.list.copies.owner], sums.shares.reshape(-1, SHARES, LANES)
        np.add.at(energies, atoms, of_lanes[:, 0])
        np.add.at(virials, atoms, of_lanes[:, 1:].transpose(0, 2, 1))

    @property
    def summary(self) -> str:
        """The list, for the report."""
        n = min(self._team.n_threads, self.list.n_chunks) if self.list.n_builds else self._team.n_threads
        threads = f"{n} thread{'s' if n > 1 else ''}"
        return f"cluster list (skin {self.list.skin:.3g}, {threads}, {'mixed' if self._is_mixed else 'double'} precision)"

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return self._laws.skipped()

    def _by_lane(self, k: int, table: NDArray[np.float64], species_index: NDArray[np.int64]) -> SameForAll | ByLane:
        """Parameters of law k, from a table (S, S, 1 + P)."""
        if len(table) == 1:
            return SameForAll(tuple(table[0, 0].tolist()))
        slots = len(self.list.copies.owner) * LANES
        values = self._memory.array(f"parameters of law {k}", self._number, table.shape[-1] * len(table) * slots)
        columns = values.reshape(table.shape[-1], -1)
        species = self._memory.array(f"species of law {k}", np.int64, slots)
        fill_lanes(table, species_index, self.list.clusters.atom, self.list.copies.owner, columns, species)
        return ByLane(tuple(columns), species, slots)


@kernel
def fill_lanes(table, species_index, atom, owner, columns, species):
    """species (slots,) and columns (1 + P, S · slots), as ByLane describes them, of all lanes of all copies."""
    slots = species.size
    for slot in range(slots):
        species[slot] = species_index[atom[owner[slot // LANES] * LANES + slot % LANES]]
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
def take_out(x, y, z, forces):
    """forces −= (x, y, z) / N: what pairs push all atoms together is rounding, and momentum is to be conserved."""
    x, y, z = x / forces.shape[0], y / forces.shape[0], z / forces.shape[0]
    for i in range(forces.shape[0]):
        forces[i, 0] -= x
        forces[i, 1] -= y
        forces[i, 2] -= z
