"""A disk that is full after some bytes."""

import errno
import os

from h5md_runs import bring_to_disk_every


def fill_the_disk(monkeypatch, after):
    """After so many calls of fsync, three for the first frame and two for each other flush, the disk is full."""
    calls = []

    def full(*_):
        calls.append(1)
        if len(calls) > after:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda descriptor: (full(), fsync(descriptor)))
    bring_to_disk_every(0.0, monkeypatch)
