"""A system that lacks what only Linux, or only POSIX, has. `python tests/elsewhere.py run argon.toml` runs the command
there. As on Windows, a file that is open is neither renamed nor removed."""

import io
import os
import signal
import sys

# of the modules, and of os and signal; Python's own modules need some others
MODULES = ("fcntl", "resource")
CALLS = "fork register_at_fork getuid killpg pread pwrite link O_NOFOLLOW O_NONBLOCK".split()
CALLS += ["sched_getaffinity", "sched_setaffinity"]
SIGNALS = ("SIGHUP", "pthread_sigmask")
HIDDEN = ("/proc", "/dev/fd", "/sys")


def unless_hidden(call):
    def checked(path, *more, **options):
        if str(path).startswith(HIDDEN):
            raise FileNotFoundError(2, "No such file or directory", path)
        return call(path, *more, **options)

    return checked


def unless_open(call, listed=os.listdir, target=os.readlink):
    def checked(path, *more, **options):
        for number in listed("/proc/self/fd"):
            try:
                is_open = target(f"/proc/self/fd/{number}") == os.path.realpath(path)
            except FileNotFoundError:  # that of the list itself
                continue
            if is_open:
                raise PermissionError(13, "The process cannot access the file: it is in use", path)
        return call(path, *more, **options)

    return checked


for place, names in ((os, CALLS), (signal, SIGNALS)):
    for name in names:
        if hasattr(place, name):
            delattr(place, name)
sys.modules.update(dict.fromkeys(MODULES))  # importing None is an ImportError
os.stat, io.open = unless_hidden(os.stat), unless_hidden(io.open)
os.replace, os.rename, os.unlink, os.remove = map(unless_open, (os.replace, os.rename, os.unlink, os.remove))

if __name__ == "__main__":
    from minimd_command import main

    main()
