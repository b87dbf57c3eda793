"""Pair laws on the plain pair list: one pair after the other, in any cell."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.fixed_point import GridSums
from minimd.compiled.kernels import kernel
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws, skin_for, widest_skin
from minimd.neighbors.pair_list import PairList, check_size
from minimd.potentials.pair_loop import by_species, pair_loop_for
from minimd.potentials.term import FORCES, OwnTerm
from minimd.structure.system import System

ALL_PAIRS_UP_TO = 100  # atoms: up to this, an open scene is faster without a list that has to be rebuilt


class PairListTerm(OwnTerm):
    """Laws on all pairs within their cutoffs, found with one pair list."""

    list: PairList

    def __init__(self, system: System, laws: PairLaws, options: Options, displacement: float = 0.0) -> None:
        n, cutoff = len(system), laws.cutoff
        if not system.cell.is_periodic and n <= ALL_PAIRS_UP_TO:
            cutoff = np.inf
        skin = skin_for(system, laws, options, displacement) if cutoff < np.inf else 0.0
        check_size(system, cutoff, skin)
        self._in_users_order = cutoff == np.inf
        self.summary = "all pairs" if self._in_users_order else f"pair list (skin {skin:.3g})"
        self.list, self.widest_skin = PairList(n, cutoff, skin, laws.excluded), widest_skin(system, laws)
        self._options = replace(options, skin=skin)
        self._laws, self._loops = laws, [pair_loop_for(one.law) for one in laws.members]
        self._parameters_of = 0  # which build of the list
        self._positions, self._sums = (
            np.empty((n, 3)),
            (np.empty((n, 3)), np.empty(n), np.empty((n, 6))),
        )  # forces of floats or of whole numbers

    def follow(self, system: System) -> bool:
        """See Term; a cell that now has room for clusters, or no longer has room for the list, needs another list."""
        self.widest_skin = widest_skin(system, self._laws)
        if self.list.skin > self.widest_skin or self._laws.fit_clusters(system, self._options, 0.0):
            return False
        self.list.follow(system.cell)
        return True

    def add_to(self, system: System, detail: int, sums: Any) -> None:
        """See Term."""
        self.list.update(system.positions, system.cell)
        if self._parameters_of != self.list.n_builds:
            species = system.species_index[self.list.order]
            self._parameters, self._parameters_of = (
                [by_species(one.table, species) for one in self._laws.members],
                self.list.n_builds,
            )
        if self._in_users_order:
            self._run_loops(system.positions, detail, sums)
            return
        local = self._local_sums(sums)
        gather(system.positions, self.list.order, self.list.offsets, self._positions, local[0])
        if detail != FORCES:
            local[1][:], local[2][:] = 0.0, 0.0
        self._run_loops(self._positions, detail, local)
        scatter(local[0], self.list.order, sums[0])
        if detail != FORCES:
            sums[1][self.list.order] += local[1]
            sums[2][self.list.order] += local[2]

    def _local_sums(self, sums: Any) -> Any:
        """Accumulators in the order of the list, of the kind of sums."""
        if self._sums[0].dtype != sums[0].dtype:
            self._sums = (np.empty(sums[0].shape, sums[0].dtype), *self._sums[1:])
        return (
            sums._replace(impulses=self._sums[0], energies=self._sums[1], virials=self._sums[2])
            if isinstance(sums, GridSums)
            else self._sums
        )

    def _run_loops(self, positions: NDArray, detail: int, sums: Any) -> None:
        for one, loop, parameters in zip(self._laws.members, self._loops, self._parameters, strict=True):
            loop(positions, self.list.pairs, one.law, parameters, detail, sums)

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return (["neighbor list (all pairs)"] if self._in_users_order else []) + self._laws.skipped()


@kernel
def gather(positions, order, offsets, local_positions, local_forces):
    """local_positions = positions[order] + offsets, local_forces = 0, in the order of the list. All (N, 3)."""
    for k in range(order.size):
        for c in range(3):
            local_positions[k, c] = positions[order[k], c] + offsets[k, c]
            local_forces[k, c] = 0


@kernel
def scatter(local_forces, order, forces):
    """forces[order] += local_forces, both (N, 3) [energy/length]."""
    for k in range(order.size):
        for c in range(3):
            forces[order[k], c] += local_forces[k, c]
