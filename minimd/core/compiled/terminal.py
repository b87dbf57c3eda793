"""Standard error, which may be missing, closed, or replaced by an object of the host that has little but `write`."""

import sys
from contextlib import suppress


def tell(line: str) -> None:
    """Print a line on standard error, if somebody can read it."""
    with suppress(Exception):  # whatever an object of the host raises
        if sys.stderr is not None:  # else it would go to standard output
            print(line, file=sys.stderr, flush=True)


def is_terminal() -> bool:
    """Whether standard error is a terminal."""
    try:
        return bool(sys.stderr.isatty())
    except Exception:
        return False
