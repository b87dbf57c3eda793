"""What was measured of one engine with one scene, and the ratios between rows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MINIMD = "minimd"


class Row(NamedTuple):
    """One engine with one scene.

    speeds : (R,) atom-steps per second in each turn.  bytes_per_atom : None if not measured.
    """

    engine: str
    threads: int
    precision: str
    scene: str
    n_atoms: int
    speeds: NDArray[np.float64]
    bytes_per_atom: float | None = None

    @property
    def is_minimd(self) -> bool:
        """False for a peer."""
        return self.engine == MINIMD


def faster_than_peer(rows: Sequence[Row], peer: Row) -> NDArray[np.float64] | None:
    """Speed of minimd, double, on as many threads / speed of the peer, turn by turn; None where that did not run."""
    if peer.is_minimd:
        return None
    ours = _find(rows, peer.threads, peer.scene)
    return None if ours is None else ours.speeds / peer.speeds


def beside_one_thread(rows: Sequence[Row], row: Row) -> NDArray[np.float64] | None:
    """Speed of a row of minimd / speed of minimd, double, on one thread, with the same scene; None for peers."""
    reference = _find(rows, 1, row.scene)
    return None if reference is None or not row.is_minimd else row.speeds / reference.speeds


def _find(rows: Sequence[Row], threads: int, scene: str) -> Row | None:
    """The row of minimd in double precision with these properties."""
    return next((row for row in rows if row.is_minimd and (row.threads, row.precision, row.scene) == (threads, "double", scene)), None)
