"""The averages of a table as text, and a figure of one quantity against a parameter."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from minimd.ensemble.table import EnsembleTable
from minimd.structure.checks import listed, near
from minimd.structure.statistics import with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOLD = ("temperature", "potential_energy", "pressure")  # observables listed as text; if none of them exists, all are listed
DRAWN = ("pressure", "potential_energy")
MOST_CURVES = 8
MOST_LINES = 100


def told_averages(table: EnsembleTable) -> Iterator[str]:
    """A line of names, then the averages over members with the same parameters, a line for each of the first hundred sets."""
    rows = table.averaged()
    names = [name for name in TOLD if name in table.observables] or list(table.observables)
    units = {name: f" [{table.unit(name)}]" if table.unit(name) else "" for name in names}
    lines = [[*table.parameters, "members", *(f"{name.replace('_', ' ')}{units[name]}" for name in names)]]
    for row in rows[:MOST_LINES]:
        means = [with_error(row[f"{name}_mean"], row[f"{name}_error"]) for name in names]
        lines.append([*(str(row[name]) for name in table.parameters), str(row["n_members"]), *means])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        yield "  ".join(f"{word:>{width}}" for word, width in zip(line, widths, strict=True))
    if len(rows) > MOST_LINES:
        yield f"and {len(rows) - MOST_LINES} more, see {table.folder / 'table.csv'}"


def drawn_quantity(table: EnsembleTable, quantity: str | None) -> str:
    """The observable of the figure: quantity, or if it is None, pressure, else potential energy, else the first.  Raises ValueError."""
    if not table.observables:
        raise ValueError("there is nothing to draw: no member is done yet")
    if quantity is None:
        return next((name for name in DRAWN if name in table.observables), table.observables[0])
    if quantity not in table.observables:
        raise ValueError(f"the quantity must be one of {listed(table.observables)}; it is {quantity!r}{near(quantity, table.observables)}")
    return quantity


def picture_of_scan(table: EnsembleTable, quantity: str | None = None) -> Figure:
    """One quantity against the first parameter that has several numbers as values, with error bars; a curve for each set of values of the others.

    Raises ValueError if no member is done, or none has such a quantity.
    """
    from minimd.engine.record_picture import Picture

    name, rows = drawn_quantity(table, quantity), table.averaged()
    numbers = [one for one in table.parameters if rows.dtype[one].kind in "if" and len(set(rows[one].tolist())) > 1]
    others = [one for one in table.parameters if one not in numbers[:1]]
    figure = Picture(figsize=(7.0, 4.5), dpi=150, layout="constrained")
    axes = figure.subplots()
    curves: dict[tuple, list[int]] = {}
    for k, row in enumerate(rows):
        curves.setdefault(tuple(row[one] for one in others), []).append(k)
    several = {one for one in others if len(set(rows[one].tolist())) > 1}
    for key, members in curves.items():
        curve = rows[members][np.argsort(rows[members][numbers[0]])] if numbers else rows[members]
        x = curve[numbers[0]] if numbers else np.arange(len(curve))
        label = ", ".join(f"{one.rpartition('.')[2]} = {value}" for one, value in zip(others, key, strict=True) if one in several)
        axes.errorbar(x, curve[f"{name}_mean"], curve[f"{name}_error"], marker="o", ms=3.5, lw=1.0, capsize=2.5, label=label)
    _finish(axes, table, name, numbers, len(curves))
    return figure


def _finish(axes: Any, table: EnsembleTable, name: str, numbers: list[str], n_curves: int) -> None:
    unit = table.unit(name).replace("k_B", "$k_B$")
    axes.set(xlabel=numbers[0] if numbers else "set of parameters", ylabel=f"mean {name.replace('_', ' ')}" + (f"  [{unit}]" if unit else ""))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, lw=0.6)
    axes.set_title(f"{int(table.done.sum())} members, bars: one standard error", fontsize=10)
    if 1 < n_curves <= MOST_CURVES:
        axes.legend(frameon=False, fontsize=8)


def save_picture(table: EnsembleTable, quantity: str | None = None, out: Path | None = None) -> Path:
    """Save the figure to out, or to a file in the folder named after the quantity.  Raises ValueError as picture_of_scan, OSError."""
    from minimd.analysis.picture import save

    place = out or table.folder / f"{drawn_quantity(table, quantity)}.png"
    return save(picture_of_scan(table, quantity), place)
