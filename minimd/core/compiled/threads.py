"""Programs of operations, run by threads that share each of them: every thread takes the next chunk until none is left.

An operation is a compiled function of its data and the number of a chunk. It is cut into chunks by the size of the
scene, never by the number of threads, and no two chunks of it write to the same memory. So the result is the same, to
the last bit, for any number of threads, and whichever thread did which chunk.

The next operation begins when all chunks are finished, whoever did them: threads wait for chunks, not for threads. The
calling thread starts at once; the others, which sleep if no program comes for a millisecond, join when they are awake
(some 10 to 80 µs later), or not at all if the machine is busy: they can make a program faster, never delay it. In each
operation a thread begins with the same chunks, whose memory is then in its cache, and then helps with the others.

Python's own work can go on beside an operation that does not need it: the calling thread comes to that later.
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
from numpy.typing import NDArray

from minimd.core.compiled.by_address import call_at
from minimd.core.compiled.kernels import code_for, kernel, scalar, types_of

# shared counters: the open phase, see _word; the program it belongs to; the finished chunks of the open phase; what its
# operation has answered; and for each chunk the last phase in which it was taken
OPEN = 0
TASK = 1
FINISHED = 8
ANSWER = 9
CLAIMS = 16
MOST_CHUNKS = 1024
BITS = 12  # of the number of an operation, and of its chunks, in the word of a phase
MOST_OPERATIONS = (1 << BITS) - 1
MOST_PHASES = 1 << 38  # of one set of counters: the word of a phase has 63 bits
CODE, DATA, CHUNKS, THEN, OTHERWISE = range(5)  # columns of the table of operations
AT = 0  # place in a course: the next operation
# answers: go on with the operation THEN, or OTHERWISE; Python is wanted
GO_ON = 0
JUMP = -1
PYTHON = 1
PATIENCE = 2000  # reads of a counter before a waiting thread lets others run
# times that a helper lets others run, about a millisecond, before it sleeps: waking it takes as long as a small program
LINGERING = 1000

HAS_AFFINITY = hasattr(os, "sched_setaffinity")
_sched_getcpu = types.ExternalFunction("sched_getcpu", types.int32())
_let_others_run = types.ExternalFunction(
    "SwitchToThread" if os.name == "nt" else "sched_yield", types.int32()
)


class Worker(namedtuple("Worker", "counters thread n_threads")):
    """One thread of a pool.
    counters : shared.
    thread : its number, 0 of the caller.
    n_threads : of the pool."""


def no_counts() -> NDArray[np.int64]:
    """Counters at zero."""
    n_claims = MOST_CHUNKS + 1  # one more for what open_program reserves
    return np.zeros(CLAIMS + n_claims, dtype=np.int64)


class ThreadPool:
    """The calling thread and n_threads − 1 helpers."""

    def __init__(self, n_threads: int) -> None:
        self.n_threads = n_threads
        self._code: Callable | None = None  # of run_operations
        self._busy = threading.Lock()
        self._counters = no_counts()
        self._task: tuple = ()
        self._core = -1
        self._wake: list[threading.Lock] = []
        self._helpers: list[threading.Thread] = []
        for thread in range(1, n_threads):
            wake = threading.Lock()
            wake.acquire()
            helper = threading.Thread(target=self._help, args=(thread, wake), daemon=True)
            self._wake.append(wake)
            self._helpers.append(helper)
            helper.start()

    def run(
        self,
        operations: NDArray[np.int64],
        course: NDArray[np.int64],
        beside: Callable[[], Any] | None = None,
    ) -> int:
        """run_operations on this thread, and on the others as soon as they are awake; returns what it returns.
        beside : what this thread does first; the first operation does not need it, all others may. If it raises, the
            operations are made nonetheless, up to the next of Python."""
        if self._code is None:
            worker = Worker(self._counters, 0, self.n_threads)
            self._code = code_for(run_operations, types_of((worker, 0, operations, course)))
        with self._busy:
            # the number of the program: that of its first phase
            first = (int(self._counters[OPEN]) >> 2 * BITS) + 1
            if first > MOST_PHASES:
                self._counters = no_counts()
                first = 1
            worker = Worker(self._counters, 0, self.n_threads)
            self._task = self._counters, first, self._code, operations, course
            if self._helpers and HAS_AFFINITY:
                self._keep_off_callers_core()
            for wake in self._wake:
                if wake.locked():
                    wake.release()
            try:
                if beside is None:
                    return int(self._code(worker, first, operations, course))
                try:
                    open_program(worker, first, operations, course, 1)
                    beside()
                finally:  # the others are at work, also if it raises
                    answer = int(self._code(worker, first, operations, course))
                return answer
            finally:
                self._task = ()

    def _keep_off_callers_core(self) -> None:
        """Keep helpers off this core: Linux tends to wake a thread on its waker's, where it would wait for its end."""
        core = _current_core()
        if core != self._core:
            self._core = core
            cores = os.sched_getaffinity(0)
            for helper in self._helpers:
                if helper.is_alive() and helper.native_id is not None:
                    with suppress(OSError):  # it may end just now
                        os.sched_setaffinity(helper.native_id, cores - {core} or cores)

    def _help(self, thread: int, wake: threading.Lock) -> None:
        while True:
            wake.acquire()
            current = self._task
            if current:  # else it is too late
                counters, task, code, operations, course = current
                code(Worker(counters, thread, self.n_threads), task, operations, course)
                del current, code, operations, course
                _linger(counters, task)


