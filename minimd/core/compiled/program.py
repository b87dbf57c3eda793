"""A program: operations in a row, some of them made by Python, the others by compiled code on all threads."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, scalar
from minimd.core.compiled.threads import AT, GO_ON, JUMP, MOST_CHUNKS, MOST_OPERATIONS, ThreadPool

__all__ = ["GO_ON", "JUMP"]

# answers of operations: see threads.run_operations; NEEDS_ROOM: memory; BREATHE: Python looks whether to go on
NEEDS_ROOM = 2
BREATHE = 3
NOT_FINITE = 4
OUT_OF_RANGE = 5
CANNOT_KEEP = 6
# atoms, or terms, of which each takes as long: some microseconds, more than a barrier
IN_A_CHUNK = 512


class Operation(NamedTuple):
    """An operation of a program.
    code : address of a kernel (data, chunk) → answer, see operation; 0 where Python is wanted.
    data : its data.
    n_chunks : that it is cut into.
    then, otherwise : the operations to go on with if it answers GO_ON or JUMP, counted from this one.
    python : what Python does at an operation of its own, called without arguments; or, called with an answer above 0,
        about that answer.
    again : the operation to go on with after the latter, counted from this one.
    is_kept : whether its maker keeps the data, as long as the version of the program stays the same; else it does.
    is_long : whether other threads may begin with it while Python is at work on the operation before it, if that
        is_beside.
    is_beside : of Python: whether it, and all that its maker yields before it, neither write what long operations read
        or write, nor read what these write. See side_by_side."""

    code: int
    data: ByAddress | None
    n_chunks: int
    then: int = 1
    otherwise: int = 1
    python: Callable[..., Any] | None = None
    again: int = 0
    is_kept: bool = False
    is_beside: bool = False
    is_long: bool = False


def operation(
    calls: DirectCalls, kernel: Callable, data: ByAddress, n_chunks: int = 1, **more: Any
) -> Operation:
    """An operation of compiled code.
    calls : of a caller who always gives this kernel data of one type."""
    return Operation(calls.address(kernel, data, 0), data, n_chunks, **more)


def in_python(function: Callable[[], Any], **more: Any) -> Operation:
    """An operation of Python."""
    return Operation(0, None, 0, python=function, **more)


def side_by_side(
    first: Iterable[Operation], parts: Iterable[Sequence[Operation]], n_threads: int
) -> Iterator[Operation]:
    """The first operations, then those of the parts.

    With several threads, what the parts have up to Python's work that may go on beside a long operation is made before
    the first long one. On one thread, what it writes would no longer be in the cache where a part goes on.
    """
    ahead: list[Operation] = []
    rest: list[Operation] = []
    for part in parts:
        beside = [k for k, step in enumerate(part) if step.is_beside and n_threads > 1]
        cut = 1 + max(beside, default=-1)
        ahead += part[:cut]
        rest += part[cut:]

    for step in first:
        if step.is_long:
            yield from ahead
            ahead = []
        yield step
    yield from ahead
    yield from rest


def n_chunks_of(n: int) -> int:
    """How many chunks n atoms, or terms, are cut into."""
    return max(1, min(n // IN_A_CHUNK, MOST_CHUNKS))


@scalar
def share_of(chunk, n_chunks, n):
    """The first of the n that belong to a chunk, and the one behind the last."""
    return chunk * n // n_chunks, (chunk + 1) * n // n_chunks


class Program:
    """Operations that are made anew when the memory of their data was replaced.
    make : returns them: always as many, in the same order.
    version : of that memory.
    pool : the threads."""

    def __init__(
        self, make: Callable[[], Iterable[Operation]], version: Callable[[], Any], pool: ThreadPool
    ) -> None:
        self._make = make
        self._version = version
        self._pool = pool
        self._made_for: Any = None
        self._course = np.zeros(1, dtype=np.int64)

    @property
    def is_outdated(self) -> bool:
        """Whether operations must be made anew."""
        return self._version() != self._made_for

    def prepare(self) -> None:
        """Make operations anew if they are outdated, and compile what is not compiled yet."""
        if not self.is_outdated:
            return
        operations = list(self._make())
        if len(operations) >= MOST_OPERATIONS:
            raise ValueError(
                f"a program has up to {MOST_OPERATIONS - 1} operations; this one has {len(operations)}"
            )
        self._rows = np.zeros((len(operations), 5), dtype=np.int64)
        for k, each in enumerate(operations):
            data = 0 if each.data is None else each.data.address
            self._rows[k] = each.code, data, each.n_chunks, k + each.then, k + each.otherwise
            if each.is_kept:
                operations[k] = each._replace(data=None)
        self.operations = operations
        self._made_for = self._version()

    def run(self, first: int = 0) -> None:
        """Make all operations, from the first on; raises what Python's part of them raises."""
        self.prepare()
        course = self._course
        course[AT] = first
        beside = None
        while course[AT] < len(self.operations):
            answer = self._pool.run(self._rows, course, beside)
            beside = None
            if not answer:  # the end is reached
                continue
            current = self.operations[course[AT]]
            if current.python is None:
                raise RuntimeError(f"operation {course[AT]} returned the unknown status {answer}")
            if current.code:
                current.python(answer)
                course[AT] += current.again
            else:
                course[AT] += current.then
                if current.is_beside and self.operations[course[AT]].is_long:
                    beside = current.python
                else:
                    current.python()
            self.prepare()
