"""Components of constraints shared out among threads: no two of them have an atom in common.

A solver is a function solver(first, last, *arguments) that treats components first to last − 1. It is named by a marker, a
NamedTuple class that @type_of(solver) ties to it, so that the compiled kernel is found again by the next process.
"""

from typing import Any

import numpy as np
from numba.core import types
from numba.extending import overload

from minimd.compiled.kernels import shared_kernel
from minimd.compiled.threads import MOST_CHUNKS, ThreadPool, barrier, begin, finish_and_take, take, thread_pool

CONSTRAINTS_IN_A_SHARE = 500  # at least: a share of work must be worth handing out


class Crew:
    """A team for components with so many constraints in all, with no more threads than there is work for."""

    def __init__(self, n_components: int, n_constraints: int, most_threads: int) -> None:
        self.n_components, n_shares = n_components, max(1, min(n_components, n_constraints // CONSTRAINTS_IN_A_SHARE, MOST_CHUNKS))
        self._team: ThreadPool = thread_pool(min(most_threads, n_shares))
        self._answers = np.zeros(n_shares, dtype=np.int64)

    def run(self, solver: tuple, *arguments: Any) -> int:
        """The worst answer of a solver: that of the first components that failed, negative, or else the largest."""
        self._team.run(share_out, self._answers, solver, self.n_components, arguments)
        failed = self._answers[self._answers < 0]
        return int(failed[0] if failed.size else self._answers.max())


@shared_kernel
def share_out(me, task, answers, solver, n, arguments):
    """answers[k] = what the solver returns for the k-th share of n components."""
    n_shares = answers.size
    phase = begin(me, task)
    share = take(me, phase, n_shares)
    while share >= 0:
        answers[share] = solve_some(solver, share * n // n_shares, (share + 1) * n // n_shares, arguments)
        share = finish_and_take(me, phase, n_shares)
    barrier(me, phase)


def solve_some(solver, first, last, arguments):
    """The answer of the solver that a marker names, for components first to last − 1."""
    return type(solver).formula.py_func(first, last, *arguments)


@overload(solve_some)
def _solve_some(solver, first, last, arguments):
    if not isinstance(solver, types.BaseNamedTuple):
        return None
    function = solver.instance_class.formula
    return lambda solver, first, last, arguments: function(first, last, *arguments)
