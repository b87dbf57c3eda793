"""The results of an ensemble as a table: a row for each member, or averages over members with the same parameters."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Displayed, Rows
from minimd.console.words import listed, near
from minimd.engine.record import SERIES
from minimd.ensemble.folder import DESCRIPTION, Asked, EnsembleFolder, is_done
from minimd.ensemble.member import file_of
from minimd.ensemble.work import BEGUN, DONE, FAILED, MISSING, SUFFIX, Row, read_note
from minimd.files.claim import write_whole
from minimd.structure.errors import sentence
from minimd.structure.statistics import with_error
from minimd.structure.units import SYSTEMS, UnitSystem

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
SHOWN_FAILURES = 3
# observables listed as text; if none of them exists, all are listed
TOLD = "temperature", "potential_energy", "pressure"
MOST_LINES = 100
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
    folder : of the ensemble.  parameters, observables : names.  units : the UnitSystem of the observables,
        None if it is not known.

    table["pressure_mean"] is a column of the array.
    """

    def __init__(self, folder: Path, names: Sequence[str], array: NDArray[Any], units: UnitSystem | None) -> None:
        self.folder, self.parameters, self.array, self.units = folder, tuple(names), array, units
        self.observables = tuple(
            name.removesuffix("_mean") for name in array.dtype.names or () if name.endswith("_mean")
        )

    def __getitem__(self, name: str) -> NDArray[Any]:
        names = self.array.dtype.names or ()
        if name not in names:
            raise KeyError(f"a table has no column {name!r}; it has {', '.join(names)}{near(name, names)}")
        return self.array[name]

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
        groups, first = _groups([rows[name] for name in self.parameters], len(rows))
        kinds: list[tuple[str, Any]] = [(name, rows.dtype[name]) for name in self.parameters] + [
            ("n_members", np.int64)
        ]
        kinds += [(name + ending, np.float64) for name in self.observables for ending in ("_mean", "_error")]
        made = np.zeros(len(first), dtype=kinds)
        for name in self.parameters:
            made[name] = rows[name][first]
        made["n_members"] = np.bincount(groups, minlength=len(first))
        for name in self.observables:
            made[f"{name}_mean"], made[f"{name}_error"] = _joined(
                rows[f"{name}_mean"], rows[f"{name}_error"], groups, made["n_members"]
            )
        return made

    def unit(self, name: str) -> str:
        """The unit of an observable, in words; empty for a pure number, or if it is not known."""
        return "" if self.units is None else str(getattr(self.units, SERIES.get(name) or "", ""))

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
        return DataFrame({name: self.array[name] for name in self.array.dtype.names or ()}).set_index("index")

    def write(self) -> None:
        """Write table.csv and table.json into the folder; numbers have all their digits,
        paths are relative to the folder.  Raises OSError."""
        columns = {name: self.array[name].tolist() for name in self.array.dtype.names or ()}
        columns["file"] = [
            file_of(index).as_posix() if file else ""
            for index, file in zip(columns["index"], columns["file"], strict=True)
        ]
        stream = io.StringIO()
        lines = csv.writer(stream, lineterminator="\n")
        lines.writerow(columns)
        lines.writerows(zip(*columns.values(), strict=True))
        write_whole(self.folder / "table.csv", stream.getvalue())
        units = {name: unit for name in self.observables if (unit := self.unit(name))}
        whole = {name: [None if number != number else number for number in values] for name, values in columns.items()}
        write_whole(
            self.folder / "table.json", json.dumps({"parameters": self.parameters, "units": units, "columns": whole})
        )

    def failures(self) -> Iterator[str]:
        """A sentence for each member that has failed."""
        for row in self.array[self["status"] == FAILED]:
            told = ", ".join(f"{name} = {row[name]}" for name in self.parameters)
            yield f"member {row['index']}{f' ({told})' if told else ''}: {row['message']}"

    def display_rows(self) -> Rows:
        """See Displayed."""
        counts = {status: int((self["status"] == status).sum()) for status in (DONE, FAILED, BEGUN, MISSING)}
        told = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        rows = [("ensemble", f"{len(self)} members in {self.folder}: {told}")]
        for name in self.parameters:
            values = self[name]
            limits = f", {values.min()} to {values.max()}" if values.dtype.kind in "if" else ""
            rows.append((name, f"{len(set(values.tolist()))} values{limits}"))
        averages = self.averaged()
        for name in (one for one in self.observables if "momentum" not in one and len(averages)):
            limits = _limits(averages[f"{name}_mean"], averages[f"{name}_error"])
            rows.append((f"mean {name}".replace("_", " "), f"{limits} {self.unit(name)}".rstrip()))
        several = list(self.failures())
        rows += [("FAILED", told) for told in several[:SHOWN_FAILURES]]
        return rows + ([("", f"and {len(several) - SHOWN_FAILURES} more")] if len(several) > SHOWN_FAILURES else [])

    def __repr__(self) -> str:
        return f"EnsembleTable({len(self)} members, {', '.join([*self.parameters, *self.observables])})"


