"""The results of an ensemble as a table: a row for each member, or averages over members with the same parameters."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.whole_file import write_picture, write_whole
from minimd.core.console.words import listed, near
from minimd.core.engine.record import SERIES
from minimd.core.structure.errors import sentence
from minimd.core.structure.statistics import with_error
from minimd.core.structure.units import ASE, SYSTEMS, UnitSystem
from minimd.ensemble.folder import DESCRIPTION, Asked, EnsembleFolder, alone
from minimd.ensemble.member import (
    BEGUN,
    DONE,
    FAILED,
    MISSING,
    NOTE,
    STATES,
    file_of,
    member_text,
    read_note,
    value_text,
)

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

SHOWN_FAILURES = 3
# observables listed first, and not listed, as text; if no others exist, all are listed
TOLD = "temperature", "potential_energy", "pressure"
LEFT_OUT = "kinetic_energy", "total_energy", "conserved_energy"
MOST_LINES = 100  # of the lines for each set of parameters
MOST_TOLD = 10  # members that are listed as running, and as begun
DRAWN = ("pressure", "potential_energy")
MOST_CURVES = 8


class EnsembleTable(Displayed):
    """The results of the members of an ensemble, in the order of their indices.

    Attributes
    ----------
    array : structured array: index, the parameters, status, n_steps, n_atoms, <name>_mean and <name>_error of each
        observable, file, message. status is "done", "failed", "begun" (stopped before its end) or "missing".
        Means are NaN for a member that is not done.
    folder : of the ensemble.
    parameters, observables : names.
    units : the UnitSystem of the observables, None if it is not known.

    table["pressure_mean"] is a column of the array.
    """

    def __init__(
        self, folder: Path, names: Sequence[str], array: NDArray[Any], units: UnitSystem | None
    ) -> None:
        self.folder = folder
        self.parameters = tuple(names)
        self.array = array
        self.units = units
        means = [name for name in array.dtype.names or () if name.endswith("_mean")]
        self.observables = tuple(name.removesuffix("_mean") for name in means)

    def __getitem__(self, name: str) -> NDArray[Any]:
        columns = self._columns()
        if name not in columns:
            raise KeyError(
                f"a table has no column {name!r}; it has {', '.join(columns)}{near(name, columns)}"
            )
        return columns[name]

    def __len__(self) -> int:
        return len(self.array)

    @property
    def done(self) -> NDArray[np.bool_]:
        """Which members are done."""
        return np.asarray(self["status"] == DONE)

    def averaged(self) -> NDArray[Any]:
        """Structured array with a row for each set of parameters: the parameters, the number n_members of members done,
        their means and errors.

        The error of a mean over M ≥ 2 members is the larger of √(Σ σ²) / M, with the error σ of each member, and the
        standard error that follows from the scatter of their means. Sets without a member that is done are left out.
        """
        rows = self.array[self.done]
        # the number of each set, in the order of their members
        kinds = [np.zeros(len(rows), dtype=np.int64)]
        kinds += [np.unique(rows[name], return_inverse=True)[1] for name in self.parameters]
        sets = dict[tuple, int]()
        keys = zip(*kinds, strict=True)
        groups = np.array([sets.setdefault(key, len(sets)) for key in keys], dtype=np.int64)
        n_sets = len(sets)
        n = np.bincount(groups, minlength=n_sets)
        first = np.unique(groups, return_index=True)[1]
        columns = {name: rows[name][first] for name in self.parameters}
        columns["n_members"] = n

        for name in self.observables:
            means = rows[f"{name}_mean"]
            errors = rows[f"{name}_error"]
            mean = np.bincount(groups, means, n_sets) / n
            squares = np.bincount(groups, (means - mean[groups]) ** 2, n_sets)
            scatter = np.full(n_sets, np.nan)
            np.divide(squares, n * (n - 1.0), out=scatter, where=n > 1)
            inner = np.sqrt(np.bincount(groups, errors**2, n_sets)) / n
            columns[f"{name}_mean"] = mean
            columns[f"{name}_error"] = np.fmax(inner, np.sqrt(scatter))

        return _structured(columns)

    def unit(self, name: str) -> str:
        """The unit of an observable, in words; empty for a pure number, or if it is not known."""
        if self.units is None:
            return ""
        if name == "density" and "volume" in self.observables:
            return "g/cm³" if self.units == ASE else f"atoms/{self.units.volume}"
        return str(getattr(self.units, SERIES.get(name) or "", ""))

    def shown(self, name: str, rows: NDArray[Any]) -> tuple[Any, Any, str]:
        """Means and errors of an observable in rows of averaged(), in the unit in which it is shown, and this unit:
        pressures are in bar with ASE's units."""
        factor = 1.0
        unit = self.unit(name)
        if self.units is not None and SERIES.get(name) == "pressure":
            factor = self.units.to_shown_pressure
            unit = self.units.shown_pressure
        return factor * rows[f"{name}_mean"], factor * rows[f"{name}_error"], unit

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame with the columns of the array, and the index of the members as its index.

        Raises ModuleNotFoundError if pandas is not installed; minimd itself does not need it.
        """
        try:
            from pandas import DataFrame
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "to_pandas needs pandas, which is not installed: install it, or use table.array or table.csv"
            ) from error
        return DataFrame(self._columns()).set_index("index")

    def plot(self, quantity: str | None = None) -> Figure:
        """A figure of one observable against the first parameter that has several numbers as values, with error bars; a
        curve for each set of values of the others. In a notebook it appears in the cell; .savefig(path) writes a file.

        quantity : name of an observable; if not given, pressure, else potential energy, else the first.

        Raises ValueError if no member is done, or none has such an observable.
        """
        from minimd.core.engine.record_picture import Picture
        from minimd.scene.section import quantity_of  # takes its time to load

        name = drawn_quantity(self, quantity)
        rows = self.averaged()
        several = [
            parameter for parameter in self.parameters if len(set(rows[parameter].tolist())) > 1
        ]
        x_name = next(
            (parameter for parameter in several if rows.dtype[parameter].kind in "if"), None
        )
        others = [parameter for parameter in several if parameter != x_name]
        means, errors, unit = self.shown(name, rows)
        figure = Picture(figsize=(7.0, 4.5), dpi=150, layout="constrained")
        axes = figure.subplots()
        curves = dict[str, list[int]]()
        for k, row in enumerate(rows):
            values = [
                f"{parameter.rpartition('.')[2]} = {value_text(row[parameter])}"
                for parameter in others
            ]
            curves.setdefault(", ".join(values), []).append(k)

        for label, members in curves.items():
            curve = np.array(members)
            x = np.arange(len(curve))
            if x_name is not None:
                curve = curve[np.argsort(rows[x_name][curve])]
                x = rows[x_name][curve]
            axes.errorbar(
                x,
                means[curve],
                errors[curve],
                marker="o",
                ms=3.5,
                lw=1.0,
                capsize=2.5,
                label=label.replace("$", r"\$"),
            )

        unit = unit.replace("k_B", "$k_B$")
        quantity = name.replace("_", " ").replace("$", r"\$")
        axes.set_xlabel(quantity_of(x_name or "set of parameters"), parse_math=False)
        axes.set_ylabel(f"mean {quantity}  [{unit}]" if unit else f"mean {quantity}")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, lw=0.6)
        axes.set_title(f"{int(self.done.sum())} members, bars: one standard error", fontsize=10)
        if 1 < len(curves) <= MOST_CURVES:
            axes.legend(frameon=False, fontsize=8)
        return figure

    def _columns(self) -> dict[str, Any]:
        """The columns of the array, by name."""
        return {name: self.array[name] for name in self.array.dtype.names or ()}

    def write(self) -> None:
        """Write table.csv, its titles with units, and table.json into the folder; numbers have all their digits, paths
        are relative to the folder.
        Raises OSError."""
        columns = {name: column.tolist() for name, column in self._columns().items()}
        for index, file in enumerate(columns["file"]):
            if file:
                columns["file"][index] = file_of(index).as_posix()
        stream = io.StringIO()
        lines = csv.writer(stream, lineterminator="\n")
        units = {name: self.unit(name) for name in self.observables if self.unit(name)}
        titles = {f"{name}_{of}": unit for name, unit in units.items() for of in ("mean", "error")}
        lines.writerow(f"{name} [{titles[name]}]" if name in titles else name for name in columns)
        lines.writerows(zip(*columns.values(), strict=True))
        write_whole(self.folder / "table.csv", stream.getvalue())
        for name, column in columns.items():
            columns[name] = [None if number != number else number for number in column]
        table = {"parameters": self.parameters, "units": units, "columns": columns}
        write_whole(self.folder / "table.json", json.dumps(table))

    def failures(self, members: range | None = None) -> Iterator[str]:
        """A sentence for each member that has failed.
        members : consecutive indices of those that are told, None for all."""
        rows = self.array if members is None else self.array[members.start : members.stop]
        for row in rows[rows["status"] == FAILED]:
            parameters = {name: row[name] for name in self.parameters}
            yield f"{member_text(row['index'], parameters)}: {row['message']}"

    def display_rows(self) -> Rows:
        """See Displayed."""
        counts = Counter(self["status"].tolist())
        states = ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])
        rows = [("ensemble", f"{len(self)} members in {self.folder}: {states}")]
        for name in self.parameters:
            values = self[name]
            limits = ""
            if values.dtype.kind in "if":
                limits = f", {value_text(values.min())} to {value_text(values.max())}"
            rows.append((name, f"{len(set(values.tolist()))} values{limits}"))
        if self.done.any():
            first, *others = told_averages(self)
            rows.append(("means", first))
            rows += [("", line) for line in others]
        failures = list(self.failures())
        rows += [("FAILED", failure) for failure in failures[:SHOWN_FAILURES]]
        n_more = len(failures) - SHOWN_FAILURES
        if n_more > 0:
            rows.append(("", f"and {n_more} more"))
        return rows

    def __repr__(self) -> str:
        return f"EnsembleTable({len(self)} members, {', '.join([*self.parameters, *self.observables])})"


def _structured(columns: dict[str, Any]) -> NDArray[Any]:
    """A structured array of these columns."""
    n_rows = len(next(iter(columns.values())))
    array = np.empty(n_rows, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        array[name] = column
    return array


def table_of(folder: EnsembleFolder, asked: Asked, n_members: int) -> EnsembleTable:
    """The table of the first n_members members of a folder.

    Results are those of members that have failed, or are done with all steps that are asked for now.
    """
    on_disk = folder.files()
    rows = []
    states = []
    files = []

    for index in range(n_members):
        row = folder.rows.get(index, {})
        has_result = bool(row) and (row["status"] == FAILED or asked.is_done(row))
        rows.append(row if has_result else {})
        place = file_of(index).as_posix()
        files.append(str(folder.path / place) if place in on_disk else "")
        states.append(rows[-1].get("status", BEGUN if files[-1] else MISSING))

    columns: dict[str, Any] = {"index": np.arange(n_members)}
    for name in asked.parameters[0]:
        columns[name] = np.array([values[name] for values in asked.parameters[:n_members]])
    columns["status"] = np.array(states)
    for name in ("n_steps", "n_atoms"):
        columns[name] = np.array([row.get(name, 0) for row in rows], dtype=np.int64)
    names = list(dict.fromkeys(name for row in rows for name in row.get("means", ())))

    for ending, key in (("_mean", "means"), ("_error", "errors")):
        results = [row.get(key, {}) for row in rows]
        for name in names:
            numbers = [result.get(name, np.nan) for result in results]
            columns[name + ending] = np.array(numbers, dtype=np.float64)

    columns["file"] = np.array(files, object)
    columns["message"] = np.array([row.get("message", "") for row in rows], object)
    units = {row["units"] for row in rows if "units" in row}
    known = SYSTEMS.get(units.pop()) if len(units) == 1 else None
    return EnsembleTable(folder.path, list(asked.parameters[0]), _structured(columns), known)


def written_table(folder: EnsembleFolder, asked: Asked, n_members: int) -> EnsembleTable:
    """The same, written into the folder; it has all members if other calls may run there.
    Raises OSError."""
    with alone(folder.path):
        if folder.members is not None:
            folder.read()
            asked = folder.asked or asked
            n_members = len(asked.parameters)
        table = table_of(folder, asked, n_members)
        table.write()
    return table


def status(folder: Path) -> tuple[EnsembleTable, list[str]]:
    """The table as it is now, and lines about it.
    Raises FileNotFoundError, ValueError for a folder without an ensemble."""
    with EnsembleFolder(folder, writes=False) as opened:
        if opened.asked is None:
            raise FileNotFoundError(
                f"folder {str(folder)!r} holds no ensemble: there is no {DESCRIPTION} in it"
            )

        table = table_of(opened, opened.asked, len(opened.asked.parameters))
        steps = opened.asked.steps
        noted = sorted(int(Path(name).stem) for name in opened.files() if name.endswith(NOTE))

    notes = {index: read_note(opened.file(index)) for index in noted}
    running = [index for index in noted if notes[index]]
    begun = np.flatnonzero(table["status"] == BEGUN).tolist()
    stopped = [index for index in begun if not notes.get(index)]
    lines = str(table).splitlines()

    for word, members in (("running", running), ("begun", stopped)):
        for index in members[:MOST_TOLD]:
            progress = notes.get(index) or _progress(table["file"][index], steps)
            lines.append(f"{word:<14} member {index}: {progress}")
        n_more = len(members) - MOST_TOLD
        if n_more > 0:
            lines.append(f"{'':<14} and {n_more} more")

    return table, lines


def _progress(file: str, steps: int) -> str:
    """The progress of a member in words. A file that is being written cannot be read."""
    from minimd.core.files.h5md_reader import read_file

    try:
        contents = read_file(file)
        return f"stopped after {contents.step - int(contents.record.step[0])} of {steps} steps"
    except (OSError, ValueError) as error:
        return "running" if isinstance(error, BlockingIOError) else sentence(error)


def told_averages(table: EnsembleTable) -> Iterator[str]:
    """A line of names, then the averages over members with the same parameters, a line for each of the first hundred
    sets."""
    rows = table.averaged()
    names = [name for name in TOLD if name in table.observables]
    for name in table.observables:
        if name not in (*TOLD, *LEFT_OUT) and "momentum" not in name:
            names.append(name)
    names = [name for name in names if not _is_constant(rows, name)] or list(table.observables)
    columns = [[name, *map(value_text, rows[name][:MOST_LINES])] for name in table.parameters]
    columns.append(["members", *map(str, rows["n_members"][:MOST_LINES])])

    for name in names:
        means, errors, unit = table.shown(name, rows)
        title = name.replace("_", " ")
        averages = zip(means, errors, strict=True)
        cells = [with_error(*average) for average in islice(averages, MOST_LINES)]
        columns.append([f"{title} [{unit}]" if unit else title, *cells])

    widths = [max(map(len, column)) for column in columns]
    for line in zip(*columns, strict=True):
        yield "  ".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True))
    if len(rows) > MOST_LINES:
        yield f"and {len(rows) - MOST_LINES} more, see {table.folder / 'table.csv'}"


def _is_constant(rows: NDArray[Any], name: str) -> bool:
    """Whether an observable is a component of the cell that never changes."""
    means = rows[f"{name}_mean"]
    is_one = np.all(means == means[0]) and np.all(rows[f"{name}_error"] == 0.0)
    return name.startswith("cell_") and bool(is_one)


def drawn_quantity(table: EnsembleTable, quantity: str | None) -> str:
    """The observable of the figure: quantity, or if it is None, pressure, else potential energy, else the first.
    Raises ValueError."""
    if not table.observables:
        raise ValueError("there is nothing to draw: no member is done yet")
    if quantity is None:
        return next((name for name in DRAWN if name in table.observables), table.observables[0])
    return checked_quantity(quantity, table.observables)


def checked_quantity(quantity: str, observables: Sequence[str]) -> str:
    """The name of an observable.
    Raises ValueError if it is none of these."""
    if quantity not in observables:
        hint = near(quantity, observables)
        raise ValueError(
            f"the quantity must be one of {listed(observables)}; it is {quantity!r}{hint}"
        )
    return quantity


def save_picture(
    table: EnsembleTable, quantity: str | None = None, out: Path | None = None
) -> Path:
    """Save the figure to out, or to a file in the folder named after the quantity.
    Raises ValueError as EnsembleTable.plot, OSError."""
    place = out or table.folder / f"{drawn_quantity(table, quantity)}.png"
    return write_picture(table.plot(quantity), place)
