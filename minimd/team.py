"""Threads that work on one task together: each takes the next share of it until none is left.

    phase = begin(team, thread, task)
    share = take(team, phase, n)
    while share >= 0:
        ...                                    # the work of this share
        share = finish_and_take(team, phase, n)
    phase = wait(team, phase)                  # until all n shares are finished, by whomever

A task is cut into shares by its size, never by the number of threads, and no two shares of a phase write to the same
memory: so the result has the same bits however many threads there are, and whoever did what.

Nobody waits for a thread, only for shares. The thread that calls starts at once; the others sleep between tasks and join when they
are awake (some 20 µs), or not at all if the machine has other things to do: they can make a task faster, never hold it up.
"""

import functools
import os
import threading
from collections.abc import Callable

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from minimd.compiling import scalar

TICKET, FINISHED, PLACES = 0, 8, 16  # two shared counters, each on a cache line of its own
SHARE_BITS = 16  # a ticket is phase · 2¹⁶ + the next share
PHASES = 8  # at most, in one task
PATIENCE = 2000  # looks at a ticket before a waiting thread lets others run

_let_others_run = types.ExternalFunction("SwitchToThread" if os.name == "nt" else "sched_yield", types.int32())


class Team:
    """The calling thread and n_threads − 1 helpers."""

    def __init__(self, n_threads: int) -> None:
        self.n_threads = n_threads
        self._counters = np.zeros(PLACES, dtype=np.int64)
        self._busy = threading.Lock()
        self._n_tasks = 0
        self._task: tuple = ()
        self._wake = [threading.Lock() for _ in range(n_threads - 1)]
        for thread, wake in enumerate(self._wake, start=1):
            wake.acquire()
            threading.Thread(target=self._help, args=(thread, wake), name=f"minimd-{thread}", daemon=True).start()

    def run(self, kernel: Callable, *arguments: object) -> None:
        """kernel(counters, thread, task, *arguments) on this thread, and on the others as soon as they are awake.

        The kernel must begin, take, finish and wait as described above, and release Python's lock (compiling.shared_kernel).
        """
        with self._busy:
            self._n_tasks += 1
            self._task = (self._n_tasks, kernel, arguments)
            for wake in self._wake:
                if wake.locked():
                    wake.release()
            kernel(self._counters, 0, self._n_tasks, *arguments)

    def _help(self, thread: int, wake: threading.Lock) -> None:
        while True:
            wake.acquire()
            task, kernel, arguments = self._task
            kernel(self._counters, thread, task, *arguments)
            del kernel, arguments


@functools.cache
def team_of(n_threads: int) -> Team:
    """The team of so many threads; all simulations of a process share it."""
    return Team(n_threads)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=team_of.cache_clear)  # a child process has none of its parent's threads


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@scalar
def begin(counters, thread, task):
    """The first phase of a task; the calling thread, number 0, opens it."""
    phase = task * PHASES
    if thread == 0:
        _exchange(counters, TICKET, phase << SHARE_BITS)
    return phase


@scalar
def take(counters, phase, n):
    """The number of the next share of a phase, −1 if all n are taken."""
    ticket = _read(counters, TICKET)
    while ticket >> SHARE_BITS == phase and ticket & ((1 << SHARE_BITS) - 1) < n:
        found = _replace(counters, TICKET, ticket, ticket + 1)
        if found == ticket:
            return ticket & ((1 << SHARE_BITS) - 1)
        ticket = found
    return -1


@scalar
def finish_and_take(counters, phase, n):
    """Tell that a share is done, and take the next. Whoever finishes the last of a phase opens the next phase."""
    if _add(counters, FINISHED, 1) == n - 1:
        _exchange(counters, FINISHED, 0)
        _exchange(counters, TICKET, (phase + 1) << SHARE_BITS)
        return -1
    return take(counters, phase, n)


@scalar
def wait(counters, phase):
    """Wait until a phase is over; returns the next."""
    looks = 0
    while _read(counters, TICKET) >> SHARE_BITS == phase:
        looks += 1
        if looks > PATIENCE:
            _let_others_run()
    return phase + 1


def _atomic(name: str):
    """An intrinsic (counters, place, value) that changes a counter in one step and returns what it was."""

    @intrinsic
    def change(_context, counters, place, value):
        def generate(context, builder, signature, arguments):
            return builder.atomic_rmw(name, _address(context, builder, signature, arguments), arguments[2], "seq_cst")

        return types.int64(counters, types.intp, types.int64), generate

    return change


_add, _exchange = _atomic("add"), _atomic("xchg")


@intrinsic
def _read(_context, counters, place):
    """A counter as it is now, whoever wrote it."""

    def generate(context, builder, signature, arguments):
        return builder.load_atomic(_address(context, builder, signature, arguments), "seq_cst", 8)

    return types.int64(counters, types.intp), generate


@intrinsic
def _replace(_context, counters, place, expected, value):
    """Write a value if the counter is still as expected; returns what it was."""

    def generate(context, builder, signature, arguments):
        pair = builder.cmpxchg(_address(context, builder, signature, arguments), arguments[2], arguments[3], "seq_cst", "seq_cst")
        return builder.extract_value(pair, 0)

    return types.int64(counters, types.intp, types.int64, types.int64), generate


def _address(context, builder, signature, arguments) -> ir.Value:
    data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
    return builder.gep(data, [arguments[1]])
