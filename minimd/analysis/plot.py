"""A run in one picture: energy, temperature, momentum, structure."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from minimd.analysis.picture import four_panels, save
from minimd.diagnosis.report import drift
from minimd.files.h5md_reader import H5MDContents
from minimd.mdanalysis.universes import RunUniverse, mean_square_displacement, radial_distribution, universe_of

ENERGY, TEMPERATURE, MOMENTUM, STRUCTURE, ACCENT = "#1f5fa8", "#c8501e", "#5b3f99", "#1b7f5c", "#222222"
Array = NDArray[np.float64]
STYLE: dict[str, Any] = {"lw": 1.1, "solid_joinstyle": "round"}


def plot_file(path: str | Path, out: str | Path | None = None) -> Path:
    """Draw a minimd file and return the name of the picture.

    Four panels: change of the total energy per atom, temperature, change of the total momentum, and g(r) where the cell is
    periodic in all directions, else the mean-square displacement.
    out : the picture, in a format that matplotlib knows by its suffix; the name of the file with .png if not given.

    Raises FileNotFoundError, OSError, ValueError as universe, or if the picture cannot be written.
    """
    with universe_of(path) as made:
        figure = drawn(made)
    return save(figure, Path(path).with_suffix(".png") if out is None else Path(out))


def drawn(made: RunUniverse) -> Figure:
    """The picture of plot_file, of a run whose universe is open, not yet written anywhere."""
    figure, panels = four_panels()
    contents = made.contents
    for draw, panel in zip((_energy, _temperature, _momentum), panels, strict=False):
        draw(panel, contents.record.time * contents.system.units.to_picosecond, contents)
        panel.set_xlabel(f"time  [{contents.system.units.shown_time}]")
    _structure(panels[3], made)
    for panel in panels:
        panel.margins(x=0.01)
        panel.title.set_fontsize(10)
    figure.suptitle(f"{contents.title}, {contents.method}, {contents.n_frames} frames", fontsize=11)
    return figure


def _energy(panel: Axes, times: Array, contents: H5MDContents) -> None:
    """Total energy per atom, minus heat Q if there is a bath, since its start, with the line of its drift."""
    record = contents.record
    has_bath = "conserved_energy" in record
    energy, name = (record.conserved_energy, "total energy − heat") if has_bath else (record.total_energy, "total energy")
    change, factor = _scaled((energy - energy[0]) / record.n_atoms)
    panel.plot(times, change, color=ENERGY, label=name, **STYLE)
    panel.plot(times, change.mean() + drift(times, change).slope * (times - times.mean()), color=ACCENT, lw=1.0, ls="--", label="drift")
    panel.set_ylabel(f"{'(E − Q − E₀)' if has_bath else '(E − E₀)'} / N  [{factor}{record.units.energy}]")
    panel.set_title(f"{name} per atom   (kinetic energy: {record.kinetic_energy.mean() / record.n_atoms:.3g} {record.units.energy})")
    panel.margins(y=0.12)
    panel.legend(frameon=False, fontsize=8, ncols=2, loc="lower right", borderaxespad=0.0)


def _temperature(panel: Axes, times: Array, contents: H5MDContents) -> None:
    temperature, unit = contents.record.temperature, contents.system.units.temperature.replace("k_B", "$k_B$")
    panel.plot(times, temperature, color=TEMPERATURE, **STYLE)
    panel.axhline(temperature.mean(), color=ACCENT, lw=1.0, ls="--")
    panel.set(ylabel=f"T  [{unit}]", title=f"temperature   (mean: {temperature.mean():.4g} {unit})")
    panel.ticklabel_format(axis="y", useOffset=False)


def _momentum(panel: Axes, times: Array, contents: H5MDContents) -> None:
    record = contents.record
    changes = np.linalg.norm(record.momentum - record.momentum[0], axis=1) / (record.absolute_momentum.max() or 1.0)
    shown, factor = _scaled(changes)
    panel.plot(times, shown, color=MOMENTUM, **STYLE)
    label = f"|P − P₀| / Σ|mv|{f'  [{factor.strip()}]' if factor else ''}"
    panel.set(ylabel=label, title=f"total momentum   (largest change: {changes.max():.1e})", ylim=(0.0, None))


def _scaled(values: Array) -> tuple[Array, str]:
    """Values divided by a power of ten, and that power as part of a unit; unchanged if they are zero, or between 0.01 and 1000."""
    size = float(np.abs(values).max())
    power = int(np.floor(np.log10(size))) if 0.0 < size < np.inf else 0
    return (values, "") if -2 <= power <= 2 else (values / 10.0**power, f"$10^{{{power}}}$ ")


def _structure(panel: Axes, made: RunUniverse) -> None:
    """g(r) if it can be had, else the mean-square displacement, else a note that there is none."""
    system = made.contents.system
    if system.cell.pbc.all() and len(system) > 1:
        r, g = radial_distribution(made)
        panel.axhline(1.0, color="0.7", lw=0.8)
        panel.plot(r, g, color=STRUCTURE, **STYLE)
        panel.set(xlabel=f"r  [{system.units.length}]", ylabel="g(r)", xlim=(0.0, r[-1]), ylim=(0.0, None), title="radial distribution, all atoms")
    elif made.contents.n_frames > 1:
        lags, squares = mean_square_displacement(made)
        panel.plot(lags, squares, color=STRUCTURE, **STYLE)
        panel.set(xlabel=f"lag  [{system.units.shown_time}]", ylabel=f"⟨|r(t) − r(0)|²⟩  [{system.units.length}²]", title="mean-square displacement")
    else:
        panel.text(0.5, 0.5, "one frame only, no displacement", ha="center", va="center", transform=panel.transAxes, color="0.4")
