"""Simulations from files: at the restart of a run, and at any step of a run in fixed-point arithmetic."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from minimd.console.quiet import outside_minimd
from minimd.engine.engine import Snapshot
from minimd.engine.observation import extras_in
from minimd.forces.forces import Potential
from minimd.structure.checks import checked_count

if TYPE_CHECKING:
    from minimd.files.h5md_reader import H5MDContents

Potentials = Potential | Sequence[Potential] | None


def resumed(kind: Any, file: str | Path, potentials: Potentials, threads: int | None, step: int | None = None) -> Any:
    """See Simulation.resume.  kind : Simulation."""
    from minimd.files.h5md_reader import read_file, verify_frames  # h5py is slow to load
    from minimd.files.h5md_schema import other_potentials

    verify_frames(file)  # a child process reads it first
    contents = read_file(file)
    if potentials is None:
        from minimd.document.document import potentials_of_scene  # pydantic is slow to load

        potentials = potentials_of_scene(contents.scene, contents.potentials, Path(file))
    options = {name: getattr(contents, name) for name in ("precision", "skin", "barostat")}
    simulation = kind(contents.system, potentials, contents.integrator(), threads=threads, **options)
    simulation.extra_observables = extras_in(contents.record)
    simulation.engine.notes.update(title=contents.title, scene=contents.scene)
    simulation.engine.go_on_from(contents.restart)
    if other := other_potentials(contents.potentials, simulation.potentials):
        those = f"those of the last steps in {str(file)!r}: {other}"
        warnings.warn(f"the potentials are not {those}; energies jump at this step", stacklevel=outside_minimd())
    if contents.repaired:
        warnings.warn(contents.repaired, stacklevel=outside_minimd())
    if step is not None:
        step, steps = checked_count("step", step, 0), contents.record.step
        check_is_fixed(file, contents)
        if not steps[0] <= step <= contents.step:
            has = f"file {str(file)!r} has the steps {steps[0]} to {contents.step}"
            raise ValueError(f"{has}; step must be one of them, but step = {step}")
        frame = int(np.searchsorted(steps, step, side="right")) - 1
        go_to(simulation, file, contents, frame)  # the frame before the step
        simulation.make_steps(step - int(steps[frame]))
    return simulation


def check_is_fixed(file: str | Path, contents: H5MDContents) -> None:
    """Raise ValueError for a run in float64, or with rigid bonds: its steps go on from velocities before they were
    projected."""
    if contents.restart.grid is None:
        only = "only runs with precision='fixed-point' can be made again to the last bit from any of their frames"
        raise ValueError(f"{only}; the run in {str(file)!r} was made with precision={contents.precision!r}")
    if contents.restart.images is not None:
        why = "its steps cannot be made again to the last bit from a frame, only from its restart"
        raise ValueError(f"the run in {str(file)!r} has rigid bonds: {why}")


def go_to(simulation: Any, file: str | Path, contents: H5MDContents, frame: int) -> None:
    """Put a simulation into the state of a frame.

    In fixed-point arithmetic this is all that the steps to come depend on.
    """
    from minimd.files.h5md_reader import frames_of

    record, engine, reservoir = contents.record, simulation.engine, 0.0
    if "conserved_energy" in record:
        reservoir = float(record.total_energy[frame] - record.conserved_energy[frame])
    [at] = frames_of(file, [frame], engine.system.units)
    engine.restore(Snapshot(at.step, at.time, at.positions, at.velocities, reservoir))
    if (grid := engine.interactions.grid) is not None:
        grid.take(engine.system, engine.constraint_set.inverse_masses)  # takes off the rounding of the units of files
    engine.is_whole = True
    engine.leave()


def last_step(step: int, n_steps: int | None, until_step: int | None) -> int:
    """The step at which a run ends.  Raises ValueError unless exactly one of n_steps and until_step is given."""
    if (n_steps is None) == (until_step is None):
        given = f"n_steps = {n_steps!r}, until_step = {until_step!r}"
        raise ValueError(f"a run needs either n_steps or until_step; {given}")
    if n_steps is not None:
        return step + checked_count("n_steps", n_steps, 0)
    return checked_count("until_step", until_step, step)
