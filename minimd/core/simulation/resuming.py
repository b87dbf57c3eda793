"""Simulations from files, at the restart of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minimd.core.console.annexes import from_annex
from minimd.core.console.quiet import warn
from minimd.core.engine.observation import extras_in
from minimd.core.forces.forces import Potential
from minimd.core.integrators.splitting import Splitting
from minimd.core.simulation.goal import UNLIMITED
from minimd.core.structure.checks import checked_count

if TYPE_CHECKING:
    from minimd.core.files.h5md_reader import H5MDContents

Potentials = Potential | Sequence[Potential] | None


def resumed(
    kind: Any,
    file: str | Path,
    potentials: Potentials,
    method: Splitting | None,
    threads: int | None,
) -> Any:
    """See Simulation.resume.
    kind : Simulation."""
    from minimd.core.files.h5md_reader import read_file, verify_frames  # h5py is slow to load
    from minimd.core.files.h5md_schema import other_potentials

    verify_frames(file)  # a child process reads it first
    contents = read_file(file)
    if potentials is None:
        potentials = stored_potentials(contents, file)
    options = {name: getattr(contents, name) for name in ("precision", "skin", "barostat")}
    if contents.barostat is not None and method is not None and method.is_thermostat:
        options["barostat"] = replace(contents.barostat, temperature=None)  # that of the method
    simulation = kind(
        contents.system, potentials, method or contents.integrator(), threads=threads, **options
    )
    simulation.extra_observables = extras_in(contents.record)
    simulation.engine.notes.update(title=contents.title, scene=contents.scene)
    # not rounded to another grid than that of the run
    simulation.system.cell = contents.system.cell
    simulation.engine.go_on_from(contents.restart)
    other = other_potentials(contents.potentials, simulation.potentials)
    if other:
        warn(
            f"the potentials given are not those of the last steps in {str(file)!r}: {other}; "
            "the potential energy jumps at this step"
        )
    if contents.repaired:
        warn(contents.repaired)
    return simulation


def stored_potentials(contents: H5MDContents, file: str | Path) -> Any:
    """The potentials of the scene in a file.
    Raises ValueError if it has no scene."""
    return from_annex("potentials of a scene")(contents.scene, contents.potentials, Path(file))


def last_step(
    step: int, n_steps: int | None, until_step: int | None, has_goal: bool, max_steps: int | None
) -> int:
    """The last step at which a run ends.
    has_goal : whether it may end before, with max_steps if there is a limit.
    Raises ValueError unless exactly one of n_steps, until_step and a goal is given, or if until_step has passed."""
    if has_goal:
        if (n_steps, until_step) != (None, None):
            raise ValueError(
                "a run with until=... ends by itself: give max_steps in place of n_steps and until_step"
            )
        return step + (UNLIMITED if max_steps is None else checked_count("max_steps", max_steps))
    if max_steps is not None:
        raise ValueError(f"max_steps belongs to until=...; max_steps = {max_steps!r}: give n_steps")
    if (n_steps is None) == (until_step is None):
        raise ValueError(
            "a run needs either n_steps or until_step, or until=...; "
            f"n_steps = {n_steps!r}, until_step = {until_step!r}"
        )
    if n_steps is not None:
        return step + checked_count("n_steps", n_steps, 0)
    end = checked_count("until_step", until_step, 0)
    if end < step:
        raise ValueError(
            f"until_step = {end} has passed, the simulation is at step {step}; give a later one, or n_steps"
        )
    return end
