"""Pair laws on the cluster list: eight pairs at a time, on a pool of threads."""

from collections.abc import Iterable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.fixed_point import MOST, GridSums
from minimd.compiled.kernels import DirectCalls, kernel, without_cache
from minimd.compiled.simd.lanes import DOUBLE, MIXED
from minimd.compiled.threads import thread_pool
from minimd.forces.cluster_kernel import Motion, Rest, evaluate_clusters
from minimd.forces.cluster_loop import LANE_SUMS, ByLane, ForceSums, Sums, start_sums
from minimd.forces.options import FIXED_POINT, Options, described
from minimd.forces.pair_laws import PairLaws, skin_for, widest_skin
from minimd.integrators.splitting.state import GridState, State, steps_of
from minimd.neighbors import domains
from minimd.neighbors.buffers import Buffers
from minimd.neighbors.cluster_list import ClusterList
from minimd.neighbors.cluster_search import LAYERS
from minimd.neighbors.clusters import DIMENSIONS
from minimd.potentials.pair_loop import SameForAll
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, OwnTerm
from minimd.potentials.user_laws import is_recognized
from minimd.structure.errors import RangeError
from minimd.structure.grid import TOO_LARGE
from minimd.structure.system import System

NOTHING = np.zeros((0, 3))
AT_REST = Motion((), np.zeros((1, 2)), np.ones((1, 2)), 0, 0, 0.0, NOTHING, *(np.zeros(0) for _ in range(4)))  # one compiled kernel for both
MOST_MOVED = 4_000_000  # atoms in a call, half a second


class ClusterTerm(OwnTerm):
    """Laws on all pairs within their cutoffs, eight at a time, found with one cluster list."""

    list: ClusterList
    needs_one_accumulator = marches = True

    def __init__(self, system: System, laws: PairLaws, options: Options, displacement: float = 0.0) -> None:
        self._pool = thread_pool(max(1, min(options.most_threads, len(system) // domains.ATOMS_PER_DOMAIN)))
        self._is_mixed, self._precision = options.precision == "mixed", options.precision
        if self._is_mixed:
            laws.check_single_precision()
        skin = skin_for(system, laws, options, displacement, LAYERS)
        self.list = ClusterList(len(system), laws.cutoff, skin, laws.excluded, options.precision, self._pool)
        self._pair_laws, self.widest_skin = laws, widest_skin(system, laws)
        are_recognized = all(is_recognized(one.law) for one in laws.members)
        self._evaluate = evaluate_clusters if are_recognized else without_cache(evaluate_clusters)
        self._calls = DirectCalls(), DirectCalls(), DirectCalls()  # by detail
        self._prepared_for, self._started_for = 0, cast(Any, None)  # which build of the list, and which arrays
        self._memory = Buffers()
        self._own: tuple[NDArray, ...] = ()

    def follow(self, system: System) -> bool:
        """See Term; a cell without room for the list needs another one."""
        self.widest_skin = widest_skin(system, self._pair_laws)
        if self.list.skin > self.widest_skin or system.cell.heights.min() < self.list.cutoff + self.list.skin:
            return False
        self.list.follow(system.cell)
        return True

    def add_to(self, system: System, detail: int, sums: Any) -> None:
        """See Term."""
        self._update(system)
        own = self._force_sums if detail == FORCES else self._sums(detail)
        steps = self._steps(sums.steps) if isinstance(sums, GridSums) else ()
        arguments = (system.positions, self.list.arrays, self._laws, own, sums[0], AT_REST._replace(steps=steps) if detail == FORCES else Rest(steps))
        self._pool.run(self._evaluate, *arguments, calls=self._calls[detail])
        if detail == TOTALS:
            sums[1][0] += own.energies.sum()
            sums[2][0] += own.virials.sum(axis=0)
        elif detail == PER_ATOM:
            self._add_each(own, sums[1], sums[2])
        if isinstance(sums, GridSums) and not self._is_in_range():
            sums.faults[0] = 1

    def _steps(self, steps: Any) -> Any:
        """With the limit of forces divided by distances: all distances are below the cutoff. () without a grid."""
        return steps._replace(limit2=(MOST / self._pair_laws.cutoff) ** 2) if steps else ()

    def _is_in_range(self) -> bool:
        """Whether the kernel found no force and no momentum beyond its range since the last question."""
        was_in_range = not self.list.memory.net.any()
        self.list.memory.net[:] = 0.0
        return was_in_range

    def _check(self, state: GridState) -> None:
        """Raise RangeError if something has left its range."""
        if not self._is_in_range():
            state.grid.check_momenta(state.velocities, state.inverse_masses)
            raise RangeError(TOO_LARGE)
        state.grid.check_positions(state.positions)

    def prepare(self, system: System, forces: NDArray, steps: Any = ()) -> None:
        """See Term."""
        motion = AT_REST._replace(steps=self._steps(steps))
        arguments = (system.positions, self.list.arrays, self._laws, self._force_sums, forces, motion)
        self._pool.compile(self._evaluate, *arguments, calls=self._calls[FORCES])

    def march(self, system: System, state: State, durations: NDArray, n: int) -> int:
        """See Term. Between two list builds all threads stay in one kernel; only so many atoms move in a call that Ctrl-C is answered soon."""
        n_cycles = min(n, max(1, MOST_MOVED // (state.velocities.shape[0] * len(durations))))
        n_pairs, made, state.forces_are_current = n_cycles * len(durations), 0, False
        lasting, units = np.ascontiguousarray(durations[:, :, 0]), np.ascontiguousarray(durations[:, :, 1])
        forces, steps = (state.impulses, self._steps(steps_of(state.grid, units[:, 0]))) if isinstance(state, GridState) else (state.forces, ())
        while made < n_pairs:
            self._update(system)
            self._own = self._own or self._own_arrays()
            motion = Motion(steps, lasting, units, made, n_pairs - made, self.list.limit2, state.velocities, state.inverse_masses, *self._own)
            arguments = (system.positions, self.list.arrays, self._laws, self._force_sums, forces, motion)
            made += self._pool.run(self._evaluate, *arguments, calls=self._calls[FORCES])
            if isinstance(state, GridState):
                self._check(state)
        return n_cycles

    def _update(self, system: System) -> None:
        """A valid list, and what is prepared for it."""
        self.list.update(system.positions, system.cell)
        if self._prepared_for != self.list.n_builds:
            self._prepare(system)
        if self._precision == FIXED_POINT and self._started_for is not self.list.arrays:  # a new list, or another layer of it
            self._started_for = self.list.arrays
            start_sums(self.list.arrays.rows, len(self._laws), self.list.memory.first_sum)

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
        return f"cluster list (skin {self.list.skin:.3g}, {threads}, {described(self._precision)}) on {vectors}"

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
