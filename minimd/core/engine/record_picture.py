"""Pictures of a record: change of the energy, temperature, change of the momentum, pressure. Drawn without a window."""

from io import BytesIO
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from minimd.core.structure.units import UnitSystem

INCHES = (10.0, 7.0)
DOTS_PER_INCH = 150
ENERGY, TEMPERATURE, MOMENTUM, STRUCTURE, ACCENT = (
    "#1f5fa8",
    "#c8501e",
    "#5b3f99",
    "#1b7f5c",
    "#222222",
)
Array = NDArray[np.float64]
STYLE: dict[str, Any] = {"lw": 1.1, "solid_joinstyle": "round"}


class DrawnRecord(Protocol):
    """The parts of a Record that are drawn; see there."""

    units: UnitSystem
    n_atoms: int

    def __len__(self) -> int: ...

    def __contains__(self, name: str) -> bool: ...

    def __getattr__(self, name: str) -> Array: ...


class Picture(Figure):
    """A figure that a notebook shows even if pyplot was not imported."""

    def _repr_png_(self) -> bytes:
        """Called by Jupyter."""
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=DOTS_PER_INCH // 2)
        return stream.getvalue()


def four_panels(more: int = 0) -> tuple[Picture, list[Axes]]:
    """An empty picture and its panels, row by row: four, and as many more as asked for."""
    n_rows = 2 + (more + 1) // 2
    figure = Picture(
        figsize=(INCHES[0], INCHES[1] / 2.0 * n_rows), dpi=DOTS_PER_INCH, layout="constrained"
    )
    *panels, last = figure.subplots(n_rows, 2).ravel()
    if more % 2:
        last.remove()
    else:
        panels.append(last)
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(alpha=0.25, lw=0.6)
    return figure, panels


def picture_of(record: DrawnRecord) -> Picture:
    """See Record.plot."""
    if not len(record):
        raise ValueError("there is nothing to plot: the record has no entries")
    figure, panels = four_panels()
    times = record.time * record.units.to_picosecond
    unit = record.units.shown_time
    for draw, panel in zip(
        (draw_energy, draw_temperature, draw_momentum, draw_pressure), panels, strict=True
    ):
        draw(panel, times, record)
        panel.set_xlabel(f"time  [{unit}]")
        panel.margins(x=0.01)
        panel.title.set_fontsize(10)
    return figure


def draw_energy(panel: Axes, times: Array, record: DrawnRecord) -> Array:
    """Change of the total energy per atom since the start, minus heat of a bath; returned in the unit of the axis."""
    energy = record.total_energy
    name = "total energy"
    formula = "(E − E₀)"
    if "conserved_energy" in record:
        energy = record.conserved_energy
        name = "total energy − heat"
        formula = "(E − Q − E₀)"
    change, factor = scaled((energy - energy[0]) / record.n_atoms)
    panel.plot(times, change, color=ENERGY, label=name, **STYLE)
    panel.set_ylabel(f"{formula} / N  [{factor}{record.units.energy}]")
    kinetic = f"{record.kinetic_energy.mean() / record.n_atoms:.3g} {record.units.energy}"
    panel.set_title(f"{name} per atom   (kinetic energy: {kinetic})")
    return change


def draw_temperature(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """The kinetic temperature, and its mean."""
    temperature = record.temperature
    unit = record.units.temperature.replace("k_B", "$k_B$")
    panel.plot(times, temperature, color=TEMPERATURE, **STYLE)
    panel.axhline(temperature.mean(), color=ACCENT, lw=1.0, ls="--")
    panel.set(ylabel=f"T  [{unit}]", title=f"temperature   (mean: {temperature.mean():.4g} {unit})")
    panel.ticklabel_format(axis="y", useOffset=False)


def draw_momentum(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """Change of the total momentum, as a fraction of Σ|mv|."""
    changes = np.linalg.norm(record.momentum - record.momentum[0], axis=1) / (
        record.absolute_momentum.max() or 1.0
    )
    values, factor = scaled(changes)
    panel.plot(times, values, color=MOMENTUM, **STYLE)
    label = f"|P − P₀| / Σ|mv|{f'  [{factor.strip()}]' if factor else ''}"
    panel.set(
        ylabel=label,
        title=f"total momentum   (largest change: {changes.max():.1e})",
        ylim=(0.0, None),
    )


def draw_pressure(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """The pressure, or the potential energy per atom if there is no pressure."""
    name = "potential energy per atom"
    values = record.potential_energy / record.n_atoms
    unit = record.units.energy
    if "pressure" in record:
        name = "pressure"
        values = record.pressure
        unit = record.units.pressure
    panel.plot(times, values, color=STRUCTURE, **STYLE)
    panel.axhline(values.mean(), color=ACCENT, lw=1.0, ls="--")
    symbol = "P" if name == "pressure" else "U / N"
    panel.set(ylabel=f"{symbol}  [{unit}]", title=f"{name}   (mean: {values.mean():.4g} {unit})")
    panel.ticklabel_format(axis="y", useOffset=False)


def scaled(values: Array) -> tuple[Array, str]:
    """Values over a power of ten, and that power as part of a unit; unchanged if zero, or between 0.01 and 1000."""
    size = float(np.abs(values).max())
    power = int(np.floor(np.log10(size))) if 0.0 < size < np.inf else 0
    return (values, "") if -2 <= power <= 2 else (values / 10.0**power, f"$10^{{{power}}}$ ")
