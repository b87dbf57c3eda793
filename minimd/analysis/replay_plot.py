"""The last steps of a failed run in one picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from minimd.diagnosis.crash_report import CrashReport
from minimd.structure.units import UnitSystem

if TYPE_CHECKING:
    from minimd.replay import Row

INCHES, DOTS_PER_INCH = (10.0, 7.0), 150
COLORS = ("#1f5fa8", "#1b7f5c", "#c8501e", "#5b3f99")
WIDE = 50.0  # largest over smallest from which an axis is logarithmic


def plot_replay(rows: "Sequence[Row]", findings: CrashReport, units: UnitSystem, picture: Path) -> None:
    """Draw energy, distance of the closest pair, largest force and largest speed against the step.

    Raises
    ------
    OSError : if the picture cannot be written.
    """
    figure = Figure(figsize=INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    steps = np.array([row.step for row in rows])
    series = {
        f"total energy  [{units.energy}]": [row.energy for row in rows],
        f"closest pair  [{units.length}]": [row.distance for row in rows],
        f"largest force  [{units.energy}/{units.length}]": [row.force for row in rows],
        f"largest speed  [{units.length}/{units.time}]": [row.speed for row in rows],
    }
    for panel, (label, values), color in zip(figure.subplots(2, 2).ravel(), series.items(), COLORS, strict=True):
        numbers = np.array(values, dtype=float)
        finite = numbers[np.isfinite(numbers)]
        panel.plot(steps, numbers, color=color, lw=1.1, marker="o", ms=3.0)
        if finite.size and finite.min() > 0.0 and finite.max() > WIDE * finite.min():
            panel.set_yscale("log")
        panel.axvline(findings.step, color="0.5", lw=1.0, ls="--")
        panel.set_ylabel(label)
        panel.set_xlabel("step")
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(alpha=0.25, lw=0.6)
    figure.suptitle(f"{findings.cause}\n(dashed: step {findings.step}, which failed)", fontsize=10, wrap=True)
    try:
        figure.savefig(picture)
    except OSError as error:
        raise OSError(f"picture {str(picture)!r} cannot be written: {error.strerror or error}") from error
