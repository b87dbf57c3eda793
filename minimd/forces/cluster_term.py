"""Pair laws on the cluster list: eight pairs at a time, on a pool of threads."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.fixed_point import MOST, GridSums
from minimd.compiled.kernels import DirectCalls, without_cache
from minimd.compiled.simd.lanes import DOUBLE, MIXED
from minimd.compiled.threads import thread_pool
from minimd.forces.cluster_kernel import MADE, TO_MAKE, Atoms, Contacts, Loop, Motion, evaluate_clusters
from minimd.forces.cluster_loop import LANE_SUMS, ByLane, ForceSums, Sums, Work, add_forces_of_laws, prepare_loop
from minimd.forces.cluster_march import TASKS_PER_MOVE, march_clusters
from minimd.forces.options import FIXED_POINT, Options, described
from minimd.forces.pair_laws import PairLaws, skin_for, widest_skin
from minimd.integrators.splitting.state import Contact, Cycle, GridState, State, steps_of
from minimd.neighbors import domains
from minimd.neighbors.buffers import Buffers
from minimd.neighbors.cluster_build import build_clusters
from minimd.neighbors.cluster_list import ClusterList
from minimd.neighbors.cluster_search import LAYERS
from minimd.potentials.pair_loop import SameForAll
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, OwnTerm
from minimd.potentials.user_laws import is_recognized
from minimd.structure.errors import RangeError
from minimd.structure.grid import TOO_LARGE
from minimd.structure.system import System

NOTHING, NONE = np.zeros((0, 3)), np.zeros(0)
NO_COURSE = np.zeros(2, dtype=np.int64)
NO_CONTACTS = Contacts(1.0, 0.0, 0.0, np.zeros((0, 0, 3)), NONE, NONE, NONE, NONE)
AT_REST = Motion((), np.ones((1, 2, 2)), NO_COURSE, NO_CONTACTS, Atoms(NOTHING, NONE, 1, NONE, NONE, NONE))
MOST_MOVED = 8_000_000  # atoms in a call, about a second
MOST_NOISE = 1_000_000  # atoms whose noise is kept at a time


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
        kernels = (add_forces_of_laws, prepare_loop)
        self._add_forces, self._prepare_loop = kernels if are_recognized else map(without_cache, kernels)
        self._calls = DirectCalls(), DirectCalls(), DirectCalls()  # by detail
        self._arranged_for, self._prepared_for = 0, (0, 0)  # which arrays of the list; which build, and how many layers
        self._memory = Buffers()
        self._atoms: Atoms | None = None
        self._work_of_totals: Work | None = None

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
        work = self._work if detail == FORCES else self._totals() if detail == TOTALS else self._each()
        motion = AT_REST._replace(steps=self._steps(sums.steps)) if isinstance(sums, GridSums) else AT_REST
        self._pool.run(evaluate_clusters, *self._evaluation(system, work, sums[0], motion), calls=self._calls[FORCES])
        if detail == TOTALS:
            sums[1][0] += work.sums.energies.sum()
            sums[2][0] += work.sums.virials.sum(axis=0)
        elif detail == PER_ATOM:
            self._add_each(work.sums, sums[1], sums[2])
        if isinstance(sums, GridSums) and not self._is_in_range():
            sums.faults[0] = 1

    def _evaluation(self, system: System, work: Work, forces: NDArray, motion: Motion) -> tuple[Any, ...]:
        """Arguments of evaluate_clusters."""
        arrays, calls = self.list.arrays, self._calls[work.sums.detail]
        add = calls.address(self._add_forces, 0, arrays, work, motion.steps, 0)
        prepare = calls.address(self._prepare_loop, arrays, work) if self._needs_preparation else 0
        return system.positions, arrays, Loop(add, prepare, work.address), forces, motion

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

    def prepare(self, system: System, forces: NDArray, steps: Any = (), is_alone: bool = True) -> None:
        """See Term."""
        evaluation = self._evaluation(system, self._work, forces, AT_REST._replace(steps=self._steps(steps)))
        self._pool.compile(evaluate_clusters, *evaluation, calls=self._calls[FORCES])
        if is_alone and self.list.can_be_renewed:
            self._pool.compile(march_clusters, *self._with_builds(evaluation), calls=self._calls[FORCES])

    def march(self, system: System, state: State, cycle: Cycle, n: int) -> int:
        """See Term. Threads stay in one kernel; only so many atoms move in a call that Ctrl-C is answered soon."""
        n_atoms, (durations, contact) = len(state.velocities), cycle
        n_cycles = min(n, max(1, (MOST_MOVED if contact is None else MOST_NOISE) // (n_atoms * len(durations))))
        if n_cycles <= 0 or (contact is not None and isinstance(state, GridState)):
            return 0
        state.forces_are_current, course = False, np.array([0, n_cycles * len(durations)])
        contacts = NO_CONTACTS if contact is None else in_contact(contact, state, n_cycles)
        calls = self._calls[FORCES]
        on_grid = (
            (state.impulses, self._steps(steps_of(state.grid, durations[:, 0, 1])))
            if isinstance(state, GridState)
            else None
        )
        forces, steps = on_grid or (state.forces, ())
        while course[MADE] < course[TO_MAKE]:
            self._update(system)
            evaluation = self._evaluation(
                system, self._work, forces, Motion(steps, durations, course, contacts, self._atoms_of(state))
            )
            if self.list.can_be_renewed:
                n_tasks = TASKS_PER_MOVE * int(course[TO_MAKE] - course[MADE])
                self.list.renewed(
                    self._pool.run(march_clusters, *self._with_builds(evaluation), calls=calls, n_tasks=n_tasks)
                )
                self._prepared_for = self.list.n_builds, int(self.list.rows.layers[0])
            else:
                course[MADE] += self._pool.run(evaluate_clusters, *evaluation, calls=calls)
            del evaluation  # it would hold the old memory of the list while the new is taken
            if isinstance(state, GridState):
                self._check(state)
        if contact is not None:
            contact.bath.energy = float(contacts.energy[0])
        return n_cycles

    def _with_builds(self, evaluation: tuple[Any, ...]) -> tuple[Any, ...]:
        """Arguments of march_clusters."""
        calls, building = self._calls[FORCES], (evaluation[0], self.list.building)
        evaluate = self._pool.address(evaluate_clusters, *evaluation, calls=calls)
        return evaluate, evaluation, self._pool.address(build_clusters, *building, calls=calls), building

    def _update(self, system: System) -> None:
        """A valid list, and what is prepared for it."""
        self.list.update(system.positions, system.cell)
        if self._arranged_for != self.list.n_arranged:
            self._arrange(system)
        in_use = self.list.n_builds, int(self.list.rows.layers[0])
        if self._prepared_for != in_use:
            self._prepared_for = in_use
            if self._needs_preparation:
                self._calls[FORCES](self._prepare_loop, self.list.arrays, self._work)

    def _arrange(self, system: System) -> None:
        """Arrays that go with those of the list."""
        of_lanes = [self._by_lane(k, one.table, system.species_index) for k, one in enumerate(self._pair_laws.members)]
        self._laws: tuple[Any, ...] = tuple(
            (one.law, parameters) for one, parameters in zip(self._pair_laws.members, of_lanes, strict=True)
        )
        self._needs_preparation = self._precision == FIXED_POINT or any(isinstance(one, ByLane) for one in of_lanes)
        self._work = Work(
            self._laws, ForceSums(self.list.memory.forces, np.zeros(0), np.zeros((0, 6)), np.zeros(0), FORCES)
        )
        self._work_of_totals = None
        self._atoms = None  # made where atoms march
        self._arranged_for, self._prepared_for = self.list.n_arranged, (0, 0)

    def _atoms_of(self, state: State) -> Atoms:
        """Atoms, with memory for them in the order of the clusters."""
        if (
            self._atoms is None
            or self._atoms.velocities is not state.velocities
            or self._atoms.inverse_masses is not state.inverse_masses
        ):
            are_same = bool((state.inverse_masses == state.inverse_masses[0]).all())
            masses = self._memory.array(
                "own inverse masses", np.float64, self.list.lanes.size if are_same else len(self.list.clusters.atom)
            )
            masses[:] = state.inverse_masses[0]
            positions = self.list.idle
            self._atoms = Atoms(
                state.velocities,
                state.inverse_masses,
                0 if are_same else 1,
                positions,
                state.room(positions.size),
                masses,
            )
        return self._atoms

    def _totals(self) -> Work:
        """Work with accumulators of each cluster, which are zero, in idle memory; it is kept,
        because small scenes are observed often."""
        n = self.list.n_clusters
        if self._work_of_totals is None or len(self._work_of_totals.sums.energies) != n:
            energies, virials = self.list.idle[:n], self.list.idle[n : 7 * n].reshape(n, 6)
            self._work_of_totals = self._work_with(energies, virials, NONE, TOTALS)
        self._work_of_totals.sums.energies[:], self._work_of_totals.sums.virials[:] = 0.0, 0.0
        return self._work_of_totals

    def _each(self) -> Work:
        """Work with accumulators of each slot and each lane of a ghost, which are zero."""
        n_lanes = self.list.lanes.size
        n, n_sums = self.list.n_clusters * n_lanes, int(self.list.domains.window[-1]) * n_lanes * LANE_SUMS
        return self._work_with(np.zeros(n), np.zeros((n, 6)), np.zeros(n_sums), PER_ATOM)

    def _work_with(self, energies: NDArray, virials: NDArray, lane_sums: NDArray, detail: int) -> Work:
        return Work(self._laws, Sums(self.list.memory.forces, energies, virials, lane_sums, detail))

    def _add_each(self, sums: Sums, energies: NDArray, virials: NDArray) -> None:
        """Add the sums of slots and lanes to the energies (N,) and virials (N, 6) of their atoms."""
        clusters, n_lanes, n = self.list.clusters, self.list.lanes.size, self.list.n_clusters
        atom, real = clusters.atom[: n * n_lanes], (np.arange(n_lanes) < clusters.filled[:n, None]).ravel()
        energies[atom[real]] += sums.energies[real]
        virials[atom[real]] += sums.virials[real]
        of_lanes, (first, window) = (
            sums.lane_sums.reshape(-1, LANE_SUMS, n_lanes),
            (self.list.domains.first, self.list.domains.window),
        )
        owner = np.concatenate(
            [self.list.ghosts.owner[a : a + size] for a, size in zip(first, np.diff(window), strict=True)]
        )
        atoms = atom.reshape(-1, n_lanes)[owner]
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
        species = self._memory.array(f"species of law {k}", np.int64, slots)
        return ByLane(tuple(values.reshape(table.shape[-1], -1)), species, slots, table, species_index)


def in_contact(contact: Contact, state: State, n: int) -> Contacts:
    """Contacts of n steps, as the kernel takes them."""
    n_atoms = len(state.velocities)
    before, after, energy = np.zeros(n_atoms), np.zeros(n_atoms), np.array([contact.bath.energy])
    noise = contact.noise(n, n_atoms)
    return Contacts(contact.kept, contact.spread, contact.duration, noise, state.masses, before, after, energy)
