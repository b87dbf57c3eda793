"""The last steps of a failed run in one picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from minimd.diagnosis.crash_report import CrashReport
from minimd.structure.units import UnitSystem

INCHES, DOTS_PER_INCH = (10.0, 7.0), 150
COLORS = ("#1f5fa8", "#1b7f5c", "#c8501e", "#5b3f99")
WIDE = 50.0  # largest over smallest from which an axis is logarithmic


def plot_replay(steps: Mapping[str, Sequence[float]], labels: Mapping[str, str], findings: CrashReport, units: UnitSystem, picture: Path) -> None:
    """Draw energy, distance of the closest pair, largest force and largest speed against the step.

    steps : numbers of each step by name, "step" among them.  labels : names of the four series, and what stands at their axes.

    Raises
    ------
    OSError : if the picture cannot be written.
    """
    figure = Figure(figsize=INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    shown = (units.energy, units.length, f"{units.energy}/{units.length}", f"{units.length}/{units.time}")
    for panel, (name, label), unit, color in zip(figure.subplots(2, 2).ravel(), labels.items(), shown, COLORS, strict=True):
        numbers = np.array(steps[name], dtype=float)
        finite = numbers[np.isfinite(numbers)]
        panel.plot(steps["step"], numbers, color=color, lw=1.1, marker="o", ms=3.0)
        if finite.size and finite.min() > 0.0 and finite.max() > WIDE * finite.min():
            panel.set_yscale("log")
        panel.axvline(findings.step, color="0.5", lw=1.0, ls="--")
        panel.set(xlabel="step", ylabel=f"{label}  [{unit}]")
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(alpha=0.25, lw=0.6)
    figure.suptitle(f"{findings.cause}\n(dashed: step {findings.step}, which failed)", fontsize=10, wrap=True)
    try:
        figure.savefig(picture)
    except OSError as error:
        raise OSError(f"picture {str(picture)!r} cannot be written: {error.strerror or error}") from error
