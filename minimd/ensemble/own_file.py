"""The run of a member in its own file, for functions `run` that can go on after an interruption."""

from __future__ import annotations

import os
from pathlib import Path

from minimd.engine.record import Record
from minimd.simulation.simulation import Simulation

STOPPED = ".stopped.h5md"


def stopped_file(file: Path) -> Path:
    """The name under which the file of a stopped member is kept."""
    return file.with_suffix(STOPPED)


def set_aside(file: Path) -> None:
    """Rename the file of a stopped member, so that `run` may write a new file, or go on with the old one."""
    if file.exists():
        os.replace(file, stopped_file(file))


def run_in_file(simulation: Simulation, file: Path, steps: int, every: int) -> Record:
    """Make the steps of a member, or the remaining ones if it was stopped, and write them to its file;
    returns the record of all frames.

    To go on, the simulation takes over the state in the file, to the last bit.  Raises as Simulation.run.
    """
    from minimd.files.h5md_reader import read_file

    first = _taken_up(simulation, stopped_file(file))
    if first is None:
        return simulation.run(steps, every=every, trajectory=file, progress=False)
    os.replace(stopped_file(file), file)
    if simulation.step < first + steps:
        simulation.run(until_step=first + steps, every=every, trajectory=file, append=True, progress=False)
    return read_file(file).record


def _taken_up(simulation: Simulation, file: Path) -> int | None:
    """Take over the last state in a file; returns the first step of its run,
    or None if there is no file or it is damaged or of another system."""
    from minimd.files.h5md_reader import read_file, verify_frames

    if not file.exists():
        return None
    try:
        verify_frames(file)
        contents = read_file(file)
    except (OSError, ValueError):  # the member begins anew, and has the same bits
        return None
    if len(contents.system) != len(simulation.system):
        return None
    simulation.engine.go_on_from(contents.restart)
    return int(contents.record.step[0])
