"""Threads that work on one task together: each takes the next chunk of it until none is left.

    phase = begin(worker, task)
    chunk = take(worker, phase, n)
    while chunk >= 0:
        ...                                            # the work of this chunk, of n
        chunk = finish_and_take(worker, phase, n)
    phase = barrier(worker, phase)                     # returns when all n chunks are finished, whoever did them

A task is cut into chunks by its size, never by the number of threads, and no two chunks of a phase write to the same
memory. So the result is the same, to the last bit, for any number of threads, and whichever thread did which chunk.

A barrier waits for chunks, not for threads. The calling thread starts at once; the others, which sleep if no task comes
for a millisecond, join when they are awake (some 10 to 80 µs later), or not at all if the machine is busy: they can
make a task faster, never delay it. The work of a chunk must not raise: no other thread would finish that chunk. It may
call stop: after the phase, was_stopped tells all threads. In every task each thread begins with the same chunks, whose
memory is then in its cache, and then helps with the others.
"""

import functools
import os
import threading
from collections import namedtuple
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from minimd.compiled.kernels import DirectCalls, kernel, scalar, shared_kernel

OPEN, STOPPED, FINISHED, CLAIMS = (
    0,
    4,
    8,
    16,
)  # shared counters: the open phase, the last phase in which stop was called, the
# finished chunks of the open phase, and for each chunk the last phase it was taken in
MOST_CHUNKS = 1024
PHASES = 1 << 20  # a task has fewer
PATIENCE = 2000  # reads of a counter before a waiting thread lets others run
# times that a helper lets others run, about a millisecond, before it goes to sleep: waking it takes as long as a small
# task
LINGERING = 1000

HAS_AFFINITY = hasattr(os, "sched_setaffinity")
_sched_getcpu = types.ExternalFunction("sched_getcpu", types.int32())
_let_others_run = types.ExternalFunction("SwitchToThread" if os.name == "nt" else "sched_yield", types.int32())


class Worker(namedtuple("Worker", "counters thread n_threads")):
    """One thread of a pool.

    counters : shared.  thread : its number; 0 is the calling thread.  n_threads : of the pool.
    """


class ThreadPool:
    """The calling thread and n_threads − 1 helpers."""

    def __init__(self, n_threads: int) -> None:
        self.n_threads = n_threads
        self._counters = np.zeros(CLAIMS + MOST_CHUNKS, dtype=np.int64)
        self._worker = Worker(self._counters, 0, n_threads)
        self._busy = threading.Lock()
        self._task: tuple = ()
        self._n_tasks, self._core = 0, -1
        self._wake = [threading.Lock() for _ in range(n_threads - 1)]
        self._helpers = [
            threading.Thread(target=self._help, args=(k, wake), daemon=True)
            for k, wake in enumerate(self._wake, start=1)
        ]
        for wake, helper in zip(self._wake, self._helpers, strict=True):
            wake.acquire()
            helper.start()

    def run(self, kernel: Callable, *arguments: object, calls: DirectCalls | None = None, n_tasks: int = 1) -> Any:
        """kernel(worker, task, *arguments) on this thread, and on the others as soon as they are awake;
        returns what it returns on this one.

        calls : of a caller who always gives this kernel arguments of the same types.
        n_tasks : of a kernel that calls others, one after the other, with the numbers from task on;
            only in a pool of one thread.
        The kernel must call begin and share as described above, and release Python's lock (shared_kernel).
        """
        if calls is not None:
            kernel = calls.code(kernel, self._worker, 0, *arguments)
        with self._busy:
            first, self._n_tasks = self._n_tasks + 1, self._n_tasks + n_tasks
            self._task = (first, kernel, arguments)
            if self._helpers and HAS_AFFINITY:
                self._keep_off_callers_core()
            for wake in self._wake:
                if wake.locked():
                    wake.release()
            try:
                return kernel(self._worker, first, *arguments)
            finally:
                self._task = ()
                self._counters[OPEN] = (
                    self._n_tasks + 1
                ) * PHASES - 1  # nobody waits for this task, even if it has failed

    def address(self, kernel: Callable, *arguments: object, calls: DirectCalls) -> int:
        """The address of a kernel for these arguments, for call_at."""
        return calls.address(kernel, self._worker, 0, *arguments)

    def compile(self, kernel: Callable, *arguments: object, calls: DirectCalls) -> None:
        """Compile a kernel as run would do."""
        calls.code(kernel, self._worker, 0, *arguments)

    def _keep_off_callers_core(self) -> None:
        """Keep helpers off this core: Linux tends to wake a thread on the core of the one that wakes it,
        where it would wait for the task to end."""
        core = _current_core()
        if core != self._core:
            self._core, cores = core, os.sched_getaffinity(0)
            for helper in self._helpers:
                if helper.is_alive() and helper.native_id is not None:
                    with suppress(OSError):  # it may end just now
                        os.sched_setaffinity(helper.native_id, cores - {core} or cores)

    def _help(self, thread: int, wake: threading.Lock) -> None:
        worker = Worker(self._counters, thread, self.n_threads)
        while True:
            wake.acquire()
            if current := self._task:  # else it is too late
                task, kernel, arguments = current
                kernel(worker, task, *arguments)
                del current, kernel, arguments
                _linger(self._counters, task)


