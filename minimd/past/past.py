"""The past of a run in fixed-point arithmetic: any of its steps is made again, to the last bit, from the nearest frame.

In this arithmetic a frame is all that the steps to come depend on, so a file with few frames holds all steps.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.progress import progress_of
from minimd.core.engine.observation import observe
from minimd.core.engine.record import Frame, Record
from minimd.core.engine.snapshot import Snapshot
from minimd.core.simulation.resuming import Potentials
from minimd.core.simulation.simulation import Observer, Simulation
from minimd.core.structure.checks import COUNTS, checked_count

if TYPE_CHECKING:
    from minimd.core.files.h5md_reader import H5MDContents

SAME_PACE = 1e-6  # relative: times in a file are rounded
TELLS = 100  # of a progress bar
BEFORE = "; earlier steps were made with another method, barostat or state"


class Past(Displayed):
    """The past of a run in fixed-point arithmetic: any of its steps, made again to the last bit.

        past = md.Past("run.h5md")
        sim = past.at(123_456)                                   # the simulation, as it was
        record = past.observe([observer], 123_000, 124_000)      # as if it had been attached then
        other = past.branch(123_456)                             # to change something there, and go on

    A step is made from the nearest frame: forwards from one before it, or backwards from one after it. Steps of baths
    are made forwards only, with the noise of the run. So a step costs at most the steps between two frames, half of
    them if there is a way back: with n frames, 1/n or 1/2n of the run. print(past) tells it.

    The way from frame to frame is that of the run if no observer has changed its state in between: observe compares
    energies with those of all frames that it looks at. Of a run continued with another method, bath or state, only the
    steps since then can be made again.

    Parameters
    ----------
    file : .h5md file of a run, finished or interrupted, or its archive (see archive).
    potentials, threads : as for Simulation.resume.

    Attributes
    ----------
    steps : (A,) int, steps that cost nothing: those of the frames, and the last one.
    goes_back : whether steps are also made backwards.
    worst : the largest cost of a step, in steps.
    contents : H5MDContents.

    Raises
    ------
    ValueError : for a run in float64, with rigid bonds, or with several time steps; and as Simulation.resume.
    FileNotFoundError, OSError : as Simulation.resume, for files that do not exist or are damaged.
    """

    def __init__(
        self, file: str | Path, potentials: Potentials = None, *, threads: int | None = None
    ) -> None:
        from minimd.core.files.h5md_reader import read_file  # h5py is slow to load

        self._last = Simulation.resume(file, potentials, threads=threads)
        self.file = Path(file)
        self.contents = read_file(file)
        check_is_fixed(file, self.contents)
        record = self.contents.record
        timestep = self.contents.timestep
        paces = np.diff(record.time) / np.diff(record.step)
        others = paces[~np.isclose(paces, timestep, rtol=SAME_PACE, atol=0.0)]
        if others.size:
            raise ValueError(
                f"the run in {str(file)!r} has several time steps, {others[0]:g} and {timestep:g}: "
                "the file keeps only the last one; steps of others cannot be made again"
            )
        known = np.unique(np.append(record.step, max(self.contents.step, record.step[-1])))
        self.steps = known[known >= min(self.contents.since, known[-1])]
        self._n_bytes = self.file.stat().st_size
        self.goes_back = self._last.method.is_symmetric
        gap = int(np.diff(self.steps).max(initial=1))
        self.worst = gap // 2 if self.goes_back else gap - 1

    def __repr__(self) -> str:
        return (
            f"Past({str(self.file)!r}, steps {self.steps[0]} to {self.steps[-1]}, "
            f"each by making at most {self.worst})"
        )

    def display_rows(self) -> Rows:
        """See Displayed."""
        first = self.steps[0]
        last = self.steps[-1]
        n_frames = self.contents.n_frames
        percent = 100.0 * self.worst / max(1, last - first)
        ways = "forwards or backwards" if self.goes_back else "forwards"
        return [
            ("past", f"{self.file}: {n_frames} frames, {self._n_bytes / 1e6:.3g} MB"),
            *self.contents.scene_in_words(),
            ("steps", f"{first} to {last}, each of them to the last bit"),
            (
                "cost",
                f"at most {self.worst} steps, {percent:.2g} % of the run, made from the nearest frame, {ways}",
            ),
        ]

    def cost(self, step: int) -> int:
        """The number of steps that at(step) makes; below zero if it makes them backwards.

        Raises ValueError for a step outside the run.
        """
        step = checked_count("step", step, 0)
        first = self.steps[0]
        last = self.steps[-1]
        if not first <= step <= last:
            raise ValueError(
                f"step must be from {first} to {last}, the steps of {str(self.file)!r} that can be made again"
                f"{BEFORE * (self.contents.since > 0)}; step = {step}"
            )
        ways = step - self.steps
        costs = np.where((ways >= 0) | self.goes_back, np.abs(ways), COUNTS - 1)
        return int(ways[np.argmin(costs)])

    def at(self, step: int, *, progress: bool | None = None) -> Simulation:
        """A simulation in the state of a step; each call makes a new one. Its next steps are those of the run.

        progress : show a progress bar; if not given, on a terminal and in a notebook.

        Raises
        ------
        ValueError : for a step outside the run; if the energy of the frame is not that of the file, as with other
            potentials than those of the run.
        """
        n = self.cost(step)
        simulation = copy.copy(self._last)
        frame = int(np.searchsorted(self.contents.record.step, step - n))
        if frame < self.contents.n_frames:
            go_to(simulation, self.file, self.contents, frame)
        make = simulation.run_back if n < 0 else simulation.make_steps
        block = max(simulation.guard.block, abs(n) // TELLS)
        with progress_of(abs(n), f"making step {step} again", progress) as tell:
            for done in range(0, abs(n), block):
                make(min(block, abs(n) - done))
                tell(min(done + block, abs(n)))
        return simulation

    def branch(self, step: int, *, progress: bool | None = None) -> Simulation:
        """The same simulation as at(step), with a title that tells where it comes from: to change something, and go
        on with a file of its own.

            other = past.branch(123_456)
            other.velocities[7] *= -1.0
            other.run(10_000, trajectory="other.h5md")

        The file of the past stays as it is. If nothing is changed, the branch is the run, also with the noise of its
        bath: for other noise give other.method another seed.
        Raises as at.
        """
        simulation = self.at(step, progress=progress)
        simulation.engine.notes["title"] += f", branched from step {step} of {self.file.name}"
        return simulation

    def observe(
        self,
        observers: Sequence[Observer],
        start: int,
        stop: int,
        every: int = 1,
        *,
        progress: bool | None = None,
    ) -> Record:
        """Let observers look at the steps from start to stop, as if they had been attached then, and return the record.

        The numbers are those of a run in which they were attached, to the last bit. It costs at(start), and the steps
        from start to stop.
        every : as for Simulation.run; observers of minimd.observers have their own steps.

        Raises
        ------
        ValueError : for steps outside the run; if energies are not those in the file, as after an observer that changes
            the state: for that, take a branch.
        """
        self.cost(checked_count("stop", stop, checked_count("start", start, 0)))
        simulation = self.at(start, progress=progress)
        stored = self.contents.record
        record = simulation.run(
            until_step=stop, every=every, observers=observers, progress=progress, crash_report=False
        )
        steps, now, before = np.intersect1d(record.step, stored.step, return_indices=True)
        others = steps[record.total_energy[now] != stored.total_energy[before]]
        if others.size:
            _refuse(self.file, others[0])
        return record


def check_is_fixed(file: str | Path, contents: H5MDContents) -> None:
    """Raise ValueError for a run in float64, or with rigid bonds: its steps go on from velocities before they were
    projected."""
    if contents.restart.grid is None:
        raise ValueError(
            "only runs with precision='fixed-point' can be made again to the last bit from any of their frames; "
            f"the run in {str(file)!r} was made with precision={contents.precision!r}"
        )
    if contents.restart.images is not None:
        raise ValueError(
            f"the run in {str(file)!r} has rigid bonds: its steps cannot be made again to the last bit from a frame, "
            "only from its restart"
        )


def go_to(simulation: Simulation, file: str | Path, contents: H5MDContents, frame: int) -> Frame:
    """Put a simulation into the state of a frame, and observe it.

    Raises ValueError if its energy is not the one in the file.
    """
    from minimd.core.files.h5md_reader import frames_of

    record = contents.record
    engine = simulation.engine
    reservoir = 0.0
    if "conserved_energy" in record:
        reservoir = float(record.total_energy[frame] - record.conserved_energy[frame])
    [stored] = frames_of(file, [frame], engine.system.units)
    engine.restore(
        Snapshot(
            stored.step,
            stored.time,
            stored.positions,
            stored.velocities,
            reservoir,
            contents.restart.state.clock,
        ),
        is_whole=True,
    )
    grid = engine.interactions.grid
    if grid is not None:
        # takes off the rounding of the units of files
        grid.take(engine.system, engine.constraint_set.inverse_masses)
    engine.leave()
    observed = observe(engine)
    if observed.observables["total_energy"] != record.total_energy[frame]:
        _refuse(file, stored.step)
    return observed


def _refuse(file: str | Path, step: int) -> None:
    raise ValueError(
        f"the energy of step {step} of {str(file)!r} is different when it is computed again: "
        "give the potentials of the run, and observers that change nothing"
    )
