"""The last steps of a failed run in one picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from minimd.analysis.picture import four_panels, save
from minimd.diagnosis.crash_report import CrashReport
from minimd.structure.units import UnitSystem

COLORS = ("#1f5fa8", "#1b7f5c", "#c8501e", "#5b3f99")
WIDE = 50.0  # largest over smallest from which an axis is logarithmic: on a linear one the small values would lie on the axis


def plot_replay(rows: Sequence[Any], findings: CrashReport, units: UnitSystem, picture: Path) -> None:
    """Draw energy, distance of the closest pair, largest force and largest speed against the step.

    rows : of a minimd.replay.Replay, one for each step.  Raises OSError if the picture cannot be written.
    """
    figure, panels = four_panels()
    series = {
        f"total energy  [{units.energy}]": [row.energy for row in rows],
        f"closest pair  [{units.length}]": [row.distance for row in rows],
        f"largest force  [{units.energy}/{units.length}]": [row.force for row in rows],
        f"largest speed  [{units.length}/{units.time}]": [row.speed for row in rows],
    }
    for panel, (label, values), color in zip(panels, series.items(), COLORS, strict=True):
        numbers = np.array(values, dtype=float)
        finite = numbers[np.isfinite(numbers)]
        panel.plot([row.step for row in rows], numbers, color=color, lw=1.1, marker="o", ms=3.0)
        if finite.size and finite.min() > 0.0 and finite.max() > WIDE * finite.min():
            panel.set_yscale("log")
        panel.axvline(findings.step, color="0.5", lw=1.0, ls="--")
        panel.set(xlabel="step", ylabel=label)
    figure.suptitle(f"{findings.cause}\n(dashed: step {findings.step}, which failed)", fontsize=10, wrap=True)
    save(figure, picture)
