"""Processes that are killed at work."""

import os
import signal
import traceback

CALLS = ("pwrite", "fsync", "ftruncate", "replace", "link", "unlink", "open")  # of os, by which minimd changes files


def killed_at(k, work):
    """Do work in a child process that dies, as by kill -9, before its k-th change of a file; None if it was killed."""
    child = os.fork()
    if child == 0:
        signal.alarm(300)  # it ends, too, where the tests were ended before it
        try:
            _die_at(k)
            work()
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    status = os.waitpid(child, 0)[1]
    return None if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)


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
