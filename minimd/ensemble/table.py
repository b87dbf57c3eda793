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

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.whole_file import write_picture, write_whole
from minimd.core.console.words import listed, near
from minimd.core.engine.record import SERIES
from minimd.core.structure.errors import sentence
from minimd.core.structure.statistics import with_error
from minimd.core.structure.units import SYSTEMS, UnitSystem
from minimd.ensemble.folder import DESCRIPTION, Asked, EnsembleFolder, alone
from minimd.ensemble.member import BEGUN, DONE, FAILED, MISSING, NOTE, STATES, file_of, read_note

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

SHOWN_FAILURES = 3
# observables listed as text; if none of them exists, all are listed
TOLD = "temperature", "potential_energy", "pressure"
# of the lines for each set of parameters
LEFT_OUT = "kinetic_energy", "total_energy", "conserved_energy"
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
        names = self.array.dtype.names or ()
        if name not in names:
            raise KeyError(
                f"a table has no column {name!r}; it has {', '.join(names)}{near(name, names)}"
            )
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
        # the number of each set, in the order of their members
        rows = self.array[self.done]
        sets = dict[tuple, int]()
        kinds_of = [
            np.unique(rows[name], return_inverse=True)[1].tolist() for name in self.parameters
        ]
        keys = zip(*kinds_of, strict=True) if kinds_of else [()] * len(rows)
        groups = np.array([sets.setdefault(key, len(sets)) for key in keys], dtype=np.int64)
        first = np.unique(groups, return_index=True)[1]
        kinds: list[tuple[str, Any]] = [(name, rows.dtype[name]) for name in self.parameters]
        kinds += [("n_members", np.int64)]
        kinds += [
            (name + ending, np.float64)
            for name in self.observables
            for ending in ("_mean", "_error")
        ]
        made = np.zeros(len(sets), dtype=kinds)
        for name in self.parameters:
            made[name] = rows[name][first]
        n = made["n_members"] = np.bincount(groups, minlength=len(sets))
        for name in self.observables:
            means = rows[f"{name}_mean"]
            errors = rows[f"{name}_error"]
            scatter = np.full(len(sets), np.nan)
            mean = made[f"{name}_mean"] = np.bincount(groups, means, len(sets)) / n
            squares = np.bincount(groups, (means - mean[groups]) ** 2, len(sets))
            np.divide(squares, n * (n - 1.0), out=scatter, where=n > 1)
            inner = np.sqrt(np.bincount(groups, errors**2, len(sets))) / n
            made[f"{name}_error"] = np.fmax(inner, np.sqrt(scatter))
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
        return DataFrame(
            {name: self.array[name] for name in self.array.dtype.names or ()}
        ).set_index("index")

    def write(self) -> None:
        """Write table.csv and table.json into the folder; numbers have all their digits, paths are relative to the
        folder.  Raises OSError."""
        columns = {name: self.array[name].tolist() for name in self.array.dtype.names or ()}
        pairs = zip(columns["index"], columns["file"], strict=True)
        columns["file"] = [file_of(index).as_posix() if file else "" for index, file in pairs]
        stream = io.StringIO()
        lines = csv.writer(stream, lineterminator="\n")
        lines.writerow(columns)
        lines.writerows(zip(*columns.values(), strict=True))
        write_whole(self.folder / "table.csv", stream.getvalue())
        units = {name: unit for name in self.observables if (unit := self.unit(name))}
        whole = {
            name: [None if number != number else number for number in values]
            for name, values in columns.items()
        }
        told = {"parameters": self.parameters, "units": units, "columns": whole}
        write_whole(self.folder / "table.json", json.dumps(told))

    def failures(self, members: range | None = None) -> Iterator[str]:
        """A sentence for each member that has failed.  members : consecutive indices of those that are told, None for
        all."""
        rows = self.array if members is None else self.array[members.start : members.stop]
        for row in rows[rows["status"] == FAILED]:
            told = ", ".join(f"{name} = {row[name]}" for name in self.parameters)
            yield f"member {row['index']}{f' ({told})' if told else ''}: {row['message']}"

    def display_rows(self) -> Rows:
        """See Displayed."""
        counts = {status: int((self["status"] == status).sum()) for status in STATES}
        told = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        rows = [("ensemble", f"{len(self)} members in {self.folder}: {told}")]
        for name in self.parameters:
            values = self[name]
            limits = f", {values.min()} to {values.max()}" if values.dtype.kind in "if" else ""
            rows.append((name, f"{len(set(values.tolist()))} values{limits}"))
        if self.done.any():
            rows += [("" if k else "means", line) for k, line in enumerate(told_averages(self))]
        several = list(self.failures())
        rows += [("FAILED", told) for told in several[:SHOWN_FAILURES]]
        return rows + (
            [("", f"and {len(several) - SHOWN_FAILURES} more")]
            if len(several) > SHOWN_FAILURES
            else []
        )

    def __repr__(self) -> str:
        return f"EnsembleTable({len(self)} members, {', '.join([*self.parameters, *self.observables])})"


