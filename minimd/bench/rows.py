"""What was measured, row by row, and the ratios between rows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MINIMD, MELT = "minimd", "melt"


class Row(NamedTuple):
    """One engine with one scene.

    speeds : (R,) atom-steps per second in each turn.  n_pairs : in range, as a mean of start and end; None if not counted.
    bytes_per_atom : None if not measured.
    """

    engine: str
    threads: int
    precision: str
    scene: str
    n_atoms: int
    speeds: NDArray[np.float64]
    n_pairs: float | None = None
    bytes_per_atom: float | None = None

    @property
    def is_minimd(self) -> bool:
        """False for a peer."""
        return self.engine == MINIMD

    @property
    def pair_speeds(self) -> NDArray[np.float64] | None:
        """(R,) pairs in range, times steps, per second."""
        return None if self.n_pairs is None else self.speeds * self.n_pairs / self.n_atoms


def faster_than_peer(rows: Sequence[Row], peer: Row) -> NDArray[np.float64] | None:
    """Speed of minimd, double, on as many threads / speed of the peer, turn by turn; None where that did not run."""
    if peer.is_minimd:
        return None
    ours = _find(rows, peer.threads, "double", peer.scene)
    return None if ours is None else ours.speeds / peer.speeds


def beside_one_thread(rows: Sequence[Row], row: Row) -> NDArray[np.float64] | None:
    """Speed of a row of minimd / speed of minimd, double, on one thread, with the same scene; None for peers."""
    reference = _find(rows, 1, "double", row.scene)
    return None if reference is None or not row.is_minimd else row.speeds / reference.speeds


def beside_melt(rows: Sequence[Row], row: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Speed of another scene / speed of the melt, of the same threads and precision: by atoms, and by pairs in range."""
    melt = _find(rows, row.threads, row.precision, MELT)
    if melt is None or row.scene == MELT or row.pair_speeds is None or melt.pair_speeds is None:
        return None
    return row.speeds / melt.speeds, row.pair_speeds / melt.pair_speeds


def _find(rows: Sequence[Row], threads: int, precision: str, scene: str) -> Row | None:
    """The row of minimd with these properties."""
    return next((row for row in rows if row.is_minimd and (row.threads, row.precision, row.scene) == (threads, precision, scene)), None)
