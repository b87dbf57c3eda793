"""MDAnalysis' reader of H5MD, with frames turned to fit the cell."""

from typing import Any

from MDAnalysis.coordinates.H5MD import H5MDReader
from MDAnalysis.lib.util import store_init_arguments

from minimd.files.h5md_opening import admitted
from minimd.files.turned_cell import Turn


class RunReader(H5MDReader):
    """Frames of a minimd file.  turn : of its cell, or None. A transformation could do the same, but it can be set only once."""

    @store_init_arguments
    def __init__(self, filename: str, turn: Turn | None = None, **kwargs: Any) -> None:
        self._turn = turn
        super().__init__(filename, **kwargs)

    def open_trajectory(self) -> None:
        """Called by MDAnalysis, which opens the file itself; see admitted."""
        super().open_trajectory()
        admitted(self._file, self.filename)

    def _read_frame(self, frame: int) -> Any:
        ts = super()._read_frame(frame)
        return ts if self._turn is None else self._turn(ts)
