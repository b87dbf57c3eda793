"""Frames that wait to be written, in memory that is reused:
allocating new memory would take longer than copying the frames."""

import numpy as np

from minimd.engine.record import Frame
from minimd.files.h5md_schema import Column

BLOCK_BYTES, MOST_FRAMES = 32 * 1024**2, 4096


class FrameBlock:
    """Entries of the series of a file, for some frames.

    columns : of the file.  frame : an example of the frames to come.  n_frames : number of frames in the block.
    """

    def __init__(self, columns: list[Column], frame: Frame) -> None:
        entries = {column.path: np.asarray(column.entry(frame)) for column in columns}
        capacity = int(np.clip(BLOCK_BYTES // sum(entry.nbytes for entry in entries.values()), 1, MOST_FRAMES))
        self.n_frames, self._columns, self._capacity = 0, columns, capacity
        self._entries = {path: np.empty((capacity, *entry.shape), entry.dtype) for path, entry in entries.items()}

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another frame."""
        return self.n_frames == self._capacity

    def take(self, frame: Frame) -> None:
        """Copy the entries of a frame."""
        for column in self._columns:
            self._entries[column.path][self.n_frames] = column.entry(frame)
        self.n_frames += 1

    def entries(self) -> dict[str, np.ndarray]:
        """(n_frames, ...) for each series, by its path."""
        return {path: entries[: self.n_frames] for path, entries in self._entries.items()}

    def clear(self) -> None:
        """Remove all frames."""
        self.n_frames = 0
