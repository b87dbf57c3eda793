"""Seeing a failed run fail again, step by step, from the file that it left."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from minimd.diagnosis.crash_report import SUFFIX, CrashReport
from minimd.forces.forces import Potential
from minimd.neighbors.queries import closest_pair
from minimd.simulation.simulation import Simulation
from minimd.structure.errors import ConstraintError, NonFiniteError

if TYPE_CHECKING:
    from minimd.files.crash_file import CrashFile

PATIENCE = 20  # steps behind the failure, should it not come again: rounding is not the same
LAST_ROWS, STRIDE = 12, 10  # of the table: the last ones all, of the others every tenth


class Row(NamedTuple):
    """One step.  time, energy : [time], [energy], total.  first, second, distance : the closest pair [length]; −1 and NaN where there is none.

    pushed, force : the atom under the largest force, and its size [energy/length].  fastest, speed : [length/time].
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


HEADS = ("step", "time", "total energy", "closest pair", "distance", "largest force", "on", "fastest", "speed")


@dataclass(frozen=True)
class Replay:
    """What a replay saw. str() is a table.

    Attributes
    ----------
    rows : a Row of each step that could be made.  ending : what ended it, in words.  failed_at : step, or None if it did not fail again.
    findings : CrashReport of the first failure.  trajectory, picture : files, or None where none was written.
    """

    rows: list[Row]
    ending: str
    failed_at: int | None
    findings: CrashReport
    trajectory: Path | None
    picture: Path | None

    def __str__(self) -> str:
        shown = [row for k, row in enumerate(self.rows) if k % STRIDE == 0 or k >= len(self.rows) - LAST_ROWS]
        widths = (8, 11, 14, 15, 10, 14, 8, 9, 11)
        lines = ["".join(f"{head:>{width}}" for head, width in zip(HEADS, widths, strict=True))]
        lines += ["".join(f"{cell:>{width}}" for cell, width in zip(_cells(row), widths, strict=True)) for row in shown]
        return "\n".join([*lines, self.ending])


def _cells(row: Row) -> tuple[str, ...]:
    pair = f"{row.first}-{row.second}" if row.first >= 0 else "none"
    numbers = (f"{row.distance:.4g}", f"{row.force:.4g}", str(row.pushed), str(row.fastest), f"{row.speed:.4g}")
    return (str(row.step), f"{row.time:.5g}", f"{row.energy:.8g}", pair, *numbers)


def replay(
    file: str | Path,
    potentials: Potential | Sequence[Potential] | None = None,
    *,
    trajectory: str | Path | bool = True,
    picture: str | Path | bool = True,
    overwrite: bool = False,
) -> Replay:
    """Go back to a state some steps before a failure, and make these steps again, each of them observed.

    Parameters
    ----------
    file : .crash.h5md of a run that failed: system, method and constraints are in it.
    potentials : those of the run; if not given, those of the scene that is stored in the file.
    trajectory, picture : where to write the steps and a picture of them; True for names after the file, False for none.
    overwrite : replace files that exist.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : for a file that is none, for one without a scene if no potentials are given, or for
        outputs that exist or cannot be written.
    """
    from minimd.files.crash_file import read_crash_report

    past = read_crash_report(file)
    frames, drawing = _output(trajectory, Path(file), ".replay.h5md", overwrite), _output(picture, Path(file), ".replay.png", overwrite)
    simulation = _simulation(past, _potentials(past, file) if potentials is None else potentials)
    rows: list[Row] = []
    failed_at, ending = _run(simulation, past.findings, frames, rows)
    if not rows:
        rows.append(_row(simulation))
    if drawing is not None:
        from minimd.analysis.replay_plot import plot_replay

        plot_replay(rows, past.findings, simulation.system.units, drawing)
    written = frames if frames is not None and frames.exists() else None
    return Replay(rows, ending, failed_at, past.findings, written, drawing)


def _output(wanted: str | Path | bool, file: Path, suffix: str, overwrite: bool) -> Path | None:
    if wanted is False:
        return None
    path = file.with_name(file.name.removesuffix(SUFFIX).removesuffix(file.suffix) + suffix) if wanted is True else Path(wanted)
    if path.exists() and not overwrite:
        raise FileExistsError(f"output {str(path)!r} exists; choose another name, or replace it with overwrite")
    return path


def _potentials(past: "CrashFile", file: str | Path) -> list[Potential]:
    """Those of the scene in the file."""
    if not past.scene:
        raise ValueError(
            f"file {str(file)!r} holds no scene from which to rebuild its potentials; call minimd.replay(file, potentials) with those of the "
            f"script: {'; '.join(past.potentials)}"
        )
    from minimd.scene import parse_scene

    return parse_scene(past.scene, Path(file)).potentials()


def _simulation(past: "CrashFile", potentials: Potential | Sequence[Potential]) -> Simulation:
    simulation = Simulation(past.system, potentials, past.method, precision=past.precision, skin=past.skin)
    simulation.go_to(past.start)
    simulation.noise_shift = past.noise_shift
    return simulation


def _run(simulation: Simulation, findings: CrashReport, trajectory: Path | None, rows: list[Row]) -> tuple[int | None, str]:
    """Make the steps; returns at which it failed, and a sentence."""
    files = () if trajectory is None else trajectory
    n_steps = findings.step - simulation.step + PATIENCE
    try:
        simulation.run(
            n_steps,
            every=1,
            trajectory=files,
            store_forces=True,
            overwrite=True,
            observers=[lambda now: rows.append(_row(now))],
            crash_report=False,
            progress=False,
        )
    except (NonFiniteError, ConstraintError) as error:
        found = error.crash_report
        step = findings.step if found is None else found.step
        again = "again" if step == findings.step else f"at another step than the first time ({findings.step}): rounding differs"
        return step, f"failed {again}: {error}"
    return None, f"it did not fail again up to step {simulation.step}: something from outside acted on the first run, such as an observer"


def _row(simulation: Simulation) -> Row:
    """What stands in the table about the present state; the forces are those of the last look."""
    force, speed = (np.sqrt(np.einsum("ij,ij->i", array, array)) for array in (simulation.forces, simulation.velocities))
    closest = closest_pair(simulation.system)
    first, second, distance = (-1, -1, np.nan) if closest is None else closest
    pushed, fastest = int(np.argmax(force)), int(np.argmax(speed))
    record = simulation.record
    energy = float(record.total_energy[-1]) if record is not None and len(record) else np.nan
    return Row(
        simulation.step, simulation.time, energy, int(first), int(second), distance, pushed, float(force[pushed]), fastest, float(speed[fastest])
    )
