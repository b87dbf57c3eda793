"""Where a warning points to: the line of the user, however deep in minimd it arises."""

import sys


def outside_minimd() -> int:
    """The stacklevel, for a warning of the calling function, of the first frame outside minimd and contextlib."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in ("minimd", "contextlib"):
        frame, level = frame.f_back, level + 1
    return level
