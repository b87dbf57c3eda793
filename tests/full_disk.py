"""A disk that is full after some bytes."""

import errno
import os


def fill_the_disk(monkeypatch, after):
    """After so many calls of fsync, two for the first frame and three for each other flush, the disk is full."""
    calls = []

    def full(*_):
        calls.append(1)
        if len(calls) > after:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda descriptor: (full(), fsync(descriptor)))
    monkeypatch.setattr("minimd.files.h5md_writer.SECONDS_BETWEEN_FLUSHES", 0.0)
