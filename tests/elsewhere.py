"""The command on a system without what only Linux, or only POSIX, has: `python tests/elsewhere.py run argon.toml`.
As on Windows, a file that is open is neither renamed nor removed."""

import io
import os
import signal
import sys

CALLS = (
    "fork register_at_fork sched_getaffinity sched_setaffinity getuid killpg pread pwrite link O_NOFOLLOW O_NONBLOCK"
)
MISSING = [*((os, name) for name in CALLS.split()), (signal, "SIGHUP"), (signal, "pthread_sigmask")]
HIDDEN, OPEN = ("/proc", "/dev/fd"), "/proc/self/fd"


def is_open(path):
    return os.path.realpath(path) in {os.path.realpath(f"{OPEN}/{number}") for number in os.listdir(OPEN)}


def unless(refused, error, call):
    def checked(path, *more, **options):
        if refused(path):
            raise error(2, "not here", path)
        return call(path, *more, **options)

    return checked


if __name__ == "__main__":
    for place, name in MISSING:
        vars(place).pop(name, None)
    sys.modules.update(fcntl=None, resource=None)  # to import None is an ImportError
    for place, name in ((os, "stat"), (io, "open")):
        setattr(place, name, unless(lambda path: str(path).startswith(HIDDEN), FileNotFoundError, getattr(place, name)))
    for name in ("replace", "rename", "unlink", "remove"):
        setattr(os, name, unless(is_open, PermissionError, getattr(os, name)))
    from minimd_command import main

    main()
