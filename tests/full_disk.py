"""A disk that is full after some bytes."""

import errno
import os

from h5md_runs import bring_to_disk_every


def fill_the_disk(monkeypatch, after):
    """After so many calls of fsync, three for the first frame and two for each other flush, the disk is full."""
    left, fsync = iter(range(after)), os.fsync

    def syncing(descriptor):
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", syncing)
    bring_to_disk_every(0.0, monkeypatch)
