"""A run in one picture: energy, temperature, momentum, structure."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from minimd.core.console.whole_file import write_picture
from minimd.core.diagnosis.report import drift
from minimd.core.engine.record import Record
from minimd.core.engine.record_picture import (
    ACCENT,
    STRUCTURE,
    STYLE,
    Array,
    draw_energy,
    draw_momentum,
    draw_temperature,
    four_panels,
)
from minimd.mdanalysis.universes import (
    RunUniverse,
    mean_square_displacement,
    radial_distribution,
    universe_of,
)


def plot_file(path: str | Path, out: str | Path | None = None) -> Path:
    """Draw a minimd file and return the name of the picture.

    Four panels show the change of the total energy per atom, the temperature, the change of the total momentum, and
    g(r) if the cell is periodic in all directions, else the mean-square displacement.
    A further panel is drawn for each observer of the run.
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
    units = run.system.units
    answers = [observer.result() for observer in contents.observers.values() if observer.n_looks]
    figure, panels = four_panels(len(answers))
    for draw, panel in zip((_energy, draw_temperature, draw_momentum), panels, strict=False):
        draw(panel, record.time * units.to_picosecond, record)
        panel.set_xlabel(f"time  [{units.shown_time}]")
    _structure(panels[3], run)
    for panel, answer in zip(panels[4:], answers, strict=False):
        answer.draw(panel)
    for panel in panels:
        panel.margins(x=0.01)
        panel.title.set_fontsize(10)
    figure.suptitle(
        f"{contents.title}, {contents.method}, {contents.n_frames} frames",
        fontsize=11,
        parse_math=False,
    )
    return figure


def _energy(panel: Axes, times: Array, record: Record) -> None:
    """Change of the total energy per atom since the start, minus heat Q of a bath, with the line of its drift."""
    change = draw_energy(panel, times, record)
    drifting = change.mean() + drift(times, change).slope * (times - times.mean())
    panel.plot(times, drifting, color=ACCENT, lw=1.0, ls="--", label="drift")
    panel.margins(y=0.12)
    panel.legend(frameon=False, fontsize=8, ncols=2, loc="lower right", borderaxespad=0.0)


def _structure(panel: Axes, run: RunUniverse) -> None:
    """g(r) if possible, else the mean-square displacement, else a note that there is none."""
    units = run.system.units
    if run.system.cell.pbc.all() and len(run.system) > 1:
        r, g = radial_distribution(run)
        panel.axhline(1.0, color="0.7", lw=0.8)
        panel.plot(r, g, color=STRUCTURE, **STYLE)
        panel.set(
            xlabel=f"r  [{units.length}]",
            ylabel="g(r)",
            title="radial distribution, all atoms",
            xlim=(0.0, r[-1]),
            ylim=(0.0, None),
        )
    elif run.contents.n_frames > 1:
        panel.plot(*mean_square_displacement(run), color=STRUCTURE, **STYLE)
        panel.set(
            xlabel=f"lag  [{units.shown_time}]",
            ylabel=f"⟨|r(t) − r(0)|²⟩  [{units.length}²]",
            title="mean-square displacement",
        )
    else:
        panel.text(
            0.5,
            0.5,
            "one frame only, no displacement",
            ha="center",
            va="center",
            transform=panel.transAxes,
            color="0.4",
        )
