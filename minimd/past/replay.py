"""Replaying a failed run step by step, from the crash file that it left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from minimd.core.console.whole_file import write_picture
from minimd.core.diagnosis.crash_report import CrashReport
from minimd.core.files.crash_file import SUFFIX, read_crash_report
from minimd.core.forces.forces import Potential
from minimd.core.neighbors.queries import closest_pair
from minimd.core.simulation.resuming import stored_potentials
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.errors import ConstraintError, NonFiniteError
from minimd.core.structure.observables import longest
from minimd.core.structure.units import LJ, SYSTEMS, UnitSystem

# steps after the failure, if it does not occur again at its step: rounding differs between processors
PATIENCE = 20
# rows of the table: all of the last ones, every tenth of the others
LAST_ROWS = 12
APART = 10
# see ReplayedStep.row
HEAD = "    step       time  total energy   closest pair  distance largest force      on  fastest      speed"
WIDE = 50.0  # ratio of the largest to the smallest value above which an axis is logarithmic


class ReplayedStep(NamedTuple):
    """One step.
    time : [time].
    energy : total [energy].
    first, second, distance : the closest pair [length]; −1, −1 and NaN if there is none.
    pushed, force : the atom with the largest force, and this force [energy/length].
    fastest, speed : the fastest atom [length/time].
    """

    step: int
    time: float
    energy: float
    first: int
    second: int
    distance: float
    pushed: int
    force: float
    fastest: int
    speed: float

    @classmethod
    def of(cls, simulation: Simulation) -> ReplayedStep:
        """The present step; forces and energy are those of the last observation."""
        record = simulation.record
        pair = closest_pair(simulation.system) or (-1, -1, np.nan)
        energy = float(record.total_energy[-1]) if record is not None and len(record) else np.nan
        largest = *longest(simulation.forces), *longest(simulation.velocities)
        return cls(simulation.step, simulation.time, energy, *pair, *largest)

    def row(self, units: UnitSystem) -> str:
        """A row of the table: time in ps or τ, speed with the same unit of time, and all else in the units of the
        system."""
        time = self.time * units.to_picosecond
        speed = self.speed / units.to_picosecond
        pair = f"{self.first}-{self.second}" if self.first >= 0 else "none"
        return (
            f"{self.step:>8}{time:>11.5g}{self.energy:>14.8g}{pair:>15}{self.distance:>10.4g}"
            f"{self.force:>14.4g}{self.pushed:>8}{self.fastest:>9}{speed:>11.4g}"
        )


@dataclass(frozen=True)
class Replay:
    """The result of a replay. str() gives a table.

    rows : a ReplayedStep for each step that succeeded.
    ending : why it ended, as text.
    failed_at : step, or None if it did not fail again.
    findings : CrashReport of the original failure.
    trajectory, picture : paths of the files, or None if not written.
    """

    rows: list[ReplayedStep]
    ending: str
    failed_at: int | None
    findings: CrashReport
    trajectory: Path | None
    picture: Path | None

    def __str__(self) -> str:
        units = SYSTEMS.get(self.findings.units, LJ)
        force = f"{units.energy}/{units.length}"
        speed = f"{units.length}/{units.shown_time}"
        names = (
            f"{'':>8}{units.shown_time:>11}{units.energy:>14}{'':>15}{units.length:>10}"
            f"{force:>14}{'':>17}{speed:>11}"
        )
        first_of_last = len(self.rows) - LAST_ROWS
        rows = [
            row.row(units)
            for k, row in enumerate(self.rows)
            if k % APART == 0 or k >= first_of_last
        ]
        return "\n".join([HEAD, names, *rows, self.ending])


def replay(
    file: str | Path,
    potentials: Potential | Sequence[Potential] | None = None,
    *,
    trajectory: str | Path | bool = True,
    picture: str | Path | bool = True,
    overwrite: bool = False,
) -> Replay:
    """Go back to a state some steps before a failure, make these steps again, and observe each of them.

    Parameters
    ----------
    file : the .crash.h5md file of a run that failed; it holds system, method and constraints.
    potentials : those of the run; if not given, those of the scene that is stored in the file.
    trajectory, picture : where to write the steps and a picture of them; True for names made from that of the file,
        False for none.
    overwrite : replace files that exist; those with names that minimd has made are always replaced.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : if the file is not a crash file, if it has no scene and no potentials are
        given, or if outputs exist or cannot be written.
    """
    past = read_crash_report(file)
    run = past.run
    findings = past.findings
    frames = _output(trajectory, Path(file), "h5md", overwrite)
    drawing = _output(picture, Path(file), "png", overwrite)
    simulation = Simulation(
        run.system,
        stored_potentials(run, file) if potentials is None else potentials,
        run.integrator(),
        barostat=run.barostat,
        precision=run.precision,
        skin=run.skin,
        grid=run.restart.grid,
    )
    simulation.restore(past.start)
    simulation.engine.noise_shift = past.noise_shift
    simulation.guard.judge_by(*past.judgment)
    rows: list[ReplayedStep] = []
    failed_at = None
    try:
        simulation.run(
            findings.step - simulation.step + PATIENCE,
            every=1,
            trajectory=() if frames is None else frames,
            observers=[lambda now: rows.append(ReplayedStep.of(now))],
            store_forces=True,
            overwrite=True,
            progress=False,
            crash_report=False,
        )
        ending = (
            f"it did not fail again up to step {simulation.step}: something that is not in the file, "
            "such as an observer, acted on the first run"
        )
    except (NonFiniteError, ConstraintError) as error:
        failed_at = findings.step if error.crash_report is None else error.crash_report.step
        when = "again"
        if failed_at != findings.step:
            when = f"at another step than the first time ({findings.step}): rounding differs"
        ending = f"failed {when}: {error}"
    rows = rows or [ReplayedStep.of(simulation)]
    if drawing is not None:
        _draw(rows, findings, simulation.system.units, drawing)
    if frames is not None and not frames.exists():
        frames = None
    return Replay(rows, ending, failed_at, findings, frames, drawing)


def _output(wanted: str | Path | bool, file: Path, end: str, overwrite: bool) -> Path | None:
    if wanted is False:
        return None
    own = file.name.removesuffix(SUFFIX).removesuffix(file.suffix)
    path = file.with_name(f"{own}.replay.{end}") if wanted is True else Path(wanted)
    if path.exists() and not overwrite and wanted is not True:
        raise FileExistsError(
            f"output {str(path)!r} exists; choose another name, or delete it with overwrite=True, "
            "or --overwrite of the command"
        )
    return path


def _draw(
    rows: list[ReplayedStep], findings: CrashReport, units: UnitSystem, picture: Path
) -> None:
    """Draw energy, distance of the closest pair, largest force and largest speed against the step."""
    from minimd.core.engine.record_picture import empty_panels

    figure, panels = empty_panels(4)
    columns = zip(*rows, strict=True)
    steps, _, energies, _, _, distances, _, forces, _, speeds = map(np.array, columns)
    speeds = speeds / units.to_picosecond
    force = f"{units.energy}/{units.length}"
    speed = f"{units.length}/{units.shown_time}"
    series = (
        ("total energy", units.energy, energies, "#1f5fa8"),
        ("closest pair", units.length, distances, "#1b7f5c"),
        ("largest force", force, forces, "#c8501e"),
        ("largest speed", speed, speeds, "#5b3f99"),
    )
    for panel, (label, unit, numbers, color) in zip(panels, series, strict=True):
        finite = numbers[np.isfinite(numbers)]
        panel.plot(steps, numbers, color=color, lw=1.1, marker="o", ms=3.0)
        if finite.size and finite.min() > 0.0 and finite.max() > WIDE * finite.min():
            panel.set_yscale("log")
        panel.axvline(findings.step, color="0.5", lw=1.0, ls="--")
        panel.set(xlabel="step", ylabel=f"{label}  [{unit}]")
    figure.suptitle(
        f"{findings.cause}\n(dashed: step {findings.step}, which failed)",
        fontsize=10,
        wrap=True,
        parse_math=False,
    )
    write_picture(figure, picture)