def thread_pool(n_threads: int) -> ThreadPool:
    """A pool with this number of threads.
    All simulations of a process share its helpers, and wait for each other, unless there is one thread."""
    return ThreadPool(1) if n_threads == 1 else _shared_pool(n_threads)


_shared_pool = functools.cache(ThreadPool)

if hasattr(os, "register_at_fork"):
    # a child process has none of its parent's threads
    os.register_at_fork(after_in_child=_shared_pool.cache_clear)


# of kernels that several threads run at once: they do not hold Python's lock
without_lock = functools.partial(kernel, nogil=True)


@without_lock
def run_operations(worker, task, operations, course):
    """Run operations, from course[AT] on, until one of them answers with a number above 0, or there is none left.

    Returns that answer, or 0; course[AT] is then the operation that gave it, or the number of all operations.
    operations : (n, 5) int64; of each its code (an address), its data (an address), the number of its chunks (0 where
        Python is wanted), and the operations to go on with if it answers GO_ON or JUMP.
    The chunks of an operation answer GO_ON; those that do not must all give the same answer."""
    counters = worker.counters
    if worker.n_threads == 1:
        return _run_alone(operations, course)
    if worker.thread == 0:
        if _read(counters, TASK) != task:
            open_program(worker, task, operations, course, 0)
        else:  # it was opened before, with a chunk that the caller has finished by now
            finish_chunk(worker, operations, course)
    word = _read(counters, OPEN)
    reads = 0
    while word >> 2 * BITS < task:  # a helper may be faster than the calling thread
        word = _read(counters, OPEN)
        reads = _waited(reads)
    while True:
        at = word >> BITS & MOST_OPERATIONS
        n = word & MOST_OPERATIONS
        # read after the word: which is then of this task
        if at == MOST_OPERATIONS or _read(counters, TASK) != task:
            return _read(counters, ANSWER)
        chunk = _take(worker, word, n)
        while chunk >= 0:
            answer = call_at(operations[at, CODE], (operations[at, DATA], chunk))
            if answer != GO_ON:
                _exchange(counters, ANSWER, answer)
            if finish_chunk(worker, operations, course):
                break
            chunk = _take(worker, word, n)
        before = word
        reads = 0
        while word == before:
            word = _read(counters, OPEN)
            reads = _waited(reads)


@without_lock
def open_program(worker, task, operations, course, n_reserved):
    """Let threads begin with the operation course[AT].
    n_reserved : 1 if it ends only after one more chunk, which the calling thread finishes in run_operations; else 0."""
    _exchange(worker.counters, TASK, task)
    _open(worker.counters, task, operations, course, course[AT], GO_ON, n_reserved)


