"""Components of constraints on several threads: no two of them have an atom in common.

A solver is a function solver(first, last, *arguments) that treats components first to last − 1. It is named by a marker, a
NamedTuple class that type_of(solver) ties to it, so that the next process finds the compiled kernel in the cache.
"""

from typing import Any

import numpy as np
from numba.core import types
from numba.extending import overload

from minimd.compiled.kernels import shared_kernel
from minimd.compiled.threads import MOST_CHUNKS, ThreadPool, barrier, begin, finish_and_take, take, thread_pool
from minimd.constraints.vectors import Atoms

CONSTRAINTS_IN_A_CHUNK = 500  # at least, some ten microseconds of work: more than it takes to wake a thread


class SolverPool:
    """Runs solvers on the components of a group, cut into chunks whose number follows from the constraints alone, on several threads."""

    def __init__(self, n_components: int, n_constraints: int, most_threads: int) -> None:
        self.n_components, n_chunks = n_components, max(1, min(n_components, n_constraints // CONSTRAINTS_IN_A_CHUNK, MOST_CHUNKS))
        self._threads: ThreadPool = thread_pool(min(most_threads, n_chunks))
        self._answers = np.zeros(n_chunks, dtype=np.int64)

    def run(self, solver: tuple, atoms: tuple, *arguments: Any) -> int:
        """The worst answer of a solver: that of the first components that failed, negative, or else the largest.

        atoms : the fields of Atoms, of which compiled code makes one: a plain tuple is a microsecond faster to pass.
        """
        self._threads.run(run_chunks, self._answers, solver, self.n_components, atoms, arguments)
        failed = self._answers[self._answers < 0]
        return int(failed[0] if failed.size else self._answers.max())


@shared_kernel
def run_chunks(me, task, answers, solver, n, atoms, arguments):
    """answers[k] = what the solver returns for the k-th chunk of n components."""
    n_chunks = answers.size
    phase = begin(me, task)
    chunk = take(me, phase, n_chunks)
    while chunk >= 0:
        answers[chunk] = solve_some(solver, chunk * n // n_chunks, (chunk + 1) * n // n_chunks, Atoms(*atoms), arguments)
        chunk = finish_and_take(me, phase, n_chunks)
    barrier(me, phase)


def solve_some(solver, first, last, atoms, arguments):
    """The answer of the solver that a marker names, for components first to last − 1."""
    return type(solver).formula.py_func(first, last, atoms, *arguments)


@overload(solve_some)
def _solve_some(solver, first, last, atoms, arguments):
    if not isinstance(solver, types.BaseNamedTuple):
        return None
    function = solver.instance_class.formula
    return lambda solver, first, last, atoms, arguments: function(first, last, atoms, *arguments)
