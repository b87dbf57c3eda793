"""The command on a system without what only Linux, or only POSIX, has: `python tests/elsewhere.py run argon.toml`.
As on Windows, a file that is open is neither renamed nor removed."""

import io
import os
import signal
import sys

CALLS = (
    "fork register_at_fork sched_getaffinity sched_setaffinity getuid killpg pread pwrite link O_NOFOLLOW O_NONBLOCK"
)
MISSING = {os: CALLS.split(), signal: ["SIGHUP", "pthread_sigmask"]}
OPEN = "/proc/self/fd"


def is_hidden(path):
    return str(path).startswith(("/proc", "/dev/fd"))


def is_open(path):
    return os.path.realpath(path) in {os.path.realpath(f"{OPEN}/{number}") for number in os.listdir(OPEN)}


def unless(refused, error, call):
    def checked(path, *more, **options):
        if refused(path):
            raise error(1, "not here", path)
        return call(path, *more, **options)

    return checked


if __name__ == "__main__":
    for place, name in ((place, name) for place, names in MISSING.items() for name in names if hasattr(place, name)):
        delattr(place, name)
    sys.modules.update(dict.fromkeys(("fcntl", "resource")))  # to import None is an ImportError
    os.stat, io.open = (unless(is_hidden, FileNotFoundError, call) for call in (os.stat, io.open))
    for name in ("replace", "rename", "unlink", "remove"):
        setattr(os, name, unless(is_open, PermissionError, getattr(os, name)))
    from minimd_command import main

    main()