@without_lock
def finish_chunk(worker, operations, course):
    """Note that a chunk of the open phase is finished; whether it was the last one: then the next phase is open."""
    counters = worker.counters
    word = _read(counters, OPEN)
    is_last = _add(counters, FINISHED, 1) == (word & MOST_OPERATIONS) - 1
    if is_last:
        _end_phase(counters, word, operations, course)
    return is_last


@scalar
def _run_alone(operations, course):
    """See run_operations: on one thread."""
    at = course[AT]
    answer = GO_ON
    while answer <= GO_ON and at < operations.shape[0]:
        answer = PYTHON if operations[at, CHUNKS] == 0 else GO_ON
        for chunk in range(operations[at, CHUNKS]):
            reply = call_at(operations[at, CODE], (operations[at, DATA], chunk))
            answer = reply if reply != GO_ON else answer
        if answer <= GO_ON:
            at = operations[at, THEN if answer == GO_ON else OTHERWISE]
    course[AT] = at
    return max(answer, GO_ON)


@scalar
def _end_phase(counters, word, operations, course):
    """What the thread does that finishes the last chunk of a phase: it opens the next one."""
    answer = _read(counters, ANSWER)
    at = word >> BITS & MOST_OPERATIONS
    if answer <= GO_ON:
        at = operations[at, THEN if answer == GO_ON else OTHERWISE]
    _open(counters, (word >> 2 * BITS) + 1, operations, course, at, max(answer, GO_ON), 0)


@scalar
def _open(counters, phase, operations, course, at, answer, n_reserved):
    """Open a phase: that of an operation, or the end of the program.
    The word of a phase holds its number, that of its operation and that of its chunks, so that threads read all three
    at once: a chunk can be taken only as long as the phase is open, since only then some have not been taken in it.
    n_reserved : chunks more, up to one, that nobody takes."""
    n = 0
    if at < operations.shape[0] and answer == GO_ON:
        n = operations[at, CHUNKS]
        answer = PYTHON if n == 0 else GO_ON
    if n == 0:
        course[AT] = at
        at = MOST_OPERATIONS
    _exchange(counters, FINISHED, 0)
    _exchange(counters, ANSWER, answer)
    word = (phase << BITS | at) << BITS | n + n_reserved
    if n_reserved > 0:
        _exchange(counters, CLAIMS + n, word)
    _exchange(counters, OPEN, word)


@scalar
def _take(worker, word, n):
    """The number of a chunk of this phase that no thread has taken yet; −1 if there is none."""
    first = worker.thread * n // worker.n_threads
    if _read(worker.counters, OPEN) == word:
        for k in range(n):
            chunk = first + k if first + k < n else first + k - n
            taken = _read(worker.counters, CLAIMS + chunk)
            if taken < word and _replace(worker.counters, CLAIMS + chunk, taken, word) == taken:
                return chunk
    return -1


@scalar
def _waited(reads):
    """One more read of a counter; others may run after every PATIENCE of them."""
    if reads > PATIENCE:
        _let_others_run()
    return reads + 1


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
        def emit(builder, address, number):
            return builder.atomic_rmw(name, address, number, "seq_cst")

        return types.int64(counters, types.intp, types.int64), _at(counters, emit)

    return change


_add = _atomic("add")
_exchange = _atomic("xchg")


@intrinsic
def _read(_context, counters, place):
    """The present number of a counter, whichever thread wrote it."""
    emit = _at(counters, lambda builder, address: builder.load_atomic(address, "seq_cst", 8))
    return types.int64(counters, types.intp), emit


@intrinsic
def _replace(_context, counters, place, expected, number):
    """Write a number if the counter still has the expected one; returns what it was."""

    def emit(builder, *values):
        return builder.extract_value(builder.cmpxchg(*values, "seq_cst", "seq_cst"), 0)

    return types.int64(counters, types.intp, types.int64, types.int64), _at(counters, emit)


@without_lock
def _linger(counters, task):
    """Stay awake for a moment after a program: in a run of steps the next one begins soon."""
    reads = 0
    while reads < LINGERING * PATIENCE and _read(counters, TASK) == task:
        reads += 1
        if reads % PATIENCE == 0:
            _let_others_run()


@kernel
def _current_core():
    """The number of the core that runs this."""
    return _sched_getcpu()
