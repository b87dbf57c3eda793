"""Pair laws on the plain pair list: one pair after the other, in any cell."""

from collections import namedtuple
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, Operation, operation
from minimd.core.forces.options import Options
from minimd.core.forces.pair_laws import ListTerm, PairLaws, skin_for
from minimd.core.neighbors.pair_list import PairList, check_size, is_in_reach
from minimd.core.potentials.law import loop_for
from minimd.core.potentials.pair_loop import PairWork, add_pair_forces, source_for
from minimd.core.potentials.term import PER_ATOM, TOTALS, Target
from minimd.core.structure.system import System

NONE = np.zeros(0)
# atoms: up to this, an open scene is faster without a list that has to be rebuilt
ALL_PAIRS_UP_TO = 100


class Local(ByAddress, namedtuple("Local", "positions forces order offsets own_positions sums")):
    """Atoms in the order of the list.
    positions, forces : (N, 3).
    order, offsets : see PairList.

    own_positions : (N, 3) = positions[order] + offsets.
    sums : forces (N, 3), energies (N,) and virials (N, 6).
    """


@called_kernel
def gather_atoms(local, _chunk):
    """Positions into the order of the list; sums = 0.

    local : Local; own_positions and sums are overwritten.
    """
    positions, _, order, offsets, own, (forces, energies, virials) = local

    for k in range(order.size):
        for c in range(3):
            own[k, c] = positions[order[k], c] + offsets[k, c]
            forces[k, c] = 0
        energies[k] = 0.0
        for c in range(virials.shape[1]):
            virials[k, c] = 0.0

    return GO_ON


@called_kernel
def scatter_forces(local, _chunk):
    """forces[order] += those of the sums.

    local : Local; forces grow.
    """
    _, forces, order, _, _, (own, _, _) = local
    for k in range(order.size):
        for c in range(3):
            forces[order[k], c] += own[k, c]
    return GO_ON


class PairListTerm(ListTerm):
    """Laws on all pairs within their cutoffs, found with one pair list."""

    list: PairList

    def __init__(
        self, system: System, laws: PairLaws, options: Options, displacement: float = 0.0
    ) -> None:
        super().__init__(system, laws)
        n = len(system)
        cutoff = laws.cutoff
        if not system.cell.is_periodic and n <= ALL_PAIRS_UP_TO:
            cutoff = np.inf
        skin = skin_for(system, laws, options, displacement) if cutoff < np.inf else 0.0
        check_size(system, cutoff, skin)
        self.summary = "all pairs" if cutoff == np.inf else f"pair list (skin {skin:.3g})"
        self.list = PairList(n, cutoff, skin, laws.excluded)
        self._options = replace(options, skin=skin)
        self._loops = [loop_for(add_pair_forces, member.law) for member in laws.members]
        self._positions = np.empty((n, 3))
        self._energies = np.empty(n)
        self._virials = np.empty((n, 6))
        self._calls = [DirectCalls() for _ in self._loops]

    def suits(self, system: System) -> bool:
        """See ListTerm: a cell that now has room for clusters has another list."""
        return not self._pair_laws.fit_clusters(system, self._options, 0.0)

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        if self.list.n_builds == 0:
            self._update(system)

        def update(_answer: int) -> None:
            self._update(system)

        order = self.list.order
        sums = np.zeros_like(target.forces), self._energies, self._virials
        atoms = (system.positions, target.forces, order, self.list.offsets, self._positions)
        local = Local(*atoms, sums)
        pairs = (self._positions, self.list.pairs)
        output = (target.steps, target.detail, sums)
        first = self._calls[0]
        yield operation(first, is_in_reach, self.list.reach, python=update)
        yield operation(first, gather_atoms, local)
        laws = zip(self._calls, self._loops, self._pair_laws.members, self._passes, strict=True)
        for calls, loop, member, passes in laws:
            slopes = NONE if passes is None else passes.slopes
            source = source_for(member, system, order, slopes)
            if passes is not None:
                yield from passes.on_pairs(*pairs, source, order)
            yield operation(calls, loop, PairWork(*pairs, member.law, source, *output))
        yield operation(first, scatter_forces, local)

    def _update(self, system: System) -> None:
        self.list.update(system.positions, system.cell)
        self.list.ready(system.positions, system.cell)

    def collect(self, target: Target) -> None:
        """See Term."""
        super().collect(target)
        if target.detail == TOTALS:
            target.energies[0] += self._energies.sum()
            target.virials[0] += self._virials.sum(axis=0)
        elif target.detail == PER_ATOM:
            target.energies[self.list.order] += self._energies
            target.virials[self.list.order] += self._virials

    def skipped(self) -> Iterable[str]:
        """See Term."""
        absent = ["neighbor list (all pairs)"] if self.list.cutoff == np.inf else []
        return [*absent, *super().skipped()]
