"""The bridge to LAMMPS: a simulation is handed over, verified at step 0, run under MPI,
and brought back as a file of minimd."""

from minimd.core.structure.errors import HandOverError
from minimd.lammps.handing_over import (
    HandOver,
    check_hand_over,
    hand_over,
    not_carried_over,
    write_input,
)
from minimd.lammps.program import find_program

__all__ = [
    "HandOver",
    "HandOverError",
    "check_hand_over",
    "find_program",
    "hand_over",
    "not_carried_over",
    "write_input",
]
