"""Pictures of a record: change of the energy, temperature, momentum, volume, pressure. Drawn without a window."""

from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from minimd.core.structure.arrays import Array
from minimd.core.structure.units import UnitSystem

INCHES = (10.0, 7.0)
DOTS_PER_INCH = 150
ENERGY, TEMPERATURE, MOMENTUM, VOLUME, STRUCTURE, ACCENT = (
    "#1f5fa8",
    "#c8501e",
    "#5b3f99",
    "#8a6d1f",
    "#1b7f5c",
    "#222222",
)
STYLE: dict[str, Any] = {"lw": 1.1, "solid_joinstyle": "round"}


class DrawnRecord(Protocol):
    """The parts of a Record that are drawn; see there."""

    units: UnitSystem
    n_atoms: int
    conserves_momentum: bool

    def __len__(self) -> int: ...

    def __contains__(self, name: str) -> bool: ...

    def __getattr__(self, name: str) -> Array: ...


Drawing = Callable[[Axes, Array, DrawnRecord], None]


class Picture(Figure):
    """A figure that a notebook shows even if pyplot was not imported."""

    def _repr_png_(self) -> bytes:
        """Called by Jupyter."""
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=DOTS_PER_INCH // 2)
        return stream.getvalue()


def empty_panels(n: int) -> tuple[Picture, list[Axes]]:
    """An empty picture and its n panels, two in a row."""
    n_rows = (n + 1) // 2
    size = (INCHES[0], INCHES[1] / 2.0 * n_rows)
    figure = Picture(figsize=size, dpi=DOTS_PER_INCH, layout="constrained")
    panels = figure.subplots(n_rows, 2).ravel().tolist()
    if n % 2:
        panels.pop().remove()
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(alpha=0.25, lw=0.6)
    return figure, panels


def picture_of(record: DrawnRecord) -> Picture:
    """See Record.plot."""
    if not len(record):
        raise ValueError("there is nothing to plot: the record has no entries")
    quantities = drawn_quantities(record, 4)
    figure, panels = empty_panels(len(quantities))
    draw_quantities(panels, record, quantities)
    return figure


def drawn_quantities(record: DrawnRecord, fewest: int) -> list[Drawing]:
    """What is drawn of a record: energy and temperature; momentum, if it is conserved; volume and pressure, if the
    volume changes; pressure and potential energy as long as there are fewer than `fewest`."""
    chosen: list[Drawing] = [draw_energy, draw_temperature]
    if record.conserves_momentum:
        chosen.append(draw_momentum)
    if "volume" in record:
        chosen += [draw_volume, draw_pressure]
    elif "pressure" in record and len(chosen) < fewest:
        chosen.append(draw_pressure)
    if len(chosen) < fewest:
        chosen.append(draw_potential_energy)
    return chosen


def draw_quantities(
    panels: Sequence[Axes], record: DrawnRecord, quantities: Sequence[Drawing]
) -> None:
    """Draw the quantities of a record against time, each into its panel; panels may be more."""
    times = record.time * record.units.to_picosecond
    for draw, panel in zip(quantities, panels, strict=False):
        draw(panel, times, record)
        if len(times) == 1:
            panel.lines[0].set_marker("o")
        panel.set_xlabel(f"time  [{record.units.shown_time}]")
        panel.margins(x=0.01)
        panel.title.set_fontsize(10)


def draw_energy(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """Change of the total energy per atom since the start, minus heat of a bath."""
    energy = record.total_energy
    name = "total energy"
    formula = "(E − E₀)"
    if "conserved_energy" in record:
        energy = record.conserved_energy
        name = "total energy − heat"
        formula = "(E − Q − E₀)"
    change, factor = scaled((energy - energy[0]) / record.n_atoms)
    panel.plot(times, change, color=ENERGY, **STYLE)
    panel.set_ylabel(f"{formula} / N  [{factor}{record.units.energy}]")
    kinetic = f"{record.kinetic_energy.mean() / record.n_atoms:.3g} {record.units.energy}"
    panel.set_title(f"{name} per atom   (kinetic energy: {kinetic})")


def draw_temperature(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """The kinetic temperature, and its mean."""
    unit = record.units.temperature.replace("k_B", "$k_B$")
    _draw_with_mean(panel, times, record.temperature, TEMPERATURE, ("temperature", "T", unit))


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


def draw_volume(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """The volume of the cell, and its mean."""
    names = ("volume", "V", record.units.volume)
    _draw_with_mean(panel, times, record.volume, VOLUME, names)


def draw_pressure(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """The pressure, and its mean."""
    units = record.units
    names = ("pressure", "P", units.shown_pressure)
    _draw_with_mean(panel, times, units.to_shown_pressure * record.pressure, STRUCTURE, names)


def draw_potential_energy(panel: Axes, times: Array, record: DrawnRecord) -> None:
    """The potential energy per atom, and its mean."""
    names = ("potential energy per atom", "U / N", record.units.energy)
    _draw_with_mean(panel, times, record.potential_energy / record.n_atoms, VOLUME, names)


def _draw_with_mean(
    panel: Axes, times: Array, values: Array, color: str, names: tuple[str, str, str]
) -> None:
    """A series, and its mean.
    names : of the quantity, of its symbol, of its unit."""
    name, symbol, unit = names
    panel.plot(times, values, color=color, **STYLE)
    panel.axhline(values.mean(), color=ACCENT, lw=1.0, ls="--")
    digits = 6 if np.abs(values.mean()) >= 1e4 else 4
    mean = f"{values.mean():.{digits}g} {unit}"
    panel.set(ylabel=f"{symbol}  [{unit}]", title=f"{name}   (mean: {mean})")
    panel.ticklabel_format(axis="y", useOffset=False)


def scaled(values: Array) -> tuple[Array, str]:
    """Values over a power of ten, and that power as part of a unit; unchanged if zero, or between 0.01 and 1000."""
    size = float(np.abs(values).max())
    power = int(np.floor(np.log10(size))) if 0.0 < size < np.inf else 0
    return (values, "") if -2 <= power <= 2 else (values / 10.0**power, f"$10^{{{power}}}$ ")
