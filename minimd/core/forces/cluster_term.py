"""Pair laws on the cluster list: eight pairs at a time, on a pool of threads.

Its operations are the loop over the clusters of a domain, and the sums of its forces.
"""

from collections import namedtuple
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress, run_at
from minimd.core.compiled.fixed_point import MOST
from minimd.core.compiled.kernels import DirectCalls, called_kernel, kernel, scalar
from minimd.core.compiled.program import GO_ON, OUT_OF_RANGE, Operation, operation
from minimd.core.compiled.simd import lane
from minimd.core.compiled.simd.vector import BITS, count
from minimd.core.forces.cluster_loop import (
    APART,
    SUMS,
    ByLane,
    ChargesByLane,
    ForceSums,
    LoopWork,
    SlopesByLane,
    Sums,
    TotalSums,
    TwoKindsOfRows,
    add_forces_of_laws,
    prepare_loop,
)
from minimd.core.forces.options import FIXED_POINT, Options, described, pool_for
from minimd.core.forces.pair_laws import ListTerm, PairLaws, bare_species, skin_for
from minimd.core.neighbors.buffers import Buffers
from minimd.core.neighbors.cluster_list import ClusterList
from minimd.core.neighbors.cluster_memory import clear, collected
from minimd.core.neighbors.cluster_search import BUILDS, IN_USE, LAYERS, PREPARED_FOR
from minimd.core.neighbors.domains import LATE
from minimd.core.potentials.law import loop_for
from minimd.core.potentials.pair_loop import SameForAll
from minimd.core.potentials.term import FORCES, TOTALS, PairLaw, Target
from minimd.core.structure.system import System


class ClusterEvaluation(
    ByAddress, namedtuple("ClusterEvaluation", "arrays add prepare work forces steps")
):
    """What the operations work on.

    arrays : ClusterArrays.
    add, prepare : addresses of add_forces_of_laws and, if the loop needs it after a list build, of prepare_loop, or 0;
        compiled for each law, so that the kernels of this file are the same for all laws.
    work : address of their Work.
    forces : (N, 3) output [energy/length]; int64 impulses in fixed-point arithmetic, where steps : Steps, else ().
    """


@called_kernel
def prepare_laws(evaluation, _chunk):
    """What the loop needs of a new list, or of other layers of one, once for each of them."""
    layers = evaluation.arrays.rows.layers
    now = layers[BUILDS] * (LAYERS + 1) + layers[IN_USE]
    if layers[PREPARED_FOR] != now:
        layers[PREPARED_FOR] = now
        run_at(evaluation.prepare, (evaluation.arrays, evaluation.work))
    return GO_ON


@called_kernel
def add_domain(evaluation, domain):
    """Forces between the atoms of a domain and all that it sees. On one thread the sums of what is whole are taken at
    once: while they are in the cache."""
    arrays = evaluation.arrays
    clear(domain, arrays)
    if domain < arrays.memory.is_out.size:
        arrays.memory.is_out[domain] = 0
    run_at(evaluation.add, (domain, arrays, evaluation.work, evaluation.steps))
    if domain >= arrays.domains.numbers[LATE]:
        _collect(domain, evaluation)
    return GO_ON


@called_kernel
def collect_domain(evaluation, domain):
    """The forces on the atoms of a domain that were not taken before.  OUT_OF_RANGE if one of a pair was, in
    fixed-point arithmetic."""
    if domain < evaluation.arrays.domains.numbers[LATE]:
        _collect(domain, evaluation)
    is_out = evaluation.arrays.memory.is_out
    return OUT_OF_RANGE if is_out.size > 0 and is_out[domain] else GO_ON


@scalar
def _collect(domain, evaluation):
    """forces (N, 3) = those on the atoms of a domain."""
    arrays = evaluation.arrays
    forces = evaluation.forces
    clusters = evaluation.arrays.clusters
    n_lanes = count(clusters.lanes)

    for k in range(arrays.domain_start[domain], arrays.domain_start[domain + 1]):
        x, y, z = collected(k, arrays)
        for k_lane in range(n_lanes):
            if k_lane < clusters.filled[k]:
                i = np.uintp(clusters.atom[k * n_lanes + k_lane])
                forces[i, 0] = lane(x, k_lane)
                forces[i, 1] = lane(y, k_lane)
                forces[i, 2] = lane(z, k_lane)


