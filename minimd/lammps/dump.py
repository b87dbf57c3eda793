"""Reading LAMMPS' binary dumps of all atoms (dump custom, suffix .bin; LAMMPS' format 2 of 2020), frame by frame."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

MAGIC = b"DUMPCUSTOM"


def frames(path: Path, n_atoms: int) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """For each frame, its step and all columns but the first, (N, C); the first must be the id, which orders the rows.

    A frame that is cut off or lacks atoms ends the iteration.  Raises ValueError for a file that is not such a dump.
    """
    with path.open("rb") as file:
        while file.peek(1):  # type: ignore[attr-defined]
            try:
                yield _frame(file, n_atoms)
            except EOFError:
                return


def _frame(file: BinaryIO, expected: int) -> tuple[int, NDArray[np.float64]]:
    length = -_read(file, "q")
    if length != len(MAGIC) or _exactly(file, length) != MAGIC or _read(file, "i") != 1:
        raise ValueError("LAMMPS has written a dump in a format that minimd does not know; use LAMMPS of 2021 or later")
    _read(file, "i")  # revision
    step, n_atoms, tilted = _read(file, "q"), _read(file, "q"), _read(file, "i")
    if n_atoms != expected:
        raise EOFError
    _exactly(file, 6 * 4 + (9 if tilted else 6) * 8)  # boundaries and box
    n_columns = _read(file, "i")
    _exactly(file, _read(file, "i"))  # unit style
    if _read(file, "b"):
        _read(file, "d")  # time
    _exactly(file, _read(file, "i"))  # names of the columns
    rows, filled = np.empty((n_atoms, n_columns - 1)), 0
    for _ in range(_read(file, "i")):  # processes
        n_numbers = _read(file, "i")
        part = np.frombuffer(_exactly(file, 8 * n_numbers)).reshape(-1, n_columns)
        rows[part[:, 0].astype(np.int64) - 1] = part[:, 1:]
        filled += len(part)
    if filled != n_atoms:
        raise EOFError
    return step, rows


def _read(file: BinaryIO, kind: str) -> Any:
    return struct.unpack(kind, _exactly(file, struct.calcsize(kind)))[0]


def _exactly(file: BinaryIO, n_bytes: int) -> bytes:
    """The next n_bytes bytes.  Raises EOFError if there are fewer."""
    read = file.read(n_bytes)
    if len(read) < n_bytes:
        raise EOFError
    return read
