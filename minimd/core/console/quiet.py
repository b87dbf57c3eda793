"""Warnings: the line to which one points, and those passed over in one thread alone.

warnings.catch_warnings changes the filters of all threads, and may leave them changed.
"""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

INSIDE = ("minimd", "contextlib")  # packages to whose lines no warning points
IS_QUIET = ContextVar("is_quiet", default=False)


class Here:
    """In place of the regular expression of a filter: it fits all messages of a quiet thread or asynchronous task."""

    def match(self, _message: str) -> bool:
        """Called by the module warnings, in the thread that warns."""
        return IS_QUIET.get()


FILTER: Any = ("ignore", Here(), Warning, None, 0)  # as the module warnings keeps its filters


@contextmanager
def quiet() -> Iterator[None]:
    """Context in which warnings of this thread are passed over; those of other threads are not."""
    filters: Any = warnings.filters
    if filters[:1] != [FILTER]:  # each time: whoever leaves warnings.catch_warnings has removed it
        filters.insert(0, FILTER)
        for place in range(len(filters) - 1, 0, -1):
            if filters[place] is FILTER:
                del filters[place]
    before = IS_QUIET.set(True)
    try:
        yield
    finally:
        IS_QUIET.reset(before)


def warn(words: str) -> None:
    """Warn of something, at the first line outside minimd and contextlib. Where standard error is closed, nobody reads
    it."""
    frame = sys._getframe()
    level = 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in INSIDE:
        frame = frame.f_back
        level += 1
    try:
        warnings.warn(words, stacklevel=level)
    except UserWarning:  # warnings are errors
        raise
    except Exception:  # whatever standard error raises
        return