def thread_pool(n_threads: int) -> ThreadPool:
    """A pool with this number of threads.

    All simulations of a process share its helpers, and wait for each other, unless there is one thread.
    """
    return ThreadPool(1) if n_threads == 1 else _shared_pool(n_threads)


@functools.cache
def _shared_pool(n_threads: int) -> ThreadPool:
    return ThreadPool(n_threads)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_shared_pool.cache_clear)  # a child process has none of its parent's threads


@scalar
def begin(worker, task):
    """The first phase of a task; the calling thread opens it, and the others wait for that.

    So no thread is ever ahead of the open phase.
    """
    phase = task * PHASES
    if worker.thread == 0:
        _exchange(worker.counters, OPEN, phase)
    reads = 0
    while _read(worker.counters, OPEN) < phase:
        reads += 1
        if reads > PATIENCE:
            _let_others_run()
    return phase


@scalar
def take(worker, phase, n):
    """The number of a chunk of this phase that no thread has taken yet; −1 if there is none."""
    first = worker.thread * n // worker.n_threads
    if _read(worker.counters, OPEN) == phase:
        for k in range(n):
            chunk = first + k if first + k < n else first + k - n
            taken = _read(worker.counters, CLAIMS + chunk)
            if taken < phase and _replace(worker.counters, CLAIMS + chunk, taken, phase) == taken:
                return chunk
    return -1


@scalar
def finish_and_take(worker, phase, n):
    """Count a chunk as finished, and take the next. The thread that finishes the last chunk opens the next phase."""
    if _add(worker.counters, FINISHED, 1) == n - 1:
        _exchange(worker.counters, FINISHED, 0)
        _exchange(worker.counters, OPEN, phase + 1)
        return -1
    return take(worker, phase, n)


@scalar
def barrier(worker, phase):
    """Wait as long as this phase is open, then return the next phase.

    If another phase is open, a helper does not wait.
    """
    reads = 0
    while _read(worker.counters, OPEN) == phase:
        reads += 1
        if reads > PATIENCE:
            _let_others_run()
    return phase + 1


@scalar
def stop(worker, phase):
    """Called in a chunk: the work of the task ends with this phase, see was_stopped."""
    _exchange(worker.counters, STOPPED, phase)


@scalar
def was_stopped(worker, phase):
    """Whether a chunk of this phase called stop.

    Asked after its barrier, it gives all threads the same answer, however late they are.
    """
    return _read(worker.counters, STOPPED) == phase


def _at(counters, emit: Callable) -> Callable:
    """The code generator of an intrinsic that changes a counter by emit(builder, address, *numbers)."""

    def generate(context, builder, signature, arguments):
        data = context.make_array(counters)(context, builder, arguments[0]).data
        return emit(builder, builder.gep(data, [arguments[1]]), *arguments[2:])

    return generate


def _atomic(name: str):
    """An intrinsic (counters, place, number) that changes a counter in one step and returns what it was."""

    @intrinsic
    def change(_context, counters, place, number):
        emit = _at(counters, lambda builder, address, number: builder.atomic_rmw(name, address, number, "seq_cst"))
        return types.int64(counters, types.intp, types.int64), emit

    return change


_add, _exchange = _atomic("add"), _atomic("xchg")


@intrinsic
def _read(_context, counters, place):
    """The present number of a counter, whichever thread wrote it."""
    return types.int64(counters, types.intp), _at(
        counters, lambda builder, address: builder.load_atomic(address, "seq_cst", 8)
    )


@intrinsic
def _replace(_context, counters, place, expected, number):
    """Write a number if the counter still has the expected one; returns what it was."""
    emit = _at(
        counters, lambda builder, *values: builder.extract_value(builder.cmpxchg(*values, "seq_cst", "seq_cst"), 0)
    )
    return types.int64(counters, types.intp, types.int64, types.int64), emit


@shared_kernel
def _linger(counters, task):
    """Stay awake for a moment after a task: in a run of steps the next one begins soon."""
    reads = 0
    while reads < LINGERING * PATIENCE and _read(counters, OPEN) < (task + 1) * PHASES:
        reads += 1
        if reads % PATIENCE == 0:
            _let_others_run()


@kernel
def _current_core():
    """The number of the core that runs this."""
    return _sched_getcpu()
