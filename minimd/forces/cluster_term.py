"""Pair laws on the cluster list: eight pairs at a time, on a pool of threads."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import DirectCalls, kernel, without_cache
from minimd.compiled.simd.lanes import DOUBLE, MIXED
from minimd.compiled.threads import thread_pool
from minimd.forces.cluster_kernel import Motion, Rest, evaluate_clusters
from minimd.forces.cluster_loop import LANE_SUMS, ByLane, ForceSums, Sums
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws, skin_for, widest_skin
from minimd.integrators.splitting.state import State
from minimd.neighbors import domains
from minimd.neighbors.buffers import Buffers
from minimd.neighbors.cluster_list import ClusterList
from minimd.neighbors.cluster_search import LAYERS
from minimd.neighbors.clusters import DIMENSIONS
from minimd.potentials.pair_loop import SameForAll
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, Term
from minimd.potentials.user_laws import is_recognized
from minimd.structure.system import System

NOTHING = np.zeros((0, 3))
AT_REST = Motion(np.zeros((1, 2)), 0, 0, 0.0, NOTHING, *(np.zeros(0) for _ in range(4)))  # a Motion: one compiled kernel for both
MOST_MOVED = 4_000_000  # atoms in a call, half a second


class ClusterTerm(Term):
    """Laws on all pairs within their cutoffs, eight at a time, found with one cluster list."""

    list: ClusterList
    needs_one_accumulator = marches = True

    def __init__(self, system: System, laws: PairLaws, options: Options, displacement: float = 0.0) -> None:
        self._pool = thread_pool(max(1, min(options.most_threads, len(system) // domains.ATOMS_PER_DOMAIN)))
        self._is_mixed = options.precision == "mixed"
        if self._is_mixed:
            laws.check_single_precision()
        skin = skin_for(system, laws, options, displacement, LAYERS)
        self.list = ClusterList(len(system), laws.cutoff, skin, laws.excluded, self._is_mixed, self._pool)
        self._pair_laws, self.widest_skin = laws, widest_skin(system, laws)
        are_recognized = all(is_recognized(one.law) for one in laws.members)
        self._evaluate = evaluate_clusters if are_recognized else without_cache(evaluate_clusters)
        self._calls = DirectCalls(), DirectCalls(), DirectCalls()  # by detail
        self._prepared_for = 0  # which build of the list
        self._memory = Buffers()
        self._own: tuple[NDArray, ...] = ()

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """See Term."""
        self._update(system)
        sums = self._force_sums if detail == FORCES else self._sums(detail)
        arguments = (system.positions, self.list.arrays, self._laws, sums, forces, AT_REST if detail == FORCES else Rest())
        self._pool.run(self._evaluate, *arguments, calls=self._calls[detail])
        if detail == TOTALS:
            energies[0] += sums.energies.sum()
            virials[0] += sums.virials.sum(axis=0)
        elif detail == PER_ATOM:
            self._add_each(sums, energies, virials)

    def prepare(self, system: System, forces: NDArray) -> None:
        """See Term."""
        arguments = (system.positions, self.list.arrays, self._laws, self._force_sums, forces, AT_REST)
        self._pool.compile(self._evaluate, *arguments, calls=self._calls[FORCES])

    def march(self, system: System, state: State, durations: NDArray, n: int) -> int:
        """See Term. Between two list builds all threads stay in one kernel; only so many atoms move in a call that Ctrl-C is answered soon."""
        n_cycles = min(n, max(1, MOST_MOVED // (state.velocities.shape[0] * len(durations))))
        n_pairs, made, state.forces_are_current = n_cycles * len(durations), 0, False
        while made < n_pairs:
            self._update(system)
            self._own = self._own or self._own_arrays()
            motion = Motion(durations, made, n_pairs - made, self.list.limit2, state.velocities, state.inverse_masses, *self._own)
            arguments = (system.positions, self.list.arrays, self._laws, self._force_sums, state.forces, motion)
            made += self._pool.run(self._evaluate, *arguments, calls=self._calls[FORCES])
        return n_cycles

    def _update(self, system: System) -> None:
        """A valid list, and what is prepared for it."""
        self.list.update(system.positions, system.cell)
        if self._prepared_for != self.list.n_builds:
            self._prepare(system)

    def _prepare(self, system: System) -> None:
        """After a list build: parameters in the order of its clusters, and the array of its forces."""
        of_lanes = [self._by_lane(k, one.table, system.species_index) for k, one in enumerate(self._pair_laws.members)]
        self._laws = tuple((one.law, parameters) for one, parameters in zip(self._pair_laws.members, of_lanes, strict=True))
        self._force_sums = ForceSums(self.list.memory.forces, np.zeros(0), np.zeros((0, 6)), np.zeros(0), FORCES)
        self._own = ()  # made where atoms march
        self._prepared_for = self.list.n_builds

    def _own_arrays(self) -> tuple[NDArray, ...]:
        """Memory for the atoms in the order of the clusters, see Motion."""
        n = len(self.list.clusters.atom)
        return tuple(self._memory.array(f"own {k}", np.float64, size) for k, size in enumerate((DIMENSIONS * n, DIMENSIONS * n, n)))

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
