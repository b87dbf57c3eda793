"""A run in one picture: energy, temperature, momentum or pressure, structure, and the results of its observers."""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from minimd.core.console.whole_file import write_picture
from minimd.core.diagnosis.report import conserved_energy
from minimd.core.diagnosis.run_report import densities
from minimd.core.engine.record_picture import (
    ACCENT,
    STRUCTURE,
    STYLE,
    draw_quantities,
    draw_volume,
    drawn_quantities,
    empty_panels,
)
from minimd.mdanalysis.universes import (
    RunUniverse,
    mean_square_displacement,
    radial_distribution,
    universe_of,
)
from minimd.observers.motion import DisplacementResult
from minimd.observers.radial_distribution import RadialDistributionResult


def plot_file(path: str | Path, out: str | Path | None = None) -> Path:
    """Draw a minimd file and return the name of the picture.

    Four panels or more show the change of the total energy per atom; the temperature; the change of the total momentum
    if it is conserved, else the pressure, or U per atom without one; volume and pressure if the volume changes; and
    g(r) if the cell is periodic in all directions, else the mean-square displacement, both since method, bath or state
    were changed last. The energy has the line of its drift if it should be constant.
    A further panel is drawn for each observer of the run, and none for structure if an observer has measured it, or if
    they were changed until the last frame, as in a ramp of the temperature, or the only one has no g(r).
    out : the picture, in the format of its suffix; the name of the file with .png if not given.

    Raises FileNotFoundError, OSError, ValueError as universe, or if the picture cannot be written.
    """
    with universe_of(path) as run:
        figure = drawn(run)
    return write_picture(figure, Path(path).with_suffix(".png") if out is None else Path(out))


def drawn(run: RunUniverse) -> Figure:
    """The figure of plot_file, for a run whose universe is open; it is not written to a file."""
    contents = run.contents
    record = contents.record
    quantities = drawn_quantities(record, 3)
    n = len(quantities)
    answers = [observer.result() for observer in contents.observers.values() if observer.n_looks]
    results = [answer.draw for answer in answers]
    structure = RadialDistributionResult if _is_bulk(run) else DisplacementResult
    is_measured = any(isinstance(answer, structure) for answer in answers)
    if not is_measured and (run.n_recent > 1 or (_is_bulk(run) and not run.n_earlier)):
        results.insert(0, partial(_draw_structure, run=run))
    figure, panels = empty_panels(n + len(results))
    draw_quantities(panels, record, quantities)
    is_drawn = "conserved_energy" not in record and "work" not in record
    is_constant = is_drawn and not run.n_earlier
    if is_constant and len(record) > 1:
        _draw_drift(panels[0], run)
    if draw_volume in quantities:
        density, unit = densities(record, run.system.masses.sum())
        volume = panels[quantities.index(draw_volume)]
        title = f"volume   (mean density: {density.mean():.4g} {unit})"
        volume.set_title(title, fontsize=10)
    for draw, panel in zip(results, panels[n:], strict=True):
        draw(panel)
        panel.margins(x=0.01)
        panel.title.set_fontsize(10)
    frames = f"{contents.n_frames} frame{'s' * (contents.n_frames > 1)}"
    title = f"{contents.title}, {contents.method}, {frames}"
    figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def _draw_drift(panel: Axes, run: RunUniverse) -> None:
    """The line of the drift of the total energy, which its legend gives in the words of a report."""
    record = run.contents.record
    units = record.units
    times = record.time * units.to_picosecond
    energy, rate = conserved_energy(record)
    (curve,) = panel.lines
    change = np.asarray(curve.get_ydata())
    scale = np.ptp(change) / (np.ptp(energy) or 1.0)  # the curve may be over a power of ten
    drifting = change.mean() + scale * rate.slope * (times - times.mean())
    label = f"drift: {rate} {units.energy} per atom per {units.shown_time}"
    panel.plot(times, drifting, color=ACCENT, lw=1.0, ls="--", label=label)
    panel.margins(y=0.12)
    panel.legend(frameon=False, fontsize=8, loc="lower right", borderaxespad=0.0)


def _is_bulk(run: RunUniverse) -> bool:
    return run.system.volume is not None and len(run.system) > 1


def _draw_structure(panel: Axes, run: RunUniverse) -> None:
    """g(r) if possible, else the mean-square displacement."""
    units = run.system.units
    frames = f", from step {run.contents.record.step[run.n_earlier]} on" * bool(run.n_earlier)
    if _is_bulk(run):
        pairs = radial_distribution(run)
        pairs.draw(panel)
        panel.set_title(f"{pairs.title}{frames}")
    else:
        panel.plot(*mean_square_displacement(run), color=STRUCTURE, **STYLE)
        panel.set(
            xlabel=f"lag  [{units.shown_time}]",
            ylabel=f"⟨|r(t) − r(0)|²⟩  [{units.length}²]",
            title=f"mean-square displacement{frames}",
        )
