"""A disk that is full after some bytes."""

import errno
import os


def fill_the_disk(monkeypatch, after):
    """From so many reservations of room on, the disk is full."""
    calls = []

    def full(*_):
        calls.append(1)
        if len(calls) > after:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    monkeypatch.setattr("minimd.files.h5md_writer.SECONDS_BETWEEN_FLUSHES", 0.0)
