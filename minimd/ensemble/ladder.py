"""The results of replica exchange: which replica was where in the ladder, acceptance, round trips, energies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.display import Rows
from minimd.core.console.words import near
from minimd.core.engine.record import Frame, Record
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import checked_count
from minimd.core.structure.statistics import mean_and_error, with_error
from minimd.ensemble.member import file_of, value_text
from minimd.observers.accumulator import Result, Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, repr=False)
class Ladder(Result):
    """The results of md.exchange: K replicas, which have changed their places in a ladder of K temperatures in A
    attempts.

    temperatures : (K,) ascending.
    folder : of the replicas.
    places : (A, K) int, the place in the ladder that each replica had before an attempt.
    energies : (A, K) potential energy of each replica at an attempt [energy].
    accepted : (A, K − 1) bool, whether the replicas at k and k + 1 then exchanged their temperatures.
    first : number of the first of these attempts, from 1.

    What is at one temperature, at_temperatures()[:, k], is of the canonical ensemble. Reweighting by WHAM or MBAR needs
    these energies and the temperatures.
    """

    temperatures: Array
    folder: Path
    places: Indices
    energies: Array
    accepted: NDArray[np.bool_]
    first: int = 1
    title: ClassVar[str] = "replica exchange"
    coefficients: ClassVar[tuple[str, ...]] = (
        "lowest_acceptance",
        "mean_acceptance",
        "n_round_trips",
    )

    def __len__(self) -> int:
        return len(self.places)

    def after(self, n_attempts: int) -> Ladder:
        """The same without the first attempts, in which the replicas have not yet forgotten their start.
        Raises ValueError if there are not so many."""
        n = checked_count("n_attempts", n_attempts, 0, len(self) + 1)
        parts = {name: getattr(self, name)[n:] for name in ("places", "energies", "accepted")}
        return replace(self, **parts, first=self.first + n)

    @cached_property
    def replicas(self) -> Indices:
        """(A, K) int, the replica at each temperature before an attempt."""
        return np.argsort(self.places, axis=1)

    @cached_property
    def records(self) -> list[Record]:
        """The Record in the file of each replica, at all its temperatures."""
        from minimd.core.files.h5md_reader import read_file

        return [read_file(self.file(k)).record for k in range(len(self.temperatures))]

    def file(self, replica: int) -> Path:
        """The file of a replica."""
        return self.folder / file_of(replica)

    def at_temperatures(self, name: str = "potential_energy") -> Array:
        """A series of numbers in the records, such as the pressure, by temperature: (A, K)."""
        series = self.energies
        if name != "potential_energy":
            known = self.records[0].columns()
            if name not in known:
                raise ValueError(
                    f"name must be that of a series of numbers in the records; name = {name!r}{near(name, known)}"
                )
            last = self.first + len(self)
            series = np.array(
                [record.columns()[name][self.first : last] for record in self.records]
            ).T
        return np.take_along_axis(series, self.replicas, axis=1)

    def frames(self, k: int) -> Iterator[Frame]:
        """The frames at temperature k of the ladder, one for each attempt: positions and velocities, as they are in the
        files of the replicas."""
        from minimd.core.files.h5md_reader import frames_of

        replicas = self.replicas[:, checked_count("k", k, 0, len(self.temperatures))]
        readers = {}
        for replica in set(replicas.tolist()):
            numbers = self.first + np.flatnonzero(replicas == replica)
            readers[replica] = frames_of(self.file(replica), numbers.tolist(), self.units)
        for replica in replicas.tolist():
            yield next(readers[replica])

    def means(self, name: str = "potential_energy") -> tuple[Array, Array]:
        """Means of a series at each temperature, and their standard errors, (K,)."""
        columns = self.at_temperatures(name).T
        means, errors = np.array([mean_and_error(column) for column in columns]).T
        return means, errors

    @property
    def acceptance(self) -> Array:
        """(K − 1,) accepted exchanges of k and k + 1, as a part of the attempts for this pair; NaN without any."""
        pairs = np.arange(len(self.temperatures) - 1)
        numbers = self.first + np.arange(len(self))
        n_attempts = (pairs % 2 != numbers[:, None] % 2).sum(axis=0)
        with np.errstate(invalid="ignore"):
            return np.asarray(self.accepted.sum(axis=0) / n_attempts)

    @property
    def lowest_acceptance(self) -> float:
        """That of the pair with the lowest one."""
        return float(np.fmin.reduce(self.acceptance))

    @property
    def mean_acceptance(self) -> float:
        """The mean over all pairs."""
        known = self.acceptance[np.isfinite(self.acceptance)]
        return float(known.mean()) if known.size else np.nan

    @property
    def round_trips(self) -> Indices:
        """(K,) round trips of each replica: from one end of the ladder to the other and back."""
        return np.array([n_round_trips(path, len(self.temperatures) - 1) for path in self.places.T])

    @property
    def n_round_trips(self) -> int:
        """Those of all replicas."""
        return int(self.round_trips.sum())

    def series(self) -> list[Series]:
        """See Result: energies at each temperature, and acceptance with the next one, NaN for the last."""
        means, errors = self.means()
        return [
            Series("temperature", self.units.temperature, self.temperatures),
            Series("potential_energy", self.units.energy, means, errors),
            Series("acceptance", "", np.append(self.acceptance, np.nan)),
        ]

    def draw(self, panel: Axes) -> None:
        """See Result: the place of each replica in the ladder at each attempt."""
        attempts = self.first + np.arange(len(self))
        for path in self.places.T:
            panel.step(attempts, self.temperatures[path], where="mid", lw=0.8)
        panel.set(
            xlabel="attempt", ylabel=f"temperature of each replica  [{self.units.temperature}]"
        )
        panel.set_title(f"{self.title}, {self.n_round_trips} round trips")

    def display_rows(self) -> Rows:
        """See Displayed."""
        unit = self.units.temperature
        ends = " to ".join(map(value_text, self.temperatures[[0, -1]].tolist()))
        last = self.first + len(self) - 1
        rows = [
            (self.title, f"{len(self.temperatures)} temperatures, {ends} {unit}, in {self.folder}"),
            ("attempts", f"{len(self)}, {self.first} to {last}" if len(self) else "none"),
        ]
        if not len(self):
            return rows
        columns: list[list[Any]] = [
            [f"temperature [{unit}]"],
            [f"potential energy [{self.units.energy}]"],
        ]
        columns.append(["acceptance with the next"])
        columns[0] += map(value_text, self.temperatures.tolist())
        columns[1] += map(with_error, *self.means())
        columns[2] += [f"{part:.3f}" for part in self.acceptance] + [""]
        widths = [max(map(len, column)) for column in columns]
        for line in zip(*columns, strict=True):
            cells = zip(line, widths, strict=True)
            rows.append(("", "  ".join(f"{cell:>{width}}" for cell, width in cells).rstrip()))
        trips = self.round_trips
        each = f"{trips.min()} to {trips.max()} of each replica"
        rows.append(("round trips", f"{self.n_round_trips}, {each}"))
        return rows


def n_round_trips(path: Indices, top: int) -> int:
    """How often a replica went from one end of the ladder to the other and back.
    path : (A,) its places, from 0 to top."""
    ends = path[(path == 0) | (path == top)]
    n_ways = np.count_nonzero(np.diff(ends))
    return int(n_ways) // 2