def _limits(means: Floats, errors: Floats) -> str:
    """The lowest and the highest of the means of several sets of parameters, with their errors where these are known;
    that of one set."""
    if np.isnan(means).all():
        return "not known"
    lowest, highest = int(np.nanargmin(means)), int(np.nanargmax(means))
    told = [with_error(means[k], errors[k]) for k in (lowest, highest)]
    return f"from {told[0]} to {told[1]}" if lowest != highest else told[0]


def _groups(columns: Sequence[NDArray[Any]], n_rows: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The number of the group of each row, (R,), and the first row of each group, (G,),
    where rows with the same entries are a group.

    Groups are counted in the order of their first rows.
    """
    groups = np.zeros(n_rows, dtype=np.int64)
    for column in columns:
        kinds = np.unique(column, return_inverse=True)[1]
        groups = np.unique(groups * (kinds.max(initial=0) + 1) + kinds, return_inverse=True)[1]
    _, first, groups = np.unique(groups, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return np.argsort(order)[groups], first[order]


def _joined(means: Floats, errors: Floats, groups: NDArray[np.int64], n: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Means of the means of the n members of each group, and their errors, (G,); see EnsembleTable.averaged."""

    def summed(numbers: Floats) -> Floats:
        # without members, bincount returns integers
        return np.bincount(groups, numbers, minlength=len(n)).astype(np.float64)

    joined, inner = summed(means) / n, np.sqrt(summed(errors**2)) / n
    scatter = np.full(len(n), np.nan)
    np.divide(summed((means - joined[groups]) ** 2), n * (n - 1.0), out=scatter, where=n > 1)
    return joined, np.fmax(inner, np.sqrt(scatter))


def table_of(folder: EnsembleFolder, asked: Asked, n_members: int) -> EnsembleTable:
    """The table of the first n_members members of a folder.

    Results are those of members that have failed, or are done with all steps that are asked for now.
    """
    rows = [folder.rows.get(index) for index in range(n_members)]
    is_present = [row and (row["status"] == FAILED or is_done(row, asked.steps, bool(asked.run))) for row in rows]
    rows = [row if present else None for row, present in zip(rows, is_present, strict=True)]
    names = list(asked.parameters[0])
    observables = list(dict.fromkeys(name for row in rows if row is not None for name in row.get("means", ())))
    columns: dict[str, Any] = {"index": np.arange(n_members)}
    columns |= {name: np.array([one[name] for one in asked.parameters[:n_members]]) for name in names}
    there, names_of_files = folder.files(), [file_of(index).as_posix() for index in range(n_members)]
    columns["status"] = np.array(
        [
            row["status"] if row else BEGUN if name in there else MISSING
            for row, name in zip(rows, names_of_files, strict=True)
        ]
    )
    for name in ("n_steps", "n_atoms"):
        columns[name] = np.array([(row or {}).get(name, 0) for row in rows], dtype=np.int64)
    for ending, key in (("_mean", "means"), ("_error", "errors")):
        numbers = _numbers(rows, key, observables)
        columns |= {name + ending: numbers[:, k] for k, name in enumerate(observables)}
    files = [str(folder.path / name) if name in there else "" for name in names_of_files]
    columns["file"] = np.array(files, dtype=object)
    columns["message"] = np.array([(row or {}).get("message", "") for row in rows], dtype=object)
    array = np.empty(n_members, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        array[name] = column
    units = {row["units"] for row in rows if row is not None and "units" in row}
    return EnsembleTable(folder.path, names, array, SYSTEMS.get(units.pop()) if len(units) == 1 else None)


def _numbers(rows: Sequence[Row | None], key: str, names: list[str]) -> Floats:
    """The means or errors of these names in all rows, (R, names); NaN where there is none."""
    numbers = np.full((len(rows), len(names)), np.nan)
    for k, row in enumerate(rows):
        found = row.get(key, {}) if row is not None else {}
        if found:
            numbers[k] = list(found.values()) if list(found) == names else [found.get(name, np.nan) for name in names]
    return numbers


def status(folder: Path) -> tuple[EnsembleTable, list[str]]:
    """The table as it is now, and lines about it.  Raises FileNotFoundError,
    ValueError for a folder without an ensemble."""
    with EnsembleFolder(folder, writes=False) as opened:
        if opened.asked is None:
            raise FileNotFoundError(f"folder {str(folder)!r} holds no ensemble: there is no {DESCRIPTION} in it")
        table = table_of(opened, opened.asked, len(opened.asked.parameters))
        steps = opened.asked.steps
        noted = [int(Path(name).stem) for name in opened.files() if name.endswith(SUFFIX)]
    lines = str(table).splitlines()
    begun = {index: table["file"][index] for index in np.flatnonzero(table["status"] == BEGUN).tolist()}
    now = {index: told for index in sorted(noted) if (told := read_note(opened.file(index)))}
    lines += _some("running", (f"member {index}: {told}" for index, told in now.items()), len(now))
    stopped = {index: file for index, file in begun.items() if index not in now}
    lines += _some(
        "begun", (f"member {index}: {_progress(file, steps)}" for index, file in stopped.items()), len(stopped)
    )
    return table, lines


def _some(word: str, told: Iterator[str], n: int) -> list[str]:
    """The first of n lines, each after the word, and how many more there are."""
    lines = [f"{word:<14} {line}" for line in islice(told, MOST_TOLD)]
    return lines + ([f"{'':<14} and {n - MOST_TOLD} more"] if n > MOST_TOLD else [])


def _progress(file: str, steps: int) -> str:
    """The progress of a member in words. A file that is being written cannot be read."""
    from minimd.files.h5md_reader import read_file

    try:
        contents = read_file(file)
        return f"stopped after {contents.step - int(contents.record.step[0])} of {steps} steps"
    except (OSError, ValueError) as error:
        return "running" if isinstance(error, BlockingIOError) else sentence(error)


def told_averages(table: EnsembleTable) -> Iterator[str]:
    """A line of names, then the averages over members with the same parameters,
    a line for each of the first hundred sets."""
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
    """The observable of the figure: quantity, or if it is None, pressure, else potential energy, else the first.
    Raises ValueError."""
    if not table.observables:
        raise ValueError("there is nothing to draw: no member is done yet")
    if quantity is None:
        return next((name for name in DRAWN if name in table.observables), table.observables[0])
    if quantity not in table.observables:
        raise ValueError(
            f"the quantity must be one of {listed(table.observables)}; it is "
            f"{quantity!r}{near(quantity, table.observables)}"
        )
    return quantity


def picture_of_scan(table: EnsembleTable, quantity: str | None = None) -> Figure:
    """One quantity against the first parameter that has several numbers as values, with error bars;
    a curve for each set of values of the others.

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
        label = ", ".join(
            f"{one.rpartition('.')[2]} = {value}" for one, value in zip(others, key, strict=True) if one in several
        )
        axes.errorbar(
            x, curve[f"{name}_mean"], curve[f"{name}_error"], marker="o", ms=3.5, lw=1.0, capsize=2.5, label=label
        )
    unit = table.unit(name).replace("k_B", "$k_B$")
    axes.set(
        xlabel=numbers[0] if numbers else "set of parameters",
        ylabel=f"mean {name.replace('_', ' ')}" + (f"  [{unit}]" if unit else ""),
    )
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, lw=0.6)
    axes.set_title(f"{int(table.done.sum())} members, bars: one standard error", fontsize=10)
    if 1 < len(curves) <= MOST_CURVES:
        axes.legend(frameon=False, fontsize=8)
    return figure


def save_picture(table: EnsembleTable, quantity: str | None = None, out: Path | None = None) -> Path:
    """Save the figure to out, or to a file in the folder named after the quantity.
    Raises ValueError as picture_of_scan, OSError."""
    from minimd.analysis.plot import save

    place = out or table.folder / f"{drawn_quantity(table, quantity)}.png"
    return save(picture_of_scan(table, quantity), place)
