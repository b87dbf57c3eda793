"""A process that is killed at its k-th write to the disk."""

import os
import signal
import time
import traceback

TOO_MANY, FAILED = 254, 255  # exit codes of the child
CALLS = ("pwrite", "fsync", "ftruncate", "replace", "link", "unlink", "open")  # of os, by which minimd changes files


def killed_at(k, work):
    """Do work in a child process that dies, as by kill -9, before its k-th change of a file; how many it made if it lives to the end, else None."""
    child = os.fork()
    if child == 0:
        n_changes, status = _die_at(k), FAILED
        try:
            work()
            status = min(n_changes[0], TOO_MANY)
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(status)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return None
    assert os.WEXITSTATUS(status) < TOO_MANY, "it failed, or made too many changes to count"
    return os.WEXITSTATUS(status)


def killed_after(seconds, work):
    """Do work in a child process, and kill it after some seconds; whether it was still at work."""
    child = _at_work(work)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    time.sleep(0.05)  # children of its own die a moment later
    return os.WIFSIGNALED(status)


def seconds_of(work):
    """How long a child process takes to do work."""
    start = time.perf_counter()
    os.waitpid(_at_work(work), 0)
    return time.perf_counter() - start


def _at_work(work):
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


def _die_at(k):
    """Counts changes of files by this process; its children, which only read, live on."""
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
    return n_changes
