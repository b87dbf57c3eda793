"""The results of an ensemble as a table: one row for each member, or averages over members with the same parameters."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from minimd.engine.record import SERIES
from minimd.ensemble.folder import Asked, EnsembleFolder, is_done, write_whole
from minimd.ensemble.member import file_of
from minimd.ensemble.work import BEGUN, DONE, FAILED, MISSING, Row
from minimd.structure.checks import near
from minimd.structure.display import Displayed, Rows
from minimd.structure.units import SYSTEMS, UnitSystem

if TYPE_CHECKING:
    import pandas

TEXTS = ("file", "message")
SHOWN_FAILURES = 3


class EnsembleTable(Displayed):
    """What came of the members of an ensemble, in the order of their indices.

    Attributes
    ----------
    array : structured array: index, the parameters, status, n_steps, n_atoms, <name>_mean and <name>_error of each observable, file, message.
        status is "done", "failed", "begun" (stopped before its end) or "missing". Means are NaN where a member is not done.
    folder : of the ensemble.  parameters, observables : names.  units : the UnitSystem of the observables, None if it is not known.

    table["pressure_mean"] is a column of the array.
    """

    def __init__(self, folder: Path, names: Sequence[str], array: NDArray[Any], units: UnitSystem | None) -> None:
        self.folder, self.parameters, self.array, self.units = folder, tuple(names), array, units
        self.observables = tuple(name.removesuffix("_mean") for name in array.dtype.names or () if name.endswith("_mean"))

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
        """Structured array with a row for each set of parameters: these, n_members that are done, means and errors over these members.

        The error of a mean over M ≥ 2 members is the larger of √(Σ σ²) / M, with their own errors σ, and the standard error of their means
        by their scatter. Sets of which no member is done are left out.
        """
        rows = self.array[self.done]
        groups: dict[tuple, list[int]] = {}
        for k, key in enumerate(zip(*(rows[name].tolist() for name in self.parameters), strict=True) if self.parameters else [()] * len(rows)):
            groups.setdefault(key, []).append(k)
        means = [name + ending for name in self.observables for ending in ("_mean", "_error")]
        kinds = [(name, rows.dtype[name]) for name in self.parameters] + [("n_members", np.int64), *((name, np.float64) for name in means)]
        made = np.zeros(len(groups), dtype=kinds)
        for k, (key, members) in enumerate(groups.items()):
            pairs = [_joined(rows[f"{name}_mean"][members], rows[f"{name}_error"][members]) for name in self.observables]
            made[k] = (*key, len(members), *(number for pair in pairs for number in pair))
        return made

    def unit(self, name: str) -> str:
        """The unit of an observable, in words; empty for a pure number, or if it is not known."""
        return "" if self.units is None else str(getattr(self.units, SERIES.get(name) or "", ""))

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame with the columns of the array, and the index of the members as its index.

        Raises ModuleNotFoundError if pandas is not installed, which minimd does not need itself.
        """
        try:
            from pandas import DataFrame
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError("to_pandas needs pandas, which is not installed: install it, or use table.array or table.csv") from error
        return DataFrame({name: self.array[name] for name in self.array.dtype.names or ()}).set_index("index")

    def write(self) -> None:
        """Write table.csv and table.json into the folder; numbers have all their digits, paths begin at the folder.  Raises OSError."""
        columns = {name: self.array[name].tolist() for name in self.array.dtype.names or ()}
        columns["file"] = [str(Path(file).relative_to(self.folder)) if file else "" for file in columns["file"]]
        stream = io.StringIO()
        lines = csv.writer(stream, lineterminator="\n")
        lines.writerow(columns)
        lines.writerows(zip(*columns.values(), strict=True))
        write_whole(self.folder / "table.csv", stream.getvalue())
        units = {name: unit for name in self.observables if (unit := self.unit(name))}
        whole = {name: [None if number != number else number for number in values] for name, values in columns.items()}
        write_whole(self.folder / "table.json", json.dumps({"parameters": self.parameters, "units": units, "columns": whole}))

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
        for name in (one for one in self.observables if "momentum" not in one and self.done.any()):
            means = self[f"{name}_mean"][self.done]
            rows.append((f"mean {name}".replace("_", " "), f"from {means.min():.6g} to {means.max():.6g} {self.unit(name)}".rstrip()))
        several = list(self.failures())
        rows += [("FAILED", sentence) for sentence in several[:SHOWN_FAILURES]]
        return rows + ([("", f"and {len(several) - SHOWN_FAILURES} more")] if len(several) > SHOWN_FAILURES else [])

    def __repr__(self) -> str:
        return f"EnsembleTable({len(self)} members, {', '.join([*self.parameters, *self.observables])})"


def _joined(means: NDArray[Any], errors: NDArray[Any]) -> tuple[float, float]:
    """Mean of the means of several members, and its error; see EnsembleTable.averaged."""
    n = len(means)
    inner = float(np.sqrt((errors**2).sum()) / n)
    if n == 1:
        return float(means[0]), inner
    return float(means.mean()), float(np.fmax(inner, means.std(ddof=1) / np.sqrt(n)))


def table_of(folder: EnsembleFolder, asked: Asked, n_members: int) -> EnsembleTable:
    """The table of the first n_members members of a folder."""
    rows = [_present(folder.rows.get(index), asked) for index in range(n_members)]
    names = list(asked.parameters[0])
    observables = list(dict.fromkeys(name for row in rows if row is not None for name in row.get("means", ())))
    columns: dict[str, Any] = {"index": np.arange(n_members)}
    columns |= {name: np.array([one[name] for one in asked.parameters[:n_members]]) for name in names}
    files = [folder.path / file_of(index) for index in range(n_members)]
    is_there = [file.exists() for file in files]
    columns["status"] = np.array([row["status"] if row else BEGUN if there else MISSING for row, there in zip(rows, is_there, strict=True)])
    for name in ("n_steps", "n_atoms"):
        columns[name] = np.array([(row or {}).get(name, 0) for row in rows], dtype=np.int64)
    for name in observables:
        for ending, key in (("_mean", "means"), ("_error", "errors")):
            columns[name + ending] = np.array([(row or {}).get(key, {}).get(name, np.nan) for row in rows], dtype=np.float64)
    columns["file"] = np.array([str(file) if there else "" for file, there in zip(files, is_there, strict=True)], dtype=object)
    columns["message"] = np.array([(row or {}).get("message", "") for row in rows], dtype=object)
    array = np.empty(n_members, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        array[name] = column
    units = {row["units"] for row in rows if row is not None and "units" in row}
    return EnsembleTable(folder.path, names, array, SYSTEMS.get(units.pop()) if len(units) == 1 else None)


def _present(row: Row | None, asked: Asked) -> Row | None:
    """The row of a member that has failed or is done, also if more steps are asked for than when it ended; else None."""
    is_present = row is not None and (row["status"] == FAILED or is_done(row, asked.steps, bool(asked.run)))
    return row if is_present else None