def table_of(folder: EnsembleFolder, asked: Asked, n_members: int) -> EnsembleTable:
    """The table of the first n_members members of a folder.

    Results are those of members that have failed, or are done with all steps that are asked for now.
    """
    found = [folder.rows.get(index) for index in range(n_members)]
    rows = [row if row and (row["status"] == FAILED or asked.is_done(row)) else {} for row in found]
    there = folder.files()
    places = [file_of(index).as_posix() for index in range(n_members)]
    is_there = [place in there for place in places]
    columns: dict[str, Any] = {"index": np.arange(n_members)}
    columns |= {
        name: np.array([one[name] for one in asked.parameters[:n_members]])
        for name in asked.parameters[0]
    }
    states = [
        row.get("status", BEGUN if file else MISSING)
        for row, file in zip(rows, is_there, strict=True)
    ]
    columns["status"] = np.array(states)
    columns |= {
        name: np.array([row.get(name, 0) for row in rows], dtype=np.int64)
        for name in ("n_steps", "n_atoms")
    }
    names = list(dict.fromkeys(name for row in rows for name in row.get("means", ())))
    nothing = dict.fromkeys(names, np.nan)
    for ending, key in (("_mean", "means"), ("_error", "errors")):
        several = [row.get(key, nothing) for row in rows]
        alike = [one if list(one) == names else nothing | one for one in several]
        numbers = np.array([list(one.values()) for one in alike], dtype=np.float64).reshape(
            n_members, len(names)
        )
        columns |= {f"{name}{ending}": numbers[:, k] for k, name in enumerate(names)}
    files = [
        str(folder.path / place) if file else ""
        for place, file in zip(places, is_there, strict=True)
    ]
    columns |= {
        "file": np.array(files, object),
        "message": np.array([row.get("message", "") for row in rows], object),
    }
    array = np.empty(n_members, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        array[name] = column
    units = {row["units"] for row in rows if "units" in row}
    known = SYSTEMS.get(units.pop()) if len(units) == 1 else None
    return EnsembleTable(folder.path, list(asked.parameters[0]), array, known)


def written_table(folder: EnsembleFolder, asked: Asked, n_members: int) -> EnsembleTable:
    """The same, written into the folder; it has all members if other calls may run there.  Raises OSError."""
    with alone(folder.path):
        if folder.members is not None:
            folder.read()
            asked = folder.asked or asked
            n_members = len(asked.parameters)
        table = table_of(folder, asked, n_members)
        table.write()
    return table


def status(folder: Path) -> tuple[EnsembleTable, list[str]]:
    """The table as it is now, and lines about it.  Raises FileNotFoundError, ValueError for a folder without an
    ensemble."""
    with EnsembleFolder(folder, writes=False) as opened:
        if opened.asked is None:
            raise FileNotFoundError(
                f"folder {str(folder)!r} holds no ensemble: there is no {DESCRIPTION} in it"
            )
        table = table_of(opened, opened.asked, len(opened.asked.parameters))
        steps = opened.asked.steps
        noted = sorted(int(Path(name).stem) for name in opened.files() if name.endswith(NOTE))
    lines = str(table).splitlines()
    running = {index: told for index in noted if (told := read_note(opened.file(index)))}
    begun = [
        index for index in np.flatnonzero(table["status"] == BEGUN).tolist() if index not in running
    ]
    for word, members in (("running", list(running)), ("begun", begun)):
        for index in islice(members, MOST_TOLD):
            lines.append(
                f"{word:<14} member {index}: {running.get(index) or _progress(table['file'][index], steps)}"
            )
        lines += [f"{'':<14} and {len(members) - MOST_TOLD} more"] * (len(members) > MOST_TOLD)
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
    own = [
        name
        for name in table.observables
        if name not in (*TOLD, *LEFT_OUT) and "momentum" not in name
    ]
    names = [name for name in TOLD if name in table.observables] + own or list(table.observables)
    units = {name: f" [{table.unit(name)}]" if table.unit(name) else "" for name in names}
    lines = [
        [
            *table.parameters,
            "members",
            *(f"{name.replace('_', ' ')}{units[name]}" for name in names),
        ]
    ]
    for row in rows[:MOST_LINES]:
        means = [with_error(row[f"{name}_mean"], row[f"{name}_error"]) for name in names]
        lines.append(
            [*(str(row[name]) for name in table.parameters), str(row["n_members"]), *means]
        )
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
        words = f"the quantity must be one of {listed(table.observables)}"
        raise ValueError(f"{words}; it is {quantity!r}{near(quantity, table.observables)}")
    return quantity


def picture_of_scan(table: EnsembleTable, quantity: str | None = None) -> Figure:
    """One quantity against the first parameter that has several numbers as values, with error bars; a curve for each
    set of values of the others.

    Raises ValueError if no member is done, or none has such a quantity.
    """
    from minimd.core.engine.record_picture import Picture

    name = drawn_quantity(table, quantity)
    rows = table.averaged()
    several = [one for one in table.parameters if len(set(rows[one].tolist())) > 1]
    x_name = next((one for one in several if rows.dtype[one].kind in "if"), None)
    others = [one for one in several if one != x_name]
    figure = Picture(figsize=(7.0, 4.5), dpi=150, layout="constrained")
    axes = figure.subplots()
    curves = dict[tuple, list[int]]()
    for k, row in enumerate(rows):
        curves.setdefault(tuple(row[one] for one in others), []).append(k)
    for key, members in curves.items():
        curve = (
            rows[members] if x_name is None else rows[members][np.argsort(rows[members][x_name])]
        )
        x = np.arange(len(curve)) if x_name is None else curve[x_name]
        label = ", ".join(
            f"{one.rpartition('.')[2]} = {value}" for one, value in zip(others, key, strict=True)
        )
        bars: dict[str, Any] = {
            "marker": "o",
            "ms": 3.5,
            "lw": 1.0,
            "capsize": 2.5,
            "label": label.replace("$", r"\$"),
        }
        axes.errorbar(x, curve[f"{name}_mean"], curve[f"{name}_error"], **bars)
    unit = table.unit(name).replace("k_B", "$k_B$")
    quantity = name.replace("_", " ").replace("$", r"\$")
    axes.set_xlabel(x_name or "set of parameters", parse_math=False)
    axes.set_ylabel(f"mean {quantity}" + (f"  [{unit}]" if unit else ""))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, lw=0.6)
    axes.set_title(f"{int(table.done.sum())} members, bars: one standard error", fontsize=10)
    if 1 < len(curves) <= MOST_CURVES:
        axes.legend(frameon=False, fontsize=8)
    return figure


def save_picture(
    table: EnsembleTable, quantity: str | None = None, out: Path | None = None
) -> Path:
    """Save the figure to out, or to a file in the folder named after the quantity.  Raises ValueError as
    picture_of_scan, OSError."""

    place = out or table.folder / f"{drawn_quantity(table, quantity)}.png"
    return write_picture(picture_of_scan(table, quantity), place)
