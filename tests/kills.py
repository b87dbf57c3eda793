"""Processes that are killed at work."""

import os
import signal
import time
import traceback

CALLS = ("pwrite", "fsync", "ftruncate", "replace", "link", "unlink", "open")  # of os, by which minimd changes files


def at_work(work):
    """The number of a child process that does work."""
    child = os.fork()
    if child == 0:
        signal.alarm(300)  # it ends, too, where the tests were ended before it
        try:
            work()
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    return child


def killed_at(k, work):
    """Do work in a child process that dies, as by kill -9, before its k-th change of a file; None if it was killed."""
    child = at_work(lambda: (_die_at(k), work()))
    status = os.waitpid(child, 0)[1]
    return None if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)


def killed_after(seconds, work):
    """Do work in a child process, and kill it after some seconds; whether it was still at work."""
    child = at_work(work)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    time.sleep(0.05)  # children of its own die a moment later
    return os.WIFSIGNALED(status)


def _die_at(k):
    """Die at the k-th change of a file by this process; its children, which only read, live on."""
    n_changes, process = [0], os.getpid()

    def counted(call):
        def changed(*arguments, **options):
            n_changes[0] += 1
            if n_changes[0] == k and os.getpid() == process:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments, **options)

        return changed

    for name in CALLS:
        setattr(os, name, counted(getattr(os, name)))
