"""Threads that work on one task together: each takes the next share of it until none is left.

    phase = begin(me, task)
    share = take(me, phase, n)
    while share >= 0:
        ...                                    # the work of this share
        share = finish_and_take(me, phase, n)
    phase = wait(me, phase)                    # until all n shares are finished, by whomever

A task is cut into shares by its size, never by the number of threads, and no two shares of a phase write to the same
memory: so the result has the same bits however many threads there are, and whoever did what.

Nobody waits for a thread, only for shares. The thread that calls starts at once; the others sleep between tasks and join when they
are awake (some 20 µs), or not at all if the machine has other things to do: they can make a task faster, never hold it up.
Between take and finish nothing may raise: nobody else would finish that share.
Each begins with shares of its own, the same ones every time, whose memory is near it, and then helps the others.
"""

import functools
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from minimd.compiled.kernels import kernel, scalar, shared_kernel

OPEN, FINISHED, CLAIMS = 0, 8, 16  # shared counters: the phase at work, its finished shares, and for each share the last phase it was taken in
MOST_SHARES = 1024
PHASES = 8  # a task has fewer
PATIENCE = 2000  # looks at a counter before a waiting thread lets others run
LINGERING = 100_000  # looks, about 100 µs, before a helper goes to sleep: waking it takes as long as a small task

HAS_AFFINITY = hasattr(os, "sched_setaffinity")
_let_others_run = types.ExternalFunction("SwitchToThread" if os.name == "nt" else "sched_yield", types.int32())


class Worker(NamedTuple):
    """One of a team. counters : shared.  thread : its number; 0 is the caller.  n_threads : of the team."""

    counters: Any
    thread: int
    n_threads: int


class ThreadPool:
    """The calling thread and n_threads − 1 helpers."""

    def __init__(self, n_threads: int) -> None:
        self.n_threads = n_threads
        self._counters = np.zeros(CLAIMS + MOST_SHARES, dtype=np.int64)
        self._busy = threading.Lock()
        self._n_tasks = 0
        self._task: tuple = ()
        self._core = -1
        self._wake = [threading.Lock() for _ in range(n_threads - 1)]
        self._helpers = [threading.Thread(target=self._help, args=(k, wake), daemon=True) for k, wake in enumerate(self._wake, start=1)]
        for wake, helper in zip(self._wake, self._helpers, strict=True):
            wake.acquire()
            helper.start()

    def run(self, kernel: Callable, *arguments: object) -> None:
        """kernel(me, task, *arguments) on this thread, and on the others as soon as they are awake.

        The kernel must begin, take, finish and wait as described above, and release Python's lock (compiling.shared_kernel).
        """
        with self._busy:
            self._n_tasks += 1
            self._task = (self._n_tasks, kernel, arguments)
            if self._helpers and HAS_AFFINITY:
                self._keep_off_callers_core()
            for wake in self._wake:
                if wake.locked():
                    wake.release()
            try:
                kernel(Worker(self._counters, 0, self.n_threads), self._n_tasks, *arguments)
            finally:
                self._task = ()

    def _keep_off_callers_core(self) -> None:
        """Linux likes to wake a thread on the core of the one that wakes it, where it would wait for the end of the task."""
        core = _current_core()
        if core != self._core:
            self._core, cores = core, os.sched_getaffinity(0)
            for helper in self._helpers:
                if helper.is_alive() and helper.native_id is not None:
                    with suppress(OSError):  # it may end just now
                        os.sched_setaffinity(helper.native_id, cores - {core} or cores)

    def _help(self, thread: int, wake: threading.Lock) -> None:
        me = Worker(self._counters, thread, self.n_threads)
        while True:
            wake.acquire()
            current = self._task
            if not current:
                continue  # too late
            task, kernel, arguments = current
            kernel(me, task, *arguments)
            del current, kernel, arguments
            _linger(self._counters, task)


@functools.cache
def thread_pool(n_threads: int) -> ThreadPool:
    """The team of so many threads; all simulations of a process share it."""
    return ThreadPool(n_threads)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=thread_pool.cache_clear)  # a child process has none of its parent's threads


@scalar
def begin(me, task):
    """The first phase of a task; the calling thread opens it."""
    phase = task * PHASES
    if me.thread == 0:
        _exchange(me.counters, OPEN, phase)
    return phase


@scalar
def take(me, phase, n):
    """The number of a share of a phase that nobody has taken yet; −1 if there is none."""
    first = me.thread * n // me.n_threads
    if _read(me.counters, OPEN) == phase:
        for k in range(n):
            share = first + k if first + k < n else first + k - n
            taken = _read(me.counters, CLAIMS + share)
            if taken < phase and _replace(me.counters, CLAIMS + share, taken, phase) == taken:
                return share
    return -1


@scalar
def finish_and_take(me, phase, n):
    """Tell that a share is done, and take the next. Whoever finishes the last of a phase opens the next phase."""
    if _add(me.counters, FINISHED, 1) == n - 1:
        _exchange(me.counters, FINISHED, 0)
        _exchange(me.counters, OPEN, phase + 1)
        return -1
    return take(me, phase, n)


@scalar
def wait(me, phase):
    """Wait until a phase is over, not at all if it is not the one at work (a helper too early or too late); returns the next."""
    looks = 0
    while _read(me.counters, OPEN) == phase:
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


@shared_kernel
def _linger(counters, task):
    """Stay awake for a moment after a task: in a run of steps the next one begins soon."""
    looks = 0
    while looks < LINGERING and _read(counters, OPEN) < (task + 1) * PHASES:
        looks += 1


_sched_getcpu = types.ExternalFunction("sched_getcpu", types.int32())


@kernel
def _current_core():
    """The number of the core that runs this."""
    return _sched_getcpu()