@kernel
def add_domains(of_domains, energies, virials):
    """Add the sums of domains, every APART-th row, to the first energy and virial."""
    for c in range(SUMS):
        total = 0.0
        for row in range(0, of_domains.shape[0], APART):
            total += of_domains[row, c]
        if c == 0:
            energies[0] += total
        else:
            virials[0, c - 1] += total


NONE = np.zeros(0)


class ClusterTerm(ListTerm):
    """Laws on all pairs within their cutoffs, eight at a time, found with one cluster list."""

    list: ClusterList
    assigns = True

    def __init__(
        self, system: System, laws: PairLaws, options: Options, displacement: float = 0.0
    ) -> None:
        super().__init__(system, laws)
        n_atoms = len(system)
        self.pool = pool_for(options, n_atoms)
        self._precision = options.precision
        is_fixed = options.precision == FIXED_POINT
        skin = skin_for(system, laws, options, displacement, LAYERS)
        self.list = ClusterList(n_atoms, laws.cutoff, skin, laws.excluded, is_fixed, self.pool)
        members = [member.law for member in laws.members]
        self._add_forces = loop_for(add_forces_of_laws, *members)
        self._prepare_loop = loop_for(prepare_loop, *members)
        self._calls = DirectCalls(), DirectCalls(), DirectCalls()  # by detail
        self._arranged_for = 0  # which arrays of the list
        self._memory = Buffers()
        self._evaluations: dict[tuple[Any, ...], tuple[ClusterEvaluation, LoopWork]] = {}

    def suits(self, system: System) -> bool:
        """See ListTerm: a cell without room for the list needs another one."""
        return bool(min(system.cell.heights.tolist()) >= self.list.cutoff + self.list.skin)

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        if self._arranged_for != self.list.version:
            self._arrange(system)
        evaluation = self._evaluation(target)
        n = self.list.n_domains
        calls = self._calls[FORCES]
        yield from self.list.operations()
        if self._needs_preparation:
            yield operation(calls, prepare_laws, evaluation, is_kept=True)
        for passes, (_, source) in zip(self._passes, self._laws, strict=True):
            if passes is not None:
                yield from passes.on_clusters(self.list.arrays, source, n)
        yield operation(calls, add_domain, evaluation, n, is_kept=True, is_long=True)
        yield operation(calls, collect_domain, evaluation, n, is_kept=True)

    def _evaluation(self, target: Target) -> ClusterEvaluation:
        """What operations for a target work on: kept as long as the list is not arranged anew."""
        key = _key(target)
        if key in self._evaluations:
            return self._evaluations[key][0]
        arrays = self.list.arrays
        work = self._work_of(target.detail)
        calls = self._calls[target.detail]
        steps = ()
        if target.steps:
            # with the limit of forces divided by distances: all distances are below the cutoff
            steps = target.steps._replace(limit2=(MOST / self._pair_laws.cutoff) ** 2)
        add = calls.address(self._add_forces, 0, arrays, work, steps)
        prepare = 0
        if self._needs_preparation:
            prepare = calls.address(self._prepare_loop, arrays, work)
        evaluation = ClusterEvaluation(arrays, add, prepare, work.address, target.forces, steps)
        self._evaluations[key] = evaluation, work
        return evaluation

    def collect(self, target: Target) -> None:
        """See Term."""
        super().collect(target)
        if target.detail == FORCES:
            return
        sums = self._evaluations[_key(target)][1].sums
        if target.detail == TOTALS:
            add_domains(sums.of_rows, target.energies, target.virials)
        else:
            self._add_each(sums, target.energies, target.virials)

    def _arrange(self, system: System) -> None:
        """Arrays that go with those of the list."""
        laws = []
        self._needs_preparation = self._precision == FIXED_POINT

        for k, member in enumerate(self._pair_laws.members):
            source = self._source(k, member, system)
            laws.append((member.law, source))
            self._needs_preparation |= not isinstance(source, SameForAll)

        self._laws: tuple[Any, ...] = tuple(laws)
        self._arranged_for = self.list.version
        self._evaluations.clear()

    def _work_of(self, detail: int) -> LoopWork:
        """Work with accumulators: none; of each domain; or of each slot and each lane of a ghost."""
        forces = self.list.memory.forces
        if detail == FORCES:
            sums: Sums = ForceSums(forces, np.zeros((0, SUMS)), NONE, detail)
        elif detail == TOTALS:
            of_domains = np.zeros((APART * self.list.n_domains, SUMS))
            sums = TotalSums(forces, of_domains, NONE, detail)
        else:
            of_rows = np.zeros((len(self.list.clusters.atom), SUMS))
            of_lanes = np.zeros(len(self.list.ghosts.parts) * self.list.lanes.size * SUMS)
            sums = Sums(forces, of_rows, of_lanes, detail)

        return LoopWork(self._laws, sums)

    def _add_each(self, sums: Sums, energies: NDArray, virials: NDArray) -> None:
        """Add the sums of slots and lanes to those of their atoms.

        energies : (N,).
        virials : (N, 6).
        """
        clusters = self.list.clusters
        n_lanes = self.list.lanes.size
        n = self.list.n_clusters
        atom = clusters.atom[: n * n_lanes]
        real = (np.arange(n_lanes) < clusters.filled[:n, None]).ravel()
        of_rows = sums.of_rows[: n * n_lanes][real]
        energies[atom[real]] += of_rows[:, 0]
        virials[atom[real]] += of_rows[:, 1:]
        first = self.list.domains.first
        window = self.list.domains.window
        owner = self.list.ghosts.owner
        of_lanes = sums.of_lanes.reshape(-1, SUMS, n_lanes)[: int(window[-1])]
        windows = zip(first, np.diff(window), strict=True)
        owners = np.concatenate([owner[start : start + size] for start, size in windows])
        atoms = atom.reshape(-1, n_lanes)[owners]
        np.add.at(energies, atoms, of_lanes[:, 0])
        np.add.at(virials, atoms, of_lanes[:, 1:].transpose(0, 2, 1))

    @property
    def summary(self) -> str:  # type: ignore[override]
        """The list, for the report."""
        n_threads = self.pool.n_threads
        if self.list.n_builds:
            n_threads = min(n_threads, self.list.n_domains)
        threads = "1 thread" if n_threads == 1 else f"{n_threads} threads"
        return (
            f"cluster list (skin {self.list.skin:.3g}, {threads}, {described(self._precision)}) "
            f"on vectors of {self.list.lanes.size} × {BITS} bits"
        )

    def _source(
        self, k: int, law: PairLaw, system: System
    ) -> SameForAll | ByLane | ChargesByLane | SlopesByLane | TwoKindsOfRows:
        """Where the loop finds the numbers of law k: the same for all pairs, by species, and with charges by atom.

        The memory of columns is kept as long as the list is.
        """
        slots = len(self.list.ghosts.owner) * self.list.lanes.size
        n_species, _, n_numbers = law.table.shape
        source: SameForAll | ByLane = SameForAll(tuple(law.table[0, 0].tolist()))
        if n_species > 1:
            size = n_numbers * n_species * slots
            numbers = self._memory.array(f"parameters of law {k}", np.float64, size)
            species = self._memory.array(f"species of law {k}", np.int64, slots)
            columns = tuple(numbers.reshape(n_numbers, -1))
            source = ByLane(columns, species, slots, law.table, system.species_index)

        if law.embedding is not None:
            return SlopesByLane(self._memory.array(f"slopes of law {k}", np.float64, slots), source)
        if law.charges is None:
            return source
        charges = self._memory.array(f"charges of law {k}", np.float64, slots)
        full = ChargesByLane(charges, law.charges, source)
        is_bare = bare_species(law)
        if not is_bare.any():
            return full
        bare = ChargesByLane(charges, law.charges, SameForAll((law.cutoff**2,)))
        return TwoKindsOfRows(full, bare, is_bare)


def _key(target: Target) -> tuple[Any, ...]:
    if not target.steps:
        return (target.detail,)
    return target.detail, float(target.steps.per_force[0]), *target.steps[1:]
